"""Contact of the two walls of a cut in finite elements: nodes of one must not enter the other, without friction.

A node that has entered is pushed back by a spring along the normal of the wall where it is nearest; which place that
is, is determined again until the equilibrium no longer changes. The springs are so stiff that nodes enter by a
hundredth of an element (penalty method; Wriggers, Computational Contact Mechanics, 2nd ed. 2006, chapters 5 and 9).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import bsr_array, coo_array, csr_array, diags_array
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Longs, Mask
from tissue_sim.calibration.cholesky import Cholesky, NotPositive
from tissue_sim.calibration.solid import Solid
from tissue_sim.model.cutting.cut_surface import FACES

STIFF = 40.0  # a wall's stiffness, in Young's moduli over its mean edge
DEEP = 0.25  # mean edges of a wall by which the lips pass through each other, from which contact begins at rest
MOST_ROUNDS = 8  # of determining where nodes touch
STILL = 5e-3  # relative change of the displacements between two rounds, at the end
TOLERANCE = 1e-5  # of the energy
CANDIDATES = 12  # triangles of a wall among which the nearest is looked for
BESIDE = 0.5  # mean edges of a wall beyond its rim, where a node doesn't touch it
SUB = np.array([(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)])  # triangles of a quadratic facet


class Springs(NamedTuple):
    """Springs that push back nodes that have entered a wall. k nodes."""

    rows: csr_array  # (k, 3n) change of each gap by displacements
    gap: Floats  # (k,) m, without displacements
    stiffness: Floats  # (k,) N/m


class TouchingSolid(Solid):
    """Solid that springs hold apart at the walls of a cut."""

    springs: Springs | None = None

    def energy(self, displacement: Floats) -> tuple[float, Floats, float]:
        """Return the energy J, its gradient (n, 3) N, and the least det F; see Solid.

        Parameters
        ----------
        displacement : Floats, shape (n, 3), m
            The displacement.
        """
        energy, forces, least = super().energy(displacement)
        if self.springs is None:
            return energy, forces, least
        rows, gap, stiffness = self.springs
        entered = np.minimum(gap + rows @ displacement.ravel(), 0.0)
        push = (rows.T @ (stiffness * entered)).reshape(forces.shape)
        return energy + 0.5 * float(stiffness @ entered**2), forces + push, least

    def tangent(self, displacement: Floats) -> bsr_array:
        """Return the stiffness about a displaced state, held axes included; see Solid.

        Parameters
        ----------
        displacement : Floats, shape (n, 3), m
            The displacement.
        """
        found = super().tangent(displacement)
        if self.springs is None:
            return found
        rows, gap, stiffness = self.springs
        entered = gap + rows @ displacement.ravel() < 0.0
        more = rows.T @ diags_array(np.where(entered, stiffness, 0.0)) @ rows
        return bsr_array(found + more.tobsr((3, 3)))


class _Factor:
    """Factor of a solid about a state, or about rest where that is unstable: a preconditioner, without the springs."""

    def __init__(self, solid: Solid, moved: Floats) -> None:
        try:
            self._factor: Cholesky = solid.factor(moved)
        except NotPositive:
            self._factor = solid.factor(np.zeros_like(moved))

    def precondition(self, right: Floats) -> Floats:
        """Return displacements (3n, c) m for forces (3n, c) N."""
        return self._factor.precondition(right)

    def renew(self, moved: Floats) -> None:
        """Do nothing: the springs make it worn, and it leaves them out."""


class Lips:
    """The two walls of a cut.

    Parameters
    ----------
    below : Longs, shape (w, 6)
        Quadratic facets of the wall on the sheet's negative side.
    above : Longs, shape (w, 6)
        Those of the other wall; each node lies on that of the first wall.
    points : Floats, shape (p, 3), m
        Corners of the elements.
    cells : Longs, shape (c, 4)
        The elements' corners, which tell on which side of a facet its wall's tissue lies.
    """

    def __init__(self, below: Longs, above: Longs, points: Floats, cells: Longs) -> None:
        turned = _points_into_tissue(below[:, :3], points, cells)
        order = np.array([0, 2, 1, 5, 4, 3])
        below[turned], above[turned] = below[turned][:, order], above[turned][:, order]
        self._triangles = below[:, SUB].reshape(-1, 3)
        twins = np.unique(np.stack([above.ravel(), below.ravel()], axis=1), axis=0)
        self._above, self._below = twins[twins[:, 0] != twins[:, 1]].T  # those at the front are the same
        corners = points[below[:, :3]]
        area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        weight = np.bincount(above[:, SUB].ravel(), np.repeat(area / 12.0, 12), int(above.max()) + 1)
        self._area = weight[self._above]
        self._edge = float(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).mean())

    def penetration(self, nodes: Floats, moved: Floats) -> float:
        """Return by how much the lips pass through each other, m, at most, for displacements (n, 3) m of nodes."""
        _, gap, beside, _, _ = self._nearest(nodes + moved)
        return float(max(0.0, -np.where(beside, 0.0, gap).min(initial=0.0)))

    def settle(self, solid: TouchingSolid, load: Floats, start: Floats) -> tuple[Floats, bool]:
        """Return the equilibrium of a solid whose lips touch, (n, 3) m, and whether there is one.

        Parameters
        ----------
        solid : TouchingSolid
            The solid.
        load : Floats, shape (n, 3), N
            The loads.
        start : Floats, shape (n, 3), m
            The equilibrium without contact.
        """
        if self.penetration(solid.nodes, start) > DEEP * self._edge:
            start = np.zeros_like(start)
        moved, factor, settled = start, _Factor(solid, start), False
        mu, lam = solid.moduli.mu, solid.moduli.lam
        youngs_modulus = mu * (3.0 * lam + 2.0 * mu) / (lam + mu)
        stiffness = STIFF * youngs_modulus / self._edge * self._area
        try:
            for number in range(MOST_ROUNDS):
                solid.springs = self._springs(solid.nodes, moved, stiffness, twins=number == 0)
                found = solid.follow(moved, load, factor, TOLERANCE)
                if not found.converged:
                    break
                change = np.linalg.norm(found.displacement - moved) / np.linalg.norm(found.displacement)
                moved = found.displacement
                if number and change < STILL:
                    settled = True
                    break
        finally:
            solid.springs = None
        return moved, settled

    def _springs(self, nodes: Floats, moved: Floats, stiffness: Floats, *, twins: bool) -> Springs:
        """Return the springs at a displaced state: to where the wall is nearest, or to the node that lay there."""
        normal, _, beside, corners, weights = self._nearest(nodes + moved)
        if twins:
            corners, weights = np.stack([self._below] * 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(normal), 1))
            normal, beside = self._normals(nodes + moved)[self._below], np.zeros(len(normal), dtype=bool)
        chosen = np.flatnonzero(~beside)
        normal, corners, weights = normal[chosen], corners[chosen], weights[chosen]
        own, k, n = self._above[chosen], len(chosen), len(nodes)
        ends = np.concatenate([own[:, None], corners], axis=1)
        fraction = np.concatenate([np.ones((k, 1)), -weights], axis=1)
        columns = (3 * ends[:, :, None] + np.arange(3)).reshape(k, 12)
        values = (fraction[:, :, None] * normal[:, None, :]).reshape(k, 12)
        row = np.repeat(np.arange(k), 12)
        rows = coo_array((values.ravel(), (row, columns.ravel())), shape=(k, 3 * n)).tocsr()
        return Springs(rows, rows @ nodes.ravel(), stiffness[chosen])

    def _normals(self, positions: Floats) -> Floats:
        """Return the lower wall's normals (n, 3) at its nodes, towards the other wall; 0 at other nodes."""
        corner = positions[self._triangles]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        total = np.zeros((len(positions), 3))
        for column in self._triangles.T:
            np.add.at(total, column, normal)
        return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None])

    def _nearest(self, positions: Floats) -> tuple[Floats, Floats, Mask, Longs, Floats]:
        """Return where the lower wall is nearest to each node (k,) of the upper one.

        The wall's normals (k, 3), gaps (k,) m, whether the node lies beside the wall, the nodes (k, 3) of the triangle
        there, and their weights (k, 3).
        """
        triangles = self._triangles
        corner = positions[triangles]
        reach = min(CANDIDATES, len(triangles))
        points = positions[self._above]
        candidates = cKDTree(corner.mean(axis=1)).query(points, k=reach)[1].reshape(len(points), reach)
        weights = _closest(points[:, None], corner[candidates])
        away = points[:, None] - np.einsum("kcw,kcwx->kcx", weights, corner[candidates])
        best = np.argmin(np.einsum("kcx,kcx->kc", away, away), axis=1)
        row = np.arange(len(points))
        chosen, weight, away = candidates[row, best], weights[row, best], away[row, best]
        # Normals are interpolated between nodes, so that they don't jump where the nearest triangle changes.
        normal = np.einsum("kw,kwx->kx", weight, self._normals(positions)[triangles[chosen]])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        gap = np.einsum("kx,kx->k", away, normal)
        beside = np.linalg.norm(away - gap[:, None] * normal, axis=1) > BESIDE * self._edge
        return normal, gap, beside, triangles[chosen], weight


def _points_into_tissue(triangles: Longs, points: Floats, cells: Longs) -> Mask:
    """Return which triangles (w,) of elements have normals that point into their element."""
    n = len(points)
    faces = cells[:, FACES].reshape(-1, 3)

    def keys(corners: Longs) -> Longs:
        corners = np.sort(corners, axis=1)
        found: Longs = (corners[:, 0] * n + corners[:, 1]) * n + corners[:, 2]
        return found

    of_cells, wanted = keys(faces), keys(triangles)
    order = np.argsort(of_cells)
    owner = order[np.searchsorted(of_cells[order], wanted)] // 4
    a, b, c = (points[triangles[:, k]] for k in range(3))
    into = np.einsum("wx,wx->w", np.cross(b - a, c - a), points[cells[owner]].mean(axis=1) - a)
    turned: Mask = into > 0.0
    return turned


def _closest(points: Floats, triangles: Floats) -> Floats:
    """Return the weights (..., 3) of the nearest points of triangles (..., 3, 3) to points (..., 3)."""
    a, b, c = (triangles[..., k, :] for k in range(3))
    one, other = b - a, c - a
    normal = np.cross(one, other)
    square = np.maximum(np.einsum("...x,...x->...", normal, normal), 1e-300)
    at_b = np.einsum("...x,...x->...", np.cross(points - a, other), normal) / square
    at_c = np.einsum("...x,...x->...", np.cross(one, points - a), normal) / square
    best = np.stack([1.0 - at_b - at_c, at_b, at_c], axis=-1)
    nearest = np.where((best >= 0.0).all(axis=-1), 0.0, np.inf)
    for first, last in ((0, 1), (1, 2), (2, 0)):
        start, way = triangles[..., first, :], triangles[..., last, :] - triangles[..., first, :]
        length = np.maximum(np.einsum("...x,...x->...", way, way), 1e-300)
        part = np.clip(np.einsum("...x,...x->...", points - start, way) / length, 0.0, 1.0)
        away = points - start - part[..., None] * way
        distance = np.einsum("...x,...x->...", away, away)
        weights = np.zeros_like(best)
        weights[..., first], weights[..., last] = 1.0 - part, part
        closer = distance < nearest
        best = np.where(closer[..., None], weights, best)
        nearest = np.where(closer, distance, nearest)
    return best
