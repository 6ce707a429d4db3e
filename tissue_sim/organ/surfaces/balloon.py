"""Balloon: a closed triangle surface of N points and 2N - 4 triangles that expands to an organ's wall.

Mitchell (1997) as used by Zhang, Gu et al. (2006), section 2: f_i = k_t sum_j (x_j - x_i) + k_p n_i; a move that would
leave the organ is bisected. A fold of the wall that the expanding surface would meet from both sides (a deep hilum) is
closed at first and entered by shrinking. While the surface grows, points move from crowded to stretched places and
edges flip, so that long and hollow organs get even triangles too. Then points are added or removed up to N, and laid on
the sub-voxel wall.

Folds that neither expansion nor shrinking enters (deep and narrow) are reached from the other side: the wall's own
marching cubes surface is thinned to N points. `Balloon.expanded` says which of the two was used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import ConvexHull

from tissue_sim.array_types import Floats, Ints, Singles
from tissue_sim.errors import UserError
from tissue_sim.jit import kernel
from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.surface_checks import signed_volume
from tissue_sim.organ.surfaces.fitting import RATIO, Finished, bring_to, finish, fit, flip, mean_edge, sample
from tissue_sim.organ.surfaces.marching_cubes import marching_cubes_surface
from tissue_sim.organ.surfaces.surface import Wall, closed_wall, intersecting_pairs
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface
from tissue_sim.organ.surfaces.transport import transport

Progress = Callable[[float], None]

FEWEST_POINTS = 50
_EXPANDING = 1000  # points; the others come or go at the wall
_CRUMPLED = 0.01  # of the points: with more intersecting pairs of triangles, the surface doesn't disentangle any more
_SETTLED = 5e-4  # fraction of the volume gained in a round of steps, at which the expansion ends
_ROUND = 15  # steps between two looks at the volume
_DETAIL = 0.5  # edge lengths: narrower folds are closed while the balloon moves
# Expansions tried until the wall is reached: folds narrower than this many organ depths are closed at first.
_CLOSINGS = (0.0, 0.5, 1.0)
# After that the wall itself is thinned, folds narrower than this many edge lengths closed for good.
_DETAILS = (0.0, 0.5, 1.0, 2.0)
# Hausdorff distance from the wall at which nothing else is tried: voxels, or edge lengths of a coarse surface, whose
# flat triangles lie that far off a round wall without leaving out a fold.
_NEAR, _FLAT = 1.5, 0.4


@dataclass(frozen=True)
class BalloonParameters:
    """Forces per step in voxels of the wall's grid, and numbers of steps."""

    tension: float = 0.05  # k_t, per step
    pressure: float = 0.7  # k_p, voxels per step
    steps: int = 2000  # at most
    fitting: int = 60  # tangential relaxation steps on the wall


@dataclass(frozen=True, eq=False)
class Balloon:
    """Result of the expansion.

    Attributes
    ----------
    positions : Floats, shape (n, 3), mm
        Points on the wall's grid.
    triangles : Ints, shape (2 n - 4, 3)
        Corner indices, outward.
    missed : float, mm
        Largest distance from the wall to the surface; much more than a voxel means a fold of the wall that the balloon
        didn't enter.
    expanded : bool
        True if expanded from inside; False if thinned from the wall's own surface, because the expansion left a fold
        out.
    warnings : tuple[str, ...]
        Regularity that wasn't reached, one line each.
    """

    positions: Floats
    triangles: Ints
    missed: float
    expanded: bool = True
    warnings: tuple[str, ...] = ()

    @property
    def edge(self) -> float:
        """Mean edge length, mm."""
        return mean_edge(self.positions, self.triangles)


def check_points(points: int) -> None:
    """Check the number of surface points.

    Parameters
    ----------
    points : int
        The number.

    Raises
    ------
    UserError
        When it is less than 50.
    """
    if points < FEWEST_POINTS:
        raise UserError(f"--points {points} is too few for an organ; use {FEWEST_POINTS} or more")


def inflate(
    wall: Wall, points: int, parameters: BalloonParameters | None = None, progress: Progress | None = None
) -> Balloon:
    """Return a surface of exactly `points` points on the wall, closed and free of folds.

    Parameters
    ----------
    wall : Wall
        The wall.
    points : int
        Number of points.
    parameters : BalloonParameters | None, optional
        Forces and steps; None for the usual ones.
    progress : Progress | None, optional
        Called with the fraction done, 0 to 1, never falling.

    Raises
    ------
    UserError
        For fewer than 50 points, and where no surface without self-intersection is found.

    References
    ----------
    Mitchell 1997; Zhang, Gu et al. 2006, section 2.
    """
    check_points(points)
    p = parameters or BalloonParameters()
    rising = _Rising(progress)
    reference = marching_cubes_surface(wall)
    best: Finished | None = None
    for start in _starts(wall, points, p, rising):
        found = finish(start.positions, start.triangles, start.wall, reference, p.fitting)
        # What expanded comes first and is preferred: the wall's own surface must come clearly nearer.
        if found is not None and (best is None or found.better_than(best, 0.9)):
            best, expanded = found, start.expanded
        if best is None or best.warnings:
            continue
        near = max(_NEAR * wall.spacing, _FLAT * mean_edge(best.positions, best.triangles))
        if best.hausdorff <= near or not start.expanded:
            break  # closing folds would only lead away from the wall
    rising(1.0)
    if best is not None:
        return Balloon(best.positions, best.triangles, best.missed, expanded, best.warnings)
    raise UserError(
        f"the balloon of {points} points intersects itself on this organ; try more --points, or a smoother mask"
    )


class _Rising:
    """Progress callback that passes on only fractions larger than those before."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress, self._last = progress, -1.0

    def __call__(self, fraction: float) -> None:
        if self._progress is not None and fraction > self._last:
            self._last = fraction
            self._progress(fraction)


@dataclass(frozen=True, eq=False)
class _Start:
    """Surface of the wanted number of points near the wall, and the wall to lay it on."""

    positions: Floats
    triangles: Ints
    wall: Wall
    expanded: bool


def _starts(wall: Wall, points: int, p: BalloonParameters, rising: Progress) -> Iterator[_Start]:
    """Yield expansions that reach the wall everywhere, then the thinned wall, then expansions that left a fold out."""
    edge = float(np.sqrt(4.0 / np.sqrt(3.0) * wall.area() / (2 * points - 4)))
    closed = closed_wall(wall, _DETAIL * edge) or wall
    late: list[_Start] = []
    for k, closing in enumerate(_CLOSINGS):
        moved = _inflate(closed, _EXPANDING, closing, p, _Part(rising, 0.25 * k, 0.25 * k + 0.2))
        if moved is None or len(intersecting_pairs(*moved)) > _CRUMPLED * _EXPANDING:
            continue
        brought = bring_to(*moved, closed, points)
        if brought is None:
            continue
        if distance_to_surface(closed.points(), *brought).max() < edge:
            yield _Start(*brought, wall, True)
        late.append(_Start(*brought, closed, True))
    rising(0.8)
    for detail in _DETAILS:
        shown = closed_wall(wall, detail * edge) if detail > 0.0 else wall
        brought = bring_to(*marching_cubes_surface(shown), shown, points) if shown is not None else None
        if brought is not None and shown is not None:
            yield _Start(*brought, shown, False)
    yield from late


class _Part:
    """Progress callback that maps 0..1 to a part of the whole."""

    def __init__(self, whole: Progress, start: float, end: float) -> None:
        self._whole, self._start, self._end = whole, start, end

    def __call__(self, fraction: float) -> None:
        self._whole(self._start + min(max(fraction, 0.0), 1.0) * (self._end - self._start))


def _inflate(
    wall: Wall, points: int, closing: float, p: BalloonParameters, rising: Progress
) -> tuple[Floats, Ints] | None:
    """Return the balloon on the wall; first in the organ closed by `closing` times its depth. None for a ring."""
    depth = distance_transform_edt(wall.level < 0.0)
    centre = np.array(np.unravel_index(int(depth.argmax()), depth.shape))[::-1] * wall.spacing
    deepest = float(depth.max()) * wall.spacing
    positions, triangles = fibonacci_sphere(points)
    positions = centre + 0.6 * deepest * positions
    outer = closed_wall(wall, closing * deepest, smooth=False) if closing > 0.0 else wall
    if outer is None:
        return None
    _move_to_wall(positions, triangles, outer, p, +1.0, rising)
    if closing > 0.0:
        fit(positions, triangles, outer, p.fitting // 3)
        _move_to_wall(positions, triangles, wall, p, -1.0, rising)
    return positions, triangles


def _move_to_wall(
    positions: Floats, triangles: Ints, wall: Wall, p: BalloonParameters, sign: float, rising: Progress
) -> None:
    """Expand inside the organ (sign +1), or shrink around it (-1), until the volume settles; in place."""
    points, h = len(positions), wall.spacing
    level = np.ascontiguousarray(sign * wall.level, dtype=np.float32)
    whole = float(np.count_nonzero(wall.level < 0.0)) * h**3
    volume = signed_volume(positions, triangles)
    for step in range(1, p.steps + 1):
        forces = p.tension, sign * p.pressure * h
        expand(positions, triangles, surface_normals(positions, triangles), level, h, forces)
        if step % 3 == 0:
            transport(positions, triangles, RATIO, max(points // 25, 1))
            flip(positions, triangles)
        if step % _ROUND == 0:
            before, volume = volume, signed_volume(positions, triangles)
            rising(volume / whole)
            if abs(volume - before) < _SETTLED * volume:
                return


def fibonacci_sphere(points: int) -> tuple[Floats, Ints]:
    """Return a unit sphere of evenly spread points; its convex hull has 2 points - 4 triangles, outward."""
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


@kernel
def expand(
    positions: Floats,
    triangles: Ints,
    normal: Floats,
    level: Singles,
    h: float,
    forces: tuple[float, float],
) -> None:
    """Do one step of the balloon's forces, in place.

    level: allowed where it is 0 or less, on a grid of h mm; forces: tension without unit, and pressure in mm per step
    along the normals (n, 3). A move that would leave the organ is halved up to three times, then tried along the
    surface only, so that points at the wall still slide.
    """
    n = positions.shape[0]
    tension, pressure = forces
    force = pressure * normal
    for t in range(triangles.shape[0]):
        for k in range(3):
            i, j = triangles[t, k], triangles[t, (k + 1) % 3]
            for m in range(3):
                force[i, m] += tension * (positions[j, m] - positions[i, m])
    for i in range(n):
        fx, fy, fz = force[i, 0], force[i, 1], force[i, 2]
        for attempt in range(2):
            if attempt == 1:
                across = fx * normal[i, 0] + fy * normal[i, 1] + fz * normal[i, 2]
                fx, fy, fz = fx - across * normal[i, 0], fy - across * normal[i, 1], fz - across * normal[i, 2]
            length = np.sqrt(fx * fx + fy * fy + fz * fz)
            scale = min(1.0, h / length) if length > 0.0 else 0.0
            moved = False
            for _ in range(4):
                x, y, z = positions[i, 0] + scale * fx, positions[i, 1] + scale * fy, positions[i, 2] + scale * fz
                if sample(level, h, x, y, z) <= 0.0:
                    positions[i, 0], positions[i, 1], positions[i, 2] = x, y, z
                    moved = True
                    break
                scale *= 0.5
            if moved:
                break
