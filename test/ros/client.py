"""What a test knows of a running node: everything that it hears on the topics."""

import time
from collections.abc import Callable

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Client:
    """Subscribes a node's topics in this process, and talks to its services."""

    def __init__(self, namespace: str = "", markers: bool = True) -> None:
        self.context = rclpy.Context()
        self.context.init()
        self.node = rclpy.create_node("client", namespace=namespace, context=self.context)
        self.target = f"{namespace}/tissue_sim"  # the node's full name
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.wrenches: list[tuple[float, np.ndarray]] = []
        self.stamps: list[float] = []  # s, when the node published each of them
        self.surfaces: list[np.ndarray] = []
        self.markers: list[MarkerArray] = []
        self.diagnostics: dict[str, str] = {}
        self.level = b""
        self.message = ""
        node = self.node
        node.create_subscription(WrenchStamped, "left/servo_cf", self._on_wrench, qos_profile_sensor_data)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        if markers:
            node.create_subscription(MarkerArray, f"{self.target}/markers", self._on_markers, LATCHED)
        self.pose = node.create_publisher(PoseStamped, "left/measured_cp", qos_profile_sensor_data)
        self.force = node.create_publisher(WrenchStamped, "left/measured_cf", qos_profile_sensor_data)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def spin(self, seconds: float) -> None:
        self.spin_until(lambda: False, seconds)

    def spin_until(self, done: Callable[[], bool], timeout: float) -> bool:
        end = time.monotonic() + timeout
        while not done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.01)
        return done()

    def call(self, kind: type, name: str, request: object) -> object:
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(10.0), f"no service {name}"
        future = client.call_async(request)
        assert self.spin_until(future.done, 10.0), f"no answer from {name}"
        self.node.destroy_client(client)
        return future.result()

    def reset(self) -> Trigger.Response:
        return self.call(Trigger, f"{self.target}/reset", Trigger.Request())

    def record(self, on: bool) -> SetBool.Response:
        return self.call(SetBool, f"{self.target}/record", SetBool.Request(data=on))

    def set_parameter(self, name: str, value: object) -> object:
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call(SetParameters, f"{self.target}/set_parameters", request).results[0]

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
        message.header.stamp = self.stamp(None)
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = map(float, force)
        self.force.publish(message)

    def stamp(self, seconds: float | None):
        if seconds is None:
            return self.node.get_clock().now().to_msg()
        return rclpy.time.Time(nanoseconds=int(1e9 * seconds)).to_msg()

    def _on_wrench(self, message: WrenchStamped) -> None:
        force, torque = message.wrench.force, message.wrench.torque
        values = np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])
        self.wrenches.append((time.monotonic(), values))
        self.stamps.append(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == f"{self.target.strip('/')}: physics":
                self.diagnostics = {item.key: item.value for item in status.values}
                self.level, self.message = status.level, status.message

    def _on_markers(self, message: MarkerArray) -> None:
        self.markers.append(message)
        surface = next(marker for marker in message.markers if marker.ns == "surface")
        if surface.action == Marker.ADD:
            self.surfaces.append(np.array([(p.x, p.y, p.z) for p in surface.points]))
