"""Bodies given by a lattice of points: their surface, and places inside tetrahedra."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array

from tissue_sim.array_types import Floats, Ints, Longs

AT_ONCE = 64  # points located together
EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))  # whose midpoints are the last nodes of a quadratic element


def shell(counts: tuple[int, int, int]) -> tuple[Longs, Ints]:
    """Return the outer points of a lattice, as indices, and the triangles between them.

    The triangles are counter-clockwise from outside where the indices grow along a right-handed frame. The diagonals
    alternate, so that none of the lattice's directions is stiffer than another.

    counts: number of points along each axis. Returns indices of the points (n, 3) and triangles (t, 3).
    """
    index = np.stack(np.meshgrid(*(np.arange(count) for count in counts), indexing="ij"), axis=-1)
    last = np.array(counts) - 1
    outside = ((index == 0) | (index == last)).any(axis=-1)
    number = np.full(counts, -1)
    number[outside] = np.arange(np.count_nonzero(outside))
    triangles = []
    for axis in range(3):
        for side in (0, counts[axis] - 1):
            face = np.take(number, side, axis=axis)
            a, b, c, d = face[:-1, :-1], face[1:, :-1], face[1:, 1:], face[:-1, 1:]
            even = (np.add.outer(np.arange(a.shape[0]), np.arange(a.shape[1])) % 2 == 0)[..., None]
            one = np.where(even, np.stack([a, b, d], axis=-1), np.stack([a, b, c], axis=-1))
            other = np.where(even, np.stack([b, c, d], axis=-1), np.stack([a, c, d], axis=-1))
            both = np.concatenate([one.reshape(-1, 3), other.reshape(-1, 3)])
            # The face's own axes are in cyclic order but for y, where they are x and z.
            outward = (side > 0) != (axis == 1)
            triangles.append(both if outward else both[:, ::-1])
    return index[outside], np.concatenate(triangles).astype(np.int32)


def places(points: Floats, nodes: Floats, cells: Ints) -> csr_array:
    """Return the interpolation of values at the nodes of straight cells to points.

    A point outside all of them is taken with the cell that it leaves least.

    points (p, 3) m; nodes (n, 3) m; cells (c, 4) or (c, 10): node indices of linear or quadratic cells. Returns (p, n):
    interpolation matrix.
    """
    corner = nodes[cells[:, :4]]
    back = np.linalg.inv((corner[:, 1:] - corner[:, :1]).transpose(0, 2, 1))
    best, weight = np.empty(len(points), dtype=np.int64), np.empty((len(points), 4))
    for first in range(0, len(points), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        found = np.einsum("cij,pcj->pci", back, points[some, None] - corner[None, :, 0])
        found = np.concatenate([1.0 - found.sum(axis=2, keepdims=True), found], axis=2)
        best[some] = found.min(axis=2).argmax(axis=1)
        weight[some] = found[np.arange(len(found)), best[some]]
    value = weight
    if cells.shape[1] > 4:
        value = np.stack(
            [*(weight.T * (2.0 * weight.T - 1.0)), *(4.0 * weight[:, a] * weight[:, b] for a, b in EDGES)], 1
        )
    row = np.repeat(np.arange(len(points)), cells.shape[1])
    return coo_array((value.ravel(), (row, cells[best].ravel())), shape=(len(points), len(nodes))).tocsr()


def rigid_motion(start: Floats, end: Floats) -> tuple[Floats, Floats]:
    """Return the rotation and shift that bring points closest to others (Kabsch 1976).

    start (k, 3): points; end (k, 3): other points. Returns the rotation (3, 3) and the shift (3,).
    """
    middle, goal = start.mean(axis=0), end.mean(axis=0)
    left, _, right = np.linalg.svd((start - middle).T @ (end - goal))
    mirrored = np.sign(np.linalg.det(right.T @ left.T))
    rotation = right.T @ np.diag([1.0, 1.0, mirrored]) @ left.T
    return rotation, goal - rotation @ middle
