"""A recorded bag as NumPy arrays with names and units, without ROS."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.array_types import Array, Floats, Longs
from tissue_sim.contact.tools import Tool
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags.recording import Recording, tools_of


@dataclass(frozen=True, eq=False, repr=False)
class Series:
    """A recorded quantity over simulated time.

    name, such as `left/force`; unit, such as `N`, empty for a quaternion; ticks (k,) that it belongs to; time (k,) s
    since the bag's first tick; values (k, ...) in the unit.
    """

    name: str
    unit: str
    ticks: Longs
    time: Floats
    values: Array

    def __len__(self) -> int:
        return len(self.ticks)

    def __repr__(self) -> str:
        span = f"{self.time[0]:.3f} to {self.time[-1]:.3f} s" if len(self) else "empty"
        return f"<Series {self.name}: {self.values.shape} {self.unit or 'xyzw'}, {span}>"

    def at(self, ticks: ArrayLike) -> Array:
        """Return the newest values at some ticks (m,), as (m, ...); NaN before the first."""
        index = np.searchsorted(self.ticks, np.asarray(ticks), side="right") - 1
        if not len(self):
            return np.full((len(index), *self.values.shape[1:]), np.nan)
        found = np.array(self.values[np.maximum(index, 0)], dtype=np.float64)
        found[index < 0] = np.nan
        return found


class Bag(Mapping[str, Series]):
    """What a bag holds, by name.

    Of each tool `left`: `left/position` m, `left/quaternion`, `left/angle` rad (grippers), as ticks took them up, and
    `left/external_force` N; `left/force` N and `left/torque` N m on the hand. Of each organ `kidney`:
    `kidney/surface`, positions (k, n_surface, 3) m. All in the axes of the organ or the scene.
    """

    def __init__(self, path: Path, recording: Recording) -> None:
        config = recording.config
        self.path = path
        self.recording = recording
        self.parameters: JsonObject = config["parameters"]
        self.rate = float(config["parameters"]["rate"])  # Hz, when the recording began
        self.version = str(config["package_version"])  # of the package that recorded it
        self.tools: list[Tool] = tools_of(config)
        self.organ_names = list(config["organs"]) if "organs" in config else [config["organ"]["name"]]
        clock = self.clock = Clock(recording)  # s at ticks
        self.first_tick, self.last_tick = recording.first_tick, max(recording.first_tick, recording.last_tick)
        self.duration = float(clock([self.last_tick])[0])  # s
        self._series = {}
        for name, unit, ticks, values in _all_of(recording, self.tools, self.organ_names):
            # A wrench of no tick was sent while nothing was simulated; one of the same tick is the same.
            known, index = np.unique(ticks, return_index=True)
            known, index = known[known >= 0], index[known >= 0]
            if len(known):
                self._series[name] = Series(name, unit, known, clock(known), values[index])

    @cached_property
    def organs(self) -> dict[str, Organ]:
        """Return the organs of the recording, by name."""
        return {name: one.organ() for name, one in zip(self.organ_names, self.recording.organs, strict=True)}

    def __getitem__(self, name: str) -> Series:
        return self._series[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._series)

    def __len__(self) -> int:
        return len(self._series)

    def __repr__(self) -> str:
        width = max(map(len, self), default=0)
        rows = [f"  {one.name:<{width}}  {one.values.shape!s:<15} {one.unit}".rstrip() for one in self.values()]
        head = f"<Bag {self.path}: {self.duration:.3f} s from {self.rate:g} ticks a second, tissue_sim {self.version}"
        return "\n".join([head, *rows]) + ">"


def read_bag(path: str | os.PathLike[str]) -> Bag:
    """Read a recorded bag.

    Parameters
    ----------
    path
        Its folder. One that is still recorded, or was broken off, is read as far as it goes.

    Returns
    -------
    Bag
        Arrays by name, and the organs and tools of the recording.

    Raises
    ------
    UserError
        For a folder that is missing, damaged, or was not recorded by a node of tissue_sim.
    """
    return Bag(Path(path), Recording.read(Path(path)))


def _all_of(
    recording: Recording, tools: Sequence[Tool], organs: Sequence[str]
) -> Iterator[tuple[str, str, Longs, Array]]:
    """Yield name, unit, ticks (k,) and values (k, ...) of everything in a bag."""
    shown, body = recording.shown(), 0
    for number, tool in enumerate(tools):
        ticks, poses = _taken(recording, body, "pose", recording.poses[number], 7)
        yield f"{tool.name}/position", "m", ticks, poses[:, :3]
        yield f"{tool.name}/quaternion", "", ticks, poses[:, 3:]
        if tool.has_jaws:
            angles = {sequence: np.array([angle]) for sequence, angle in recording.angles[number].items()}
            ticks, values = _taken(recording, body, "pose", angles, 1)
            yield f"{tool.name}/angle", "rad", ticks, values[:, 0]
        ticks, forces = _taken(recording, body, "force", recording.forces[number], 3)
        yield f"{tool.name}/external_force", "N", ticks, forces
        yield f"{tool.name}/force", "N", shown.wrench_ticks[number], shown.wrenches[number][:, :3]
        yield f"{tool.name}/torque", "N m", shown.wrench_ticks[number], shown.wrenches[number][:, 3:]
        body += tool.n_bodies
    for name, ticks, surfaces in zip(organs, shown.surface_ticks, shown.surfaces, strict=True):
        yield f"{name}/surface", "m", ticks, surfaces


def _taken(recording: Recording, body: int, kind: str, given: Mapping[int, Floats], size: int) -> tuple[Longs, Floats]:
    """Return the ticks (k,) that took up an input of a body, and what it was, (k, size)."""
    ticks, sequences = recording.used_poses(body, kind)
    pairs = [(tick, given[number]) for tick, number in zip(ticks, sequences, strict=True) if number in given]
    values = np.array([value for _, value in pairs]).reshape(len(pairs), size)
    return np.array([tick for tick, _ in pairs], dtype=np.int64), values


class Clock:
    """Simulated time, s, of ticks since the first one: the rate may change while a bag is recorded."""

    def __init__(self, recording: Recording) -> None:
        organ = recording.organs[0]
        first, rows = recording.first_tick, organ.journal["inputs"]
        before, after = rows[rows["tick"] <= first], rows[rows["tick"] > first]
        newest = int(before["settings"][-1]) if len(before) else 0
        changed = np.flatnonzero(np.diff(after["settings"], prepend=newest))
        numbers = [newest, *after["settings"][changed].tolist()]
        known = np.array(sorted(organ.settings))
        place = np.maximum(np.searchsorted(known, numbers, side="right") - 1, 0)  # as replays do
        lengths = np.array(
            [float(organ.settings[number].tick_time) for number in known[place].tolist()]
        )  # s, of a tick
        # Each length holds from `starts` on, whose tick is the first of that length.
        self._starts = np.array([first + 1, *after["tick"][changed].tolist()], dtype=np.int64)
        self._lengths = lengths
        self._began = np.concatenate([[0.0], np.cumsum(np.diff(self._starts) * lengths[:-1])])

    def __call__(self, ticks: ArrayLike) -> Floats:
        """Return the time (k,) s at the end of ticks (k,)."""
        given = np.asarray(ticks, dtype=np.int64)
        part = np.maximum(np.searchsorted(self._starts, given, side="right") - 1, 0)
        return np.asarray(self._began[part] + (given + 1 - self._starts[part]) * self._lengths[part])
