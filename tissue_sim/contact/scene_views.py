"""Pictures of a scene, and its page in a browser."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from tissue_sim.array_types import Pixels
from tissue_sim.contact.drawn_scene import body_poses, surfaces_of
from tissue_sim.contact.painter import Painter, whole_view
from tissue_sim.contact.tools import ToolSet
from tissue_sim.errors import UserError
from tissue_sim.model.simulation import Simulation
from tissue_sim.rendering.pinhole import Pinhole

if TYPE_CHECKING:
    from tissue_sim.contact.scene_page import DrawnParts, ScenePage


class SceneViews:
    """Mixin of a scene for pictures and a page."""

    names: list[str]
    tools: ToolSet
    _painter: tuple[int, Painter] | None = None  # with the thread for which it was made

    @property
    def simulations(self) -> list[Simulation]:
        """Simulation of each organ."""
        raise NotImplementedError

    def render(
        self, width: int = 640, height: int = 480, pose: ArrayLike | None = None, field_of_view: float = 60.0
    ) -> Pixels:
        """Return a picture of the scene, as an endoscope would show it.

        Parameters
        ----------
        width, height : int, pixels, optional
            Its size.
        pose : ArrayLike | None, shape (7,), m and quaternion xyzw, optional
            Pose of the camera's optical frame: x to the right, y down, z into the picture; None to see all organs from
            the front. `tissue_sim.rendering.pinhole.look_at` makes one.
        field_of_view : float, degrees, optional
            Angle across the width.

        Returns
        -------
        Pixels
            (height, width, 3) red, green, blue, 0 to 255.

        Raises
        ------
        UserError
            For sizes and poses out of range, and where nothing can be drawn: it needs the extra camera, and OpenGL.
        """
        lens, thread = Pinhole.of_view(width, height, field_of_view), threading.get_ident()
        if self._painter is None or self._painter[0] != thread or self._painter[1].lens != lens:
            if self._painter is not None and self._painter[0] == thread:
                self._painter[1].close()
            self._painter = thread, Painter(self.tools, lens)
        painter, surfaces = self._painter[1], surfaces_of(self.simulations, self.names)
        painter.draw(surfaces, body_poses(self.simulations[0]))
        return painter.picture(whole_view(surfaces, lens) if pose is None else pose)

    def show(self, port: int = 0) -> ScenePage:
        """Show the scene in a browser, or in a notebook, of this machine.

        Parameters
        ----------
        port : int, optional
            Port at which the page is served; 0 for a free one.

        Returns
        -------
        ScenePage
            The page: its `address`; `update()` after steps shows where everything is then; `close()` ends it.

        Raises
        ------
        UserError
            For a port that is taken or out of range, and where viser is missing: it needs the extra viewer.
        """
        if not 0 <= port <= 65535:
            raise UserError(f"port {port} is outside 0..65535; 0 chooses a free one")
        try:
            from tissue_sim.contact.scene_page import ScenePage
        except ImportError as error:
            raise UserError(f"a page needs {error.name}: pip install 'tissue_sim[viewer]'") from None

        def look() -> DrawnParts:
            return surfaces_of(self.simulations, self.names), body_poses(self.simulations[0])

        return ScenePage(look, self.tools, port)
