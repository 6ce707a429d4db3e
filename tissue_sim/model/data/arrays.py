"""Copying between arrays, without the temporary that a slice assignment may take."""

from __future__ import annotations

from tissue_sim.array_types import Floats, Ints
from tissue_sim.jit import kernel


@kernel
def copy(source: Floats | Ints, target: Floats | Ints) -> None:
    """Copy a contiguous array into another of the same size.

    Parameters
    ----------
    source : Floats | Ints
        The array.
    target : Floats | Ints
        Receives the values.
    """
    size = source.size
    flat_source, flat_target = source.reshape(size), target.reshape(size)
    for index in range(size):
        flat_target[index] = flat_source[index]


@kernel
def add(source: Floats, target: Floats) -> None:
    """Add a contiguous array to another of the same size.

    Parameters
    ----------
    source : Floats
        The array.
    target : Floats
        Receives the sums.
    """
    size = source.size
    flat_source, flat_target = source.reshape(size), target.reshape(size)
    for index in range(size):
        flat_target[index] += flat_source[index]


@kernel
def copy_nodes(source: Floats, target: Floats, nodes: Ints) -> None:
    """Copy the rows of some nodes from one array to another.

    Parameters
    ----------
    source : Floats, shape (n, 3)
        The array.
    target : Floats, shape (n, 3)
        Receives the rows.
    nodes : Ints, shape (k,)
        Nodes.
    """
    for index in range(len(nodes)):
        node = nodes[index]
        for c in range(3):
            target[node, c] = source[node, c]
