"""Smooth motion of tools: minimum-jerk pieces joined into a path that repeats."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from tissue_sim.array_types import Floats

PEAK_OVER_MEAN = 1.875  # of a minimum-jerk motion's speed
TURNING = 2.5  # rad/s, peak
SHORTEST = 0.1  # s, of any motion


def minimum_jerk(progress: Floats) -> Floats:
    """Fraction of the way at a fraction of the time: no speed and no acceleration at both ends.

    Flash and Hogan (1985).
    """
    s = np.clip(progress, 0.0, 1.0)
    return np.minimum(s**3 * (10.0 + s * (6.0 * s - 15.0)), 1.0)  # rounding takes it past 1 right before the end


@dataclass(frozen=True)
class Move:
    """How one tool moves: along a spline through points (k, 3) m, turning from one rotation to another."""

    points: Floats
    rotations: Rotation  # two: at the start and at the end

    @staticmethod
    def line(start: Floats, end: Floats, turn: Rotation) -> Move:
        """Straight, without turning."""
        return Move(np.array([start, end]), Rotation.concatenate([turn, turn]))

    @staticmethod
    def arc(centre: Floats, start: Floats, end: Floats, turn: tuple[Rotation, Rotation]) -> Move:
        """Around a centre, the short way; start and end lie at the same distance from it."""
        a, b = start - centre, end - centre
        radius = float(np.linalg.norm(a))
        axis = np.cross(a, b)
        if np.linalg.norm(axis) < 1e-9 * radius**2:  # the same point, or the opposite one: any way round will do
            axis = np.cross(a, np.eye(3)[np.abs(a).argmin()])
        axis /= np.linalg.norm(axis)
        angle = float(np.arctan2(np.cross(a, b) @ axis, a @ b))
        steps = np.linspace(0.0, angle, max(2, int(np.ceil(abs(angle) / 0.05)) + 1))
        points = centre + Rotation.from_rotvec(steps[:, None] * axis).apply(a)
        return Move(points, Rotation.concatenate(turn))

    @property
    def length(self) -> float:
        """Metres from start to end."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())

    @property
    def angle(self) -> float:
        """Radians from the first rotation to the last."""
        return float((self.rotations[0].inv() * self.rotations[1]).magnitude())

    def poses(self, fraction: Floats) -> Floats:
        """Poses (m, 7), position m and quaternion x y z w, at fractions (m,) of the way."""
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        out = np.empty((len(fraction), 7))
        if steps.sum() < 1e-12:
            out[:, :3] = self.points[0]
        elif len(self.points) == 2:
            out[:, :3] = self.points[0] + fraction[:, None] * (self.points[1] - self.points[0])
        else:
            along = np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()
            out[:, :3] = CubicSpline(along, self.points)(fraction)
        out[:, 3:] = Slerp([0.0, 1.0], self.rotations)(fraction).as_quat()
        return out


@dataclass(frozen=True)
class Segment:
    """One phase of a path.

    name; duration s; one move for each tool; outward (T, 3): the way out of the tissue, zero where a
    tool is outside and clear of it; jaws (2, T): angles in rad between the jaws of each at the start and at the end,
    zero for tools that have none.
    """

    name: str
    duration: float
    moves: tuple[Move, ...]
    outward: Floats
    jaws: Floats | None = None  # None: all are zero

    @staticmethod
    def timed(
        name: str, moves: Sequence[Move], outward: Floats, speed: float, jaws: Floats | None = None, reach: float = 0.0
    ) -> Segment:
        """A segment as long as its farthest move takes with a peak speed in m/s, also of the tips of jaws.

        reach: m from their hinge to their tips.
        """
        duration = max(max(PEAK_OVER_MEAN * m.length / speed, PEAK_OVER_MEAN * m.angle / TURNING) for m in moves)
        if jaws is not None:
            duration = max(duration, PEAK_OVER_MEAN * 0.5 * float(np.ptp(jaws, axis=0).max()) * reach / speed)
        return Segment(name, max(duration, SHORTEST), tuple(moves), outward, jaws)

    def poses(self, time: Floats) -> Floats:
        """Poses (m, T, 7) at times (m,) s from the segment's start."""
        fraction = minimum_jerk(time / self.duration)
        return np.stack([move.poses(fraction) for move in self.moves], axis=1)

    def angles(self, time: Floats) -> Floats:
        """Angles (m, T) rad between the jaws at times (m,) s from the segment's start."""
        start, end = np.zeros((2, len(self.moves))) if self.jaws is None else self.jaws
        return start + minimum_jerk(time / self.duration)[:, None] * (end - start)


@dataclass(frozen=True)
class Path:
    """Motion of tools, in a frame, that ends where it begins.

    tools (T); segments in order; centre (3,) m and radius m of a ball that holds the organ and the
    tools when they touch it.
    """

    tools: tuple[str, ...]
    segments: tuple[Segment, ...]
    centre: Floats
    radius: float
    starts: Floats = field(init=False, repr=False)  # s, of each segment, and the end

    def __post_init__(self) -> None:
        durations = [segment.duration for segment in self.segments]
        object.__setattr__(self, "starts", np.concatenate([[0.0], np.cumsum(durations)]))

    @property
    def duration(self) -> float:
        """Seconds of one cycle."""
        return float(self.starts[-1])

    def _at(self, time: float) -> tuple[Segment, float]:
        time = float(time) % self.duration
        index = min(int(np.searchsorted(self.starts, time, side="right")) - 1, len(self.segments) - 1)
        return self.segments[index], time - float(self.starts[index])

    def phase(self, time: float) -> str:
        """Name of the phase at a time in s, such as `poke/hold`; the path repeats."""
        return self._at(time)[0].name

    def poses(self, time: float) -> dict[str, tuple[Floats, Floats]]:
        """Position (3,) m and quaternion (4,) x y z w of each tool at a time in s; the path repeats."""
        segment, since = self._at(time)
        pose = segment.poses(np.array([since]))[0]
        return {tool: (pose[i, :3], pose[i, 3:]) for i, tool in enumerate(self.tools)}

    def sample(self, rate: float) -> Floats:
        """One cycle as poses (m, T, 7) at a rate in Hz."""
        return self._sample(rate, Segment.poses, (len(self.tools), 7))

    def sample_jaws(self, rate: float) -> Floats:
        """The angles (m, T) rad between the jaws of each tool, beside the poses of `sample`."""
        return self._sample(rate, Segment.angles, (len(self.tools),))

    def _sample(self, rate: float, values: Callable[[Segment, Floats], Floats], shape: tuple[int, ...]) -> Floats:
        times = np.arange(max(1, round(self.duration * rate))) / rate
        which = np.clip(np.searchsorted(self.starts, times, side="right") - 1, 0, len(self.segments) - 1)
        out = np.empty((len(times), *shape))
        for index, segment in enumerate(self.segments):
            chosen = which == index
            out[chosen] = values(segment, times[chosen] - self.starts[index])
        return out

    def retreat(self, time: float, rate: float, speed: float = 0.15) -> Floats:
        """Poses (m, T, 7) at a rate in Hz that take the tools straight out, from where they are at a time.

        Jaws open first: they would take along what they hold.
        """
        return self._leave(time, rate, speed, Segment.poses)

    def retreat_jaws(self, time: float, rate: float, speed: float = 0.15) -> Floats:
        """The angles (m, T) rad between the jaws of each tool, beside the poses of `retreat`."""
        return self._leave(time, rate, speed, Segment.angles)

    def _leave(self, time: float, rate: float, speed: float, values: Callable[[Segment, Floats], Floats]) -> Floats:
        segment, since = self._at(time)
        now = np.array([since])
        pose, angle = segment.poses(now)[0], segment.angles(now)[0]
        stay, out = [], []
        for tool, way in enumerate(segment.outward):
            start, turn = pose[tool, :3], Rotation.from_quat(pose[tool, 3:])
            stay.append(Move.line(start, start, turn))
            out.append(Move.line(start, leave(start, way, self.centre, self.radius), turn))
        opened = np.where(segment.outward.any(axis=1), self._widest(), angle)
        parts = [Segment.timed("retreat", out, segment.outward, speed, np.array([opened, opened]))]
        if np.any(opened > angle):
            turning = PEAK_OVER_MEAN * float((opened - angle).max()) / TURNING
            parts.insert(0, Segment("open", turning, tuple(stay), segment.outward, np.array([angle, opened])))
        times = [np.arange(1, max(2, int(np.ceil(part.duration * rate)) + 1)) / rate for part in parts]
        return np.concatenate([values(part, at) for part, at in zip(parts, times, strict=True)])

    def _widest(self) -> Floats:
        """Largest angle (T,) rad between the jaws of each tool."""
        none = np.zeros((1, len(self.tools)))
        return np.asarray(np.concatenate([none, *(s.jaws for s in self.segments if s.jaws is not None)]).max(axis=0))


def leave(start: Floats, way: Floats, centre: Floats, radius: float) -> Floats:
    """Where a line from inside a ball leaves it; the start itself when `way` is zero or it is outside already."""
    offset = start - centre
    b, c = float(offset @ way), float(offset @ offset) - radius**2
    if not np.any(way) or c >= 0.0:
        return start
    return start + (-b + np.sqrt(b * b - c)) * way
