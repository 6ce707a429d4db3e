"""Finds contact sets beside the physics loop, at a rate of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

import numpy as np

from tissue_sim.contact.finder import ContactFinder, reach_margins
from tissue_sim.ros.bags.recorder import Recorder
from tissue_sim.ros.node.tool_port import ToolPort
from tissue_sim.ros.shared.physics import Physics
from tissue_sim.ros.shared.report import Report, Trouble

BUSY_WAIT, IDLE_WAIT = 0.05, 0.5  # s without a new pose or force after which it is looked whether they went stale


class ContactWorker:
    """A thread that turns the newest poses and surface into contact sets.

    Nothing is found when no pose and no position changed; a tool that appears inside the organ
    is held off until it has been outside.
    """

    def __init__(
        self,
        finder: ContactFinder,
        physics: Physics,
        ports: Sequence[ToolPort],
        recorder: Recorder,
        woken: threading.Event,
        warn: Callable[[str], None],
    ) -> None:
        self.rate = 250.0  # Hz, may change while running
        self.unchanged_skips = 0
        self.dropped = 0
        self.durations: list[float] = []
        self._trouble = Trouble("contact search", warn)
        self._finder, self._physics, self._ports = finder, physics, list(ports)
        self._recorder, self._woken, self._warn = recorder, woken, warn
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="contact", daemon=True)
        self._port_of = [port for port in ports for _ in port.bodies]  # of each body
        n_bodies = len(self._port_of)
        self._positions = np.zeros((len(physics.simulation.model.rest), 3))
        self._engaged = np.zeros(n_bodies, dtype=np.int64)
        self._held_off = [False] * n_bodies
        self._last_pose = np.zeros((n_bodies, 7))
        self._last_time = time.monotonic()
        self._last_key: tuple[int, ...] = ()
        self._last_empty = False
        self._last_resets = physics.loop.resets
        self._idle = False

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stop.set()
        self._woken.set()
        if self._thread.is_alive():
            self._thread.join(timeout=0.5)

    def report(self, report: Report) -> None:
        """Add what was found, what was not looked for, and how long it took."""
        durations = self.durations[-250:]
        counters = self._finder.counters
        report.values |= {
            "contact_p99_us": 1e6 * float(np.percentile(durations, 99)) if durations else 0.0,
            "contact_sets": counters.sets,
            "skipped.tool_far": counters.far_skips,
            "skipped.nothing_moved": self.unchanged_skips,
        }
        report.problems["dropped_contacts"] = self.dropped
        self._trouble.report(report)

    def _run(self) -> None:
        while not self._stop.is_set():
            self._woken.wait(timeout=IDLE_WAIT if self._idle else BUSY_WAIT)
            self._woken.clear()
            start = time.monotonic()
            with self._trouble.noted():  # the node goes on with the last set
                self._refresh(start)
            rest = 1.0 / self.rate - (time.monotonic() - start)
            if rest > 0.0:
                time.sleep(rest)

    def _refresh(self, now: float) -> None:
        newest = [port.newest for port in self._ports]
        sequences = [one.sequence for one in newest for _ in one.placed]
        poses = np.concatenate([one.placed for one in newest])
        if self._physics.loop.resets != self._last_resets:  # the organ has jumped back under the tools
            self._last_resets = self._physics.loop.resets
            self._engaged[:] = 0
        fresh = [counts for port in self._ports for counts in [port.pose_freshness.counts] * len(port.bodies)]
        # The first of its bodies pushes with the tool's force.
        pushing = np.zeros(len(fresh), dtype=np.int64)
        pushing[[port.bodies[0] for port in self._ports if port.force_freshness.counts]] = 1
        if not any(fresh) and not pushing.any() and self._last_empty and not self._engaged.any():
            self.unchanged_skips += 1
            self._idle = True
            return
        self._idle = False
        key = (*sequences, self._physics.surface_sequence, *map(int, fresh), *map(int, pushing))
        if key == self._last_key:
            self.unchanged_skips += 1
            return
        self._last_key = key
        tick, carried = self._physics.positions(self._positions)
        poses[:, :3] -= carried
        elapsed = max(now - self._last_time, 1e-4)
        bodies = self._physics.results().bodies
        behind = bodies.speed * bodies.remaining  # m that the loop has yet to lead them
        reach = reach_margins(poses[:, :3], self._last_pose[:, :3], 2.0 / (self.rate * elapsed), behind)
        margins = np.zeros(len(poses))
        for body, is_fresh in enumerate(fresh):
            # A thread that had no time may never see poses stop: the loop does.
            if not is_fresh or bodies[body].lapsed:
                self._engaged[body] = 0
                continue
            if not self._engaged[body]:
                if self._finder.is_inside(body, self._positions, poses[body]):
                    if not self._held_off[body]:
                        name, stale_time = self._port_of[body].name, self._physics.settings().stale_time
                        self._warn(
                            f"tool '{name}' appeared inside the organ and feels nothing until it has been outside:"
                            f" send a pose outside first, and the next within stale_time ({stale_time:g} s)"
                        )
                    self._held_off[body] = True
                    continue
                self._engaged[body] = 1
                self._held_off[body] = False
            else:
                margins[body] = reach[body]
        self._last_pose, self._last_time = poses, now
        found = self._finder.find(self._positions, poses, margins, self._engaged, pushing)
        self._trouble.succeeded()
        empty = found.header.points == 0 and bool(np.all(found.tip_node < 0))
        self._last_empty = empty
        self.dropped += int(found.header.dropped)
        rows = list(
            zip(
                sequences,
                margins.tolist(),
                self._engaged.astype(bool).tolist(),
                pushing.astype(bool).tolist(),
                strict=True,
            )
        )
        with self._recorder.together:
            sequence = self._physics.post_contacts(found)
            self._recorder.contacts(sequence, tick, found, rows)
        self.durations.append(time.monotonic() - now)
        if len(self.durations) > 1000:
            del self.durations[:500]
