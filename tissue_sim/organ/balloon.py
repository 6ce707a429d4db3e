"""Balloon: a closed triangle surface of N points and 2N - 4 triangles that expands to an organ's wall.

Mitchell (1997) as used by Zhang, Gu et al. (2006), section 2: f_i = k_t sum_j (x_j - x_i) + k_p n_i; a move
that would leave the organ is bisected. A fold of the wall that the expanding surface would meet from both
sides (a deep hilum) is closed at first and entered by shrinking. While the surface grows, points travel from crowded to
stretched places and edges flip, so that long and hollow organs get even triangles too. At the end the
points are laid on the sub-voxel wall.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt
from scipy.spatial import ConvexHull, cKDTree

from tissue_sim.errors import UserError
from tissue_sim.organ.organ import signed_volume
from tissue_sim.organ.remesh import flip_edges, relax, transport, vertex_normals
from tissue_sim.organ.surface import Wall, closed_wall, intersecting_pairs

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

FEWEST_POINTS = 50
_RATIO = 2.0  # a long edge is split when it is this many times a short one
_SETTLED = 5e-4  # share of the volume gained in a round of steps at which the expansion ends
_ROUND = 15  # steps between two looks at the volume
# Tried until nothing folds and the wall is reached: folds narrower than the first number of edge lengths are closed
# for good, those narrower than the second number of organ depths at first only.
_TRIES = ((0.5, 0.0), (0.5, 0.5), (0.5, 1.0), (0.75, 0.5), (1.0, 0.5), (1.5, 0.5), (1.5, 1.0), (2.0, 2.0))


@dataclass(frozen=True)
class BalloonParameters:
    """Forces per step in voxels of the wall's grid, and numbers of steps."""

    tension: float = 0.05  # k_t, per step
    pressure: float = 0.7  # k_p, voxels per step
    steps: int = 2000  # at most
    fitting: int = 60  # tangential relaxation steps on the wall


@dataclass(frozen=True, eq=False)
class Balloon:
    """positions (n, 3) mm on the wall's grid, outward triangles (2 n - 4, 3).

    missed mm: largest distance from the wall to the nearest corner or middle of a triangle or edge; more
    than an edge's length means a fold of the wall that the balloon didn't enter.
    """

    positions: Floats
    triangles: Ints
    missed: float

    @property
    def edge(self) -> float:
        """Mean edge length, mm."""
        t = self.triangles
        sides = self.positions[t] - self.positions[np.roll(t, 1, axis=1)]
        return float(np.linalg.norm(sides, axis=2).mean())


def check_points(points: int) -> None:
    """Raise UserError for fewer than 50 points."""
    if points < FEWEST_POINTS:
        raise UserError(f"--points {points} is too few for an organ; use {FEWEST_POINTS} or more")


def inflate(wall: Wall, points: int, parameters: BalloonParameters | None = None) -> Balloon:
    """Surface of exactly `points` points and 2 points - 4 triangles on the wall, closed and free of folds.

    Raises UserError for fewer than 50 points, or when no surface without self-intersection is found.
    """
    check_points(points)
    p = parameters or BalloonParameters()
    edge = np.sqrt(4.0 / np.sqrt(3.0) * wall.area() / (2 * points - 4))
    best: Balloon | None = None
    for detail, closing in _TRIES:
        shown = closed_wall(wall, detail * edge) or wall
        found = _inflate(shown, points, closing, p)
        if found is None or len(intersecting_pairs(*found)):
            continue
        positions, triangles = found
        _match_volume(positions, triangles, shown)
        missed = _farthest_from(positions, triangles, wall)
        if best is None or missed < 0.9 * best.missed:
            best = Balloon(positions, triangles, missed)
        if _farthest_from(positions, triangles, shown) < edge:
            return best
    if best is not None:
        return best
    raise UserError(
        f"the balloon of {points} points folds over itself on this organ; try more --points, or a smoother mask"
    )


def _farthest_from(positions: Floats, triangles: Ints, wall: Wall) -> float:
    """Largest distance, mm, from the wall to a point of the surface: has the balloon been everywhere?"""
    inside = wall.level < 0.0
    rim = np.argwhere(inside & ~binary_erosion(inside))[:, ::-1] * wall.spacing
    corner = positions[triangles]
    middles = 0.5 * (corner + np.roll(corner, 1, axis=1))
    probes = np.concatenate([positions, corner.mean(axis=1), middles.reshape(-1, 3)])
    return float(cKDTree(probes).query(rim)[0].max())


def _inflate(wall: Wall, points: int, closing: float, p: BalloonParameters) -> tuple[Floats, Ints] | None:
    """Balloon on the wall; first in the organ closed by `closing` times its depth. None where that makes a ring."""
    depth = distance_transform_edt(wall.level < 0.0)
    centre = np.array(np.unravel_index(int(depth.argmax()), depth.shape))[::-1] * wall.spacing
    deepest = float(depth.max()) * wall.spacing
    positions, triangles = fibonacci_sphere(points)
    positions = centre + 0.6 * deepest * positions
    outer = closed_wall(wall, closing * deepest) if closing > 0.0 else wall
    if outer is None:
        return None
    _move_to_wall(positions, triangles, outer, p, +1.0)
    if closing > 0.0:
        _fit(positions, triangles, outer, p.fitting // 3)
        _move_to_wall(positions, triangles, wall, p, -1.0)
    _fit(positions, triangles, wall, p.fitting)
    return positions, triangles


def _move_to_wall(positions: Floats, triangles: Ints, wall: Wall, p: BalloonParameters, sign: float) -> None:
    """Expand inside the organ (sign +1), or shrink around it (-1), until the volume settles. In place."""
    points, h = len(positions), wall.spacing
    level = np.ascontiguousarray(sign * wall.level, dtype=np.float32)
    volume = signed_volume(positions, triangles)
    for step in range(1, p.steps + 1):
        expand(positions, triangles, vertex_normals(positions, triangles), level, h, p.tension, sign * p.pressure * h)
        if step % 3 == 0:
            transport(positions, triangles, _RATIO, max(points // 25, 1))
            _flip(positions, triangles)
        if step % _ROUND == 0:
            before, volume = volume, signed_volume(positions, triangles)
            if abs(volume - before) < _SETTLED * volume:
                return


def fibonacci_sphere(points: int) -> tuple[Floats, Ints]:
    """Unit sphere of any number of evenly spread points; its convex hull has 2 points - 4 triangles, outward."""
    k = np.arange(points) + 0.5
    z = 1.0 - 2.0 * k / points
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z * z)
    positions = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    triangles = ConvexHull(positions).simplices.astype(np.int32)
    a, b, c = (positions[triangles[:, m]] for m in range(3))
    inward = np.einsum("ij,ij->i", a, np.cross(b - a, c - a)) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    return positions, np.ascontiguousarray(triangles)


def _flip(positions: Floats, triangles: Ints) -> None:
    for _ in range(5):
        if flip_edges(positions, triangles) == 0:
            return


def _fit(positions: Floats, triangles: Ints, wall: Wall, steps: int) -> None:
    """Lay the points on the wall, evenly: relax along the surface, project, flip; match the volume at the end."""
    n = len(positions)
    for step in range(steps):
        if step < steps // 2 and step % 4 == 0:
            transport(positions, triangles, _RATIO, max(n // 50, 1))
        _flip(positions, triangles)
        relax(positions, triangles, 0.4)
        positions[:] = wall.project(positions, 1 if step < steps - 1 else 4)


def _match_volume(positions: Floats, triangles: Ints, wall: Wall) -> None:
    """Shift the points along the wall's normal so that flat triangles enclose what the wall does.

    Points on a round wall make a polyhedron inside it; the shift is a small part of a voxel.
    """
    inside = np.clip(0.5 - wall.level / wall.spacing, 0.0, 1.0)
    wanted = float(inside.sum(dtype=np.float64)) * wall.spacing**3
    gradient = wall.gradient(positions)
    normal = gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-9)
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
    shift = (wanted - signed_volume(positions, triangles)) / area
    positions += normal * float(np.clip(shift, -0.5 * wall.spacing, 0.5 * wall.spacing))


@njit(cache=True)
def sample(level, h, x, y, z):  # type: ignore[no-untyped-def]
    """Trilinear level at a point, mm; far outside counts as outside."""
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


@njit(cache=True)
def expand(
    positions: Floats,
    triangles: Ints,
    normal: Floats,
    level: NDArray[np.float32],
    h: float,
    tension: float,
    pressure: float,
) -> None:
    """One step of the balloon's forces, in place.

    normal (n, 3): of the points; level: allowed where it is 0 or less; pressure in mm a step, tension without
    unit. A move that would leave the organ is halved up to three times, then tried along the surface only, so
    that points at the wall still slide.
    """
    n = positions.shape[0]
    force = pressure * normal
    for t in range(triangles.shape[0]):
        for k in range(3):
            i, j = triangles[t, k], triangles[t, (k + 1) % 3]
            force[i] += tension * (positions[j] - positions[i])
    for i in range(n):
        f = force[i]
        for attempt in range(2):
            if attempt == 1:
                f = f - normal[i] * (f * normal[i]).sum()
            length = np.sqrt((f**2).sum())
            scale = min(1.0, h / length) if length > 0.0 else 0.0
            moved = False
            for _ in range(4):
                x = positions[i] + scale * f
                if sample(level, h, x[0], x[1], x[2]) <= 0.0:
                    positions[i] = x
                    moved = True
                    break
                scale *= 0.5
            if moved:
                break
