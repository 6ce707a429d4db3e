"""`tissue_sim view`: a running node in the browser."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import socket
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from tissue_sim.errors import UserError
from tissue_sim.ros import client
from tissue_sim.ros.cdr import parse_stamped

if TYPE_CHECKING:
    import viser
    from rclpy.node import Node

FRAME_TIME = 1.0 / 30.0  # s, at least, between two pictures
IDLE_TIME = 0.2  # s between two looks while no browser is connected
SILENT_AFTER = 3.0  # s without diagnostics
POSE_LASTS = 1.0  # s that a tool stays in the picture without a new pose
FORCE_LASTS = 0.2  # s


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument(
        "--host", default="127.0.0.1", help="address to serve at; 0.0.0.0 lets other machines look (no password)"
    )
    parser.add_argument("--port", type=client.port_number, default=8080, help="port to serve at")
    parser.add_argument("--node", type=client.node_name, default="tissue_sim", help="name of the node")
    parser.add_argument("--tools", type=client.names, default="left,right", help="names of the tools")
    parser.add_argument(
        "--tool-radius", type=client.number(1e-4, 0.1, "m"), default=0.005, help="of the spheres that stand for them, m"
    )


def run(args: argparse.Namespace) -> int:
    """Serve the page until SIGINT or SIGTERM; returns 0. Raises UserError when it can't be served."""
    check_port(args.host, args.port)
    stop = client.Stop()
    with _server(args.host, args.port) as server, client.client_node("viewer", args.node) as node:
        print(f"open http://{_shown(args.host)}:{args.port}", flush=True)
        viewer = Viewer(server, node, args.node, args.tools, args.tool_radius)
        while not stop:
            started = time.monotonic()
            watched = bool(server.get_clients())
            viewer.update(watched)
            time.sleep(max(0.001, (FRAME_TIME if watched else IDLE_TIME) - (time.monotonic() - started)))
    return 0


def check_port(host: str, port: int) -> None:
    """Raise UserError, with the remedy, when nothing can be served at host and port."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
            probe.listen(1)
    except (socket.gaierror, UnicodeError):
        raise UserError(f"'{host}' is no address; use --host 127.0.0.1, or 0.0.0.0 for all of this machine's") from None
    except PermissionError:
        raise UserError(f"port {port} needs more rights; choose one above 1023 with --port") from None
    except OSError as error:
        if error.errno in (98, 48):  # EADDRINUSE on Linux and elsewhere
            raise UserError(f"port {port} of {host} is taken; choose another with --port") from None
        raise UserError(f"cannot serve at {host}:{port}: {error.strerror}; choose another --host") from None


class Viewer:
    """Takes the newest of everything and draws what has changed; `update` is called for each picture."""

    def __init__(
        self, server: viser.ViserServer, node: Node, target: str, tools: tuple[str, ...], radius: float
    ) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import QoSProfile
        from sensor_msgs.msg import PointCloud2
        from shape_msgs.msg import Mesh

        from tissue_sim.ros.services import Services
        from tissue_sim.ros.view_panel import Panel
        from tissue_sim.ros.view_scene import FIELD_OF_VIEW, OrganView, SkeletonView, ToolView, light

        self._server, self._target = server, target
        self._mesh = client.Inbox(node, Mesh, f"/{target}/mesh", client.latched_qos())
        self._surface = client.Inbox(node, PointCloud2, f"/{target}/surface", client.stream_qos())
        self._atoms = client.Inbox(node, PointCloud2, f"/{target}/skeleton", client.stream_qos())
        self._reports = client.Inbox(node, DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
        self._services = Services(target)
        self._panel = Panel(server)
        self._organ_view: Any = OrganView
        self._organ: OrganView | None = None
        self._positions: Any = None
        self._skeleton = SkeletonView(server)
        self._tools = [_Tool(node, ToolView(server, name, i, radius), name) for i, name in enumerate(tools)]
        self._values: dict[str, str] = {}
        self._heard = -np.inf
        server.scene.set_up_direction("+z")
        light(server)
        server.initial_camera.fov = FIELD_OF_VIEW
        server.initial_camera.near = 0.02
        self._panel.opacity.on_update(lambda _: self._set_opacity())

    def update(self, watched: bool) -> None:
        """Take what has come; draw it when somebody looks."""
        mesh = self._mesh.take()
        if mesh is not None:
            self._take_mesh(*client.mesh_arrays(mesh))
        self._take_report()
        self._services.poll(self._panel.wishes, self._tell)
        surface, atoms = self._surface.take(), self._atoms.take()
        if surface is not None and self._organ is not None:
            positions = client.cloud_array(surface)
            # Another number of nodes belongs to an organ whose mesh is still on its way.
            if positions.shape == self._organ.rest.shape and np.isfinite(positions).all():
                self._positions = positions.astype(np.float64)
        with self._server.atomic():
            if watched and self._organ is not None and self._positions is not None:
                self._organ.show(self._positions)
                self._positions = None
            if atoms is not None:
                self._skeleton.show(client.cloud_array(atoms)[:, :3].astype(np.float64))
            for tool in self._tools:
                tool.update()

    def _take_mesh(self, vertices: Any, triangles: Any) -> None:
        from tissue_sim.ros.view_scene import camera_for

        if self._organ is not None:
            if np.array_equal(vertices, self._organ.rest):
                return
            self._organ.remove()
            self._skeleton.remove()
        self._organ = self._organ_view(self._server, vertices, triangles)
        self._positions = None
        self._set_opacity()
        position, centre = camera_for(vertices)
        for camera in (self._server.initial_camera, *(one.camera for one in self._server.get_clients().values())):
            camera.position = position
            camera.look_at = centre

    def _take_report(self) -> None:
        report = self._reports.take()
        values = client.physics_status(report, self._target) if report is not None else None
        now = time.monotonic()
        if values is not None:
            self._values, self._heard = values, now
        if now - self._heard < SILENT_AFTER:
            self._panel.say(f"**/{self._target}**", self._values)
        elif self._organ is None:
            self._panel.say(f"**Waiting for the mesh of /{self._target}.** Start `tissue_node`.", {})
        else:
            self._panel.say(f"**/{self._target} is silent.** The picture shows where it stood.", {})

    def _set_opacity(self) -> None:
        value = float(self._panel.opacity.value)
        if self._organ is not None:
            self._organ.set_opacity(None if value >= 1.0 else value)

    def _tell(self, text: str, good: bool) -> None:
        for one in self._server.get_clients().values():
            one.add_notification(
                "Done" if good else "Not done", text, color="green" if good else "red", auto_close_seconds=6.0
            )


class _Tool:
    """A tool's newest pose and wrench, and its place in the picture."""

    def __init__(self, node: Node, view: Any, name: str) -> None:
        from geometry_msgs.msg import PoseStamped, WrenchStamped

        self._view = view
        self._poses = client.Inbox(node, PoseStamped, f"{name}/measured_cp", client.stream_qos(), raw=True)
        self._wrenches = client.Inbox(node, WrenchStamped, f"{name}/servo_cf", client.stream_qos(), raw=True)
        self._position: Any = None
        self._force: Any = None
        self._posed = self._felt = -np.inf

    def update(self) -> None:
        now = time.monotonic()
        pose, wrench = _vector(self._poses.take(), 7), _vector(self._wrenches.take(), 6)
        if pose is not None:
            self._position, self._posed = pose, now
        if wrench is not None:
            self._force, self._felt = wrench, now
        self._view.show(
            self._position if now - self._posed < POSE_LASTS else None,
            self._force if now - self._felt < FORCE_LASTS else None,
        )


def _vector(raw: bytes | None, n_values: int) -> Any:
    """First three values of a stamped message, or None when there is none, or none that can be drawn."""
    if raw is None:
        return None
    try:
        values = np.array(parse_stamped(raw, n_values).values[:3])
    except ValueError:
        return None
    return values if np.isfinite(values).all() else None


@contextlib.contextmanager
def _server(host: str, port: int) -> Iterator[viser.ViserServer]:
    """A viser server that says nothing on the terminal and serves at this port or not at all."""
    try:
        import viser
    except ImportError:
        raise UserError("the viewer needs viser: pip install viser") from None
    os.environ.pop("_VISER_PORT_OVERRIDE", None)
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="tissue_sim", verbose=False)
    try:
        if server.get_port() != port:
            raise UserError(f"port {port} of {host} is taken; choose another with --port")
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def _shown(host: str) -> str:
    """How a host reads in an address that works in a browser on this machine."""
    return {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)
