"""A tool's topics, by their CRTK names, with the types that they have inside the node and in a bag."""

from __future__ import annotations

TOOL_TOPICS = {
    "measured_cp": "geometry_msgs/msg/PoseStamped",
    "measured_cf": "geometry_msgs/msg/WrenchStamped",
    "servo_cf": "geometry_msgs/msg/WrenchStamped",
}
GRIPPER_TOPICS = {
    "measured_js": "std_msgs/msg/Float64MultiArray",  # rad between the jaws, one number for each measured_cp
}
