"""What a test knows of a running node: everything that it hears on the topics."""

import time

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

from helpers.ros.participant import Participant

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Client(Participant):
    """Subscribes a node's topics in this process, and talks to its services."""

    def __init__(self, namespace: str = "", markers: bool = True) -> None:
        super().__init__("client", namespace)
        self.wrenches: list[tuple[float, np.ndarray]] = []
        self.stamps: list[float] = []  # s, when the node published each of them
        self.surfaces: list[np.ndarray] = []
        self.markers: list[MarkerArray] = []
        node = self.node
        node.create_subscription(WrenchStamped, "left/servo_cf", self._on_wrench, qos_profile_sensor_data)
        if markers:
            node.create_subscription(MarkerArray, f"{self.target}/markers", self._on_markers, LATCHED)
        self.pose = node.create_publisher(PoseStamped, "left/measured_cp", qos_profile_sensor_data)
        self.force = node.create_publisher(WrenchStamped, "left/measured_cf", qos_profile_sensor_data)

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

    def send_force(self, force: object, frame: str = "organ") -> None:
        message = WrenchStamped()
        message.header.frame_id = frame
        message.header.stamp = self.stamp()
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = map(float, force)
        self.force.publish(message)

    def _on_wrench(self, message: WrenchStamped) -> None:
        force, torque = message.wrench.force, message.wrench.torque
        values = np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])
        self.wrenches.append((time.monotonic(), values))
        self.stamps.append(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)

    def _on_markers(self, message: MarkerArray) -> None:
        self.markers.append(message)
        surface = next(marker for marker in message.markers if marker.ns == "surface")
        if surface.action == Marker.ADD:
            self.surfaces.append(np.array([(p.x, p.y, p.z) for p in surface.points]))
