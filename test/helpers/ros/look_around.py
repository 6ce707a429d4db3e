"""A ROS program that is none of ours: waits until it sees the nodes that are named, and prints all that it sees."""

import os
import sys
import time
from pathlib import Path

import rclpy

sys.path.insert(0, str(Path(__file__).parents[2]))
from helpers.patience import wait_for

rclpy.init()
node = rclpy.create_node("looking_around")


def seen() -> set[str]:
    return {f"{namespace.rstrip('/')}/{name}" for name, namespace in node.get_node_names_and_namespaces()}


wait_for(lambda: seen() >= set(sys.argv[1:]), lambda: f"saw {seen()}")
time.sleep(2.0)  # others, if any, are seen in that time, too: announcements go out at once and then every 3 s
print("sees", *sorted(seen()), flush=True)
os._exit(0)
