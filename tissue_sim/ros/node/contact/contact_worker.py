"""Search for contact sets beside the physics loop, at a rate of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

import numpy as np

from tissue_sim.contact.finder import ContactFinder
from tissue_sim.contact.tools import ToolSet
from tissue_sim.contact.touched_surface import TouchedSurface
from tissue_sim.ros.node.contact.contact_search import ContactSearch, OrganContactSearch, ToolsNow
from tissue_sim.ros.node.tools.tool_port import ToolPort
from tissue_sim.ros.shared.report import RepeatedFailure, Report

BUSY_WAIT, IDLE_WAIT = 0.05, 0.5  # s without a new pose or force, after which a check for stale ones is due


class ContactWorker:
    """A thread that turns the newest poses and surfaces into contact sets, and into pairs where organs touch."""

    def __init__(
        self,
        searches: Sequence[ContactSearch],
        pairs: OrganContactSearch | None,
        ports: Sequence[ToolPort],
        woken: threading.Event,
        warn: Callable[[str], None],
    ) -> None:
        self.rate = 250.0  # Hz, may change while running
        self.idle_skips = 0
        self.durations: list[float] = []
        self._searches, self._pairs, self._ports, self._woken = list(searches), pairs, list(ports), woken
        self._trouble = RepeatedFailure("contact search", warn)
        self._stop = threading.Event()
        self._passes_begun = self._passes_ended = 0
        self._pass_ended = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="contact", daemon=True)
        self._idle = self._organs_move = False

    @property
    def tools(self) -> ToolSet:
        """The tools."""
        return self._searches[0].finder.tools

    def finder_of(self, organ: int, surface: TouchedSurface) -> ContactFinder:
        """Return a finder on another surface of the organ of an index; this takes a while."""
        return self._searches[organ].finder_of(surface)

    def exchange(self, organ: int, finder: ContactFinder, number: int) -> None:
        """Search on another surface of an organ from the next search on, after the loop has gone on with it.

        finder: the finder on that surface; number: number of the cut.
        """
        self._searches[organ].exchange(finder)
        if self._pairs is not None:
            self._pairs.exchange(organ, finder.surface, number)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stop.set()
        self._woken.set()
        if self._thread.is_alive():
            self._thread.join(timeout=0.5)

    def catch_up(self, timeout: float) -> bool:
        """Wait for a whole search that begins after this call, so that its sets are posted.

        timeout: how long to wait at most, s. Returns whether it ended in time.
        """
        with self._pass_ended:
            wanted = self._passes_begun + 1
            self._woken.set()
            return self._pass_ended.wait_for(lambda: self._passes_ended >= wanted, timeout)

    def report(self, report: Report) -> None:
        """Add what was found, what was skipped, and how long it took."""
        durations = self.durations[-250:]
        counters = [one.finder.counters for one in self._searches]
        report.values |= {
            "contact_p99_us": 1e6 * float(np.percentile(durations, 99)) if durations else 0.0,
            "contact_sets": sum(one.sets for one in counters),
            "skipped.tool_far": sum(one.far_skips for one in counters),
            "skipped.nothing_moved": self.idle_skips + sum(one.unchanged_skips for one in self._searches),
        }
        report.problems["dropped_contacts"] = sum(one.dropped for one in self._searches)
        if self._pairs is not None:
            found = self._pairs.finder.counters
            report.values |= {
                "pair_searches": found.searches,
                "skipped.organs_far": found.far_skips,
                "skipped.organs_apart": found.apart_skips,
                "skipped.no_organ_moved": self._pairs.unchanged_skips,
            }
            report.problems["dropped_pairs"] = found.dropped
        self._trouble.report(report)

    def _run(self) -> None:
        while not self._stop.is_set():
            # Organs touch each other without a tool, and tools go on to their newest poses without a new one.
            moves = self._organs_move or any(one.is_behind for one in self._searches)
            wait = 1.0 / self.rate if moves else IDLE_WAIT if self._idle and self._pairs is None else BUSY_WAIT
            self._woken.wait(timeout=wait)
            self._woken.clear()
            with self._pass_ended:
                self._passes_begun += 1
            begun = time.monotonic()
            with self._trouble.noted():  # after an error the node goes on with the last sets
                self._refresh(begun)
            with self._pass_ended:
                self._passes_ended = self._passes_begun
                self._pass_ended.notify_all()
            rest = 1.0 / self.rate - (time.monotonic() - begun)
            if rest > 0.0:
                time.sleep(rest)

    def _refresh(self, begun: float) -> None:
        now = ToolsNow.of(self._ports)
        looking = [one for one in self._searches if not one.is_idle(now)]
        self._idle = not looking
        self.idle_skips += len(self._searches) - len(looking)
        found = False
        for one in looking:
            with self._trouble.noted():
                found |= one.refresh(now, begun, self.rate)
        if self._pairs is not None:
            self._organs_move = self._pairs.refresh()
        if found:
            self._trouble.succeeded()
            self.durations.append(time.monotonic() - begun)
            if len(self.durations) > 1000:
                del self.durations[:500]
