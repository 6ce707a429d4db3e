"""What a run of an organ shows, tick by tick, and how far two runs are apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs


@dataclass(frozen=True)
class Shown:
    """The wrenches and surfaces that were handed out, with the ticks that they show.

    By tool: wrench_ticks (k,), wrenches (k, 6) N and N m about the tool's origin. By organ: surface_ticks (s,),
    surfaces (s, n, 3) m.
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
        """What is shown of the ticks from first to last."""
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
        """The same, so many ticks later."""
        moved = [[shown + ticks for shown in every] for every in (self.wrench_ticks, self.surface_ticks)]
        return Shown(self.tools, moved[0], self.wrenches, moved[1], self.surfaces)


@dataclass(frozen=True)
class Deviation:
    """How far a quantity is off, by tick: ticks (k,), ascending, values (k,) in its unit; and what is tolerated."""

    what: str
    unit: str
    tolerance: float
    ticks: Longs
    values: Floats

    @property
    def largest(self) -> float:
        """In its unit; 0 where nothing was compared."""
        return float(self.values.max(initial=0.0))

    @property
    def tick(self) -> int:
        """Of the largest; -1 where nothing is off."""
        return int(self.ticks[np.argmax(self.values)]) if self.largest > 0.0 else -1

    def __str__(self) -> str:
        return f"{self.what} {self.largest:.3g} {self.unit}{f' (tick {self.tick})' if self.largest else ''}"

    @property
    def first_beyond(self) -> int:
        """The first tick that is off by more than is tolerated; -1 where none is."""
        beyond = np.flatnonzero(self.values > self.tolerance)
        return int(self.ticks[beyond[0]]) if len(beyond) else -1


@dataclass(frozen=True)
class Comparison:
    """How far two runs are apart."""

    wrenches: int
    surfaces: int
    force: Deviation  # N
    torque: Deviation  # N m
    position: Deviation  # m

    @property
    def quantities(self) -> tuple[Deviation, Deviation, Deviation]:
        """All of them."""
        return self.force, self.torque, self.position

    @property
    def holds_nothing(self) -> bool:
        """True where there was nothing to compare, which is no success."""
        return self.wrenches == 0 and self.surfaces == 0

    @property
    def first_beyond(self) -> int:
        """The first tick at which any quantity is off by more than is tolerated; -1 where none is."""
        return min((found.first_beyond for found in self.quantities if found.first_beyond >= 0), default=-1)

    @property
    def passes(self) -> bool:
        """True where something was compared, and all is within the tolerances."""
        return not self.holds_nothing and self.first_beyond < 0


def compare(wanted: Shown, found: Shown, force_tolerance: float, position_tolerance: float) -> Comparison:
    """How far what was found is from what was wanted, at the same ticks; tolerances in N and N m, and in m."""
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
    """How far each number is off; what is no number is off by infinity."""
    with np.errstate(invalid="ignore"):  # of what a damaged bag says to be numbers
        apart = np.abs(np.asarray(wanted, dtype=np.float64) - found)
    apart[np.isnan(apart)] = np.inf
    return apart
