"""Contact of the two walls of a cut in finite elements: nodes of one must not enter the other, without friction.

A node that has entered is pushed back by a spring along the normal of the wall where it is nearest; which place that
is, is determined again until the equilibrium no longer changes. The springs are so stiff that nodes enter by a
hundredth of an element (penalty method; Wriggers, Computational Contact Mechanics, 2nd ed. 2006, chapters 5 and 9).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import bsr_array, coo_array, csr_array, diags_array

from tissue_sim.array_types import Floats, Longs, Mask
from tissue_sim.calibration.cholesky import Cholesky, NotPositive
from tissue_sim.calibration.solid import Solid
from tissue_sim.contact.triangles import nearest_among
from tissue_sim.organ.edges import CELL_FACES
from tissue_sim.organ.normals import triangle_area

STIFF = 40.0  # a wall's stiffness, in Young's moduli over its mean edge
DEEP = 0.25  # mean edges of a wall by which the lips pass through each other, from which contact begins at rest
MOST_ROUNDS = 8  # of determining where nodes touch
STILL = 5e-3  # relative change of the displacements between two rounds, at the end
TOLERANCE = 1e-5  # of the energy
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
        """Return the energy J, its gradient (n, 3) N, and the least det F at a displacement (n, 3) m; see Solid."""
        energy, forces, least = super().energy(displacement)
        if self.springs is None:
            return energy, forces, least
        rows, gap, stiffness = self.springs
        entered = np.minimum(gap + rows @ displacement.ravel(), 0.0)
        push = (rows.T @ (stiffness * entered)).reshape(forces.shape)
        return energy + 0.5 * float(stiffness @ entered**2), forces + push, least

    def tangent(self, displacement: Floats) -> bsr_array:
        """Return the stiffness about a displacement (n, 3) m, held axes included; see Solid."""
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

    below (w, 6): quadratic facets of the wall on the sheet's negative side; above (w, 6): those of the other wall (each
    node lies on that of the first wall); points (p, 3) m: corners of the elements; cells (c, 4): the elements' corners,
    which show on which side of a facet its wall's tissue lies.
    """

    def __init__(self, below: Longs, above: Longs, points: Floats, cells: Longs) -> None:
        turned = _points_into_tissue(below[:, :3], points, cells)
        order = np.array([0, 2, 1, 5, 4, 3])
        below[turned], above[turned] = below[turned][:, order], above[turned][:, order]
        self._triangles = below[:, SUB].reshape(-1, 3)
        twins = np.unique(np.stack([above.ravel(), below.ravel()], axis=1), axis=0)
        self._above, self._below = twins[twins[:, 0] != twins[:, 1]].T  # those at the front are the same
        corners = points[below[:, :3]]
        area = triangle_area(points, below[:, :3])
        weight = np.bincount(above[:, SUB].ravel(), np.repeat(area / 12.0, 12), int(above.max()) + 1)
        self._area = weight[self._above]
        self._edge = float(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).mean())

    def penetration(self, nodes: Floats, moved: Floats) -> float:
        """Return by how much the lips pass through each other, m, at most, for displacements (n, 3) m of nodes."""
        _, gap, beside, _, _ = self._nearest(nodes + moved)
        return float(max(0.0, -np.where(beside, 0.0, gap).min(initial=0.0)))

    def settle(self, solid: TouchingSolid, load: Floats, start: Floats) -> tuple[Floats, bool]:
        """Return the equilibrium of a solid whose lips touch, (n, 3) m, and whether there is one.

        load (n, 3) N; start (n, 3) m: the equilibrium without contact.
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
        corner, points = positions[triangles], positions[self._above]
        chosen, weight, _ = nearest_among(corner, points)
        away = points - np.einsum("kw,kwx->kx", weight, corner[chosen])
        # Normals are interpolated between nodes, so that they don't jump where the nearest triangle changes.
        normal = np.einsum("kw,kwx->kx", weight, self._normals(positions)[triangles[chosen]])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        gap = np.einsum("kx,kx->k", away, normal)
        beside = np.linalg.norm(away - gap[:, None] * normal, axis=1) > BESIDE * self._edge
        return normal, gap, beside, triangles[chosen], weight


def _points_into_tissue(triangles: Longs, points: Floats, cells: Longs) -> Mask:
    """Return which triangles (w,) of elements have normals that point into their element."""
    n = len(points)
    faces = cells[:, CELL_FACES].reshape(-1, 3)

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
