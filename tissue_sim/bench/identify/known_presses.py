"""Presses of a finger by this package's finite elements at places of an organ, over its inclusions and elsewhere."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim import progress
from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench.palpation.presses import THROUGH, by_elements
from tissue_sim.calibration.cases import surface_of
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.errors import UserError
from tissue_sim.identification.places import PressPoint, clear_of_clamp, thickness
from tissue_sim.organ.inclusions import existing_inclusions
from tissue_sim.organ.organ import Organ
from tissue_sim.result_cache import remembered, user_cache

FINGER = 0.007  # m, radius
DEEP = np.array([0.0005, 0.001, 0.0015, 0.002, 0.003, 0.004])  # m, at which finite elements are solved
CLEAR = 4.0  # edges from the clamp
OVER, AROUND = 7, 0.022  # places over an inclusion, within m from the one nearest to its middle
ELSEWHERE = 5


def places_with(organ: Organ) -> list[PressPoint]:
    """Return places at nodes: OVER over the organ's first inclusion, then ELSEWHERE others, far from each other.

    Raises UserError for an organ without an inclusion.
    """
    inclusions = existing_inclusions(organ)
    surface, deepest = surface_of(organ), float(DEEP[-1])
    free = clear_of_clamp(organ, surface.positions, CLEAR)
    apart = np.linalg.norm(surface.positions - inclusions[0].positions.mean(axis=0), axis=1)
    nearest = int(np.where(free, apart, np.inf).argmin())
    near = np.linalg.norm(surface.positions - surface.positions[nearest], axis=1) < AROUND

    def spot(node: int) -> PressPoint:
        return PressPoint(node, "node", surface.positions[node], -surface.normal[node])

    thick = np.array([free[node] and thickness(organ, spot(node)) > deepest / THROUGH for node in range(len(free))])
    chosen = _far_apart(surface.positions, np.flatnonzero(thick & near), [nearest], OVER)
    chosen = _far_apart(surface.positions, np.flatnonzero(thick & ~near), chosen, OVER + ELSEWHERE)
    return [spot(node) for node in chosen]


def _far_apart(positions: Floats, candidates: Longs, chosen: list[int], count: int) -> list[int]:
    """Return chosen nodes and further ones, each the farthest from those before."""
    found = list(chosen)
    while len(found) < min(count, len(chosen) + len(candidates)):
        apart = cKDTree(positions[found]).query(positions[candidates])[0]
        found.append(int(candidates[apart.argmax()]))
    return found


def forces_by_elements(organ: Organ, spots: list[PressPoint], kind: str) -> Floats:
    """Return the forces (n, d) N of finite elements at spots; nan where they don't settle.

    They take minutes, and are kept in the user's cache, each as it comes.
    """

    def make() -> dict[str, Floats]:
        kept = Checkpoint(user_cache() / f".{kind}-{organ.digest()[:24]}", {"organ": organ.digest(), "kind": kind})

        def one(spot: PressPoint) -> Floats:
            name = " ".join(f"{value:.9g}" for value in (*spot.point, *spot.direction))
            return kept.remember(name, lambda: {"force": by_elements(organ, [spot], FINGER, DEEP)[0]})["force"]

        solved = np.array([one(spot) for spot in progress.steps(spots, "finite elements")])
        kept.remove()
        return {"force": solved}

    found = remembered(kind, organ.digest(), make)["force"]
    if len(found) != len(spots):
        raise UserError(f"{user_cache()} holds other presses of organ '{organ.name}'; remove {kind}-*.npz there")
    return found
