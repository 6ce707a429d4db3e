"""What a recorded bag holds: the topics and journal rows that recorder and replay share.

Beside the messages as they were received and published, a bag holds the organ file, the settings,
the whole state after one tick, and a journal: which tick took up which input, what each contact set
was found from, and which tick each published message shows. That is all a replay needs.
"""

from __future__ import annotations

import io
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

FORMAT = 1  # raised when an older replay could not read a newer bag

# Topics under the node's name, with their types.
PRIVATE_TOPICS = {
    "config": "std_msgs/msg/String",  # JSON
    "organ": "std_msgs/msg/UInt8MultiArray",  # the organ file
    "state": "std_msgs/msg/UInt8MultiArray",  # npz: floats, integers
    "settings": "std_msgs/msg/Float64MultiArray",  # sequence, settings
    "contact_set": "std_msgs/msg/UInt8MultiArray",  # npz: a set found from a surface before the state
    "journal": "std_msgs/msg/Int64MultiArray",  # rows
    "mesh": "shape_msgs/msg/Mesh",
    "surface": "sensor_msgs/msg/PointCloud2",
    "skeleton": "sensor_msgs/msg/PointCloud2",
    "markers": "visualization_msgs/msg/MarkerArray",
}


class Row(IntEnum):
    """First number of a journal row."""

    INPUT = 0  # tick, contact set, settings, resets, then pose and force of each body: what it took up
    CONTACT = 1  # contact set, surface's tick, engaged bits, pushing bits, then pose and margin (mm) per body
    WRENCH = 2  # tool, tick: one for each recorded servo_cf
    SURFACE = 3  # tick: one for each recorded surface


def row_width(n_bodies: int) -> int:
    """Numbers in a journal row; a gripper has two bodies, other tools one."""
    return 5 + 2 * n_bodies


def pack(**arrays: NDArray) -> NDArray[np.uint8]:
    """Arrays as the bytes of an npz."""
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **arrays)
    return np.frombuffer(stream.getvalue(), dtype=np.uint8)


def unpack(data: NDArray[np.uint8]) -> dict[str, NDArray]:
    """Arrays from the bytes of an npz; raises ValueError when they are damaged."""
    with np.load(io.BytesIO(np.asarray(data, dtype=np.uint8).tobytes()), allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}
