"""Where an organ's surface needs shorter edges: where the body is thin, near its clamp, and where it is touched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Ints
from tissue_sim.organ.edges import directed_edges
from tissue_sim.organ.normals import triangle_area
from tissue_sim.organ.surface_checks import signed_volume
from tissue_sim.organ.surfaces.sizing import GROWTH, Wanted, distance_to_line, local_edges, thickness
from tissue_sim.organ.tool_resolution import relative_size

if TYPE_CHECKING:
    from tissue_sim.organ.imaging.image import Volume

# Of the thickness: edges wanted where the body is thin. Of surfaces with 0.35, calibrated ones of a vein and of an
# aneurysm were off by 11 and 12 % at worst.
THROUGH = 0.28
BESIDE = 0.6  # of the distance from the clamp's edge: edges wanted near it
HELD = 1.5  # of the distance from the clamp's edge, on the side that is held: nothing moves there
NEAREST = 0.009  # m from the clamp's edge, nearer to which edges need not become shorter, in an organ like a kidney
HINGE = 0.18  # of the thickness at the clamp's edge, where a slender body bends as at a hinge: edges as short as that
SHORTEST = 0.4  # of the edges that there were: a rim may be as thin as it likes
TOUCHED = 0.5  # of the edges that there were: wanted at places that are named without an edge


@dataclass(frozen=True, eq=False)
class Ball:
    """Refine within a ball: centre (3,) m, radius m, edge m, or None for half of the edges that there were."""

    centre: Floats
    radius: float
    edge: float | None = None


@dataclass(frozen=True, eq=False)
class Along:
    """Refine around a polyline, such as a cut's: points (m, 3) m, radius m, edge m, or None for half of those there."""

    points: Floats
    radius: float
    edge: float | None = None


@dataclass(frozen=True, eq=False)
class Painted:
    """Refine within a mask: edge m, or None for half of the edges that there were."""

    mask: Volume
    edge: float | None = None


@dataclass(frozen=True)
class Refinement:
    """Where edges are to be shorter: where the body is thin, near the clamp's edge, and at named places."""

    thin: bool = False
    clamp: bool = False
    places: tuple[Ball | Along | Painted, ...] = ()

    def __bool__(self) -> bool:
        return self.thin or self.clamp or bool(self.places)


def wanted_edges(
    refinement: Refinement, positions: Floats, triangles: Ints, fixed: Ints, closer: float = 1.0
) -> Wanted:
    """Return a function from points (n, 3) m to the edge lengths wanted there, (n,) m; infinite where none are.

    Parameters
    ----------
    refinement : where edges are to be shorter
    positions : surface nodes, evenly spaced, (n, 3) m
    triangles : outward, (t, 3)
    fixed : nodes that are held
    closer : how many times as close points are to be as those, before they are refined

    """
    edge = float(local_edges(positions, triangles).mean()) / closer
    parts: list[Wanted] = []
    if refinement.thin:
        parts.append(_by_thickness(positions, triangles, SHORTEST * edge))
    if refinement.clamp and len(fixed):
        parts.append(_by_clamp(positions, triangles, fixed))
    for place in refinement.places:
        shortest = place.edge or TOUCHED * edge
        if isinstance(place, Painted):
            parts.append(_in_mask(place.mask, shortest))
        else:
            points = place.centre[None] if isinstance(place, Ball) else place.points
            parts.append(_around(points, place.radius, shortest))

    def wanted(points: Floats) -> Floats:
        found = np.full(len(points), np.inf)
        for part in parts:
            found = np.minimum(found, part(points))
        return found

    return wanted


def _by_thickness(positions: Floats, triangles: Ints, shortest: float) -> Wanted:
    size = np.maximum(THROUGH * thickness(positions, triangles), shortest)
    tree = cKDTree(positions)
    edge = float(local_edges(positions, triangles).mean())
    for _ in range(8):  # edges grow by so much with the distance, around what is thin
        apart, near = tree.query(positions, k=min(9, len(positions)))
        size = np.minimum(size, (size[near] + GROWTH * apart).min(axis=1))

    def wanted(points: Floats) -> Floats:
        apart, near = tree.query(points, k=3)
        weight = 1.0 / np.maximum(apart, 1e-3 * edge)
        found: Floats = (weight * np.minimum(size[near], 10.0 * edge)).sum(axis=1) / weight.sum(axis=1)
        return found

    return wanted


def _by_clamp(positions: Floats, triangles: Ints, fixed: Ints) -> Wanted:
    rim, nodes = cKDTree(clamp_rim(positions, triangles, fixed)), cKDTree(positions)
    through = np.partition(thickness(positions, triangles)[nodes.query(rim.data)[1]], rim.n // 2)[rim.n // 2]
    shortest = min(BESIDE * NEAREST * relative_size(signed_volume(positions, triangles)), HINGE * float(through))
    slope = np.full(len(positions), BESIDE)
    slope[fixed] = HELD

    def wanted(points: Floats) -> Floats:
        found: Floats = np.maximum(slope[nodes.query(points)[1]] * rim.query(points)[0], shortest)
        return found

    return wanted


def clamp_rim(positions: Floats, triangles: Ints, fixed: Ints) -> Floats:
    """Return the middles (k, 3) m of the edges between held and free nodes; the held nodes where there are none."""
    held = np.zeros(len(positions), dtype=bool)
    held[fixed] = True
    edges = directed_edges(triangles)
    edges = edges[held[edges[:, 0]] & ~held[edges[:, 1]]]
    found: Floats = positions[edges].mean(axis=1) if len(edges) else positions[fixed]
    return found


def points_with(refinement: Refinement, positions: Floats, triangles: Ints, fixed: Ints, closer: float = 1.0) -> int:
    """Return about how many points an even surface would have if it were refined.

    Parameters
    ----------
    refinement : where edges are to be shorter
    positions : surface nodes, (n, 3) m
    triangles : outward, (t, 3)
    fixed : nodes that are held
    closer : how many times as close points are to be as those, before they are refined

    """
    wanted = wanted_edges(refinement, positions, triangles, fixed, closer)
    # At the middles of triangles too: a place may be smaller than the edges that there are.
    corner = positions[triangles]
    places = np.concatenate([corner.mean(axis=1, keepdims=True), corner], axis=1)
    size = wanted(places.reshape(-1, 3)).reshape(len(triangles), 4)
    length = local_edges(positions, triangles)[triangles].mean(axis=1, keepdims=True) / closer
    times = np.maximum(length / size, 1.0)
    area = triangle_area(positions, triangles)
    return round(len(positions) * closer**2 * float((area * (times**2).mean(axis=1)).sum() / area.sum()))


def _around(line: Floats, radius: float, shortest: float) -> Wanted:
    def wanted(points: Floats) -> Floats:
        return shortest + GROWTH * np.maximum(distance_to_line(points, line) - radius, 0.0)

    return wanted


def _in_mask(mask: Volume, shortest: float) -> Wanted:
    outside = 1e-3 * ndimage.distance_transform_edt(~mask.array, mask.spacing[::-1])

    def wanted(points: Floats) -> Floats:
        index = mask.to_index(1e3 * points)
        inner = np.clip(index, 0, np.array(mask.size) - 1)
        beyond = 1e-3 * np.linalg.norm((index - inner) * mask.spacing, axis=1)  # m, of points outside the image
        far = ndimage.map_coordinates(outside, inner[:, ::-1].T, order=1, mode="nearest")
        return shortest + GROWTH * (far + beyond)

    return wanted
