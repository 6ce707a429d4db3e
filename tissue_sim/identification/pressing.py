"""A ball that is pressed into an organ, slowly, and held until its force stands."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.organ.organ import Organ

CLEAR = 0.002  # m between ball and organ at the start
SPEED = 0.002  # m/s: so slow that an organ that bends at 1 Hz is not swung, and sticks where a still one would
HOLDING, LONGEST = 0.2, 5.0  # s between two readings of the force at a depth, and at most
STILL = 1e-3  # of the force, by which it has changed since the last look
FRICTION = 10.0  # at which nothing slips


class Path(Protocol):
    """Path of a ball's middle into tissue, and the direction in which its force is measured."""

    @property
    def direction(self) -> Floats:
        """Direction inwards, (3,)."""

    def at(self, deep: float) -> Floats:
        """Return the ball's middle at a depth, m."""


class Press(NamedTuple):
    """Point at which a sphere presses, and its direction."""

    place: Floats  # (3,) m, of the ball's middle where it touches
    direction: Floats  # (3,) inwards
    node: int = -1  # of the surface, that it presses at; -1 for none

    def at(self, deep: float) -> Floats:
        """Return the ball's middle at a depth, m."""
        return self.place + deep * self.direction


def ball(organ: Organ, radius: float, friction: float) -> Scene:
    """Return the organ and a ball, its radius in m, with that coefficient of friction."""
    scene = Scene(organ, [Tool("ball", radius=radius)], ticks_a_set=4)
    scene.simulation.settings.friction = friction
    return scene


def forces(scene: Scene, press: Path, depths: Floats) -> Floats:
    """Return the force (d,) N on a ball, against its direction, that is held at each of several depths (d,) m."""
    scene.reset()
    deep, found = min(-CLEAR, float(depths[0])), []
    for depth in depths:
        lead(scene, press, (deep, float(depth)), SPEED)
        deep = float(depth)
        found.append(held(scene, press, deep))
    return np.array(found)


def moving_forces(scene: Scene, press: Path, depths: Floats, speed: float) -> Floats:
    """Return the force (d,) N on a ball, against its direction, as it passes depths (d,) m with a speed, m/s."""
    scene.reset()
    deep, found = min(-CLEAR, float(depths[0])), []
    for depth in depths:
        lead(scene, press, (deep, float(depth)), speed)
        deep = float(depth)
        found.append(-float(scene.wrenches[0, :3] @ press.direction))
    return np.array(found)


def lead(scene: Scene, press: Path, span: tuple[float, float], speed: float) -> None:
    """Move a ball from one depth to another, m."""
    ticks = max(1, round((span[1] - span[0]) / (speed * scene.simulation.settings.tick_time)))
    for place in np.linspace(*span, ticks + 1)[1:]:
        scene.move(0, press.at(float(place)))
        scene.step()


def held(scene: Scene, press: Path, deep: float) -> float:
    """Return the force, N, on a ball at a depth, m, once it changes no more: an organ may take seconds to bend."""
    tick, force = scene.simulation.settings.tick_time, np.inf
    for _ in range(round(LONGEST / HOLDING)):
        for _ in range(round(HOLDING / tick)):
            scene.move(0, press.at(deep))
            scene.step()
        before, force = force, -float(scene.wrenches[0, :3] @ press.direction)
        if abs(force - before) <= STILL * abs(force):
            break
    return force
