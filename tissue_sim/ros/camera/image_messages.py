"""Images as bytes: the messages of a camera, of which only stamp and pixels change from picture to picture."""

from __future__ import annotations

import io
import struct

import numpy as np
from PIL import Image as Pillow
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from tissue_sim.array_types import Array, Pixels
from tissue_sim.rendering.pinhole import Pinhole
from tissue_sim.ros.shared.cdr import CDR_HEADER

COLOUR, DEPTH, LABELS = "rgb8", "32FC1", "mono8"  # encodings
BYTES_A_PIXEL = {COLOUR: 3, DEPTH: 4, LABELS: 1}
JPEG = "rgb8; jpeg compressed bgr8"  # as image_transport names colours that were compressed


class ImageTemplate:
    """A sensor_msgs/Image of one size and encoding.

    lens: the camera, for the size; encoding: COLOUR, DEPTH or LABELS.
    """

    def __init__(self, frame_id: str, lens: Pinhole, encoding: str) -> None:
        step = lens.width * BYTES_A_PIXEL[encoding]
        message = Image(height=lens.height, width=lens.width, encoding=encoding, is_bigendian=0, step=step)
        message.header.frame_id = frame_id
        self._head, self._size = _before_octets(message), lens.height * step

    def message(self, stamp: int, pixels: Array) -> bytes:
        """Return the message.

        stamp: its time, ns; pixels (height, width) or (height, width, 3): its pixels, of the encoding's type. Raises
        ValueError for pixels of another size.
        """
        octets = np.ascontiguousarray(pixels).view(np.uint8).data
        if octets.nbytes != self._size:
            raise ValueError(f"{octets.nbytes} bytes of pixels; expected: {self._size}")
        return _stamped(self._head, stamp, octets)


class JpegTemplate:
    """A sensor_msgs/CompressedImage of colours. quality: quality of the JPEG, 1 to 100."""

    def __init__(self, frame_id: str, quality: int) -> None:
        message = CompressedImage(format=JPEG)
        message.header.frame_id = frame_id
        self._head, self._quality = _before_octets(message), quality

    def message(self, stamp: int, colours: Pixels) -> bytes:
        """Return the message of colours (height, width, 3); stamp in ns."""
        file = io.BytesIO()
        Pillow.fromarray(colours).save(file, format="JPEG", quality=self._quality)
        return _stamped(self._head, stamp, file.getbuffer())


class InfoTemplate:
    """A sensor_msgs/CameraInfo.

    frame_id: its frame (of a stereo pair that of the left camera); lens: the camera; baseline: how far right of the
    left camera it is, m.
    """

    def __init__(self, frame_id: str, lens: Pinhole, baseline: float = 0.0) -> None:
        message = CameraInfo(height=lens.height, width=lens.width, distortion_model="plumb_bob", d=[0.0] * 5)
        message.header.frame_id = frame_id
        message.k, message.r = lens.matrix.ravel(), np.eye(3).ravel()
        message.p = np.column_stack([lens.matrix, [-lens.fx * baseline, 0.0, 0.0]]).ravel()
        self._bytes = bytearray(serialize_message(message))

    def message(self, stamp: int) -> bytes:
        """Return the message; stamp in ns."""
        _stamp(self._bytes, stamp)
        return bytes(self._bytes)


def _before_octets(message: Image | CompressedImage) -> bytearray:
    """Return the bytes of a message up to the octets that end it, and to their number."""
    marked = b"\x5e\xed\xf0\x0d" * 4
    message.data = marked
    raw = bytes(serialize_message(message))
    return bytearray(raw[: raw.index(struct.pack("<I", len(marked)) + marked)])


def _stamped(head: bytearray, stamp: int, octets: memoryview) -> bytes:
    """Return a message from its first bytes, a time, ns, and the octets that end it."""
    _stamp(head, stamp)
    return b"".join((head, struct.pack("<I", octets.nbytes), octets))


def _stamp(message: bytearray, stamp: int) -> None:
    struct.pack_into("<iI", message, CDR_HEADER, stamp // 1_000_000_000, stamp % 1_000_000_000)
