"""Stamped messages read from their bytes, without ROS."""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

CDR_HEADER = 4  # bytes before the body; alignment counts from the body


UNSTAMPED = -1  # the stamp of a message that has none


class Stamped(NamedTuple):
    """What a message of doubles says: a pose (7: m, quaternion xyzw) or a wrench (6: N, N m)."""

    stamp: int  # ns; 0: invalid; UNSTAMPED
    frame_id: str
    values: tuple[float, ...]


def parse_stamped(raw: bytes, n_values: int) -> Stamped:
    """Read a little-endian CDR message of a header and n_values doubles.

    Raises ValueError when it is cut short or of another encoding.
    """
    if len(raw) < 16 or raw[1] != 1:
        raise ValueError("no little-endian CDR message")
    seconds, nanoseconds, length = struct.unpack_from("<iII", raw, CDR_HEADER)
    start = CDR_HEADER + 12
    end = start + length
    body = CDR_HEADER + (end - CDR_HEADER + 7) // 8 * 8
    if body + 8 * n_values > len(raw):
        raise ValueError("the message is cut short")
    frame_id = raw[start : end - 1].decode(errors="replace")
    return Stamped(seconds * 1_000_000_000 + nanoseconds, frame_id, struct.unpack_from(f"<{n_values}d", raw, body))


def parse_plain(raw: bytes, n_values: int) -> Stamped:
    """Read a little-endian CDR message of n_values doubles without a header: a Pose or a Wrench.

    Raises ValueError when it is cut short or of another encoding.
    """
    if len(raw) < CDR_HEADER or raw[1] != 1:
        raise ValueError("no little-endian CDR message")
    if CDR_HEADER + 8 * n_values > len(raw):
        raise ValueError("the message is cut short")
    return Stamped(UNSTAMPED, "", struct.unpack_from(f"<{n_values}d", raw, CDR_HEADER))


def parse_moving(raw: bytes, n_values: int) -> Stamped:
    """Read a little-endian CDR message of a header, the name of a moving frame, and doubles: a TransformStamped or,
    of which the pose comes first, an Odometry.

    Raises ValueError when it is cut short or of another encoding.
    """
    if len(raw) < 16 or raw[1] != 1:
        raise ValueError("no little-endian CDR message")
    seconds, nanoseconds, length = struct.unpack_from("<iII", raw, CDR_HEADER)
    start = CDR_HEADER + 12
    end = start + length
    child = CDR_HEADER + (end - CDR_HEADER + 3) // 4 * 4
    if child + 4 > len(raw):
        raise ValueError("the message is cut short")
    after = child + 4 + struct.unpack_from("<I", raw, child)[0]
    body = CDR_HEADER + (after - CDR_HEADER + 7) // 8 * 8
    if body + 8 * n_values > len(raw):
        raise ValueError("the message is cut short")
    frame_id = raw[start : end - 1].decode(errors="replace")
    return Stamped(seconds * 1_000_000_000 + nanoseconds, frame_id, struct.unpack_from(f"<{n_values}d", raw, body))


def unit_pose(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pose (7,) with its quaternion scaled to length 1, in place.

    Node and replay share it, so that a pose is the same number in both. Raises ValueError for a zero
    quaternion.
    """
    norm = math.sqrt(float(pose[3:] @ pose[3:]))
    if norm < 1e-6:
        raise ValueError("its quaternion is zero; send a unit quaternion")
    pose[3:] /= norm
    return pose
