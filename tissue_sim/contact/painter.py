"""Pictures of a scene as arrays, drawn off-screen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.array_types import Floats, Ints, Pixels
from tissue_sim.contact.drawn_scene import DrawnSurface, body_shapes
from tissue_sim.contact.tools import ToolSet
from tissue_sim.errors import UserError
from tissue_sim.rendering.appearance import tissue_colour
from tissue_sim.rendering.pinhole import Pinhole, framing


class Painter:
    """Draws organs and tools; for use in one thread.

    Parameters
    ----------
    tools : ToolSet
        The tools.
    lens : Pinhole
        The camera.
    samples : int, optional
        Samples per pixel, which smooth edges: 1, 2 or 4.

    Raises
    ------
    UserError
        If drawing is impossible.
    """

    def __init__(self, tools: ToolSet, lens: Pinhole, samples: int = 4) -> None:
        try:
            from tissue_sim.rendering.bodies import METAL, Look
            from tissue_sim.rendering.offscreen import Offscreen
        except ImportError as error:
            raise UserError(f"pictures need {error.name}: pip install 'tissue_sim[camera]'") from None
        self.lens, self._look = lens, Look
        self._drawn = Offscreen(lens, samples=samples)
        self._shapes: dict[str, Ints] = {}  # triangles with which each organ was drawn
        self._tools = [f"tool/{body}" for body in range(len(tools.meshes))]
        for name, shape in zip(self._tools, body_shapes(tools), strict=True):
            self._drawn.add(name, *shape, METAL)

    def draw(self, surfaces: Sequence[DrawnSurface], poses: Sequence[Floats | None]) -> None:
        """Draw the present state of the scene.

        Parameters
        ----------
        surfaces : Sequence[DrawnSurface]
            Surfaces of the organs.
        poses : Sequence[Floats | None], shape (7,) each, m and quaternion xyzw
            Poses of the tools' bodies; None for one that isn't seen.
        """
        for number, one in enumerate(surfaces):
            name = f"organ/{one.name}"
            if self._shapes.get(name) is not one.triangles:
                red, green, blue = (part / 255.0 for part in tissue_colour(one.name))
                self._drawn.add(name, one.rest, one.triangles, self._look((red, green, blue), min(number + 1, 100)))
                self._shapes[name] = one.triangles
            self._drawn.move(name, one.points)
        for name, pose in zip(self._tools, poses, strict=True):
            self._drawn.place(name, pose)

    def picture(self, pose: ArrayLike) -> Pixels:
        """Return the colours (height, width, 3) from a camera's pose (7,), m and quaternion xyzw."""
        colour = self._drawn.take(pose).colour
        assert colour is not None  # as it was asked for
        return colour

    def close(self) -> None:
        """Free the memory of the graphics processor."""
        self._drawn.close()


def whole_view(surfaces: Sequence[DrawnSurface], lens: Pinhole) -> Floats:
    """Return the pose (7,) of a camera in front of organs at rest that shows all of them, m and quaternion xyzw."""
    return framing(np.concatenate([one.rest for one in surfaces]), lens)
