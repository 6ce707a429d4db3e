"""Path of a cut, as a node takes it on ~/cut_path."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

from tissue_sim.array_types import Floats


def cut_path(polyline: Floats, direction: Floats, frame_id: str) -> Path:
    """Return the path of a cut, whose poses' z axes point where the blade is moved.

    polyline (m, 3) m: its points; direction (3,): unit direction of the blade; frame_id: frame of both.
    """
    turn = (*np.cross([0.0, 0.0, 1.0], direction), 1.0 + direction[2])
    if np.linalg.norm(turn) < 1e-6:  # straight down, half a turn about any axis
        turn = (1.0, 0.0, 0.0, 0.0)
    x, y, z, w = (np.array(turn) / np.linalg.norm(turn)).tolist()
    message = Path()
    message.header.frame_id = frame_id
    for point in polyline:
        stamped = PoseStamped()
        at, q = stamped.pose.position, stamped.pose.orientation
        at.x, at.y, at.z = point.tolist()
        q.x, q.y, q.z, q.w = x, y, z, w
        message.poses.append(stamped)
    return message
