"""What a test knows of a running node: everything that it hears on the topics."""

import time
from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.serialization import deserialize_message
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from helpers.ros.participant import Participant
from helpers.ros.processes import shipped

MOMENT = 0.1  # s
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Client(Participant):
    """Subscribes a node's topics in this process, and talks to its services."""

    def __init__(self, namespace: str = "", markers: bool = True) -> None:
        super().__init__("client", namespace)
        self.wrenches: list[tuple[float, np.ndarray]] = []
        self.stamps: list[float] = []  # s, when the node published each of them
        organ = shipped()
        self.rest = organ.surface_positions[organ.surface_triangles.ravel()]  # theirs, of the organ that ships
        self._markers: list[bytes] = []  # as bytes: to take each apart would take longer than the next needs to come
        self._taken_apart: tuple[bytes, MarkerArray, np.ndarray] = (b"", MarkerArray(), np.zeros((0, 3)))
        node = self.node
        node.create_subscription(WrenchStamped, "left/servo_cf", self._on_wrench, qos_profile_sensor_data)
        if markers:
            node.create_subscription(MarkerArray, f"{self.target}/markers", self._markers.append, LATCHED, raw=True)
        self.pose = node.create_publisher(PoseStamped, "left/measured_cp", qos_profile_sensor_data)
        self.force = node.create_publisher(WrenchStamped, "left/external_cf", qos_profile_sensor_data)

    def meet(self) -> None:
        """Wait until the node receives poses, and its messages arrive."""
        assert self.spin_until(lambda: self.pose.get_subscription_count() > 0 and self.diagnostics)

    def reset(self) -> Trigger.Response:
        return self.call(Trigger, f"{self.target}/reset", Trigger.Request())

    def record(self, on: bool) -> SetBool.Response:
        name = f"{self.target}/record"
        is_first = name not in self._clients
        answer = self.call(SetBool, name, SetBool.Request(data=on))
        if is_first and on and "already recording" in answer.message:  # the answer to the very first request was lost
            answer.success = True
        return answer

    def send_pose(
        self,
        position: object,
        quaternion: object = (0.0, 0.0, 0.0, 1.0),
        frame: str = "organ",
        stamp: float | None = None,
    ) -> None:
        message = PoseStamped()
        message.header.frame_id = frame
        message.header.stamp = self.stamp(stamp)
        pose = message.pose
        pose.position.x, pose.position.y, pose.position.z = map(float, position)
        pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = map(float, quaternion)
        self.pose.publish(message)

    def ask(self, position: object, **named: object) -> None:
        """Send a pose, and hear until it is answered; where the answer was lost, for a moment."""
        before = len(self.wrenches)
        self.send_pose(position, **named)
        self.spin_until(lambda: len(self.wrenches) > before, MOMENT)

    def kick(self, hold: Callable[[], object]) -> float:
        """Return the highest force on the left hand, as a multiple of the one that it settles at.

        Steps from one wrench to the next tell nothing on a busy machine, which loses some.

        Parameters
        ----------
        hold
            Sends a pose where the tool is, and lets a moment pass.
        """

        def is_settled() -> bool:
            hold()
            newest = np.linalg.norm([wrench[:3] for _, wrench in self.wrenches[-50:]], axis=1)
            return len(newest) == 50 and bool(np.ptp(newest) < 0.05 * newest.mean())

        assert self.spin_until(is_settled), self.wrenches[-10:]
        return max(float(np.linalg.norm(wrench[:3])) for _, wrench in self.wrenches) / self.hand_force()

    def hand_force(self) -> float:
        """N, what the left hand feels."""
        return float(np.linalg.norm(self.wrenches[-1][1][:3])) if self.wrenches else 0.0

    def markers(self) -> MarkerArray:
        """The newest."""
        return self._newest_markers()[1]

    def surface(self) -> np.ndarray:
        """Corners (3 t, 3) m of the triangles in the newest markers; none before these came."""
        return self._newest_markers()[2]

    def moved(self) -> float:
        """m, the farthest that a corner of the newest surface is from where it rests; infinite without one."""
        surface = self.surface()
        return float(np.linalg.norm(surface - self.rest, axis=1).max()) if len(surface) else np.inf

    def _newest_markers(self) -> tuple[bytes, MarkerArray, np.ndarray]:
        del self._markers[:-1]
        if self._markers and self._markers[0] is not self._taken_apart[0]:
            message = deserialize_message(self._markers[0], MarkerArray)
            surface = next(marker for marker in message.markers if marker.ns == "surface")
            corners = np.array([(p.x, p.y, p.z) for p in surface.points]).reshape(-1, 3)
            self._taken_apart = self._markers[0], message, corners
        return self._taken_apart

    def send_force(self, force: object) -> None:
        message = WrenchStamped()
        message.header.frame_id = "organ"
        message.header.stamp = self.stamp()
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = map(float, force)
        self.force.publish(message)

    def _on_wrench(self, message: WrenchStamped) -> None:
        force, torque = message.wrench.force, message.wrench.torque
        values = np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])
        self.wrenches.append((time.monotonic(), values))
        self.stamps.append(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)
