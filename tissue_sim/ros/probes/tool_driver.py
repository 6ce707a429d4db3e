"""A hand that moves a tool of a node.

The program `python -m tissue_sim.ros.probes.tool_driver ORGAN` presses it into the organ and stops sending.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher

from tissue_sim.array_types import Floats
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.probes.graph import NODE, START_TIME, first_within
from tissue_sim.ros.shared import client
from tissue_sim.unexpected_errors import catch_all

RADIUS, DEPTH, SWING = 0.005, 0.003, 2e-4  # m: radius of the tool, its depth, its amplitude
FAR = -0.1  # m, a depth out of the organ's reach
UNTURNED = (0.0, 0.0, 0.0, 1.0)


class Hand:
    """Sender of poses of the tool `left` from a rclpy node, `rate` times a second, Hz."""

    def __init__(self, node: Node, organ: Organ, rate: float = 1000.0) -> None:
        self._node, self._period = node, 1.0 / rate
        self._to_node = node.create_publisher(PoseStamped, "left/measured_cp", client.stream_qos())
        self._message = PoseStamped()
        self._message.header.frame_id = "organ"
        points = organ.surface_positions
        self._inward: Floats = np.array([-1.0, 0.0, 0.0])
        self._touch: Floats = points[np.argmax(points[:, 0])] - RADIUS * self._inward

    def meet(self) -> None:
        """Wait until the node hears the hand. Raises UserError when it doesn't."""
        first_within(self._to_node.get_subscription_count, 20.0, "the node was not found over DDS")

    def approach(self) -> None:
        """Move the tool from outside into contact: one that appears inside would be held off."""
        for depth in np.linspace(-0.02, DEPTH, 400):
            self.send(depth)
            time.sleep(self._period)

    def wait_for_answer(self) -> None:
        """Send poses far from the organ until the first is answered. Raises UserError when none is."""
        answers = client.NewestMessage(self._node, WrenchStamped, "left/servo_cf", client.stream_qos(), raw=True)

        def answered() -> bool:
            self.send(FAR)
            return answers.take() is not None

        first_within(answered, START_TIME, "no pose was answered")
        answers.close()

    def send(self, depth: float, publisher: Publisher | None = None) -> None:
        """Send a pose at a depth in the organ, m; to the node, or by another publisher."""
        self.send_pose(np.concatenate([self._touch + depth * self._inward, UNTURNED]), publisher)

    def send_pose(self, pose: Floats, publisher: Publisher | None = None) -> None:
        """Send a pose (7,), m and a unit quaternion xyzw, to the node, or by another publisher."""
        message = self._message
        position, turn = message.pose.position, message.pose.orientation
        position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w = pose.tolist()
        message.header.stamp = self._node.get_clock().now().to_msg()
        (publisher or self._to_node).publish(message)


def main(organ_file: str) -> None:
    """Press once."""
    with client.client_node("hand", NODE) as node:
        hand = Hand(node, Organ.load(organ_file))
        hand.meet()
        hand.approach()


if __name__ == "__main__":
    catch_all("hand")
    main(sys.argv[1])
