"""Rigid spheres pressed into a finite-element solid, which doesn't slip along them: force against depth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.solid import Solid

TIE = 2000.0  # N/m, by which a touching node is held to its place on the sphere: 10 um under 20 mN
ENTERED = 1e-6  # m inside a sphere
MOST_ROUNDS = 12  # of finding out which nodes touch, at one depth


class Squeezed(NamedTuple):
    """A solid between spheres, at rest."""

    displacement: Floats  # (n, 3) m of all nodes
    forces: Floats  # (s, 3) N of the spheres on the solid
    touching: Longs  # nodes that touch
    least_det: float  # det F where the solid is compressed most
    settled: bool


def squeezed(solid: Solid, surface: Longs, paths: Floats, radius: float) -> list[Squeezed]:
    """Equilibria of a solid whose surface nodes (k,) stick to spheres that go along paths (steps, s, 3) m.

    A node that comes to lie inside a sphere is tied to the nearest place on it, and let go once it would be pulled.
    One entry a step; ends at the first at which no equilibrium is found.
    """
    surface = surface[~solid.held[surface].any(axis=1)]
    rest = solid.nodes[surface]
    owner = np.full(len(surface), -1)
    place = np.zeros_like(rest)  # on the owner's surface, from its centre
    moved = np.zeros_like(solid.nodes)
    found: list[Squeezed] = []
    for centres in paths:
        settled = False
        for _ in range(MOST_ROUNDS):
            stuck = owner >= 0
            solid.ties[surface] = np.where(stuck, TIE, 0.0)
            load = np.zeros_like(moved)
            load[surface[stuck]] = TIE * (centres[owner[stuck]] + place[stuck] - rest[stuck])
            moved, converged = solid.follow(moved, load)
            push = load[surface] - solid.ties[surface, None] * moved[surface]
            away = (rest + moved[surface])[:, None] - centres
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
        found.append(Squeezed(moved, forces, surface[owner >= 0], solid.energy(moved)[2], settled))
        if not settled:
            break
    solid.ties[:] = 0.0
    return found
