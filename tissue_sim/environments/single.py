"""Environment of Gymnasium for one copy of a task."""

from __future__ import annotations

import gymnasium
import numpy as np

from tissue_sim.array_types import Floats, Pixels, Singles
from tissue_sim.environments.cut_copies import copies_of
from tissue_sim.environments.observations import Observer, camera_of
from tissue_sim.environments.tasks import STEP
from tissue_sim.organ.organ import Organ


class TissueEnv(gymnasium.Env):
    """One copy of a task; the first copy of a vector environment with the same seed does the same.

    Parameters
    ----------
    task : str
        Press, Palpate, Retract, Hold or Cut.
    organ : Organ | str | None, optional
        Another organ, or the name of one that ships; None for the task's.
    observation : str, optional
        What is seen: pose, or beside it the surface, or an image.
    render_mode : str | None, optional
        rgb_array to have pictures of `render`.
    """

    metadata: dict[str, object] = {"render_modes": ["rgb_array"], "render_fps": round(1.0 / STEP)}  # noqa: RUF012

    def __init__(
        self,
        task: str,
        organ: Organ | str | None = None,
        observation: str = "pose",
        render_mode: str | None = None,
    ) -> None:
        self.copies = copies_of(task, 1, organ, threads=1)
        self.render_mode, self._camera = render_mode, None if render_mode is None else camera_of(self.copies)
        self._observer = Observer(self.copies, observation)
        self.observation_space, self.action_space = self._observer.spaces()

    def reset(
        self, *, seed: int | None = None, options: dict[str, object] | None = None
    ) -> tuple[dict[str, Singles | Pixels], dict[str, object]]:
        """Begin an episode."""
        super().reset(seed=seed)
        self.copies.begin(np.zeros(1, dtype=np.int64), [self.np_random])
        return self._observe(), {}

    def step(self, action: Floats) -> tuple[dict[str, Singles | Pixels], float, bool, bool, dict[str, object]]:
        """Do a step of 20 ms."""
        stepped = self.copies.step(np.asarray(action)[None])
        info: dict[str, object] = {"success": bool(stepped.succeeded[0])}
        return self._observe(), float(stepped.reward[0]), bool(stepped.terminated[0]), False, info

    def render(self) -> Pixels | None:  # type: ignore[override]
        """Return a picture (RENDERED, RENDERED, 3) of what is there; None without a render_mode."""
        return None if self._camera is None else self._camera.pictures()[0]

    def _observe(self) -> dict[str, Singles | Pixels]:
        return {name: values[0] for name, values in self._observer.observe().items()}
