"""Kernels of the skeleton over the voxel graph: the distance-mapping tree and lengths of paths inside.

Neighbours are the 26 around a voxel, but a diagonal step needs voxels inside to step over: parts of a solid that meet
only across an edge or a corner, as the two sides of a thin cut do, are not neighbours.
"""

from __future__ import annotations

import heapq

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel


@kernel
def _open(depth: Floats, v: int, a: int, b: int, c: int) -> bool:
    """Return whether a path over faces leads from voxel v to its neighbour v + a + b + c, inside the box of the two.

    a, b, c are steps along z, y and x, or 0.
    """
    if (a != 0) + (b != 0) + (c != 0) < 2:
        return True
    if c == 0:
        return depth[v + a] > 0.0 or depth[v + b] > 0.0
    if b == 0:
        return depth[v + a] > 0.0 or depth[v + c] > 0.0
    if a == 0:
        return depth[v + b] > 0.0 or depth[v + c] > 0.0
    if depth[v + a] > 0.0 and (depth[v + a + b] > 0.0 or depth[v + a + c] > 0.0):
        return True
    if depth[v + b] > 0.0 and (depth[v + a + b] > 0.0 or depth[v + b + c] > 0.0):
        return True
    return depth[v + c] > 0.0 and (depth[v + a + c] > 0.0 or depth[v + b + c] > 0.0)


@kernel
def grow_tree(depth: Floats, shape: Longs) -> tuple[Longs, Longs]:
    """Grow a tree from the deepest voxel, always to the deepest reachable voxel (Prim's algorithm).

    Parameters
    ----------
    depth : Floats, shape (nz ny nx,), voxels
        Distance to the border, flattened, positive inside.
    shape : Longs, shape (3,)
        Number of voxels along z, y, x.

    Returns
    -------
    tuple[Longs, Longs]
        Parent of every voxel, -1 at the root, -2 where not reached; and the order of growth, filled with -1.

    References
    ----------
    Wan & Liang 2002.
    """
    nz, ny, nx = shape[0], shape[1], shape[2]
    parent = np.full(depth.size, -2, dtype=np.int64)
    order = np.full(depth.size, -1, dtype=np.int64)
    root = np.argmax(depth)
    parent[root] = -1
    heap = [(-depth[root], root)]
    grown = 0
    while len(heap) > 0:
        _, v = heapq.heappop(heap)
        order[grown] = v
        grown += 1
        z, y, x = v // (ny * nx), (v // nx) % ny, v % nx
        for dz in range(-1, 2):
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    k, j, i = z + dz, y + dy, x + dx
                    if k < 0 or j < 0 or i < 0 or k >= nz or j >= ny or i >= nx:
                        continue
                    w = (k * ny + j) * nx + i
                    if parent[w] == -2 and depth[w] > 0.0 and _open(depth, v, dz * ny * nx, dy * nx, dx):
                        parent[w] = v
                        heapq.heappush(heap, (-depth[w], w))
    return parent, order


@kernel
def approach(depth: Floats, shape: Longs, sources: Longs, distance: Floats, nearest: Longs) -> None:
    """Shorten the shortest paths inside (Dijkstra) by new sources, in place.

    Only voxels that get nearer are visited.

    Parameters
    ----------
    depth : Floats, shape (nz ny nx,), voxels
        Distance to the border, flattened, positive inside.
    shape : Longs, shape (3,)
        Number of voxels along z, y, x.
    sources : Longs
        Indices of the new sources.
    distance : Floats, shape (nz ny nx,), voxels
        Length of the shortest path, inf where unknown; updated.
    nearest : Longs, shape (nz ny nx,)
        Source of that path; updated.
    """
    nz, ny, nx = shape[0], shape[1], shape[2]
    heap = [(0.0, np.int64(0))]
    heap.pop()
    for s in sources:
        distance[s] = 0.0
        nearest[s] = s
        heap.append((0.0, s))
    heapq.heapify(heap)
    while len(heap) > 0:
        d, v = heapq.heappop(heap)
        if d > distance[v]:
            continue
        z, y, x = v // (ny * nx), (v // nx) % ny, v % nx
        for dz in range(-1, 2):
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    k, j, i = z + dz, y + dy, x + dx
                    if k < 0 or j < 0 or i < 0 or k >= nz or j >= ny or i >= nx:
                        continue
                    w = (k * ny + j) * nx + i
                    if depth[w] <= 0.0:
                        continue
                    there = d + np.sqrt(float(dx * dx + dy * dy + dz * dz))
                    if there < distance[w] and _open(depth, v, dz * ny * nx, dy * nx, dx):
                        distance[w] = there
                        nearest[w] = nearest[v]
                        heapq.heappush(heap, (there, w))


@kernel
def middle_path(depth: Floats, shape: Longs, source: int, target: int) -> Longs:
    """Return the cheapest path inside, where a step costs its length over the squared depth.

    It keeps to the middle as the tree does, but goes straight through wide places whose ridges go round.

    Parameters
    ----------
    depth : Floats, shape (nz ny nx,), voxels
        Distance to the border, flattened, positive inside.
    shape : Longs, shape (3,)
        Number of voxels along z, y, x.
    source : int
        First voxel.
    target : int
        Last voxel.

    Returns
    -------
    Longs
        Indices of voxels from source to target; empty where the target can't be reached.
    """
    nz, ny, nx = shape[0], shape[1], shape[2]
    cost = np.full(depth.size, np.inf)
    before = np.full(depth.size, -1, dtype=np.int64)
    cost[source] = 0.0
    heap = [(0.0, np.int64(source))]
    while len(heap) > 0:
        c, v = heapq.heappop(heap)
        if c > cost[v]:
            continue
        if v == target:
            break
        z, y, x = v // (ny * nx), (v // nx) % ny, v % nx
        for dz in range(-1, 2):
            for dy in range(-1, 2):
                for dx in range(-1, 2):
                    k, j, i = z + dz, y + dy, x + dx
                    if k < 0 or j < 0 or i < 0 or k >= nz or j >= ny or i >= nx:
                        continue
                    w = (k * ny + j) * nx + i
                    if depth[w] <= 0.0:
                        continue
                    there = c + np.sqrt(float(dx * dx + dy * dy + dz * dz)) / (depth[v] * depth[w])
                    if there < cost[w] and _open(depth, v, dz * ny * nx, dy * nx, dx):
                        cost[w] = there
                        before[w] = v
                        heapq.heappush(heap, (there, w))
    count = 0
    at = int(target) if np.isfinite(cost[target]) else -1
    while at >= 0:
        count += 1
        at = before[at]
    path = np.empty(count, dtype=np.int64)
    at = int(target)
    for k in range(count):
        path[count - 1 - k] = at
        at = before[at]
    return path
