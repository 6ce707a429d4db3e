"""Tetrahedra some of whose faces lie on the sheet of a cut, and the same with these faces doubled.

Nodes near the sheet are moved onto it, and edges that cross it are bisected there; so is what crosses the cut's front
within the sheet. Every tetrahedron then lies on one side.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tissue_sim.array_types import Floats, Longs, Mask
from tissue_sim.model.cutting.sheet import Sheet
from tissue_sim.organ.edges import CELL_FACES, cell_edges

SNAP, SNAP_FRONT = 0.4, 0.3  # of a node's shortest edge, from which it is moved onto the sheet, and onto its front
LEAST_VOLUME = 0.15  # of an element's volume, which it keeps when a corner is moved
ON = 0.12  # of an edge, within which a node that can't be moved counts as on the sheet, or on the front
STEP = 1e-6  # m, for slopes
ROUNDS = 3  # of Newton's method and of regula falsi


class Mesh(NamedTuple):
    """Tetrahedra with faces on a sheet."""

    points: Floats  # (p, 3) m
    cells: Longs  # (c, 4)
    walls: Longs  # (w, 3) faces on the sheet that the cut covers, corners ascending


class Opened(NamedTuple):
    """A mesh whose walls are doubled. d nodes are; new ones are appended."""

    points: Floats  # (p + d, 3) m
    cells: Longs  # (c, 4)
    original: Longs  # (p + d,) the node of the mesh before
    walls: Longs  # (w, 3) as in Mesh
    below: Longs  # (d,) nodes on the sheet's negative side
    above: Longs  # (d,) those that lie upon them, on the positive one


def split(points: Floats, cells: Longs, sheet: Sheet, still: Mask) -> Mesh:
    """Return tetrahedra with faces on a sheet.

    points (p, 3) m: nodes; cells (c, 4): tetrahedra; still (p,): nodes of the boundary that must stay where they are,
    and on their side of the sheet. Returns the mesh; the nodes keep their numbers.
    """
    points, cells = points.copy(), _upright(points, cells.astype(np.int64))
    fronts = _Fronts(sheet)
    shortest = _shortest(points, cells)
    margin = 2.5 * float(np.median(shortest[_near(fronts, points, 0.0)])) if _near(fronts, points, 0.0).any() else 0.0
    near = _near(fronts, points, margin)
    on = np.zeros(len(points), dtype=bool)
    outer = np.zeros(len(points), dtype=bool)
    outer[np.unique(_outer_faces(cells))] = True
    _snap(points, cells, fronts, near & ~outer, on)
    across = fronts.across(points)
    on |= near & ~still & (np.abs(across) < ON * shortest)
    points, cells, on = _bisected_across(points, cells, on, fronts, margin)
    points, cells, on = _bisected_at_fronts(points, cells, on, fronts)
    points, cells, walls = _openable(points, cells, on, fronts)
    return Mesh(points, _upright(points, cells), walls)


class _Fronts:
    """A sheet as functions of the place: 0 on it, and 0 on each of its three fronts, below 0 within them."""

    def __init__(self, sheet: Sheet) -> None:
        self.sheet = sheet
        self._length = float(np.linalg.norm(np.diff(sheet.flat, axis=0), axis=1).sum())

    def across(self, points: Floats) -> Floats:
        """Return the distances (k,) m from the sheet, with its sign."""
        return self.sheet.place(points).across

    def values(self, points: Floats) -> Floats:
        """Return all functions (k, 4) m."""
        place = self.sheet.place(points)
        return np.stack(
            [place.across, place.along - self._length, -place.along, place.below - self.sheet.depth], axis=1
        )

    def slopes(self, points: Floats) -> Floats:
        """Return their gradients (k, 4, 3)."""
        directions = STEP * np.eye(3)
        return np.stack(
            [
                (self.values(points + direction) - self.values(points - direction)) / (2.0 * STEP)
                for direction in directions
            ],
            axis=2,
        )

    def covers(self, points: Floats, more: float = 0.0) -> Mask:
        """Return which points (k,) of the sheet the cut reaches."""
        return self.sheet.covers(self.sheet.place(points), more)


def _near(fronts: _Fronts, points: Floats, margin: float) -> Mask:
    """Return which points (k,) lie over the cut or within a margin of it, however far across."""
    return fronts.covers(points, margin)


def _upright(points: Floats, cells: Longs) -> Longs:
    """Return tetrahedra turned so that their volumes are positive."""
    turned = _volumes(points, cells) < 0.0
    cells = cells.copy()
    cells[turned] = cells[turned][:, [1, 0, 2, 3]]
    return cells


def _volumes(points: Floats, cells: Longs) -> Floats:
    corner = points[cells]
    a, b, c = (corner[:, k] - corner[:, 0] for k in (1, 2, 3))
    volumes: Floats = np.einsum("cx,cx->c", np.cross(a, b), c) / 6.0
    return volumes


def _edges(cells: Longs) -> Longs:
    """Return the edges (e, 2), each once."""
    return np.unique(np.sort(cell_edges(cells), axis=1), axis=0)


def _shortest(points: Floats, cells: Longs) -> Floats:
    """Return the length (p,) m of the shortest edge at each node."""
    edges = _edges(cells)
    length = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    found = np.full(len(points), np.inf)
    for end in edges.T:
        np.minimum.at(found, end, length)
    return found


def _outer_faces(cells: Longs) -> Longs:
    """Return the faces (f, 3) of one tetrahedron only."""
    faces, count = np.unique(np.sort(cells[:, CELL_FACES].reshape(-1, 3), axis=1), axis=0, return_counts=True)
    return faces[count == 1]


def _snap(points: Floats, cells: Longs, fronts: _Fronts, movable: Mask, on: Mask) -> None:
    """Move nodes onto the sheet, and those beside its front onto that, where the elements around them allow it."""
    shortest = _shortest(points, cells)
    chosen = np.flatnonzero(movable & (np.abs(fronts.across(points)) < SNAP * shortest))
    if not len(chosen):
        return
    size = shortest[chosen]
    value = fronts.values(points[chosen])
    close = value[:, 1:] < SNAP_FRONT * size[:, None]
    at_front = (np.abs(value[:, 1:]) < SNAP_FRONT * size[:, None]) & close.all(axis=1)[:, None]
    onto = [_moved(points[chosen], fronts, np.zeros_like(at_front)), _moved(points[chosen], fronts, at_front)]
    order = np.argsort(cells.ravel(), kind="stable")
    begin = np.searchsorted(cells.ravel()[order], np.arange(len(points) + 1))
    for row, node in enumerate(chosen):
        around = cells[order[begin[node] : begin[node + 1]] // 4]
        old, least = points[node].copy(), LEAST_VOLUME * _volumes(points, around)
        for target in (onto[1][row], onto[0][row]):
            points[node] = target
            if np.linalg.norm(target - old) < size[row] and np.all(_volumes(points, around) >= least):
                on[node] = True
                break
            points[node] = old


def _moved(points: Floats, fronts: _Fronts, at_front: Mask) -> Floats:
    """Return the nearest points (k, 3) on the sheet, and on those fronts (k, 3) that are chosen."""
    points = points.copy()
    wanted = np.concatenate([np.ones((len(points), 1), dtype=bool), at_front], axis=1)
    for _ in range(ROUNDS):
        slopes = fronts.slopes(points) * wanted[:, :, None]
        value = fronts.values(points) * wanted
        square = np.einsum("kax,kbx->kab", slopes, slopes) + np.eye(4) * np.where(wanted, 1e-9, 1.0)[:, None, :]
        points -= np.einsum("kax,ka->kx", slopes, np.linalg.solve(square, value[:, :, None])[:, :, 0])
    return points


def _bisected(points: Floats, cells: Longs, edges: Longs, middles: Floats) -> tuple[Floats, Longs]:
    """Split edges (k, 2) at given points (k, 3), one after another: every tetrahedron around one becomes two."""
    made = [tuple(cell) for cell in cells.tolist()]
    around: list[set[int]] = [set() for _ in range(len(points))]
    for index, cell in enumerate(made):
        for node in cell:
            around[node].add(index)
    for number, (a, b) in enumerate(edges.tolist(), len(points)):
        around.append(set())
        for index in sorted(around[a] & around[b]):
            cell = made[index]
            made[index] = tuple(number if node == b else node for node in cell)
            made.append(tuple(number if node == a else node for node in cell))
            around[b].discard(index)
            around[a].discard(len(made) - 1)
            for node in made[index]:
                around[node].add(index)
            for node in made[-1]:
                around[node].add(len(made) - 1)
    return np.concatenate([points, middles]), np.array(made, dtype=np.int64)


def _bisected_across(
    points: Floats, cells: Longs, on: Mask, fronts: _Fronts, margin: float
) -> tuple[Floats, Longs, Mask]:
    """Split the edges that cross the sheet in the cut, or within a margin of it."""
    across = np.where(on, 0.0, fronts.across(points))
    edges = _edges(cells)
    edges = edges[across[edges[:, 0]] * across[edges[:, 1]] < 0.0]
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    low, high = np.zeros(len(edges)), np.ones(len(edges))
    at_low, at_high = across[edges[:, 0]], across[edges[:, 1]]
    middle = a
    for _ in range(ROUNDS):  # the sheet may be bent between two nodes
        part = low + (high - low) * at_low / (at_low - at_high)
        middle = a + part[:, None] * (b - a)
        value = fronts.across(middle)
        same = np.sign(value) == np.sign(at_low)
        low, at_low = np.where(same, part, low), np.where(same, value, at_low)
        high, at_high = np.where(same, high, part), np.where(same, at_high, np.where(value == 0.0, 1e-30, value))
    kept = fronts.covers(middle, margin)
    points, cells = _bisected(points, cells, edges[kept], middle[kept])
    return points, cells, np.concatenate([on, np.ones(int(kept.sum()), dtype=bool)])


def _bisected_at_fronts(points: Floats, cells: Longs, on: Mask, fronts: _Fronts) -> tuple[Floats, Longs, Mask]:
    """Split the edges within the sheet that cross its front."""
    for which in (1, 2, 3):
        value = fronts.values(points)[:, which]
        edges = _edges(cells)
        edges = edges[on[edges].all(axis=1)]
        first, last = value[edges[:, 0]], value[edges[:, 1]]
        least = ON * np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
        crossing = (first * last < 0.0) & (np.abs(first) > least) & (np.abs(last) > least)
        edges, first, last = edges[crossing], first[crossing], last[crossing]
        part = (first / (first - last))[:, None]
        middle = points[edges[:, 0]] * (1.0 - part) + points[edges[:, 1]] * part
        kept = fronts.covers(middle, 1e-5)
        points, cells = _bisected(points, cells, edges[kept], middle[kept])
        on = np.concatenate([on, np.ones(int(kept.sum()), dtype=bool)])
    return points, cells, on


def _walls(points: Floats, cells: Longs, on: Mask, fronts: _Fronts) -> Longs:
    """Return the faces (w, 3) on the sheet between tetrahedra of both sides that the cut covers."""
    across = np.where(on, 0.0, fronts.across(points))
    side = np.where(across[cells].sum(axis=1) < 0.0, -1, 1)
    here = np.flatnonzero(on[cells].sum(axis=1) >= 3)
    faces = np.sort(cells[here][:, CELL_FACES].reshape(-1, 3), axis=1)
    faces, place, count = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    total = np.bincount(place.ravel(), np.repeat(side[here], 4))
    between = (count == 2) & (total == 0) & on[faces].all(axis=1)
    faces = faces[between]
    return faces[fronts.covers(points[faces].mean(axis=1))]


def _openable(points: Floats, cells: Longs, on: Mask, fronts: _Fronts) -> tuple[Floats, Longs, Longs]:
    """Split edges of walls both of whose ends lie on the front, where the walls could not part; return walls too."""
    for _ in range(ROUNDS):
        walls = _walls(points, cells, on, fronts)
        edges, count = _edge_counts(walls)
        outer = _edge_counts(_outer_faces(cells))[0]
        rim = edges[(count == 1) & ~_is_in(edges, outer, len(points))]
        front = np.zeros(len(points), dtype=bool)
        front[rim.ravel()] = True
        tight = edges[(count == 2) & front[edges].all(axis=1)]
        if not len(tight):
            break
        points, cells = _bisected(points, cells, tight, points[tight].mean(axis=1))
        on = np.concatenate([on, np.ones(len(tight), dtype=bool)])
    return points, cells, _walls(points, cells, on, fronts)


def _edge_counts(triangles: Longs) -> tuple[Longs, Longs]:
    """Return the edges (e, 2) of triangles, and of how many triangles (e,) each is."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1)
    found, count = np.unique(edges, axis=0, return_counts=True)
    return found, count


def _is_in(edges: Longs, others: Longs, n: int) -> Mask:
    """Return which edges (e,) are among others."""
    return np.isin(edges[:, 0] * n + edges[:, 1], others[:, 0] * n + others[:, 1])


def opened(mesh: Mesh, sheet: Sheet) -> Opened:
    """Return a mesh whose walls are doubled, so that the two sides part there.

    sheet: the sheet on which its walls lie. Returns the mesh; nodes on the front stay single.
    """
    n, cells = len(mesh.points), mesh.cells
    mine = np.zeros(n, dtype=bool)
    mine[np.unique(mesh.walls)] = True
    around = np.flatnonzero(mine[cells].any(axis=1))
    corner = np.full(cells.shape, -1, dtype=np.int64)
    place = mine[cells]
    corner[place] = np.arange(int(place.sum()))
    links = np.concatenate([*_links(cells, around, corner, mesh.walls, n)], axis=0)
    size = int(place.sum())
    joined = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(size, size))
    label = connected_components(joined, directed=False)[1]
    node = cells[place]
    parts, first = np.unique(label, return_index=True)
    owner = node[first]
    # The first part of a node keeps its number.
    order = np.argsort(owner, kind="stable")
    repeated = np.zeros(len(parts), dtype=bool)
    repeated[order[1:]] = owner[order[1:]] == owner[order[:-1]]
    number = owner.copy()
    number[repeated] = n + np.arange(int(repeated.sum()))
    made = cells.copy()
    made[place] = number[label]
    original = np.concatenate([np.arange(n), owner[repeated]])
    points = mesh.points[original]
    across = sheet.place(mesh.points[cells].mean(axis=1)).across
    side = np.bincount(label, np.repeat(np.sign(across), 4).reshape(-1, 4)[place])
    new, old = number[repeated], owner[repeated]
    first_side = np.zeros(n)
    first_side[owner[~repeated]] = side[~repeated]
    up = side[repeated] > first_side[old]
    return Opened(points, made, original, mesh.walls, np.where(up, old, new), np.where(up, new, old))


def _links(cells: Longs, around: Longs, corner: Longs, walls: Longs, n: int) -> Iterator[Longs]:
    """Yield pairs (k, 2) of corners of one node in neighbours whose common face is not a wall."""
    faces = np.sort(cells[around][:, CELL_FACES].reshape(-1, 3), axis=1)
    keys = (faces[:, 0] * n + faces[:, 1]) * n + faces[:, 2]
    shut = np.isin(keys, (walls[:, 0] * n + walls[:, 1]) * n + walls[:, 2])
    order = np.argsort(keys, kind="stable")
    order = order[~shut[order]]
    twin = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    one, other = order[twin], order[twin + 1]
    for column in range(3):
        node = faces[one, column]
        ends = []
        for face in (one, other):
            cell = around[face // 4]
            ends.append(corner[cell, np.argmax(cells[cell] == node[:, None], axis=1)])
        found = np.stack(ends, axis=1)
        yield found[found[:, 0] >= 0]
    own = np.unique(corner[corner >= 0])
    yield np.stack([own, own], axis=1)
