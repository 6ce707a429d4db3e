"""Balls that are pressed in at places of an organ and don't slip, beside neo-Hookean finite elements of its shape."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import starmap
from typing import NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench.processes import on_all_cores
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.sphere_compression import compressed, own_nodes
from tissue_sim.identification.places import PressPoint, thickness
from tissue_sim.identification.pressing import FRICTION, Press, ball, forces
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.tool_resolution import mean_edge

DEPTHS = np.array([0.3, 0.5, 0.8, 1.0])  # radii
THROUGH = 0.35  # of the organ's thickness there, how deep a ball is pressed at most
STEPS = 2  # of the finite elements for each depth
ACROSS = 1.6  # elements of finite elements on a ball's radius at the least
ELEMENTS = Grading(clamp=0, growth=1.0)  # places lie far from the clamp


class Pressed(NamedTuple):
    """Results of a ball at a spot: radius in mean edges; depths (d,) radii, forces (d,) N, nan where unsettled."""

    radius: float
    place: int
    kind: str
    depths: Floats
    ours: Floats
    reference: Floats

    @property
    def off(self) -> Floats:
        """Difference from the finite elements (d,), %."""
        return np.asarray(100.0 * (self.ours / self.reference - 1.0))


Reference = Callable[[Organ, Sequence[PressPoint], float, Floats], Floats]


def presses(
    organ: Organ, radii: Sequence[float], places: Sequence[Sequence[PressPoint]], reference: Reference | None = None
) -> Iterable[Pressed]:
    """Yield the forces of balls that are pressed in at all spots, beside the reference: finite elements if None.

    radii: mean edges. Raises UserError as Body does.
    """
    edge = mean_edge(organ)
    runs = [(radius, spots, _depths(organ, spots, radius * edge)) for radius in radii for spots in places]
    given = [(organ, spots, radius * edge, radius * edge * depths) for radius, spots, depths in runs]
    wanted = starmap(reference, given) if reference else on_all_cores(by_elements, given)
    balls = {radius: ball(organ, radius * edge, FRICTION) for radius in radii}
    with progress.task("presses", len(radii) * sum(map(len, places))) as under_way:
        for (radius, spots, depths), found in zip(runs, wanted, strict=True):
            for spot, one in zip(spots, found, strict=True):
                press = Press(spot.point - radius * edge * spot.direction, spot.direction)
                ours = forces(balls[radius], press, radius * edge * depths)
                yield Pressed(radius, spot.place, spot.kind, depths, ours, one)
                under_way.advance()


def _depths(organ: Organ, spots: Sequence[PressPoint], radius: float) -> Floats:
    """Return how deep a ball of a radius, m, is pressed in at all spots of a place, (d,) radii."""
    thick = min(thickness(organ, spot) for spot in spots)
    return DEPTHS[radius * DEPTHS <= THROUGH * thick]


def by_elements(organ: Organ, spots: Sequence[PressPoint], radius: float, depths: Floats) -> Floats:
    """Return the force (k, d) N of finite elements on a ball at spots (k,) of one place; nan where none settles.

    radius m; depths (d,) m, of which each is reached in steps. They are touched at all of their own nodes under it.
    """
    edge, middle = mean_edge(organ), np.mean([spot.point for spot in spots], axis=0)
    reach = max(1.1 * radius, 0.9 * edge) + max(np.linalg.norm(spot.point - middle) for spot in spots)
    near = np.linalg.norm(organ.surface_positions - middle, axis=1) < reach
    near[organ.fixed] = False
    fine = max(0, math.ceil(math.log2(ACROSS * edge / radius)))
    body = Body(organ, np.flatnonzero(near), ELEMENTS._replace(near=fine))
    centre = organ.surface_positions[organ.surface_triangles].mean(axis=1)
    found = np.full((len(spots), len(depths)), np.nan)
    deep = np.interp(np.arange(1, STEPS * len(depths) + 1) / STEPS, np.arange(len(depths) + 1), [0.0, *depths])
    for spot, row in zip(spots, found, strict=True):
        under = np.flatnonzero(np.linalg.norm(centre - spot.point, axis=1) < 1.1 * radius + edge)
        nodes = _beneath(body, own_nodes(body, under), spot, radius)
        path = spot.point - radius * spot.direction + deep[:, None] * spot.direction
        steps = compressed(body.solid, nodes, path[:, None], radius)
        for number, step in enumerate(steps[STEPS - 1 :: STEPS]):
            if step.settled:
                row[number] = step.forces[0] @ spot.direction
    return found


def _beneath(body: Body, nodes: Longs, spot: PressPoint, radius: float) -> Longs:
    """Return the nodes that a ball moving straight in can reach: fewer take less time."""
    away = body.solid.nodes[nodes] - spot.point
    beside = np.linalg.norm(away - np.outer(away @ spot.direction, spot.direction), axis=1)
    return nodes[beside < 1.1 * radius]
