"""Friction from strokes, and why it can't be identified from other recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.identification.measured import MeasuredStroke


class Friction(NamedTuple):
    """Coefficient of friction, and its standard deviation between strokes (0 for a single one)."""

    coefficient: float
    deviation: float
    strokes: int


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
