"""Haptic devices along one axis: moving mass, friction, encoder, actuator; their data and how they move."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.jit import kernel

SERVO = 1e-3  # s between two updates of a device's force
FINE = 20  # steps of its motion in one of them


class Device(NamedTuple):
    """Haptic device as its tip feels.

    Attributes
    ----------
    mass : float
        Moving mass, kg.
    damping : float
        Viscous damping, N s/m.
    friction : float
        Coulomb friction, N.
    quantum : float
        Encoder quantum, m.
    most_force : float
        Largest force, N.
    source : str
        Source of the figures, and which of them is assumed.
    """

    name: str
    mass: float
    damping: float
    friction: float
    quantum: float
    most_force: float
    source: str

    @property
    def finest(self) -> float:
        """Smallest motion that counts, m."""
        return max(self.quantum, 5e-6)


class Hand(NamedTuple):
    """Contribution of a hand that holds a device: mass kg, damping N s/m, stiffness N/m."""

    mass: float
    damping: float
    stiffness: float


# Data sheets give no viscous damping; such a device is stabilised by its dry friction.
ASSUMED_DAMPING = 0.1  # N s/m
DEVICES = (
    Device(
        "Touch",
        mass=0.045,
        damping=ASSUMED_DAMPING,
        friction=0.26,
        quantum=55e-6,
        most_force=3.3,
        source="3D Systems (SensAble) Touch, formerly Phantom Omni: apparent mass 45 g, backdrive friction 0.26 N,"
        " 0.055 mm, 3.3 N, by its data sheet; damping assumed",
    ),
    Device(
        "Premium 1.5",
        mass=0.075,
        damping=ASSUMED_DAMPING,
        friction=0.04,
        quantum=30e-6,
        most_force=8.5,
        source="3D Systems (SensAble) Phantom Premium 1.5: apparent mass 75 g, backdrive friction 0.04 N, 0.03 mm,"
        " 8.5 N, by its data sheet; damping assumed",
    ),
    Device(
        "textbook",
        mass=0.1,
        damping=5.0,
        friction=0.0,
        quantum=0.0,
        most_force=10.0,
        source="not a real device: mass and damping only, the quantities that the theory considers",
    ),
)
NO_HAND, GRIP = Hand(0.0, 0.0, 0.0), Hand(0.05, 2.0, 100.0)  # the latter assumed: a light grip of two fingers


class Moving:
    """Device that is pushed along its axis: position m (negative: into the tissue), speed m/s.

    hand: the hand on it; push: force of the hand towards the tissue, N; start: position at the start, m.
    """

    def __init__(self, device: Device, hand: Hand, push: float, start: float) -> None:
        self.device = device
        self._motion = np.array([start, 0.0])
        self._properties = np.array(
            [device.mass + hand.mass, device.damping + hand.damping, device.friction, hand.stiffness, start]
        )
        self._push = push

    @property
    def measured(self) -> float:
        """Position by the encoder, m."""
        place, quantum = float(self._motion[0]), self.device.quantum
        return quantum * float(np.floor(place / quantum)) if quantum > 0.0 else place

    @property
    def place(self) -> float:
        """Position, m."""
        return float(self._motion[0])

    def advance(self, force: float) -> None:
        """Move for SERVO s under a force, N, along the axis, limited by the actuator."""
        most = self.device.most_force
        given = min(max(force, -most), most) - self._push
        move(self._motion, self._properties, given, SERVO / FINE, FINE)


@kernel
def move(motion: Floats, properties: Floats, force: float, step: float, count: int) -> None:
    """Advance position and speed (2,) m, m/s by `count` steps, s, under a constant force, N.

    properties (5,): mass kg, damping N s/m, Coulomb friction N, stiffness N/m towards a place m.
    """
    mass, damping, friction = properties[0], properties[1], properties[2]
    for _ in range(count):
        pull = force - properties[3] * (motion[0] - properties[4])
        speed = (motion[1] + step * pull / mass) / (1.0 + step * damping / mass)
        least = step * friction / mass
        # Dry friction takes at most the remaining speed.
        if abs(speed) <= least:
            speed = 0.0
        else:
            speed -= least if speed > 0.0 else -least
        motion[1] = speed
        motion[0] += step * speed


def quarters(places: Floats) -> tuple[float, float]:
    """Return the peak-to-peak motion in the last quarter but one, and in the last.

    places (n,) m: positions. Returns both, m.
    """
    count = len(places) // 4
    third, last = places[-2 * count : -count], places[-count:]
    return float(np.ptp(third)), float(np.ptp(last))
