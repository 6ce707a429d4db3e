"""Hop distances between all pairs of surface nodes: the paper's preprocessing table (section 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from tissue_sim.model.data.model import Model
from tissue_sim.model.elasticity.assembly import NO_HOPS

LARGEST_TABLE = 4096  # surface nodes: 16 MiB; for more nodes the region is searched on demand
_ROWS = 256
_FAR = np.iinfo(np.uint8).max  # this many hops or more


def hop_table(model: Model, largest: int = LARGEST_TABLE) -> NDArray[np.uint8]:
    """Return the number of hops between every two surface nodes along triangle edges; every edge counts as one.

    Dijkstra's algorithm, as in the paper.

    Parameters
    ----------
    model : Model
        Constants of the model.
    largest : int, optional
        Number of surface nodes beyond which there is no table.

    Returns
    -------
    NDArray[np.uint8], shape (n_surface, n_surface)
        Hops; shape (0, 0) without a table.
    """
    n = model.n_surface
    if n > largest:
        return NO_HOPS
    start, links = model.neighbour_start[: n + 1], model.neighbours
    graph = csr_array((np.ones(len(links)), links, start), shape=(n, n))
    table = np.empty((n, n), dtype=np.uint8)
    for first in range(0, n, _ROWS):
        rows = np.arange(first, min(first + _ROWS, n))
        table[rows] = np.minimum(dijkstra(graph, indices=rows, unweighted=True), _FAR)
    return table
