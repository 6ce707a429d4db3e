"""A node of the name that `bench start` looks for, which comes so many s after the program that looks for it.

usage: late_node.py SECONDS
"""

import sys
import time

import rclpy

from tissue_sim.ros.shared import dds

dds.prepare()
rclpy.init()
watcher = rclpy.create_node("watcher")
print("up", flush=True)
while "finder" not in watcher.get_node_names():
    time.sleep(0.01)
time.sleep(float(sys.argv[1]))
node = rclpy.create_node("tissue_sim")
time.sleep(3600.0)
