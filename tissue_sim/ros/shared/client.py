"""Shared parts of the programs beside the node: arguments, signals, a polled rclpy node, messages as arrays."""

from __future__ import annotations

import argparse
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import numpy as np

from tissue_sim.array_types import Floats, Longs, Singles
from tissue_sim.ros.shared import dds

if TYPE_CHECKING:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
    from rclpy.node import Node
    from rclpy.qos import QoSProfile
    from rclpy.subscription import Subscription
    from sensor_msgs.msg import PointCloud2
    from shape_msgs.msg import Mesh

WANTED = "expected letters, digits and _, not beginning with a digit"


# arguments -------------------------------------------------------------------------------------
def number(low: float, high: float, unit: str) -> Callable[[str], float]:
    """Return an argparse type: a number from `low` to `high`; the unit is for messages."""

    def convert(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"'{text}' is not a number ({unit})") from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} is outside {low:g}..{high:g} {unit}")
        return value

    return convert


def port_number(text: str) -> int:
    """Convert an argument to a TCP port."""
    if not text.isdecimal() or not 1 <= int(text) <= 65535:
        raise argparse.ArgumentTypeError(f"'{text}' is not a port; choose one in 1..65535")
    return int(text)


def names(text: str) -> tuple[str, ...]:
    """Convert an argument to names of tools, separated by commas."""
    found = tuple(word.strip() for word in text.split(","))
    for name in found:
        if not (name.isidentifier() and name.isascii()) or found.count(name) > 1:
            raise argparse.ArgumentTypeError(f"'{name}' in '{text}' is not a valid or unique name ({WANTED})")
    return found


def node_name(text: str) -> str:
    """Convert an argument to a node's name, with its namespace if it has one."""
    for part in text.strip("/").split("/"):
        if not (part.isidentifier() and part.isascii()):
            raise argparse.ArgumentTypeError(f"'{text}' is not a node name ({WANTED})")
    return text.strip("/")


# signals ---------------------------------------------------------------------------------------
class Stop:
    """True after SIGINT, SIGTERM or SIGHUP, while entered as a context in the main thread; polled."""

    def __init__(self) -> None:
        # A plain attribute: an Event's lock could be held by the very thread that the handler interrupts.
        self._asked = False
        self._restored = ExitStack()

    def __enter__(self) -> Stop:
        for asked_by in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            self._restored.callback(signal.signal, asked_by, signal.signal(asked_by, self._ask))
        return self

    def __exit__(self, *_: object) -> None:
        self._restored.close()

    def _ask(self, *_: object) -> None:
        self._asked = True

    def __bool__(self) -> bool:
        return self._asked


# ROS -------------------------------------------------------------------------------------------
@contextmanager
def client_node(name: str, target: str) -> Iterator[Node]:
    """Provide a node beside the node `target`, in the same namespace; rclpy is running meanwhile."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    dds.prepare()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node(
            name,
            namespace="/" + target.rpartition("/")[0],
            enable_rosout=False,
            start_parameter_services=False,
        )
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


def node_beside(node: Node, what: str) -> Node:
    """Return another node of a program, in the same namespace and with its name before `what`.

    what: end of the name.
    """
    import rclpy

    return rclpy.create_node(
        f"{node.get_name()}_{what}",
        namespace=node.get_namespace(),
        enable_rosout=False,
        start_parameter_services=False,
    )


def wait_until[Answer](ask: Callable[[], Answer], longest: float, stop: object = False) -> Answer:
    """Ask until the answer is neither None nor False, a condition is true, or time is over.

    ask: gives an answer; longest: that time, s; stop: that condition. Returns the last answer.
    """
    end = time.monotonic() + longest
    while (answer := ask()) in (None, False) and not stop and time.monotonic() < end:
        time.sleep(0.02)
    return answer


def repeat(stop: Stop, turn: Callable[[], float]) -> None:
    """Call a function periodically until a signal comes.

    stop: whether it has come; turn: the function (it returns the time, s, from the time when it was due until the next
    call).
    """
    due = time.monotonic()
    while not stop:
        period = turn()
        now = time.monotonic()
        due = max(due + period, now + 0.001)
        time.sleep(due - now)


def stream_qos() -> QoSProfile:
    """Return the QoS of poses, wrenches and surfaces."""
    from tissue_sim.ros.shared.qos import STREAM

    return STREAM


def latched_qos() -> QoSProfile:
    """Return the QoS of mesh and markers."""
    from tissue_sim.ros.shared.qos import LATCHED

    return LATCHED


class NewestMessage[Message]:
    """The newest message of a topic, fetched on request.

    No callback runs for the messages in between: a 1 kHz stream costs as little as its reader's rate.

    qos: how it is subscribed; raw: whether messages are returned as bytes.
    """

    def __init__(self, node: Node, kind: type[Message], topic: str, qos: QoSProfile, raw: bool = False) -> None:
        self._node = node
        self._subscription: Subscription = node.create_subscription(kind, topic, _unused, qos, raw=raw)

    def take(self) -> Message | None:
        """Return the newest message since the last call (bytes when raw), or None."""
        return next(reversed(self.take_all()), None)

    def take_all(self) -> list[Message]:
        """Return the messages since the last call that the topic's depth has kept, oldest first."""
        messages, subscription = [], self._subscription
        with subscription.handle:
            while (found := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
                messages.append(found[0])
        return messages

    def close(self) -> None:
        """Unsubscribe."""
        self._node.destroy_subscription(self._subscription)


def _unused(_: object) -> None:
    """Do nothing: it is never called, since nothing spins the node."""


# messages --------------------------------------------------------------------------------------
def mesh_arrays(message: Mesh) -> tuple[Floats, Longs]:
    """Return vertices (n, 3), m, and triangles (t, 3) of a mesh."""
    vertices = np.array([(p.x, p.y, p.z) for p in message.vertices], dtype=np.float64).reshape(-1, 3)
    triangles = np.array([t.vertex_indices for t in message.triangles], dtype=np.int64).reshape(-1, 3)
    return vertices, triangles


def cloud_array(message: PointCloud2) -> Singles:
    """Return the columns (n, k) of a PointCloud2 of little-endian float32 only."""
    return np.frombuffer(message.data, dtype="<f4").reshape(-1, message.point_step // 4)


def newest_status(reports: Sequence[DiagnosticArray], target: str) -> DiagnosticStatus | None:
    """Return a node's newest physics DiagnosticStatus, or None without one."""
    name = f"{target.strip('/')}: physics"
    for report in reversed(reports):
        for status in report.status:
            if status.name == name:
                return status
    return None


def physics_status(reports: Sequence[DiagnosticArray], target: str) -> dict[str, str] | None:
    """Return the values of a node's newest physics status, or None without one."""
    status = newest_status(reports, target)
    return None if status is None else {item.key: item.value for item in status.values}
