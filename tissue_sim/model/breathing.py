"""Breath: how far it moves what hangs on it, and what organs feel of that.

An organ that breathes is simulated in the frame of its clamp, where that stands still. Tools come towards it as the
frame goes the other way, and the frame's acceleration is a weight on its nodes. What hardly bends an organ it doesn't
feel (`unfelt`).
"""

from __future__ import annotations

import math
from typing import Any

from tissue_sim.jit import kernel
from tissue_sim.model.records import Record

FOLLOW = 20.0  # 1/s, how fast it goes where it is told to be: 0.1 s behind


class Breath(Record):
    """How a breath goes: out at time 0, with a pause there, and in after half a period (Lujan et al. 1999, n = 2).

    Or after what is told from outside, smoothly: as a critically damped spring would draw it there.
    """

    period: float  # s; 0: none
    follows: bool  # what is told
    x: float  # m, the way from breathed out to breathed in
    y: float
    z: float
    time: float  # s
    told: float  # share of the way
    share: float  # where it is on the way there
    speed: float  # 1/s


@kernel
def breathed_in(time: float, period: float) -> tuple[float, float, float]:
    """Share of the way after so many s, sin^4(pi t / T), its speed, 1/s, and its acceleration, 1/s^2."""
    if period <= 0.0:
        return 0.0, 0.0, 0.0
    turn = math.pi / period
    s, c = math.sin(turn * time), math.cos(turn * time)
    return s**4, 4.0 * turn * s**3 * c, turn * turn * s * s * (12.0 * c * c - 4.0 * s * s)


@kernel
def follow(breath: Any, step: float) -> tuple[float, float, float]:
    """Go on for `step` s towards the share that was told; returns share, speed, 1/s, and acceleration, 1/s^2."""
    change = FOLLOW * (FOLLOW * (breath.told - breath.share) - 2.0 * breath.speed)
    breath.speed += step * change
    breath.share += step * breath.speed
    return breath.share, breath.speed, change


@kernel
def breathe(worlds: Any, carried: Any, step: float) -> None:
    """Carry organs on by one tick of `step` s; carried: see `carried_with`. `share_loads` sets what they feel of it."""
    breath = carried.breath
    breath.time += step
    if breath.follows:
        share, speed, change = follow(breath, step)
    else:
        share, speed, change = breathed_in(breath.time, breath.period)
    carried.share[0], carried.share[1] = share, speed
    for organ in range(len(worlds)):
        state, moves = worlds[organ].state, carried.moves[organ]
        if moves == 0.0:
            continue
        for axis in range(3):
            way = moves * (breath.x if axis == 0 else breath.y if axis == 1 else breath.z)
            shift = share * way - state.carried[axis]
            state.carried[axis] += shift
            carried.speed[organ, axis] = speed * way
            carried.change[organ, axis] = change * way
            for body in range(len(state.bodies)):
                if state.bodies[body].age >= 0:
                    state.held_pose[body, axis] -= shift
                    state.body_goal[body, axis] -= shift


@kernel
def weigh(settings: Any, carried: Any, organ: int, share: float) -> None:
    """Set an organ's gravity, less the share of its frame's acceleration that it feels."""
    change, gravity = carried.change[organ], carried.gravity[organ]
    settings.gravity_x = gravity[0] - share * change[0]
    settings.gravity_y = gravity[1] - share * change[1]
    settings.gravity_z = gravity[2] - share * change[2]


@kernel
def note_gravity(settings: Any, carried: Any, organ: int) -> None:
    """Take an organ's gravity out of its settings, which are new: what it has without the breath."""
    gravity = carried.gravity[organ]
    gravity[0], gravity[1], gravity[2] = settings.gravity_x, settings.gravity_y, settings.gravity_z
