"""Copying between arrays, without the temporary that a slice assignment may take."""

from __future__ import annotations

from typing import Any

from tissue_sim.jit import kernel


@kernel
def copy(source: Any, target: Any) -> None:
    """Copy a contiguous array into another of the same size.

    Parameters
    ----------
    source : Any
        The array.
    target : Any
        Receives the values.
    """
    size = source.size
    flat_source, flat_target = source.reshape(size), target.reshape(size)
    for index in range(size):
        flat_target[index] = flat_source[index]


@kernel
def copy_nodes(source: Any, target: Any, nodes: Any) -> None:
    """Copy the rows of some nodes from one array to another.

    Parameters
    ----------
    source : Any, shape (n, 3)
        The array.
    target : Any, shape (n, 3)
        Receives the rows.
    nodes : Any, shape (k,)
        Nodes.
    """
    for index in range(len(nodes)):
        node = nodes[index]
        for c in range(3):
            target[node, c] = source[node, c]
