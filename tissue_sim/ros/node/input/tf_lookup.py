"""Frames looked up in tf, where tf2_ros is installed (apt)."""

from __future__ import annotations

import time

from rclpy.node import Node
from rclpy.time import Time

from tissue_sim.errors import shown
from tissue_sim.ros.shared.frames import Transform, UnknownFrame

try:
    import tf2_ros
except ImportError:  # the PyPI wheels have none
    tf2_ros = None

KEPT = 0.01  # s that an answer is reused; tf is published less often


def tf_installed() -> bool:
    """Return whether frames can be looked up."""
    return tf2_ros is not None


class TfLookup:
    """Lookup of frames against one target; call it from the executor's thread only.

    It listens to /tf only after the first question, since that costs time.
    """

    def __init__(self, node: Node, target: str) -> None:
        self._node, self.target = node, target
        self._buffer: tf2_ros.Buffer | None = None
        self._listener: tf2_ros.TransformListener | None = None
        self._answers: dict[str, tuple[float, Transform]] = {}

    def __call__(self, frame_id: str) -> Transform:
        """Return the newest transform from a frame to the target; raise UnknownFrame with tf's reason."""
        now = time.monotonic()
        asked, answer = self._answers.get(frame_id, (-KEPT, None))
        if answer is not None and now - asked < KEPT:
            return answer
        _, answer = self.newest(frame_id)
        self._answers[frame_id] = (now, answer)
        return answer

    def newest(self, frame_id: str) -> tuple[int, Transform]:
        """Return the stamp, ns, and the newest transform from a frame to the target; raise UnknownFrame as above.

        The stamp is 0 where all transforms between them are static.
        """
        if self._buffer is None:
            self._buffer = tf2_ros.Buffer()
            self._listener = tf2_ros.TransformListener(self._buffer, self._node)
        try:
            found = self._buffer.lookup_transform(self.target, frame_id, Time())
        except tf2_ros.TransformException as error:
            raise UnknownFrame(f"tf has no transform from it to '{self.target}' ({shown(str(error), 200)})") from None
        offset, turn, stamp = found.transform.translation, found.transform.rotation, found.header.stamp
        try:
            answer = Transform.of_pose((offset.x, offset.y, offset.z, turn.x, turn.y, turn.z, turn.w))
        except ValueError as error:
            raise UnknownFrame(f"tf's transform to '{self.target}' {error}") from None
        return 1_000_000_000 * stamp.sec + stamp.nanosec, answer
