"""Operations of a batch on its copies: compiled for a single organ, in Python for coupled organs."""

from __future__ import annotations

import queue
import threading
from typing import Any

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.contact.compiled_steps import (
    NO_COPY,
    CopyProgress,
    advance_copies,
    search_memory,
    tables_of,
    take_poses,
)
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import ToolSet
from tissue_sim.handles import handle, row


class CompiledCopies:
    """Copies of a scene with a single organ, which one kernel advances without the GIL.

    Parameters
    ----------
    scenes : list[Scene]
        The copies.
    threads : int
        Number of threads that may advance copies at the same time.
    """

    def __init__(self, scenes: list[Scene], threads: int) -> None:
        finder, count = scenes[0].finder, len(scenes)
        self._scenes, self._tools = scenes, scenes[0].tools
        self._worlds = row([one.simulation.world for one in scenes])
        bodies = len(self._tools.grown)
        self._course = CopyProgress(
            ticks_a_set=scenes[0].ticks_a_set,
            left=np.zeros(count, dtype=np.int64),
            ticks=np.array([one.ticks for one in scenes], dtype=np.int64),
            sequence=np.array([one.sequence for one in scenes], dtype=np.int64),
            is_found=np.zeros(count, dtype=np.int64),
            goal=np.zeros((count, bodies, 7)),
            has_goal=np.zeros(count, dtype=np.int64),
        )
        goal = scenes[0].organs[0].set_goal
        if goal is not None:
            self._course.goal[:], self._course.has_goal[:] = goal, 1
        self._shared = handle(self._course)
        self._tables = tables_of(finder)
        self._rooms: queue.SimpleQueue[Any] = queue.SimpleQueue()
        for _ in range(threads):
            self._rooms.put(search_memory(finder))
        self._finding = threading.Lock()  # all copies share the finder's buffers

    def move(self, copies: Longs, poses: Floats, angles: Floats) -> None:
        """Give the tools of copies (k,) new poses (k, T, 7) and angles (k, T)."""
        bodies = poses
        if len(self._tools.grown) != len(self._tools.tools):
            bodies = np.array([_body_poses(self._tools, *one) for one in zip(poses, angles, strict=True)])
        take_poses(self._worlds, copies, np.ascontiguousarray(bodies), self._shared)

    def advance(self, copies: Longs, ticks: int) -> None:
        """Advance copies (k,) by some ticks; several threads may do so with others at the same time."""
        room = self._rooms.get()
        self._course.left[copies] = ticks
        try:
            while (waiting := advance_copies(self._worlds, self._shared, self._tables, room, copies)) != NO_COPY:
                self._find(waiting)
        finally:
            self._rooms.put(room)

    def _find(self, copy: int) -> None:
        """Find the contacts of a copy with its finder."""
        course, organ = self._course, self._scenes[copy].organs[0]
        organ.set_goal = course.goal[copy].copy() if course.has_goal[copy] else None
        with self._finding:
            organ.find(int(course.sequence[copy]))
        course.goal[copy], course.has_goal[copy], course.is_found[copy] = organ.set_goal, 1, 1

    def reset(self, copy: int) -> None:
        """Return a copy to rest."""
        self._scenes[copy].reset()
        self._course.ticks[copy] = self._course.has_goal[copy] = 0

    def counters(self, copy: int) -> Longs:
        """Return the counters of a copy besides its memory: ticks, sequence, and the goals of the last search."""
        course = self._course
        head = [course.ticks[copy], course.sequence[copy], course.has_goal[copy]]
        return np.concatenate([np.array(head), course.goal[copy].reshape(-1).view(np.int64)])

    def set_counters(self, copy: int, words: Longs) -> None:
        """Set what `counters` returned."""
        course = self._course
        course.ticks[copy], course.sequence[copy], course.has_goal[copy] = words[:3]
        course.goal[copy].reshape(-1).view(np.int64)[:] = words[3:]


class JoinedCopies:
    """Copies of a scene with coupled organs: the ticks are compiled, the search for contacts takes the GIL.

    Parameters
    ----------
    scenes : list[Scene]
        The copies.
    """

    def __init__(self, scenes: list[Scene]) -> None:
        self._scenes = scenes
        self._finding = threading.Lock()  # all copies share the finders' buffers

    def move(self, copies: Longs, poses: Floats, angles: Floats) -> None:
        """Give the tools of copies (k,) new poses (k, T, 7) and angles (k, T)."""
        for copy, each, wide in zip(copies.tolist(), poses, angles, strict=True):
            for tool, pose in enumerate(each):
                self._scenes[copy].move(tool, pose[:3], pose[3:], float(wide[tool]))

    def advance(self, copies: Longs, ticks: int) -> None:
        """Advance copies (k,) by some ticks; several threads may do so with others at the same time."""
        for copy in copies.tolist():
            scene = self._scenes[copy]
            for _ in range(ticks):
                if scene.ticks % scene.ticks_a_set == 0:
                    with self._finding:
                        scene.find()
                scene.ticks += 1
                scene.joined.step()

    def reset(self, copy: int) -> None:
        """Return a copy to rest."""
        self._scenes[copy].reset()

    def counters(self, copy: int) -> Longs:
        """Return the counters of a copy besides its memory: ticks, sequence, the breath's displacement, and goals."""
        scene = self._scenes[copy]
        goals = [one.set_goal for one in scene.organs]
        shape = scene.simulation.state.body_goal.shape
        floats = [scene.found_at, *(np.zeros(shape) if goal is None else goal for goal in goals)]
        head = [scene.ticks, scene.sequence, *(goal is not None for goal in goals)]
        return np.concatenate([np.array(head, dtype=np.int64), *(part.reshape(-1).view(np.int64) for part in floats)])

    def set_counters(self, copy: int, words: Longs) -> None:
        """Set what `counters` returned."""
        scene = self._scenes[copy]
        organs, shape = len(scene.organs), scene.simulation.state.body_goal.shape
        scene.ticks, scene.sequence = map(int, words[:2])
        floats = words[2 + organs :].view(np.float64)
        scene.found_at = floats[: 3 * organs].reshape(organs, 3).copy()
        goals = floats[3 * organs :].reshape(organs, *shape)
        for one, has_goal, goal in zip(scene.organs, words[2 : 2 + organs], goals, strict=True):
            one.set_goal = goal.copy() if has_goal else None
        if scene.pairs_finder is not None:
            scene.pairs_finder.forget()


def _body_poses(tools: ToolSet, poses: Floats, angles: Floats) -> Floats:
    """Return the poses of all bodies (B, 7) of tools at poses (T, 7) with angles (T,)."""
    return np.concatenate([tools.poses(tool, pose, float(angles[tool])) for tool, pose in enumerate(poses)])
