"""Pausing and stepping: the services ~/pause and ~/step, and the same requests of simulation_interfaces."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from std_srvs.srv import SetBool, Trigger

from tissue_sim.errors import UserError
from tissue_sim.ros.node.contact.contact_worker import ContactWorker
from tissue_sim.ros.node.shared.deferred_service import DeferredService, Work
from tissue_sim.ros.node.shared.guarded_node import GuardedNode
from tissue_sim.ros.node.shared.sim_clock import SimClock
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.report import Report

BY_CLOCK = "use_sim_time is set: ticks follow /clock, so pause and step at its publisher"
NEXT_TICK = "the node is paused: the organs return to rest with the next tick"
LONGEST_SEARCH = 1.0  # s that a step waits for contacts before it takes its next ticks without them
LATE_CONTACTS = (
    f"a step went on with older contacts, as finding new ones took more than {LONGEST_SEARCH:g} s: another run may"
    " differ; reduce the load on this machine"
)
PAUSED = "paused: no ticks and no forces until ~/pause is called with data: false"


class Pausing:
    """Pausing and stepping of the node's ticks; the executor calls it, except for the work of a step.

    Poses that come meanwhile are kept as the newest; forces are zero until the node goes on.

    Parameters
    ----------
    node : GuardedNode
        The node.
    loop : Loop
        The loop.
    clock : SimClock
        The clock that ticks follow.
    step_ticks : Callable[[], int]
        Returns how many ticks ~/step takes.
    contacts : ContactWorker
        Finds contacts beside the ticks.

    Attributes
    ----------
    stopped
        Whether it was paused by a reset to the start, and has not been stepped since.
    """

    def __init__(
        self,
        node: GuardedNode,
        loop: Loop,
        clock: SimClock,
        step_ticks: Callable[[], int],
        contacts: ContactWorker,
    ) -> None:
        self._loop, self._clock, self._log, self._contacts = loop, clock, node.get_logger(), contacts
        self._step_ticks = step_ticks
        self.stopped = False
        self._cancelled = threading.Event()  # the step that is being taken
        self._stepping = threading.Lock()
        clock.jumped.append(self._on_clock)
        node.create_service(SetBool, "~/pause", self._on_pause)
        DeferredService(node, Trigger, "~/step", self._on_step)

    @property
    def paused(self) -> bool:
        """Whether the node is paused, or stopped."""
        return self._loop.pause.active

    @property
    def possible(self) -> bool:
        """Whether the node can be paused: not while its ticks follow /clock."""
        return not self._clock.active

    def pause(self) -> None:
        """Take no further tick. Raises UserError when ticks follow /clock."""
        if not self.possible:
            raise UserError(BY_CLOCK)
        self._cancelled.set()
        self.stopped = False
        if not self.paused:
            self._log.info(PAUSED)
            self._loop.pause.begin()

    def stop(self) -> None:
        """Pause, with the organ back at rest as of the next tick. Raises UserError when ticks follow /clock."""
        self.pause()
        self._loop.reset()
        self.stopped = True

    def resume(self) -> None:
        """Go on by the clock, if paused; a step that is being taken ends."""
        self._cancelled.set()
        self.stopped = False
        if self.paused:
            self._loop.pause.end()
            self._log.info("no longer paused")

    def begin_step(self) -> None:
        """Begin a step, whose ticks `take` takes.

        Raises UserError when the node isn't paused, or another step is being taken.
        """
        if not self.possible:
            raise UserError(BY_CLOCK)
        if not self.paused:
            raise UserError(
                "the node is not paused, but only a paused node can be stepped: call ~/pause with data: true"
            )
        if not self._stepping.acquire(blocking=False):
            raise UserError("another step is in progress; wait for its answer")
        self.stopped = False
        self._cancelled.clear()

    def take(self, ticks: int) -> int:
        """Take the ticks of the step that was begun, no faster than the clock.

        Contacts are found as often as in a node that runs, but the ticks wait for them: what a step does must not
        depend on how busy the machine is.

        Returns how many were taken: fewer where the node was paused again, goes on, or ends meanwhile. Raises
        TimeoutError when the loop doesn't answer.
        """
        try:
            due, warned = time.monotonic(), False
            for taken in range(ticks):
                if taken % max(1, round(1.0 / (self._contacts.rate * self._loop.tick_time))) == 0:
                    if not self._contacts.catch_up(LONGEST_SEARCH) and not warned:
                        self._log.warning(LATE_CONTACTS)
                        warned = True
                if self._cancelled.is_set() or not self._loop.pause.step():
                    return taken
                due += self._loop.tick_time
                self._cancelled.wait(max(0.0, due - time.monotonic()))
            return ticks
        finally:
            self._stepping.release()

    def close(self) -> None:
        """End the step that is being taken."""
        self._cancelled.set()

    def report(self, report: Report) -> None:
        """Add whether the node is paused."""
        report.values["paused"] = self.paused
        if self.paused:
            report.warnings.append(PAUSED)

    def _on_clock(self) -> None:
        """Resume, as ticks are about to follow another clock."""
        if self.paused:
            self.resume()

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            if request.data:
                self.pause()
            else:
                self.resume()
            response.success, response.message = True, "paused" if self.paused else "ticks continue"
        except (UserError, TimeoutError) as error:
            response.success, response.message = False, str(error)
        return response

    def _on_step(self, _: Trigger.Request, response: Trigger.Response) -> Work | None:
        ticks = self._step_ticks()
        try:
            self.begin_step()
        except UserError as error:
            response.success, response.message = False, str(error)
            return None

        def work() -> None:
            response.success, response.message = step_result(self, ticks)

        return work


def step_result(pausing: Pausing, ticks: int) -> tuple[bool, str]:
    """Take the ticks of a step that was begun.

    pausing: takes them. Returns whether all were taken, and a line about it.
    """
    try:
        taken = pausing.take(ticks)
    except TimeoutError as error:
        return False, str(error)
    return taken == ticks, f"{taken} of {ticks} ticks were taken"
