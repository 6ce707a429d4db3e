"""Notices that a step has become too long under load, and has it halved for a while.

Tissue that is squeezed or stretched is stiffer than at rest, so that a substep may come to lie beyond the critical
step. Nodes then turn around in every substep, ever faster. Those that do so are looked for in some ticks of cells,
whose penalties add up where several are squeezed, and in those of one substep, which is as long as rest allows.
"""

from __future__ import annotations

from typing import Any

from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel
from tissue_sim.model.arrays import copy

LOOK_EVERY = 2  # substeps at the least
FAST = 2e-3  # m/s, 2 um in a step of a ms: slower is what contacts do while they settle, but
FAST_AGAIN = 2e-5  # m/s, once a step was found too long: what is held must not be shaken off each time it is tried anew
TURNED = 0.5  # of a speed, that it has at least the other way
MANY = 4  # coordinates that turn around
GREW = 1.5  # their squared speeds from one look to the next
MOST = 0.2  # of all squared speeds is theirs: a blow makes more of its motion turn around, while it ebbs away
# Ticks for which the step stays halved. A blow is soon over. A step that is too long is found so again, and each time
# halved for MORE times as long, until what shivered has died down.
HALVED, MORE, LONGEST = 120, 3, 1080


@kernel
def _at_any(model: Any) -> bool:
    return True


@kernel
def _at_one(model: Any) -> bool:
    return False


@chosen(lambda model: _at_any if has(model, "tissue") else _at_one)
def looks_at_any(model: Any) -> Any:
    """True when ticks of more than one substep are looked at, too."""


@kernel
def is_looked_at(model: Any, state: Any, substeps: int) -> bool:
    """True when this tick of some substeps is one to look at; a step stays halved one tick less."""
    status = state.status
    if status.shivering > 0:
        status.shivering -= 1
    else:
        status.halving = max(HALVED, status.halving - 1)
    if substeps > 1 and not looks_at_any(model):
        return False
    return substeps * status.tick % LOOK_EVERY < substeps


@kernel
def begin_look(state: Any, scratch: Any) -> None:
    """Keep the velocities before the tick's last substep."""
    copy(state.velocity, scratch.velocity_before)


@kernel
def end_look(state: Any, scratch: Any) -> None:
    """Have the step halved when nodes have turned around in this substep, faster than at the last look.

    A mode that the step just allows turns around as often, after a blow, but dies down.
    """
    size, status = state.velocity.size, state.status
    before, after = scratch.velocity_before.reshape(size), state.velocity.reshape(size)
    last, status.turning = status.turning, 0.0
    fast = FAST_AGAIN if status.halving > HALVED else FAST
    if count_turning(before, after, fast) < MANY:
        return
    status.turning = energy_of_turning(before, after, fast)
    if 0.0 < GREW * last < status.turning and status.turning > MOST * energy_of(after):
        status.turning = 0.0
        status.shivering = max(HALVED, status.halving)
        status.halving = min(LONGEST, MORE * status.shivering)
        state.count.shivers += 1


@kernel
def turns(before: float, after: float, fast: float) -> bool:
    """True for a speed of more than `fast`, m/s, that has become about as large the other way."""
    return (before * before > fast * fast) & (before * after < -TURNED * before * before)


@kernel
def count_turning(before: Any, after: Any, fast: float) -> int:
    """How many coordinates of more than `fast` go about as fast as before, m/s, the other way; flat arrays."""
    turning = 0
    for index in range(len(before)):
        turning += turns(before[index], after[index], fast)
    return turning


@kernel
def energy_of(velocity: Any) -> float:
    """Sum of all squared speeds, m^2/s^2; flat."""
    total = 0.0
    for index in range(len(velocity)):
        total += velocity[index] * velocity[index]
    return total


@kernel
def energy_of_turning(before: Any, after: Any, fast: float) -> float:
    """Sum of their squared speeds, m^2/s^2."""
    total = 0.0
    for index in range(len(before)):
        if turns(before[index], after[index], fast):
            total += after[index] * after[index]
    return total
