"""Rigid spheres pressed into a finite-element solid, which doesn't slip along them: force against depth."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, vstack

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.solid import Solid

TIE = 2000.0  # N/m, by which a touching point is held to its place on the sphere: 10 um under 20 mN
ENTERED = 1e-6  # m inside a sphere
MOST_ROUNDS = 12  # of finding out which points touch, at one depth


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


def organ_points(body: Body, near: Ints) -> Points:
    """Contact points as the model has them: the organ's nodes, and the middles of edges and triangles near (t, 3).

    A force on an organ's node is a traction around it, as for all loads; so the node goes where that traction does
    its work, by the mean of what it acts on.
    """
    organ = body.organ
    edges = np.unique(np.sort(near[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2), axis=0)
    means = []
    for group in (np.unique(near)[:, None], edges, near):
        count, size = group.shape
        rows = np.repeat(np.arange(count), size)
        values = np.full(group.size, 1.0 / size)
        means.append(csr_array((values, (rows, group.ravel())), shape=(count, organ.n_surface)))
    mean = csr_array(vstack(means))
    return Points(mean @ organ.surface_positions, csr_array(mean @ body.load_matrix.T))


def squeezed(solid: Solid, points: Points, paths: Floats, radius: float) -> list[Squeezed]:
    """Equilibria of a solid whose points stick to spheres that go along paths (steps, s, 3) m.

    A point that comes to lie inside a sphere is tied to the nearest place on it, and let go once it would be pulled.
    One entry a step; ends at the first at which no equilibrium is found.
    """
    rest, weights = points
    owner = np.full(len(rest), -1)
    place = np.zeros_like(rest)  # on the owner's surface, from its centre
    moved = np.zeros_like(solid.nodes)
    found: list[Squeezed] = []
    for centres in paths:
        settled = False
        push = np.zeros_like(rest)
        for _ in range(MOST_ROUNDS):
            stuck = owner >= 0
            tied = csr_array(weights[stuck])
            solid.ties = math.sqrt(TIE) * tied
            wanted = centres[owner[stuck]] + place[stuck] - rest[stuck]
            moved, converged = solid.follow(moved, tied.T @ (TIE * wanted))
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
    solid.ties = None
    return found
