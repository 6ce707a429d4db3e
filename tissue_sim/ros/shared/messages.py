"""Messages as bytes: serialised once as a template, then patched in place and published as they are."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2, PointField

from tissue_sim.array_types import Floats, Ints
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.shared.cdr import CDR_HEADER, LITTLE_ENDIAN
from tissue_sim.ros.shared.shown_organ import ShownOrgan
from tissue_sim.ros.shared.tool_messages import WrenchMessage


class NumbersTemplate:
    """A message that ends in doubles, ready to be patched: a wrench or a pose, with or without a header.

    message: whose numbers are replaced; a Float64MultiArray has an empty layout; n_numbers: number of the doubles.
    """

    def __init__(self, message: PoseStamped | WrenchMessage, n_numbers: int, frame_id: str = "") -> None:
        self._stamped = hasattr(message, "header")
        if self._stamped:
            message.header.frame_id = frame_id
        self._bytes = bytearray(serialize_message(message))
        self._n = n_numbers
        self._body = len(self._bytes) - 8 * n_numbers

    def message(self, stamp: int, numbers: Sequence[float] | Floats) -> bytes:
        """Return the message with as many of the numbers as it holds; the rest are zero.

        stamp: its time, if it has one, ns.
        """
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
        """Return the message with the present `points`, of a time in ns."""
        struct.pack_into("<iI", self._bytes, CDR_HEADER, stamp // 1_000_000_000, stamp % 1_000_000_000)
        return bytes(self._bytes)


def rest_mesh(shown: ShownOrgan) -> bytes:
    """Return the rest surface of what is shown of an organ as a shape_msgs/Mesh."""
    return _mesh(shown.points(shown.rest), shown.triangles)


def inclusion_mesh(organ: Organ) -> bytes:
    """Return the surfaces of all inclusions at rest as one shape_msgs/Mesh."""
    return _mesh(organ.inclusion_positions, organ.inclusion_triangles)


def _mesh(positions: Floats, triangles: Ints) -> bytes:
    """Return a shape_msgs/Mesh, written as CDR: rclpy takes tens of milliseconds, in which no pose is answered."""
    corners = np.asarray(triangles, dtype="<u4").tobytes()
    counted = struct.pack("<I", len(triangles)) + corners + struct.pack("<I", len(positions))
    gap = -len(counted) % 8 if len(positions) else 0  # doubles are aligned
    return LITTLE_ENDIAN + counted + bytes(gap) + np.asarray(positions, dtype="<f8").tobytes()
