"""Branches of a skeleton: found in the distance-mapping tree, judged, and joined into a tree of evenly spaced atoms.

Wan & Liang (2002) take the farthest descendants off the centreline as branches and drop the short ones. Here the
voxel farthest past the surface of the skeleton so far (the balls around its voxels) is a candidate's tip, its path in
the distance-mapping tree the candidate. It is a branch where it is long past that surface, long against its own
radius, and round: the ridges that lead from the middle of a flat organ to its rim are not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label, map_coordinates, uniform_filter1d

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.directions import across
from tissue_sim.organ.polyline import arc_length
from tissue_sim.organ.skeletons.voxel_tree import approach

InnerEnd = Callable[[Floats, Floats], int]
_PAST = 1.5  # radii of the parent: least length past its surface, to the branch's own tip
_SLENDER = 2.0  # own radii: least length past the parent's surface, trimmed
_FLAT = 2.5  # largest area of the cross-section, in circles of the branch's radius: 1 is round, an ellipse its aspect
_THINNEST = 1.0  # voxels between middle and wall; thinner is roughness
_PREFILTER = 0.8  # fraction of _PAST from which a candidate is examined: voxel paths are inexact
_TIP = 0.5  # of the median radius: least radius assumed for the thin end of a line
_TRIED = 200  # candidates
_SECTIONS = 9  # cross-sections that judge a branch


@dataclass(frozen=True, eq=False)
class Limb:
    """Branch in voxels.

    Attributes
    ----------
    tip : int
        Index of the voxel at the tip before trimming.
    start : int
        Index of the voxel at the tip after trimming.
    path : Floats, shape (m, 3), x, y, z
        Voxels from the trimmed tip to the parent's surface.
    thickness : Floats, shape (m,)
        Distance to the boundary along the path.
    centre : Floats, shape (3,)
        Centre of the parent's ball that the path runs into.
    reach : float
        Radius of that ball.
    """

    tip: int
    start: int
    path: Floats
    thickness: Floats
    centre: Floats
    reach: float


@dataclass(frozen=True, eq=False)
class Line:
    """Smooth centreline, from its junction (or the root) to its tip.

    Attributes
    ----------
    points : Floats, shape (m, 3), mm
        Points of the line.
    on : int
        Line from which it starts, -1 for the first.
    at : float, mm
        Arc length along that line at the junction.
    radius : float, mm
        Radius at the junction.
    """

    points: Floats
    on: int = -1
    at: float = 0.0
    radius: float = 0.0


@dataclass(frozen=True, eq=False)
class Tree:
    """Atoms of a skeleton with branches.

    Attributes
    ----------
    positions : Floats, shape (a, 3), mm
        Atoms.
    parent : Ints, shape (a,)
        Earlier atom towards the root, or -1.
    branch : Ints, shape (a,)
        Branch of each atom.
    branches : int
        Number of branches.
    length : float, mm
        Length of all lines.
    """

    positions: Floats
    parent: Ints
    branch: Ints
    branches: int
    length: float


def find_limbs(depth: Floats, parent: Longs, order: Longs, chain: Longs, inner_end: InnerEnd) -> list[Limb]:
    """Return the branches off the chain of voxels, longest first.

    Parameters
    ----------
    depth : Floats, shape (nz, ny, nx), voxels
        Distance to the border, positive inside.
    parent : Longs
        Parent of every voxel, of `grow_tree`.
    order : Longs
        Order of growth, of `grow_tree`.
    chain : Longs, shape (m,)
        Voxels of the centreline.
    inner_end : InnerEnd
        Called with a path and its thickness; returns the first point of the path, from its tip, that runs along the
        organ.

    Returns
    -------
    list[Limb]
        The branches.
    """
    shape = np.array(depth.shape)
    flat = np.ascontiguousarray(depth, dtype=np.float64).ravel()
    reached = order[order >= 0]
    up = _rerooted(parent, chain)
    skeleton = np.zeros(flat.size, dtype=bool)
    skeleton[chain] = True
    distance = np.full(flat.size, np.inf)
    nearest = np.full(flat.size, -1, dtype=np.int64)
    approach(flat, shape, np.asarray(chain), distance, nearest)
    # What a candidate must go past: the radius where it starts, on thin tips and on paths that were no branches the
    # radius behind them, so that what is left beside such a path isn't taken for a branch of it.
    behind = np.maximum(flat, _THINNEST)
    behind[chain] = np.maximum(flat[chain], _TIP * np.median(flat[chain]))
    limbs = []
    for _ in range(_TRIED):
        start = nearest[reached]
        past = distance[reached] - flat[start]
        past[past < _PREFILTER * _PAST * behind[start]] = 0.0
        if not past.any():
            break
        path = [int(reached[past.argmax()])]
        while not skeleton[path[-1]]:
            path.append(int(up[path[-1]]))
        ids = np.array(path)
        limb = _judged(depth, ids, np.flatnonzero(skeleton), inner_end)
        if limb is None:
            behind[ids] = np.maximum(flat[ids], behind[ids[-1]])
        else:
            behind[ids] = np.maximum(flat[ids], _TIP * np.median(limb.thickness))
            skeleton[ids] = True
            limbs.append(limb)
        approach(flat, shape, ids, distance, nearest)
    return limbs


def _rerooted(parent: Longs, chain: Longs) -> Longs:
    """Return the tree's parents with the chain as its root: from every voxel up to the chain."""
    top = int(chain[np.flatnonzero(~np.isin(parent[chain], chain))[0]])
    up = parent.copy()
    below, above = top, int(parent[top])
    while above >= 0:
        up[above], below, above = below, above, int(parent[above])
    up[top] = -1
    return up


def _judged(depth: Floats, ids: Longs, skeleton: Longs, inner_end: InnerEnd) -> Limb | None:
    """Return the branch along a path of voxels from a tip to the skeleton; None where it is not one."""
    path, thickness = _places(ids, depth.shape), depth.ravel()[ids]
    middle, reach = _places(skeleton, depth.shape), depth.ravel()[skeleton]
    gap = np.linalg.norm(path[:, None] - middle, axis=2) - reach
    base = int(np.argmax(gap.min(axis=1) <= 0.0))
    if base < 2:
        return None
    ball = int(gap[base].argmin())
    arc = arc_length(path[: base + 1])
    tip = inner_end(path[:base], thickness[:base])
    own = float(np.median(thickness[tip:base]))
    length = float(arc[-1] - arc[tip])
    if own < _THINNEST or length < _SLENDER * own or length + thickness[tip] < _PAST * reach[ball]:
        return None
    if _flatness(depth, path[tip:base], thickness[tip:base]) > _FLAT:
        return None
    return Limb(int(ids[0]), int(ids[tip]), path[tip:base], thickness[tip:base], middle[ball], float(reach[ball]))


def _flatness(depth: Floats, path: Floats, thickness: Floats) -> float:
    """Return the median area of cross-sections, in circles of the path's radius there."""
    found = []
    for k in np.unique(np.linspace(0, len(path) - 1, _SECTIONS).round().astype(int)):
        r = float(thickness[k]) + 0.5  # voxels are counted from their centres
        away = int(r) + 2
        along = path[min(k + away, len(path) - 1)] - path[max(k - away, 0)]
        if not along.any():
            continue
        u, v = across(along / np.linalg.norm(along))
        step = max(0.25 * r, 0.5)
        reach = int(5.0 * r / step)
        a, b = np.meshgrid(*(step * np.arange(-reach, reach + 1),) * 2)
        places = path[k] + a[..., None] * u + b[..., None] * v
        inside = map_coordinates(depth, np.moveaxis(places, -1, 0)[::-1], order=1, mode="constant") > 0.25
        parts, _ = label(inside)
        own = parts[reach, reach]
        if own:
            found.append(np.count_nonzero(parts == own) * step**2 / (np.pi * r**2))
    return float(np.median(found)) if found else np.inf


def longest_chain(parent: Longs, shape: tuple[int, ...], tips: Longs, starts: Longs) -> Longs:
    """Return the tree's longest path between two of the tips, measured from their trimmed starts.

    The first two tips are kept unless others give a longer path.

    Parameters
    ----------
    parent : Longs
        Parent of every voxel.
    shape : tuple[int, ...]
        Shape of the grid.
    tips : Longs, shape (k,)
        Voxels of the tips, k >= 2.
    starts : Longs, shape (k,)
        Voxels of the trimmed tips.

    Returns
    -------
    Longs
        Indices of voxels.
    """
    best, chosen = -1.0, (0, 1)
    for i in range(len(tips)):
        for j in range(i + 1, len(tips)):
            places = uniform_filter1d(_places(path_between(parent, starts[i], starts[j]), shape), 5, axis=0)
            length = float(arc_length(places)[-1])
            if length > best + 1e-9:
                best, chosen = length, (i, j)
    return path_between(parent, tips[chosen[0]], tips[chosen[1]])


def path_between(parent: Longs, first: int, last: int) -> Longs:
    """Return the tree's path between two voxels.

    Parameters
    ----------
    parent : Longs
        Parent of every voxel.
    first : int
        First voxel.
    last : int
        Last voxel.

    Returns
    -------
    Longs
        Indices of voxels, ends included.
    """
    side, other = path_up(parent, int(first)), path_up(parent, int(last))
    while len(side) > 1 and len(other) > 1 and side[-2] == other[-2]:
        side.pop()
        other.pop()
    return np.array(side + other[-2::-1], dtype=np.int64)


def path_up(parent: Longs, tip: int) -> list[int]:
    """Return the voxels from a tip to the tree's root."""
    path = [tip]
    while parent[path[-1]] >= 0:
        path.append(int(parent[path[-1]]))
    return path


def _places(ids: Longs, shape: tuple[int, ...]) -> Floats:
    return np.stack(np.unravel_index(ids, shape), axis=1)[:, ::-1].astype(np.float64)


def join(lines: list[Line], limb: Floats, own: float, centre: Floats, reach: float) -> Line:
    """Return a limb as a line that continues straight to a junction on one of the lines.

    The junction is where the limb, extended in its own direction, comes nearest to a line inside its parent's ball.

    Parameters
    ----------
    lines : list[Line]
        Lines that it may start from.
    limb : Floats, shape (m, 3), mm
        Points from its tip to its parent's surface.
    own : float, mm
        Its radius near its base.
    centre : Floats, shape (3,), mm
        Centre of the parent's ball at its base.
    reach : float, mm
        Radius of that ball.
    """
    base = limb[-1]
    arc = arc_length(limb)
    behind = np.array([np.interp(max(arc[-1] - 2.0 * own, 0.0), arc, limb[:, k]) for k in range(3)])
    direction = base - behind if np.any(base != behind) else centre - base
    direction = direction / np.linalg.norm(direction)
    best: tuple[float, int, int] | None = None
    for k, line in enumerate(lines):
        ahead = np.maximum((line.points - base) @ direction, 0.0)
        miss = np.linalg.norm(line.points - base - ahead[:, None] * direction, axis=1)
        far = np.linalg.norm(line.points - centre, axis=1)
        # Outside the ball the nearest point counts, so that a junction is found wherever the line was moved.
        miss += np.where(far <= 0.9 * reach, 0.0, 1e3 * reach + far)
        m = int(miss.argmin())
        if best is None or miss[m] < best[0]:
            best = float(miss[m]), k, m
    assert best is not None
    _, k, m = best
    points = np.concatenate([lines[k].points[m][None], limb[::-1]])
    return Line(points, k, float(arc_length(lines[k].points)[m]), reach)
