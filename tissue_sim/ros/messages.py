"""Messages as bytes: typed once as a template, then patched in place and published as they are."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2, PointField
from shape_msgs.msg import Mesh, MeshTriangle
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from tissue_sim.model.state import Floats
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.cdr import CDR_HEADER
from tissue_sim.ros.colours import TISSUE

SENTINEL = 1.2345678901234567e89
COLOUR_SENTINEL = 1.2345e30
FORCE_COLOUR = (0.20, 0.55, 0.95, 1.0)
ARROW_LENGTH = 0.03  # m for 1 N
LEAST_FORCE = 1e-4  # N that gets an arrow


class NumbersTemplate:
    """A message that ends in doubles, ready to be patched: a wrench or a pose, with or without a header.

    message: a PoseStamped, WrenchStamped, Wrench or Float64MultiArray (empty layout), its numbers to be replaced.
    """

    def __init__(self, message: Any, n_numbers: int, frame_id: str = "") -> None:
        self._stamped = hasattr(message, "header")
        if self._stamped:
            message.header.frame_id = frame_id
        self._bytes = bytearray(serialize_message(message))
        self._n = n_numbers
        self._body = len(self._bytes) - 8 * n_numbers

    def message(self, stamp: int, numbers: Sequence[float] | Floats) -> bytes:
        """The message with a stamp in ns, if it has one, and as many of the numbers as it holds; the rest are zero."""
        if self._stamped:
            struct.pack_into("<iI", self._bytes, CDR_HEADER, stamp // 1_000_000_000, stamp % 1_000_000_000)
        n = min(self._n, len(numbers))
        struct.pack_into(f"<{n}d", self._bytes, self._body, *numbers[:n])
        return bytes(self._bytes)


class CloudTemplate:
    """A PointCloud2 of float32 columns, ready to be patched."""

    def __init__(self, frame_id: str, n_points: int, columns: tuple[str, ...]) -> None:
        message = PointCloud2()
        message.header.frame_id = frame_id
        message.height, message.width = 1, n_points
        message.fields = [
            PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
            for index, name in enumerate(columns)
        ]
        message.point_step = 4 * len(columns)
        message.row_step = message.point_step * n_points
        message.is_dense = True
        block = np.zeros((n_points, len(columns)), dtype="<f4")
        block.reshape(-1)[:1] = 1.2345e30
        message.data = block.tobytes()
        self._bytes = bytearray(serialize_message(message))
        start = self._bytes.find(block.tobytes())
        self.points = np.frombuffer(self._bytes, dtype="<f4", offset=start, count=block.size).reshape(block.shape)

    def message(self, stamp: int) -> bytes:
        """The message as `points` stand, with a stamp in ns."""
        struct.pack_into("<iI", self._bytes, CDR_HEADER, stamp // 1_000_000_000, stamp % 1_000_000_000)
        return bytes(self._bytes)


class MarkerBytes:
    """A MarkerArray as bytes whose stamps, actions, poses, points and colours are written in place.

    markers keep their kinds and numbers of points and colours; of marker i, poses[i] (7,) are m and a quaternion xyzw,
    points[i] (k, 3) m and colours[i] (c, 4) red, green, blue, alpha.
    """

    def __init__(self, markers: Sequence[Marker]) -> None:
        given = [np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 3) for marker in markers]
        for index, marker in enumerate(markers):
            marker.header.stamp = Time(sec=0x5EED, nanosec=0x5EED0000 + index)
            marker.action = 0x5EED000
            marker.pose.position.x, marker.pose.orientation.w = SENTINEL, 1.0
            if marker.points:
                marker.points = [Point(x=SENTINEL), *marker.points[1:]]
            if marker.colors:
                marker.colors = [ColorRGBA(r=COLOUR_SENTINEL), *marker.colors[1:]]
        raw = serialize_message(MarkerArray(markers=list(markers)))
        self._bytes = _aligned(raw)
        self._stamps: list[int] = []
        self._actions: list[int] = []
        self.poses, self.points, self.colours = [], [], []
        at = 0
        for index, marker in enumerate(markers):
            n_points, n_colours = len(marker.points), len(marker.colors)
            at = raw.find(struct.pack("<iI", 0x5EED, 0x5EED0000 + index), at)
            self._stamps.append(at)
            at = raw.find(struct.pack("<i", 0x5EED000), at)
            self._actions.append(at)
            at = raw.find(struct.pack("<d", SENTINEL), at)
            self.poses.append(self._bytes[at : at + 56].view("<f8"))
            self.poses[-1][0] = 0.0
            at += 56
            if n_points:
                at = raw.find(struct.pack("<d", SENTINEL), at)
            self.points.append(self._bytes[at : at + 24 * n_points].view("<f8").reshape(n_points, 3))
            self.points[-1][:] = given[index]
            at += 24 * n_points
            if n_colours:
                at = raw.find(struct.pack("<f", COLOUR_SENTINEL), at)
            self.colours.append(self._bytes[at : at + 16 * n_colours].view("<f4").reshape(n_colours, 4))
            at += 16 * n_colours
            self.show(index, True)

    def stamp(self, stamp: int) -> None:
        """Set the stamp of every marker, ns."""
        for at in self._stamps:
            struct.pack_into("<iI", self._bytes, at, stamp // 1_000_000_000, stamp % 1_000_000_000)

    def show(self, index: int, is_shown: bool) -> None:
        """Add a marker, or delete it."""
        struct.pack_into("<i", self._bytes, self._actions[index], Marker.ADD if is_shown else Marker.DELETE)

    def message(self) -> bytes:
        """The message as it stands."""
        return self._bytes.tobytes()

    def deletion(self) -> bytes:
        """The same markers, all deleted: for the shutdown."""
        for index in range(len(self._actions)):
            self.show(index, False)
        return self.message()


class MarkersTemplate:
    """The MarkerArray of a scene: surface, skeleton and an arrow for each tool's contact force.

    Coloured, the surface has a colour for each corner of a triangle, which makes the message two thirds longer.
    """

    SURFACE_COLOUR = (*(part / 255.0 for part in TISSUE), 1.0)
    SKELETON_COLOUR = (0.95, 0.90, 0.55, 1.0)

    def __init__(self, frame_id: str, organ: Organ, n_tools: int, coloured: bool = False) -> None:
        self._corners = organ.surface_triangles.ravel()
        self._bones = skeleton_lines(organ)
        surface = empty_marker(frame_id, "surface", 0, Marker.TRIANGLE_LIST, self.SURFACE_COLOUR, (1.0, 1.0, 1.0))
        skeleton = empty_marker(frame_id, "skeleton", 0, Marker.LINE_LIST, self.SKELETON_COLOUR, (0.001, 0.0, 0.0))
        surface.points = [Point()] * len(self._corners)
        skeleton.points = [Point()] * len(self._bones)
        if coloured:
            surface.colors = [ColorRGBA()] * len(self._corners)
        arrows = [force_arrow(frame_id, "contacts", tool) for tool in range(n_tools)]
        # A marker with an empty list is refused by RViz: an organ without bones has no skeleton.
        markers = [surface, *([skeleton] if len(self._bones) else []), *arrows]
        self._arrows = range(len(markers) - n_tools, len(markers))
        self._bytes = MarkerBytes(markers)

    def message(
        self, stamp: int, position: Floats, n_surface: int, centre: Floats, wrench: Floats, colours: Any = None
    ) -> bytes:
        """The message for positions (n, 3) m.

        centre (T, 3) m where each tool touches, wrench (T, 6) what it feels; a tool without force
        has its arrow deleted. colours (n_surface, 4): red, green, blue, alpha of the nodes, where it is coloured.
        """
        template = self._bytes
        template.stamp(stamp)
        # mode: with the default one numpy takes into a buffer of its own first.
        np.take(position, self._corners, axis=0, out=template.points[0], mode="clip")
        if len(template.colours[0]):
            np.take(colours, self._corners, axis=0, out=template.colours[0], mode="clip")
        if len(self._bones):
            np.take(position[n_surface:], self._bones, axis=0, out=template.points[1], mode="clip")
        for index, start, force in zip(self._arrows, centre, wrench[:, :3], strict=True):
            draw_force(template, index, start, force)
        return template.message()

    def deletion(self) -> bytes:
        """The same markers, all deleted: for the shutdown."""
        return self._bytes.deletion()


def force_arrow(frame_id: str, namespace: str, number: int) -> Marker:
    """The arrow of a force, its points to be written by draw_force."""
    marker = empty_marker(frame_id, namespace, number, Marker.ARROW, FORCE_COLOUR, (0.002, 0.004, 0.006))
    marker.points = [Point(), Point()]
    return marker


def draw_force(markers: MarkerBytes, index: int, start: Floats, force: Floats) -> None:
    """Let an arrow start at (3,) m and show a force (3,) N; without a force it is deleted."""
    markers.show(index, float(force @ force) > LEAST_FORCE**2)
    markers.points[index][0] = start
    markers.points[index][1] = start + ARROW_LENGTH * force


def _aligned(raw: bytes) -> NDArray[np.uint8]:
    """A message's bytes in memory whose float64 lie where the processor wants them: CDR aligns behind its header."""
    room = np.empty(len(raw) + 8, dtype=np.uint8)
    start = (-CDR_HEADER - room.ctypes.data) % 8
    aligned = room[start : start + len(raw)]
    aligned[:] = np.frombuffer(raw, dtype=np.uint8)
    return aligned


def skeleton_lines(organ: Organ) -> Any:
    """Atom indices (2 b,) of the skeleton's line list: each atom and its parent."""
    child = np.flatnonzero(organ.atom_parent >= 0)
    return np.stack([child, organ.atom_parent[child]], axis=1).ravel()


def rest_mesh(organ: Organ) -> bytes:
    """The rest surface as a shape_msgs/Mesh."""
    message = Mesh(
        triangles=[MeshTriangle(vertex_indices=row) for row in organ.surface_triangles.astype(np.uint32)],
        vertices=[Point(x=float(x), y=float(y), z=float(z)) for x, y, z in organ.surface_positions],
    )
    return bytes(serialize_message(message))


def empty_marker(
    frame_id: str, namespace: str, number: int, kind: int, colour: tuple[float, ...], scale: tuple[float, ...]
) -> Marker:
    """A marker without points: a colour red, green, blue, alpha, a scale (3,) as its kind has it."""
    marker = Marker()
    marker.header.frame_id = frame_id
    marker.ns, marker.id, marker.type = namespace, number, kind
    marker.pose = Pose()
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = scale
    red, green, blue, alpha = colour
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    return marker
