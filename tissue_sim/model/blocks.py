"""Springs packed in blocks, the layout that the force kernels run on."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Ints

BLOCK = 16  # springs in a block: a few vectors of the processor; more only pads small regions
LINE = 64  # bytes of the processor's cache


class Blocks(NamedTuple):
    """Springs of one kind; the last block is filled up with springs without stiffness."""

    nodes: Ints  # (b, BLOCK, c) nodes of each spring
    constants: Floats  # (b, k BLOCK) k constants of the springs, one row of BLOCK after the other


def pack(nodes: Ints, constants: Floats, filling: Floats) -> Blocks:
    """Blocks of springs with nodes (s, c) and constants (s, k); `filling` (k,) those of springs that only fill up."""
    blocks = -(-len(nodes) // BLOCK)
    ends = np.zeros((blocks * BLOCK, nodes.shape[1]), dtype=np.int32)
    ends[: len(nodes)] = nodes
    values = np.empty((blocks * BLOCK, constants.shape[1]))
    values[:] = filling
    values[: len(nodes)] = constants
    kinds = constants.shape[1]
    rows = np.ascontiguousarray(values.reshape(blocks, BLOCK, kinds).transpose(0, 2, 1))
    return Blocks(aligned(ends.reshape(blocks, BLOCK, nodes.shape[1])), aligned(rows.reshape(blocks, kinds * BLOCK)))


def aligned(values: NDArray[Any]) -> NDArray[Any]:
    """A copy that begins with a line of the cache: vectors that lie across two lines take a sixth longer to read."""
    room = np.empty(values.nbytes + LINE, dtype=np.uint8)
    first = -room.ctypes.data % LINE
    copy: NDArray[Any] = room[first : first + values.nbytes].view(values.dtype).reshape(values.shape)
    copy[...] = values
    return copy


def empty_blocks(count: int, nodes: int, constants: int) -> Blocks:
    """Room for `count` springs of so many nodes and constants."""
    blocks = -(-count // BLOCK)
    return Blocks(np.zeros((blocks, BLOCK, nodes), dtype=np.int32), np.zeros((blocks, constants * BLOCK)))
