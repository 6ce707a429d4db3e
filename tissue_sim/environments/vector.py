"""Vector environment of Gymnasium on a batch: all copies are stepped at once, on all cores."""

from __future__ import annotations

from collections.abc import Mapping

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from tissue_sim.array_types import Floats, Longs, Mask, Pixels, Singles
from tissue_sim.environments.cut_copies import copies_of
from tissue_sim.environments.observations import Observer
from tissue_sim.organ.organ import Organ


class TissueVectorEnv(gymnasium.vector.VectorEnv):
    """Copies of a task, each with its own organ's place, stiffness and goal.

    Parameters
    ----------
    task : str
        Press, Palpate, Retract, Hold or Cut.
    num_envs : int, optional
        Number of copies.
    max_episode_steps : int, optional
        Steps of 20 ms after which an episode is truncated; 0: never.
    organ : Organ | str | None, optional
        Another organ, or the name of one that ships; None for the task's.
    observation : str, optional
        What is seen: pose, or beside it the surface, or an image.
    threads : int, optional
        As in SceneBatch: 0 for one on each core.
    """

    metadata = {"autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP, "render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        max_episode_steps: int = 0,
        organ: Organ | str | None = None,
        observation: str = "pose",
        threads: int = 0,
    ) -> None:
        self.num_envs, self.render_mode = num_envs, None
        self.copies = copies_of(task, num_envs, organ, threads)
        self._observer = Observer(self.copies, observation)
        self.single_observation_space, self.single_action_space = self._observer.spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._longest = max_episode_steps
        self._elapsed = np.zeros(num_envs, dtype=np.int64)
        self._is_over = np.zeros(num_envs, dtype=np.bool_)
        self._randoms = [np.random.default_rng(one) for one in np.random.SeedSequence().spawn(num_envs)]

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: Mapping[str, ArrayLike] | None = None
    ) -> tuple[dict[str, Singles | Pixels], dict[str, object]]:
        """Begin all episodes, or those of the mask `reset_mask` in options; copy i takes the seed plus i."""
        seeds = [seed + copy for copy in range(self.num_envs)] if isinstance(seed, int) else seed
        for copy, one in enumerate(seeds or []):
            if one is not None:
                self._randoms[copy] = seeding.np_random(one)[0]
        mask = (options or {}).get("reset_mask")
        self._begin(np.arange(self.num_envs) if mask is None else np.flatnonzero(mask))
        return self._observer.observe(), {}

    def step(self, actions: Floats) -> tuple[dict[str, Singles | Pixels], Floats, Mask, Mask, dict[str, object]]:
        """Do a step of 20 ms; a copy whose episode ended in the last one begins again instead, without reward."""
        begins = self._is_over.copy()
        stepped = self.copies.step(actions)
        self._elapsed += 1
        truncated = (self._elapsed >= self._longest) if self._longest else np.zeros(self.num_envs, dtype=np.bool_)
        self._begin(np.flatnonzero(begins))
        reward, terminated = np.where(begins, 0.0, stepped.reward), stepped.terminated & ~begins
        truncated = truncated & ~begins & ~terminated
        self._is_over = terminated | truncated
        succeeded = stepped.succeeded & ~begins
        return self._observer.observe(), reward, terminated, truncated, {"success": succeeded}

    def _begin(self, copies: Longs) -> None:
        self.copies.begin(copies, [self._randoms[copy] for copy in copies.tolist()])
        self._elapsed[copies], self._is_over[copies] = 0, False
