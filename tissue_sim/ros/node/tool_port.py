"""One tool's topics: poses and forces in, checked; the wrench out."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from tissue_sim.array_types import Floats
from tissue_sim.contact.gripper import about
from tissue_sim.contact.tools import ToolSet
from tissue_sim.ros.bags.recorder import Recorder
from tissue_sim.ros.shared.cdr import UNSTAMPED, Stamped, unit_pose
from tissue_sim.ros.shared.frames import Frames, Transform, UnknownFrame, Vector, rotate, rotate_back
from tissue_sim.ros.shared.messages import NumbersTemplate
from tissue_sim.ros.shared.physics import Physics
from tissue_sim.ros.shared.qos import RELIABLE, STREAM
from tissue_sim.ros.shared.report import Report
from tissue_sim.ros.shared.tool_messages import FORCE_TYPES, N_POSE, N_WRENCH, POSE_TYPES, Incoming, ToolTopics
from tissue_sim.ros.shared.tool_topics import TOOL_TOPICS

FARTHEST = 100.0  # m: a pose beyond it is in another unit
LONGEST_PERIOD = 0.1  # s between two poses of a stream
COARSE = 1.25  # step of the scale of periods, so that what depends on them changes seldom
WARN_EVERY = 5.0  # s between two lines about the same kind of bad input


class Refused(Exception):
    """Input that is not taken up: a short name for the counter, and the line for the user."""

    def __init__(self, name: str, line: str) -> None:
        super().__init__(line)
        self.name = name


class NewestPose(NamedTuple):
    """A pose that was taken up, and what a bag holds of it."""

    sequence: int
    pose: Floats  # (7,)
    placed: Floats  # (b, 7) of the tool's bodies
    raw: bytes
    angle: bytes  # of a gripper


class ToolPort:
    """Subscribes a tool's measured_cp and measured_cf, publishes its servo_cf, in the types and axes of its bridge.

    Inside, and in a bag, a pose is a PoseStamped and a force or wrench a WrenchStamped, all in the organ's frame.
    A wrench goes out for each pose that arrives, from the callback itself; `keep_publishing` goes on
    at the tick rate when poses stop, until the wrench is zero.
    """

    def __init__(
        self,
        node: Node,
        index: int,
        name: str,
        tools: ToolSet,
        topics: ToolTopics,
        frames: Frames,
        organ_frame: str,
        physics: Physics,
        recorder: Callable[[], Recorder],
        woken: threading.Event,
    ) -> None:
        self.index, self.name, self.topics = index, name, topics
        self.bodies = tools.bodies[index]
        self._tools = tools
        self.angle = 0.0  # rad between a gripper's jaws
        self.refused: Counter[str] = Counter()
        self.poses = self.forces = 0
        # Sequence, pose (7,), poses of the bodies (b, 7), bytes of the newest pose, and those of a gripper's angle;
        # replaced as one so that they belong together.
        nowhere = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        self.newest = NewestPose(0, nowhere, np.tile(nowhere, (len(self.bodies), 1)), b"", b"")
        self.newest_force: tuple[int, bytes] = (0, b"")
        self.pose_clock = -math.inf  # monotonic s of the newest accepted pose
        self.force_clock = -math.inf
        self.force = 0.0  # N, magnitude last published
        self._period = 1e-3  # s between two poses, on average
        self._log, self._clock = node.get_logger(), node.get_clock()
        self._physics, self._recorder, self._woken = physics, recorder, woken
        self._pose_stamp = self._force_stamp = 0
        self._warned: dict[str, float] = {}
        self._frames = frames
        self._to_organ = frames.to_organ(topics.frame_id)  # from the frame that the newest pose came in
        self._pose_type, self._force_type = POSE_TYPES[topics.pose_type], FORCE_TYPES[topics.force_type]
        # Bytes that come in or go out just as a bag holds them are not made a second time.
        unmoved = self._to_organ.is_identity
        as_bagged = {
            "measured_cp": topics.pose_type == "PoseStamped" and unmoved,
            "measured_cf": topics.force_type == "WrenchStamped" and unmoved,
            "servo_cf": topics.wrench_type == "WrenchStamped" and unmoved and not topics.turns_wrench,
        }
        frame_id = name if topics.wrench_frame == "body" else topics.frame_id
        n_numbers = topics.array_length if topics.wrench_type == "Float64MultiArray" else N_WRENCH
        self._template = NumbersTemplate(topics.outgoing(), n_numbers, frame_id)
        self._bag_pose = NumbersTemplate(PoseStamped(), N_POSE, organ_frame)
        self._bag_force = NumbersTemplate(WrenchStamped(), N_WRENCH, organ_frame)
        self._bag_wrench = NumbersTemplate(WrenchStamped(), N_WRENCH, organ_frame)
        self._bag_angle = NumbersTemplate(Float64MultiArray(data=[0.0]), 1)
        self._lock = threading.Lock()
        self._published = -math.inf
        qos = RELIABLE if topics.reliable else STREAM
        names = topics.names
        self._servo = node.create_publisher(type(topics.outgoing()), names["servo_cf"], qos)
        self._subscriptions = [
            node.create_subscription(self._pose_type.message, names["measured_cp"], self._on_pose, qos, raw=True),
            node.create_subscription(self._force_type.message, names["measured_cf"], self._on_force, qos, raw=True),
        ]
        if self.is_gripper:
            self._jaws = node.create_subscription(JointState, names["measured_js"], self._on_angle, qos)
        self.names = {"servo_cf": self._servo.topic_name} | {
            topic: subscription.topic_name
            for topic, subscription in zip(("measured_cp", "measured_cf"), self._subscriptions, strict=True)
        }
        # A bag's topic has a name of its own where its type or axes are not the bridge's.
        own = node.get_fully_qualified_name()
        self.bag_names = {
            topic: self.names[topic] if as_bagged[topic] else f"{own}/{name}/{topic}" for topic in TOOL_TOPICS
        }
        if self.is_gripper:
            self.bag_names["measured_js"] = f"{own}/{name}/measured_js"
        self._wrench_as_bagged = as_bagged["servo_cf"]

    @property
    def is_gripper(self) -> bool:
        """True for a tool of two jaws."""
        return len(self.bodies) > 1

    # in ----------------------------------------------------------------------------------------
    def _on_pose(self, raw: bytes) -> None:
        settings = self._physics.settings()
        fresh_for = settings.stale_time + settings.ramp_time
        now = time.monotonic()
        try:
            last_stamp = self._pose_stamp if now - self.pose_clock < fresh_for else 0
            message, to_organ = self._read(raw, self._pose_type, N_POSE, "pose", last_stamp)
            if not to_organ.is_identity:
                message = message._replace(values=to_organ.of(message.values))
            try:
                pose = unit_pose(np.array(message.values))
            except ValueError as error:
                raise Refused("zero_quaternion", str(error)) from None
            if np.abs(pose[:3]).max() > FARTHEST:
                raise Refused("far_pose", f"it lies {np.abs(pose[:3]).max():.3g} m away; positions are in metres")
        except Refused as refused:
            self._refuse("pose", refused)
            return
        if message.stamp != UNSTAMPED:
            self._pose_stamp = message.stamp
        self._to_organ = to_organ
        if not to_organ.is_identity or self._pose_type is not POSE_TYPES["PoseStamped"]:
            raw = self._bag_pose.message(self._stamp(message), message.values)
        angle = self._bag_angle.message(0, [self.angle]) if self.is_gripper else b""
        placed = self._tools.poses(self.index, pose, self.angle)
        for body, at in zip(self.bodies, placed, strict=True):
            sequence = self._physics.post_pose(body, at)
        self.newest = NewestPose(sequence, pose, placed, raw, angle)
        if now - self.pose_clock < LONGEST_PERIOD:
            self._period += 0.02 * (now - self.pose_clock - self._period)
        self.pose_clock = now
        self.poses += 1
        self._recorder().received(self.bag_names["measured_cp"], raw)
        if self.is_gripper:
            self._recorder().received(self.bag_names["measured_js"], angle)
        self._publish()
        self._woken.set()

    def _on_angle(self, message: JointState) -> None:
        """The jaws open and close with the next pose: an angle alone must not keep a stale tool in touch."""
        try:
            if not message.position:
                raise Refused("no_angle", "it holds no position")
            if not math.isfinite(message.position[0]):
                raise Refused("nan_angle", "it holds a value that is not finite")
        except Refused as refused:
            self._refuse("angle", refused)
            return
        self.angle = float(message.position[0])

    def _on_force(self, raw: bytes) -> None:
        settings = self._physics.settings()
        fresh_for = settings.stale_time + settings.ramp_time
        now = time.monotonic()
        try:
            last_stamp = self._force_stamp if now - self.force_clock < fresh_for else 0
            message, to_organ = self._read(raw, self._force_type, N_WRENCH, "force", last_stamp)
        except Refused as refused:
            self._refuse("force", refused)
            return
        if message.stamp != UNSTAMPED:
            self._force_stamp = message.stamp
        self.force_clock = now
        if not to_organ.is_identity or self._force_type is not FORCE_TYPES["WrenchStamped"]:
            message = message._replace(values=_turned(message.values, lambda v: rotate(to_organ.rotation, v)))
            raw = self._bag_force.message(self._stamp(message), message.values)
        self.newest_force = (self._physics.post_force(self.bodies[0], np.array(message.values[:3])), raw)
        self.forces += 1
        self._recorder().received(self.bag_names["measured_cf"], raw)
        self._woken.set()

    def _read(self, raw: bytes, kind: Incoming, n_values: int, what: str, last_stamp: int) -> tuple[Stamped, Transform]:
        """A message whose values can be used, and the transform from its frame to the organ's."""
        try:
            message = kind.parse(raw, n_values)
        except ValueError as error:
            raise Refused("malformed", f"{error}") from None
        if not all(map(math.isfinite, message.values)):
            raise Refused(f"nan_{what}", "it holds a value that is not finite")
        if message.stamp == UNSTAMPED:  # nor has it a frame; what arrives later is newer
            return message, self._frames.to_organ(self.topics.frame_id)
        try:
            to_organ = self._frames.to_organ(message.frame_id)
        except UnknownFrame as error:
            raise Refused(
                "unknown_frame",
                f"its frame is '{message.frame_id}', expected '{self.topics.frame_id}'"
                f" (parameter {self.name}.frame_id names another); {error}",
            ) from None
        if message.stamp == 0:
            raise Refused("no_stamp", "its stamp is 0, which marks invalid data")
        if message.stamp < last_stamp:
            raise Refused(
                "backward_stamp", f"its stamp is {1e-9 * (last_stamp - message.stamp):.3f} s before the last one"
            )
        return message, to_organ

    def _stamp(self, message: Stamped) -> int:
        return message.stamp if message.stamp != UNSTAMPED else int(self._clock.now().nanoseconds)

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
            self._send(*self.felt())

    def felt(self) -> tuple[int, Floats]:
        """The newest tick, and what the hand feels, (6,) N and N m about the tool's origin, in the organ's axes."""
        tick, wrenches = self._physics.wrenches()
        return tick, self.share_of(wrenches)

    def share_of(self, wrenches: Floats) -> Floats:
        """What the hand feels, (6,) N and N m, of what all bodies do, (B, 6)."""
        if not self.is_gripper:
            return wrenches[self.bodies[0]]
        newest = self.newest
        return about(newest.pose[:3], wrenches[self.bodies], newest.placed[:, :3])

    def _send(self, tick: int, wrench: Floats) -> None:
        if not np.all(np.isfinite(wrench)):  # never seen, and never to be felt
            wrench = np.zeros(6)
            self.refused["nan_wrench"] += 1
        stamp = self._clock.now().nanoseconds
        raw = self._template.message(stamp, self._along_axes(wrench))
        self._servo.publish(raw)
        self.force = math.sqrt(float(wrench[:3] @ wrench[:3]))
        self._published = time.monotonic()
        recorder = self._recorder()
        if recorder.active:
            if not (self._wrench_as_bagged and self._to_organ.is_identity):
                raw = self._bag_wrench.message(stamp, wrench)
            recorder.wrench(self.bag_names["servo_cf"], self.index, tick, raw)

    def _along_axes(self, wrench: Floats) -> Sequence[float] | Floats:
        """A wrench in the organ's axes, along those that the bridge takes it in; about the tool's origin still."""
        to_organ, topics = self._to_organ, self.topics
        if to_organ.is_identity and not topics.turns_wrench:
            return wrench
        x, y, z, w = self.newest.pose.tolist()[3:] if topics.wrench_frame == "body" else to_organ.rotation
        turn = topics.wrench_rotation
        return _turned(wrench.tolist(), lambda v: rotate_back(turn, rotate_back((x, y, z, w), v)))

    def keep_publishing(self, silence: float) -> bool:
        """Publish the newest wrench if nothing went out for `silence` s and the last one wasn't zero.

        Returns True while there is something left to fade.
        """
        with self._lock:
            if self.force == 0.0:
                return False
            if time.monotonic() - self._published >= silence:
                self._send(*self.felt())
            return self.force != 0.0

    def publish_zero(self) -> None:
        """A last wrench of zero, for the shutdown."""
        with self._lock:
            self._send(-1, np.zeros(6))

    # state -------------------------------------------------------------------------------------
    @property
    def period(self) -> float:
        """Seconds between two poses, on average, to the next step of a coarse scale."""
        return float(COARSE ** math.ceil(math.log(self._period, COARSE)))

    def report(self, report: Report) -> None:
        """Add the state, the force, the poses that came and what was refused."""
        report.values |= {
            f"{self.name}.state": self.state(),
            f"{self.name}.force_n": self.force,
            f"{self.name}.poses": self.poses,
            "force_n": report.values.get("force_n", 0.0) + self.force,  # of all tools
        }
        report.problems |= {f"{self.name}.refused.{why}": count for why, count in sorted(self.refused.items())}

    def state(self) -> str:
        """none, fresh, stale, or refused (held off until it leaves the organ)."""
        if self.poses == 0:
            return "none"
        if time.monotonic() - self.pose_clock > self._physics.settings().stale_time:
            return "stale"
        return "fresh" if self._physics.results().tools[self.bodies[0]].engaged else "refused"


def _turned(wrench: Sequence[float], turn: Callable[[Vector], Vector]) -> tuple[float, ...]:
    fx, fy, fz, tx, ty, tz = wrench
    return (*turn((fx, fy, fz)), *turn((tx, ty, tz)))
