"""Centreline by distance mapping (Wan & Liang 2002), with medial atoms spaced evenly along it and its branches.

Every inner voxel has its exact distance from the boundary (DFB). A tree grows from the voxel of largest DFB over the
26-neighbour graph, always to the reachable voxel of largest DFB, keeping each voxel's parent; where loops of the organ
touch, a thin cut keeps it from closing a ring. The tips are the two inner voxels farthest from each other along paths
inside, unless a branch's tip makes a longer centreline. The path between them that prefers large DFB is trimmed at the
tips, centred between voxels, smoothed and resampled by arc length. Branches: `skeleton_tree`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_smoothing_spline
from scipy.ndimage import distance_transform_edt, gaussian_filter, gaussian_filter1d, map_coordinates
from scipy.spatial import cKDTree
from skimage.measure import euler_number

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.directions import across
from tissue_sim.errors import UserError
from tissue_sim.organ.polyline import arc_length
from tissue_sim.organ.skeletons.atom_placement import place_atoms
from tissue_sim.organ.skeletons.skeleton_tree import Limb, Line, find_limbs, join, longest_chain, path_between
from tissue_sim.organ.skeletons.voxel_tree import approach, grow_tree, middle_path
from tissue_sim.organ.surfaces.solid_ball import flip_simple
from tissue_sim.organ.surfaces.surface import Wall

BRANCHES = ("auto", "none")

_MOST_VOXELS = 6e5  # inside that the tree is grown over; of more, every second (third ...) along each axis
_GROWTH = 0.4  # the centreline starts where its radius grows by less than this per length: 1 on a tip's own axis
_THINNEST = 0.35  # and where the radius is this fraction of the side's median
_FINGER = 4.0  # radii along which a finger, thinner than that, grows by less than
_FINGER_GROWTH = 1.5
_LONGEST_TRIM = 0.75  # fraction of either side that may be trimmed: a ball keeps a short centreline
_CENTRING_STEPS = 8
_WINDOW = 0.5  # radii that a centring step looks around
_DISC = 9  # samples across that window
_PLATEAU = 0.05  # radii of distance to the wall over which the weight falls by e


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Medial atoms as a chain, or a tree where the organ branches.

    Attributes
    ----------
    positions : Floats, shape (a, 3), mm
        Atoms on the wall's grid.
    radius : Floats, shape (a,), mm
        Distance to the wall.
    parent : Ints, shape (a,)
        Neighbour towards the root, an earlier atom; -1 at the root, which is the first; i - 1 in a chain.
    length : float, mm
        Length of all centrelines.
    branch : Ints, shape (a,)
        Segment between junctions and tips that each atom belongs to; a junction's atom belongs to the one towards the
        root.
    branches : int
        Number of segments, 1 for a chain.
    """

    positions: Floats
    radius: Floats
    parent: Ints
    length: float
    branch: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    branches: int = 1


def check_atoms(atoms: int) -> None:
    """Check the number of atoms.

    Parameters
    ----------
    atoms : int
        The number.

    Raises
    ------
    UserError
        When it is less than 1.
    """
    if atoms < 1:
        raise UserError(f"--atoms {atoms} is too few; use 1 or more")


def extract(wall: Wall, atoms: int, branches: str = "auto") -> Skeleton:
    """Return medial atoms inside the wall, evenly spaced by arc length: a chain, or a tree.

    Parameters
    ----------
    wall : Wall
        The wall.
    atoms : int
        Number of atoms.
    branches : str, optional
        `auto` follows branches that are long and round enough (`skeleton_tree`), `none` gives a chain.

    Raises
    ------
    UserError
        For an unknown choice, fewer atoms than 1 or than the branches need, and an organ too small for its grid.

    References
    ----------
    Wan & Liang 2002: Automatic 3-D virtual camera path by distance-mapping.
    """
    check_atoms(atoms)
    if branches not in BRANCHES:
        raise UserError(f"--branches {branches} is unknown; use {' or '.join(BRANCHES)}")
    wall, corner = _cropped(wall)
    inside = wall.level < 0.0
    depth = distance_transform_edt(inside) - 0.5
    if depth.max() < 1.5:
        raise UserError("the organ is under four voxels thick, too thin for a skeleton; use a finer image")
    stride = int(np.ceil(np.cbrt(np.count_nonzero(inside) / _MOST_VOXELS)))
    coarse = _without_handles(_thinned_out(depth, stride))
    parent, order = grow_tree(coarse.ravel(), np.array(coarse.shape))
    chain = _chain(coarse, parent, order)
    limbs = find_limbs(coarse, parent, order, chain, _inner_end)
    if limbs:
        chain = _longest(coarse, parent, chain, limbs)
        limbs = find_limbs(coarse, parent, order, chain, _inner_end) if branches == "auto" else []
    h, step = wall.spacing, wall.spacing * stride
    deep = gaussian_filter(np.where(inside, depth, 0.0), 0.7).astype(np.float32) * np.float32(h)
    path = _places(middle_path(coarse.ravel(), np.array(coarse.shape), chain[0], chain[-1]), coarse.shape) * step
    first, last = _trimmed(path, _sample(deep, path, h))
    path = path[first:last]
    lines = [Line(_middle(path, deep, h))]
    for limb in limbs:
        own = float(np.median(limb.thickness[-8:])) * step
        line = join(lines, _middle(limb.path * step, deep, h), own, limb.centre * step, limb.reach * step)
        lines.append(_kept_inside(line, wall, coarse, step))
    if atoms == 1 and not limbs:
        positions, length = path[[int(_sample(deep, path, h).argmax())]], float(arc_length(lines[0].points)[-1])
        above, branch, count = np.full(1, -1, dtype=np.int32), np.zeros(1, dtype=np.int32), 1
    else:
        tree = place_atoms(lines, atoms)
        positions, above, branch, count, length = tree.positions, tree.parent, tree.branch, tree.branches, tree.length
    if np.any(wall.sample(positions) >= 0.0):
        raise UserError("the skeleton leaves the organ; use a finer image or a smoother mask")
    radius, _ = cKDTree(wall.points()).query(positions)
    return Skeleton(positions + corner, radius, above, length, branch, count)


def _kept_inside(line: Line, wall: Wall, coarse: Floats, step: float) -> Line:
    """Return the line with a path to its junction inside, where the straight one from its limb leaves the organ."""
    first, second = line.points[:2]
    if np.all(wall.sample(first + np.linspace(0.0, 1.0, 16)[:, None] * (second - first)) < 0.0):
        return line
    shape = np.array(coarse.shape)
    index = np.clip(np.rint(line.points[:2] / step).astype(np.int64)[:, ::-1], 0, shape - 1)
    ends = np.ravel_multi_index((index[:, 0], index[:, 1], index[:, 2]), coarse.shape)
    path = _places(middle_path(coarse.ravel(), shape, int(ends[0]), int(ends[1])), coarse.shape) * step
    return replace(line, points=np.concatenate([first[None], path[1:-1], line.points[1:]]))


def _cropped(wall: Wall) -> tuple[Wall, Floats]:
    """Return the wall with little more of its grid than the organ, and the new grid's first voxel (3,) mm."""
    box = []
    for axis in range(3):
        used = np.flatnonzero((wall.level < 0.0).any(axis=tuple({0, 1, 2} - {axis})))
        if not len(used):
            raise UserError("the wall encloses no voxel; use a finer image")
        box.append(slice(max(int(used[0]) - 2, 0), int(used[-1]) + 3))
    corner = np.array([s.start for s in box[::-1]], dtype=np.float64) * wall.spacing
    level = np.ascontiguousarray(wall.level[tuple(box)])
    return replace(wall, level=level, origin=wall.origin + wall.direction @ corner), corner


def _thinned_out(depth: Floats, stride: int) -> Floats:
    """Return the depth at every stride-th voxel, in voxels of that coarser grid."""
    if stride == 1:
        return depth
    return np.ascontiguousarray((depth[::stride, ::stride, ::stride] + 0.5) / stride - 0.5)


def _without_handles(depth: Floats) -> Floats:
    """Return the depth (nz, ny, nx) voxels, zero in one thin cut through each handle, at its thinnest place.

    Paths inside then don't take a short cut where neighbouring loops of an organ touch.
    """
    inside = depth > 0.0
    if euler_number(inside, connectivity=1) == 1:
        return np.ascontiguousarray(depth, dtype=np.float64)
    grown = np.zeros(depth.shape, dtype=np.uint8)
    grown[np.unravel_index(int(depth.argmax()), depth.shape)] = 1
    flip_simple(grown, inside, depth, 1)
    return np.where(grown == 1, depth, 0.0)


def _chain(coarse: Floats, parent: Longs, order: Longs) -> Longs:
    """Return the tree's path between the two voxels farthest from each other inside: indices, from tip to tip."""
    reached = order[order >= 0]
    first = _farthest(coarse, reached, int(order[0]))
    return path_between(parent, first, _farthest(coarse, reached, first))


def _longest(coarse: Floats, parent: Longs, chain: Longs, limbs: list[Limb]) -> Longs:
    """Return the tree's path between those two tips, of the chain and its branches, with the longest centreline.

    A wide pocket's far corner can be farther than the tip of a branch with the longer centreline.
    """
    first, last = _trimmed(_places(chain, coarse.shape), coarse.ravel()[chain])
    tips = [chain[0], chain[-1], *(limb.tip for limb in limbs)]
    starts = [chain[first], chain[last - 1], *(limb.start for limb in limbs)]
    return longest_chain(parent, coarse.shape, np.array(tips), np.array(starts))


def _farthest(coarse: Floats, reached: Longs, source: int) -> int:
    """Return the reached voxel with the longest path inside from the source."""
    distance = np.full(coarse.size, np.inf)
    nearest = np.full(coarse.size, -1, dtype=np.int64)
    approach(coarse.ravel(), np.array(coarse.shape), np.array([source]), distance, nearest)
    return int(reached[distance[reached].argmax()])


def _places(chain: Longs, shape: tuple[int, ...]) -> Floats:
    """Return voxel coordinates (m, 3), order x, y, z, of indices."""
    return np.stack(np.unravel_index(chain, shape), axis=1)[:, ::-1].astype(np.float64)


def _middle(path: Floats, field: NDArray[np.float32], h: float) -> Floats:
    """Return the path smoothed and centred between voxels."""
    return _smooth(_centre(_smooth(path, field, h), field, h), field, h)


def _sample(field: NDArray[np.float32], points: Floats, h: float) -> Floats:
    return map_coordinates(field, points.T[::-1] / h, output=np.float64, order=1, mode="nearest")


def _trimmed(path: Floats, radius: Floats) -> tuple[int, int]:
    """Return the first and one past the last point where the path runs along the organ, not from a tip's corner."""
    root = int(radius.argmax())
    first = _inner_end(path[: root + 1], radius[: root + 1])
    last = _inner_end(path[root:][::-1], radius[root:][::-1])
    return first, len(path) - last


def _inner_end(side: Floats, radius: Floats) -> int:
    """Return the first point, from a side's tip, where the radius grows slowly and is thick enough, or a finger's.

    A finger is thin, but stays as thin along several radii.
    """
    arc = arc_length(side)
    voxel = arc[-1] / max(len(arc), 2)
    ahead = arc + np.maximum(0.5 * radius, voxel)
    growth = (np.interp(ahead, arc, radius) - radius) / (ahead - arc)
    finger = (np.interp(arc + _FINGER * radius, arc, radius) < _FINGER_GROWTH * radius) & (radius >= 0.8 * voxel)
    fit = (growth < _GROWTH) & ((radius >= _THINNEST * np.median(radius)) | finger)
    return int(np.flatnonzero(fit | (arc > _LONGEST_TRIM * arc[-1]))[0]) if arc[-1] > 0.0 else 0


def _smooth(path: Floats, field: NDArray[np.float32], h: float) -> Floats:
    """Return a smoothing spline along the path; stiffer for a thick organ, softer where that would leave it."""
    if len(path) < 8:
        return path
    arc = arc_length(path)
    keep = np.concatenate([[True], np.diff(arc) > 1e-9])
    arc, path = arc[keep], path[keep]
    scale = max(float(np.median(_sample(field, path, h))), 2.0 * h)
    t = np.linspace(0.0, arc[-1], max(int(2.0 * arc[-1] / h), 16))
    even = np.stack([np.interp(t, arc, path[:, k]) for k in range(3)], axis=1)
    least = 0.9 * min(float(_sample(field, even, h).min()), h)
    for fraction in (0.35, 0.2, 0.1, 0.05):
        stiffness = (fraction * scale) ** 4 / (t[1] - t[0])
        line = np.stack([make_smoothing_spline(t, even[:, k], lam=stiffness)(t) for k in range(3)], axis=1)
        if np.all(_sample(field, line, h) > least):
            return line
    return even


def _centre(line: Floats, field: NDArray[np.float32], h: float) -> Floats:
    """Return the line moved across its direction to where the distance to the wall is largest.

    The mean place over a small disc across the line, with weights that fall with the distance to the wall: on a sharp
    ridge that is the ridge, on a flat one its middle.
    """
    line = line.copy()
    grid = np.linspace(-1.0, 1.0, _DISC)
    u, v = (g.ravel() for g in np.meshgrid(grid, grid))
    u, v = u[u * u + v * v <= 1.01], v[u * u + v * v <= 1.01]
    for _ in range(_CENTRING_STEPS):
        along = np.gradient(line, axis=0)
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
        first, second = across(along)
        radius = np.maximum(_sample(field, line, h), h)
        offset = _WINDOW * radius[:, None, None] * (first[:, None] * u[:, None] + second[:, None] * v[:, None])
        depth = _sample(field, (line[:, None] + offset).reshape(-1, 3), h).reshape(len(line), -1)
        weight = np.exp((depth - depth.max(axis=1, keepdims=True)) / (_PLATEAU * radius[:, None]))
        move = np.einsum("ij,ijk->ik", weight, offset) / weight.sum(axis=1, keepdims=True)
        # Neighbours move together, since the line would otherwise fold where it turns into a branch.
        apart = float(arc_length(line)[-1]) / max(len(line) - 1, 1)
        if apart > 0.0:
            move = gaussian_filter1d(move, 0.5 * float(np.median(radius)) / apart, axis=0, mode="nearest")
        length = np.linalg.norm(move, axis=1, keepdims=True)
        line += move * np.minimum(1.0, h / np.maximum(length, 1e-12))
    return line
