"""Measures of closed triangle surfaces: regularity, self-intersection, and the distance between two of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.organ.edges import directed_edges
from tissue_sim.organ.normals import triangle_area
from tissue_sim.organ.surface_checks import signed_volume
from tissue_sim.organ.surfaces.intersections import intersecting_pairs
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface

_SAMPLES = 40_000  # on each surface


@dataclass(frozen=True)
class SurfaceComparison:
    """Distances between a surface and a reference; lengths in the unit of the positions."""

    hausdorff: float  # symmetric: the largest distance from either to the other
    mean: float  # symmetric: mean of the two mean distances, each by area
    volume_ratio: float  # enclosed by the surface, over the reference's


def compare(reference: tuple[Floats, Ints], surface: tuple[Floats, Ints]) -> SurfaceComparison:
    """Return the distances between two closed surfaces.

    They are measured from each surface's corners and area-weighted samples to the exact nearest point of the other. The
    samples are spread by a fixed sequence, so the same surfaces give the same figures.

    Parameters
    ----------
    reference : tuple[Floats, Ints]
        Points, shape (n, 3), and outward triangles, shape (t, 3).
    surface : tuple[Floats, Ints]
        Points and outward triangles.

    References
    ----------
    Cignoni, Rocchini & Scopigno 1998: Metro, measuring error on simplified surfaces.
    """
    largest, means = [], []
    for one, other in ((reference, surface), (surface, reference)):
        far = distance_to_surface(_samples(*one), *other)
        means.append(float(far.mean()))
        largest.append(max(float(far.max()), float(distance_to_surface(one[0], *other).max())))
    ratio = signed_volume(*surface) / signed_volume(*reference)
    return SurfaceComparison(max(largest), 0.5 * sum(means), float(ratio))


def _samples(positions: Floats, triangles: Ints, count: int = _SAMPLES) -> Floats:
    """Return points (count, 3) spread by area: even steps through the summed areas, a low-discrepancy place in each."""
    corner = positions[triangles]
    area = triangle_area(positions, triangles)
    total = np.cumsum(area)
    k = np.arange(count)
    chosen = np.minimum(np.searchsorted(total, (k + 0.5) / count * total[-1]), len(area) - 1)
    # The R2 sequence (Roberts 2018), folded from the square onto the triangle.
    u, v = np.modf(0.5 + 0.7548776662466927 * k)[0], np.modf(0.5 + 0.5698402909980532 * k)[0]
    over = u + v > 1.0
    u, v = np.where(over, 1.0 - u, u)[:, None], np.where(over, 1.0 - v, v)[:, None]
    a, b, c = (corner[chosen, m] for m in range(3))
    return a + u * (b - a) + v * (c - a)


@dataclass(frozen=True)
class SurfaceQuality:
    """Measures of a closed triangle surface; lengths in the unit of its positions."""

    euler: int  # 2 for genus 0
    open_edges: int
    edge_mean: float
    edge_variation: float  # standard deviation over mean
    least_angle: float  # degrees
    volume: float
    self_intersections: int  # pairs of triangles


def measure(positions: Floats, triangles: Ints) -> SurfaceQuality:
    """Return the measures of a surface.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    """
    edges = np.sort(directed_edges(triangles), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    length = np.linalg.norm(positions[unique[:, 0]] - positions[unique[:, 1]], axis=1)
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    return SurfaceQuality(
        euler=len(np.unique(triangles)) - len(unique) + len(triangles),
        open_edges=int(np.count_nonzero(count != 2)),
        edge_mean=float(length.mean()),
        edge_variation=float(length.std() / length.mean()),
        least_angle=float(np.rad2deg(corner_angles(positions, triangles).min())),
        volume=float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0),
        self_intersections=len(intersecting_pairs(positions, triangles)),
    )


def corner_angles(positions: Floats, triangles: Ints) -> Floats:
    """Return the three angles of every triangle.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    Floats, shape (t, 3), rad
        Angles.
    """
    corner = positions[triangles]
    u = np.roll(corner, -1, axis=1) - corner
    v = np.roll(corner, -2, axis=1) - corner
    return np.arctan2(np.linalg.norm(np.cross(u, v), axis=2), np.einsum("ijk,ijk->ij", u, v))
