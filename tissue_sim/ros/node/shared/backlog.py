"""How far the executor is behind the messages that come in, and which are skipped until it has caught up.

rclpy's EventsExecutor keeps an event for each message, though only the newest of a stream waits: where they come faster
than they can be handled, events pile up without end. Each takes 0.2 kB, and services wait behind all of them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from rclpy.node import Node

from tissue_sim.ros.shared.report import Report

MOST_BEHIND = 0.05  # s that an event may wait
# s between two handled messages of a stream while the executor is behind; even with the longest no tool is stale.
SHORTEST, LONGEST = 0.5e-3, 0.016
EASED = 0.7  # factor on the pause at the next check when it isn't behind

Post = Callable[[Callable[[], None]], object]  # the executor does it after everything that waits


class Backlog:
    """Measurement of how long a posted task waits for the executor; the pause doubles until that is short."""

    def __init__(self, post: Post) -> None:
        self._post = post
        self.pause = 0.0  # s between two handled messages of a stream; 0: all are handled
        self.behind, self.longest = 0.0, 0.0  # s that the newest event waited; the longest of all
        self._asked = self._answered = 0.0  # s

    def look(self) -> None:
        """Check how far it is behind, and post the next task; to be called by one thread."""
        now = time.monotonic()
        waits = self._answered < self._asked  # the last task
        self.behind = now - self._asked if waits else self._answered - self._asked
        self.longest = max(self.longest, self.behind)
        if self.behind > MOST_BEHIND:
            self.pause = min(max(SHORTEST, 2.0 * self.pause), LONGEST)
        else:
            self.pause *= EASED
            if self.pause < SHORTEST:
                self.pause = 0.0
        if not waits:
            self._asked = now
            self._post(self._answer)

    def _answer(self) -> None:
        self._answered = time.monotonic()

    def report(self, report: Report) -> None:
        """Add how far it is behind, and that messages are skipped."""
        report.values |= {"executor_behind_ms": 1e3 * self.behind, "executor_most_behind_ms": 1e3 * self.longest}
        if self.pause > SHORTEST:  # at more than one check
            report.warnings.append(
                "poses and forces arrive faster than they can be handled: one per topic is handled every"
                f" {1e3 * self.pause:.1f} ms"
            )


class InputThrottle:
    """Gate for the messages of one stream, as often as a backlog allows."""

    def __init__(self, backlog: Backlog) -> None:
        self._backlog, self._passed = backlog, -math.inf
        self.passed_over = 0

    def passes(self) -> bool:
        """Return whether a message that has come is to be handled; the next one is newer."""
        pause = self._backlog.pause
        if not pause:
            return True
        now = time.monotonic()
        if now - self._passed < pause:
            self.passed_over += 1
            return False
        self._passed = now
        return True


def executor_of(node: Node) -> Post:
    """Return a function that has a node's executor run functions, once it has one."""

    def post(task: Callable[[], None]) -> None:
        if node.executor is None:
            task()
        else:
            node.executor.create_task(task)

    return post
