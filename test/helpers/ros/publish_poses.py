"""A haptic bridge in small: pokes the shipped kidney with tool `left`, 500 poses a second."""

import argparse
import math
import sys
import time
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.qos import qos_profile_sensor_data

sys.path.insert(0, str(Path(__file__).parents[2]))
from helpers.ros.processes import poke_path, shipped

parser = argparse.ArgumentParser()
parser.add_argument("--depth", type=float, required=True)
parser.add_argument("--seconds", type=float, required=True)
parser.add_argument("--hold", action="store_true")
args = parser.parse_args()

touch, inward = poke_path(shipped())
rclpy.init()
node = rclpy.create_node("publisher")
publisher = node.create_publisher(PoseStamped, "left/measured_cp", qos_profile_sensor_data)
end = time.monotonic() + 10.0
while publisher.get_subscription_count() == 0 and time.monotonic() < end:
    time.sleep(0.02)
message = PoseStamped()
message.header.frame_id = "organ"
message.pose.orientation.w = 1.0
start = time.monotonic()
count = 0
# A second outside first: the node may discover this publisher later than the publisher discovers the node.
while (elapsed := time.monotonic() - start - 1.0) < args.seconds:
    phase = max(0.0, elapsed / args.seconds)
    # A busy machine shows its viewers little: for a third of the way in and out the organ is pressed all the way.
    pressed = min(1.0, 4.0 * phase if args.hold else 1.2 * math.sin(math.pi * min(1.0, 2.0 * phase)))
    position = touch + (args.depth * pressed - 0.008 * (1.0 - pressed)) * inward
    message.header.stamp = node.get_clock().now().to_msg()
    message.pose.position.x, message.pose.position.y, message.pose.position.z = map(float, position)
    publisher.publish(message)
    count += 1
    time.sleep(max(0.0, start + count / 500.0 - time.monotonic()))
print(f"{count} poses")
node.destroy_node()
rclpy.shutdown()
