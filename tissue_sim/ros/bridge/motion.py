"""Smooth motion of tools: minimum-jerk legs, joined into a path of poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BPoly
from scipy.spatial.transform import Rotation, Slerp

from tissue_sim.array_types import Floats

PEAK_OVER_MEAN = 1.875  # of a minimum-jerk motion's speed
FAST, OPENING = 0.150, 0.075  # m/s, peak
TURNING = 2.5  # rad/s, peak
SHORTEST = 0.1  # s, of any leg that moves
ARC_POINTS = 400

_QUINTIC = BPoly.from_derivatives([0.0, 1.0], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])


def minimum_jerk(progress: Floats) -> Floats:
    """Fraction of the way at a fraction of the time: no speed and no acceleration at both ends.

    Flash and Hogan (1985).
    """
    return np.clip(_QUINTIC(np.clip(progress, 0.0, 1.0)), 0.0, 1.0)


class Ball(NamedTuple):
    """Centre (3,) and radius, m, of a ball that holds the organ and the tools when they touch it."""

    centre: Floats
    radius: float

    def leave(self, start: Floats, way: Floats) -> Floats:
        """Where a line along a unit way (3,) leaves the ball; the start itself when that is outside already."""
        offset = start - self.centre
        b, c = float(offset @ way), float(offset @ offset) - self.radius**2
        return start if c >= 0.0 else start + (np.sqrt(b * b - c) - b) * way

    def arc(self, start: Floats, end: Floats) -> Floats:
        """Points (k, 3) m around the centre, the short way; start and end lie at the same distance from it."""
        turn = Rotation.align_vectors([end - self.centre], [start - self.centre])[0].as_rotvec()
        steps = Rotation.from_rotvec(np.linspace(0.0, 1.0, ARC_POINTS)[:, None] * turn)
        return self.centre + steps.apply(start - self.centre)


@dataclass(frozen=True)
class Path:
    """Poses of T tools at a rate in Hz.

    phases (m,): what goes on, such as `poke/hold`; poses (m, T, 7), m and quaternions xyzw; angles (m, T) rad between
    jaws; outward (m, T, 3): the way out of the tissue, zero where a tool is outside and clear of it. reach: m from the
    hinge of jaws to their tips.
    """

    rate: float
    ball: Ball
    reach: float
    phases: NDArray[np.str_]
    poses: Floats
    angles: Floats
    outward: Floats

    @classmethod
    def standing(cls, poses: Floats, rate: float, ball: Ball, reach: float) -> Path:
        """A path of one pose of each tool, (T, 7), with closed jaws."""
        none = np.zeros((1, len(poses), 3))
        return cls(rate, ball, reach, np.array(["pause"]), poses[None], none[:, :, 0], none)

    @property
    def duration(self) -> float:
        """Seconds from its first pose to the first of the next turn."""
        return len(self.poses) / self.rate

    def then(
        self,
        phase: str,
        to: Mapping[int, Floats] | None = None,
        speed: float = FAST,
        seconds: float = 0.0,
        angle: Mapping[int, float] | None = None,
        turn: Mapping[int, Floats] | None = None,
        outward: Mapping[int, Floats] | None = None,
    ) -> Path:
        """This path and one more leg; by the number of a tool what changes, all else stays.

        to: where it goes, (3,) m, or the points (k, 3) that it goes through, at a peak speed in m/s, also of the tips
        of jaws; angle: rad between its jaws, turn: its rotation (4,), at the end; seconds: how long it takes at least.
        """
        before, shut = self.poses[-1], self.angles[-1]
        to, angle, turn, outward = to or {}, angle or {}, turn or {}, outward or {}
        ways = [np.vstack([pose[:3], to.get(tool, pose[:3])]) for tool, pose in enumerate(before)]
        along = [np.append(0.0, np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))) for way in ways]
        turns = [Rotation.from_quat([pose[3:], turn.get(tool, pose[3:])]) for tool, pose in enumerate(before)]
        opening = np.array([angle.get(tool, now) for tool, now in enumerate(shut)]) - shut
        turning = max((end * start.inv()).magnitude() for start, end in turns)
        going = max(0.5 * self.reach * np.abs(opening).max(), *(length[-1] for length in along))
        least = PEAK_OVER_MEAN * max(going / speed, turning / TURNING)
        n = int(np.ceil(self.rate * max(least, SHORTEST if least > 1e-6 else 0.0, seconds) - 1e-9))
        if n == 0:
            return self
        share = minimum_jerk(np.arange(1, n + 1) / n)
        places = [
            np.stack([np.interp(share * length[-1], length, axis) for axis in way.T], axis=1)
            for way, length in zip(ways, along, strict=True)
        ]
        rotations = [Slerp([0.0, 1.0], pair)(share).as_quat() for pair in turns]
        out = np.array([outward.get(tool, np.zeros(3)) for tool in range(len(before))])
        return replace(
            self,
            phases=np.append(self.phases, [phase] * n),
            poses=np.concatenate([self.poses, np.concatenate([places, rotations], axis=2).swapaxes(0, 1)]),
            angles=np.concatenate([self.angles, shut + share[:, None] * opening]),
            outward=np.concatenate([self.outward, np.broadcast_to(out, (n, *out.shape))]),
        )

    def retreat(self, index: int) -> Path:
        """From one of the poses straight out. Jaws open first: they would take along what they hold."""
        here = {name: getattr(self, name)[index : index + 1] for name in ("phases", "poses", "angles", "outward")}
        inside = {tool: way for tool, way in enumerate(self.outward[index]) if way.any()}
        opened = {tool: float(self.angles[:, tool].max()) for tool in inside}
        out = {tool: self.ball.leave(self.poses[index, tool, :3], way) for tool, way in inside.items()}
        return replace(self, **here).then("open", speed=OPENING, angle=opened).then("retreat", out)
