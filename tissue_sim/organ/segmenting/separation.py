"""Separation of a region at its necks.

The depth of a region (distance to its border) rises to a peak in every lobe. Eroding step by step, two lobes part
at the depth of the neck between them. A neck much narrower than either lobe joins two organs; a wide one
belongs to one organ. All voxels are visited from the deepest to the shallowest, lobes grow and meet, and wide necks
join them: every step of the erosion at once, and every seed inside one organ finds the same organ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Ints
from tissue_sim.jit import kernel


@dataclass(frozen=True, eq=False)
class Parts:
    """Bodies of a region, separated at their narrow necks.

    Attributes
    ----------
    labels : Ints, shape (nz, ny, nx)
        0 outside, else the body.
    volume : NDArray[np.int64], shape (n + 1,), voxels
        Volume of every body.
    peak : NDArray[np.float64], shape (n + 1,)
        Greatest depth of every body, in the depth's unit.
    """

    labels: Ints
    volume: NDArray[np.int64]
    peak: NDArray[np.float64]


def part(depth: NDArray[np.float64], neck: float) -> Parts:
    """Separate a region into bodies at its narrow necks.

    Parameters
    ----------
    depth : NDArray[np.float64], shape (nz, ny, nx)
        Distance to the region's border, positive inside.
    neck : float
        Fraction of the smaller lobe's depth below which a neck separates.
    """
    padded = np.pad(depth, 1)
    flat = padded.ravel()
    inside = np.flatnonzero(flat > 0.0)
    order = inside[np.argsort(-flat[inside], kind="stable")]
    steps = np.array(
        [
            dz * padded.strides[0] + dy * padded.strides[1] + dx * padded.strides[2]
            for dz in (-1, 0, 1)
            for dy in (-1, 0, 1)
            for dx in (-1, 0, 1)
            if (dz, dy, dx) != (0, 0, 0)
        ]
    )
    steps //= padded.itemsize
    labels = _flood(flat, order.astype(np.int64), steps.astype(np.int64), neck)
    used = np.bincount(labels) > 0
    used[0] = True
    rank = (np.cumsum(used) - 1).astype(np.int32)
    labels = rank[labels].reshape(padded.shape)[1:-1, 1:-1, 1:-1]
    count = int(labels.max()) + 1
    volume = np.bincount(labels.ravel(), minlength=count)
    peak = np.zeros(count)
    within = labels > 0
    np.maximum.at(peak, labels[within], depth[within])
    return Parts(labels, volume, peak)


def necks(parts: Parts, depth: NDArray[np.float64], body: int) -> NDArray[np.float64]:
    """Return the depth of the neck from one body to every other.

    Parameters
    ----------
    parts : Parts
        Bodies of the region.
    depth : NDArray[np.float64], shape (nz, ny, nx)
        Distance to the region's border.
    body : int
        Label of the body.

    Returns
    -------
    NDArray[np.float64], shape (n + 1,)
        Depth; 0 where they don't touch.
    """
    found = np.zeros(len(parts.volume))
    for axis in range(3):
        labels, deep = np.moveaxis(parts.labels, axis, 0), np.moveaxis(depth, axis, 0)
        for first, second in ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))):
            touching = (labels[first] == body) & (labels[second] != body) & (labels[second] > 0)
            saddle = np.minimum(deep[first][touching], deep[second][touching])
            np.maximum.at(found, labels[second][touching], saddle)
    return found


@kernel
def _root(parent: NDArray[np.int64], at: int) -> int:
    while parent[at] != at:
        parent[at] = parent[parent[at]]
        at = parent[at]
    return at


@kernel
def _flood(
    depth: NDArray[np.float64], order: NDArray[np.int64], steps: NDArray[np.int64], neck: float
) -> NDArray[np.int64]:
    """Return the label of every voxel, 0 outside: lobes in order of falling depth, joined through wide necks."""
    label = np.zeros(len(depth), dtype=np.int64)
    parent = np.zeros(len(order) + 1, dtype=np.int64)
    peak = np.zeros(len(order) + 1)
    count = 0
    for at in order:
        best = 0
        for step in steps:
            other = label[at + step]
            if other == 0:
                continue
            root = _root(parent, other)
            if best == 0 or root == best:
                best = root
                continue
            high, low = (best, root) if peak[best] >= peak[root] else (root, best)
            if depth[at] >= neck * peak[low]:
                parent[low] = high
            best = high
        if best == 0:
            count += 1
            best = count
            parent[best] = best
            peak[best] = depth[at]
        label[at] = best
    for at in order:
        label[at] = _root(parent, label[at])
    return label
