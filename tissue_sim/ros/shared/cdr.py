"""Reading of stamped messages from their bytes, without ROS.

Every `parse_` function raises ValueError for a message that is cut short or of another encoding.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

CDR_HEADER = 4  # bytes before the body; alignment counts from the body
LITTLE_ENDIAN = b"\x00\x01\x00\x00"  # such a header, of plain CDR
FARTHEST, HARDEST = 100.0, 1e6  # m and N: larger values are in another unit


UNSTAMPED = -1  # the stamp of a message that has none


class Stamped(NamedTuple):
    """Contents of a message of doubles: a pose (7: m, quaternion xyzw) or a wrench (6: N, N m)."""

    stamp: int  # ns; 0: invalid; UNSTAMPED
    frame_id: str
    values: tuple[float, ...]


def parse_stamped(raw: bytes, n_values: int) -> Stamped:
    """Read a little-endian CDR message of a header and doubles."""
    stamp, frame_id, end = _header(raw)
    return Stamped(stamp, frame_id, _doubles(raw, end, n_values))


def parse_plain(raw: bytes, n_values: int) -> Stamped:
    """Read a little-endian CDR message of doubles without a header: a Pose or a Wrench."""
    _check_encoding(raw, CDR_HEADER)
    return Stamped(UNSTAMPED, "", _doubles(raw, CDR_HEADER, n_values))


def parse_moving(raw: bytes, n_values: int) -> Stamped:
    """Read a little-endian CDR message of a header, the name of a moving frame, and doubles.

    It is a TransformStamped or an Odometry, in which the pose comes first.
    """
    stamp, frame_id, end = _header(raw)
    child = _aligned(end, 4)
    if child + 4 > len(raw):
        raise ValueError("the message is truncated")
    return Stamped(stamp, frame_id, _doubles(raw, child + 4 + struct.unpack_from("<I", raw, child)[0], n_values))


def parse_octets(raw: bytes) -> NDArray[np.uint8]:
    """Return the data of a UInt8MultiArray without dimensions."""
    return np.frombuffer(raw, dtype=np.uint8, count=_counted(raw, CDR_HEADER + 8), offset=CDR_HEADER + 12)


def parse_number(raw: bytes) -> float:
    """Return the first number of a Float64MultiArray without dimensions."""
    _counted(raw, CDR_HEADER + 8, 8)
    return _doubles(raw, CDR_HEADER + 12, 1)[0]


def parse_text(raw: bytes) -> str:
    """Return the text of a String."""
    length = _counted(raw, CDR_HEADER)
    return raw[CDR_HEADER + 4 : CDR_HEADER + 3 + length].decode()


def parse_cloud(raw: bytes) -> NDArray[np.float32]:
    """Return the columns (n, k) of a PointCloud2 of little-endian float32 only."""
    *_, at = _header(raw)
    at = _aligned(at, 4) + 8  # height, width
    n_fields = _counted(raw, at, 0)
    at += 4
    for _ in range(n_fields):
        at = _aligned(at, 4)
        at = _aligned(at + 4 + _counted(raw, at), 4) + 12  # name; offset, type, count
    at = _aligned(at + 1, 4)  # is_bigendian
    columns, length = _counted(raw, at, 0) // 4, _counted(raw, at + 8)
    return np.frombuffer(raw, dtype="<f4", count=length // 4, offset=at + 12).reshape(-1, columns)


def _counted(raw: bytes, at: int, size: int = 1) -> int:
    """Return the number of items of so many bytes each that follow it."""
    _check_encoding(raw, at + 4)
    count = int(struct.unpack_from("<I", raw, at)[0])
    if at + 4 + size * count > len(raw):
        raise ValueError("the message is truncated")
    return count


def _check_encoding(raw: bytes, least: int) -> None:
    if len(raw) < least or raw[1] != 1:
        raise ValueError("the message is not little-endian CDR")


def _header(raw: bytes) -> tuple[int, str, int]:
    """Return stamp, ns, and frame of a message's header, and where it ends."""
    _check_encoding(raw, CDR_HEADER + 12)
    seconds, nanoseconds, length = struct.unpack_from("<iII", raw, CDR_HEADER)
    if seconds < 0:
        raise ValueError("its stamp is before 1970")
    start = CDR_HEADER + 12
    end = start + length
    return seconds * 1_000_000_000 + nanoseconds, raw[start : end - 1].decode(errors="replace"), end


def _aligned(at: int, size: int) -> int:
    """Return where the next value of so many bytes lies."""
    return CDR_HEADER + (at - CDR_HEADER + size - 1) // size * size


def _doubles(raw: bytes, at: int, count: int) -> tuple[float, ...]:
    body = _aligned(at, 8)
    if body + 8 * count > len(raw):
        raise ValueError("the message is truncated")
    return struct.unpack_from(f"<{count}d", raw, body)


def check_position(position: NDArray[np.float64]) -> None:
    """Check that a position is in metres.

    position (3,) m. Raises ValueError when it is in another unit, or not a number.
    """
    distances = [abs(along) for along in position.tolist()]  # three numbers take NumPy longer than Python
    if not all(along <= FARTHEST for along in distances):
        raise ValueError(f"its position is {max(distances):.3g} m away; positions are in metres")


def check_force(force: NDArray[np.float64]) -> None:
    """Check that a force (3,) is in newtons. Raises ValueError when it is in another unit, or not a number."""
    if not (hardest := float(np.abs(force).max())) <= HARDEST:
        raise ValueError(f"its force is {hardest:.3g} N; forces are in newtons")


class BadQuaternion(ValueError):
    """A quaternion that is not a rotation.

    counted: what it is counted as.
    """

    def __init__(self, counted: str, what: str) -> None:
        super().__init__(f"its quaternion is {what}; send a unit quaternion")
        self.counted = counted


def unit_pose(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scale a pose's quaternion to length 1, in place, and return the pose.

    Node and replay share it, so that a pose is the same number in both.

    pose (7,) m and quaternion xyzw: the pose (updated). Raises BadQuaternion when the quaternion is zero or not finite,
    or its length exceeds all numbers.
    """
    x, y, z, w = pose[3:].tolist()
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not 1e-6 <= norm < math.inf:
        if norm < 1e-6:
            raise BadQuaternion("zero_quaternion", "zero")
        if all(map(math.isfinite, (x, y, z, w))):
            raise BadQuaternion("large_quaternion", "too large")
        raise BadQuaternion("nan_pose", "not finite")
    pose[3:] = x / norm, y / norm, z / norm, w / norm
    return pose
