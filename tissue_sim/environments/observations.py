"""What environments show of their copies, and the spaces of observations and actions."""

from __future__ import annotations

import gymnasium
import numpy as np

from tissue_sim.array_types import Pixels, Singles
from tissue_sim.contact.drawn_scene import DrawnSurface
from tissue_sim.contact.painter import Painter
from tissue_sim.environments.copies import TaskCopies
from tissue_sim.errors import UserError
from tissue_sim.rendering.pinhole import Pinhole, look_at

KINDS = ("pose", "surface", "image")  # image and surface come beside the pose
SIZE, VIEW = 64, 60.0  # pixels of a side, degrees
RENDERED = 480  # pixels of a side of what `render` returns
DISTANCE, SIDE = 0.12, (0.55, -1.0, 0.3)  # m, and direction from the middle of the organ at rest to the camera


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
        self._camera = Camera(copies) if kind == "image" else None

    def observe(self) -> dict[str, Singles | Pixels]:
        """Return the observations of all copies."""
        seen: dict[str, Singles | Pixels] = {**self._copies.observe()}
        if self._kind == "surface":
            seen["surface"] = self._copies.surface()
        if self._camera is not None:
            seen["image"] = self._camera.pictures()
        return seen

    def spaces(self) -> tuple[gymnasium.spaces.Dict, gymnasium.spaces.Box]:
        """Return the spaces of one copy's observations and actions."""

        def box(*shape: int, most: float = np.inf) -> gymnasium.spaces.Box:
            return gymnasium.spaces.Box(-most, most, shape, np.float32)

        seen = self._copies.observe()
        spaces: dict[str, gymnasium.Space] = {name: box(*one.shape[1:]) for name, one in seen.items()}
        if self._kind == "surface":
            spaces["surface"] = box(self._copies.organ.n_surface, 3)
        if self._camera is not None:
            spaces["image"] = gymnasium.spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        return gymnasium.spaces.Dict(spaces), box(self._copies.task.actions, most=1.0)


class Camera:
    """A camera that stands still in the environments' frame, while the organs lie differently in it.

    Parameters
    ----------
    copies : TaskCopies
        The copies.
    size : int, optional
        Pixels of a side.
    samples : int, optional
        Samples of a pixel that smooth edges: 1, 2 or 4.

    Raises
    ------
    UserError
        Where nothing can be drawn.
    """

    def __init__(self, copies: TaskCopies, size: int = SIZE, samples: int = 1) -> None:
        self._copies, self._size = copies, size
        self._painter = Painter(copies.batch.tools, Pinhole.of_view(size, size, VIEW), samples)
        rest = copies.organ.surface_positions
        middle = 0.5 * (rest.min(axis=0) + rest.max(axis=0))
        away = np.array(SIDE) / np.linalg.norm(SIDE)
        self._pose = look_at(middle + DISTANCE * away, middle)

    def pictures(self) -> Pixels:
        """Return the pictures (n, size, size, 3) of all copies."""
        copies, organ = self._copies, self._copies.organ
        surfaces, bodies = copies.batch.surface_positions(), copies.batch.body_poses
        found: Pixels = np.empty((len(surfaces), self._size, self._size, 3), dtype=np.uint8)
        for copy, points in enumerate(surfaces):
            seen = DrawnSurface(organ.name, points, organ.surface_positions, organ.surface_triangles)
            self._painter.draw([seen], list(bodies[copy]))
            found[copy] = self._painter.picture(copies.inside(copy, self._pose))
        return found


def camera_of(copies: TaskCopies) -> Camera:
    """Return the camera whose pictures `render` returns. Raises UserError where nothing can be drawn."""
    return Camera(copies, RENDERED, samples=4)
