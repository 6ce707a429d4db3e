"""Search for self-contact between the walls of a fold that closes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, eye_array

from tissue_sim.array_types import Floats, Longs
from tissue_sim.contact.broad_phase import approach
from tissue_sim.contact.contact_points import add_normals
from tissue_sim.contact.touched_surface import TouchedSurface
from tissue_sim.contact.triangles import nearest_of_face
from tissue_sim.jit import kernel
from tissue_sim.organ.organ import Organ

FACING = -0.2  # cosine between the outward normals of two nodes, below which they face towards or away from each other
BEHIND = 0.3  # sine of the angle by which a node may be behind another one's plane and still face it
MARGIN = 0.002  # m in front of a wall within which a node is examined
STALE = 0.002  # m of approach of a surface to itself, after which all nodes are examined again
DEEPEST = 0.004  # m, largest distance of a node behind a wall if it was in front of it before


class SelfFinder:
    """Finder of pairs of nodes and triangles of one surface that face each other.

    A node counts as behind a wall only if it was in front of that wall at the last search: of a thin organ, a node is
    always behind the far wall. Triangles that a cut has split are used as neighbours only: lips have contact of their
    own (model.contact.lips).
    """

    def __init__(self, touched: Organ | TouchedSurface) -> None:
        surface = TouchedSurface.of(touched)
        organ, self._triangles = surface.organ, surface.old_triangles
        every = organ.surface_triangles.astype(np.int64)
        n = organ.n_surface
        corner = organ.surface_positions[every]
        longest = float(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max())
        self._reach = MARGIN + 0.6 * longest  # m between nodes; a triangle has no place farther from all corners
        self._order = np.argsort(organ.surface_positions[:, 0]).astype(np.int64)
        # Distance by which each node may approach nodes that aren't its neighbours before it is within reach of one, m.
        self._room: Floats = np.zeros(n)
        self._before: Floats | None = None  # the surface at that time
        self._facing = _Facing(np.zeros((n, 3)), np.zeros(n, dtype=np.int64), np.zeros(n))
        self._walls = _Walls(np.full(n, -1, dtype=np.int64), np.zeros(n, dtype=np.int64), np.zeros((n, 3)))
        self._corners = np.zeros((4, 3))
        start, end = every.ravel(), np.roll(every, -1, axis=1).ravel()
        edges = csr_array((np.ones(2 * len(start)), (np.r_[start, end], np.r_[end, start])), shape=(n, n))
        self._near = _Lists.of(edges + edges @ edges + eye_array(n, format="csr"))
        start = self._triangles.ravel()
        order = np.argsort(start, kind="stable")
        owner = csr_array((np.ones(len(start)), order // 3, np.searchsorted(start[order], np.arange(n + 1))))
        self._around = _Lists.of(owner + edges @ owner)

    def forget(self) -> None:
        """Discard the last search after the organ has jumped: no node counts as in front of a wall."""
        self._walls.before[:] = -1

    def find(self, surface: Floats) -> tuple[Longs, Floats]:
        """Return the pairs on a surface: nodes (p, 4), a node and a triangle's three, and weights (p, 3).

        Parameters
        ----------
        surface : Floats, shape (n, 3), m
            Points of the surface.
        """
        now = _Surface(np.ascontiguousarray(surface), self._triangles)
        facing, walls = self._facing, self._walls
        few, count = self._within_reach(now.position), 0
        if len(few):
            count = facing_nodes(now, few, self._near, walls.before, self._reach, facing)
        if count:
            count = facing_walls(now, self._near, self._around, facing, walls, self._corners)
        else:
            self.forget()
        if count == 0:
            return np.zeros((0, 4), dtype=np.int64), np.zeros((0, 3))
        found = np.flatnonzero(walls.triangle >= 0)
        return np.column_stack([found, self._triangles[walls.triangle[found]]]), walls.weight[found]

    def _within_reach(self, surface: Floats) -> Longs:
        """Return nodes that may be within reach of others, sorted by their first coordinate at the last search."""
        before = self._before
        nearer = STALE if before is None else approach(surface, before, surface, before)
        if nearer >= STALE:
            find_rooms(surface, self._order, self._near, self._reach, STALE, self._room)
            self._before, nearer = surface.copy(), 0.0
        return self._order[self._room[self._order] <= nearer]


class _Lists(NamedTuple):
    """Sorted list for each of n nodes."""

    start: Longs  # (n + 1,)
    items: Longs

    @classmethod
    def of(cls, table: csr_array) -> _Lists:
        """Return the columns that each row of a sparse table has."""
        made = csr_array(table)
        made.sort_indices()
        return cls(made.indptr.astype(np.int64), made.indices.astype(np.int64))


class _Surface(NamedTuple):
    """Surface of an organ as it is now."""

    position: Floats  # (n, 3) m
    triangles: Longs  # (t, 3)


class _Facing(NamedTuple):
    """Nearest node that faces each of n nodes."""

    normal: Floats  # (n, 3) outward unit normals
    partner: Longs  # (n,) that node, or -1
    apart: Floats  # (n,) m^2, squared distance of the two


class _Walls(NamedTuple):
    """Triangle in front of which each of n nodes is, or was before it came behind it."""

    before: Longs  # (n,) the one found at the last search, or -1
    triangle: Longs  # (n,) the one found now, or -1
    weight: Floats  # (n, 3) of the nearest place on it


@kernel
def facing_walls(
    surface: _Surface, near: _Lists, around: _Lists, facing: _Facing, walls: _Walls, corners: Floats
) -> int:
    """Find the walls of nodes from those that face them; return how many nodes have one.

    near: neighbours of each node; around: triangles near each node; corners (4, 3): buffer.
    """
    position, triangles = surface
    count = 0
    for node in range(len(walls.triangle)):
        best, least, before, partner = -1, np.inf, walls.before[node], facing.partner[node]
        if partner >= 0:
            for index in range(around.start[partner], around.start[partner + 1]):
                triangle = around.items[index]
                if is_beside(triangles[triangle], near, node):
                    continue
                apart = reach_triangle(position, triangles[triangle], position[node], corners)
                if apart < least:
                    best, least = triangle, apart
                    for corner in range(3):
                        walls.weight[node, corner] = corners[3, corner]
        walls.triangle[node] = -1
        if best < 0:
            continue
        ahead, agrees = stand(position, triangles[best], position[node], facing.normal[node])
        if agrees >= 0.0:
            continue
        if ahead < 0.0:
            goes_on = False
            if before >= 0:
                for corner in range(3):
                    goes_on = goes_on or is_beside(triangles[before], near, triangles[best, corner])
            if not goes_on or least >= DEEPEST * DEEPEST:
                continue
        elif least >= MARGIN * MARGIN:
            continue
        walls.triangle[node] = best
        count += 1
    for node in range(len(walls.triangle)):
        walls.before[node] = walls.triangle[node]
    return count


@kernel
def is_beside(triangle: Longs, near: _Lists, node: int) -> bool:
    """Return whether a corner of a triangle is a neighbour of a node."""
    beside = False
    for corner in range(3):
        beside = beside or is_near(near, node, triangle[corner])
    return beside


@kernel
def reach_triangle(position: Floats, triangle: Longs, point: Floats, corners: Floats) -> float:
    """Return the squared distance of a triangle from a point, m^2; write the weights of the place to corners[3]."""
    for corner in range(3):
        for axis in range(3):
            corners[corner, axis] = position[triangle[corner], axis]
    nearest_of_face(corners[:3], point, corners[3])
    apart = 0.0
    for axis in range(3):
        at = corners[3, 0] * corners[0, axis] + corners[3, 1] * corners[1, axis] + corners[3, 2] * corners[2, axis]
        apart += (point[axis] - at) ** 2
    return apart


@kernel
def stand(position: Floats, triangle: Longs, point: Floats, outward: Floats) -> tuple[float, float]:
    """Return the distance of a point in front of a triangle's plane, and the cosine to its normal, both unscaled."""
    a, b, c = position[triangle[0]], position[triangle[1]], position[triangle[2]]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    ahead = (point[0] - a[0]) * x + (point[1] - a[1]) * y + (point[2] - a[2]) * z
    return ahead, outward[0] * x + outward[1] * y + outward[2] * z


@kernel
def facing_nodes(surface: _Surface, order: Longs, near: _Lists, before: Longs, reach: float, facing: _Facing) -> int:
    """Find for each node the nearest one that faces it within reach, m; return how many have one.

    Nodes that face away from each other, through the organ, count only if they faced each other before: before (n,) >=
    0, see _Walls. order (k,): candidates, see put_in_order; near: nodes that are no partners of each node.
    """
    position, triangles = surface
    normal, partner, apart = facing
    n = len(normal)
    normal[:] = 0.0
    add_normals(position, triangles, normal)
    for node in range(n):
        size = 0.0
        for axis in range(3):
            size += normal[node, axis] ** 2
        for axis in range(3):
            normal[node, axis] /= max(size, 1e-300) ** 0.5
        partner[node], apart[node] = -1, reach * reach
    put_in_order(position, order)
    for place in range(len(order)):
        i = order[place]
        for later in range(place + 1, len(order)):
            j = order[later]
            x = position[j, 0] - position[i, 0]
            if x > reach:
                break
            y, z = position[j, 1] - position[i, 1], position[j, 2] - position[i, 2]
            square = x * x + y * y + z * z
            if square >= apart[i] and square >= apart[j]:
                continue
            ahead_i = x * normal[i, 0] + y * normal[i, 1] + z * normal[i, 2]
            ahead_j = -(x * normal[j, 0] + y * normal[j, 1] + z * normal[j, 2])
            if min(ahead_i, ahead_j) < -BEHIND * square**0.5 and before[i] < 0 and before[j] < 0:
                continue
            agrees = normal[i, 0] * normal[j, 0] + normal[i, 1] * normal[j, 1] + normal[i, 2] * normal[j, 2]
            if agrees < FACING and not is_near(near, i, j):
                if square < apart[i]:
                    apart[i], partner[i] = square, j
                if square < apart[j]:
                    apart[j], partner[j] = square, i
    count = 0
    for node in range(n):
        count += partner[node] >= 0
    return count


@kernel
def put_in_order(position: Floats, order: Longs) -> None:
    """Sort nodes, (k,), by their first coordinate, from a nearly sorted order."""
    for place in range(1, len(order)):
        node = order[place]
        here = place
        while here > 0 and position[order[here - 1], 0] > position[node, 0]:
            order[here] = order[here - 1]
            here -= 1
        order[here] = node


@kernel
def find_rooms(position: Floats, order: Longs, near: _Lists, reach: float, most: float, room: Floats) -> None:
    """Compute for each node (n,) the distance to the nearest other one minus the reach, m, except neighbours.

    most: upper limit of the result, m; order, near: see facing_nodes.
    """
    room[:] = most
    put_in_order(position, order)
    for place in range(len(order)):
        i = order[place]
        for later in range(place + 1, len(order)):
            j = order[later]
            x = position[j, 0] - position[i, 0]
            if x > reach + most:
                break
            y, z = position[j, 1] - position[i, 1], position[j, 2] - position[i, 2]
            square = x * x + y * y + z * z
            least = reach + max(room[i], room[j])
            if square < least * least and not is_near(near, i, j):
                apart = square**0.5 - reach
                room[i], room[j] = min(room[i], apart), min(room[j], apart)


@kernel
def is_near(near: _Lists, node: int, other: int) -> bool:
    """Return whether a node is in another one's sorted list."""
    low, high = near.start[node], near.start[node + 1]
    while low < high:
        middle = (low + high) // 2
        if near.items[middle] < other:
            low = middle + 1
        else:
            high = middle
    return low < near.start[node + 1] and near.items[low] == other
