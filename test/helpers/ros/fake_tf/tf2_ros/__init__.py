"""Takes the place of tf2_ros where only ROS's wheels are: the same calls, each transform a message of its own."""

from geometry_msgs.msg import TransformStamped
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time


class TransformException(Exception):
    pass


class LookupException(TransformException):
    pass


class Buffer:
    def __init__(self, cache_time: Duration | None = None, node: Node | None = None) -> None:
        self.frames: dict[tuple[str, str], TransformStamped] = {}

    def set_transform(self, transform: TransformStamped, authority: str) -> None:
        self.frames[transform.header.frame_id, transform.child_frame_id] = transform

    def lookup_transform(
        self, target_frame: str, source_frame: str, time: Time, timeout: Duration | None = None
    ) -> TransformStamped:
        found = self.frames.get((target_frame, source_frame))
        if found is None:
            raise LookupException(f'"{source_frame}" passed to lookupTransform argument source_frame does not exist.')
        return found


class TransformListener:
    """Hears TransformStamped on /tf_static and /tf; tf2_msgs isn't among the wheels."""

    def __init__(self, buffer: Buffer, node: Node, *, spin_thread: bool = False) -> None:
        qos = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.subscriptions = [
            node.create_subscription(
                TransformStamped, topic, lambda message: buffer.set_transform(message, "test"), profile
            )
            for topic, profile in (("/tf_static", qos), ("/tf", QoSProfile(depth=100)))
        ]


class _Broadcaster:
    def __init__(self, node: Node, topic: str, qos: QoSProfile) -> None:
        self.pub_tf = node.create_publisher(TransformStamped, topic, qos)

    def sendTransform(self, transform: TransformStamped | list[TransformStamped]) -> None:
        for one in transform if isinstance(transform, list) else [transform]:
            self.pub_tf.publish(one)


class StaticTransformBroadcaster(_Broadcaster):
    def __init__(self, node: Node, qos: QoSProfile | int | None = None) -> None:
        super().__init__(node, "/tf_static", qos or QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL))


class TransformBroadcaster(_Broadcaster):
    def __init__(self, node: Node, qos: QoSProfile | int | None = None) -> None:
        super().__init__(node, "/tf", qos or QoSProfile(depth=100))
