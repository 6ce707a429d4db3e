"""Results of a run of an organ, tick by tick, and the deviation between two runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs


@dataclass(frozen=True)
class Shown:
    """The wrenches and surfaces that were posted, with the ticks that they show.

    Attributes
    ----------
    tools : Sequence[str]
        Names of the tools.
    wrench_ticks : Sequence[Longs], shape (k,)
        Ticks of each tool's wrenches.
    wrenches : Sequence[Floats], shape (k, 6), N and N m
        Each tool's wrenches about its origin.
    surface_ticks : Sequence[Longs], shape (s,)
        Ticks of each organ's surfaces.
    surfaces : Sequence[NDArray[np.float32]], shape (s, n, 3), m
        Each organ's surfaces.
    """

    tools: Sequence[str]
    wrench_ticks: Sequence[Longs]
    wrenches: Sequence[Floats]
    surface_ticks: Sequence[Longs]
    surfaces: Sequence[NDArray[np.float32]]

    @property
    def ticks(self) -> Longs:
        """Every tick of which something is shown, ascending."""
        return np.unique(np.concatenate([*self.wrench_ticks, *self.surface_ticks]))

    def within(self, first: int, last: int) -> Shown:
        """Return what is shown of the ticks from first to last."""
        wanted = [(ticks >= first) & (ticks <= last) for ticks in self.wrench_ticks]
        shapes = [(ticks >= first) & (ticks <= last) for ticks in self.surface_ticks]
        return Shown(
            self.tools,
            [ticks[chosen] for ticks, chosen in zip(self.wrench_ticks, wanted, strict=True)],
            [wrenches[chosen] for wrenches, chosen in zip(self.wrenches, wanted, strict=True)],
            [ticks[chosen] for ticks, chosen in zip(self.surface_ticks, shapes, strict=True)],
            [surfaces[chosen] for surfaces, chosen in zip(self.surfaces, shapes, strict=True)],
        )

    def later(self, ticks: int) -> Shown:
        """Return the same, some ticks later."""
        moved = [[shown + ticks for shown in every] for every in (self.wrench_ticks, self.surface_ticks)]
        return Shown(self.tools, moved[0], self.wrenches, moved[1], self.surfaces)


@dataclass(frozen=True)
class Deviation:
    """Deviation of a quantity by tick.

    Attributes
    ----------
    what : str
        Name of the quantity.
    unit : str
        Its unit.
    tolerance : float
        Largest deviation tolerated, in that unit.
    ticks : Longs, shape (k,)
        The ticks, ascending.
    values : Floats, shape (k,)
        The deviation at each, in that unit.
    """

    what: str
    unit: str
    tolerance: float
    ticks: Longs
    values: Floats

    @property
    def largest(self) -> float:
        """Largest deviation, in its unit; 0 where nothing was compared."""
        return float(self.values.max(initial=0.0))

    @property
    def tick(self) -> int:
        """Tick of the largest deviation; -1 where there is none."""
        return int(self.ticks[np.argmax(self.values)]) if self.largest > 0.0 else -1

    def __str__(self) -> str:
        return f"{self.what} {self.largest:.3g} {self.unit}{f' (tick {self.tick})' if self.largest else ''}"

    @property
    def first_beyond(self) -> int:
        """First tick beyond the tolerance; -1 where there is none."""
        beyond = np.flatnonzero(self.values > self.tolerance)
        return int(self.ticks[beyond[0]]) if len(beyond) else -1


@dataclass(frozen=True)
class Comparison:
    """Deviations between two runs."""

    wrenches: int
    surfaces: int
    force: Deviation  # N
    torque: Deviation  # N m
    position: Deviation  # m

    @property
    def quantities(self) -> tuple[Deviation, Deviation, Deviation]:
        """All three deviations."""
        return self.force, self.torque, self.position

    @property
    def is_empty_comparison(self) -> bool:
        """Whether there was nothing to compare, which is no success."""
        return self.wrenches == 0 and self.surfaces == 0

    @property
    def first_beyond(self) -> int:
        """First tick at which any quantity is beyond its tolerance; -1 where none is."""
        return min((found.first_beyond for found in self.quantities if found.first_beyond >= 0), default=-1)

    @property
    def passes(self) -> bool:
        """Whether something was compared, and all is within the tolerances."""
        return not self.is_empty_comparison and self.first_beyond < 0


def compare(wanted: Shown, found: Shown, force_tolerance: float, position_tolerance: float) -> Comparison:
    """Compare two runs at the same ticks.

    wanted: the run that is taken as true; found: the run that is compared with it; force_tolerance: largest deviation
    of a wrench, N and N m; position_tolerance: largest deviation of a position, m.
    """
    wrench_ticks = np.concatenate([*wanted.wrench_ticks, np.zeros(0, dtype=np.int64)])
    order = np.argsort(wrench_ticks, kind="stable")
    off = _off(
        np.concatenate([*wanted.wrenches, np.zeros((0, 6))]), np.concatenate([*found.wrenches, np.zeros((0, 6))])
    )
    moved = [_off(*both).max(axis=(1, 2), initial=0.0) for both in zip(wanted.surfaces, found.surfaces, strict=True)]
    surface_ticks = np.concatenate([*wanted.surface_ticks, np.zeros(0, dtype=np.int64)])
    later = np.argsort(surface_ticks, kind="stable")
    parts = (slice(0, 3), slice(3, 6))
    force, torque = (off[order][:, part].max(axis=1, initial=0.0) for part in parts)
    return Comparison(
        wrenches=len(wrench_ticks),
        surfaces=len(surface_ticks),
        force=Deviation("force", "N", force_tolerance, wrench_ticks[order], force),
        torque=Deviation("torque", "N m", force_tolerance, wrench_ticks[order], torque),
        position=Deviation(
            "position",
            "m",
            position_tolerance,
            surface_ticks[later],
            np.concatenate([*moved, np.zeros(0)])[later],
        ),
    )


def _off(wanted: NDArray, found: NDArray) -> Floats:
    """Return the absolute deviation of each number; it is infinite where there is no number."""
    with np.errstate(invalid="ignore"):  # a damaged bag may hold any numbers
        apart = np.abs(np.asarray(wanted, dtype=np.float64) - found)
    apart[np.isnan(apart)] = np.inf
    return apart
