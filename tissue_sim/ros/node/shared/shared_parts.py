"""What several parts of the node work with."""

from __future__ import annotations

from typing import NamedTuple

from rclpy.node import Node

from tissue_sim.ros.bags.recorder import Recorder
from tissue_sim.ros.node.shared.backlog import Backlog
from tissue_sim.ros.node.shared.sim_clock import SimClock
from tissue_sim.ros.shared.organs import Organs


class SharedParts(NamedTuple):
    """The node, and those parts of it that others work with."""

    node: Node
    organs: Organs
    recorder: Recorder
    clock: SimClock  # that ticks follow
    backlog: Backlog  # how far the executor is behind
