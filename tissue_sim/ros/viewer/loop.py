"""The viewer's work for each picture: take the newest of everything, draw what has changed."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np
import viser
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from visualization_msgs.msg import Marker, MarkerArray

from tissue_sim.array_types import Floats
from tissue_sim.rendering.organ_view import FIELD_OF_VIEW, camera_for, light
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.node_parameters import NodeParameters
from tissue_sim.ros.shared.parameter_specs import ORGANS
from tissue_sim.ros.viewer.pace import Pace
from tissue_sim.ros.viewer.panel import SOLID, TRANSLUCENT, Panel, detail, headline
from tissue_sim.ros.viewer.scene import LigamentView
from tissue_sim.ros.viewer.services import Services
from tissue_sim.ros.viewer.tools import SILENT_AFTER, ToolsView
from tissue_sim.ros.viewer.viewed_organ import ViewedOrgan


class Viewer:
    """Viewer of a node; `update` is called for each picture.

    tools: names of the tools, or None for those of the node; patience: as in `Poke`, s.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        node: Node,
        target: str,
        tools: tuple[str, ...] | None,
        patience: float,
    ) -> None:
        self._server, self._target = server, target
        self._node = node
        self.organs = [ViewedOrgan(server, node, target, "")]
        self._reports = client.NewestMessage(node, DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        self._services = Services(node, target)
        self._parameters = NodeParameters(node, target)
        self._panel = Panel(server)
        self._tool_markers = client.NewestMessage(node, MarkerArray, f"/{target}/tools", client.stream_qos())
        self.tools = ToolsView(server, node, target, tools, patience)
        self._values: dict[str, str] = {}
        self._headline, self._detail = "", ""
        self._last_message = -np.inf
        self._rest: Floats | None = None  # of all organs, (n, 3) m
        self._seen_by: set[int] = set()  # pages whose cameras see all of these
        self._lines: client.NewestMessage | None = None  # of a scene's ligaments
        self._ligaments = LigamentView(server)
        self._pace = Pace(server.get_clients)
        server.scene.set_up_direction("+z")
        light(server)
        server.initial_camera.fov = FIELD_OF_VIEW
        server.initial_camera.near = 0.02

    def update(self) -> bool:
        """Take what has come; draw it when a page is open; return whether one is."""
        now, watchers = time.monotonic(), self._server.get_clients()
        if sum(one.take_mesh() for one in self.organs):  # of all of them
            self._look()
            self._parameters.ask()  # it may be another node of that name
        parameters = self._parameters.poll()
        if parameters is not None:
            self._name(tuple(parameters.get(ORGANS, ())) or ("",))
        self._take_report()
        self._services.poll(self._panel.requests, self._report)
        for one in self.organs:
            one.take_inclusions()
            one.take_surface()
        self._place(watchers)
        eye = next((np.asarray(page.camera.position) for page in watchers.values() if _has_size(page)), None)
        with self._server.atomic():
            for one in self.organs:
                one.draw(eye, self._panel.opacity.value)
            self._draw_ligaments()
            self.tools.take(self._tool_markers.take(), now)
            if parameters is not None:
                self.tools.use(parameters)
            self.tools.update(now, watchers, *self._points())
        return bool(watchers)

    def close(self) -> None:
        """Release every tool."""
        self._pace.close()
        self.tools.close()

    @property
    def picture_time(self) -> float:
        """Return the s that the slowest page needs from one picture to the next."""
        return self._pace.picture_time

    def _name(self, names: tuple[str, ...]) -> None:
        """View the organs of these names, which a node has reported."""
        if names == tuple(one.name for one in self.organs):
            return
        for one in self.organs:
            one.remove()
        self.organs = [ViewedOrgan(self._server, self._node, self._target, name) for name in names]
        is_scene = names != ("",)
        self._panel.name(names if is_scene else ())
        if self._lines is not None:
            self._lines.close()
            self._ligaments.remove()
        self._lines = None
        if is_scene:
            self._lines = client.NewestMessage(
                self._node, MarkerArray, f"/{self._target}/ligaments", client.latched_qos()
            )
        self._panel.opacity.value = TRANSLUCENT if len(names) == 1 else SOLID  # type: ignore[misc]  # viser's type: read-only

    def _points(self) -> tuple[Floats | None, str]:
        """Return the last positions of all surfaces, (n, 3) m, and their frame; None before they have come."""
        known = [one for one in self.organs if one.points is not None]
        if len(known) < len(self.organs):
            return None, ""
        return np.concatenate([one.points for one in known if one.points is not None]), known[0].frame_id

    def _look(self) -> None:
        """Point the initial camera at all organs, and place their names."""
        views = [one.view for one in self.organs if one.view is not None]
        self._rest = np.concatenate([view.rest for view in views])
        for view in views:
            view.name_beside(np.concatenate([other.rest for other in views if other is not view or len(views) == 1]))
        position, looked_at = camera_for(self._rest)
        self._server.initial_camera.position, self._server.initial_camera.look_at = position, looked_at
        self._seen_by.clear()

    def _place(self, watchers: Mapping[int, viser.ClientHandle]) -> None:
        """Point the camera of each page that is new, or sees new organs, at all of them beside the panel."""
        self._seen_by &= set(watchers)
        if self._rest is None:
            return
        for number, page in watchers.items():
            if number not in self._seen_by and _has_size(page):
                size = int(page.camera.image_width), int(page.camera.image_height)
                page.camera.position, page.camera.look_at = camera_for(self._rest, size)
                self._seen_by.add(number)

    def _draw_ligaments(self) -> None:
        message = self._lines.take() if self._lines is not None else None
        for marker in message.markers if message is not None else ():
            ends = [(point.x, point.y, point.z) for point in marker.points if marker.action == Marker.ADD]
            self._ligaments.show(np.array(ends).reshape(-1, 2, 3))

    def _take_report(self) -> None:
        status = client.newest_status(self._reports.take_all(), self._target)
        now = time.monotonic()
        if status is not None:
            if now - self._last_message >= SILENT_AFTER:
                self._parameters.ask()  # it may serve other organs by now
            before, self._last_message = self._values.get("registrations"), now
            self._values = {item.key: item.value for item in status.values}
            if self._values.get("registrations") != before:
                self._parameters.ask()  # the organ is elsewhere in the frame of the tools
            level = int.from_bytes(status.level, "little")
            self._headline, self._detail = headline(self._target, level, status.message), detail(level, status.message)
        if now - self._last_message < SILENT_AFTER:
            self._panel.say(self._headline, self._values, self._detail)
        elif all(one.view is None for one in self.organs):
            self._panel.say(f"<b>Waiting for the mesh of /{self._target}.</b> Start tissue_node.", {})
        else:
            self._panel.say(f"<b>/{self._target} doesn't answer.</b> The picture shows its last state.", {})

    def _report(self, text: str, good: bool) -> None:
        for watcher in self._server.get_clients().values():
            watcher.add_notification(
                "Done" if good else "Not done", text, color="green" if good else "red", auto_close_seconds=6.0
            )


def _has_size(page: viser.ClientHandle) -> bool:
    """Return whether a page has reported its size and its camera, which takes a moment."""
    return page.camera.image_width > 0 and page.camera.image_height > 0
