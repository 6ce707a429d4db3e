"""The surface of a cut organ: the outer one, split along the cuts, and the walls of both lips."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs, Mask
from tissue_sim.errors import UserError
from tissue_sim.model.cutting.crossing import Crossing, section_of
from tissue_sim.model.cutting.holes import hole_triangles, open_edges
from tissue_sim.model.cutting.meeting_surface import SurfacePart, meeting_surface
from tissue_sim.model.cutting.parts import CutCells
from tissue_sim.model.cutting.virtual_nodes import Copies
from tissue_sim.organ.edges import CELL_FACES
from tissue_sim.organ.organ import Organ, signed_volume

MAX_LOST_VOLUME = 1e-4  # fraction of the volume that may be lost by filled holes where cuts meet


class CutSurface(NamedTuple):
    """Closed surface whose points lie in cells. p points, t triangles; the organ's surface nodes come first."""

    nodes: Longs  # (p, 4) between which each point lies; several may be the same
    weights: Floats  # (p, 4) of these, of sum 1
    triangles: Ints  # (t, 3) counter-clockwise seen from outside
    wall: Longs  # (t,) 0 for the outer surface, otherwise the number of the cut whose wall it is, from 1 on
    partner: Longs  # (p,) the point at the same place on the other side of a cut; itself if there is none
    side: Longs  # (p,) 1 or -1, side of the cut on which a point with a partner lies, otherwise 0

    def at(self, positions: Floats) -> Floats:
        """Return the points (p, 3) m, for given positions (n, 3) m of the cut organ's nodes."""
        found: Floats = np.einsum("pk,pkx->px", self.weights, positions[self.nodes])
        return found


class _Points(NamedTuple):
    """Points of a cut on edges of cells. e edges, q points."""

    key: Longs  # (e,) n times the lower node, plus the higher one; ascending
    point: Longs  # (e, 2) points on the side of the lower and of the higher node; the same where both sides meet
    nodes: Longs  # (q, 4)
    weights: Floats  # (q, 4)
    edge: Longs  # (q,) the edge of each point

    def at(self, end: Longs, other: Longs, n: int) -> tuple[Longs, Mask]:
        """Return the points on edges, on the side of the first of their nodes, and whether there is one."""
        key = np.minimum(end, other) * n + np.maximum(end, other)
        place = np.searchsorted(self.key, key).clip(0, len(self.key) - 1)
        return self.point[place, (end > other).astype(np.int64)], self.key[place] == key


def uncut_surface(organ: Organ) -> CutSurface:
    """Return the surface of an organ without cuts."""
    own = np.arange(organ.n_surface)
    weights = np.zeros((organ.n_surface, 4))
    weights[:, 0] = 1.0
    wall = np.zeros(len(organ.surface_triangles), dtype=np.int64)
    nodes = np.stack([own] * 4, axis=1)
    return CutSurface(nodes, weights, organ.surface_triangles.copy(), wall, own, np.zeros_like(own))


def cut_surface(organ: Organ, cuts: Sequence[CutCells]) -> CutSurface:
    """Return the surface of a cut organ.

    Every additional point lies on an edge of cells, or, where cuts meet, on a face or in a cell, so that neighbours
    have it in common.

    Parameters
    ----------
    organ : Organ
        The organ before.
    cuts : Sequence[CutCells]
        Cells that each cut, or group of meeting cuts, divides; no two have a node in common.

    Raises
    ------
    UserError
        If two cuts are so close that they split the same triangle, or meet where the surface can't be closed.
    """
    made = uncut_surface(organ)
    nodes, weights, triangles, wall = made.nodes, made.weights, made.triangles.astype(np.int64), made.wall
    partner, side = made.partner, made.side
    rank = np.arange(organ.n_surface)
    owner = _owners(organ)
    for cut in cuts:
        new = _one_cut(organ, cut, owner, len(nodes)) if cut.copies else _meeting_cuts(organ, cut, owner, len(nodes))
        # Triangles of the uncut organ come first; those that an earlier cut has split are marked.
        if np.any(triangles[new.gone, 0] < 0):
            raise UserError(
                "the cut comes within a triangle of an earlier one, without meeting it; move it by a millimetre"
            )
        triangles[new.gone] = -1
        nodes, weights = np.concatenate([nodes, new.nodes]), np.concatenate([weights, new.weights])
        rank = np.concatenate([rank, rank.max() + 1 + new.rank])
        partner, side = np.concatenate([partner, new.partner]), np.concatenate([side, new.side])
        triangles, wall = np.concatenate([triangles, new.triangles]), np.concatenate([wall, new.wall])
        # Cells that the mesh lacks, as they would be too flat, leave holes in the walls.
        filling = hole_triangles(triangles[triangles[:, 0] >= 0], rank)
        triangles = np.concatenate([triangles, filling])
        wall = np.concatenate([wall, np.full(len(filling), cut.numbers[0] + 1)])
    kept = triangles[:, 0] >= 0
    whole = CutSurface(nodes, weights, triangles[kept].astype(np.int32), wall[kept], partner, side)
    found = without_idle_points(whole, organ.n_surface)
    volume = signed_volume(found.at(organ.rest_positions[_sources(organ, cuts)]), found.triangles)
    if len(open_edges(triangles[kept])) or not np.isfinite(volume):
        raise UserError("the surface can't be closed at the cut; move it by a millimetre")
    if any(not cut.copies for cut in cuts):
        if not abs(volume / organ.volume - 1.0) <= MAX_LOST_VOLUME:
            raise UserError(
                "the cuts meet where cells of the organ are too flat to be divided; move it by a millimetre"
            )
    return found


def without_idle_points(surface: CutSurface, own: int) -> CutSurface:
    """Return a surface without unused points, such as those inside a front, where both sides meet.

    Parameters
    ----------
    surface : CutSurface
        The surface.
    own : int
        Number of the organ's surface nodes, which stay.
    """
    used = np.zeros(len(surface.nodes), dtype=bool)
    used[:own] = used[surface.triangles] = True
    number = np.cumsum(used) - 1
    paired = used[surface.partner]
    partner = np.where(paired, surface.partner, np.arange(len(used)))
    side = np.where(paired, surface.side, 0)
    triangles = number[surface.triangles].astype(np.int32)
    return CutSurface(
        surface.nodes[used], surface.weights[used], triangles, surface.wall, number[partner[used]], side[used]
    )


def _sources(organ: Organ, cuts: Sequence[CutCells]) -> Longs:
    """Return for each node of the cut organ the original node: itself, or that of which it is a copy."""
    return np.concatenate([np.arange(organ.n_nodes), *(cut.pieces.virtual_of for cut in cuts)])


def _one_cut(organ: Organ, cut: CutCells, owner: Longs, first: int) -> SurfacePart:
    """Return the surface at a cut that meets no other one."""
    (crossing,), copies = cut.crossings, cut.copies
    assert copies is not None
    split = _split(organ, crossing, copies, owner)
    points = _points(organ, crossing, copies, split, first)
    outer, gone = _outer(organ.surface_triangles.astype(np.int64), points, crossing.positive)
    walls = _walls(organ, crossing, points)
    partner, side = _partners(points, crossing, organ.n_nodes)
    number = cut.numbers[0] + 1
    wall = np.concatenate([np.zeros(len(outer), dtype=np.int64), np.full(len(walls), number)])
    triangles = np.concatenate([outer, walls])
    return SurfacePart(points.nodes, points.weights, triangles, wall, partner, side, points.edge, gone)


def _meeting_cuts(organ: Organ, cut: CutCells, owner: Longs, first: int) -> SurfacePart:
    """Return the surface at cuts that meet."""
    made = meeting_surface(organ, cut.crossings, cut.pieces, owner, first)
    number = np.concatenate([[0], np.array(cut.numbers) + 1])
    return made._replace(wall=number[made.wall])


def _partners(points: _Points, crossing: Crossing, n: int) -> tuple[Longs, Longs]:
    """Return the partner (q,) of each of a cut's points, and its side (q,); see CutSurface."""
    first = int(points.point.min())
    low, high = points.point.T - first
    partner, side = np.empty(len(points.nodes), dtype=np.int64), np.zeros(len(points.nodes), dtype=np.int64)
    partner[low], partner[high] = first + high, first + low
    up = np.where(crossing.positive[points.key // n], 1, -1)
    apart = low != high
    side[low[apart]], side[high[apart]] = up[apart], -up[apart]
    return partner, side


def _owners(organ: Organ) -> Longs:
    """Return the cell (t,) of which each triangle is a face; -1 where the mesh has no cell, as it would be too flat."""
    n = organ.n_nodes
    faces = _face_keys(organ.cell_nodes[:, CELL_FACES].reshape(-1, 3), n)
    order = np.argsort(faces, kind="stable")
    key = _face_keys(organ.surface_triangles, n)
    place = order[np.searchsorted(faces[order], key).clip(0, len(faces) - 1)]
    owners: Longs = np.where(faces[place] == key, place // 4, -1)
    return owners


def _face_keys(faces: Ints | Longs, n: int) -> Longs:
    corner = np.sort(faces.astype(np.int64), axis=1)
    keys: Longs = (corner[:, 0] * n + corner[:, 1]) * n + corner[:, 2]
    return keys


def _edge_keys(first: Longs, second: Longs, n: int) -> Longs:
    keys: Longs = np.minimum(first, second) * n + np.maximum(first, second)
    return keys


def _cell_edges(cells: Ints | Longs, n: int) -> Longs:
    """Return the keys of all edges of cells, each once."""
    pairs = np.array([(a, b) for a in range(4) for b in range(a)])
    quads = cells.astype(np.int64)
    return np.unique(_edge_keys(quads[:, pairs[:, 0]], quads[:, pairs[:, 1]], n))


def _lone_first(triangles: Longs, positive: Mask) -> tuple[Longs, Longs]:
    """Return which triangles have corners on both sides, and these rotated so that the single corner comes first."""
    up = positive[triangles]
    crossed = np.flatnonzero(up.any(axis=1) & ~up.all(axis=1))
    chosen, up = triangles[crossed], up[crossed]
    lone = np.argmax(up == (up.sum(axis=1) == 1)[:, None], axis=1)
    return crossed, np.take_along_axis(chosen, (lone[:, None] + np.arange(3)) % 3, axis=1)


def _split(organ: Organ, crossing: Crossing, copies: Copies, owner: Longs) -> Mask:
    """Return which triangles (t,) the cut splits: those of divided cells, and those without a cell on its path."""
    n = organ.n_nodes
    divided = np.zeros(len(organ.cell_nodes), dtype=bool)
    divided[crossing.cells] = True
    crossed, turned = _lone_first(organ.surface_triangles.astype(np.int64), crossing.positive)
    edges = np.stack([_edge_keys(turned[:, 0], turned[:, corner], n) for corner in (1, 2)], axis=1)
    split = (owner[crossed] >= 0) & divided[owner[crossed]]
    seen, end = np.divmod(copies.edges.key, n)
    open_edges = np.unique(_edge_keys(seen, end, n)[~copies.edges.closed])
    alone = ~np.isin(edges, _cell_edges(organ.cell_nodes, n))  # edges of flat cells only
    while True:
        through = np.concatenate([open_edges, edges[split][alone[split]]])
        found = split | ((owner[crossed] < 0) & np.isin(edges, through).any(axis=1))
        if np.array_equal(found, split):
            break
        split = found
    whole = np.zeros(len(organ.surface_triangles), dtype=bool)
    whole[crossed] = split
    return whole


def _points(organ: Organ, crossing: Crossing, copies: Copies, split: Mask, first: int) -> _Points:
    """Return the points of a cut: on the edges of divided cells between both sides, and of split triangles."""
    n, height = organ.n_nodes, crossing.height
    seen, end = np.divmod(copies.edges.key, n)
    _, turned = _lone_first(organ.surface_triangles[split].astype(np.int64), crossing.positive)
    outer = np.concatenate([_edge_keys(turned[:, 0], turned[:, corner], n) for corner in (1, 2)])
    key = np.unique(np.concatenate([_edge_keys(seen, end, n), outer]))
    low, high = np.divmod(key, n)
    # The copy of the lower node on the side of the higher one, and vice versa; edges that belong to no divided cell
    # have both nodes themselves.
    pair, closed = np.stack([low, high], axis=1), np.ones(len(key), dtype=bool)
    for column, one, other in ((0, low, high), (1, high, low)):
        place = np.searchsorted(copies.edges.key, one * n + other).clip(0, len(copies.edges.key) - 1)
        there = copies.edges.key[place] == one * n + other
        pair[there, column] = copies.edges.node[place[there]]
        closed[there] = copies.edges.closed[place[there]]
    part = height[low] / (height[low] - height[high])
    # An edge without any cell is open, and its points need a cell that moves them.
    alone = np.flatnonzero(~np.isin(key, _cell_edges(organ.cell_nodes, n)))
    closed[alone] = False
    edge = np.repeat(np.arange(len(key)), np.where(closed, 1, 2))
    begin = np.concatenate([[0], np.cumsum(np.where(closed, 1, 2))])[:-1]
    point = np.stack([begin, begin + ~closed], axis=1)
    nodes, weights = np.empty((len(edge), 4), dtype=np.int64), np.zeros((len(edge), 4))
    lower = np.stack([low, pair[:, 1]], axis=1)
    upper = np.stack([pair[:, 0], high], axis=1)
    for column, ends in ((0, lower), (1, upper)):
        nodes[point[:, column]] = ends[:, [0, 1, 1, 1]]
        weights[point[:, column], 0], weights[point[:, column], 1] = 1.0 - part, part
    rest = organ.rest_positions
    for lonely in alone:
        where = (1.0 - part[lonely]) * rest[low[lonely]] + part[lonely] * rest[high[lonely]]
        for mine, node in zip(point[lonely], (low[lonely], high[lonely]), strict=True):
            nodes[mine], weights[mine] = _host(organ, crossing, copies, int(node), where)
    return _Points(key, first + point, nodes, weights, edge)


def _host(organ: Organ, crossing: Crossing, copies: Copies, node: int, where: Floats) -> tuple[Longs, Floats]:
    """Return the cell or copy of a node's side next to a point that lies in none, and the point's coordinates in it."""
    divided = np.flatnonzero((organ.cell_nodes[crossing.cells] == node).any(axis=1))
    around = np.flatnonzero((organ.cell_nodes == node).any(axis=1))
    around = np.setdiff1d(around, crossing.cells)
    own = copies.above if crossing.positive[node] else copies.below
    cells = np.concatenate([organ.cell_nodes[crossing.cells[divided]], organ.cell_nodes[around]]).astype(np.int64)
    corner = organ.rest_positions[cells]
    found = np.linalg.solve((corner[:, 1:] - corner[:, :1]).transpose(0, 2, 1), (where - corner[:, 0])[:, :, None])
    coordinates = np.concatenate([1.0 - found.sum(axis=1), found[:, :, 0]], axis=1)
    best = int(np.argmax(coordinates.min(axis=1)))
    return np.concatenate([own[divided], organ.cell_nodes[around]])[best], coordinates[best]


def _outer(triangles: Longs, points: _Points, positive: Mask) -> tuple[Longs, Longs]:
    """Return the triangles that replace those (k, 3) with points of a cut, and which are replaced."""
    n = len(positive)
    crossed, turned = _lone_first(triangles, positive)
    a, b, c = turned.T
    (p, on_p), (q, on_q) = points.at(a, b, n), points.at(a, c, n)
    (far_p, _), (far_q, _) = points.at(b, a, n), points.at(c, a, n)
    both, first, second = on_p & on_q, on_p & ~on_q, on_q & ~on_p
    made = [
        np.stack(corners, axis=1)[chosen]
        for chosen, corners in (
            (both, (a, p, q)),
            (both, (far_p, b, c)),
            (both, (far_p, c, far_q)),
            (first, (a, p, c)),
            (first, (p, b, c)),
            (second, (a, b, q)),
            (second, (q, b, c)),
        )
    ]
    return np.concatenate(made), crossed[on_p | on_q]


def _walls(organ: Organ, crossing: Crossing, points: _Points) -> Longs:
    """Return the triangles of both walls of a cut, without those where its sides meet."""
    quads = organ.cell_nodes[crossing.cells].astype(np.int64)
    pairs = section_of(crossing.positive[quads])
    row = np.arange(len(quads))[:, None]
    up, down = quads[row, pairs[:, :, 0]], quads[row, pairs[:, :, 1]]
    above = points.at(up, down, organ.n_nodes)[0]
    below = points.at(down, up, organ.n_nodes)[0]
    made = []
    for corners in ([0, 1, 2], [0, 2, 3]):
        one, other = above[:, corners], below[:, corners]
        real = (one[:, 1] != one[:, 2]) & (one != other).any(axis=1)
        made += [one[real], other[real][:, ::-1]]
    return np.concatenate(made)
