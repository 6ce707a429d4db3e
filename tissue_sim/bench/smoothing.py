"""Delay and force steps of a tool's smoothing, in ticks and so the same on any machine.

A tool follows the poses of a slow bridge evenly, each over the time until the next one is due (smoothing 1), over a
fraction of it, or at once (0). The delay is the time until the force follows half of a step of 0.3 mm; the steps are
the largest change of the force within a tick while the hand oscillates in the tissue.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ

RATE, POSE_RATES, SMOOTHINGS = 1000, (500, 100, 30), (1.0, 0.5, 0.0)  # Hz, Hz, fractions
RADIUS, DEPTH, STEP = 0.005, 0.003, 3e-4  # m
SWING, FREQUENCY, SWINGS = 1e-3, 5.0, 2  # m and Hz of the hand, 31 mm/s at most
REST = 300  # ticks until the tissue is at rest
INWARD = np.array([-1.0, 0.0, 0.0])


class Smoothed(NamedTuple):
    """Figures of one smoothing at one rate of poses, Hz."""

    smoothing: float
    rate: float
    half: int  # ticks until the force has followed half of a step
    step: float  # N, largest change of the force within a tick while the hand oscillates


def measure(organ: Organ) -> list[Smoothed]:
    """Return the figures of every smoothing at every rate."""
    return [one(organ, smoothing, rate) for rate in POSE_RATES for smoothing in SMOOTHINGS]


def one(organ: Organ, smoothing: float, rate: float) -> Smoothed:
    """Return the figures of a tool's smoothing at a rate of poses, Hz."""
    scene = Scene(organ, [Tool("ball", radius=RADIUS, smoothing=smoothing)])
    period = max(1, round(RATE / rate))
    points = organ.surface_positions
    touch = points[np.argmax(points[:, 0])] - RADIUS * INWARD

    def forces_at(depths: Floats) -> Floats:
        """Return the force after each tick, (k, 3) N, while poses come at these depths (k,), m."""
        forces = np.empty((len(depths), 3))
        for tick, depth in enumerate(depths):
            if tick % period == 0:
                scene.move(0, touch + depth * INWARD)
            scene.step()
            forces[tick] = scene.wrenches[0, :3]
        return forces

    forces_at(np.linspace(-0.002, DEPTH, 400))
    before = forces_at(np.full(REST // period * period, DEPTH))[-1]
    after = forces_at(np.full(REST // period * period, DEPTH + STEP))
    change = np.linalg.norm(after - before, axis=1)
    half = 1 + int(np.argmax(change >= 0.5 * change[-1]))
    phase = 2.0 * np.pi * FREQUENCY / RATE * np.arange(round(SWINGS * RATE / FREQUENCY))
    swung = forces_at(DEPTH + STEP + SWING * np.sin(phase))
    return Smoothed(smoothing, rate, half, float(np.linalg.norm(np.diff(swung, axis=0), axis=1).max()))


def as_json(found: list[Smoothed]) -> list[JsonObject]:
    """Return the figures for --json."""
    return [one._asdict() for one in found]


def table(found: list[JsonObject]) -> list[list[str]]:
    """Return the figures as rows of cells, the first of which is the head."""
    rows = [["poses, Hz", "smoothing", "half of a step takes effect after, ticks", "largest step of force, mN"]]
    for one in found:
        rows.append([f"{one['rate']:g}", f"{one['smoothing']:g}", f"{one['half']}", f"{1e3 * one['step']:.1f}"])
    return rows
