"""What a camera sees of a node: its organs' surfaces, ligaments and tools, as bodies that are drawn."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import Marker, MarkerArray

from tissue_sim.array_types import Floats, Longs, Singles
from tissue_sim.organ.winding import inside
from tissue_sim.rendering.appearance import INCLUSION, LIGAMENT, Colour, tissue_colour
from tissue_sim.rendering.bodies import MOST_LABEL, Look
from tissue_sim.rendering.offscreen import Offscreen
from tissue_sim.rendering.primitives import ball, cylinder, tubes
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.organ_topics import path_of

FIRST_ORGAN, LIGAMENTS, FIRST_TOOL = 1, 100, 101  # labels
STEEL = (0.62, 0.64, 0.67)
LIGAMENT_BODY = "ligaments"
SILENT_AFTER = 3.0  # s without markers, after which the tools' poses are unknown


class SeenOrgan:
    """An organ whose topics lie below a node's name, or below its own there.

    drawn: what draws it; name: its name in a scene (empty for a single organ); label: its label in a segmentation.
    """

    def __init__(self, node: Node, drawn: Offscreen, target: str, name: str, label: int) -> None:
        below = path_of(f"/{target}", name)
        self._mesh = client.NewestMessage(node, Mesh, f"{below}/mesh", client.latched_qos())
        self._surface = client.NewestMessage(node, PointCloud2, f"{below}/surface", client.stream_qos())
        self._within = client.NewestMessage(node, Mesh, f"{below}/inclusions", client.latched_qos())
        self._drawn, self._body = drawn, f"organ/{name}"
        self._look = Look(screen(tissue_colour(name)), label=min(label, LIGAMENTS - 1))
        self.name = name
        self.rest: Floats | None = None
        self._triangles: Longs = np.zeros((0, 3), dtype=np.int64)
        self._inclusions: tuple[Floats, Longs] | None = None
        self._positions: Singles | None = None  # the newest
        self._pending: tuple[Floats, Longs] | None = None  # a mesh whose positions have not come
        self.frame_id, self.stamp = "", 0  # of the newest surface; ns

    def take(self) -> bool:
        """Take what has come; return whether the surface is new."""
        if (mesh := self._mesh.take()) is not None:
            self._pending = client.mesh_arrays(mesh)
        if (within := self._within.take()) is not None:
            self._inclusions = client.mesh_arrays(within)
            self._add()
        if (surface := self._surface.take()) is None:
            return False
        positions = client.cloud_array(surface)
        if not np.isfinite(positions).all():
            return False
        # A mesh is drawn once there are positions of it: until then, those that come are of the one before.
        if self._pending is not None and positions.shape == self._pending[0].shape:
            self.rest, self._triangles = self._pending
            self._pending = None
            self._add()
        if self.rest is None or positions.shape != self.rest.shape:
            return False
        self._positions = positions
        self._drawn.move(self._body, positions)
        self.frame_id = surface.header.frame_id
        self.stamp = surface.header.stamp.sec * 1_000_000_000 + surface.header.stamp.nanosec
        return True

    def _add(self) -> None:
        """Draw the surface at rest; where a cut goes through an inclusion, its walls have the colour of that."""
        if self.rest is None:
            return
        look, fraction = self._look, np.zeros(len(self.rest))
        if self._inclusions is not None and len(self._inclusions[1]):
            vertices, triangles = self._inclusions
            look = replace(look, inner=screen(INCLUSION))
            fraction = inside(self.rest, vertices, triangles.astype(np.int32)).astype(float)
        self._drawn.add(self._body, self.rest, self._triangles, look, fraction)
        if self._positions is not None and self._positions.shape == self.rest.shape:
            self._drawn.move(self._body, self._positions)

    def remove(self) -> None:
        """Remove it from the picture, and unsubscribe."""
        for inbox in (self._mesh, self._surface, self._within):
            inbox.close()
        self._drawn.remove(self._body)


class SeenLigaments:
    """The ligaments of a node's scene, as its markers show them.

    drawn: what draws them.
    """

    def __init__(self, node: Node, drawn: Offscreen, target: str) -> None:
        self._lines = client.NewestMessage(node, MarkerArray, f"/{target}/ligaments", client.latched_qos())
        self._drawn, self._count = drawn, 0

    def take(self) -> None:
        """Take what has come."""
        message = self._lines.take()
        if message is None:
            return
        parts = [marker for marker in message.markers if marker.action == Marker.ADD]
        points = np.array([(point.x, point.y, point.z) for marker in parts for point in marker.points])
        if not len(points):
            self._drawn.remove(LIGAMENT_BODY)
            self._count = 0
            return
        vertices, triangles = tubes(points.reshape(-1, 2, 3), 0.5 * parts[0].scale.x)
        if len(vertices) != self._count:
            look = Look(screen(LIGAMENT), label=LIGAMENTS, texture=0.0)
            self._drawn.add(LIGAMENT_BODY, vertices, triangles, look)
            self._count = len(vertices)
        self._drawn.move(LIGAMENT_BODY, vertices)


class SeenTools:
    """The tools of a node, as its markers show them.

    drawn: what draws them.
    """

    def __init__(self, node: Node, drawn: Offscreen, target: str) -> None:
        self._markers = client.NewestMessage(node, MarkerArray, f"/{target}/tools", client.stream_qos())
        self._drawn = drawn
        self._names: tuple[str, ...] = ()  # of the tools, in order
        self._shapes: dict[str, tuple[float, ...]] = {}  # of each body
        self._last_message = -np.inf

    def use(self, names: Sequence[str]) -> None:
        """Use the order of the node's tools for their labels."""
        if tuple(names) != self._names:
            self._names = tuple(names)
            self._clear()

    def take(self) -> None:
        """Take what has come; tools of which no message comes any more are not drawn."""
        message, now = self._markers.take(), time.monotonic()
        if message is None:
            if now - self._last_message > SILENT_AFTER:
                self._clear()
            return
        self._last_message = now
        parts = [marker for marker in message.markers if marker.type != Marker.ARROW]
        there = {f"tool/{marker.ns}/{marker.id}" for marker in parts}
        for body in set(self._shapes) - there:
            self._remove(body)
        for marker in parts:
            self._show(f"tool/{marker.ns}/{marker.id}", marker)

    def _show(self, body: str, marker: Marker) -> None:
        shape = (marker.type, marker.scale.x, marker.scale.z, len(marker.points))
        if self._shapes.get(body) != shape:
            made = shape_of(marker)
            if made is None:
                return
            order = self._names.index(marker.ns) if marker.ns in self._names else len(self._names)
            is_flat = marker.type == Marker.TRIANGLE_LIST
            label = min(FIRST_TOOL + order, MOST_LABEL)
            self._drawn.add(body, *made, Look(STEEL, label, is_metal=True, is_flat=is_flat, texture=0.0))
            self._shapes[body] = shape
        place, turn = marker.pose.position, marker.pose.orientation
        pose = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
        self._drawn.place(body, pose if marker.action == Marker.ADD else None)

    def _remove(self, body: str) -> None:
        self._drawn.remove(body)
        del self._shapes[body]

    def _clear(self) -> None:
        for body in list(self._shapes):
            self._remove(body)


def screen(colour: Colour) -> tuple[float, float, float]:
    """Return red, green and blue of 0 to 255 as a colour of 0 to 1."""
    red, green, blue = colour
    return red / 255.0, green / 255.0, blue / 255.0


def shape_of(marker: Marker) -> tuple[Floats, Longs] | None:
    """Return vertices (n, 3) m and triangles (t, 3) of a marker; None for one that is not a body.

    marker: a sphere, a cylinder or a list of triangles.
    """
    if marker.type == Marker.SPHERE:
        return ball(0.5 * marker.scale.x)
    if marker.type == Marker.CYLINDER:
        return cylinder(0.5 * marker.scale.x, marker.scale.z)
    if marker.type == Marker.TRIANGLE_LIST and marker.points:
        points = np.array([(p.x, p.y, p.z) for p in marker.points])
        return points, np.arange(len(points)).reshape(-1, 3)
    return None
