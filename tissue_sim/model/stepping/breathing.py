"""Breathing: the displacement of clamps and attached points, and the load on organs.

An organ that breathes is simulated in the frame of its clamp, in which the clamp is at rest. In this frame tools move
the opposite way, and the frame's acceleration acts like a weight on the nodes. Loads that hardly bend an organ are left
out (`wake_threshold`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.data.records import Record, words_of
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.world import World

FOLLOW_RATE = 20.0  # 1/s, rate at which a breath follows external input, with a lag of 0.1 s


class Breath(Record):
    """Breathing curve: exhaled at time 0, with a pause there, inhaled after half a period (Lujan et al. 1999, n = 2).

    Alternatively it follows external input, smoothed as by a critically damped spring.
    """

    period: float  # s; 0: none
    follows: bool  # whether it follows external input
    x: float  # m, the displacement from exhaled to inhaled
    y: float
    z: float
    time: float  # s
    target: float  # fraction of the displacement, external input
    fraction: float  # present fraction of the displacement
    speed: float  # 1/s


@kernel
def inhaled_fraction(time: float, period: float) -> tuple[float, float, float]:
    """Return the displacement of a periodic breath at a time: sin^4(pi t / T) and its derivatives.

    Parameters
    ----------
    time : float, s
        The time.
    period : float, s
        The period.

    Returns
    -------
    tuple[float, float, float]
        Fraction of the displacement, its speed, 1/s, and its acceleration, 1/s^2.

    References
    ----------
    Lujan et al. 1999, n = 2.
    """
    if period <= 0.0:
        return 0.0, 0.0, 0.0
    turn = math.pi / period
    s, c = math.sin(turn * time), math.cos(turn * time)
    return s**4, 4.0 * turn * s**3 * c, turn * turn * s * s * (12.0 * c * c - 4.0 * s * s)


class Carried(NamedTuple):
    """Motion of k organs by breathing; see `state.carried`."""

    breath: Breath
    breath_words: Longs  # memory of the breath
    fraction: Floats  # (2,) fraction of the breath's displacement, and its rate, 1/s
    moves: Floats  # (k,) fraction of the displacement that each follows
    gravity: Floats  # (k, 3) m/s^2, of each without the breath
    speed: Floats  # (k, 3) m/s
    change: Floats  # (k, 3) m/s^2


def moves_with_frame(breath: Breath, moves: Sequence[float], gravity: Floats) -> Carried:
    """Return organs that follow a breath by the fractions `moves` (k,), exhaled; see Carried."""
    count = len(moves)

    def rows() -> Floats:
        return np.zeros((count, 3))

    given = np.array(moves, dtype=np.float64), np.array(gravity, dtype=np.float64)
    return Carried(breath, words_of(breath), np.zeros(2), *given, rows(), rows())


@kernel
def follow(breath: Breath, step: float) -> tuple[float, float, float]:
    """Advance by `step` s towards the external input; return fraction, speed, 1/s, and acceleration, 1/s^2."""
    change = FOLLOW_RATE * (FOLLOW_RATE * (breath.target - breath.fraction) - 2.0 * breath.speed)
    breath.speed += step * change
    breath.fraction += step * breath.speed
    return breath.fraction, breath.speed, change


@kernel
def breathe(worlds: Sequence[World], carried: Carried, step: float) -> None:
    """Move organs with the breath for one tick; `apply_wake_threshold` sets the load that it exerts on them.

    Parameters
    ----------
    worlds : Sequence[World]
        Worlds of the organs; updated.
    carried : Carried
        How organs follow the breath; updated.
    step : float, s
        Duration of the tick.
    """
    breath = carried.breath
    breath.time += step
    if breath.follows:
        fraction, speed, change = follow(breath, step)
    else:
        fraction, speed, change = inhaled_fraction(breath.time, breath.period)
    carried.fraction[0], carried.fraction[1] = fraction, speed
    for organ in range(len(worlds)):
        state, moves = worlds[organ].state, carried.moves[organ]
        if moves == 0.0:
            continue
        for axis in range(3):
            way = moves * (breath.x if axis == 0 else breath.y if axis == 1 else breath.z)
            shift = fraction * way - state.carried[axis]
            state.carried[axis] += shift
            carried.speed[organ, axis] = speed * way
            carried.change[organ, axis] = change * way
            for body in range(len(state.bodies)):
                if state.bodies[body].age >= 0:
                    state.held_pose[body, axis] -= shift
                    state.body_goal[body, axis] -= shift


@kernel
def set_frame_gravity(settings: Settings, carried: Carried, organ: int, fraction: float) -> None:
    """Set an organ's gravity to that without breath, minus a fraction of its frame's acceleration.

    Parameters
    ----------
    settings : Settings
        Settings of the simulation; updated.
    carried : Carried
        How organs follow the breath.
    organ : int
        Index of the organ.
    fraction : float
        Fraction of the acceleration that acts on it.
    """
    change, gravity = carried.change[organ], carried.gravity[organ]
    settings.gravity_x = gravity[0] - fraction * change[0]
    settings.gravity_y = gravity[1] - fraction * change[1]
    settings.gravity_z = gravity[2] - fraction * change[2]


@kernel
def note_gravity(settings: Settings, carried: Carried, organ: int) -> None:
    """Store an organ's gravity without the breath, from its new settings.

    Parameters
    ----------
    settings : Settings
        Settings of the simulation.
    carried : Carried
        How organs follow the breath; updated.
    organ : int
        Index of the organ.
    """
    gravity = carried.gravity[organ]
    gravity[0], gravity[1], gravity[2] = settings.gravity_x, settings.gravity_y, settings.gravity_z
