"""Finds where organs of a scene touch each other or themselves, or may before the next search: nodes near triangles."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Longs
from tissue_sim.contact.self_finder import SelfFinder
from tissue_sim.contact.triangles import nearest_weights
from tissue_sim.model.pairs import MOST_PAIRS, PairSet, pair_set
from tissue_sim.organ.organ import Organ

MARGIN = 0.003  # m from a surface within which a node is looked at
DEEPEST = 0.01  # m that a node may lie inside
NEAREST = 6  # triangles by their middles, of which the nearest is taken


@dataclass
class PairCounters:
    """What was looked for, and what could be left out."""

    searches: int = 0
    far_skips: int = 0  # pairs of organs whose boxes miss each other
    dropped: int = 0  # pairs of nodes and triangles that there was no room for


class PairFinder:
    """Finds pairs of organs, where they lie at rest (k of them)."""

    def __init__(self, organs: Sequence[Organ]) -> None:
        self.counters = PairCounters()
        self._triangles = [np.ascontiguousarray(organ.surface_triangles, dtype=np.int64) for organ in organs]
        self._sizes = [organ.n_surface for organ in organs]
        self._own = [SelfFinder(organ) for organ in organs]
        self._found = pair_set()

    def forget(self) -> None:
        """Organs have jumped."""
        for one in self._own:
            one.forget()

    def find(self, positions: Sequence[Floats], own: Sequence[bool] = ()) -> PairSet:
        """The pairs of surfaces at positions, (n, 3) m each in one frame; written anew by the next call.

        own (k,): which organs may touch themselves, by default none.
        """
        found = self._found
        found.found[0] = 0
        points = [np.asarray(p[:size]) for p, size in zip(positions, self._sizes, strict=True)]
        boxes = [(p.min(axis=0), p.max(axis=0)) for p in points]
        for first, second in itertools.product(range(len(points)), repeat=2):  # in the order of a set
            if first == second:
                if own and own[first]:
                    self._put(first, first, *self._own[first].find(points[first]))
                continue
            self.counters.searches += 1
            low, high = boxes[second][0] - MARGIN, boxes[second][1] + MARGIN
            if np.any(boxes[first][0] > high) or np.any(boxes[first][1] < low):
                self.counters.far_skips += 1
                continue
            near = np.flatnonzero(np.all((points[first] >= low) & (points[first] <= high), axis=1))
            if len(near):
                self._add(first, second, near, points)
        return found

    def _add(self, first: int, second: int, near: Longs, points: Sequence[Floats]) -> None:
        triangles, surface = self._triangles[second], points[second]
        corners = surface[triangles]
        apart, which = cKDTree(corners.mean(axis=1)).query(points[first][near], k=min(NEAREST, len(triangles)))
        close = apart[:, 0] < DEEPEST + np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
        near, which = near[close], which[close]
        if not len(near):
            return
        k = which.shape[1]
        weights, distance = nearest_weights(corners[which.ravel()], np.repeat(points[first][near], k, axis=0))
        best = distance.reshape(-1, k).argmin(axis=1)
        row = np.arange(len(near)) * k + best
        chosen, weights, distance = which.ravel()[row], weights[row], distance[row]
        normal = _normals(corners[chosen])
        way = points[first][near] - np.einsum("kc,kcx->kx", weights, corners[chosen])
        outside = np.einsum("kx,kx->k", way, normal) >= 0.0
        kept = np.flatnonzero(distance < np.where(outside, MARGIN, DEEPEST))
        if len(kept) > MOST_PAIRS:  # the nearest ones
            self.counters.dropped += len(kept) - MOST_PAIRS
            kept = np.sort(kept[np.argsort(distance[kept], kind="stable")[:MOST_PAIRS]])
        self._put(first, second, np.column_stack([near[kept], triangles[chosen[kept]]]), weights[kept])

    def _put(self, first: int, second: int, nodes: Longs, weights: Floats) -> None:
        """Add pairs of two organs, nodes (p, 4), weights (p, 3), as far as there is room."""
        found = self._found
        start = int(found.found[0])
        count = min(len(nodes), MOST_PAIRS - start)
        self.counters.dropped += len(nodes) - count
        rows = slice(start, start + count)
        found.organ[rows], found.node[rows], found.weight[rows] = (first, second), nodes[:count], weights[:count]
        found.found[0] = rows.stop


def _normals(corners: Floats) -> Floats:
    """Outward normals (k, 3) of triangles (k, 3, 3), not of length 1."""
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
