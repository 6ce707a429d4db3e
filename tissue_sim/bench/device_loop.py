"""Haptic device in a loop with what it touches, with delays in both directions, in simulated time.

Nothing here depends on how fast a machine is. A device samples its position and sets its force every millisecond, as
the node ticks; poses are sent at a rate of their own.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
import trimesh

from tissue_sim.array_types import Floats
from tissue_sim.bench.devices import NO_HAND, SERVO, Device, Hand, Moving, quarters
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.contact.virtual_coupling import passive_stiffness
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.topology import assemble_organ
from tissue_sim.ros.node.tools.passivity import Observer

PUSH, START = 0.5, 5e-4  # N of the hand, and m before the tissue: it lands at some 50 mm/s
SOFTEST, STIFFEST = 1.0, 2e4  # N/m
CLOSE_ENOUGH = 1.05  # ratio of an unstable and a stable stiffness at which a search ends
PERIODS, SHORTEST, LONGEST = 24.0, 0.8, 2.5  # of a free swing, and s: how long a trial lasts
UNCOUPLED = 1.5  # s of a trial where tissue alone resists
QUANTA = 4.0  # encoder quanta, peak to peak: smaller motion is an effect of the encoder
FAR = 0.01  # m before the tissue, beyond which a device has been thrown off
REST, LOOK = 200, 50  # periods of the servo: time at rest after which it stays there, and between two checks
STILL = 0.5  # fraction of the smallest motion that counts
KEPT = 0.95  # of an oscillation's amplitude a quarter of a trial later: above that it doesn't decay
MOST_ADDED = 5.0  # N s/m by an observer
BALL, HARDNESS = 0.027, 1000.0  # m, and factor of tissue's stiffness: a ball that hardly yields


class Link(NamedTuple):
    """Connection of a device.

    Attributes
    ----------
    rate : float
        Poses per second, Hz.
    delay : float
        Additional delay of both directions together, s.
    transport : float
        Time from a pose to its force where nothing is delayed, s; a servo sets a force a period after its pose.
    smoothed : bool
        Whether a tool moves to a pose in the time until the next one, as in the node.
    """

    rate: float = 1000.0
    delay: float = 0.0
    transport: float = SERVO
    smoothed: bool = True

    @property
    def period(self) -> float:
        """Time between two poses, s."""
        return 1.0 / self.rate

    @property
    def lag(self) -> float:
        """Time from a pose to the force that answers it, s.

        A tool reaches a pose when the next is due, and feels the mean force of a tick.
        """
        return self.delay + self.transport + (self.period - 0.5 * SERVO if self.smoothed else 0.0)


class World(Protocol):
    """Object that a device touches, along its axis; its surface is at 0, and it lies below."""

    def begin(self, stiffness: float) -> None:
        """Return to rest; stiffness N/m of the coupling, 0: the tool is where the device is."""

    def take(self, place: float, stamp: float) -> None:
        """Apply a pose: position m, and its time, s."""

    def tick(self) -> float:
        """Advance by a tick and return the force on the device, N."""


class Wall:
    """Plain spring: the sampled wall of theory."""

    def __init__(self, *, is_held: bool = False) -> None:
        self._stiffness = self._place = 0.0
        self._is_held = is_held  # it also pulls

    def begin(self, stiffness: float) -> None:
        """Implement World.begin."""
        self._stiffness, self._place = stiffness, 0.0

    def take(self, place: float, stamp: float) -> None:
        """Implement World.take."""
        self._place = place

    def tick(self) -> float:
        """Implement World.tick."""
        return -self._stiffness * (self._place if self._is_held else min(self._place, 0.0))


class Tissue:
    """Organ that a sphere presses from above, in ticks like the node's; hardness: factor of its stiffness."""

    def __init__(self, organ: Organ, hardness: float = 1.0, radius: float = 0.005, ticks_a_set: int = 4) -> None:
        self._scene = Scene(organ, [Tool("left", radius=radius)], ticks_a_set=ticks_a_set)
        settings = self._scene.simulation.settings
        settings.stiffness_scale, settings.coupling_damping = hardness, 1.0
        self._scene.set_substeps()
        surface = organ.surface_positions
        self._touch = surface[np.argmax(surface[:, 2])] + [0.0, 0.0, radius]

    def begin(self, stiffness: float) -> None:
        """Implement World.begin."""
        self._scene.reset()
        self._scene.simulation.settings.coupling_stiffness = stiffness

    def take(self, place: float, stamp: float) -> None:
        """Implement World.take."""
        # A stamp of 0 would mean that there is none.
        self._scene.move(0, self._touch + [0.0, 0.0, place], stamp=round(1e9 * (1.0 + stamp)))

    def tick(self) -> float:
        """Implement World.tick."""
        self._scene.step()
        return float(self._scene.wrenches[0, 2])


def hard_ball() -> Tissue:
    """Return a ball of 27 mm with a stiffness of some 50,000 N/m, with which the coupling limits a device."""
    mesh, radius = trimesh.creation.icosphere(1, BALL), BALL
    surface, atoms = np.asarray(mesh.vertices), np.zeros((5, 3))
    atoms[:, 2] = np.linspace(-0.4, 0.4, 5) * radius
    organ = assemble_organ(
        name="hard sphere",
        surface_positions=surface,
        surface_triangles=mesh.faces,
        atom_positions=atoms,
        atom_radius=radius - np.abs(atoms[:, 2]),
        atom_parent=np.arange(-1, 4),
        fixed=np.flatnonzero(surface[:, 2] < -0.7 * radius),
    )
    return Tissue(organ, HARDNESS, 0.01, ticks_a_set=20)  # the tool hardly moves


class Port(Protocol):
    """Filter of a force before it goes out to a device."""

    def send(self, place: float, force: float) -> float:
        """Return the force, N, that goes out in answer to a pose at a position, m."""


class Trial(NamedTuple):
    """Result of a trial: positions (n,) m, forces (n,) N, every SERVO s; the smallest motion that counts, m."""

    places: Floats
    forces: Floats
    finest: float

    @property
    def swings(self) -> bool:
        """Whether the device ends in a limit cycle or is thrown off, instead of coming to rest."""
        before, last = quarters(self.places)
        return bool(self.places[-1] > FAR) or (last > QUANTA * self.finest and last > KEPT * before)


class Holder(NamedTuple):
    """Device, the hand on it, its connection, and the port for its forces, if any."""

    device: Device
    link: Link
    hand: Hand = NO_HAND
    port: Callable[[], Port] | None = None

    @property
    def mass(self) -> float:
        """Moving mass, kg."""
        return self.device.mass + self.hand.mass

    @property
    def damping(self) -> float:
        """Viscous damping, N s/m."""
        return self.device.damping + self.hand.damping

    @property
    def passive(self) -> float:
        """Stiffness, N/m, that theory allows."""
        return passive_stiffness(self.damping, self.link.period, self.link.lag)

    def seconds(self, stiffness: float) -> float:
        """Return the duration of a trial, s."""
        if stiffness == 0.0:
            return UNCOUPLED
        period = 2.0 * math.pi * math.sqrt(self.mass / stiffness)
        return min(max(PERIODS * period, SHORTEST), LONGEST)


class ObservedPort:
    """The node's passivity observer, for a device of known mass."""

    def __init__(self, holder: Holder) -> None:
        link = holder.link
        self._observer, self._period = Observer(), link.period
        self._lag = link.delay + link.transport
        # Damping that comes late is stable only below some mass / lag.
        self._most = min(MOST_ADDED, holder.mass / (0.5 * link.period + self._lag))

    def send(self, place: float, force: float) -> float:
        """Implement Port.send."""
        there, wanted = np.array([place, 0.0, 0.0]), np.array([force, 0.0, 0.0])
        damped = self._observer.damped(there, wanted, self._period, self._lag, self._most)
        self._observer.sent(damped)
        return float(damped[0])


def tried(world: World, holder: Holder, stiffness: float) -> Trial:
    """Push a device onto what it touches, through a coupling of a stiffness, and return its motion.

    world: what it touches; holder: the device; stiffness: stiffness of the coupling, N/m. Returns positions and forces.
    """
    device, link = holder.device, holder.link
    world.begin(stiffness)
    moving = Moving(device, holder.hand, PUSH, START)
    port = holder.port() if holder.port is not None else None
    every, there = round(link.period / SERVO), round(0.5 * link.delay / SERVO)
    back = round((link.delay + link.transport) / SERVO) - there
    poses: deque[tuple[int, float]] = deque()
    answers: deque[tuple[int, float]] = deque()
    count = round(holder.seconds(stiffness) / SERVO)
    places, forces, given, newest = np.zeros(count), np.zeros(count), 0.0, START
    for now in range(count):
        if now % every == 0:
            poses.append((now, moving.measured))
        taken = bool(poses) and poses[0][0] + there <= now
        if taken:
            sent, newest = poses.popleft()
            world.take(newest, sent * SERVO)
        force = world.tick()
        if taken:
            answers.append((now + back, port.send(newest, force) if port is not None else force))
        while answers and answers[0][0] <= now:
            given = answers.popleft()[1]
        places[now], forces[now] = moving.place, given
        moving.advance(given)
        looks = now > 2 * REST and now % LOOK == 0
        if places[now] > FAR or (looks and np.ptp(places[now - REST : now]) < STILL * device.finest):
            places, forces = places[: now + 1], forces[: now + 1]
            break
    return Trial(places, forces, device.finest)


def stable_stiffness(world: World, holder: Holder) -> float:
    """Return the stiffness of a coupling up to which a device comes to rest, to CLOSE_ENOUGH.

    The search starts from what theory allows and doubles it, as a device may come to rest again where the coupling is
    far too stiff; then the logarithm is bisected. The result lies between SOFTEST and STIFFEST.

    world: what it touches; holder: the device. Returns stiffness; 0 where it oscillates at SOFTEST, N/m.
    """
    low = max(holder.passive, SOFTEST)
    while tried(world, holder, low).swings:
        if low == SOFTEST:
            return 0.0
        low = max(0.5 * low, SOFTEST)
    high = min(2.0 * low, STIFFEST)
    while not tried(world, holder, high).swings:
        if high == STIFFEST:
            return STIFFEST
        low, high = high, min(2.0 * high, STIFFEST)
    while high > CLOSE_ENOUGH * low:
        middle = math.sqrt(low * high)
        if tried(world, holder, middle).swings:
            high = middle
        else:
            low = middle
    return low
