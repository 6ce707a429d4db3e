"""Springs or cells of each node, from which a local region is collected."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array

from tissue_sim.array_types import Ints, Longs
from tissue_sim.model.data.blocks import BLOCK
from tissue_sim.model.data.model import Adjacency, Model
from tissue_sim.model.elasticity.assembly import NO_HOPS
from tissue_sim.model.elasticity.cells import cells_of, slots_of


def adjacency_of(model: Model) -> Adjacency:
    """Return the slots of every node's edges and links, or cells, in the model's blocks, in ascending order.

    Parameters
    ----------
    model : Model
        Constants of the model.
    """
    n = len(model.rest)
    edge_start, edges = _rows(model.edges.nodes, np.arange(len(model.angular_nodes)), n)
    link_start, links = _rows(model.links.nodes, np.arange(_links(model)), n)
    if model.tissue is None:
        cell_start, cells = np.zeros(n + 1, dtype=np.int32), np.zeros(0, dtype=np.int32)
    else:
        cell_start, cells = _rows(model.tissue.nodes, slots_of(model.tissue), n)
    return Adjacency(edge_start, edges, link_start, links, cell_start, cells)


def with_cell_neighbours(model: Model) -> Model:
    """Return the model with neighbours along the edges of its cells, so that interior nodes have hop distances, too.

    Parameters
    ----------
    model : Model
        Constants of the model.
    """
    assert model.tissue is not None
    ends = cells_of(model.tissue)[0].astype(np.int64)
    pairs = np.concatenate([ends[:, [a, b]] for a in range(4) for b in range(4) if a != b])
    n = len(model.rest)
    graph = coo_array((np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(n, n)).tocsr()
    graph.sort_indices()
    return model._replace(
        neighbour_start=graph.indptr.astype(np.int32), neighbours=graph.indices.astype(np.int32), hops=NO_HOPS
    )


def _links(model: Model) -> int:
    """Return how many of the links' slots are springs, without the padding."""
    return int(np.count_nonzero(model.links.constants[:, BLOCK:]))


def _rows(nodes: Ints, real: Longs, n: int) -> tuple[Ints, Ints]:
    """Return compressed rows node -> slots, in ascending order, for nodes (b, BLOCK, c) of the slots `real` (r,)."""
    ends = nodes.reshape(-1, nodes.shape[2])[real].astype(np.int64)
    slots = np.repeat(real, ends.shape[1])
    order = np.argsort(ends.ravel(), kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(ends.ravel(), minlength=n))])
    return start.astype(np.int32), slots[order].astype(np.int32)
