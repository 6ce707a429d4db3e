"""ChainMail: geometric limits that pass a displacement on from node to node, then relaxation.

Gibson, 3D ChainMail: a fast algorithm for deforming volumetric objects (1997), on the edges of tetrahedra instead of a
grid, with the limits of Li and Brodlie, Soft object modelling with generalised ChainMail (2003): node j, whose rest
offset from its neighbour i is d, stays on each axis within (1 -+ STRETCH) d -+ SHEAR (|d| on the other two axes). On a
grid this is Gibson's: along a link it may stretch, across it shear.

It has no forces. Loaded nodes are moved to where the reference has them, and the rest follows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs, Mask
from tissue_sim.bench.peers.engine import Answer, Load, timed
from tissue_sim.bench.timing import Burst, time_calls
from tissue_sim.jit import kernel
from tissue_sim.organ.organ import Organ

STRETCH, SHEAR = 0.1, 0.1  # largest relative stretch or compression of a link, and its shear
SWEEPS = 5000  # of relaxation at most
STILL = 1e-5  # fraction of the displacement: a sweep that moves no node by more has converged
UPDATE = 0.001  # s of an update, which is done once per tick
SWELLING = 200  # updates in which a load rises and falls


class Links(NamedTuple):
    """Neighbours of each of n nodes, as compressed rows."""

    start: Longs  # (n + 1,)
    neighbours: Longs


class ChainMail:
    """Nodes linked by edges; the organ's fixed nodes are held.

    nodes (n, 3) m: nodes at rest, the organ's surface first; edges (e, 2): node indices.
    """

    def __init__(self, organ: Organ, nodes: Floats, edges: Ints) -> None:
        self.organ = organ
        self.update = UPDATE
        self.rest = np.ascontiguousarray(nodes)
        self.position = self.rest.copy()
        self.links = linked(len(nodes), edges)
        self._held = np.zeros(len(nodes), dtype=np.bool_)
        self._held[organ.fixed] = True
        none = np.zeros(0, dtype=np.int64)
        self.move(none, np.zeros((0, 3)))  # compiles, before anything is timed
        self.relax(none)

    def move(self, nodes: Longs, displacement: Floats) -> None:
        """Move nodes (k,) by displacements (k, 3) m from rest, and propagate it, from held nodes too."""
        self.position[nodes] = self.rest[nodes] + displacement
        driven = self._held.copy()
        driven[nodes] = True
        sources = np.concatenate([nodes, np.flatnonzero(self._held)])
        pass_on(self.position, self.rest, self.links, driven, sources)

    def relax(self, nodes: Longs) -> float:
        """Do one sweep of relaxation about the moved nodes (k,); return the largest motion of a node, m."""
        free = ~self._held
        free[nodes] = False
        return float(relax(self.position, self.rest, self.links, np.flatnonzero(free)))

    def settle(self, load: Load) -> Answer:
        """Propagate and relax until nothing moves."""
        self.position[:] = self.rest
        nodes, displacement = moved_by(load)
        still = STILL * float(np.abs(displacement).max(initial=0.0))
        moves: list[float] = []

        def work() -> None:
            self.move(nodes, displacement)
            while len(moves) < SWEEPS and (not moves or moves[-1] > still):
                moves.append(self.relax(nodes))

        seconds = timed(work)
        return Answer((self.position - self.rest)[: self.organ.n_surface], seconds, moves[-1] <= still)

    def burst(self, load: Load) -> Burst:
        """Return updates: the loaded nodes rise and fall, the limits propagate it, and one sweep relaxes it."""
        nodes, displacement = moved_by(load)
        count = 0

        def update() -> None:
            nonlocal count
            count += 1
            self.move(nodes, 0.5 * (1.0 - np.cos(2.0 * np.pi * count / SWELLING)) * displacement)
            self.relax(nodes)

        return lambda times: time_calls(update, times)


def moved_by(load: Load) -> tuple[Longs, Floats]:
    """Return the loaded nodes (k,), and their displacements in the reference, (k, 3) m."""
    return load.nodes, load.reached[load.nodes]


def linked(count: int, edges: Ints) -> Links:
    """Return the neighbours of each of so many nodes along edges (e, 2)."""
    both = np.unique(np.concatenate([edges, edges[:, ::-1]]).astype(np.int64), axis=0)
    start = np.searchsorted(both[:, 0], np.arange(count + 1)).astype(np.int64)
    return Links(start, np.ascontiguousarray(both[:, 1]))


@kernel
def pass_on(position: Floats, rest: Floats, links: Links, driven: Mask, sources: Longs) -> None:
    """Propagate displacements, (n, 3) m in place: first in, first out, each node once, as Gibson does.

    driven (n,): nodes that stay where they are; sources (k,): where it starts.
    """
    n = len(position)
    queue = np.empty(n, dtype=np.int64)
    seen = np.zeros(n, dtype=np.bool_)
    tail = 0
    for k in range(len(sources)):
        if not seen[sources[k]]:
            seen[sources[k]] = True
            queue[tail] = sources[k]
            tail += 1
    head = 0
    while head < tail:
        i = queue[head]
        head += 1
        for slot in range(links.start[i], links.start[i + 1]):
            j = links.neighbours[slot]
            if driven[j] or seen[j]:
                continue
            around = 0.0
            for axis in range(3):
                around += abs(rest[j, axis] - rest[i, axis])
            moved = False
            for axis in range(3):
                offset = rest[j, axis] - rest[i, axis]
                slack = STRETCH * abs(offset) + SHEAR * (around - abs(offset))
                now = position[j, axis] - position[i, axis]
                within = min(max(now, offset - slack), offset + slack)
                if within != now:
                    position[j, axis] = position[i, axis] + within
                    moved = True
            if moved:
                seen[j] = True
                queue[tail] = j
                tail += 1


@kernel
def relax(position: Floats, rest: Floats, links: Links, free: Longs) -> float:
    """Put every free node (f,) at the mean of where its neighbours want it; return the largest move, m."""
    largest = 0.0
    for k in range(len(free)):
        i = free[k]
        count = links.start[i + 1] - links.start[i]
        if count == 0:
            continue
        for axis in range(3):
            total = 0.0
            for slot in range(links.start[i], links.start[i + 1]):
                j = links.neighbours[slot]
                total += position[j, axis] - rest[j, axis]
            wanted = rest[i, axis] + total / count
            largest = max(largest, abs(wanted - position[i, axis]))
            position[i, axis] = wanted
    return largest
