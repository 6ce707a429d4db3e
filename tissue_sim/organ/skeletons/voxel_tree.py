"""Kernels of the skeleton over the voxel graph: the distance-mapping tree and lengths of ways inside.

Neighbours are the 26 around a voxel, but a diagonal step needs voxels inside to step over: parts of a solid that
meet only across an edge or a corner, as the two sides of a thin cut do, are no neighbours.
"""

from __future__ import annotations

import heapq

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel


@kernel
def _open(depth: Floats, v: int, layer: int, row: int, dz: int, dy: int, dx: int) -> bool:
    """Is there a way over faces from voxel v to its neighbour (dz, dy, dx), inside the box of the two?"""
    a, b, c = dz * layer, dy * row, dx
    if (dz != 0) + (dy != 0) + (dx != 0) < 2:
        return True
    if dx == 0:
        return depth[v + a] > 0.0 or depth[v + b] > 0.0
    if dy == 0:
        return depth[v + a] > 0.0 or depth[v + c] > 0.0
    if dz == 0:
        return depth[v + b] > 0.0 or depth[v + c] > 0.0
    if depth[v + a] > 0.0 and (depth[v + a + b] > 0.0 or depth[v + a + c] > 0.0):
        return True
    if depth[v + b] > 0.0 and (depth[v + a + b] > 0.0 or depth[v + b + c] > 0.0):
        return True
    return depth[v + c] > 0.0 and (depth[v + a + c] > 0.0 or depth[v + b + c] > 0.0)


@kernel
def grow_tree(depth: Floats, shape: Longs) -> tuple[Longs, Longs]:
    """Prim-like growth from the deepest voxel, always on to the deepest reachable voxel (Wan & Liang 2002).

    depth: flattened (nz ny nx,), positive inside. Returns parent (-1 at the root, -2 where not reached) and the order
    of growth (filled with -1 behind the last voxel).
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
                    if parent[w] == -2 and depth[w] > 0.0 and _open(depth, v, ny * nx, nx, dz, dy, dx):
                        parent[w] = v
                        heapq.heappush(heap, (-depth[w], w))
    return parent, order


@kernel
def approach(depth: Floats, shape: Longs, sources: Longs, distance: Floats, nearest: Longs) -> None:
    """Shorten, in place, the shortest ways inside (Dijkstra) by new sources.

    distance (n,) voxels, inf where unknown, and nearest (n,), the source at the way's start, of earlier calls;
    sources: indices of voxels. Only what gets nearer is visited.
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
                    if there < distance[w] and _open(depth, v, ny * nx, nx, dz, dy, dx):
                        distance[w] = there
                        nearest[w] = nearest[v]
                        heapq.heappush(heap, (there, w))


@kernel
def middle_way(depth: Floats, shape: Longs, source: int, target: int) -> Longs:
    """Voxels from source to target on the cheapest way inside, where a step costs its length over the squared depth.

    It keeps to the middle as the tree does, but goes straight through wide places whose ridges go round. Empty when
    the target is out of reach.
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
                    if there < cost[w] and _open(depth, v, ny * nx, nx, dz, dy, dx):
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
