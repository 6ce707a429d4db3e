"""Last stage of the segmentation: the organ's core dilates back to the wall, against its neighbours.

The reach of the dilation is what the erosion took and a little more; where it stops is decided by the image: every
voxel in reach is either organ or not, as its intensity fits the organ or its surroundings, with the smallest wall
between the two. That is a minimal cut in its convex form (Chan, Esedoglu & Nikolova, SIAM J Appl Math 2006; 66: 1632),
solved by Chambolle and Pock's primal-dual steps (J Math Imaging Vis 2011; 40: 120). Noise then doesn't roughen the
wall, and between neighbours of the same intensity the wall closes the neck.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tissue_sim.array_types import Mask, Singles
from tissue_sim.jit import kernel
from tissue_sim.organ.segmenting.depth import depth_of
from tissue_sim.organ.segmenting.region import Region

_RIM = 6.0  # mm inwards of fat and gas to which an organ may be blurred darker
_RIVAL = 2.0  # mL, from which a part of other intensity is a neighbour and no noise
_BONE = 150.0  # HU above the organ, from which tissue is surely something else
_AROUND = 6.0  # mm over which the neighbours' intensity is averaged
_FEW = 0.02  # weight below which no neighbour is near
_FIRM = 0.7  # greatest cost of a voxel, in voxel faces
_LIGHT = 1.0  # mm, erosion of what is brighter
_RACE, _RACE_WIDTH = 1.5, 2.0  # mm: weight of who is nearer, organ or neighbour; lead at which it counts fully
_STEP = 0.28  # of both variables; stable under 1 / sqrt(12)
_SETTLED = 0.002  # mean change of the undecided voxels that counts as converged
_EVERY, _STEPS = 20, 400  # steps between looks at the change; at most


def dilate(region: Region, core: Mask, stiffness: float, spur: float) -> Mask:
    """Dilate the organ's core back to its wall, by at most the region's reach.

    Parameters
    ----------
    region : Region
        The region around the organ.
    core : Mask, shape (nz, ny, nx)
        The eroded organ.
    stiffness : float
        Weight of the image against a small wall.
    spur : float, mm
        Radius under which spurs are left out.

    Returns
    -------
    Mask, shape (nz, ny, nx)
        The organ.
    """
    sharp, smooth, level, others, h = region.sharp, region.smooth, region.level, region.others, region.h
    tissue = sharp > region.wall
    deep = depth_of(tissue) * h
    brighter = depth_of((smooth > level + region.width) & tissue) * h > _LIGHT
    darker = (smooth < level - region.width) & (deep > _RIM)
    away = depth_of(~core) * h
    rival = _sizeable((others | brighter | darker) & ~core & (away > h), _RIVAL * 1e3 / h**3)
    around, weight = local_mean(sharp, rival & (sharp < region.mean + _BONE), _AROUND / h)
    noise = max(1.4826 * float(np.median(np.abs(sharp - level)[core])), 1.0)
    fits = (sharp - level) ** 2
    other = np.where(sharp < region.dark, 0.0, sharp - region.dark) ** 2
    beyond = ((around > level) & (sharp > around)) | ((around < level) & (sharp < around))
    other = np.where(weight > _FEW, np.minimum(other, np.where(beyond, 0.0, sharp - around) ** 2), other)
    cost = stiffness * (fits - other) / (2.0 * noise**2)
    cost = np.where(sharp > region.mean + _BONE, 1.0, np.clip(cost, -_FIRM, _FIRM)).astype(np.float32)
    if rival.any():
        lead = away - depth_of(~rival) * h
        cost += _RACE * np.clip(lead / _RACE_WIDTH, -1.0, 1.0).astype(np.float32) * (lead > -_RACE_WIDTH)
    free = (away <= region.reach) & region.inside & ~core & ~others
    own = least_wall(cost, free, core)
    return _open(own, spur / h) | core


def _sizeable(mask: Mask, voxels: float) -> Mask:
    """Return the mask's connected parts of at least `voxels` voxels."""
    labels, _ = ndimage.label(mask)
    large = np.bincount(labels.ravel()) >= voxels
    large[0] = False
    return np.asarray(large[labels])


def _open(mask: Mask, radius: float) -> Mask:
    """Return the opening by a ball of `radius` voxels, through exact distances."""
    if radius <= 0.0:
        return mask
    kept = depth_of(mask) > radius
    return depth_of(~kept) <= radius if kept.any() else kept


def local_mean(values: Singles, where: Mask, sigma: float) -> tuple[Singles, Singles]:
    """Return the Gaussian-weighted local mean of values over some voxels.

    It is computed on every third voxel where sigma allows, as the mean is smooth.

    Parameters
    ----------
    values : Singles, shape (nz, ny, nx)
        Values.
    where : Mask, shape (nz, ny, nx)
        Voxels that count.
    sigma : float, voxels
        Standard deviation of the Gaussian.

    Returns
    -------
    tuple[Singles, Singles]
        The mean and the total weight (0..1), of shape (nz, ny, nx) each.
    """
    if sigma > 6.0:
        every = 3
        block = _block_mean(np.where(where, values, 0.0), every), _block_mean(where.astype(np.float32), every)
        weight = ndimage.gaussian_filter(block[1], sigma / every, mode="constant")
        total = ndimage.gaussian_filter(block[0], sigma / every, mode="constant")
        mean = total / np.maximum(weight, 1e-6)
        return _upsample(mean, every, where.shape), _upsample(weight, every, where.shape)
    weight = ndimage.gaussian_filter(where.astype(np.float32), sigma, mode="constant")
    total = ndimage.gaussian_filter(np.where(where, values, 0.0).astype(np.float32), sigma, mode="constant")
    return total / np.maximum(weight, 1e-6), weight


def _block_mean(values: NDArray[np.float32], every: int) -> Singles:
    padded = np.pad(values, [(0, -n % every) for n in values.shape], mode="edge")
    a, b, c = (n // every for n in padded.shape)
    return padded.reshape(a, every, b, every, c, every).mean(axis=(1, 3, 5), dtype=np.float32)


def _upsample(values: Singles, every: int, shape: tuple[int, ...]) -> Singles:
    for axis, n in enumerate(shape):
        at = np.clip((np.arange(n) - 0.5 * (every - 1)) / every, 0, values.shape[axis] - 1)
        low = np.minimum(at.astype(int), max(values.shape[axis] - 2, 0))
        fraction = (at - low).astype(np.float32).reshape([-1 if k == axis else 1 for k in range(3)])
        high = np.minimum(low + 1, values.shape[axis] - 1)
        values = values.take(low, axis) * (1.0 - fraction) + values.take(high, axis) * fraction
    return values


def least_wall(cost: Singles, free: Mask, inside: Mask) -> Mask:
    """Return the set of least cost: the area of its wall plus `cost` over its voxels, both in voxels.

    cost (nz, ny, nx): above 0 where a voxel fits the outside better. Only `free` voxels are decided;
    of the others `inside` belong to the set.
    """
    u = inside.astype(np.float32)
    u[free] = (cost[free] < 0.0).astype(np.float32)
    u, c, f = np.pad(u, 1), np.pad(cost, 1).astype(np.float32), np.pad(free, 1)
    lead = u.copy()
    dual = np.zeros((3, *u.shape), dtype=np.float32)
    count = max(int(np.count_nonzero(free)), 1)
    for step in range(_STEPS):
        _raise_dual(lead, dual, np.float32(_STEP))
        change = _lower_set(u, lead, dual, c, f, np.float32(_STEP))
        if step % _EVERY == _EVERY - 1 and change < _SETTLED * count:
            break
    return u[1:-1, 1:-1, 1:-1] > 0.5


@kernel
def _raise_dual(lead: Singles, dual: NDArray[np.float32], step: float) -> None:
    """Move the dual field along the set's gradient, its length limited to 1."""
    nz, ny, nx = lead.shape
    for k in range(nz - 1):
        for j in range(ny - 1):
            for i in range(nx - 1):
                here = lead[k, j, i]
                z = dual[0, k, j, i] + step * (lead[k + 1, j, i] - here)
                y = dual[1, k, j, i] + step * (lead[k, j + 1, i] - here)
                x = dual[2, k, j, i] + step * (lead[k, j, i + 1] - here)
                square = z * z + y * y + x * x
                if square > 1.0:
                    shrink = np.float32(1.0) / np.sqrt(square)
                    z *= shrink
                    y *= shrink
                    x *= shrink
                dual[0, k, j, i] = z
                dual[1, k, j, i] = y
                dual[2, k, j, i] = x


@kernel
def _lower_set(u: Singles, lead: Singles, dual: NDArray[np.float32], cost: Singles, free: Mask, step: float) -> float:
    """Move the free voxels along the dual's divergence minus their cost, within 0..1; return the summed change."""
    nz, ny, nx = u.shape
    change = 0.0
    for k in range(1, nz - 1):
        for j in range(1, ny - 1):
            for i in range(1, nx - 1):
                if not free[k, j, i]:
                    continue
                flow = dual[0, k, j, i] - dual[0, k - 1, j, i]
                flow += dual[1, k, j, i] - dual[1, k, j - 1, i]
                flow += dual[2, k, j, i] - dual[2, k, j, i - 1]
                old = u[k, j, i]
                new = min(max(old + step * (flow - cost[k, j, i]), np.float32(0.0)), np.float32(1.0))
                lead[k, j, i] = np.float32(2.0) * new - old
                u[k, j, i] = new
                change += abs(new - old)
    return change
