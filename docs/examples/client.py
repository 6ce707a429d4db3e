"""A ROS client: press 6 mm into the kidney of a running node, and plot the force. Start `tissue_node` beside it."""

import matplotlib.pyplot as plt
import rclpy
from geometry_msgs.msg import Point, Pose, PoseStamped, WrenchStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.qos import qos_profile_sensor_data as qos
from rclpy.time import Time
from std_msgs.msg import Bool

rclpy.init()
node = rclpy.create_node("hand")
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ready: list[Bool] = []
wrenches: list[WrenchStamped] = []
node.create_subscription(Bool, "/tissue_sim/ready", ready.append, latched)
poses = node.create_publisher(PoseStamped, "/left/measured_cp", qos)
node.create_subscription(WrenchStamped, "/left/servo_cf", wrenches.append, qos)

xs, forces, sent = [], [], node.get_clock().now()
while len(xs) < 900:
    x = 0.106 - 2e-5 * min(len(xs), 900 - len(xs))  # m; it goes in for half of the time, and out again
    pose = PoseStamped(pose=Pose(position=Point(x=x, y=0.042, z=-0.002)))
    pose.header.frame_id, pose.header.stamp = "organ", node.get_clock().now().to_msg()
    poses.publish(pose)
    rclpy.spin_once(node, timeout_sec=0.01)  # until the wrench that answers the pose
    if ready and ready[-1].data and wrenches and Time.from_msg(wrenches[-1].header.stamp) > sent:
        xs.append(x)
        forces.append(wrenches[-1].wrench.force.x)
        sent = node.get_clock().now()
rclpy.shutdown()
print(f"{max(forces):.2f} N at most")

figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
axis.plot([1e3 * (xs[0] - x) for x in xs], forces)
axis.set(xlabel="distance from where the tool began (mm)", ylabel="force (N)")
figure.savefig("client.png", dpi=100)
