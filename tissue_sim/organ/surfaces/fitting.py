"""Fitting of a triangle surface evenly and closely to a wall: relaxation, flips, point transport, least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Ints
from tissue_sim.jit import kernel
from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.surfaces.remesh import flip_edges
from tissue_sim.organ.surfaces.resample import thicken, thin_out
from tissue_sim.organ.surfaces.sizing import mean_edge, spread
from tissue_sim.organ.surfaces.surface import Wall, corner_angles, intersecting_pairs
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface
from tissue_sim.organ.surfaces.transport import relax, relax_sized, transport, transport_sized

RATIO = 2.0  # a long edge is split when it is this many times a short one
VARIATION = 0.25  # standard deviation of the edge lengths over their mean, at most
LEAST_ANGLE = 20.0  # degrees
_FRACTION = 0.12  # fraction of the points that a pass of thinning removes, or adds
_CLOSEST = 12  # steps of least squares
_ROUNDS = 8  # of refinement
_VAIN = 4  # rounds without a better surface, after which refinement ends
_CLOSE = 1.25  # voxels: Hausdorff distance at which refinement ends
_REACH = 1.25  # edge lengths: a surface further away than this has left out a fold
_AIM = 0.3  # voxels: distance from the wall at which refinement leaves the edges as they are
_SIZES = (0.5, 1.3)  # least and largest edge length wanted, of the mean
# Places in a triangle where its distance from the wall is looked at, with weights of a composite rule by area.
_PLACES = np.array(
    [[i / 4.0, j / 4.0, (4 - i - j) / 4.0] for i in range(5) for j in range(5 - i) if max(i, j, 4 - i - j) < 4]
)


def flip(positions: Floats, triangles: Ints) -> None:
    """Flip edges towards Delaunay until nothing changes, at most five passes; in place.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    """
    for _ in range(5):
        if flip_edges(positions, triangles) == 0:
            return


def fit(positions: Floats, triangles: Ints, wall: Wall, steps: int) -> None:
    """Lay the points evenly on the wall: relax along the surface, project, flip, move points; in place.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    wall : Wall
        The wall.
    steps : int
        Number of steps.
    """
    n = len(positions)
    for step in range(steps):
        if step < steps // 2 and step % 4 == 0:
            transport(positions, triangles, RATIO, max(n // 50, 1))
        flip(positions, triangles)
        relax(positions, triangles, 0.4)
        positions[:] = wall.project(positions, 1 if step < steps - 1 else 4)


def settle(positions: Floats, triangles: Ints, wall: Wall, steps: int = _CLOSEST, size: Floats | None = None) -> None:
    """Shift the points along the normals so that the flat triangles, not the points, lie on the wall; in place.

    Least squares of the triangles' signed distances, by area, with lumped weights; between two shifts the points relax
    along the surface. Points on a round wall would give a polyhedron inside it.
    """
    size = np.ones(len(positions)) if size is None else size
    reach = 1.5 * float(np.sqrt(4.0 / np.sqrt(3.0) * wall.area() / len(triangles)))
    for step in range(steps):
        if step < steps // 2:
            relax_sized(positions, triangles, 0.2, size)
            flip(positions, triangles)
        normal = surface_normals(positions, triangles)
        positions += normal * _shift(positions, triangles, wall.level, wall.spacing, _PLACES, reach)[:, None]


@dataclass(frozen=True, eq=False)
class Finished:
    """Surface on the wall.

    Attributes
    ----------
    positions : Floats, shape (n, 3), mm
        Points.
    triangles : Ints, shape (2 n - 4, 3)
        Corner indices, outward.
    missed : float, mm
        Largest distance from the wall to the surface.
    hausdorff : float, mm
        Largest distance in either direction.
    warnings : tuple[str, ...]
        Regularity that wasn't reached.
    """

    positions: Floats
    triangles: Ints
    missed: float
    hausdorff: float
    warnings: tuple[str, ...]

    def better_than(self, other: Finished, fraction: float = 1.0) -> bool:
        """Return whether it has no warnings where the other has, or as good and within `fraction` of its distance."""
        if bool(self.warnings) != bool(other.warnings):
            return not self.warnings
        return self.hausdorff < fraction * other.hausdorff


def finish(
    positions: Floats, triangles: Ints, wall: Wall, reference: tuple[Floats, Ints], fitting: int = 60
) -> Finished | None:
    """Return the surface laid on the wall as closely as even triangles allow.

    Where the surface stays further away than about a voxel, points move there from flat places, as long as the edges'
    variation allows.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    wall : Wall
        The wall.
    reference : tuple[Floats, Ints]
        Marching cubes surface from which distances are taken.
    fitting : int, optional
        Steps of relaxation on the wall.

    Returns
    -------
    Finished | None
        The new surface; None where it intersects itself.
    """
    p, t, size = positions.copy(), triangles.copy(), np.ones(len(positions))
    fit(p, t, wall, fitting)
    best: Finished | None = None
    vain = 0
    for attempt in range(_ROUNDS + 1):
        if attempt > 0:
            refine(p, t, size, wall, reference)
        laid = p.copy(), t.copy()
        settle(*laid, wall, size=size.copy())
        # In a slit the shift to the mean can push one side through the other; points on the wall don't.
        found = _judged(*laid, reference) or _judged(p.copy(), t.copy(), reference)
        much_better = found is not None and (best is None or found.better_than(best, 0.97))
        vain = 0 if much_better else vain + 1
        if found is not None and (best is None or found.better_than(best)):
            best = found
        if vain == _VAIN or (best is not None and not best.warnings and best.hausdorff <= _CLOSE * wall.spacing):
            break
        if attempt == 0 and found is not None and found.hausdorff > max(_REACH * mean_edge(p, t), 2.0 * wall.spacing):
            break  # a fold is left out, and points that travel can't enter it
        if attempt == 1 and best is None:
            break
        if attempt > 0 and found is not None and found.warnings:
            size[:] = np.sqrt(size)
    return best


def _judged(positions: Floats, triangles: Ints, reference: tuple[Floats, Ints]) -> Finished | None:
    """Return the surface with its distances and warnings; None if it intersects itself."""
    if len(intersecting_pairs(positions, triangles)):
        return None
    edges = positions[triangles] - positions[np.roll(triangles, 1, axis=1)]
    length = np.linalg.norm(edges, axis=2)
    variation = float(length.std() / length.mean())
    angle = float(np.rad2deg(corner_angles(positions, triangles).min()))
    warnings = []
    if variation > VARIATION:
        warnings.append(f"edge lengths vary by {variation:.2f} of their mean, more than {VARIATION:g}")
    if angle < LEAST_ANGLE:
        warnings.append(f"a triangle has an angle of {angle:.0f} degrees, less than {LEAST_ANGLE:g}")
    missed = float(distance_to_surface(reference[0], positions, triangles).max())
    corner = positions[triangles]
    probes = np.concatenate([corner.mean(axis=1), (0.5 * (corner + np.roll(corner, 1, axis=1))).reshape(-1, 3)])
    beyond = float(distance_to_surface(np.concatenate([positions, probes]), *reference).max())
    return Finished(positions, triangles, missed, max(missed, beyond), tuple(warnings))


def refine(positions: Floats, triangles: Ints, size: Floats, wall: Wall, reference: tuple[Floats, Ints]) -> None:
    """Move the points to where the surface is far from the wall; `size` (n,) are the wanted relative edge lengths.

    reference: the wall's marching cubes surface. All three arrays are changed in place.
    """
    n = len(positions)
    aim = _AIM * wall.spacing
    far = distance_to_surface(reference[0], positions, triangles)
    _, nearest = cKDTree(positions).query(reference[0])
    worst = np.zeros(n)
    np.maximum.at(worst, nearest, far)
    size *= np.clip(np.sqrt(aim / np.maximum(worst, 1e-9)), 0.75, 1.1)
    size[:] = np.clip(spread(size, triangles, 3), *_SIZES)
    size /= size.mean()
    for step in range(16):
        if step % 2 == 0:
            transport_sized(positions, triangles, 1.8, max(n // 50, 1), size)
        flip(positions, triangles)
        relax_sized(positions, triangles, 0.4, size)
        positions[:] = wall.project(positions, 1)


def bring_to(positions: Floats, triangles: Ints, wall: Wall, points: int) -> tuple[Floats, Ints] | None:
    """Return a closed surface near the wall brought to a number of points, by a few collapses or splits at a time.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    wall : Wall
        The wall.
    points : int
        Wanted number of points.

    Returns
    -------
    tuple[Floats, Ints] | None
        Points and triangles; None where the surface isn't a sphere or can't be brought to that number.
    """
    if len(triangles) != 2 * len(positions) - 4:
        return None
    positions, triangles = positions.copy(), np.ascontiguousarray(triangles)
    while len(positions) != points:
        n = len(positions)
        if n > points:
            positions, triangles = thin_out(positions, triangles, min(n - points, max(int(_FRACTION * n), 1)))
        else:
            positions, triangles = thicken(positions, triangles, min(points - n, max(int(_FRACTION * n), 1)))
        if len(positions) == n:
            return None
        for _ in range(2):
            flip(positions, triangles)
            relax(positions, triangles, 0.4)
            positions[:] = wall.project(positions, 1)
    return positions, triangles


@kernel
def sample(level, h, x, y, z):  # type: ignore[no-untyped-def]
    """Return the trilinear level at a point, mm; 1e9 outside the grid.

    Parameters
    ----------
    level : shape (nz, ny, nx), mm
        Signed distance, negative inside.
    h : mm
        Spacing of the grid.
    x, y, z : mm
        Coordinates on the grid.
    """
    nz, ny, nx = level.shape
    u, v, w = x / h, y / h, z / h
    if u < 0.0 or v < 0.0 or w < 0.0 or u > nx - 1.0 or v > ny - 1.0 or w > nz - 1.0:
        return 1e9
    i, j, k = min(int(u), nx - 2), min(int(v), ny - 2), min(int(w), nz - 2)
    u, v, w = u - i, v - j, w - k
    low = (level[k, j, i] * (1 - u) + level[k, j, i + 1] * u) * (1 - v)
    low += (level[k, j + 1, i] * (1 - u) + level[k, j + 1, i + 1] * u) * v
    high = (level[k + 1, j, i] * (1 - u) + level[k + 1, j, i + 1] * u) * (1 - v)
    high += (level[k + 1, j + 1, i] * (1 - u) + level[k + 1, j + 1, i + 1] * u) * v
    return low * (1 - w) + high * w


@kernel
def _shift(positions, triangles, level, h, places, reach):  # type: ignore[no-untyped-def]
    """Return the step (n,) along the normals: minus the mean distance, within `reach`, of the triangles around."""
    total = np.zeros(positions.shape[0])
    weight = np.zeros(positions.shape[0])
    for t in range(triangles.shape[0]):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        a, b, c = positions[i], positions[j], positions[k]
        u, v = b - a, c - a
        area = np.sqrt(
            (u[1] * v[2] - u[2] * v[1]) ** 2 + (u[2] * v[0] - u[0] * v[2]) ** 2 + (u[0] * v[1] - u[1] * v[0]) ** 2
        )
        for m in range(places.shape[0]):
            p, q, r = places[m, 0], places[m, 1], places[m, 2]
            x = p * a + q * b + r * c
            d = min(max(sample(level, h, x[0], x[1], x[2]), -reach), reach) * area
            total[i] += p * d
            total[j] += q * d
            total[k] += r * d
            weight[i] += p * area
            weight[j] += q * area
            weight[k] += r * area
    for i in range(total.shape[0]):
        total[i] = -total[i] / weight[i] if weight[i] > 0.0 else 0.0
    return total
