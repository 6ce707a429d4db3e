"""Sleep of an organ that nothing touches, and its recovery from a false rest shape."""

from __future__ import annotations

from tissue_sim.jit import kernel
from tissue_sim.model.contact.haptic_output import has_output
from tissue_sim.model.contact.volume_limit import has_compressed_cells
from tissue_sim.model.data.arrays import copy
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.state import State
from tissue_sim.model.elasticity.gravity import is_out_of_balance
from tissue_sim.model.regions.active_region import leave_region
from tissue_sim.model.regions.moved_nodes import largest_motion
from tissue_sim.model.stepping.guard import move_towards_rest
from tissue_sim.model.stepping.relaxation import creep_rate, forget_relaxation

QUIET_SPEED = 2e-5  # m/s
QUIET_DISPLACEMENT = 5e-6  # m
QUIET_TICKS = 20
# An organ that isn't touched while a hand is on another one falls asleep sooner: the rest of its return is too small to
# be seen or felt.
EARLY_SLEEP_SPEED = 5e-4  # m/s
EARLY_SLEEP_DISPLACEMENT = 4e-5  # m
EARLY_SLEEP_TICKS = 5
FALSE_REST_RATE = 1.0  # 1/s, largest speed over displacement of a false rest shape
MIN_RETURN_FRACTION = 0.02  # of the organ's return rate: an organ in a valid shape returns at half of it
MIN_RETURN_RATE = 0.2  # 1/s, lower limit of the return rate
RECOVERY_DISPLACEMENT = 2e-4  # m; an organ in a valid shape that is this far from rest is moving
INVERTED_TIME = 0.15  # s that cells may stay inverted without load
LONGEST_RETURN = 30.0  # time constants after which an organ has returned from any valid shape: exp(-15) is left


@kernel
def sleep_or_recover(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Fall asleep after a number of ticks without touch, load, speed and displacement.

    Springs that were pushed through each other can come to rest in a false rest shape. An organ that nothing touches
    recovers to its rest shape if it stands still elsewhere, if it takes much longer to return than from a valid shape,
    as compressed cells can oscillate permanently, or if its cells stay inverted. An organ with attachments, weight or
    pressing neighbours may be away from rest: it recovers only after a fault, or if it is still inverted or compressed
    long after a touch; during the recovery these don't act on it.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    """
    status = state.status
    doubted = status.faulted or not scratch.plan.forced
    if doubted and status.turned > 0 and status.alone * settings.tick_time > INVERTED_TIME:
        begin_recovery(model, state, settings, scratch)
        return
    rate = return_rate(model, settings)
    lasted = min(1.0, settings.damping_scale) * rate * status.alone * settings.tick_time  # undamped it oscillates on
    overdue = lasted > LONGEST_RETURN
    if not doubted and not (overdue and (status.turned > 0 or has_compressed_cells(model))):
        return
    speed, away = largest_motion(model, state, scratch)
    # Far from rest, a false shape may oscillate permanently; an organ is slow if its return would take ten times as
    # long
    # as from a valid shape.
    slow = speed <= max(QUIET_SPEED, min(FALSE_REST_RATE, MIN_RETURN_FRACTION * rate) * away)
    # An organ may be compressed by its own weight permanently; then it lies still.
    lies = not doubted and status.turned == 0 and slow and is_out_of_balance(model, settings)
    if away > RECOVERY_DISPLACEMENT and overdue and not lies:
        begin_recovery(model, state, settings, scratch)
        return
    status.quiet = status.quiet + 1 if slow and doubted else 0
    if status.quiet < QUIET_TICKS:
        return
    if away <= QUIET_DISPLACEMENT:
        if speed <= QUIET_SPEED:
            fall_asleep(model, state)
    elif away > RECOVERY_DISPLACEMENT and rate * status.quiet * settings.tick_time > 1.0:
        begin_recovery(model, state, settings, scratch)


@kernel
def sleep_if_at_rest(model: Model, state: State, scratch: Scratch) -> None:
    """Let an unloaded organ fall asleep if it is nearly at rest, while a hand is on another one.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory.
    """
    status = state.status
    speed, away = largest_motion(model, state, scratch)
    status.quiet = status.quiet + 1 if speed <= EARLY_SLEEP_SPEED and away <= EARLY_SLEEP_DISPLACEMENT else 0
    if status.quiet >= EARLY_SLEEP_TICKS:
        fall_asleep(model, state)


@kernel
def return_rate(model: Model, settings: Settings) -> float:
    """Return the rate at which the organ returns after its release: its damping rate, twice its lowest frequency.

    This holds after a calibration, and nearly for organs as built; parameters that make an organ softer or more damped
    reduce the rate.

    Parameters
    ----------
    model : Model
        Constants of the model.
    settings : Settings
        Settings of the simulation.

    Returns
    -------
    float, 1/s
        The rate.
    """
    softer, tougher = min(1.0, settings.stiffness_scale), max(1.0, settings.damping_scale)
    own = max(MIN_RETURN_RATE, model.damping_rate * softer / tougher)
    return own if len(model.relaxation) == 0 else min(own, creep_rate(model))


@kernel
def fall_asleep(model: Model, state: State) -> None:
    """Set the organ to its exact rest shape, asleep; a piece that was cut off stays where it lies.

    It waits while the slew limit still lowers a force, since an organ that sleeps exerts none.
    """
    if has_output(state):
        return
    status = state.status
    status.asleep = True
    status.backoff = 1
    status.turned = status.collapsing = status.faulted = False
    state.is_turned[:] = 0
    if len(model.free) == 0:
        copy(model.rest, state.position)
    else:
        for node in range(len(model.rest)):
            if model.free[node] == 0:
                for c in range(3):
                    state.position[node, c] = model.rest[node, c]
    copy(state.position, state.good_position)
    state.velocity[:] = 0.0
    forget_relaxation(state)


@kernel
def begin_recovery(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Start the recovery from a false rest shape, as soon as no force is left; see `fall_asleep`."""
    if has_output(state):
        return
    leave_region(model, state, settings, scratch)
    forget_relaxation(state)
    state.status.snapped = True
    state.status.alone = 0
    state.count.snaps += 1


@kernel
def step_recovery(model: Model, state: State, settings: Settings) -> None:
    """Do a step of the recovery from a false rest shape.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    """
    displacement = move_towards_rest(model, state, settings)
    # A fault during the recovery must not restore the false shape.
    copy(state.position, state.good_position)
    if displacement <= QUIET_DISPLACEMENT:
        state.status.snapped = state.status.faulted = False
        state.status.quiet = 0
        state.status.backoff = 1
