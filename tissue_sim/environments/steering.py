"""What an action does to a tool, and what an agent sees: the same for copies of a batch and for a tool over ROS."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Mask, Singles
from tissue_sim.environments.tasks import STEP, Task

SPEED = 0.05  # m/s of an action of 1, along each axis
OPENING, WIDEST = 2.0, 1.2  # rad/s of the jaws at an action of 1; rad
TURN = 0.35  # rad by which an organ is turned at most, about z
FARTHEST = 0.06  # m that a tool may go from where it began
SAYS = 0.5  # of the last action of a task without jaws, above which it says: here it is


class Sensed(NamedTuple):
    """What is known about n tools, in the frame that agents see it in."""

    pose: Floats  # (n, 7) m and quaternion xyzw
    wrench: Floats  # (n, 6) N and N m that the hands feel
    angle: Floats  # (n,) rad between jaws
    place: Floats  # (n, 3) m of the goal
    outward: Floats  # (n, 3) normal there
    wanted: Floats  # (n,) N, or m of a cut
    half: Floats  # (n, 3) m from there to an end of the line of a cut
    blade: Floats  # (n,) m that the blade of a cut protrudes


def clipped(actions: Floats) -> Floats:
    """Return actions (n, a) as they count: from -1 to 1."""
    return np.clip(np.asarray(actions, dtype=np.float64), -1.0, 1.0)


def moved_tip(tip: Floats, start: Floats, velocity: Floats) -> Floats:
    """Return where tools are led in a step.

    Parameters
    ----------
    tip : Floats, shape (n, 3), m
        Where they are.
    start : Floats, shape (n, 3), m
        Where they began, from which they don't go farther than FARTHEST.
    velocity : Floats, shape (n, 3)
        Of their actions, -1 to 1.
    """
    offset = tip + STEP * SPEED * velocity - start
    far = np.linalg.norm(offset, axis=1, keepdims=True)
    return np.asarray(start + offset * np.minimum(1.0, FARTHEST / np.maximum(far, 1e-12)))


def moved_jaws(angle: Floats, actions: Floats) -> Floats:
    """Return the angles (n,) rad between jaws after a step with the clipped actions (n, 4)."""
    return np.clip(angle + STEP * OPENING * actions[:, 3], 0.0, WIDEST)


def declared(task: Task, actions: Floats) -> Mask:
    """Return which clipped actions (n, a) say: here it is; none of a task without such an action."""
    if not task.declares:
        return np.zeros(len(actions), dtype=np.bool_)
    return np.asarray(actions[:, -1] > SAYS)


def observation_of(task: Task, sensed: Sensed) -> dict[str, Singles]:
    """Return the observations of n agents.

    Parameters
    ----------
    task : Task
        Their task.
    sensed : Sensed
        What is known.
    """
    seen = {"pose": sensed.pose, "wrench": sensed.wrench}
    if task.has_jaws:
        seen["angle"] = sensed.angle[:, None]
    if task.shows_goal:
        seen["goal"] = np.hstack([sensed.place, sensed.outward, sensed.wanted[:, None]])
    if task.has_blade:
        seen["line"] = np.hstack([sensed.place - sensed.half, sensed.place + sensed.half])
        seen["blade"] = sensed.blade[:, None]
    return {name: values.astype(np.float32) for name, values in seen.items()}


def turned_about_z(vectors: Floats, angle: Floats) -> Floats:
    """Return vectors (n, ..., 3) turned about z by angles that broadcast to (n, ...)."""
    x, y, sine, cosine = vectors[..., 0], vectors[..., 1], np.sin(angle), np.cos(angle)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, vectors[..., 2]], axis=-1)
