"""Search for contact of organs with each other or themselves until the next search: nodes near triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs, Mask
from tissue_sim.contact.broad_phase import NearTriangles, approach, surface_box, triangles_in_box
from tissue_sim.contact.self_contact_finder import SelfFinder
from tissue_sim.contact.touched_surface import TouchedSurface
from tissue_sim.contact.triangles import nearest_among
from tissue_sim.model.stepping.contact_pairs import MAX_CUT_POINTS, MAX_PAIRS, OrganContactSet, organ_contact_set
from tissue_sim.organ.organ import Organ

MARGIN = 0.003  # m from a surface within which a node is examined
DEEPEST = 0.01  # m, largest depth of a node inside
STALE = 0.002  # m of approach after which all nodes are examined again
OPEN = 5e-4  # m, least distance between the walls of a cut at a triangle's corner at which it is touched


@dataclass
class PairCounters:
    """Counts of searches, and of those that could be skipped."""

    searches: int = 0
    far_skips: int = 0  # pairs of organs whose boxes don't overlap
    apart_skips: int = 0  # pairs of organs that have approached by less than their distance at the last search
    dropped: int = 0  # pairs of nodes and triangles that didn't fit into the set


class _Apart(NamedTuple):
    """Approach of two surfaces, (n, 3) and (m, 3) m, before a node of the first is near, (n,) m."""

    room: Floats
    first: Floats
    second: Floats


class _Touched(NamedTuple):
    """Triangles of a surface that are touched."""

    triangles: Longs  # (t, 3)
    loose: Mask  # (t,) see TouchedSurface.is_loose


class OrganContactFinder:
    """Finder of contacts between k organs, given in their places at rest.

    Lips of a cut are touched like the rest of the surface, and walls where the cut is open: where it is closed, they
    coincide inside the organ.
    """

    def __init__(self, organs: Sequence[Organ | TouchedSurface]) -> None:
        self.counters = PairCounters()
        self._surfaces = [TouchedSurface.of(one) for one in organs]
        self._versions = [0] * len(organs)
        self._triangles = [surface.triangles.astype(np.int64) for surface in self._surfaces]
        self._own = [SelfFinder(surface) for surface in self._surfaces]
        self._low, self._high = np.zeros((2, len(organs), 3))
        self._near = [np.zeros_like(triangles) for triangles in self._triangles]  # buffer
        self._numbers = [np.zeros(len(triangles), dtype=np.int64) for triangles in self._triangles]  # buffer
        self._now: list[_Touched] = []
        self._apart: dict[tuple[int, int], _Apart] = {}
        self._found = organ_contact_set()

    @property
    def versions(self) -> list[int]:
        """Number of the cut that made the surface of each organ; 0 before the first one."""
        return self._versions

    def exchange(self, organ: int, touched: Organ | TouchedSurface, version: int) -> None:
        """Use the new surface of an organ after a cut.

        Parameters
        ----------
        organ : int
            Index of the organ.
        touched : Organ | TouchedSurface
            The surface.
        version : int
            Number of the cut.
        """
        surface = TouchedSurface.of(touched)
        triangles = surface.triangles.astype(np.int64)
        self._surfaces[organ], self._versions[organ] = surface, version
        self._triangles[organ], self._own[organ] = triangles, SelfFinder(surface)
        self._near[organ], self._numbers[organ] = np.zeros_like(triangles), np.zeros(len(triangles), dtype=np.int64)
        self._apart = {pair: found for pair, found in self._apart.items() if organ not in pair}

    def forget(self) -> None:
        """Discard earlier searches after organs have jumped."""
        for one in self._own:
            one.forget()

    def find(self, positions: Sequence[Floats], own: Sequence[bool] = ()) -> OrganContactSet:
        """Return the pairs of surfaces; they are overwritten by the next call.

        Parameters
        ----------
        positions : Sequence[Floats], one array of shape (n, 3) for each, m
            Positions in one frame: of an organ with cuts of all nodes, else at least of those of its surface.
        own : Sequence[bool], shape (k,), optional
            Which organs may touch themselves; by default none.
        """
        found = self._found
        found.found[0] = found.points[0] = 0
        points = [
            np.ascontiguousarray(one.at(now)[: one.n_points])
            for one, now in zip(self._surfaces, positions, strict=True)
        ]
        self._now = [self._touched(organ, now) for organ, now in enumerate(points)]
        for organ, surface in enumerate(points):
            surface_box(surface, len(surface), self._low[organ], self._high[organ])
        low, high = self._low - MARGIN, self._high + MARGIN
        meet = np.all((self._low[:, None] <= high) & (self._high[:, None] >= low), axis=2)
        np.fill_diagonal(meet, False)
        searches = len(points) * (len(points) - 1)
        self.counters.searches += searches
        self.counters.far_skips += searches - int(meet.sum())
        np.fill_diagonal(meet, list(own) or False)
        for first, second in np.argwhere(meet).tolist():  # in the order of a set
            if first == second:
                self._put(first, first, *self._own[first].find(points[first][: self._surfaces[first].n_surface]))
            else:
                self._add(first, second, points)
        for organ, touched in enumerate(self._surfaces):
            if touched.is_cut:
                self._name_points(organ, touched)
        return found

    def _touched(self, organ: int, points: Floats) -> _Touched:
        """Return the triangles of a surface that are touched, from its points: all but walls of a closed cut."""
        surface, triangles = self._surfaces[organ], self._triangles[organ]
        if not surface.is_cut:
            return _Touched(triangles, surface.is_loose)
        apart = np.linalg.norm(points - points[surface.partner], axis=1)
        open_there = surface.is_outer | (apart[triangles].max(axis=1) >= OPEN)
        return _Touched(np.ascontiguousarray(triangles[open_there]), surface.is_loose[open_there])

    def _name_points(self, organ: int, surface: TouchedSurface) -> None:
        """Add the cut points of an organ to the set, to which pairs refer by their numbers in its surface."""
        found = self._found
        count, start = int(found.found[0]), int(found.points[0])
        node = found.node[:count]
        made = np.zeros(node.shape, dtype=bool)
        made[:, :1] = found.organ[:count, :1] == organ
        made[:, 1:] = found.organ[:count, 1:] == organ
        made &= node >= surface.n_surface
        numbers = np.unique(node[made])[: MAX_CUT_POINTS - start]
        rows = slice(start, start + len(numbers))
        found.point_organ[rows], found.point_version[rows] = organ, self._versions[organ]
        found.point_number[rows] = numbers
        found.point_node[rows], found.point_weight[rows] = surface.nodes_of(numbers)
        found.points[0] = rows.stop
        named = ~made | np.isin(node, numbers)
        node[made] = -1 - start - np.searchsorted(numbers, node[made])
        if not named.all():
            kept = np.flatnonzero(named.all(axis=1))
            self.counters.dropped += count - len(kept)
            for rows_of_pairs in (found.organ, found.node, found.weight):
                rows_of_pairs[: len(kept)] = rows_of_pairs[kept]
            found.found[0] = len(kept)

    def _add(self, first: int, second: int, points: Sequence[Floats]) -> None:
        """Add pairs of a node of one surface and a triangle of the other; of a cut surface, points replace nodes.

        The touched walls change while cuts open, so nothing is skipped if a surface has cuts.
        """
        nodes, surface = points[first], points[second]
        changes = self._surfaces[first].is_cut or self._surfaces[second].is_cut
        last = self._apart.get((first, second))
        nearer = np.inf if last is None else approach(nodes, last.first, surface, last.second)
        if last is not None and nearer <= STALE:
            near = np.flatnonzero(last.room <= nearer)
            if len(near) == 0:
                self.counters.apart_skips += 1
                return
        else:
            low, high = self._low[second] - DEEPEST, self._high[second] + DEEPEST
            near = np.flatnonzero(np.all((nodes >= low) & (nodes <= high), axis=1))
        triangles, weights, distance = self._nearest(second, nodes[near], surface)
        corners = surface[triangles]
        way = nodes[near] - np.einsum("kc,kcx->kx", weights, corners)
        outside = np.einsum("kx,kx->k", way, _normals(corners)) >= 0.0
        room = distance - np.where(outside, MARGIN, DEEPEST)
        if nearer > STALE and not changes:
            every = np.full(len(nodes), DEEPEST - MARGIN)
            every[near] = room
            self._apart[first, second] = _Apart(every, nodes.copy(), surface.copy())
        kept = np.flatnonzero(room < 0.0)
        if len(kept) > MAX_PAIRS:  # the nearest ones
            self.counters.dropped += len(kept) - MAX_PAIRS
            kept = np.sort(kept[np.argsort(distance[kept], kind="stable")[:MAX_PAIRS]])
        self._put(first, second, np.column_stack([near[kept], triangles[kept]]), weights[kept])

    def _nearest(self, second: int, nodes: Floats, surface: Floats) -> tuple[Longs, Floats, Floats]:
        """Return for nodes (k, 3) m the nearest place of a surface (m, 3) m: triangles (k, 3), weights and distances.

        Weights are (k, 3), distances (k,) m. A place farther than DEEPEST may be replaced by another that is, too.
        """
        triangles, count = self._near[second], 0
        if len(nodes):
            low, high = nodes.min(axis=0) - DEEPEST, nodes.max(axis=0) + DEEPEST
            room = NearTriangles(triangles, self._numbers[second])
            count, _ = triangles_in_box(surface, surface, self._now[second].triangles, low, high, room)
        if count == 0:
            return np.zeros((len(nodes), 3), dtype=np.int64), np.zeros((len(nodes), 3)), np.full(len(nodes), DEEPEST)
        chosen, weights, distance = nearest_among(surface[triangles[:count]], nodes)
        if self._surfaces[second].is_cut:  # too many nodes lie under a loose triangle to share a force
            loose = np.flatnonzero(self._now[second].loose[self._numbers[second][chosen]])
            weights[loose] = np.eye(3)[np.argmax(weights[loose], axis=1)]
        return triangles[chosen], weights, distance

    def _put(self, first: int, second: int, nodes: Longs, weights: Floats) -> None:
        """Add pairs of two organs, nodes (p, 4), weights (p, 3), as far as they fit."""
        found = self._found
        start = int(found.found[0])
        count = min(len(nodes), MAX_PAIRS - start)
        self.counters.dropped += len(nodes) - count
        rows = slice(start, start + count)
        found.organ[rows], found.node[rows], found.weight[rows] = (first, second), nodes[:count], weights[:count]
        found.found[0] = rows.stop


def _normals(corners: Floats) -> Floats:
    """Return the outward normals (k, 3) of triangles (k, 3, 3), not normalised."""
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
