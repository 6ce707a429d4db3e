"""The compiled loop over all organs in a thread of its own."""

from __future__ import annotations

import ctypes
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from tissue_sim.errors import UserError
from tissue_sim.handles import handle, place_of, row
from tissue_sim.memory import provide
from tissue_sim.model.data.records import copy_of, field_of
from tissue_sim.model.data.world import World, make_world
from tissue_sim.model.joined import ExchangePlan, Joined
from tissue_sim.model.runtime import loop as rt
from tissue_sim.model.runtime import mailboxes as mb
from tissue_sim.model.runtime.exchange import boxes_after, make_exchange, take_exchange
from tissue_sim.model.runtime.joined_box import make_joined_box
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.contact_pairs import OrganContactSet, used_words
from tissue_sim.ros.shared.pause_control import PauseControl
from tissue_sim.ros.shared.priority import prefer

_libc = ctypes.PyDLL(None)  # keeps the GIL: functions called here never wait
_waiting_libc = ctypes.CDLL(None)
EXCHANGE_TIME = 5.0  # s after which a loop that runs counts as hanging


class Loop:
    """Ticks a scene's simulations at the rate of the first one. Methods may be called from any one thread each.

    boxes: the mailboxes of each, see `physics.Physics`; joined_box: those of all.
    """

    def __init__(self, joined: Joined) -> None:
        self.simulations, self.joined = tuple(joined.simulations), joined
        self.boxes = tuple(mb.make_mailboxes(one.state) for one in self.simulations)
        self.words = mb.make_loop_words()
        self.joined_box = make_joined_box(len(self.simulations[0].shapes.kind))
        self._pairs, self._respiration = handle(self.joined_box.pairs), handle(self.joined_box.respiration)
        self._thread = threading.Thread(target=self._run, name="physics", daemon=True)
        self.ended = False  # without having been stopped
        self.failure: BaseException | None = None  # error that ended it
        self._bell = ctypes.c_void_p(self.words.bell.ctypes.data)
        self._answered = ctypes.c_void_p(self.words.answered.ctypes.data)
        control = self.words.control
        self._asked, self._waiting = field_of(control, "asked"), field_of(control, "waiting")
        self._napping, self._standing = field_of(control, "napping"), field_of(control, "standing")
        self._last_wait, self._sim_time = field_of(control, "last_wait"), field_of(control, "sim_time")
        self._snapshot_lock = threading.Lock()  # held while a thread reads the requested states
        for semaphore in (self._bell, self._answered):
            _libc.sem_init(semaphore, 0, 0)
        # Separate settings: those of a simulation change between ticks, when a parameter does.
        self._settings = [copy_of(one.settings) for one in self.simulations]
        self._world_handles = [self._world_of(one, organ) for organ, one in enumerate(self.simulations)]
        self._box_handles = [handle(box) for box in self.boxes]
        self._worlds, self._box_row = row(self._world_handles), row(self._box_handles)
        links = len(joined.links.lightness)
        self._exchange = make_exchange(self._worlds, self._box_row, self._world_handles[0], self._box_handles[0], links)
        self.pause = PauseControl(self)
        self.before_reset: list[Callable[[], None]] = []  # called first: they exchange cut organs

    def _run(self) -> None:
        try:
            self._tick_on()
        except Exception as error:  # the node reports it, and ends
            self.failure = error
        self.ended = not self.words.control.stop or self.failure is not None

    def _tick_on(self) -> None:
        joined = self.joined.handle, handle(self.joined_box)
        rt.run_loop(self._worlds, self._box_row, handle(self.words), *joined, handle(self._exchange))

    def _world_of(self, simulation: Simulation, organ: int) -> World:
        """Return the handle of a simulation's world with the settings that the loop applies."""
        one = simulation
        return handle(make_world(one.model, one.state, one.shapes, self._settings[organ], one.scratch))

    def start(self) -> None:
        """Start the loop; return when it runs (compiling takes a while)."""
        self._thread.start()
        while not self.words.control.started and self._thread.is_alive():
            time.sleep(0.01)

    def prefer(self, priority: int) -> None:
        """Give the running loop a priority, see `priority.prefer`."""
        prefer(priority, self._thread.native_id or 0)

    @property
    def priority(self) -> int:
        """Real-time priority of the loop, 0 where it is a thread like others."""
        return os.sched_getparam(self._thread.native_id or 0).sched_priority if self.alive else 0

    def stop(self) -> None:
        """End the loop after the running tick."""
        control = self.words.control
        control.stop = True
        self._ring()
        if self._thread.is_alive() and control.started:  # one that still compiles can't be stopped
            self._thread.join(timeout=0.5)

    @property
    def alive(self) -> bool:
        """Whether the loop runs."""
        return self._thread.is_alive()

    def answers_within(self, age: int) -> bool:
        """Return whether the loop is there and posts its state: False where it hangs or gets no time to run.

        A loop that waits for /clock wakes less often.

        age: largest age of its last post, ns.
        """
        if self.ended:
            return False
        oldest = age + (rt.STOP_CHECK_INTERVAL if self._sim_time[0] else 0)
        return bool(time.monotonic_ns() - self._last_wait[0] <= oldest)

    @property
    def standing(self) -> bool:
        """Whether no tick is due: the loop is paused, or the clock that it follows stands."""
        return self.pause.active or self.clock_stands

    @property
    def clock_stands(self) -> bool:
        """Whether ticks follow a posted time that has not come yet, or has stood still for half a second."""
        return bool(self._standing[0]) and not self.pause.active

    @property
    def tick_time(self) -> float:
        """Simulated time of the next tick, by the settings that the last one applied, s."""
        return float(self._settings[0].tick_time)

    @property
    def ticks(self) -> int:
        """Number of ticks done."""
        return int(self.words.control.loop_ticks)

    # in ----------------------------------------------------------------------------------------
    def wake(self) -> None:
        """Request a tick at once, so that posted inputs don't wait."""
        self._asked[0] += 1
        if self._waiting[0] or self._napping[0]:
            self._ring()

    def _ring(self) -> None:
        _libc.sem_post(self._bell)

    def reset(self) -> None:
        """Return all organs to the rest shape before the next tick, uncut."""
        for heal in self.before_reset:
            heal()
        self.reset_again()

    def reset_again(self) -> None:
        """Return all organs to the rest shape before the next tick, with the cuts that they have."""
        self.words.control.resets += 1
        self.wake()

    @property
    def resets(self) -> int:
        """Number of resets requested."""
        return int(self.words.control.resets)

    def post_respiration(self, fraction: float) -> int:
        """Post where the breath is to be, as a fraction of its displacement; return its sequence number."""
        return int(mb.put(self._respiration, 0, np.array([fraction]).view(np.int64)))

    def post_organ_contacts(self, found: OrganContactSet) -> int:
        """Post the pairs in which joined organs touch each other; return its sequence number."""
        words = used_words(found)
        return int(mb.put(self._pairs, 0, words if found.points[0] else np.append(words, 0)))

    def follow_posted_time(self, follow: bool) -> None:
        """Let ticks follow the times of `post_time` instead of the monotonic clock, or no longer.

        follow: whether they do.
        """
        self.words.control.sim_time = follow
        self._ring()

    def post_time(self, nanoseconds: int) -> None:
        """Post the newest time of /clock, ns: ticks up to it are due."""
        self.words.control.posted_time = nanoseconds
        self._ring()

    def exchange(
        self, organ: int, made: Simulation, plan: ExchangePlan | None = None, patience: float | None = None
    ) -> int:
        """Go on with a simulation that continues one of the organs; return the first tick with it.

        A paused loop takes it up at once.

        made: the simulation, whose `carry_plan` fits the one in use; plan: what changes for all organs, None for an
        organ alone; patience: how long to wait for the tick, None: as long as a running loop may take, s. Raises
        UserError when the clock that ticks follow stands; TimeoutError when the loop doesn't answer.
        """
        if self.clock_stands and patience is None:
            raise UserError("the clock that ticks follow stands, so that no tick takes up the cut; publish /clock")
        box = boxes_after(self.boxes[organ], made.state, made.carry_plan)
        provide((made.model, made.state.words, made.scratch, box.shape, box.carry))
        world_handle, box_handle = self._world_of(made, organ), handle(box)
        exchange, words = self._exchange, self._exchange.words
        with self._snapshot_lock, self.pause.kept() as is_paused:
            exchange.next_world[0], exchange.next_box[0] = place_of(world_handle), place_of(box_handle)
            words.organ = organ
            if plan is not None:
                words.coarse_square, words.added, words.version = plan.coarse_square, plan.added, plan.version
                exchange.lightness[:] = plan.lightness
            words.asked += 1
            if is_paused:
                take_exchange(self._worlds, self._box_row, self.joined.handle, handle(exchange))
                mb.post_results(world_handle, box_handle)
                words.done = words.asked
            else:
                self.wake()
                self._wait_for(lambda: words.done == words.asked, patience or EXCHANGE_TIME, "took up no cut")
            self._world_handles[organ], self._box_handles[organ] = world_handle, box_handle
            self.simulations = _with(self.simulations, organ, made)
            self.boxes = _with(self.boxes, organ, box)
        return int(words.tick)

    # out ---------------------------------------------------------------------------------------
    def wait_for_answer(self, longest: float) -> bool:
        """Wait for the end of a requested tick, at most so many s; return whether there was one."""
        end = time.monotonic_ns() + round(1e9 * longest)
        timespec = (ctypes.c_long * 2)(*divmod(end, 1_000_000_000))
        return bool(_waiting_libc.sem_clockwait(self._answered, rt.CLOCK_MONOTONIC, timespec) == 0)

    @contextmanager
    def snapshots(self, timeout: float = 1.0) -> Iterator[None]:
        """Provide the whole state after one tick in the boxes of all organs, whether or not another thread requests it.

        timeout: the longest time, s. Raises TimeoutError when the loop doesn't answer.
        """
        with self._snapshot_lock:
            self.take_snapshots(timeout)
            yield

    def take_snapshots(self, timeout: float = 1.0) -> None:
        """Copy the whole state after one tick to the boxes of all organs.

        timeout: the longest time, s. Raises TimeoutError when the loop doesn't answer.
        """
        control = self.words.control
        control.snapshot_asked += 1
        self._wait_for(lambda: control.snapshot_done == control.snapshot_asked, timeout, "gave no snapshot")

    def _wait_for(self, done: Callable[[], bool], timeout: float, lack: str) -> None:
        end = time.monotonic() + timeout
        while not done():
            if time.monotonic() > end:
                raise TimeoutError(f"the physics loop {lack}")
            time.sleep(0.0005)


def _with[T](items: Sequence[T], index: int, item: T) -> tuple[T, ...]:
    """Return items with another one at an index."""
    return (*items[:index], item, *items[index + 1 :])
