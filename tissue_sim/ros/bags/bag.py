"""Contents of a recorded bag: the topics and journal rows that recorder and replay share.

Besides the messages as they were received and published, a bag holds the organ file, the settings, the whole state
after one tick, and a journal: which tick applied which input, what each contact set was found from, and which tick each
published message shows. A replay needs nothing else. Arrays and records are kept by the names of their fields (npz), so
that an added or missing field is noticed by name.
"""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from tissue_sim.model.data.records import Record
from tissue_sim.npz import read_npz

# Raised when an older replay could not read a newer bag. Format 1 held settings and state by position; 2 moved tools
# without regard to stamps; 3 lacked what a state had applied, 4 where the breath had moved the organ, 5 what links
# require of the step, 6 whether an organ has had a fault since its last reset, 7 how far a tool may go with a contact
# set; 8 called external_cf measured_cf, and 9 had contact points between three nodes, and no cuts.
FORMAT = 10
READ = (8, 9, FORMAT)

OCTETS = "std_msgs/msg/UInt8MultiArray"
# Topics of an organ, with their types: under its name, or the node's where it is the only one.
ORGAN_TOPICS = {
    "organ": OCTETS,  # the organ file
    "state": OCTETS,  # npz: the fields of model.state.State
    "settings": OCTETS,  # npz: sequence, settings
    "contact_set": OCTETS,  # npz: a set found from a surface before the state
    "journal": OCTETS,  # npz: rows of what happened
    "cut": OCTETS,  # npz: the organ after a cut, or the first contact set found on it, see recorded_cut
    "mesh": "shape_msgs/msg/Mesh",
    "surface": "sensor_msgs/msg/PointCloud2",
    "skeleton": "sensor_msgs/msg/PointCloud2",
    "markers": "visualization_msgs/msg/MarkerArray",
}
# Under the node's name.
NODE_TOPICS = {
    "config": "std_msgs/msg/String",  # JSON
    "organ_pose": OCTETS,  # npz: the pose (7,) of the organ in base_frame, and the newest tick when it became that
}
SCENE_TOPICS = {
    "joined": OCTETS,  # npz: what joins the organs, at the tick of their states
    "organ_contact_set": OCTETS,  # npz: pairs found from a surface before the state
    "journal": OCTETS,  # npz: rows that concern all of them
}


class ContactRow(Record):
    """What a contact set was found from."""

    contact_set: int  # its number
    surface_tick: int  # tick of the surface
    tool_tick: int  # tick of the tools' places


class BodyContactRow(Record):
    """The same for each of its bodies."""

    margin: float  # m beyond MARGIN
    engaged: int  # Engaged
    pushing: bool


class PairRow(Record):
    """What pairs of organs were found from; beside it stands the tick of each organ's surface."""

    pairs: int  # their number


class PairSurfaceRow(Record):
    """Surface of an organ after a cut, or after the reset of its cuts, on which pairs of organs were found."""

    organ: int
    number: int  # of the cut
    pairs: int  # number of the first pairs on it


class RespirationRow(Record):
    """Where the breath was to be."""

    respiration: int  # its number
    share: float  # fraction of the displacement; the name that bags have


class WrenchRow(Record):
    """What a recorded servo_cf shows; one row for each."""

    tool: int
    tick: int


class SurfaceRow(Record):
    """What a recorded surface shows; one row for each."""

    tick: int


def pack(**arrays: NDArray) -> NDArray[np.uint8]:
    """Return arrays, by name, as the bytes of an npz."""
    stream = io.BytesIO()
    np.savez(stream, **arrays)  # type: ignore[arg-type]
    return np.frombuffer(stream.getvalue(), dtype=np.uint8)


def unpack(data: NDArray[np.uint8]) -> dict[str, NDArray]:
    """Return the arrays from the bytes of an npz. Raises ValueError when they are damaged."""
    return read_npz(io.BytesIO(np.asarray(data, dtype=np.uint8).tobytes()))
