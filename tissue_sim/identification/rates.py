"""Friction from strokes, relaxation from holds, and why they can't be identified from other recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import curve_fit

from tissue_sim.identification.measured import Hold, MeasuredStroke

LONG_ENOUGH = 10.0  # s, of a hold
RIPPLE = 0.5  # of the mean ratio: variation along a stroke, above which it isn't friction


class Friction(NamedTuple):
    """Coefficient of friction, and its standard deviation between strokes (0 for a single one)."""

    coefficient: float
    deviation: float
    strokes: int


class Relaxation(NamedTuple):
    """Share of the force that decays in a hold, and the time constant, s."""

    share: float
    time: float
    holds: int


def friction_of(strokes: Sequence[MeasuredStroke]) -> tuple[Friction | None, str]:
    """Return the coefficient of Coulomb friction of sliding strokes, or None; and a line about it."""
    ratios = [float(np.median(stroke.against / stroke.normal)) for stroke in strokes if len(stroke.normal)]
    if not ratios:
        return (
            None,
            "friction: not identifiable from this recording: no stroke was found (a tool that slides in contact)",
        )
    if min(ratios) < 0.0:
        return None, "friction: not identifiable from this recording: the force of a stroke points along its motion"
    found = Friction(float(np.median(ratios)), float(np.std(ratios)), len(ratios))
    return found, f"friction: {found.coefficient:.2f} (strokes: {found.strokes}, deviation {found.deviation:.2f})"


def relaxation_of(holds: Sequence[Hold], has_times: bool) -> tuple[Relaxation | None, str]:
    """Return how forces relax in holds of 10 s, or None; and a line about it.

    The model has no relaxation: the line tells how much of the force its modulus leaves out.
    """
    before = "damping and relaxation: not identifiable from this recording: "
    if not has_times:
        return None, before + "its samples have no times"
    longest = max((float(np.ptp(hold.time)) for hold in holds), default=0.0)
    some = [hold for hold in holds if np.ptp(hold.time) >= LONG_ENOUGH]
    if not some:
        return None, f"{before}the longest hold lasts {longest:.1f} s, and {LONG_ENOUGH:g} s are needed"
    shares, times = zip(*(_decay(hold) for hold in some), strict=True)
    found = Relaxation(float(np.median(shares)), float(np.median(times)), len(some))
    return found, (
        f"relaxation: the force decays by {100 * found.share:.0f} % with {found.time:.1f} s (holds: {found.holds}); the"
        " model doesn't relax, and has the modulus of the loading; damping needs a sinusoid, which isn't evaluated"
    )


def _decay(hold: Hold) -> tuple[float, float]:
    """Return the decaying share of a hold's force and its time constant, s."""
    time = hold.time - hold.time[0]
    first, last = float(np.median(hold.force[:5])), float(np.median(hold.force[-20:]))

    def decay(t: np.ndarray, rest: float, part: float, constant: float) -> np.ndarray:
        return np.asarray(rest + part * np.exp(-t / constant))

    limits = ([-np.inf, -np.inf, 1e-2], [np.inf, np.inf, 10.0 * float(time[-1])])
    found, _ = curve_fit(decay, time, hold.force, (last, first - last, 0.2 * float(time[-1])), bounds=limits)
    return float(found[1] / max(found[0] + found[1], 1e-9)), float(found[2])
