"""Which springs each node has: what a local region is collected from."""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Ints
from tissue_sim.model.assembly import Adjacency, Model
from tissue_sim.model.blocks import BLOCK


def adjacency_of(model: Model) -> Adjacency:
    """Slots of every node's edges and links in the model's blocks, in ascending order."""
    edge_start, edges = _rows(model.edges.nodes, len(model.angular_nodes), len(model.rest))
    link_start, links = _rows(model.links.nodes, _links(model), len(model.rest))
    return Adjacency(edge_start, edges, link_start, links)


def _links(model: Model) -> int:
    """How many of the links' slots are springs and not filling."""
    return int(np.count_nonzero(model.links.constants[:, BLOCK:]))


def _rows(nodes: Ints, count: int, n: int) -> tuple[Ints, Ints]:
    """Compressed rows node -> slots of the first `count` slots of nodes (b, BLOCK, c)."""
    ends = nodes.reshape(-1, nodes.shape[2])[:count].astype(np.int64)
    slots = np.repeat(np.arange(count), ends.shape[1])
    order = np.argsort(ends.ravel(), kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(ends.ravel(), minlength=n))])
    return start.astype(np.int32), slots[order].astype(np.int32)
