"""What a recorded bag holds: the topics and journal rows that recorder and replay share.

Beside the messages as they were received and published, a bag holds the organ file, the settings,
the whole state after one tick, and a journal: which tick took up which input, what each contact set
was found from, and which tick each published message shows. That is all a replay needs. Arrays and records are kept
by the names of their fields (npz), so that a field more or less is noticed by name.
"""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from tissue_sim.model.records import Record
from tissue_sim.npz import read_npz

# Raised when an older replay could not read a newer bag; 1 held settings and state by position, 2 led tools without
# regard to stamps, 3 did not tell what a state had taken up, 4 not where the breath had carried the organ.
FORMAT = 5

# Topics under the node's name, with their types.
PRIVATE_TOPICS = {
    "config": "std_msgs/msg/String",  # JSON
    "organ": "std_msgs/msg/UInt8MultiArray",  # the organ file
    "state": "std_msgs/msg/UInt8MultiArray",  # npz: the fields of model.state.State
    "settings": "std_msgs/msg/UInt8MultiArray",  # npz: sequence, settings
    "contact_set": "std_msgs/msg/UInt8MultiArray",  # npz: a set found from a surface before the state
    "journal": "std_msgs/msg/UInt8MultiArray",  # npz: rows of what happened
    "mesh": "shape_msgs/msg/Mesh",
    "surface": "sensor_msgs/msg/PointCloud2",
    "skeleton": "sensor_msgs/msg/PointCloud2",
    "markers": "visualization_msgs/msg/MarkerArray",
}


class ContactRow(Record):
    """What a contact set was found from."""

    contact_set: int  # its number
    surface_tick: int  # tick of the surface


class BodyContactRow(Record):
    """The same for each of its bodies."""

    pose: int  # its number
    margin: float  # m beyond MARGIN
    engaged: bool
    pushing: bool


class WrenchRow(Record):
    """What a recorded servo_cf shows; one row for each."""

    tool: int
    tick: int


class SurfaceRow(Record):
    """What a recorded surface shows; one row for each."""

    tick: int


def pack(**arrays: NDArray) -> NDArray[np.uint8]:
    """Arrays as the bytes of an npz."""
    stream = io.BytesIO()
    np.savez(stream, **arrays)  # type: ignore[arg-type]
    return np.frombuffer(stream.getvalue(), dtype=np.uint8)


def unpack(data: NDArray[np.uint8]) -> dict[str, NDArray]:
    """Arrays from the bytes of an npz; raises ValueError when they are damaged."""
    return read_npz(io.BytesIO(np.asarray(data, dtype=np.uint8).tobytes()))
