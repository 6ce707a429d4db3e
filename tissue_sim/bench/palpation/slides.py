"""Balls that slide over an organ at constant depth: the mesh causes a ripple of their force.

A ball keeps its depth in the facets where they lie at rest. Friction carries these along, so that it is too deep
over one facet and not deep enough over the next: with friction, the facets themselves cause a ripple, which finer
meshes of the same facets have as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.calibration.cases import surface_of
from tissue_sim.contact.scene import Scene
from tissue_sim.identification.places import AROUND, PressPoint
from tissue_sim.identification.pressing import ball
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface
from tissue_sim.organ.tool_resolution import mean_edge

FRICTIONS = 0.6, 0.0  # of a sliding ball: the node's default, and none
SLID_DEPTH = 0.5  # radii
RUN_IN, SLID_LENGTH = 1.0, 3.0  # edges that are slid before the force counts, and while it does
SLIDING, ENTERING = 0.01, 0.02  # m/s
OUTSIDE, PAUSE = 0.0005, 0.2  # m before it enters, s before it slides
KNOTS, ROUNDS = 25, 4  # of a track on an edge; of finding its distance


class SlidingPress(NamedTuple):
    """Results of a ball that slides over a point."""

    radius: float  # mean edges
    place: int
    friction: float
    force: float  # N, along the normal, in the mean
    ripple: float  # % of that
    carried: float  # m, by which the surface is carried along


class Track(NamedTuple):
    """Path of the centre of a sliding ball: m along, (k,); places (k, 3) m and outward normals (k, 3)."""

    along: Floats
    centres: Floats
    normals: Floats

    def at(self, along: Floats) -> tuple[Floats, Floats]:
        """Return places (n, 3) m and normals (n, 3) between the track's own."""
        found = [[np.interp(along, self.along, column) for column in of.T] for of in (self.centres, self.normals)]
        return np.transpose(found[0]), np.transpose(found[1])


def track_over(organ: Organ, spot: PressPoint, radius: float) -> Track:
    """Return the track over a spot on which a ball, its radius in m, lies SLID_DEPTH deep in the surface at rest.

    It follows a quadric through the nodes around, at a constant distance from the triangles: on a smooth track the ball
    would feel the shape of the facets, which finite elements have, too.
    """
    surface, edge, out = surface_of(organ), mean_edge(organ), -spot.direction
    sideways = np.cross(out, [0.3, 1.0, 0.1])  # no axis, which rows of a mesh might follow
    sideways /= np.linalg.norm(sideways)
    frame = np.array([sideways, np.cross(out, sideways), out])
    near = np.linalg.norm(surface.positions - spot.point, axis=1) < AROUND * edge
    near &= surface.normal @ out > 0.5
    x, y, z = ((surface.positions[near] - spot.point) @ frame.T).T
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    level, slope, tilt, bend, twist, _ = np.linalg.lstsq(basis, z, rcond=None)[0]
    along = np.linspace(-RUN_IN - 0.5 * SLID_LENGTH, 0.5 * SLID_LENGTH, round(KNOTS * (RUN_IN + SLID_LENGTH))) * edge
    rise = np.stack([-slope - 2.0 * bend * along, -tilt - twist * along, np.ones_like(along)], axis=1)
    normals = rise @ frame / np.linalg.norm(rise, axis=1)[:, None]
    feet = np.stack([along, np.zeros_like(along), level + slope * along + bend * along**2], axis=1)
    wanted = (1.0 - SLID_DEPTH) * radius
    centres = spot.point + feet @ frame + wanted * normals
    for _ in range(ROUNDS):
        distance = distance_to_surface(centres, organ.surface_positions, organ.surface_triangles)
        centres = centres + (wanted - distance)[:, None] * normals
    return Track(along, centres, normals)


def slides(organ: Organ, radii: Sequence[float], places: Sequence[Sequence[PressPoint]]) -> Iterable[SlidingPress]:
    """Yield the forces of balls that slide over the middle of each place, with every friction; radii: mean edges."""
    edge = mean_edge(organ)
    with progress.task("slides", len(radii) * len(FRICTIONS) * len(places)) as under_way:
        for radius in radii:
            for friction in FRICTIONS:
                scene = ball(organ, radius * edge, friction)
                for spots in places:
                    over = spots[-1]
                    found = slide(scene, track_over(organ, over, radius * edge))
                    carried = float(np.linalg.norm(found.carried - (found.carried @ over.direction) * over.direction))
                    yield SlidingPress(
                        radius, over.place, friction, float(found.force.mean()), ripple(found.force), carried
                    )
                    under_way.advance()


class Slide(NamedTuple):
    """Force and carried distance along a track, after the run-in of a slide."""

    force: Floats  # (k,) N along the normal, at each tick
    carried: Floats  # (3,) m, by which the tissue that touches is displaced, in the mean of its force


def slide(scene: Scene, track: Track) -> Slide:
    """Let a ball enter, and slide on a track."""
    scene.reset()
    tick, (begin, end) = scene.simulation.settings.tick_time, track.along[[0, -1]]

    def force_at(centre: Floats, normal: Floats) -> float:
        scene.move(0, centre)
        scene.step()
        return float(scene.wrenches[0, :3] @ normal)

    first, normal = track.centres[0], track.normals[0]
    above = SLID_DEPTH * scene.tools.tools[0].radius + OUTSIDE
    for higher in np.linspace(above, 0.0, max(2, round(above / (ENTERING * tick)))):
        force_at(first + higher * normal, normal)
    for _ in range(round(PAUSE / tick)):
        force_at(first, normal)
    along = np.linspace(begin, end, max(2, round((end - begin) / (SLIDING * tick))))
    force, carried = [], []
    for place, one in zip(along, zip(*track.at(along), strict=True), strict=True):
        now = force_at(*one)
        if place >= begin + RUN_IN / (RUN_IN + SLID_LENGTH) * (end - begin):
            force.append(now)
            carried.append(displaced(scene))
    return Slide(np.array(force), np.mean(carried, axis=0))


def displaced(scene: Scene) -> Floats:
    """Return how far the tissue that touches the ball is from rest, (3,) m, in the mean of its force."""
    simulation = scene.simulation
    contacts = simulation.state.contacts
    points = contacts.header.points
    pressed = simulation.state.contact_pressed[0, :points]
    moved = (simulation.positions - simulation.model.rest)[contacts.node[:points]]
    whole = np.einsum("k,kc,kcx->x", pressed, contacts.weight[:points], moved)
    return np.asarray(whole / max(float(pressed.sum()), np.finfo(np.float64).tiny))


def ripple(force: Floats) -> float:
    """Return half the range of a force (k,) N about a parabola along the track, % of its mean.

    The parabola is the organ's: over a few edges its shape and its clamp change the force smoothly.
    """
    along = np.linspace(-1.0, 1.0, len(force))
    trend = np.polynomial.Polynomial.fit(along, force, 2)
    return float(50.0 * np.ptp(force - trend(along)) / force.mean())
