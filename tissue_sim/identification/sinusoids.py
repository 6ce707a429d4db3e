"""Tools that swing in tissue: where they do in a recording, and by how much the force runs ahead of the depth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from tissue_sim.array_types import Floats
from tissue_sim.identification.measured import Sinusoid

CYCLES = 3  # at the least
LEAST = 5e-5  # m, amplitude
CROSSED = 0.3  # of the amplitude, beyond which a crossing of the middle counts: noise crosses it many times
EVEN = 0.1  # of the mean period, deviation of a single one at most
PURE = 0.95  # fraction of the depth's variance that one sinusoid must explain
NEAR = 0.1  # of the frequency, within which it is refined


class Loss(NamedTuple):
    """Loss factor of a sinusoid: tangent of the angle by which the force runs ahead of the depth.

    deviation: its standard deviation; frequency Hz; stiffness N/m, force over depth in phase.
    """

    factor: float
    deviation: float
    frequency: float
    stiffness: float


def cycles_of(time: Floats, depths: Floats, begin: int) -> slice | None:
    """Return the samples of the whole cycles of a sinusoid from a sample on, between crossings of its middle; or None.

    Parameters
    ----------
    time : Floats, shape (k,), s
        Times of a contact.
    depths : Floats, shape (k,), m
        Depths.
    begin : int
        Where the press has ended.
    """
    shallow = depths[begin:] < 0.5 * depths.max()
    end = begin + (int(np.argmax(shallow)) if shallow.any() else len(shallow))
    own = depths[begin:end]
    if len(own) < 4 * CYCLES:
        return None
    # The retreat is among the samples, which median and median deviation hardly feel.
    middle = float(np.median(own))
    amplitude = float(np.median(np.abs(own - middle))) / np.sin(0.25 * np.pi)
    if amplitude < LEAST:
        return None
    starts = _upward_crossings(own - middle, CROSSED * amplitude)
    if len(starts) <= CYCLES:
        return None
    periods = np.diff(time[begin + starts])
    if np.std(periods) > EVEN * np.mean(periods):
        return None
    found = slice(begin + int(starts[0]), begin + int(starts[-1]) + 1)
    moved = time[found] - time[found.start]
    return found if _left_over(1.0 / float(np.mean(periods)), moved, depths[found]) < 1.0 - PURE else None


def _upward_crossings(off: Floats, beyond: float) -> Floats:
    """Return the samples (c,) at which a signal (k,) crosses zero upwards, having been beyond on both sides."""
    state = np.where(off > beyond, 1, np.where(off < -beyond, -1, 0))
    known = np.flatnonzero(state)
    rising = np.flatnonzero(np.diff(state[known]) > 0)
    return np.array(
        [
            low + int(np.argmax(off[low:high] >= 0.0))
            for low, high in zip(known[rising], known[rising + 1] + 1, strict=True)
        ],
        dtype=np.int64,
    )


def _waves(frequency: float, time: Floats) -> Floats:
    """Return drift, the sinusoid and its double (k, 7), which stiffening tissue adds."""
    phase = 2.0 * np.pi * frequency * time
    drift = time / max(float(time[-1]), 1e-12)
    ones = np.ones_like(time)
    return np.stack(
        [np.cos(phase), np.sin(phase), ones, drift, drift**2, np.cos(2.0 * phase), np.sin(2.0 * phase)], axis=1
    )


def _left_over(frequency: float, time: Floats, values: Floats) -> float:
    """Return the fraction of the variance of values that a sinusoid and drift don't explain."""
    waves = _waves(frequency, time)[:, :5]
    left = values - waves @ np.linalg.lstsq(waves, values, rcond=None)[0]
    return float(np.var(left) / np.var(values))


def loss_of(swing: Sinusoid) -> Loss:
    """Return the loss factor of a sinusoid, by least squares at its frequency.

    The deviation contains the noise of the force, and half a sample by which force and depth may be apart in time.
    """
    time, depths, forces = swing.time, swing.depths, swing.forces
    above = depths - depths.mean()
    count = max(CYCLES, int(np.sum((above[1:] >= 0.0) & (above[:-1] < 0.0))))
    guess = _strongest(count / float(time[-1]), time, depths)
    frequency = float(
        minimize_scalar(
            lambda one: _left_over(one, time, depths),
            bounds=((1.0 - NEAR) * guess, (1.0 + NEAR) * guess),
            method="bounded",
            options={"xatol": 1e-5 * guess},
        ).x
    )
    waves = _waves(frequency, time)
    moved, of_force = (np.linalg.lstsq(waves, values, rcond=None)[0] for values in (depths, forces))
    stiffness = complex(of_force[0], -of_force[1]) / complex(moved[0], -moved[1])
    left = forces - waves @ of_force
    again = float(np.clip(np.corrcoef(left[1:], left[:-1])[0, 1], 0.0, 0.99)) if np.std(left) > 0.0 else 0.0
    alone = len(time) * (1.0 - again) / (1.0 + again)  # samples whose errors are independent
    noise = float(np.std(left)) * np.sqrt(2.0 / alone) / float(np.hypot(of_force[0], of_force[1]))
    apart = 2.0 * np.pi * frequency * float(np.median(np.diff(time))) / np.sqrt(12.0)
    return Loss(stiffness.imag / stiffness.real, float(np.hypot(noise, apart)), frequency, stiffness.real)


def _strongest(guess: float, time: Floats, depths: Floats) -> float:
    """Return the frequency about a guess that explains most of the depths."""
    tried = guess * np.linspace(0.5, 1.5, 41)
    return float(tried[int(np.argmin([_left_over(one, time, depths) for one in tried]))])
