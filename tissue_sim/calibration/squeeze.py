"""Rigid spheres pressed into a finite-element solid, which doesn't slip along them: force against depth."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse import csr_array

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.cholesky import Cholesky, NotPositive
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.solid import Solid
from tissue_sim.organ.organ import Organ

FINE = Grading(near=1)  # where an organ may be touched: two nodes on an edge of its surface
TIE = 2000.0  # N/m, by which a touching point is held to its place on the sphere: 10 um under 20 mN
ENTERED = 1e-6  # m inside a sphere
MOST_ROUNDS = 12  # of finding out which points touch, at one depth
TOLERANCE = 1e-4  # of what the ties would do to the linear solid, in the energy norm
WORN = 30  # iterations at one depth, after which a factor about the state reached costs less than more of them


class Points(NamedTuple):
    """What of a solid's surface may touch: weighted sums of its nodes."""

    rest: Floats  # (k, 3) m
    weights: csr_array  # (k, n)


class Squeezed(NamedTuple):
    """A solid between spheres, at rest."""

    displacement: Floats  # (n, 3) m of all nodes
    forces: Floats  # (s, 3) N of the spheres on the solid
    touching: Longs  # points that touch
    least_det: float  # det F where the solid is compressed most
    settled: bool


def touchable(organ: Organ, touched: NDArray[np.bool_]) -> tuple[Solid, Points]:
    """Finite elements of an organ that may be touched around surface nodes (n,), and isn't where it is held.

    They are fine there, so that contact is that of a sphere, and touched at all nodes of their own. Raises UserError
    as Body does.
    """
    touched = touched.copy()
    touched[organ.fixed] = False
    body = Body(organ, np.flatnonzero(touched), FINE)
    return body.solid, own_points(body, np.flatnonzero(touched[organ.surface_triangles].all(axis=1)))


def own_points(body: Body, near: Longs) -> Points:
    """The solid's own nodes on the organ's triangles of numbers near (t,): where it is touched in truth."""
    nodes = np.unique(body.filling.facets[np.isin(body.filling.triangle, near)])
    ones = np.ones(len(nodes)), (np.arange(len(nodes)), nodes)
    return Points(body.solid.nodes[nodes], csr_array(ones, shape=(len(nodes), body.n_nodes)))


class Held:
    """What a solid tied at some of its points gives way by: a factor without ties, and their part by Woodbury.

    A spring to a point is so much stiffer than the solid that conjugate gradients would take an iteration for each.
    """

    def __init__(self, solid: Solid, factor: Cholesky, points: Points) -> None:
        self._solid, self._factor, self._points = solid, factor, points
        self._gives: dict[int, Floats] = {}  # of a point, (3, n, 3) m/N

    def anew(self, moved: Floats) -> Held:
        """The same about another state (n, 3) m; this one where that would not be stable without ties."""
        try:
            return Held(self._solid, self._solid.factor(moved), self._points)
        except NotPositive:
            return self

    def tied(self, stuck: Longs) -> Callable[[Floats], Floats]:
        """Displacements (n, 3) m for forces (n, 3) N with ties at points (k,)."""
        weights = csr_array(self._points.weights[stuck])
        new = [point for point in stuck.tolist() if point not in self._gives]
        if new:
            pulls = np.einsum("kn,ab->kanb", self._points.weights[new].toarray(), np.eye(3))
            gives = self._factor.solve(pulls.reshape(3 * len(new), -1).T).T.reshape(len(new), 3, -1, 3)
            self._gives.update(zip(new, gives, strict=True))
        if not len(stuck):
            return self._untied
        gives = np.concatenate([self._gives[point] for point in stuck.tolist()])  # (3k, n, 3)
        among = np.stack([(weights @ give).ravel() for give in gives], axis=1)
        small = lu_factor(among + np.eye(len(among)) / TIE)

        def precondition(force: Floats) -> Floats:
            moved = self._untied(force)
            pulls = lu_solve(small, (weights @ moved).ravel())
            return moved - np.tensordot(pulls, gives, axes=1)

        return precondition

    def _untied(self, force: Floats) -> Floats:
        return self._factor.precondition(force.reshape(-1, 1)).reshape(force.shape)


def squeezed(solid: Solid, points: Points, paths: Floats, radius: float) -> list[Squeezed]:
    """Equilibria of a solid whose points stick to spheres that go along paths (steps, s, 3) m.

    A point that comes to lie inside a sphere is tied to the nearest place on it, and let go once it would be pulled.
    One entry a step; ends at the first at which no equilibrium is found.
    """
    rest, weights = points
    owner = np.full(len(rest), -1)
    place = np.zeros_like(rest)  # on the owner's surface, from its centre
    moved = np.zeros_like(solid.nodes)
    held = Held(solid, solid.factor(moved), points)
    found: list[Squeezed] = []
    for centres in paths:
        settled, iterations = False, 0
        push = np.zeros_like(rest)
        for _ in range(MOST_ROUNDS):
            stuck = owner >= 0
            tied = csr_array(weights[stuck])
            solid.ties = math.sqrt(TIE) * tied
            wanted = centres[owner[stuck]] + place[stuck] - rest[stuck]
            load, precondition = tied.T @ (TIE * wanted), held.tied(np.flatnonzero(stuck))
            moved, converged, used = solid.follow(moved, load, precondition, TOLERANCE)
            iterations += used
            push[:] = 0.0
            push[stuck] = TIE * (wanted - tied @ moved)
            away = (rest + weights @ moved)[:, None] - centres
            gap = np.linalg.norm(away, axis=2) - radius
            pulled = stuck & (np.einsum("kx,kx->k", push, place) < 0.0)
            nearest = gap.argmin(axis=1)
            entered = ~stuck & (gap.min(axis=1) < -ENTERED)
            settled = converged and not pulled.any() and not entered.any()
            if settled or not converged:
                break
            owner[pulled] = -1
            owner[entered] = nearest[entered]
            way = away[entered, nearest[entered]]
            place[entered] = radius * way / np.linalg.norm(way, axis=1)[:, None]
        forces = np.array([push[owner == sphere].sum(axis=0) for sphere in range(len(centres))])
        least = solid.energy(moved)[2]
        found.append(Squeezed(moved, forces, np.flatnonzero(owner >= 0), least, settled))
        if not settled:
            break
        if iterations > WORN:
            held = held.anew(moved)
    solid.ties = None
    return found
