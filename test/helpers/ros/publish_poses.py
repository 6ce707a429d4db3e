"""A haptic bridge in small: presses the shipped kidney with tool `left`, 500 poses a second at most.

Each step waits for the wrench that answers the one before, or a moment, so that a slow node sees the same path.
SIGTERM has it leave the tissue and end; until then it holds, or comes back by a stroke again and again: where that is
out of the tissue, a tool that was lost on a slow machine is taken up again. Arguments: --depth M, --stroke M.
"""

import argparse
import signal
import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions

sys.path.insert(0, str(Path(__file__).parents[2]))
from helpers.ros.processes import poke_path, shipped

OUTSIDE, STEPS, PERIOD, PATIENCE = 0.008, 400, 0.002, 0.1  # m, poses on the way in, s, s

parser = argparse.ArgumentParser()
parser.add_argument("--depth", type=float, required=True)
parser.add_argument("--stroke", type=float, default=0.0)
args = parser.parse_args()

asked = []
signal.signal(signal.SIGTERM, lambda *_: asked.append(True))
touch, inward = poke_path(shipped())
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = rclpy.create_node("publisher")
executor = SingleThreadedExecutor()
executor.add_node(node)
publisher = node.create_publisher(PoseStamped, "left/measured_cp", qos_profile_sensor_data)
answers = []
node.create_subscription(WrenchStamped, "left/servo_cf", answers.append, qos_profile_sensor_data)
message = PoseStamped()
message.header.frame_id = "organ"
message.pose.orientation.w = 1.0
sent: list[float] = []  # depths, m


def send(depth: float) -> None:
    """A pose at a depth in m; returns when it is answered."""
    position = touch + depth * inward
    message.header.stamp = node.get_clock().now().to_msg()
    message.pose.position.x, message.pose.position.y, message.pose.position.z = map(float, position)
    answers.clear()
    publisher.publish(message)
    sent.append(depth)
    begin = time.monotonic()
    while not answers and time.monotonic() < begin + PATIENCE:
        executor.spin_once(timeout_sec=PATIENCE)
    time.sleep(max(0.0, begin + PERIOD - time.monotonic()))


while not (answers or asked):  # the node may discover this publisher later than the publisher discovers the node
    send(-OUTSIDE)
for depth in np.linspace(-OUTSIDE, args.depth, STEPS):
    send(depth)
print("pressed", flush=True)
pressed = len(sent)
while not asked:
    send(args.depth - 0.5 * args.stroke * (1.0 - np.cos((len(sent) - pressed) / STEPS * 2.0 * np.pi)))
for depth in np.linspace(args.depth, -OUTSIDE, STEPS):
    send(depth)
print(f"{len(sent)} poses", flush=True)
executor.shutdown()
node.destroy_node()
rclpy.shutdown()
