"""Impulses of contact and of blades on the bodies of tools."""

from __future__ import annotations

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import inner, kernel
from tissue_sim.model.data.scratch import Scratch


@inner
def count_on_body(scratch: Scratch, body: int, arm: Floats, impulse: tuple[float, float, float]) -> None:
    """Add an impulse on the tissue, N s, and its moment about the tool's origin to scratch.impulse.

    Parameters
    ----------
    scratch : Scratch
        Working memory; updated.
    body : int
        Index of the body.
    arm : Floats, shape (3,), m
        From the tool's origin to the place where it acts.
    impulse : tuple[float, float, float], N s
        The impulse.
    """
    px, py, pz = impulse
    sums = scratch.impulse[body]
    sums[0] += px
    sums[1] += py
    sums[2] += pz
    sums[3] += arm[1] * pz - arm[2] * py
    sums[4] += arm[2] * px - arm[0] * pz
    sums[5] += arm[0] * py - arm[1] * px


@kernel
def push_bodies(tools: Longs, body: int, scratch: Scratch, impulse: tuple[float, float, float]) -> None:
    """Move all bodies of a body's tool by the opposite of an impulse on the tissue, N s."""
    give = scratch.give[body]
    for other in range(len(tools)):
        if tools[other] == tools[body]:
            for axis in range(3):
                scratch.origin[other, axis] -= give * impulse[axis]
