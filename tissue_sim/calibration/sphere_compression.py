"""Rigid spheres pressed into a finite-element solid, which doesn't slip along them: force against depth."""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.cholesky import NotPositive
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.solid import Solid
from tissue_sim.organ.organ import Organ

FINE = Grading(near=1)  # where an organ may be touched: two nodes on an edge of its surface
TIE = 2000.0  # N/m, holds a touching node to its place on the sphere: 10 um under 20 mN
ENTERED = 1e-6  # m inside a sphere
MOST_ROUNDS = 40  # of determining which nodes touch, at one depth
ROUGH, TOLERANCE = 1e-3, 1e-6  # of the energy: while it is determined which nodes touch, and of the result
HALVINGS = 4  # of a step at whose end no equilibrium is found


class CompressionStep(NamedTuple):
    """Equilibrium of a solid between spheres."""

    displacement: Floats  # (n, 3) m of all nodes
    forces: Floats  # (s, 3) N of the spheres on the solid
    touching: Longs  # nodes that touch
    least_det: float  # det F where the solid is compressed most
    settled: bool


def touchable(organ: Organ, touched: NDArray[np.bool_], grading: Grading = FINE) -> tuple[Solid, Longs]:
    """Return the finite elements of an organ that may be touched around some surface nodes, except where it is held.

    They are fine there, so that contact is that of a sphere.

    Parameters
    ----------
    organ : Organ
        The organ.
    touched : NDArray[np.bool_], shape (n,)
        Surface nodes that may be touched.
    grading : Grading, optional
        Sizes of the elements.

    Returns
    -------
    tuple[Solid, Longs]
        The solid, and those of its nodes that may be touched.

    Raises
    ------
    UserError
        As Body does.
    """
    touched = touched.copy()
    touched[organ.fixed] = False
    body = Body(organ, np.flatnonzero(touched), grading)
    return body.solid, own_nodes(body, np.flatnonzero(touched[organ.surface_triangles].all(axis=1)))


def own_nodes(body: Body, near: Longs) -> Longs:
    """Return the solid's nodes on some of the organ's triangles, which carry the contact.

    Parameters
    ----------
    body : Body
        The finite-element body.
    near : Longs, shape (t,)
        Indices of the triangles.

    Returns
    -------
    Longs
        Node indices, ascending.
    """
    return np.unique(body.filling.facets[np.isin(body.filling.triangle, near)]).astype(np.int64)


def compressed(solid: Solid, nodes: Longs, paths: Floats, radius: float) -> list[CompressionStep]:
    """Return the equilibria of a solid whose nodes stick to spheres that move along paths.

    A node that enters a sphere is tied to the nearest place on it, and released once it would be pulled. The result has
    one entry per step; it ends at the first step at which no equilibrium is found, however short the steps that lead
    there.

    Parameters
    ----------
    solid : Solid
        The solid.
    nodes : Longs, shape (k,)
        Nodes that may be touched.
    paths : Floats, shape (steps, s, 3), m
        Centres of the spheres.
    radius : float, m
        Radius of the spheres.

    Returns
    -------
    list[Squeezed]
        The equilibria.
    """
    run = _Compression(solid, nodes, radius)
    found: list[CompressionStep] = []
    before = paths[0]
    for centres in paths:
        found.append(run.go(before, centres))
        if not found[-1].settled:
            break
        before = centres
    solid.ties = None
    return found


class Tied:
    """Solver for a solid with ties: a factor with earlier ties, and their changes since by Woodbury's formula.

    A tie is so much stiffer than the solid that conjugate gradients would take three iterations for each.
    """

    def __init__(self, solid: Solid) -> None:
        assert solid.ties is not None
        self._solid = solid
        self._take(np.zeros_like(solid.nodes))

    def _take(self, moved: Floats) -> None:
        self._factor, self._ties = self._solid.factor(moved), self._solid.ties
        self._gives: dict[int, Floats] = {}  # compliance of a node, (3n, 3) m/N
        self._changed: Longs = np.zeros(0, dtype=np.int64)

    def renew(self, moved: Floats) -> None:
        """Compute it about a state (n, 3) m; keep the earlier one where that state is unstable."""
        with suppress(NotPositive):
            self._take(moved)

    def retie(self) -> None:
        """Adopt the solid's ties."""
        assert self._solid.ties is not None
        assert self._ties is not None
        change = self._solid.ties - self._ties
        self._changed = np.flatnonzero(change)
        new = [node for node in self._changed.tolist() if node not in self._gives]
        if new:
            pulls = np.zeros((len(change) * 3, 3 * len(new)))
            pulls[_axes(np.array(new)), np.arange(3 * len(new))] = 1.0
            gives = self._factor.precondition(pulls).reshape(-1, len(new), 3)
            self._gives.update((node, gives[:, which]) for which, node in enumerate(new))
        if len(self._changed):
            self._give = np.concatenate([self._gives[node] for node in self._changed.tolist()], axis=1)
            among = self._give[_axes(self._changed)]
            self._small = lu_factor(among + np.diag(1.0 / np.repeat(change[self._changed], 3)))

    def precondition(self, right: Floats) -> Floats:
        """Return displacements (3n, c) m for forces (3n, c) N."""
        moved = self._factor.precondition(right)
        if not len(self._changed):
            return moved
        return np.asarray(moved - self._give @ lu_solve(self._small, moved[_axes(self._changed)]))


def _axes(nodes: Longs) -> Longs:
    """Return the unknowns (3k,) of nodes (k,)."""
    return np.asarray((3 * nodes[:, None] + np.arange(3)).ravel())


class _Compression:
    """Solid that moves with spheres of one radius, m, which touch it at nodes (k,)."""

    def __init__(self, solid: Solid, nodes: Longs, radius: float) -> None:
        self._solid, self._nodes, self._radius = solid, nodes, radius
        self._owner = np.full(len(nodes), -1)  # which sphere holds each
        self._place = np.zeros((len(nodes), 3))  # m from its centre
        self._moved = np.zeros_like(solid.nodes)
        solid.ties = np.zeros(len(solid.nodes))
        self._tied = Tied(solid)

    def go(self, start: Floats, end: Floats) -> CompressionStep:
        """Return the equilibrium after the spheres have moved from centres (s, 3) m to others."""
        at, fraction = 0.0, 1.0
        while True:
            kept = self._owner.copy(), self._place.copy(), self._moved
            wanted = min(1.0, at + fraction)
            settled = self._settle(start + wanted * (end - start))
            if settled:
                at, fraction = wanted, 2.0 * fraction
            elif fraction < 0.5**HALVINGS or np.array_equal(start, end):
                break
            else:
                fraction *= 0.5
                self._owner, self._place, self._moved = kept
            if at >= 1.0:
                break
        return self._found(end, settled)

    def _settle(self, centres: Floats) -> bool:
        """Find the equilibrium for spheres at centres (s, 3) m, from the present state; return whether there is one."""
        solid, nodes = self._solid, self._nodes
        tolerance = ROUGH
        for _ in range(MOST_ROUNDS):
            stuck = self._owner >= 0
            solid.ties = np.zeros(len(solid.nodes))
            solid.ties[nodes[stuck]] = TIE
            load = np.zeros_like(solid.nodes)
            load[nodes[stuck]] = TIE * self._wanted(centres)
            self._tied.retie()
            found = solid.follow(self._moved, load, self._tied, tolerance)
            if not found.converged:
                return False
            self._moved = found.displacement
            changed = self._touch(centres)
            if not changed and tolerance == TOLERANCE:
                return True
            tolerance = ROUGH if changed else TOLERANCE
        return False

    def _wanted(self, centres: Floats) -> Floats:
        """Return the displacements (t, 3) m at which the nodes that touch lie at their places."""
        stuck = self._owner >= 0
        return np.asarray(centres[self._owner[stuck]] + self._place[stuck] - self._solid.nodes[self._nodes[stuck]])

    def _pushes(self, centres: Floats) -> Floats:
        """Return the forces of the spheres on the nodes, (k, 3) N."""
        stuck = self._owner >= 0
        push = np.zeros((len(self._nodes), 3))
        push[stuck] = TIE * (self._wanted(centres) - self._moved[self._nodes[stuck]])
        return push

    def _touch(self, centres: Floats) -> bool:
        """Tie nodes that have entered a sphere, release those that are pulled; return whether there were any."""
        away = (self._solid.nodes[self._nodes] + self._moved[self._nodes])[:, None] - centres
        gap = np.linalg.norm(away, axis=2) - self._radius
        stuck = self._owner >= 0
        pulled = stuck & (np.einsum("kx,kx->k", self._pushes(centres), self._place) < 0.0)
        nearest = gap.argmin(axis=1)
        entered = ~stuck & (gap.min(axis=1) < -ENTERED)
        self._owner[pulled] = -1
        self._owner[entered] = nearest[entered]
        direction = away[entered, nearest[entered]]
        self._place[entered] = self._radius * direction / np.linalg.norm(direction, axis=1)[:, None]
        return bool(pulled.any() or entered.any())

    def _found(self, centres: Floats, settled: bool) -> CompressionStep:
        push = self._pushes(centres)
        forces = np.array([push[self._owner == sphere].sum(axis=0) for sphere in range(len(centres))])
        touching = self._nodes[self._owner >= 0]
        return CompressionStep(self._moved, forces, touching, self._solid.energy(self._moved)[2], settled)
