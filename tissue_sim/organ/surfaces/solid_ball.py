"""Least change of a voxel solid into a topological ball: handles are cut through or filled, one by one.

A voxel is simple when flipping it doesn't change the topology of the solid (Bertrand and Malandain 1994: 6-connected
solid, 26-connected outside). Growing a ball inside the solid by simple voxels, deepest first, leaves out one thin cut
through each handle at its thinnest place; carving a ball down to the solid, farthest first, leaves one thin membrane
across each handle's hole at its narrowest. The smaller of the two is taken, handle by handle.
"""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.measure import euler_number

from tissue_sim.array_types import Mask
from tissue_sim.errors import UserError
from tissue_sim.jit import kernel

_WIDEST_HOLE = 0.75  # of the organ's depth: the radius of a hole that may be filled
_THICKEST_CUT = 0.5  # of the organ's depth: the radius of a neck that may be cut
_ROUNDS = 4


def largest_part(solid: Mask) -> Mask:
    """Return the largest 6-connected part.

    Parameters
    ----------
    solid : Mask, shape (nz, ny, nx)
        Voxels of the solid; its border is empty.

    Returns
    -------
    Mask, shape (nz, ny, nx)
        Its voxels.
    """
    labels, count = ndimage.label(solid)
    return labels == int(np.bincount(labels.ravel())[1:].argmax()) + 1 if count > 1 else solid


def as_ball(solid: Mask, name: str) -> Mask:
    """Return the solid as a topological ball: cavities filled, handles cut or filled.

    Parameters
    ----------
    solid : Mask, shape (nz, ny, nx)
        Voxels of the solid; its border is empty.
    name : str
        Name for the message.

    Returns
    -------
    Mask, shape (nz, ny, nx)
        The ball.

    Raises
    ------
    UserError
        Where a handle is too thick to cut and its hole too wide to fill (a ring).
    """
    ball = largest_part(ndimage.binary_fill_holes(solid))
    for _ in range(_ROUNDS):
        if euler_number(ball, connectivity=1) == 1:
            return ball
        changed = _with_fewer_handles(ball)
        if changed is None:
            break
        ball = largest_part(ndimage.binary_fill_holes(changed))
    if euler_number(ball, connectivity=1) == 1:
        return ball
    raise UserError(
        f"{name or 'the mask'} has a through hole (like a ring) that is too wide to fill and whose rim is too thick"
        " to cut; the balloon surface needs a solid without one: fill the hole or cut the ring in the mask or mesh, or"
        " build each part of a mesh with --part N"
    )


def _with_fewer_handles(solid: Mask) -> Mask | None:
    """Return the solid with cuts and membranes that remove a handle, smallest first; None where none does."""
    box = tuple(slice(max(s.start - 3, 0), s.stop + 3) for s in ndimage.find_objects(solid.astype(np.uint8))[0])
    part = solid[box]
    depth = ndimage.distance_transform_edt(part)
    gap = ndimage.distance_transform_edt(~part)
    deepest = float(depth.max())

    grown = np.zeros(part.shape, dtype=np.uint8)
    grown[np.unravel_index(int(depth.argmax()), depth.shape)] = 1
    flip_simple(grown, part, depth, 1)
    carved = _ball_around(gap, _WIDEST_HOLE * deepest)
    flip_simple(carved, (carved == 1) & ~part, gap, 0)

    changes: list[tuple[int, int, tuple[slice, ...], Mask]] = []
    everywhere = np.ones((3, 3, 3))
    for difference, far, limit in (
        (part & (grown == 0), depth, _THICKEST_CUT * deepest),
        (~part & (carved == 1), gap, _WIDEST_HOLE * deepest),
    ):
        labels, _ = ndimage.label(difference, structure=everywhere)
        for k, place in enumerate(ndimage.find_objects(labels), start=1):
            own = labels[place] == k
            if far[place][own].max() <= max(limit, 1.5):
                changes.append((int(np.count_nonzero(own)), len(changes), place, own))
    changes.sort(key=lambda change: change[:2])

    handles = 1 - euler_number(part, connectivity=1)
    least = handles
    part = part.copy()
    for _, _, place, own in changes:
        if handles == 0:
            break
        part[place] ^= own
        left = _handles(part)
        if left < handles:
            handles = left
        else:
            part[place] ^= own
    if handles == least:
        return None
    changed = solid.copy()
    changed[box] = part
    return changed


def _ball_around(gap: NDArray[np.float64], widest: float) -> NDArray[np.uint8]:
    """Return a topological ball around the solid, 0 or 1: its vicinity, if that is one (less to carve), or the box."""
    for reach in (2.0, 0.5 * widest, widest):
        near = np.zeros(gap.shape, dtype=bool)
        inner = (slice(1, -1),) * 3
        near[inner] = gap[inner] <= reach
        if _handles(near) == 0:
            return near.astype(np.uint8)
    near[inner] = True
    return near.astype(np.uint8)


def _handles(solid: Mask) -> int:
    """Return the number of handles of the solid, large where it has cavities or several parts."""
    if ndimage.label(solid)[1] > 1 or ndimage.label(np.pad(~solid, 1, constant_values=True), np.ones((3, 3, 3)))[1] > 1:
        return 1 << 30
    return 1 - int(euler_number(solid, connectivity=1))


@kernel
def flip_simple(image, allowed, priority, value):  # type: ignore[no-untyped-def]
    """Set simple voxels to `value` in place, largest priority first, where allowed, until none is left.

    Voxels flip next to voxels that already have `value`.

    Parameters
    ----------
    image : shape (nz, ny, nx), uint8
        The solid, 0 or 1; its border is 0 and never changed.
    allowed : shape (nz, ny, nx)
        Voxels that may flip.
    priority : shape (nz, ny, nx)
        Priority of each voxel.
    value
        0 or 1.
    """
    nz, ny, nx = image.shape
    heap = [(0.0, np.int64(-1))]
    heap.pop()
    for z in range(1, nz - 1):
        for y in range(1, ny - 1):
            for x in range(1, nx - 1):
                if allowed[z, y, x] and image[z, y, x] != value and _touches(image, z, y, x, value):
                    heapq.heappush(heap, (-priority[z, y, x], np.int64((z * ny + y) * nx + x)))
    ring = np.zeros((3, 3, 3), dtype=np.uint8)
    stack = np.zeros(27, dtype=np.int64)
    while len(heap) > 0:
        at = heapq.heappop(heap)[1]
        x, y, z = at % nx, (at // nx) % ny, at // (nx * ny)
        if image[z, y, x] == value or not _simple(image, z, y, x, ring, stack):
            continue
        image[z, y, x] = value
        for c in range(max(z - 1, 1), min(z + 2, nz - 1)):
            for b in range(max(y - 1, 1), min(y + 2, ny - 1)):
                for a in range(max(x - 1, 1), min(x + 2, nx - 1)):
                    if allowed[c, b, a] and image[c, b, a] != value:
                        heapq.heappush(heap, (-priority[c, b, a], np.int64((c * ny + b) * nx + a)))


@kernel
def _touches(image, z, y, x, value):  # type: ignore[no-untyped-def]
    for c in range(z - 1, z + 2):
        for b in range(y - 1, y + 2):
            for a in range(x - 1, x + 2):
                if image[c, b, a] == value:
                    return True
    return False


@kernel
def _simple(image, z, y, x, ring, stack):  # type: ignore[no-untyped-def]
    """Return whether a voxel is simple.

    It is where the solid has one 6-connected part at the voxel's faces within its 18 neighbours, and the rest one
    26-connected part.
    """
    for c in range(3):
        for b in range(3):
            for a in range(3):
                ring[c, b, a] = image[z + c - 1, y + b - 1, x + a - 1]
    ring[1, 1, 1] = 2
    # Corners aren't in the 18-neighbourhood, so those of the solid are marked, and only the outside's count sees them.
    for c in (0, 2):
        for b in (0, 2):
            for a in (0, 2):
                if ring[c, b, a] == 1:
                    ring[c, b, a] = 3
    return _parts(ring, stack, 1) == 1 and _parts(ring, stack, 0) == 1


@kernel
def _parts(ring, stack, value):  # type: ignore[no-untyped-def]
    """Count the parts of `value` in the 3 x 3 x 3 ring, marking them 4; parts of the solid must touch a face."""
    parts = 0
    for start in range(27):
        c, b, a = start // 9, (start // 3) % 3, start % 3
        if ring[c, b, a] != value:
            continue
        if value == 1 and abs(c - 1) + abs(b - 1) + abs(a - 1) != 1:
            continue
        parts += 1
        if parts > 1:
            return parts
        ring[c, b, a] = 4
        stack[0] = start
        top = 1
        while top > 0:
            top -= 1
            at = stack[top]
            c, b, a = at // 9, (at // 3) % 3, at % 3
            for k in range(max(c - 1, 0), min(c + 2, 3)):
                for j in range(max(b - 1, 0), min(b + 2, 3)):
                    for i in range(max(a - 1, 0), min(a + 2, 3)):
                        if ring[k, j, i] != value:
                            continue
                        if value == 1 and abs(k - c) + abs(j - b) + abs(i - a) != 1:
                            continue
                        ring[k, j, i] = 4
                        stack[top] = (k * 3 + j) * 3 + i
                        top += 1
    return parts
