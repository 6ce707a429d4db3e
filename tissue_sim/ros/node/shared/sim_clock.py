"""Ticks that follow /clock when use_sim_time is set; parameter and subscription are rclpy's own."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import ClockChange, JumpThreshold, TimeJump
from rclpy.duration import Duration

from tissue_sim.ros.node.shared.guarded_node import GuardedNode
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.report import Report

NANOSECOND = Duration(nanoseconds=1)


class SimClock:
    """The clock that ticks follow; hands every time of /clock to the loop.

    Without a clock there is no tick; a jump back resets the organ.

    Attributes
    ----------
    jumped
        Functions that are called when times begin again: after a jump back, before the organ goes back to rest, and
        when ticks follow another clock.
    active
        Whether ticks follow /clock.
    """

    def __init__(self, node: GuardedNode, loop: Loop) -> None:
        self._clock, self._log, self._loop = node.get_clock(), node.get_logger(), loop
        self.jumped: list[Callable[[], None]] = []
        self.active = self._waiting = self._stood = False
        threshold = JumpThreshold(min_forward=NANOSECOND, min_backward=Duration(nanoseconds=-1), on_clock_change=True)
        self._handle = self._clock.create_jump_callback(threshold, post_callback=node.guarded(self._on_jump))
        self._follow(bool(node.get_parameter("use_sim_time").value))

    def now(self) -> float:
        """Return the time of /clock, or of the monotonic clock, which stands while the loop is paused, s."""
        return 1e-9 * self._clock.now().nanoseconds if self.active else self._loop.pause.now()

    def arrival_stamp(self) -> int:
        """Return the stamp of a message without one that comes now, without the time for which the loop was paused.

        A tool takes as long for its path as the stamps of its poses are apart. A pause is not part of that: if a tool
        is placed and ten ticks are taken, again and again, it moves in these ten.

        By ROS's clock, ns.
        """
        now = int(self._clock.now().nanoseconds)
        return now if self.active else now - round(1e9 * (time.monotonic() - self._loop.pause.now()))

    def age_of(self, stamp: int) -> float:
        """Return the time since a stamp, ns, by ROS's clock; negative for one of a clock that is ahead."""
        return 1e-9 * float(self._clock.now().nanoseconds - stamp)

    def state(self) -> str:
        """Return wall, /clock, or why nothing ticks: no /clock yet, /clock stands."""
        if not self.active:
            return "wall"
        if self._waiting:
            return "no /clock yet"
        return "/clock stands" if self._loop.clock_stands else "/clock"

    def report(self, report: Report) -> None:
        """Add the state."""
        report.values["clock"] = self.state()

    def watch(self) -> None:
        """Log once when the clock stands, and when it goes on; call it often."""
        stands = self.active and not self._waiting and self._loop.clock_stands
        if stands and not self._stood:
            self._log.info("/clock stands still: no ticks and no forces until it continues")
        elif self._stood and not stands and self.active:
            self._log.info("/clock goes on: ticks follow it again")
        self._stood = stands

    def _on_jump(self, jump: TimeJump) -> None:
        if jump.clock_change in (ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED):
            self._follow(jump.clock_change == ClockChange.ROS_TIME_ACTIVATED)
            return
        if not self.active:
            return
        if self._waiting:
            self._waiting = False
            self._log.info("ticks follow /clock")
        elif jump.delta.nanoseconds < 0:
            self._log.warning(
                f"/clock jumped back by {-1e-9 * jump.delta.nanoseconds:.3f} s: the organ was reset to rest"
            )
            self._restart()
            self._loop.reset()
        self._loop.post_time(self._clock.now().nanoseconds)

    def _follow(self, active: bool) -> None:
        self.active = active
        self._restart()
        posted = self._clock.now().nanoseconds if active else 0
        self._waiting = active and posted == 0
        if self._waiting:
            self._log.info("use_sim_time is set: waiting for /clock before the first tick")
        self._loop.post_time(posted)
        self._loop.follow_posted_time(active)

    def _restart(self) -> None:
        for notify in self.jumped:
            notify()
