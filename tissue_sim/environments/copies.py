"""Copies of a task's scene, in environments' frames: actions in, observations and rewards out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs, Mask, Singles
from tissue_sim.contact.quaternions import multiply
from tissue_sim.contact.scene_batch import SceneBatch
from tissue_sim.environments.steering import (
    TURN,
    Sensed,
    clipped,
    declared,
    moved_jaws,
    moved_tip,
    observation_of,
    turned_about_z,
)
from tissue_sim.environments.tasks import HELD, RATE, STEP, Judged, Now, task_of
from tissue_sim.organ.organ import Organ


class Stepped(NamedTuple):
    """Result of a step of n copies."""

    reward: Floats  # (n,)
    terminated: Mask  # (n,)
    succeeded: Mask  # (n,)


class TaskCopies:
    """n copies of a task.

    An organ lies turned about z and shifted in its environment's frame, in which actions and observations are.

    Parameters
    ----------
    task : str
        Its name.
    count : int
        Number of copies.
    organ : Organ | str | None, optional
        Another organ, or the name of one that ships; None for the task's.
    threads : int, optional
        As in SceneBatch.

    Raises
    ------
    UserError
        For a task or an organ that isn't there.
    """

    def __init__(self, task: str, count: int, organ: Organ | str | None = None, threads: int = 0) -> None:
        self.task = task_of(task)
        self.organ = organ if isinstance(organ, Organ) else Organ.shipped(organ or self.task.organ)
        self.scene = self.task.scene(self.organ)  # at rest
        self.batch = SceneBatch(self.scene, count, threads=threads)
        self._fresh = self.batch.save([0])[0]
        self._place, self._outward, self._half, self._start, self._tip, self._shift = np.zeros((6, count, 3))
        self._node = np.zeros(count, dtype=np.int64)
        self._wanted, self._angle, self._blade, self._heading = np.zeros((4, count))
        self._turned = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))  # of the tools, in the organs' frames
        self._held = np.zeros(count, dtype=np.int64)

    def begin(self, copies: Longs, randoms: list[np.random.Generator]) -> None:
        """Begin new episodes of some copies, drawn by a generator for each.

        Parameters
        ----------
        copies : Longs, shape (k,)
            Which.
        randoms : list[np.random.Generator]
            Their generators.
        """
        if len(copies) == 0:
            return
        self.batch.restore(self._fresh, copies)
        for copy, random in zip(copies.tolist(), randoms, strict=True):
            drawn = self.task.draw(random, self.organ)
            self._place[copy], self._outward[copy], self._start[copy] = drawn.place, drawn.outward, drawn.start
            self._tip[copy], self._wanted[copy], self._half[copy] = drawn.start, drawn.wanted, drawn.half
            self._angle[copy], self._turned[copy] = drawn.angle, drawn.turned
            self._shift[copy] = self.task.shift * random.uniform(-1.0, 1.0, 3)
            self._heading[copy] = random.uniform(-TURN, TURN)
            apart = np.linalg.norm(self.organ.surface_positions - drawn.place, axis=1)
            self._node[copy] = np.argmin(apart)
            self.batch.set_stiffness(drawn.stiffness, [copy])
        self._held[copies] = 0
        self._send(copies)

    def step(self, actions: Floats) -> Stepped:
        """Do a step of all copies.

        Parameters
        ----------
        actions : Floats, shape (n, a)
            Velocity along each axis, and for some tasks the jaws' speed, or whether the agent declares a find.
        """
        given = clipped(actions)
        self._tip = moved_tip(self._tip, self._start, turned_about_z(given[:, :3], -self._heading))
        if self.task.has_jaws:
            self._angle = moved_jaws(self._angle, given)
        self._send(np.arange(len(self._tip)))
        self.batch.step(round(STEP * RATE))
        judged = self.judge(given)
        self._held = np.where(judged.is_good, self._held + 1, 0)
        reached = (self._held >= HELD) if self.task.ends else np.zeros(len(given), dtype=np.bool_)
        return Stepped(judged.reward, reached | judged.is_over, judged.is_good)

    def judge(self, given: Floats) -> Judged:
        """Return what a step with clipped actions (n, a), which was done, is worth."""
        return self.task.judge(self._now(declared(self.task, given)))

    def observe(self) -> dict[str, Singles]:
        """Return the observations of all copies, in their environments' frames."""
        poses, wrenches = self.batch.poses[:, 0], self.batch.wrenches[:, 0]
        half = np.zeros_like(self._heading)
        about = np.stack([half, half, np.sin(0.5 * self._heading), np.cos(0.5 * self._heading)], axis=1)
        turned = [multiply(tuple(a), tuple(b)) for a, b in zip(about.tolist(), poses[:, 3:].tolist(), strict=True)]
        wrench = np.hstack(
            [turned_about_z(wrenches[:, :3], self._heading), turned_about_z(wrenches[:, 3:], self._heading)]
        )
        return observation_of(
            self.task,
            Sensed(
                pose=np.hstack([self.outside(poses[:, :3]), np.array(turned)]),
                wrench=wrench,
                angle=self._angle,
                place=self.outside(self._place),
                outward=turned_about_z(self._outward, self._heading),
                wanted=self._wanted,
                half=turned_about_z(self._half, self._heading),
                blade=self._blade,
            ),
        )

    def surface(self) -> Singles:
        """Return where the surface nodes of all copies are, (n, n_surface, 3) m, in their environments' frames."""
        surface = self.batch.surface_positions()
        return (turned_about_z(surface, self._heading[:, None]) + self._shift[:, None]).astype(np.float32)

    def _send(self, copies: Longs) -> None:
        poses = np.hstack([self._tip[copies], self._turned[copies]])[:, None]
        self.batch.move(poses, self._angle[copies][:, None], copies)

    def outside(self, points: Floats) -> Floats:
        """Return points (n, 3) of organs' frames in the environments' frames."""
        return turned_about_z(points, self._heading) + self._shift

    def inside(self, copy: int, pose: Floats) -> Floats:
        """Return a pose (7,) of the environments' frame in the frame of a copy's organ."""
        half = -0.5 * self._heading[copy]
        back = 0.0, 0.0, float(np.sin(half)), float(np.cos(half))
        place = turned_about_z(pose[None, :3] - self._shift[copy], -self._heading[[copy]])[0]
        return np.concatenate([place, multiply(back, tuple(pose[3:].tolist()))])

    def _now(self, declared: Mask) -> Now:
        forces = self.batch.wrenches[:, 0, :3]
        surface = self.batch.surface_positions()[np.arange(len(forces)), self._node]
        pushed = np.einsum("nx,nx->n", forces, self._outward)
        lifted = np.einsum("nx,nx->n", surface - self.organ.surface_positions[self._node], self._outward)
        tips = self.batch.poses[:, 0, :3]
        sizes = np.linalg.norm(forces, axis=1)
        return Now(self._place, self._outward, self._wanted, tips, pushed, sizes, lifted, declared)
