"""A client that cuts the organ of a running node."""

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rclpy.duration import Duration
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from std_msgs.msg import UInt32
from std_srvs.srv import Trigger

from helpers.ros.clients import LATCHED, Client

EDGE = [[0.055, 0.0, 0.0], [0.075, 0.0, 0.0]]  # m, above the organ's lateral side
DEPTH = 0.03  # m, along y: about 12 mm of tissue
DOWN = (-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))  # turns z to y


class Surgeon(Client):
    """A client that cuts, and hears what becomes of the organ, or of one organ of a scene."""

    def __init__(self, organ=""):
        super().__init__(markers=not organ)
        self.below = f"{self.target}/{organ}" if organ else self.target
        self.meshes, self.versions, self.events, self.clouds = [], [], [], []
        for kind, topic, received in (
            (Mesh, "mesh", self.meshes),
            (UInt32, "mesh_version", self.versions),
            (DiagnosticArray, "cuts", self.events),
        ):
            self.node.create_subscription(kind, f"{self.below}/{topic}", received.append, LATCHED)
        self.node.create_subscription(PointCloud2, f"{self.below}/surface", self.clouds.append, qos_profile_sensor_data)
        self.contacts = []
        self.node.create_subscription(PointCloud2, f"{self.target}/left/contacts", self.contacts.append, 1)
        self.path = self.node.create_publisher(Path, f"{self.below}/cut_path", 1)

    def send_path(self, edge, quaternion=DOWN, frame="organ"):
        message = Path()
        message.header.frame_id = frame
        for point in edge:
            pose = PoseStamped()
            pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = map(float, point)
            orientation = pose.pose.orientation
            orientation.x, orientation.y, orientation.z, orientation.w = map(float, quaternion)
            message.poses.append(pose)
        assert self.spin_until(lambda: self.path.get_subscription_count() > 0)
        self.path.publish(message)
        assert self.path.wait_for_all_acked(Duration(seconds=30)), "a call that follows must not overtake it"

    def cut(self, edge=EDGE, depth=DEPTH, hand=None):
        assert self.set_parameter("cut_depth", depth).successful
        self.send_path(edge)
        return self.ask_to_cut(hand)

    def ask_to_cut(self, hand=None):
        """The answer, however long it takes: a call that is repeated would find the first one at work.

        Meanwhile the hand stays at a place.
        """
        service = self.node.create_client(Trigger, f"{self.below}/cut")
        assert service.wait_for_service(30.0)
        asked = service.call_async(Trigger.Request())
        assert self.spin_until(lambda: (hand is not None and self.ask(hand)) or asked.done())
        return asked.result()
