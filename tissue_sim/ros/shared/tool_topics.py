"""A tool's topics, by their CRTK names, with the types that they have inside the node and in a bag."""

from __future__ import annotations

TOOL_TOPICS = {
    "measured_cp": "geometry_msgs/msg/PoseStamped",
    "external_cf": "geometry_msgs/msg/WrenchStamped",  # a force on the tissue; off where it has no name
    "servo_cf": "geometry_msgs/msg/WrenchStamped",
}
GRIPPER_TOPICS = {
    "measured_js": "std_msgs/msg/Float64MultiArray",  # rad between the jaws, one number for each measured_cp
}
