"""Input of a tool: poses, forces and jaws, read, checked, transformed to the organ's frame, and posted."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64MultiArray

from tissue_sim.array_types import Floats
from tissue_sim.contact.gripper import WIDEST
from tissue_sim.contact.quaternions import rotate
from tissue_sim.errors import shown
from tissue_sim.ros.node.input.freshness import Freshness
from tissue_sim.ros.node.shared.backlog import InputThrottle
from tissue_sim.ros.node.shared.served_tool import NewestPose, ServedTool, turned
from tissue_sim.ros.node.shared.shared_parts import SharedParts
from tissue_sim.ros.shared.cdr import UNSTAMPED, BadQuaternion, Stamped, check_force, check_position, unit_pose
from tissue_sim.ros.shared.frames import Transform, UnknownFrame
from tissue_sim.ros.shared.messages import NumbersTemplate
from tissue_sim.ros.shared.qos import RELIABLE, STREAM
from tissue_sim.ros.shared.tool_messages import FORCE_TYPES, N_POSE, N_WRENCH, POSE_TYPES, Incoming

WARN_EVERY = 5.0  # s between two lines about the same kind of bad input


class Refused(Exception):
    """Input that is not applied: a short name for the counter, and the line for the user."""

    def __init__(self, name: str, line: str) -> None:
        super().__init__(line)
        self.name = name


class ToolInput:
    """Input of a tool's measured_cp, external_cf where it has a name, and of a gripper measured_js.

    It posts messages to the loop and the bag. Inside, and in a bag, a pose is a PoseStamped and a force a
    WrenchStamped, both in the organ's frame. While the executor is behind by its backlog, some of them are skipped.

    freshness: freshness of poses and of forces; pose_came: called after each pose that was applied; force_came: called
    after each force that was applied.
    """

    def __init__(
        self,
        parts: SharedParts,
        tool: ServedTool,
        freshness: tuple[Freshness, Freshness],
        pose_came: Callable[[], None],
        force_came: Callable[[], None],
    ) -> None:
        node, recorder = parts.node, parts.recorder
        self._tool, self._organs, self._recorder = tool, parts.organs, recorder
        self._pose_freshness, self._force_freshness = freshness
        self._pose_gate, self._force_gate = InputThrottle(parts.backlog), InputThrottle(parts.backlog)
        self._pose_came, self._force_came = pose_came, force_came
        self._log, self._count_publishers = node.get_logger(), node.count_publishers
        self.newest, self._angle = tool.nowhere, 0.0  # rad between a gripper's jaws
        self._newest_force: tuple[int, bytes] = (0, b"")
        self.poses = 0
        self.refused: Counter[str] = Counter()
        self._warned: dict[str, float] = {}
        topics = tool.topics
        self._pose_type, self._force_type = POSE_TYPES[topics.pose_type], FORCE_TYPES[topics.force_type]
        # Bytes that come in just as a bag holds them are not made a second time.
        self._bag_pose = NumbersTemplate(PoseStamped(), N_POSE, tool.organ_frame)
        self._bag_force = NumbersTemplate(WrenchStamped(), N_WRENCH, tool.organ_frame)
        self._bag_angle = NumbersTemplate(Float64MultiArray(data=[0.0]), 1)
        self.follows = ""  # a frame of tf, in place of poses on the topic
        qos, names = RELIABLE if topics.reliable else STREAM, topics.names
        poses = node.create_subscription(self._pose_type.message, names["measured_cp"], self._on_pose, qos, raw=True)
        self._subscriptions = [poses]
        as_bagged = tool.is_unmoved and topics.pose_type == "PoseStamped"
        self._bagged_pose = recorder.add_topic(tool.name, "measured_cp", poses.topic_name if as_bagged else "", qos)
        if names["external_cf"]:
            kind = self._force_type.message
            forces = node.create_subscription(kind, names["external_cf"], self._on_force, qos, raw=True)
            self._subscriptions.append(forces)
            as_bagged = tool.is_unmoved and topics.force_type == "WrenchStamped"
            name = forces.topic_name if as_bagged else ""
            self._bagged_force = recorder.add_topic(tool.name, "external_cf", name, qos)
        self.enabled = True
        self._subscriptions.append(node.create_subscription(Bool, f"~/{tool.name}/enable", self._on_enable, RELIABLE))
        if tool.has_jaws:
            self._subscriptions.append(
                node.create_subscription(JointState, names["measured_js"], self._on_angle, qos),
            )
            self._bagged_angle = recorder.add_topic(tool.name, "measured_js", qos=qos)

    @property
    def passed_over(self) -> int:
        """Number of poses and forces that were skipped, as the executor was behind."""
        return self._pose_gate.passed_over + self._force_gate.passed_over

    @property
    def topic(self) -> str:
        """Full name of the topic of its poses."""
        return str(self._subscriptions[0].topic_name)

    @property
    def bridges(self) -> int:
        """Number of publishers of its poses; 1 for a tool that follows a frame of tf."""
        return 1 if self.follows else self._count_publishers(self.topic)

    def place(self, values: tuple[float, ...], frame_id: str, to_organ: Transform) -> None:
        """Take up a pose (7,) in the organ's frame that no message brought.

        Raises Refused where it can't be used.

        values: y, z in m and a quaternion xyzw; frame_id, to_organ: the frame that it was given in, and the transform
        from that.
        """
        _check_finite(values, "nan_pose")
        self._take(Stamped(UNSTAMPED, "", values), frame_id, to_organ, b"")

    def follow(self, message: Stamped) -> None:
        """Take up a pose that tf brought, in the frame that tf was asked for. Raises Refused."""
        _check_finite(message.values, "nan_pose")
        self._check_order(message.stamp)
        to_organ = self._tool.frames.to_organ(message.frame_id)
        self._take(message._replace(values=to_organ.of(message.values)), message.frame_id, to_organ, b"")

    def move_newest(self, pose: Floats, to_organ: Transform) -> None:
        """Say where a tool is now that the ticks have forgotten: at a pose (7,) in the organ's frame."""
        placed = self._tool.tools.poses(self._tool.index, pose, self._angle)
        self.newest = self.newest._replace(pose=pose, placed=placed, to_organ=to_organ)

    def newest_messages(self) -> dict[str, tuple[int, bytes]]:
        """Return sequence number and bytes of the last messages, by their topic in a bag."""
        pose, found = self.newest, {}
        if pose.raw:
            found[self._bagged_pose] = (pose.sequence, pose.raw)
        if pose.angle:
            found[self._bagged_angle] = (pose.sequence, pose.angle)
        if self._newest_force[1]:
            found[self._bagged_force] = self._newest_force
        return found

    def _on_enable(self, message: Bool) -> None:
        """Apply a clutch: while it is false, poses and forces are skipped, as if they had stopped."""
        if message.data != self.enabled:
            self.enabled = bool(message.data)
            name, now = self._tool.name, "enabled" if self.enabled else "disabled: its poses are ignored"
            self._log.info(f"tool '{name}' is {now} (~/{name}/enable)")

    def _on_pose(self, raw: bytes) -> None:
        if not self.enabled or not self._pose_gate.passes():
            return
        with self.refusing("pose"):
            if self.follows:
                name = self._tool.name
                raise Refused("not_followed", f"the tool follows '{self.follows}' (parameter {name}.tf_frame)")
            message, frame_id, to_organ = self._read(raw, self._pose_type, N_POSE, "nan_pose", self._pose_freshness)
            if not to_organ.is_identity:
                message = message._replace(values=to_organ.of(message.values))
            is_as_bagged = self._is_as_bagged(message, to_organ) and self._pose_type is POSE_TYPES["PoseStamped"]
            self._take(message, frame_id, to_organ, raw if is_as_bagged else b"")

    def _take(self, message: Stamped, frame_id: str, to_organ: Transform, raw: bytes) -> None:
        """Apply a pose in the organ's frame that came in frame_id; raw: its bytes where a bag holds these.

        Raises Refused.
        """
        tool = self._tool
        try:
            pose = unit_pose(np.array(message.values))
        except BadQuaternion as error:
            raise Refused(error.counted, str(error)) from None
        with self._as("far_pose"):
            check_position(pose[:3])
        stamp = self._stamp(message)
        if not raw:
            raw = self._bag_pose.message(stamp, message.values)
        angle = self._bag_angle.message(0, [self._angle]) if tool.has_jaws else b""
        placed = tool.tools.poses(tool.index, pose, self._angle)
        self._recorder.received(self._bagged_pose, raw)
        if tool.has_jaws:
            self._recorder.received(self._bagged_angle, angle)
        sequence = self._organs.post_poses(tool.bodies, placed, stamp)
        self.newest = NewestPose(sequence, pose, placed, frame_id, to_organ, raw, angle)
        self._pose_freshness.came(message.stamp)
        self.poses += 1
        self._pose_came()

    def _on_angle(self, message: JointState) -> None:
        """Keep an angle, which counts from the next pose on: alone it must not keep a stale tool in touch."""
        with self.refusing("angle"):
            if not message.position:
                raise Refused("no_angle", "it contains no position")
            at, wanted = 0, self._tool.jaw_joint
            if wanted and message.name:
                if wanted not in message.name[: len(message.position)]:
                    raise Refused("no_joint", f"it contains no position of the joint '{wanted}'")
                at = message.name.index(wanted)
            _check_finite(message.position[at : at + 1], "nan_angle")
            angle = float(message.position[at])
            if not wanted and abs(angle) > WIDEST:  # a URDF has limits of its own
                raise Refused(
                    "wide_angle",
                    f"its angle of {angle:g} rad is outside -{WIDEST:g}..{WIDEST:g}; angles are in radians",
                )
            self._angle = angle

    def _on_force(self, raw: bytes) -> None:
        if not self.enabled or not self._force_gate.passes():
            return
        with self.refusing("force"):
            message, _, to_organ = self._read(raw, self._force_type, N_WRENCH, "nan_force", self._force_freshness)
            self._force_freshness.came(message.stamp)
            if not self._is_as_bagged(message, to_organ) or self._force_type is not FORCE_TYPES["WrenchStamped"]:
                message = message._replace(values=turned(message.values, lambda v: rotate(to_organ.rotation, v)))
                raw = self._bag_force.message(self._stamp(message), message.values)
            force = np.array(message.values[:3])
            with self._as("hard_force"):
                check_force(force)
            self._recorder.received(self._bagged_force, raw)
            self._newest_force = (self._organs.post_force(self._tool.bodies[0], force), raw)
            self._force_came()

    def _read(
        self, raw: bytes, kind: Incoming, n_values: int, not_finite: str, freshness: Freshness
    ) -> tuple[Stamped, str, Transform]:
        """Return a message whose values can be used, their frame, and the transform from it to the organ's.

        not_finite: name of the refusal of values that are not finite.
        """
        tool = self._tool
        usual = tool.topics.frame_id
        with self._as("malformed"):
            message = kind.parse(raw, n_values)
        _check_finite(message.values, not_finite)
        if message.stamp == UNSTAMPED:  # it has no frame either; later arrival is newer
            return message, usual, tool.frames.to_organ(usual)
        try:
            unnamed = not message.frame_id and tool.topics.allow_empty_frame
            frame_id = usual if unnamed else message.frame_id
            to_organ = tool.frames.to_organ(frame_id)
        except UnknownFrame as error:
            remedy = "frame_id sets another one" if message.frame_id else "allow_empty_frame accepts it"
            raise Refused(
                "unknown_frame",
                f"its frame is '{shown(message.frame_id)}', expected '{usual}'"
                f" (parameter {tool.name}.{remedy}); {error}",
            ) from None
        if message.stamp == 0 and tool.topics.allow_zero_stamp:
            return message._replace(stamp=UNSTAMPED), frame_id, to_organ
        if message.stamp == 0:
            remedy = f"parameter {tool.name}.allow_zero_stamp uses the time of arrival instead"
            raise Refused("no_stamp", f"its stamp is 0, which marks invalid data ({remedy})")
        self._check_order(message.stamp, freshness)
        return message, frame_id, to_organ

    def _check_order(self, stamp: int, freshness: Freshness | None = None) -> None:
        """Raise Refused for a stamp before the last one of poses, or of others, far ahead of it, or still the same."""
        stream = self._pose_freshness if freshness is None else freshness
        last = stream.last_stamp
        if (before := last - stamp) > 0:
            raise Refused("backward_stamp", f"its stamp is {1e-9 * before:.3f} s before the last one")
        if stamp > stream.latest_stamp:
            late = f"its stamp is {1e-9 * (stamp - last):.3f} s after the last one, which came {stream.age:.3f} s ago"
            raise Refused("forward_stamp", f"{late}; the bridge's clock has jumped")
        if stream.stands_at(stamp):
            raise Refused(
                "same_stamp", f"its stamp has been the same for {stream.age:.3f} s; the bridge repeats an old message"
            )

    def _is_as_bagged(self, message: Stamped, to_organ: Transform) -> bool:
        """Return whether a bag may hold it as it came; there everything has the organ's frame."""
        return to_organ.is_identity and message.frame_id == self._tool.organ_frame and message.stamp != UNSTAMPED

    def _stamp(self, message: Stamped) -> int:
        return message.stamp if message.stamp != UNSTAMPED else self._pose_freshness.clock.arrival_stamp()

    @staticmethod
    @contextmanager
    def _as(name: str) -> Iterator[None]:
        """Refuse by this name what a check raises in here."""
        try:
            yield
        except ValueError as error:
            raise Refused(name, str(error)) from None

    @contextmanager
    def refusing(self, what: str) -> Iterator[None]:
        """Count what is refused in here, and log it now and then. what: name of what came."""
        try:
            yield
        except Refused as refused:
            self.refused[refused.name] += 1
            now = time.monotonic()
            if now - self._warned.get(refused.name, -math.inf) > WARN_EVERY:
                self._warned[refused.name] = now
                self._log.warning(f"tool '{self._tool.name}': {what} refused: {refused}")


def _check_finite(values: Iterable[float], name: str) -> None:
    """Raise Refused, under a name, where a value is not finite."""
    if not all(map(math.isfinite, values)):
        raise Refused(name, "it contains a value that is not finite")
