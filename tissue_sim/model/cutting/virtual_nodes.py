"""Virtual nodes: the corners of divided cells that lie on the other side of a cut (Molino et al. 2004)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tissue_sim.array_types import Ints, Longs, Mask
from tissue_sim.model.cutting.crossing import Crossing

_PAIRS = np.array([(a, b) for a in range(4) for b in range(4) if a != b])  # corners of a cell


class DividedEdges(NamedTuple):
    """Edges of divided cells across a cut, once for each end. e directed edges."""

    key: Longs  # (e,) n times the node that is seen, plus the end from which it is seen; ascending
    node: Longs  # (e,) the node that replaces the seen one on the end's side: itself, or a virtual node
    closed: Mask  # (e,) whether a cell around the edge is undivided, so that both sides meet there


class Copies(NamedTuple):
    """Copies that replace divided cells. k divided cells, v virtual nodes."""

    below: Longs  # (k, 4) nodes of the copy on the negative side
    above: Longs  # (k, 4) nodes of the copy on the positive side
    virtual_of: Longs  # (v,) nodes of which virtual ones are copies
    edges: DividedEdges


def copies_of(cells: Ints | Longs, crossing: Crossing, fixed: Ints, first: int) -> Copies:
    """Return the copies of divided cells, of which each keeps its nodes on its own side.

    A node on the other side is a virtual one [1]_, which all copies share [2]_ that meet at an edge between the two
    sides. Where an undivided cell meets them there, at the front, it is the node itself. A fixed node is its own
    virtual node, as both stay where they are.

    Parameters
    ----------
    cells : Ints | Longs, shape (c, 4)
        Node indices of all cells.
    crossing : Crossing
        The divided ones.
    fixed : Ints, shape (f,)
        Fixed nodes.
    first : int
        Number of the first virtual node.

    References
    ----------
    .. [1] N. Molino, Z. Bao and R. Fedkiw, "A virtual node algorithm for changing mesh topology during simulation",
       ACM Transactions on Graphics 23, 2004.
    .. [2] A. Hansbo and P. Hansbo, "A finite element method for the simulation of strong and weak discontinuities in
       solid mechanics", Computer Methods in Applied Mechanics and Engineering 193, 2004.
    """
    n, positive = len(crossing.height), crossing.positive
    quads = cells[crossing.cells].astype(np.int64)
    cell, pair = np.nonzero(positive[quads][:, _PAIRS[:, 0]] != positive[quads][:, _PAIRS[:, 1]])
    seen, end = quads[cell, _PAIRS[pair, 0]], quads[cell, _PAIRS[pair, 1]]
    key, edge = np.unique(seen * n + end, return_inverse=True)
    edge = edge.ravel()
    # A copy has one virtual node for each corner on the other side, the same along all of its edges.
    corner = 4 * cell + _PAIRS[pair, 0]
    size = len(key) + 4 * len(quads)
    links = coo_array((np.ones(len(edge)), (edge, len(key) + corner)), shape=(size, size))
    label = connected_components(links, directed=False)[1]
    closed = np.isin(key, _undivided(cells, crossing, n))
    met = np.zeros(size, dtype=bool)
    met[label[: len(key)][closed]] = True
    own = np.zeros(size, dtype=np.int64)
    own[label[: len(key)]] = key // n
    used = np.unique(label[: len(key)])
    is_fixed = np.zeros(n, dtype=bool)
    is_fixed[fixed] = True
    new = used[~met[used] & ~is_fixed[own[used]]]
    node = own.copy()
    node[new] = first + np.arange(len(new))
    at = label[len(key) :].reshape(-1, 4)
    up = positive[quads]
    return Copies(
        below=np.where(up, node[at], quads),
        above=np.where(up, quads, node[at]),
        virtual_of=own[new],
        edges=DividedEdges(key, node[label[: len(key)]], closed),
    )


def _undivided(cells: Ints | Longs, crossing: Crossing, n: int) -> Longs:
    """Return the keys, see DividedEdges, of edges between both sides in cells that are not divided."""
    whole = np.ones(len(cells), dtype=bool)
    whole[crossing.cells] = False
    others = cells[whole].astype(np.int64)
    up = crossing.positive[others]
    others = others[up.any(axis=1) & ~up.all(axis=1)]
    return (others[:, _PAIRS[:, 0]] * n + others[:, _PAIRS[:, 1]]).ravel()
