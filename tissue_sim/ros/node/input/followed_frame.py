"""A tool that follows a frame of tf, in place of poses on a topic."""

from __future__ import annotations

import time

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from tissue_sim.errors import UserError
from tissue_sim.ros.node.input.tf_lookup import TfLookup
from tissue_sim.ros.node.input.tool_input import Refused, ToolInput
from tissue_sim.ros.shared.cdr import Stamped
from tissue_sim.ros.shared.frames import UnknownFrame

AGAIN = 0.1  # s until a frame that wasn't there is asked for again


class FollowedFrame:
    """Poses of a tool by a frame of tf, asked for once in a tick's time.

    A transform counts once, by its stamp: where no newer one comes, the tool's pose becomes stale, as without messages
    of a bridge.

    node: the node, whose executor asks; lookup: lookup of frames, None without tf2_ros; followed_by: input of the tool;
    period: time between two questions, s. Raises UserError where tf2_ros is not installed.
    """

    def __init__(
        self, node: Node, lookup: TfLookup | None, frame_id: str, followed_by: ToolInput, period: float
    ) -> None:
        if lookup is None:
            raise UserError(
                f"parameter tf_frame '{frame_id}' needs tf2_ros, which is not installed: apt install"
                " ros-jazzy-tf2-ros-py"
            )
        self._lookup, self._frame_id, self._input = lookup, frame_id, followed_by
        followed_by.follows = frame_id
        self._newest, self._next = 0, 0.0  # stamp, ns; monotonic s
        # Also while /clock stands still: stamps show what is new.
        node.create_timer(period, self._ask, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _ask(self) -> None:
        """Take up the newest transform, unless it is the one before."""
        now = time.monotonic()
        if now < self._next or not self._input.enabled:
            return
        self._next = now + AGAIN
        with self._input.refusing("transform"):
            try:
                stamp, found = self._lookup.newest(self._frame_id)
            except UnknownFrame as error:
                raise Refused("unknown_frame", f"frame '{self._frame_id}' is not there: {error}") from None
            if stamp == 0:
                raise Refused(
                    "no_stamp", f"frame '{self._frame_id}' has only static transforms to '{self._lookup.target}'"
                )
            self._next = now
            if stamp != self._newest:
                self._newest = stamp
                values = (*found.translation, *found.rotation)
                self._input.follow(Stamped(stamp, self._lookup.target, values))
