"""Many copies of a scene, stepped together on all cores, for learning, sweeps and statistics."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.arguments import floats_of, number_of
from tissue_sim.array_types import Floats, Longs
from tissue_sim.contact.batch_copies import CompiledCopies, JoinedCopies
from tissue_sim.contact.compiled_steps import read_surfaces, read_tools
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.scene_copy import copied_scene, memory_of
from tissue_sim.errors import UserError
from tissue_sim.handles import row

TAKEN = 0.5  # of a thread's equal part of the remaining copies, which it takes at once


class SceneBatch:
    """n copies of a scene, each with the same results as the scene alone, to the last bit, for any number of threads.

    Parameters
    ----------
    scene : Scene
        The scene, which isn't changed; the copies start from its present state, with its options.
    n : int
        Number of copies.
    threads : int, optional
        Number of threads that step them; 0 for one on each core that this process may use.

    Raises
    ------
    UserError
        For a number of copies or threads that is out of range, and for a scene with cuts.
    """

    def __init__(self, scene: Scene, n: int, threads: int = 0) -> None:
        if not 1 <= n <= 1_000_000:
            raise UserError(f"a batch of {n} copies; expected: 1..1000000")
        if not 0 <= threads <= 4096:
            raise UserError(f"a batch on {threads} threads; expected: 0 (one on each core) to 4096")
        if any(one.cuts for one in scene.simulations):
            raise UserError("a batch copies scenes without cuts; reset the scene, which heals it, and copy that")
        if scene.simulation.shapes.blades.body.size:
            raise UserError(
                "a batch supports no blades, as a cut changes the nodes of a copy; step copies of the scene one by one"
            )
        self.names, self.tools, self.rate = scene.names, scene.tools, scene.simulation.rate
        self.threads = min(n, threads or len(os.sched_getaffinity(0)))
        self._scenes = [copied_scene(scene) for _ in range(n)]
        self._worlds = [
            row([one.simulations[organ].world for one in self._scenes]) for organ in range(len(scene.organs))
        ]
        self._is_alone = scene.joined.alone
        self._copies = CompiledCopies(self._scenes, self.threads) if self._is_alone else JoinedCopies(self._scenes)
        self._pool = ThreadPoolExecutor(self.threads - 1, "batch") if self.threads > 1 else None  # and the caller's
        self._given = np.zeros((n, len(self.tools.tools), 7))  # the last poses that were set for the tools
        self._given[..., 6] = 1.0
        self._angles = np.zeros((n, len(self.tools.tools)))

    def __repr__(self) -> str:
        tools = ", ".join(f"{tool.name} ({tool.shape})" for tool in self.tools.tools) or "no tools"
        threads = f"{self.threads} thread{'s' if self.threads > 1 else ''}"
        return f"<SceneBatch of {len(self)} x {', '.join(self.names)}; {tools}; {self.rate:g} Hz, {threads}>"

    def __len__(self) -> int:
        return len(self._scenes)

    def step(self, ticks: int = 1) -> None:
        """Advance all copies by some ticks of 1/rate seconds; contacts are found as in the scene.

        Parameters
        ----------
        ticks : int, optional
            Number of ticks.

        Raises
        ------
        UserError
            For a negative number.
        """
        if ticks < 0:
            raise UserError(f"{ticks} ticks are less than 0")
        every = np.arange(len(self))
        if self._pool is None:
            self._copies.advance(every, ticks)
            return
        parts = iter(np.split(every, np.cumsum(pieces(len(self), self.threads))[:-1]))

        def work() -> None:
            for part in parts:  # the next thread that is done takes the next part
                self._copies.advance(part, ticks)

        others = [self._pool.submit(work) for _ in range(self.threads - 1)]
        try:
            work()  # a caller that only waits would be woken by the others, which costs a tenth of their time
        finally:
            for one in others:
                one.result()

    def move(self, poses: ArrayLike, angles: ArrayLike = 0.0, copies: ArrayLike | None = None) -> None:
        """Set new poses of the tools, which take effect in the next tick.

        Parameters
        ----------
        poses : ArrayLike, shape (k, tools, 7) or (tools, 7) for all alike
            Position of its origin, m, and quaternion xyzw of length 1, of each tool of each copy.
        angles : ArrayLike, shape (k, tools) or what NumPy broadcasts to it, optional
            rad, between the jaws of grippers.
        copies : ArrayLike | None, optional
            Mask (n,) or numbers (k,) of the copies that are meant; None for all.

        Raises
        ------
        UserError
            For numbers that are not poses, and for copies that the batch doesn't have.
        """
        chosen = self._chosen(copies)
        shape = (len(chosen), len(self.tools.tools))
        given, wide = _spread(poses, (*shape, 7), "poses"), _spread(angles, shape, "angles")
        if np.any(np.abs(np.sqrt(np.sum(given[..., 3:] ** 2, axis=-1)) - 1.0) > 1e-6):
            raise UserError("poses have quaternions that are not of length 1")
        for copy, pose in zip(chosen.tolist(), given, strict=True):
            self._scenes[copy].origins[:] = pose[:, :3]
        self._given[chosen], self._angles[chosen] = given, wide
        self._copies.move(chosen, given, wide)

    def reset(self, copies: ArrayLike | None = None) -> None:
        """Return copies to rest, exhaled, without tools; the settings don't change.

        Parameters
        ----------
        copies : ArrayLike | None, optional
            Mask (n,) or numbers (k,) of the copies that are meant; None for all.

        Raises
        ------
        UserError
            For copies that the batch doesn't have.
        """
        for copy in self._chosen(copies).tolist():
            self._copies.reset(copy)

    def set_stiffness(self, factors: ArrayLike, copies: ArrayLike | None = None) -> None:
        """Set the stiffness of the organs of copies.

        Parameters
        ----------
        factors : ArrayLike, shape (k, organs) or what NumPy broadcasts to it
            Factors on each organ's stiffness, greater than 0.
        copies : ArrayLike | None, optional
            Mask (n,) or numbers (k,) of the copies that are meant; None for all.

        Raises
        ------
        UserError
            For other factors, and for copies that the batch doesn't have.
        """
        chosen = self._chosen(copies)
        given = _spread(factors, (len(chosen), len(self.names)), "factors")
        if np.any(given <= 0.0):
            raise UserError("factors of stiffness must be greater than 0")
        for copy, each in zip(chosen.tolist(), given.tolist(), strict=True):
            for simulation, factor in zip(self._scenes[copy].simulations, each, strict=True):
                simulation.settings.stiffness_scale = factor
            self._scenes[copy].set_substeps()

    def surface_positions(self, organ: int | str = 0) -> Floats:
        """Return the positions of an organ's surface nodes in every copy, with the breath, (n, n_surface, 3) m.

        Parameters
        ----------
        organ
            Its name (see `names`) or number.

        Raises
        ------
        UserError
            For an organ that the scene doesn't have.
        """
        number = number_of(organ, self.names, "organ")
        simulations = [one.simulations[number] for one in self._scenes]
        if simulations[0].local_region != "off":
            for one in simulations:
                _ = one.positions  # brings the nodes outside a region up to date
        found = np.empty((len(self), simulations[0].organ.n_surface, 3))
        read_surfaces(self._worlds[number], found)
        return found

    @property
    def wrenches(self) -> Floats:
        """Haptic output of each tool about its origin, (n, tools, 6) N and N m."""
        if not self._is_alone:
            return np.array([one.wrenches for one in self._scenes])
        poses, wrenches = self._bodies()
        return self._of_tools(poses, wrenches)

    @property
    def poses(self) -> Floats:
        """Poses of the tools as constrained by contact, (n, tools, 7) m and quaternion xyzw.

        The orientation of a gripper is the one that was set.
        """
        bodies, found = self._bodies()[0], self._given.copy()
        for tool, own in enumerate(self.tools.bodies):
            if len(own) == 1:
                found[:, tool] = bodies[:, own[0]]
                continue
            for copy, (pose, angle) in enumerate(zip(self._given[:, tool], self._angles[:, tool], strict=True)):
                apart = self.tools.poses(tool, pose, float(angle))[:, :3].mean(axis=0) - pose[:3]
                found[copy, tool, :3] = bodies[copy, own, :3].mean(axis=0) - apart
        return found

    @property
    def body_poses(self) -> Floats:
        """Poses of the rigid bodies of which the tools consist, (n, bodies, 7) m and quaternion xyzw."""
        return self._bodies()[0]

    @property
    def times(self) -> Floats:
        """Simulated time of each copy, (n,) s."""
        return np.array([one.time for one in self._scenes])

    @property
    def bytes_a_copy(self) -> int:
        """Memory of one copy, bytes; models, tools and tables are shared by all."""
        scene = self._scenes[0]
        parts = [one.nbytes for one in memory_of(scene)]
        for simulation in scene.simulations:
            tissue = simulation.model.tissue
            own = [simulation.model.work] if tissue is None else [tissue.rows, tissue.work, tissue.compressed_cells]
            parts += [_nbytes(simulation.scratch), *(one.nbytes for one in own)]
        return int(sum(parts))

    def save(self, copies: ArrayLike | None = None) -> Longs:
        """Return the whole state of copies, with their settings, from which they continue bit for bit.

        Parameters
        ----------
        copies : ArrayLike | None, optional
            Mask (n,) or numbers (k,) of the copies that are meant; None for all.

        Returns
        -------
        Longs
            shape (k, w), words of 8 bytes, for `restore` of this or any other batch of the same scene.

        Raises
        ------
        UserError
            For copies that the batch doesn't have.
        """
        return np.array([np.concatenate(self._memory(copy)) for copy in self._chosen(copies).tolist()])

    def restore(self, states: ArrayLike, copies: ArrayLike | None = None) -> None:
        """Continue from states that `save` has returned.

        If organs may touch themselves, a node that had passed a wall counts as in front of it again.

        Parameters
        ----------
        states : ArrayLike, shape (k, w) or (w,) for all alike
            The states.
        copies : ArrayLike | None, optional
            Mask (n,) or numbers (k,) of the copies that are meant; None for all.

        Raises
        ------
        UserError
            For states of another scene, and for copies that the batch doesn't have.
        """
        chosen = self._chosen(copies)
        given = np.asarray(states)
        size = sum(len(part) for part in self._memory(0))
        if given.dtype != np.int64 or given.shape not in {(size,), (len(chosen), size)}:
            raise UserError(
                f"states are {given.dtype} of shape {given.shape}; expected: int64 of shape ({len(chosen)}, {size}),"
                " as `save` returns them for this scene"
            )
        for copy, words in zip(chosen.tolist(), np.broadcast_to(given, (len(chosen), size)), strict=True):
            memory = self._memory(copy)
            parts = np.split(words, np.cumsum([len(part) for part in memory])[:-1])
            for target, part in zip(memory[:-1], parts[:-1], strict=True):
                target[:] = part
            self._copies.set_counters(copy, parts[-1])
            for simulation in self._scenes[copy].simulations:
                simulation.forget_scratch()

    def _memory(self, copy: int) -> list[Longs]:
        """Return the words of a copy's state: views, and last a copy of its counters."""
        scene = self._scenes[copy]
        given = [scene.origins, self._given[copy], self._angles[copy]]
        own = [part.reshape(-1).view(np.int64) for part in given]
        return [*memory_of(scene), *own, self._copies.counters(copy)]

    def _bodies(self) -> tuple[Floats, Floats]:
        """Return poses (n, B, 7) and wrenches (n, B, 6) of all bodies, in the frame of the first organ's clamp."""
        count = len(self.tools.grown)
        poses, wrenches = np.empty((len(self), count, 7)), np.empty((len(self), count, 6))
        read_tools(self._worlds[0], poses, wrenches)
        return poses, wrenches

    def _of_tools(self, poses: Floats, wrenches: Floats) -> Floats:
        """Return the wrenches (n, T, 6) of tools about their origins from those of their bodies (n, B, 6)."""
        if wrenches.shape[1] == len(self.tools.tools):
            return wrenches
        total = np.empty((len(self), len(self.tools.tools), 6))
        for tool, own in enumerate(self.tools.bodies):
            arms = poses[:, own, :3] - self._given[:, tool, None, :3]
            total[:, tool] = wrenches[:, own].sum(axis=1)
            total[:, tool, 3:] += np.cross(arms, wrenches[:, own, :3]).sum(axis=1)
        return total

    def _chosen(self, copies: ArrayLike | None) -> Longs:
        """Return the numbers of copies that are given as a mask, as numbers, or as None for all."""
        if copies is None:
            return np.arange(len(self))
        given = np.atleast_1d(np.asarray(copies))
        if given.dtype == np.bool_ and given.shape == (len(self),):
            return np.flatnonzero(given)
        if given.size == 0:
            return np.zeros(0, dtype=np.int64)
        if given.dtype.kind not in "iu" or given.ndim != 1 or given.min() < -len(self) or given.max() >= len(self):
            raise UserError(f"no such copies of {len(self)}: give a mask of that length, or numbers below it")
        return np.asarray(given, dtype=np.int64) % len(self)


def pieces(count: int, threads: int) -> list[int]:
    """Return the sizes of parts of the work, of which each thread takes the next one whenever it is done.

    The parts become smaller towards the end (guided self-scheduling, Polychronopoulos and Kuck 1987): copies that sleep
    are done sooner than others, and a thread that is done waits for one copy at most.

    Parameters
    ----------
    count : int
        Number of copies.
    threads : int
        Number of threads.
    """
    sizes, left = list[int](), count
    while left > 0:
        sizes.append(max(1, int(TAKEN * left / threads)))
        left -= sizes[-1]
    return sizes


def _spread(given: ArrayLike, shape: Sequence[int], name: str) -> Floats:
    """Return finite numbers, broadcast to a shape. Raises UserError, with their name, for others."""
    values = floats_of(given)
    try:
        spread = np.broadcast_to(values, tuple(shape)).copy()
    except ValueError:
        raise UserError(f"{name} have shape {values.shape}; expected: {tuple(shape)}") from None
    if not np.all(np.isfinite(spread)):
        raise UserError(f"{name} must be finite")
    return spread


def _nbytes(values: object) -> int:
    """Return the bytes of an array, or of the arrays of a NamedTuple and of those in it."""
    return sum(map(_nbytes, values)) if isinstance(values, tuple) else np.asarray(values).nbytes
