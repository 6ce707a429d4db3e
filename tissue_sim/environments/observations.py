"""What environments show of their copies, and the spaces of observations and actions."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from tissue_sim.array_types import Pixels, Singles
from tissue_sim.environments.copies import TaskCopies
from tissue_sim.errors import UserError

KINDS = ("pose", "surface", "image")  # image and surface come beside the pose


class Observer:
    """Observations of copies.

    Parameters
    ----------
    copies : TaskCopies
        The copies.
    kind : str
        One of KINDS.

    Raises
    ------
    UserError
        For another one, and where images can't be drawn.
    """

    def __init__(self, copies: TaskCopies, kind: str) -> None:
        if kind not in KINDS:
            raise UserError(f"no observation '{kind}'; choose one of {', '.join(KINDS)}")
        self._copies, self._kind = copies, kind

    def observe(self) -> dict[str, Singles | Pixels]:
        """Return the observations of all copies."""
        seen: dict[str, Singles | Pixels] = {**self._copies.observe()}
        if self._kind == "surface":
            seen["surface"] = self._copies.surface()
        return seen

    def spaces(self) -> tuple[gymnasium.spaces.Dict, gymnasium.spaces.Box]:
        """Return the spaces of one copy's observations and actions."""

        def box(*shape: int, most: float = np.inf) -> gymnasium.spaces.Box:
            return gymnasium.spaces.Box(-most, most, shape, np.float32)

        seen = self._copies.observe()
        spaces: dict[str, gymnasium.spaces.Space[Any]] = {name: box(*one.shape[1:]) for name, one in seen.items()}
        if self._kind == "surface":
            spaces["surface"] = box(self._copies.organ.n_surface, 3)
        return gymnasium.spaces.Dict(spaces), box(self._copies.task.actions, most=1.0)
