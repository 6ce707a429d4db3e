"""Springs packed in blocks, the layout on which the force kernels run."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Ints

BLOCK = 16  # springs in a block: a few vectors of the processor; larger blocks would only pad small regions
LINE = 64  # bytes of the processor's cache


class Blocks(NamedTuple):
    """Springs of one kind; the last block is filled with springs without stiffness."""

    nodes: Ints  # (b, BLOCK, c) nodes of each spring
    constants: Floats  # (b, k BLOCK) k constants of the springs, one row of BLOCK after the other


def pack(nodes: Ints, constants: Floats, filling: Floats) -> Blocks:
    """Return springs in blocks.

    Parameters
    ----------
    nodes : Ints, shape (s, c)
        Nodes of the springs.
    constants : Floats, shape (s, k)
        Constants of the springs.
    filling : Floats, shape (k,)
        Constants of springs that pad the last block.
    """
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
    """Return a copy aligned to cache lines: vectors across two lines take a sixth longer to read.

    Parameters
    ----------
    values : NDArray[Any]
        The array.

    Returns
    -------
    NDArray[Any]
        The copy.
    """
    room = np.empty(values.nbytes + LINE, dtype=np.uint8)
    first = -room.ctypes.data % LINE
    copy: NDArray[Any] = room[first : first + values.nbytes].view(values.dtype).reshape(values.shape)
    copy[...] = values
    return copy


def empty_blocks(count: int, nodes: int, constants: int) -> Blocks:
    """Return blocks of zeros.

    Parameters
    ----------
    count : int
        Number of springs.
    nodes : int
        Number of nodes of a spring.
    constants : int
        Number of constants of a spring.
    """
    blocks = -(-count // BLOCK)
    return Blocks(np.zeros((blocks, BLOCK, nodes), dtype=np.int32), np.zeros((blocks, constants * BLOCK)))
