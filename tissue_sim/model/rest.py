"""How an organ that nobody touches comes to rest: asleep, or led back from a false rest shape."""

from __future__ import annotations

from typing import Any

from tissue_sim.jit import kernel
from tissue_sim.model.arrays import copy
from tissue_sim.model.gravity import is_out_of_balance
from tissue_sim.model.guard import lead_back
from tissue_sim.model.regions import largest_motion, leave_region
from tissue_sim.model.squeezed import has_stiff_cells

QUIET_SPEED = 2e-5  # m/s
QUIET_DISPLACEMENT = 5e-6  # m
QUIET_TICKS = 20
# An organ beside one that a hand is on sleeps sooner: nobody sees its last way, nor feels it through a ligament.
DROWSY_SPEED = 5e-4  # m/s
DROWSY_DISPLACEMENT = 4e-5  # m
DROWSY_TICKS = 5
TREMBLING = 1.0  # 1/s, speed over displacement of a false shape at the most
CREEPING = 0.02  # of the organ's pace: a sound one goes back at half of that
SLOWEST = 0.2  # 1/s, of paces
SNAPPED_DISPLACEMENT = 2e-4  # m; a sound organ that far from rest is moving
TURNED_TIME = 0.15  # s that the inside may stay turned inside out with nothing acting
LONGEST_WAY = 30.0  # times of the organ's pace after which a sound one is back from anywhere: exp(-15) is left


@kernel
def rest_if_quiet(model: Any, state: Any, settings: Any, scratch: Any) -> None:
    """Fall asleep after a number of ticks without touch, load, speed and displacement.

    Springs pushed through each other can come to rest in a false shape, finite and still. An organ that
    nobody touches and that stands still away from its rest shape, that is not back long after a sound one would be, as
    squeezed cells can tremble at the same places for good, or whose inside stays turned inside out, is led back to it.
    What hangs, bears weight or is pressed by its neighbours may well be away from rest: it is led back only after a
    fault, or where it is still inside out or squeezed long after; and on its way these let go of it.
    """
    status = state.status
    doubted = status.faulted or not scratch.plan.forced
    if doubted and status.turned > 0 and status.alone * settings.tick_time > TURNED_TIME:
        snap(model, state, settings, scratch)
        return
    rate = pace(model, settings)
    lasted = min(1.0, settings.damping_scale) * rate * status.alone * settings.tick_time  # what isn't damped swings on
    overdue = lasted > LONGEST_WAY
    if not doubted and not (overdue and (status.turned > 0 or has_stiff_cells(model))):
        return
    speed, away = largest_motion(model, state, scratch)
    # Far from rest, a false shape may tremble for good; slow is what wouldn't get back in ten times a sound one's time.
    slow = speed <= max(QUIET_SPEED, min(TREMBLING, CREEPING * rate) * away)
    # Its weight may squeeze an organ for good, which then lies still.
    lies = not doubted and status.turned == 0 and slow and is_out_of_balance(model, settings)
    if away > SNAPPED_DISPLACEMENT and overdue and not lies:
        snap(model, state, settings, scratch)
        return
    status.quiet = status.quiet + 1 if slow and doubted else 0
    if status.quiet < QUIET_TICKS:
        return
    if away <= QUIET_DISPLACEMENT:
        if speed <= QUIET_SPEED:
            fall_asleep(model, state)
    elif away > SNAPPED_DISPLACEMENT and rate * status.quiet * settings.tick_time > 1.0:
        snap(model, state, settings, scratch)


@kernel
def sleep_if_quiet(model: Any, state: Any, scratch: Any) -> None:
    """Fall asleep where an organ that nothing loads is as good as at rest, while a hand is on another one."""
    status = state.status
    speed, away = largest_motion(model, state, scratch)
    status.quiet = status.quiet + 1 if speed <= DROWSY_SPEED and away <= DROWSY_DISPLACEMENT else 0
    if status.quiet >= DROWSY_TICKS:
        fall_asleep(model, state)


@kernel
def pace(model: Any, settings: Any) -> float:
    """How soon the organ is on its way after it is let go, 1/s: its damping rate, which is twice its lowest frequency.

    So calibration has it, and the organs as built are near it; slower where parameters have made it softer or tougher.
    """
    softer, tougher = min(1.0, settings.stiffness_scale), max(1.0, settings.damping_scale)
    return max(SLOWEST, model.damping_rate * softer / tougher)


@kernel
def fall_asleep(model: Any, state: Any) -> None:
    """At rest, to the last bit."""
    status = state.status
    status.asleep = True
    status.backoff = 1
    status.turned = status.collapsing = status.faulted = False
    state.is_turned[:] = 0
    copy(model.rest, state.position)
    copy(model.rest, state.good_position)
    state.velocity[:] = 0.0


@kernel
def snap(model: Any, state: Any, settings: Any, scratch: Any) -> None:
    """Start the way back from a false rest shape."""
    leave_region(model, state, settings, scratch)
    state.status.snapped = True
    state.status.alone = 0
    state.count.snaps += 1


@kernel
def find_back(model: Any, state: Any, settings: Any) -> None:
    """A step of the way back from a false rest shape."""
    displacement = lead_back(model, state, settings)
    # A fault on the way must not restore the false shape.
    copy(state.position, state.good_position)
    if displacement <= QUIET_DISPLACEMENT:
        state.status.snapped = state.status.faulted = False
        state.status.quiet = 0
        state.status.backoff = 1
