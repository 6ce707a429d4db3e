"""Smooth motion of tools: minimum-jerk legs, joined into a path of poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BPoly
from scipy.spatial.transform import Rotation, Slerp

from tissue_sim.array_types import Floats
from tissue_sim.organ.polyline import arc_length

PEAK_OVER_MEAN = 1.875  # peak over mean speed of a minimum-jerk motion
FAST, OPENING = 0.150, 0.075  # m/s, peak
TURNING = 2.5  # rad/s, peak
SHORTEST = 0.1  # s, of any leg that moves
ARC_POINTS = 400

_QUINTIC = BPoly.from_derivatives([0.0, 1.0], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])


def minimum_jerk(progress: Floats) -> Floats:
    """Return the fraction of the path at a fraction of the time [1]_: without speed and acceleration at both ends.

    Parameters
    ----------
    progress : Floats
        Fraction of the time, 0 to 1.

    References
    ----------
    .. [1] T. Flash and N. Hogan, "The coordination of arm movements", Journal of Neuroscience 5, 1985.
    """
    return np.clip(_QUINTIC(np.clip(progress, 0.0, 1.0)), 0.0, 1.0)


class Ball(NamedTuple):
    """Centre (3,) and radius, m, of a ball that holds the organ and the tools when they touch it."""

    centre: Floats
    radius: float

    def leave(self, start: Floats, direction: Floats) -> Floats:
        """Return where a line leaves the ball; the start itself when that is outside already.

        start (3,) m: start of the line; direction (3,): of length 1.
        """
        offset = start - self.centre
        b, c = float(offset @ direction), float(offset @ offset) - self.radius**2
        return start if c >= 0.0 else start + (np.sqrt(b * b - c) - b) * direction

    def arc(self, start: Floats, end: Floats) -> Floats:
        """Return points (k, 3) m around the centre, on the shorter arc, between points at the same distance from it.

        start (3,) m: first point; end (3,) m: last point.
        """
        turn = Rotation.align_vectors([end - self.centre], [start - self.centre])[0].as_rotvec()
        steps = Rotation.from_rotvec(np.linspace(0.0, 1.0, ARC_POINTS)[:, None] * turn)
        return self.centre + steps.apply(start - self.centre)


@dataclass(frozen=True)
class Leg:
    """A leg of a path. The mappings give, by the number of a tool, what changes; everything else stays.

    Attributes
    ----------
    phase : str
        Name of what happens, such as `poke/hold`.
    to : Mapping[int, Floats], shape (3,) or (k, 3), m
        Where tools go, or the points that they go through.
    speed : float, m/s
        Peak speed, also of the tips of jaws.
    seconds : float, s
        How long it takes at least.
    angle : Mapping[int, float], rad
        Angle between jaws at the end.
    turn : Mapping[int, Floats], shape (4,)
        Rotation at the end.
    outward : Mapping[int, Floats], shape (3,)
        The direction out of the tissue.
    """

    phase: str
    to: Mapping[int, Floats] = field(default_factory=dict)
    speed: float = FAST
    seconds: float = 0.0
    angle: Mapping[int, float] = field(default_factory=dict)
    turn: Mapping[int, Floats] = field(default_factory=dict)
    outward: Mapping[int, Floats] = field(default_factory=dict)


@dataclass(frozen=True)
class Path:
    """Poses of T tools at a rate.

    Attributes
    ----------
    rate : float, Hz
        Poses per second.
    ball : Ball
        Ball around organ and tools.
    reach : float, m
        Distance from the hinge of jaws to their tips.
    phases : NDArray[np.str_], shape (m,)
        Name of the leg of each pose.
    poses : Floats, shape (m, T, 7), m and quaternion xyzw
        The poses.
    angles : Floats, shape (m, T), rad
        Angles between jaws.
    outward : Floats, shape (m, T, 3)
        The direction out of the tissue, zero where a tool is outside and clear of it.
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
        """Return a path of one pose of each tool, with closed jaws.

        poses (T, 7) m and quaternion xyzw; rate: poses per second, Hz; ball: ball around organ and tools; reach:
        distance from the hinge of jaws to their tips, m.
        """
        none = np.zeros((1, len(poses), 3))
        return cls(rate, ball, reach, np.array(["pause"]), poses[None], none[:, :, 0], none)

    @property
    def duration(self) -> float:
        """Time from its first pose to the first of the next round, s."""
        return len(self.poses) / self.rate

    def then(self, leg: Leg) -> Path:
        """Return this path with one more leg."""
        before, shut = self.poses[-1], self.angles[-1]
        lines = [np.vstack([pose[:3], leg.to.get(tool, pose[:3])]) for tool, pose in enumerate(before)]
        along = [arc_length(line) for line in lines]
        turns = [Rotation.from_quat([pose[3:], leg.turn.get(tool, pose[3:])]) for tool, pose in enumerate(before)]
        opening = np.array([leg.angle.get(tool, now) for tool, now in enumerate(shut)]) - shut
        turning = max((end * start.inv()).magnitude() for start, end in turns)
        going = max(0.5 * self.reach * np.abs(opening).max(), *(length[-1] for length in along))
        least = PEAK_OVER_MEAN * max(going / leg.speed, turning / TURNING)
        n = int(np.ceil(self.rate * max(least, SHORTEST if least > 1e-6 else 0.0, leg.seconds) - 1e-9))
        if n == 0:
            return self
        fraction = minimum_jerk(np.arange(1, n + 1) / n)
        places = [
            np.stack([np.interp(fraction * length[-1], length, axis) for axis in line.T], axis=1)
            for line, length in zip(lines, along, strict=True)
        ]
        rotations = [Slerp([0.0, 1.0], pair)(fraction).as_quat() for pair in turns]
        out = np.array([leg.outward.get(tool, np.zeros(3)) for tool in range(len(before))])
        return replace(
            self,
            phases=np.append(self.phases, [leg.phase] * n),
            poses=np.concatenate([self.poses, np.concatenate([places, rotations], axis=2).swapaxes(0, 1)]),
            angles=np.concatenate([self.angles, shut + fraction[:, None] * opening]),
            outward=np.concatenate([self.outward, np.broadcast_to(out, (n, *out.shape))]),
        )

    def retreat(self, index: int) -> Path:
        """Return a path from one of the poses straight out; jaws open first, or they would keep what they hold."""
        here = {name: getattr(self, name)[index : index + 1] for name in ("phases", "poses", "angles", "outward")}
        inside = {tool: outward for tool, outward in enumerate(self.outward[index]) if outward.any()}
        opened = {tool: float(self.angles[:, tool].max()) for tool in inside}
        out = {tool: self.ball.leave(self.poses[index, tool, :3], outward) for tool, outward in inside.items()}
        return replace(self, **here).then(Leg("open", speed=OPENING, angle=opened)).then(Leg("retreat", out))
