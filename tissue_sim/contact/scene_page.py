"""Page that shows a scene in the browser, or in a notebook, without ROS."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.contact.drawn_scene import DrawnSurface, body_shapes
from tissue_sim.contact.tools import ToolSet
from tissue_sim.ports import free_port
from tissue_sim.rendering.organ_view import FIELD_OF_VIEW, OrganView, camera_for, light
from tissue_sim.rendering.page_server import LOOPBACK, NOTEBOOKS, started, stopped

FRAME_TIME = 1.0 / 30.0  # s between two pictures
METAL = (150, 155, 165)
HEIGHT = 480  # pixels in a notebook
DrawnParts = tuple[list[DrawnSurface], list[Floats | None]]  # surfaces, and poses of the tools' bodies


class ScenePage:
    """Page that shows a scene; `update` shows the present state, `close` ends it. A notebook displays it.

    Parameters
    ----------
    look : Callable[[], DrawnParts]
        Returns the present surfaces and poses.
    tools : ToolSet
        The tools.
    port : int, optional
        Port on this machine at which it is served; 0 for a free one.

    Raises
    ------
    UserError
        If the port is in use.
    """

    def __init__(self, look: Callable[[], DrawnParts], tools: ToolSet, port: int = 0) -> None:
        self.port = port or free_port()
        self._look = look
        self._server = started(LOOPBACK, self.port, None, NOTEBOOKS)
        self._views: dict[
            str, tuple[Ints, OrganView]
        ] = {}  # by the organ's name, with the triangles that it was made of
        scene = self._server.scene
        scene.set_up_direction("+z")
        light(self._server)
        self._bodies = [
            scene.add_mesh_simple(f"/tools/{body}", *shape, color=METAL, visible=False, cast_shadow=False)
            for body, shape in enumerate(body_shapes(tools))
        ]
        self._server.initial_camera.fov, self._server.initial_camera.near = FIELD_OF_VIEW, 0.02
        self._newest: DrawnParts | None = look()
        points = np.concatenate([one.rest for one in self._newest[0]])
        self._server.initial_camera.position, self._server.initial_camera.look_at = camera_for(points)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._draw, name="scene page", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Address to open in a browser of this machine."""
        return f"http://{LOOPBACK}:{self.port}"

    def update(self) -> None:
        """Show the present state of the scene; copies its surfaces, and doesn't wait for the page."""
        self._newest = self._look()

    def close(self) -> None:
        """End the page."""
        if not self._ended.is_set():
            self._ended.set()
            self._thread.join()
            stopped(self._server)

    def __enter__(self) -> ScenePage:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<scene at {self.address}{' (closed)' if self._ended.is_set() else ''}>"

    def _repr_html_(self) -> str:
        """Return a frame with the page, for notebooks."""
        return f'<iframe src="{self.address}" width="100%" height="{HEIGHT}" style="border: 0"></iframe>'

    def _draw(self) -> None:
        """Show new states until the page is closed."""
        while not self._ended.is_set():
            newest, self._newest = self._newest, None
            with self._server.atomic():
                if newest is not None:
                    self._show(*newest)
                for _, view in self._views.values():
                    view.turn()
            time.sleep(FRAME_TIME)

    def _show(self, surfaces: list[DrawnSurface], poses: list[Floats | None]) -> None:
        for one in surfaces:
            name = one.name if len(surfaces) > 1 else ""
            triangles, view = self._views.get(one.name, (None, None))
            if view is None or triangles is not one.triangles:
                if view is not None:
                    view.remove()
                view = OrganView(self._server, one.rest, one.triangles.astype(np.int64), name)
                self._views[one.name] = one.triangles, view
            view.show(one.points)
        for body, pose in zip(self._bodies, poses, strict=True):
            body.visible = pose is not None
            if pose is not None:
                body.position, body.wxyz = pose[:3], np.roll(pose[3:], 1)
