"""Detection of oscillation: a step that has become too long under load is halved for a while.

Compressed or stretched tissue is stiffer than at rest, so that a substep may exceed the critical step. Nodes then
reverse in every substep, ever faster. Such nodes are searched in some ticks of an organ of cells: when several cells
are compressed, whose penalties add up, and when a tick has one substep, which is as long as the rest shape allows.
"""

from __future__ import annotations

from typing import Any

from tissue_sim.array_types import Floats
from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel
from tissue_sim.model.data.arrays import copy
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.state import State

CHECK_EVERY = 2  # least number of substeps between two checks
MIN_SPEED = 2e-3  # m/s of an oscillating node, 2 um in a step of a ms: contacts that settle are slower
MIN_SPEED_AGAIN = 2e-5  # m/s, the same once a step was too long: held tissue must not be released at each new trial
REVERSED_FRACTION = 0.5  # least part of a node's speed that it has in the reverse direction after a substep
MIN_COORDINATES = 4  # number of coordinates that reverse
MIN_GROWTH = 1.5  # ratio of their squared speeds between two checks
MIN_FRACTION = 0.2  # of the sum of all squared speeds: after an impact, more of the motion reverses, but decays
# Ticks for which the step remains halved. An impact is soon over. A step that is still too long is found again, and
# each time remains halved for HALVED_GROWTH times as many ticks, until the oscillation has decayed.
HALVED_TICKS, HALVED_GROWTH, MAX_HALVED_TICKS = 120, 3, 1080


@kernel
def _at_any(model: Model) -> bool:
    return True


@kernel
def _at_one(model: Model) -> bool:
    return False


@chosen(lambda model: _at_any if has(model, "tissue") else _at_one)
def checks_oscillation(model: Model) -> Any:
    """Return whether ticks of more than one substep are checked, too."""


@kernel
def is_oscillation_checked(model: Model, state: State, substeps: int) -> bool:
    """Return whether this tick is to be checked; count down the ticks for which the step remains halved.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    substeps : int
        Number of substeps of the tick.
    """
    status = state.status
    if status.oscillating > 0:
        status.oscillating -= 1
    else:
        status.halving = max(HALVED_TICKS, status.halving - 1)
    if substeps > 1 and not checks_oscillation(model):
        return False
    return substeps * status.tick % CHECK_EVERY < substeps


@kernel
def begin_oscillation_check(state: State, scratch: Scratch) -> None:
    """Keep the velocities before the tick's last substep.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    """
    copy(state.velocity, scratch.velocity_before)


@kernel
def end_oscillation_check(state: State, scratch: Scratch) -> None:
    """Halve the step of the next ticks if nodes have reversed in this substep, faster than at the last check.

    After an impact, a mode for which the step is just short enough also reverses in every substep, but decays.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    """
    size, status = state.velocity.size, state.status
    before, after = scratch.velocity_before.reshape(size), state.velocity.reshape(size)
    last, status.turning = status.turning, 0.0
    fast = MIN_SPEED_AGAIN if status.halving > HALVED_TICKS else MIN_SPEED
    if count_oscillating(before, after, fast) < MIN_COORDINATES:
        return
    status.turning = energy_of_oscillation(before, after, fast)
    if 0.0 < MIN_GROWTH * last < status.turning and status.turning > MIN_FRACTION * energy_of(after):
        status.turning = 0.0
        status.oscillating = max(HALVED_TICKS, status.halving)
        status.halving = min(MAX_HALVED_TICKS, HALVED_GROWTH * status.oscillating)
        state.count.oscillations += 1


@kernel
def has_reversed(before: float, after: float, fast: float) -> bool:
    """Return whether a speed of more than `fast`, m/s, has nearly reversed."""
    return (before * before > fast * fast) & (before * after < -REVERSED_FRACTION * before * before)


@kernel
def count_oscillating(before: Floats, after: Floats, fast: float) -> int:
    """Return how many coordinates faster than `fast`, m/s, have nearly reversed; flat arrays."""
    turning = 0
    for index in range(len(before)):
        turning += has_reversed(before[index], after[index], fast)
    return turning


@kernel
def energy_of(velocity: Floats) -> float:
    """Return the sum of all squared speeds, m^2/s^2; flat array."""
    total = 0.0
    for index in range(len(velocity)):
        total += velocity[index] * velocity[index]
    return total


@kernel
def energy_of_oscillation(before: Floats, after: Floats, fast: float) -> float:
    """Return the sum of the squared speeds of coordinates that have reversed, m^2/s^2."""
    total = 0.0
    for index in range(len(before)):
        if has_reversed(before[index], after[index], fast):
            total += after[index] * after[index]
    return total
