"""What the viewer does for each picture: take the newest of everything, draw what has changed."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import viser
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import MarkerArray

from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.node_parameters import NodeParameters
from tissue_sim.ros.viewer.panel import Panel, headline
from tissue_sim.ros.viewer.scene import FIELD_OF_VIEW, OrganView, SkeletonView, camera_for, light
from tissue_sim.ros.viewer.services import Services
from tissue_sim.ros.viewer.tools import SILENT_AFTER, ToolsView
from tissue_sim.ros.viewer.view import PATIENCE


class Viewer:
    """Takes the newest of everything and draws what has changed; `update` is called for each picture.

    tools: their names, or None for those of the node; patience s as in `Poke`.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        node: Node,
        target: str,
        tools: tuple[str, ...] | None,
        patience: float = PATIENCE,
    ) -> None:
        self._server, self._target = server, target
        self._mesh = client.Inbox(node, Mesh, f"/{target}/mesh", client.latched_qos())
        self._surface = client.Inbox(node, PointCloud2, f"/{target}/surface", client.stream_qos())
        self._atoms = client.Inbox(node, PointCloud2, f"/{target}/skeleton", client.stream_qos())
        self._reports = client.Inbox(node, DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        self._services = Services(node, target)
        self._parameters = NodeParameters(node, target)
        self._panel = Panel(server)
        self._tool_markers = client.Inbox(node, MarkerArray, f"/{target}/tools", client.stream_qos())
        self.tools = ToolsView(server, node, target, tools, patience)
        self._organ: OrganView | None = None
        self._positions: Any = None  # not drawn yet
        self._points: Any = None  # where the surface was last
        self._frame_id = ""
        self._skeleton = SkeletonView(server)
        self._values: dict[str, str] = {}
        self._headline = ""
        self._heard = -np.inf
        server.scene.set_up_direction("+z")
        light(server)
        server.initial_camera.fov = FIELD_OF_VIEW
        server.initial_camera.near = 0.02

    def update(self) -> bool:
        """Take what has come; draw it when somebody looks, which is what it returns."""
        now, watchers = time.monotonic(), self._server.get_clients()
        watched = bool(watchers)
        mesh = self._mesh.take()
        if mesh is not None:
            self._take_mesh(*client.mesh_arrays(mesh))
            self._parameters.ask()  # it may be another node of that name
        told = self._parameters.poll()
        self._take_report()
        self._services.poll(self._panel.wishes, self._tell)
        surface, atoms = self._surface.take(), self._atoms.take()
        if surface is not None and self._organ is not None:
            positions = client.cloud_array(surface)
            # Another number of nodes belongs to an organ whose mesh is still on its way.
            if positions.shape == self._organ.rest.shape and np.isfinite(positions).all():
                self._positions = self._points = positions.astype(np.float64)
                self._frame_id = surface.header.frame_id
        with self._server.atomic():
            if watched and self._organ is not None and self._positions is not None:
                self._organ.show(self._positions)
                self._positions = None
            if atoms is not None:
                columns = client.cloud_array(atoms)
                self._skeleton.show(columns[:, :3].astype(np.float64), columns[:, 4].astype(np.int64))
            if self._organ is not None:
                self._organ.set_opacity(self._panel.opacity.value)
            self.tools.take(self._tool_markers.take(), now)
            if told is not None:
                self.tools.use(told)
            self.tools.update(now, watchers, self._points, self._frame_id)
        return watched

    def close(self) -> None:
        """Let go of every tool."""
        self.tools.close()

    def _take_mesh(self, vertices: Any, triangles: Any) -> None:
        if self._organ is not None:
            if np.array_equal(vertices, self._organ.rest):
                return
            self._organ.remove()
            self._skeleton.remove()
        self._organ = OrganView(self._server, vertices, triangles)
        self._positions = self._points = None
        position, centre = camera_for(vertices)
        self._server.initial_camera.position, self._server.initial_camera.look_at = position, centre
        for watcher in self._server.get_clients().values():
            watcher.camera.position, watcher.camera.look_at = position, centre

    def _take_report(self) -> None:
        status = client.newest_status(self._reports.take_all(), self._target)
        now = time.monotonic()
        if status is not None:
            self._values, self._heard = {item.key: item.value for item in status.values}, now
            self._headline = headline(self._target, int.from_bytes(status.level, "little"), status.message)
        if now - self._heard < SILENT_AFTER:
            self._panel.say(self._headline, self._values)
        elif self._organ is None:
            self._panel.say(f"<b>Waiting for the mesh of /{self._target}.</b> Start tissue_node.", {})
        else:
            self._panel.say(f"<b>/{self._target} is silent.</b> The picture shows where it stood.", {})

    def _tell(self, text: str, good: bool) -> None:
        for watcher in self._server.get_clients().values():
            watcher.add_notification(
                "Done" if good else "Not done", text, color="green" if good else "red", auto_close_seconds=6.0
            )
