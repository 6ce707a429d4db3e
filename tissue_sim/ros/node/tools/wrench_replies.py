"""Wrenches as soon as the tick that applied a pose has ended; in a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from tissue_sim.ros.node.tools.tool_port import ToolPort
from tissue_sim.ros.shared.organs import Organs
from tissue_sim.ros.shared.priority import prefer
from tissue_sim.ros.shared.report import RepeatedFailure, Report

LONGEST = 0.05  # s between checks whether it is to end


class WrenchReplies:
    """Thread that publishes a tool's wrench once a tick has applied its pose; then contacts are found again.

    woken: set after the wrenches were published; warn: takes a line about what fails.
    """

    def __init__(
        self, organs: Organs, ports: Sequence[ToolPort], woken: threading.Event, warn: Callable[[str], object]
    ) -> None:
        self._organs, self._ports, self._woken = organs, list(ports), woken
        self._trouble = RepeatedFailure("answers", warn)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="answers", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def prefer(self, priority: int) -> None:
        """Give the running thread a priority, see `priority.prefer`."""
        prefer(priority, self._thread.native_id or 0)

    def stop(self) -> None:
        """End the thread."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout=2.0 * LONGEST)

    def report(self, report: Report) -> None:
        """Add what failed here."""
        self._trouble.report(report)

    def _run(self) -> None:
        while not self._stop.is_set():
            if self._organs.loop.wait_for_answer(LONGEST):
                with self._trouble.noted():
                    self._answer()
                    self._trouble.succeeded()

    def _answer(self) -> None:
        taken = self._organs.taken()
        for port in self._ports:
            with self._trouble.noted():
                port.answer(int(taken[port.bodies[-1]]))
        self._woken.set()
