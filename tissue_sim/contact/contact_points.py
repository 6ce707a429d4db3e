"""Contact points of triangles near a tool: corners and lattice points within its reach, and their compliance."""

from __future__ import annotations

import math
from typing import NamedTuple

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.contact.shapes import signed_distance
from tissue_sim.model.data.contact_set import ContactSet
from tissue_sim.model.data.shapes import Shapes


class Lattices(NamedTuple):
    """Contact points on a triangle whose edges are divided into a number of parts, besides its corners."""

    weight: Floats  # (k, 3) barycentric
    edge: Longs  # (k,) corner opposite to the edge on which a point lies, -1 for none
    start: Longs  # (m + 2,) first point for each number of parts, up to m


class Fineness(NamedTuple):
    """Spacing of a body's contact points."""

    parts: Longs  # (t,) number of parts of the edges of each triangle
    yielding: Floats  # (t, 2) factor on the nodes' compliance for its points; their largest yielding, m
    corner_yielding: Floats  # (n, 2) the same for the corners


class Search(NamedTuple):
    """Query for contact points of a body at a pose, within a reach, m."""

    position: Floats  # (n, 3) m of the nodes
    shapes: Shapes
    body: int
    lattices: Lattices
    fineness: Fineness
    origin: Floats
    rotation: Floats
    reach: float
    normal: Floats  # (n, 3) buffer


class FoundPoints(NamedTuple):
    """Buffers for contact points."""

    body: Longs  # (c,)
    triangle: Longs  # (c,) that it lies in, -1 for one of its corners
    node: Longs  # (c, 3)
    weight: Floats  # (c, 3) barycentric
    normal: Floats  # (c, 3) outward unit normals of the tissue
    yielding: Floats  # (c, 2) see Fineness


@kernel
def points_near(near: Longs, number: Longs, search: Search, seen: Longs, found: FoundPoints, count: int) -> int:
    """Find the points of triangles that lie within reach of a body: corners, and those of their lattices.

    Parameters
    ----------
    near : Longs, shape (t, 3)
        Triangles.
    number : Longs, shape (t,)
        Their indices.
    search : Search
        The query, with the positions of the nodes, (n, 3) m.
    seen : Longs, shape (n,)
        Buffer, zero outside this function.
    found : FoundPoints
        Receives the points after the first `count`, as far as there is room.
    count : int
        Number of points found before.

    Returns
    -------
    int
        Number of points found so far.
    """
    lattices, fineness = search.lattices, search.fineness
    for t in range(len(near)):
        for c in range(3):
            for axis in range(3):
                search.normal[near[t, c], axis] = 0.0
    add_normals(search.position, near, search.normal)
    for t in range(len(near)):
        nodes = near[t, 0], near[t, 1], near[t, 2], number[t]
        for c in range(3):
            node = nodes[c]
            if seen[node] == 0:
                seen[node] = 1
                yielding = fineness.corner_yielding[node]
                count = _add_point((node, node, node, -1), (1.0, 0.0, 0.0), yielding, search, found, count)
        parts, yielding = fineness.parts[number[t]], fineness.yielding[number[t]]
        for point in range(lattices.start[parts], lattices.start[parts + 1]):
            edge, weight = lattices.edge[point], lattices.weight[point]
            # A point on an edge belongs to two triangles; it is added for the one with the edge's direction.
            if edge < 0 or nodes[(edge + 1) % 3] < nodes[(edge + 2) % 3]:
                count = _add_point(nodes, (weight[0], weight[1], weight[2]), yielding, search, found, count)
    for t in range(len(near)):
        for c in range(3):
            seen[near[t, c]] = 0
    return count


@kernel
def _add_point(
    nodes: tuple[int, int, int, int],
    weight: tuple[float, float, float],
    yielding: Floats,
    search: Search,
    found: FoundPoints,
    count: int,
) -> int:
    """Add a point if it is near the body; return the new count. The triangle's index follows its nodes."""
    x = y = z = nx = ny = nz = 0.0
    for c in range(3):
        at, normal = search.position[nodes[c]], search.normal[nodes[c]]
        x, y, z = x + weight[c] * at[0], y + weight[c] * at[1], z + weight[c] * at[2]
        nx, ny, nz = nx + weight[c] * normal[0], ny + weight[c] * normal[1], nz + weight[c] * normal[2]
    r = search.rotation
    x, y, z = x - search.origin[0], y - search.origin[1], z - search.origin[2]
    lx, ly, lz = r[0] * x + r[3] * y + r[6] * z, r[1] * x + r[4] * y + r[7] * z, r[2] * x + r[5] * y + r[8] * z
    if signed_distance(search.shapes, search.body, lx, ly, lz)[0] > search.reach:
        return count
    if count < len(found.node):
        found.body[count], found.yielding[count, 0], found.yielding[count, 1] = search.body, yielding[0], yielding[1]
        found.triangle[count] = nodes[3]
        for c in range(3):
            found.node[count, c] = nodes[c]
            found.weight[count, c] = weight[c]
        _unit(nx, ny, nz, found.normal[count])
    return count + 1


@kernel
def _unit(x: float, y: float, z: float, target: Floats) -> None:
    size = max(math.sqrt(x * x + y * y + z * z), 1e-30)
    target[0], target[1], target[2] = x / size, y / size, z / size


@kernel
def set_compliance(
    found: ContactSet, corners: Longs, weight: Floats, yielding: Floats, compliance: Floats, between: Floats
) -> None:
    """Compute the compliance of a contact set's points from that of their triangles' corners.

    Parameters
    ----------
    found : ContactSet
        The contact set, with bodies and weights of its points; updated.
    corners : Longs, shape (c, 3)
        Points that are the triangles' corners.
    weight : Floats, shape (c, 3)
        Barycentric weights of these.
    yielding : Floats, shape (c, 2)
        See Fineness, of each point.
    compliance : Floats, shape (B, p, 2), m/N
        Compliance of the tissue around each corner, along a body's normal and across it.
    between : Floats, shape (B,)
        Fraction by which a point in the middle of three nodes yields more, times 3/2.
    """
    for point in range(found.header.points):
        body, square = found.body[point], 0.0
        for c in range(found.weight.shape[1]):
            square += found.weight[point, c] * found.weight[point, c]
        more = (1.0 + between[body] * (1.0 - square)) * yielding[point, 0]
        for axis in range(2):
            total = 0.0
            for c in range(3):
                total += more * weight[point, c] * compliance[body, corners[point, c], axis]
            found.compliance[point, axis] = total
        found.most_give[point] = yielding[point, 1]


@kernel
def add_normals(position: Floats, triangles: Longs, normal: Floats) -> None:
    """Add each triangle's area-weighted outward normal to its nodes.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    triangles : Longs, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    normal : Floats, shape (n, 3), m^2
        Sums at the nodes, updated.
    """
    for t in range(len(triangles)):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, az = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1], position[j, 2] - position[i, 2]
        bx, by, bz = position[k, 0] - position[i, 0], position[k, 1] - position[i, 1], position[k, 2] - position[i, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        for c in range(3):
            node = triangles[t, c]
            normal[node, 0] += nx
            normal[node, 1] += ny
            normal[node, 2] += nz
