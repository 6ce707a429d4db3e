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


class MarkersTemplate:
    """The MarkerArray of a scene: surface, skeleton and an arrow for each tool's contact force.

    Coloured, the surface has a colour for each corner of a triangle, which makes the message two thirds longer.
    """

    SURFACE_COLOUR = (*(part / 255.0 for part in TISSUE), 1.0)
    SKELETON_COLOUR = (0.95, 0.90, 0.55, 1.0)
    FORCE_COLOUR = (0.20, 0.55, 0.95, 1.0)
    ARROW_LENGTH = 0.03  # m for 1 N

    def __init__(self, frame_id: str, organ: Organ, n_tools: int, coloured: bool = False) -> None:
        self._corners = organ.surface_triangles.ravel()
        self._bones = skeleton_lines(organ)
        self._n_tools = n_tools
        surface = _marker(frame_id, "surface", 0, Marker.TRIANGLE_LIST, self.SURFACE_COLOUR, (1.0, 1.0, 1.0))
        skeleton = _marker(frame_id, "skeleton", 0, Marker.LINE_LIST, self.SKELETON_COLOUR, (0.001, 0.0, 0.0))
        arrows = [
            _marker(frame_id, "contacts", tool, Marker.ARROW, self.FORCE_COLOUR, (0.002, 0.004, 0.006))
            for tool in range(n_tools)
        ]
        # A marker with an empty list is refused by RViz: an organ without bones has no skeleton.
        markers = [surface, *([skeleton] if len(self._bones) else []), *arrows]
        sizes = [len(self._corners), *([len(self._bones)] if len(self._bones) else []), *([2] * n_tools)]
        for index, (marker, size) in enumerate(zip(markers, sizes, strict=True)):
            marker.points = [Point(x=SENTINEL), *([Point()] * (size - 1))]
            marker.header.stamp = Time(sec=0x5EED, nanosec=0x5EED0000 + index)
            marker.action = 0x5EED000
        if coloured:
            surface.colors = [ColorRGBA(r=COLOUR_SENTINEL), *([ColorRGBA()] * (len(self._corners) - 1))]
        raw = serialize_message(MarkerArray(markers=markers))
        self._bytes = _aligned(raw)
        self._stamps, self._actions, self._blocks = [], [], []
        self._colours: Any = None
        at = 0
        for index, size in enumerate(sizes):
            at = raw.find(struct.pack("<iI", 0x5EED, 0x5EED0000 + index), at)
            self._stamps.append(at)
            at = raw.find(struct.pack("<i", 0x5EED000), at)
            self._actions.append(at)
            at = raw.find(struct.pack("<d", SENTINEL), at)
            self._blocks.append(self._bytes[at : at + 24 * size].view("<f8").reshape(size, 3))
            at += 24 * size
            if coloured and index == 0:
                at = raw.find(struct.pack("<f", COLOUR_SENTINEL), at)
                self._colours = self._bytes[at : at + 16 * size].view("<f4").reshape(size, 4)
            struct.pack_into("<i", self._bytes, self._actions[-1], Marker.ADD)

    def message(
        self, stamp: int, position: Floats, n_surface: int, centre: Floats, wrench: Floats, colours: Any = None
    ) -> bytes:
        """The message for positions (n, 3) m.

        centre (T, 3) m where each tool touches, wrench (T, 6) what it feels; a tool without force
        has its arrow deleted. colours (n_surface, 4): red, green, blue, alpha of the nodes, where it is coloured.
        """
        for at in self._stamps:
            struct.pack_into("<iI", self._bytes, at, stamp // 1_000_000_000, stamp % 1_000_000_000)
        # mode: with the default one numpy takes into a buffer of its own first.
        np.take(position, self._corners, axis=0, out=self._blocks[0], mode="clip")
        if self._colours is not None:
            np.take(colours, self._corners, axis=0, out=self._colours, mode="clip")
        if len(self._bones):
            np.take(position[n_surface:], self._bones, axis=0, out=self._blocks[1], mode="clip")
        for tool in range(self._n_tools):
            index = len(self._blocks) - self._n_tools + tool
            force = wrench[tool, :3]
            felt = float(force @ force) > 1e-8
            struct.pack_into("<i", self._bytes, self._actions[index], Marker.ADD if felt else Marker.DELETE)
            self._blocks[index][0] = centre[tool]
            self._blocks[index][1] = centre[tool] + self.ARROW_LENGTH * force
        return self._bytes.tobytes()

    def deletion(self) -> bytes:
        """The same markers, all deleted: for the shutdown."""
        for at in self._actions:
            struct.pack_into("<i", self._bytes, at, Marker.DELETE)
        return self._bytes.tobytes()


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


def _marker(
    frame_id: str, namespace: str, number: int, kind: int, colour: tuple[float, ...], scale: tuple[float, ...]
) -> Marker:
    marker = Marker()
    marker.header.frame_id = frame_id
    marker.ns, marker.id, marker.type = namespace, number, kind
    marker.pose = Pose()
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = scale
    red, green, blue, alpha = colour
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    return marker
