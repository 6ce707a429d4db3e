"""A node of the name that `bench start` looks for, which comes so many s after a file is there.

usage: late_node.py FILE SECONDS
"""

import sys
import time
from pathlib import Path

import rclpy

from tissue_sim.ros.shared import dds

dds.prepare()
rclpy.init()
print("up", flush=True)
while not Path(sys.argv[1]).exists():
    time.sleep(0.01)
time.sleep(float(sys.argv[2]))
node = rclpy.create_node("tissue_sim")
time.sleep(3600.0)
