"""Stand-ins for haptic bridges: each speaks the topics, types, QoS, frame and axes of a real one.

What a driver publishes beside its poses is from its sources: the read commands and events of the CRTK components, which
cisst_ros_crtk publishes by their names, with a transform in tf for each measured_cp; the broadcasters of ros2_control.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.qos import QoSProfile, qos_profile_system_default
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState, Joy
from std_msgs.msg import Bool, Float64MultiArray, String

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
    outputs: Mapping[str, type | None] = field(default_factory=dict)  # all topics; None: of a type that wheels lack
    frames: tuple[str, ...] = ()  # that the driver places in tf
    own_force: str = ""  # an output on which the device's own last force comes back


def _force(message: WrenchStamped) -> np.ndarray:
    return np.array([message.wrench.force.x, message.wrench.force.y, message.wrench.force.z])


def _efforts(message: Float64MultiArray) -> np.ndarray:
    # forward_command_controller takes as many numbers as it has joints, and else stops with an error.
    assert len(message.data) == 3
    return np.array(message.data)


EVENTS: dict[str, type | None] = {"operating_state": None, "error": String, "warning": String, "status": String}


def _of_devices(devices: tuple[str, ...], topics: Mapping[str, type | None]) -> dict[str, type | None]:
    """Topics below the names of devices, with those that every CRTK component has."""
    return {f"/{device}/{topic}": kind for device in devices for topic, kind in (EVENTS | dict(topics)).items()}


MASTER_ARM: dict[str, type | None] = {
    **{f"{of}{topic}": PoseStamped for of in ("", "local/") for topic in ("measured_cp", "setpoint_cp")},
    **dict.fromkeys(("measured_cv", "local/measured_cv", "body/measured_cv"), TwistStamped),
    **dict.fromkeys(("measured_js", "setpoint_js", "gripper/measured_js"), JointState),
    **dict.fromkeys(("body/measured_cf", "spatial/measured_cf"), WrenchStamped),
    **dict.fromkeys(("body/jacobian", "spatial/jacobian"), Float64MultiArray),
    "goal_reached": Bool,
    "gripper/closed": Bool,
}
FORCE_DIMENSION: dict[str, type | None] = {
    **dict.fromkeys(("measured_cp", "setpoint_cp"), PoseStamped),
    "measured_cv": TwistStamped,
    "gripper/measured_js": JointState,
    "body/measured_cf": WrenchStamped,
    **dict.fromkeys(("left", "right", "top", "bottom"), Joy),  # the buttons of a Falcon
}
SENSABLE: dict[str, type | None] = {
    **dict.fromkeys(("measured_cp", "tip/measured_cp", "setpoint_cp"), PoseStamped),
    "measured_cv": TwistStamped,
    "measured_js": JointState,
    "measured_cf": WrenchStamped,  # HD_LAST_FORCE: the force that the device was commanded to exert
    **dict.fromkeys(("button1", "button2"), Joy),
}
FD: dict[str, type | None] = {
    "/fd/ee_pose": PoseStamped,
    "/fd/button_state": Bool,
    "/fd/fd_inertia": Float64MultiArray,
    "/fd/fd_clutch": Bool,
    "/fd/joint_states": JointState,
    "/fd/dynamic_joint_states": None,
    "/fd/robot_description": String,
}

BRIDGES = {
    # mtsIntuitiveResearchKitArm: a wrench in the axes of the end effector
    "dvrk": Bridge(
        "/MTML/measured_cp",
        "HRSV",
        "/MTML/body/servo_cf",
        WrenchStamped,
        lambda m, q: q.apply(_force(m)),
        outputs=_of_devices(("MTML", "MTMR"), MASTER_ARM),
        frames=("MTML", "MTMR"),
        own_force="/MTML/body/measured_cf",
    ),
    # mtsForceDimension: what came in body/servo_cf goes to dhdSetForceAndTorqueAndGripperForce as it is
    "saw_force_dimension": Bridge(
        "/MTMR/measured_cp",
        "MTMR_base",
        "/MTMR/body/servo_cf",
        WrenchStamped,
        lambda m, _: _force(m),
        outputs=_of_devices(("MTML", "MTMR"), FORCE_DIMENSION),
        frames=("MTML", "MTMR"),
        own_force="/MTMR/body/measured_cf",
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
        outputs=FD,
        frames=("fd_base", *(f"fd_{part}_link" for part in ("x", "y", "z", "roll", "pitch", "yaw")), "fd_ee"),
    ),
    # mtsSensableHD: what came in servo_cf goes to HD_CURRENT_FORCE as it is
    "geomagic_touch": Bridge(
        "/arm/measured_cp",
        "base",
        "/arm/servo_cf",
        WrenchStamped,
        lambda m, _: _force(m),
        outputs=_of_devices(("arm",), SENSABLE),
        frames=("arm", "arm_tip"),
        own_force="/arm/measured_cf",
    ),
}


class StandIn(Participant):
    """Runs a bridge in this process: publishes poses and keeps the forces that come back."""

    def __init__(self, bridge: Bridge) -> None:
        self.bridge = bridge
        super().__init__("haptic_bridge")
        self.forces: list[np.ndarray] = []  # N along the axes of frame_id
        self.messages: list[object] = []
        self.poses = self.node.create_publisher(bridge.pose_type, bridge.pose_topic, bridge.publishes)
        self.others = {
            name: self.node.create_publisher(kind, name, bridge.publishes)
            for name, kind in bridge.outputs.items()
            if kind is not None and name != bridge.pose_topic
        }
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
        if self.bridge.own_force:
            self._tell_own_force()

    def _tell_own_force(self) -> None:
        """Publish what the device exerts, along the axes of the frame of its poses, as its driver does."""
        own = WrenchStamped()
        own.header.frame_id, own.header.stamp = self.bridge.frame_id, self.stamp()
        newest = self.forces[-1] if self.forces else np.zeros(3)
        own.wrench.force.x, own.wrench.force.y, own.wrench.force.z = map(float, newest)
        self.others[self.bridge.own_force].publish(own)

    def hold(self, position: np.ndarray) -> None:
        """Send a position; returns when it is answered or a moment has passed."""
        before = len(self.forces)
        self.send(position)
        self.spin_until(lambda: len(self.forces) > before, MOMENT)

    def _on_wrench(self, message: object) -> None:
        self.messages.append(message)
        self.forces.append(self.bridge.force(message, self.bridge.orientation))
