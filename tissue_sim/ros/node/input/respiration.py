"""The breath as prescribed from outside: checked, and posted."""

from __future__ import annotations

import math
import time
from collections import Counter

from rclpy.node import Node
from sensor_msgs.msg import JointState

from tissue_sim.ros.bags.joined_recorder import JoinedRecorder
from tissue_sim.ros.node.input.tool_input import WARN_EVERY
from tissue_sim.ros.node.shared.sim_clock import SimClock
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.qos import STREAM
from tissue_sim.ros.shared.report import Report

PAUSE = 1.0  # s without a message after which a stream may begin again, with any stamp


class RespirationInput:
    """Input of ~/respiration: a JointState whose first position is a fraction of the breath's displacement, 0 to 1.

    When messages stop, the breath stays where it was last.
    """

    def __init__(self, node: Node, loop: Loop, recorder: JoinedRecorder, clock: SimClock) -> None:
        self._loop, self._recorder, self._clock, self._log = loop, recorder, clock, node.get_logger()
        self._stamp, self._came, self._warned = 0, -math.inf, -math.inf
        self.fraction, self.taken = 0.0, 0
        self.refused: Counter[str] = Counter()
        clock.jumped.append(self._forget)
        self._subscription = node.create_subscription(JointState, "~/respiration", self._on_fraction, STREAM)

    def report(self, report: Report) -> None:
        """Add where the breath is to be, and what was refused."""
        report.values |= {"respiration": self.fraction, "respirations": self.taken}
        report.problems |= {f"respiration.refused.{why}": count for why, count in sorted(self.refused.items())}

    def _on_fraction(self, message: JointState) -> None:
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if why := self._wrong(message, stamp):
            name, line = why
            self.refused[name] += 1
            if time.monotonic() - self._warned > WARN_EVERY:
                self._warned = time.monotonic()
                self._log.warning(f"a message on ~/respiration was refused: {line}")
            return
        self._stamp, self._came = stamp, self._clock.now()
        self.fraction, self.taken = float(message.position[0]), self.taken + 1
        with self._recorder.lock:
            self._recorder.respiration(self._loop.post_respiration(self.fraction), self.fraction)
        self._loop.wake()

    def _wrong(self, message: JointState, stamp: int) -> tuple[str, str] | None:
        """Return a short name and a line for what can't be used."""
        if not message.position:
            return "no_position", "it contains no position"
        fraction = message.position[0]
        if not math.isfinite(fraction):
            return "nan_position", "it contains a value that is not finite"
        if not 0.0 <= fraction <= 1.0:
            return "no_fraction", f"its position is {fraction:g}; expected: 0, exhaled, to 1, inhaled"
        if stamp == 0:
            return "no_stamp", "its stamp is 0, which marks invalid data; set header.stamp to the time of measurement"
        if self._clock.now() - self._came < PAUSE and stamp < self._stamp:
            return "backward_stamp", f"its stamp is {1e-9 * (self._stamp - stamp):.3f} s before the last one"
        return None

    def _forget(self) -> None:
        self._stamp, self._came = 0, -math.inf
