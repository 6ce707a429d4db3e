"""Stand-ins for haptic bridges: each speaks the topics, types, QoS, frame and axes of a real one."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.qos import QoSProfile, qos_profile_system_default
from scipy.spatial.transform import Rotation
from std_msgs.msg import Float64MultiArray

from helpers.ros.participant import Participant

MOMENT = 0.1  # s
HELD = Rotation.from_euler("xyz", (30.0, -40.0, 100.0), degrees=True)  # how the hand holds a stylus


@dataclass(frozen=True)
class Bridge:
    """What a bridge publishes, and what it does with the force that it receives.

    `force` takes a message and the orientation of the device to N along the axes of `frame_id`.
    """

    pose_topic: str
    frame_id: str
    wrench_topic: str
    wrench_type: type
    force: Callable[[object, Rotation], np.ndarray]
    # cisst-ros: rclcpp::QoS of a depth alone, so reliable; ros2_control: SystemDefaultsQoS.
    publishes: QoSProfile = field(default_factory=lambda: QoSProfile(depth=10))
    subscribes: QoSProfile = field(default_factory=lambda: QoSProfile(depth=1))
    orientation: Rotation = HELD
    pose_type: type = PoseStamped


def _force(message: WrenchStamped) -> np.ndarray:
    return np.array([message.wrench.force.x, message.wrench.force.y, message.wrench.force.z])


def _efforts(message: Float64MultiArray) -> np.ndarray:
    # forward_command_controller takes as many numbers as it has joints, and else stops with an error.
    assert len(message.data) == 3
    return np.array(message.data)


BRIDGES = {
    # mtsIntuitiveResearchKitArm: a wrench in the axes of the end effector
    "dvrk": Bridge("/MTML/measured_cp", "HRSV", "/MTML/body/servo_cf", WrenchStamped, lambda m, q: q.apply(_force(m))),
    # mtsForceDimension: what came in body/servo_cf goes to dhdSetForceAndTorqueAndGripperForce as it is
    "saw_force_dimension": Bridge(
        "/MTMR/measured_cp", "MTMR_base", "/MTMR/body/servo_cf", WrenchStamped, lambda m, _: _force(m)
    ),
    # fd_hardware hands the efforts to dhdSetForceAndTorque along fd_base, and ee_pose_broadcaster turns nothing:
    # transform_rotation is 0, 0, 0 in fd_controllers.yaml of main and humble
    "forcedimension_ros2": Bridge(
        "/fd/ee_pose",
        "fd_base",
        "/fd/fd_controller/commands",
        Float64MultiArray,
        lambda m, _: _efforts(m),
        qos_profile_system_default,
        qos_profile_system_default,
    ),
    # mtsSensableHD: what came in servo_cf goes to HD_CURRENT_FORCE as it is
    "geomagic_touch": Bridge("/arm/measured_cp", "base", "/arm/servo_cf", WrenchStamped, lambda m, _: _force(m)),
}


class StandIn(Participant):
    """Runs a bridge in this process: publishes poses and keeps the forces that come back."""

    def __init__(self, bridge: Bridge) -> None:
        self.bridge = bridge
        super().__init__("haptic_bridge")
        self.forces: list[np.ndarray] = []  # N along the axes of frame_id
        self.messages: list[object] = []
        self.poses = self.node.create_publisher(bridge.pose_type, bridge.pose_topic, bridge.publishes)
        self.wrenches = self.node.create_subscription(
            bridge.wrench_type, bridge.wrench_topic, self._on_wrench, bridge.subscribes
        )

    def connected(self) -> bool:
        """Both ways; DDS matches only what has the same type and a QoS that fits."""
        publishers = self.node.get_publishers_info_by_topic(self.bridge.wrench_topic)
        return self.poses.get_subscription_count() > 0 and len(publishers) > 0

    def send(self, position: np.ndarray, valid: bool = True) -> None:
        """Publish a position in m; as cisst-ros has it, a pose that isn't valid has a stamp of 0."""
        message = PoseStamped()
        message.header.frame_id = self.bridge.frame_id
        if valid:
            message.header.stamp = self.stamp()
        pose, turn = message.pose, self.bridge.orientation.as_quat()
        pose.position.x, pose.position.y, pose.position.z = map(float, position)
        pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = map(float, turn)
        self.poses.publish(message)

    def hold(self, position: np.ndarray) -> None:
        """Send a position; returns when it is answered or a moment has passed."""
        heard = len(self.forces)
        self.send(position)
        self.spin_until(lambda: len(self.forces) > heard, MOMENT)

    def _on_wrench(self, message: object) -> None:
        self.messages.append(message)
        self.forces.append(self.bridge.force(message, self.bridge.orientation))
