"""Copying between arrays, without the temporary that a slice assignment may take."""

from __future__ import annotations

from typing import Any

from tissue_sim.jit import kernel


@kernel
def copy(source: Any, target: Any) -> None:
    """Copy a contiguous array into another of the same size."""
    size = source.size
    flat_source, flat_target = source.reshape(size), target.reshape(size)
    for index in range(size):
        flat_target[index] = flat_source[index]
