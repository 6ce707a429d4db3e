"""Outputs of the node at rates of their own: fading wrenches, markers, diagnostics; in a separate thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from tissue_sim.memory import give_back
from tissue_sim.ros.node.output.loop_timing import TimingReader
from tissue_sim.ros.node.settings import degradation as degrade
from tissue_sim.ros.node.settings.live_settings import LiveSettings
from tissue_sim.ros.node.shared.shared_parts import SharedParts
from tissue_sim.ros.node.tools.tool_port import ToolPort
from tissue_sim.ros.shared.report import RepeatedFailure, Report

SILENCE = 0.003  # s without a wrench after which the outlet goes on publishing it
IDLE_MARKER_RATE = 20.0  # Hz, of checks for motion while nothing moves
REPORT_EVERY = 1.0  # s
GIVE_BACK_EVERY = 60.0  # s
AFTER_FAILURE = 0.01  # s until the next turn


class PublishingThread:
    """Thread of fading wrenches at the tick rate, markers at their rate, and the journal.

    Four times a second it checks whether machine and executor keep up, and every second it reports. Where one of these
    fails, the others go on: no force remains because a picture could not be sent.

    show: functions that publish markers; live: settings while the node runs; publish_report: publishes the report.
    """

    def __init__(
        self,
        parts: SharedParts,
        ports: Sequence[ToolPort],
        show: Sequence[Callable[[], None]],
        live: LiveSettings,
        publish_report: Callable[[], None],
    ) -> None:
        self._organs, self._sim_clock, self._backlog = parts.organs, parts.clock, parts.backlog
        self._ports, self._show, self._live, self._publish_report = list(ports), list(show), live, publish_report
        self._logger = parts.node.get_logger()
        self._trouble = RepeatedFailure("outlet", self._logger.warning)
        self._load = TimingReader(parts.organs)
        self._ladder = degrade.DegradationLadder()
        self._seen: tuple[int, ...] = ()
        self._next_marker = self._next_look = self._next_report = self._next_return = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="outlet", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout=0.3)

    def report(self, report: Report) -> None:
        """Add what failed here."""
        self._trouble.report(report)

    def _run(self) -> None:
        self._next_marker = self._next_look = self._next_report = self._next_return = time.monotonic()
        while not self._stop.is_set():
            wait = AFTER_FAILURE
            with self._trouble.noted():
                wait = self._turn()
            if wait > 0.0:
                self._stop.wait(wait)

    def _turn(self) -> float:
        """Do what is due; return the time, s, until the next is."""
        noted, fading = self._trouble.noted, False
        for port in self._ports:
            with noted():
                fading |= port.output.keep_publishing(SILENCE)
        now = time.monotonic()
        if now >= self._next_marker:
            self._next_marker = max(self._next_marker + 1.0 / self._marker_rate(), now)
            for show in self._show:
                with noted():
                    show()
        if now >= self._next_look:
            self._next_look = max(self._next_look + degrade.LOOK_EVERY, now)
            with noted():
                self._backlog.look()
            with noted():
                self._look(now)
        if now >= self._next_report:
            self._next_report = max(self._next_report + REPORT_EVERY, now)
            with noted():
                self._publish_report()
                self._trouble.succeeded()  # unless it goes on failing
        if now >= self._next_return:
            self._next_return = now + GIVE_BACK_EVERY
            give_back()
        eased = self._live.ease(time.monotonic())
        wait = min(min(self._next_marker, self._next_look) - time.monotonic(), eased)
        return min(wait, self._organs.tick_time) if fading else wait

    def _marker_rate(self) -> float:
        """Return the marker rate; low while nothing moves, though not 0, since a viewer may connect."""
        before, self._seen = self._seen, (*self._organs.surface_sequences, *(port.input.poses for port in self._ports))
        rate = self._live.marker_rate
        return rate if self._seen != before else min(rate, IDLE_MARKER_RATE)

    def _look(self, now: float) -> None:
        """Check whether the clock stands, and whether the machine keeps up."""
        self._sim_clock.watch()
        timing, ladder = self._load.read(), self._ladder
        was_stuck = ladder.stuck
        look = degrade.Look(timing.load, timing.late_fraction, timing.dropped_ticks)
        if ladder.look(now, look, self._live.helps):
            self._degrade(ladder.level, look.words)
        elif ladder.stuck and not was_stuck:
            self._logger.warning(
                f"the machine is too slow, and the work can't be reduced further: simulated time falls behind"
                f" ({look.words}); stop other programs, set realtime_priority, or serve an organ with fewer points"
            )

    def _degrade(self, level: int, why: str) -> None:
        """Go to another level of degradation, and log it."""
        worse = level > self._live.level
        self._live.update(level)
        line = f"{self._live.describe()} ({why})"
        if worse:
            self._logger.warning(f"the machine is too slow: {line}")
        else:
            self._logger.info(f"the machine is fast enough again: {line}")
