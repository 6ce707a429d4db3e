"""Leaves out of rclpy what came with 7.1.4: a folder for PYTHONPATH."""

import sys

sys.modules["rclpy.experimental"] = None
