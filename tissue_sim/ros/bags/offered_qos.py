"""The profile that a topic is offered with, in the terms of a bag: players offer the same."""

from __future__ import annotations

from rclpy.qos import QoSProfile
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

UNLIMITED = QosTime(9223372036, 854775807)


def offered(profile: QoSProfile) -> Qos:
    """Return a profile in the terms of a bag, as `ros2 bag record` writes it."""
    return Qos(
        QosHistory[profile.history.name],
        profile.depth,
        QosReliability[profile.reliability.name],
        QosDurability[profile.durability.name],
        UNLIMITED,
        UNLIMITED,
        QosLiveliness.AUTOMATIC,
        UNLIMITED,
        avoid_ros_namespace_conventions=False,
    )
