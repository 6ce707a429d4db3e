"""One tool's topics: poses and forces in, checked; the wrench out."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from tissue_sim.model import state as st
from tissue_sim.model.state import Floats
from tissue_sim.ros.cdr import Stamped, parse_stamped, unit_pose
from tissue_sim.ros.messages import WrenchTemplate
from tissue_sim.ros.physics import Physics
from tissue_sim.ros.recorder import Recorder

FARTHEST = 100.0  # m: a pose beyond it is in another unit
WARN_EVERY = 5.0  # s between two lines about the same kind of bad input


class Refused(Exception):
    """Input that is not taken up: a short name for the counter, and the line for the user."""

    def __init__(self, name: str, line: str) -> None:
        super().__init__(line)
        self.name = name


class ToolPort:
    """Subscribes a tool's measured_cp and measured_cf, publishes its servo_cf.

    A wrench goes out for each pose that arrives, from the callback itself; `keep_publishing` goes on
    at the tick rate when poses stop, until the wrench is zero.
    """

    def __init__(
        self,
        node: Node,
        index: int,
        name: str,
        frame_id: str,
        topics: dict[str, str],
        reliable: bool,
        physics: Physics,
        recorder: Callable[[], Recorder],
        woken: threading.Event,
    ) -> None:
        self.index, self.name, self.frame_id = index, name, frame_id
        self.refused: Counter[str] = Counter()
        self.poses = self.forces = 0
        # Sequence, pose (7,) and bytes of the newest pose, replaced as one so that they belong together.
        self.newest: tuple[int, Floats, bytes] = (0, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), b"")
        self.newest_force: tuple[int, bytes] = (0, b"")
        self.pose_clock = -math.inf  # monotonic s of the newest accepted pose
        self.force_clock = -math.inf
        self.force = 0.0  # N, magnitude last published
        self._log, self._clock = node.get_logger(), node.get_clock()
        self._physics, self._recorder, self._woken = physics, recorder, woken
        self._pose_stamp = self._force_stamp = 0
        self._warned: dict[str, float] = {}
        self._template = WrenchTemplate(frame_id)
        self._lock = threading.Lock()
        self._published = -math.inf
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=1,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.VOLATILE,
        )
        self._servo = node.create_publisher(WrenchStamped, topics["servo_cf"], qos)
        self._subscriptions = [
            node.create_subscription(PoseStamped, topics["measured_cp"], self._on_pose, qos, raw=True),
            node.create_subscription(WrenchStamped, topics["measured_cf"], self._on_force, qos, raw=True),
        ]
        self.names = {"servo_cf": self._servo.topic_name} | {
            topic: subscription.topic_name
            for topic, subscription in zip(("measured_cp", "measured_cf"), self._subscriptions, strict=True)
        }

    # in ----------------------------------------------------------------------------------------
    def _on_pose(self, raw: bytes) -> None:
        settings = self._physics.settings()
        fresh_for = settings[st.STALE_TIME] + settings[st.RAMP_TIME]
        now = time.monotonic()
        try:
            message = self._read(raw, 7, "pose", self._pose_stamp if now - self.pose_clock < fresh_for else 0)
            try:
                pose = unit_pose(np.array(message.values))
            except ValueError as error:
                raise Refused("zero_quaternion", str(error)) from None
            if np.abs(pose[:3]).max() > FARTHEST:
                raise Refused("far_pose", f"it lies {np.abs(pose[:3]).max():.3g} m away; positions are in metres")
        except Refused as refused:
            self._refuse("pose", refused)
            return
        self._pose_stamp = message.stamp
        self.newest = (self._physics.post_pose(self.index, pose), pose, raw)
        self.pose_clock = now
        self.poses += 1
        self._recorder().received(self.names["measured_cp"], raw)
        self._publish()
        self._woken.set()

    def _on_force(self, raw: bytes) -> None:
        settings = self._physics.settings()
        fresh_for = settings[st.STALE_TIME] + settings[st.RAMP_TIME]
        now = time.monotonic()
        try:
            message = self._read(raw, 6, "force", self._force_stamp if now - self.force_clock < fresh_for else 0)
        except Refused as refused:
            self._refuse("force", refused)
            return
        self._force_stamp, self.force_clock = message.stamp, now
        self.newest_force = (self._physics.post_force(self.index, np.array(message.values[:3])), raw)
        self.forces += 1
        self._recorder().received(self.names["measured_cf"], raw)
        self._woken.set()

    def _read(self, raw: bytes, n_values: int, what: str, last_stamp: int) -> Stamped:
        try:
            message = parse_stamped(raw, n_values)
        except ValueError as error:
            raise Refused("malformed", f"{error}") from None
        if not all(map(math.isfinite, message.values)):
            raise Refused(f"nan_{what}", "it holds a value that is not finite")
        if message.frame_id != self.frame_id:
            raise Refused(
                "unknown_frame",
                f"its frame is '{message.frame_id}', expected '{self.frame_id}'"
                f" (parameter {self.name}.frame_id names another)",
            )
        if message.stamp == 0:
            raise Refused("no_stamp", "its stamp is 0, which marks invalid data")
        if message.stamp < last_stamp:
            raise Refused(
                "backward_stamp", f"its stamp is {1e-9 * (last_stamp - message.stamp):.3f} s before the last one"
            )
        return message

    def _refuse(self, what: str, refused: Refused) -> None:
        self.refused[refused.name] += 1
        now = time.monotonic()
        if now - self._warned.get(refused.name, -math.inf) > WARN_EVERY:
            self._warned[refused.name] = now
            self._log.warning(f"tool '{self.name}': {what} refused: {refused}")

    def forget_stamps(self) -> None:
        """Time has jumped back: the next stamps may be earlier than the last ones."""
        self._pose_stamp = self._force_stamp = 0

    # out ---------------------------------------------------------------------------------------
    def _publish(self) -> None:
        with self._lock:
            tick, wrenches = self._physics.wrenches()
            self._send(tick, wrenches[self.index])

    def _send(self, tick: int, wrench: Floats) -> None:
        if not np.all(np.isfinite(wrench)):  # never seen, and never to be felt
            wrench = np.zeros(6)
            self.refused["nan_wrench"] += 1
        raw = self._template.message(self._clock.now().nanoseconds, wrench)
        self._servo.publish(raw)
        self.force = math.sqrt(float(wrench[:3] @ wrench[:3]))
        self._published = time.monotonic()
        self._recorder().wrench(self.names["servo_cf"], self.index, tick, raw)

    def keep_publishing(self, silence: float) -> bool:
        """Publish the newest wrench if nothing went out for `silence` s and the last one wasn't zero.

        Returns True while there is something left to fade.
        """
        with self._lock:
            if self.force == 0.0:
                return False
            if time.monotonic() - self._published >= silence:
                tick, wrenches = self._physics.wrenches()
                self._send(tick, wrenches[self.index])
            return self.force != 0.0

    def publish_zero(self) -> None:
        """A last wrench of zero, for the shutdown."""
        with self._lock:
            self._send(-1, np.zeros(6))

    # state -------------------------------------------------------------------------------------
    def state(self, settings: Floats, engaged: bool) -> str:
        """none, fresh, stale, or refused (held off until it leaves the organ)."""
        if self.poses == 0:
            return "none"
        if time.monotonic() - self.pose_clock > settings[st.STALE_TIME]:
            return "stale"
        return "fresh" if engaged else "refused"


def as_values(counter: Counter[str], prefix: str) -> dict[str, Any]:
    """A counter as diagnostics values."""
    return {f"{prefix}.refused.{name}": count for name, count in sorted(counter.items())}
