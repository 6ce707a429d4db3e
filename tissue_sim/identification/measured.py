"""Measured presses and strokes of a round tool, as the identification takes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs, Mask
from tissue_sim.errors import UserError

DEEP_PART = 0.3  # of a press's depth, from where its force counts for errors
LEAST_FORCE = 0.05  # N, relative to which smaller forces are judged


class MeasuredPress(NamedTuple):
    """A tool that goes into tissue, up to where it was deepest.

    Attributes
    ----------
    name : str
        What messages call it.
    depths : Floats, shape (d,), m
        Along the direction from where the tool first touched, as far as the recording knows; negative before.
    forces : Floats, shape (d,), N
        On the tool, against the direction.
    place : Floats, shape (3,), m
        Middle of the tool at depth 0, in the organ's axes; NaN where it is unknown.
    direction : Floats, shape (3,)
        Direction into the tissue; NaN where it is unknown.
    drift : Floats, shape (d, 3), m
        Displacement of the tool across the direction; empty for none.
    speed : float, m/s
        Mean speed along the direction; 0 where no times are known.
    """

    name: str
    depths: Floats
    forces: Floats
    place: Floats
    direction: Floats
    drift: Floats
    speed: float = 0.0

    @property
    def is_placed(self) -> bool:
        """Whether its place on the organ is known."""
        return bool(np.isfinite(self.place).all() and np.isfinite(self.direction).all())

    @property
    def deepest(self) -> float:
        """Largest depth, m."""
        return float(self.depths.max())


class MeasuredStroke(NamedTuple):
    """A tool that slides over tissue: force along the normal and against the motion, (k,) N; length of its path, m."""

    name: str
    normal: Floats
    against: Floats
    length: float


class Hold(NamedTuple):
    """A tool that goes into tissue and stands still there.

    press: name of the press; time (k,) s since the tool stopped, negative while it enters; depths (k,) m as of the
    press, and forces (k,) N against the direction.
    """

    press: str
    time: Floats
    depths: Floats
    forces: Floats

    @property
    def length(self) -> float:
        """How long the tool stands still, s."""
        return float(self.time[-1])


class Sinusoid(NamedTuple):
    """A tool that swings along its direction in tissue: whole cycles, as of `Hold`; times since the first one, s."""

    press: str
    time: Floats
    depths: Floats
    forces: Floats


class Measurement(NamedTuple):
    """All that was found in a recording of one round tool.

    Attributes
    ----------
    source : str
        What it was read from.
    radius : float, m
        Radius of the tool.
    presses : list[MeasuredPress]
        Presses.
    strokes : list[MeasuredStroke]
        Strokes.
    holds : list[Hold]
        Holds.
    is_registered : bool
        Whether places are in the organ's axes; otherwise they only distinguish presses.
    sinusoids : Sequence[Sinusoid]
        Sinusoids.
    """

    source: str
    radius: float
    presses: list[MeasuredPress]
    strokes: list[MeasuredStroke]
    holds: list[Hold]
    is_registered: bool
    sinusoids: Sequence[Sinusoid] = ()

    @property
    def points(self) -> Floats:
        """Where the tool first touched the surface, (n, 3) m; NaN where it is unknown."""
        return np.array([press.place + self.radius * press.direction for press in self.presses])


class Samples(NamedTuple):
    """Depths m and forces N of all presses, (n, d), padded; counts: which of them are measurements."""

    depths: Floats
    forces: Floats
    counts: Floats

    @property
    def judged(self) -> Floats:
        """Which samples an error is the median of, (n, d): those in the deeper part of each press."""
        deepest = np.where(self.counts > 0.0, self.depths, -np.inf).max(axis=1)
        return np.asarray((self.counts > 0.0) & (self.depths >= DEEP_PART * deepest[:, None]))

    def some(self, chosen: Longs | Mask) -> Samples:
        """Return the samples of some presses, by index or by a mask."""
        return Samples(self.depths[chosen], self.forces[chosen], self.counts[chosen])

    def up_to(self, depth: float) -> Samples:
        """Return the samples at most so deep, m."""
        return self._replace(counts=self.counts * (self.depths <= depth))


def samples_of(presses: list[MeasuredPress]) -> Samples:
    """Return the samples of presses.

    Parameters
    ----------
    presses : list[MeasuredPress]
        The presses.

    Returns
    -------
    Samples
        Padded arrays.

    Raises
    ------
    UserError
        Where there is no press.
    """
    if not presses:
        raise UserError("no press was found; see docs/identify.md for what a recording needs")
    longest = max(len(press.depths) for press in presses)
    depths, forces, counts = (np.zeros((len(presses), longest)) for _ in range(3))
    for row, press in enumerate(presses):
        own = len(press.depths)
        depths[row, :own], forces[row, :own], counts[row, :own] = press.depths, press.forces, 1.0
    return Samples(depths, forces, counts)


def relative_errors(samples: Samples, predicted: Floats) -> Floats:
    """Return the errors of predicted forces (n, d) N, relative to the measured ones, (n, d); NaN where none counts."""
    off = np.abs(predicted - samples.forces) / np.maximum(np.abs(samples.forces), LEAST_FORCE)
    return np.where(samples.judged, off, np.nan)
