"""The compiled loop in a thread of its own, and the mailboxes as Python methods."""

from __future__ import annotations

import ctypes
import os
import threading
import time
from functools import partial
from typing import Any

import numpy as np

from tissue_sim.array_types import Floats, Longs, Mask
from tissue_sim.jit import handle
from tissue_sim.model import mailboxes as mb
from tissue_sim.model import realtime as rt
from tissue_sim.model.contact_set import ContactSet
from tissue_sim.model.records import copy_of, words_of
from tissue_sim.model.settings import Settings
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.state import Region, Results, results_in
from tissue_sim.model.world import make_world
from tissue_sim.ros.shared.priority import prefer

LONGEST = 0.1  # s that a wrench may go out without a new one, however late a tool's poses may come

_libc = ctypes.PyDLL(None)  # keeps the GIL: what is called here waits for nothing


class Physics:
    """Runs a simulation at its rate. Methods may be called from any one thread each.

    Everything that is posted is taken up by the next tick; the journal tells which.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.box = mb.make_mailboxes(simulation.state)
        self._box = handle(self.box)
        self._pose, self._force = handle(self.box.pose), handle(self.box.force)
        self._contacts, self._settings = handle(self.box.contacts), handle(self.box.settings)
        self._results, self._shape = handle(self.box.results), handle(self.box.shape)
        self.n_bodies = len(simulation.shapes.kind)
        self._thread = threading.Thread(target=self._run, name="physics", daemon=True)
        self._journal_read = 0
        self.ended = False  # the loop, though nobody has asked for that
        self.failure: BaseException | None = None  # what ended it
        self._oldest = 0  # ns, the age up to which a wrench may go out
        bell = ctypes.c_void_p(self.box.bell.ctypes.data)
        _libc.sem_init(bell, 0, 0)
        self._ring = partial(_libc.sem_post, bell)
        self._settings_lock = threading.Lock()
        self.post_settings(simulation.settings)

    def _run(self) -> None:
        try:
            self._loop()
        except Exception as error:  # the node tells, and ends
            self.failure = error
        self.ended = not self.box.control.stop or self.failure is not None

    def _loop(self) -> None:
        simulation = self.simulation
        # Settings of its own: those of the simulation change between ticks, when a parameter does.
        own = copy_of(simulation.settings)
        world = make_world(simulation.model, simulation.state, simulation.shapes, own, simulation.scratch)
        run = rt.run_implied_loop if simulation.implied else rt.run_loop
        run(handle(world), self._box)

    def start(self) -> None:
        """Start the loop; returns when it runs (compiling takes a while)."""
        self._thread.start()
        while not self.box.control.started and self._thread.is_alive():
            time.sleep(0.01)

    def prefer(self, priority: int) -> None:
        """Let the running loop go before other threads, see `priority.prefer`."""
        prefer(priority, self._thread.native_id or 0)

    @property
    def priority(self) -> int:
        """Real-time priority of the loop, 0 where it is a thread like others."""
        return os.sched_getparam(self._thread.native_id or 0).sched_priority if self.alive else 0

    def stop(self) -> None:
        """End the loop after the running tick."""
        self.box.control.stop = True
        self._ring()
        if self._thread.is_alive() and self.box.control.started:  # one that still compiles can't be stopped
            self._thread.join(timeout=0.5)

    @property
    def alive(self) -> bool:
        """True while the loop runs."""
        return self._thread.is_alive()

    @property
    def answers(self) -> bool:
        """False while the loop is not there, hangs, or gets no time to run: what it handed out last is old.

        Older than what a tool may feel without poses, that is, or than two ticks; a loop that waits for /clock looks
        up less often.
        """
        if self.ended:
            return False
        control = self.box.control
        oldest = self._oldest + (rt.LOOK_UP if control.sim_time else 0)
        return bool(time.monotonic_ns() - control.looked_up <= oldest)

    # in ----------------------------------------------------------------------------------------
    def post_pose(self, body: int, pose: Floats, stamp: int = 0) -> int:
        """The newest pose (7,) of a tool's body, and its stamp, ns; returns its sequence number."""
        words = np.empty(mb.POSE_WORDS, dtype=np.int64)
        words[:7], words[7] = pose.view(np.int64), stamp
        return self._put(self._pose, body, words)

    def post_force(self, body: int, force: Floats) -> int:
        """The newest external force (3,) N at the tip of a body; returns its sequence number."""
        return self._put(self._force, body, force.view(np.int64))

    def post_contacts(self, found: ContactSet) -> int:
        """The newest contact set; returns its sequence number."""
        return int(mb.put(self._contacts, 0, found.words))

    def post_settings(self, settings: Settings) -> int:
        """New settings; returns their sequence number."""
        with self._settings_lock:
            lasts = min(settings.stale_time + settings.ramp_time, LONGEST)
            self._oldest = round(1e9 * max(lasts, 2.0 * settings.tick_time))
            return int(mb.put(self._settings, 0, words_of(settings)))

    def settings(self) -> Settings:
        """The newest settings, a copy."""
        words = np.empty(Settings.words(), dtype=np.int64)
        mb.take(self._settings, 0, 0, words)
        return Settings.at(words)

    def _put(self, box: Any, body: int, message: Longs) -> int:
        sequence = int(mb.put(box, body, message))
        self._wake()
        return sequence

    def _wake(self) -> None:
        if self.box.control.napping:
            self._ring()

    def reset(self) -> None:
        """Back to the rest shape before the next tick."""
        self.box.control.resets += 1
        self._wake()

    def follow_posted_time(self, follow: bool) -> None:
        """Let ticks follow the times of `post_time` instead of the monotonic clock, or no longer."""
        self.box.control.sim_time = follow
        self._ring()

    def post_time(self, nanoseconds: int) -> None:
        """The newest time of /clock: ticks up to it are due."""
        self.box.control.posted_time = nanoseconds
        self._ring()

    # out ---------------------------------------------------------------------------------------
    @property
    def standing(self) -> bool:
        """True while ticks follow a posted time that has not come yet, or that has stood still for half a second."""
        return bool(self.box.control.standing)

    @property
    def resets(self) -> int:
        """How often it was asked to go back to the rest shape."""
        return int(self.box.control.resets)

    @property
    def tick_time(self) -> float:
        """Simulated time of a tick, s, by the newest settings."""
        return float(self.settings().tick_time)

    def results(self) -> Results:
        """What the newest tick handed out; a copy."""
        words = np.zeros(len(self.simulation.state.results), dtype=np.int64)
        mb.take(self._results, 0, 0, words)
        return results_in(words, self.n_bodies)

    def wrenches(self) -> tuple[int, Floats]:
        """The newest tick and its wrenches (T, 6) N, N m; a copy. Tick -1 and zeros while the clock or the loop stands.

        A force that no tick renews must not stay in the hand.
        """
        if self.standing or not self.answers:
            return -1, np.zeros((self.n_bodies, 6))
        newest = self.results()
        return newest.status.tick, newest.wrench

    @property
    def surface_sequence(self) -> int:
        """Raised whenever the positions moved."""
        control = self.box.control
        return int(control.loop_ticks if control.on_demand else self.box.shape.sequence[0])

    def positions(self, out: Floats, timeout: float = 0.02) -> int:
        """Copy the newest positions into out (n, 3) m; returns their tick.

        With a modal region the loop works them out for this, after its next tick; when it doesn't within timeout s,
        they are the last ones that it did.
        """
        control = self.box.control
        if control.on_demand:
            asked = int(control.surface_asked) + 1
            control.surface_asked = asked
            deadline = time.monotonic() + timeout
            while control.surface_done < asked and time.monotonic() < deadline and self.alive:
                time.sleep(2e-4)
        words = np.zeros(len(self.simulation.state.shape), dtype=np.int64)
        mb.take(self._shape, 0, 0, words)
        out.reshape(-1)[:] = words[1:].view(np.float64)
        return int(words[0])

    # For colours: read beside the running loop, so that a tick may write in between. Nothing else may rest on them.
    def contact_forces(self) -> Floats:
        """Size of the contact force on each node, (n,) N, as the last substep had it."""
        state, contacts = self.simulation.state, self.simulation.state.contacts
        status = self.results().status  # of a whole tick: the running one has counted no contact so far
        forces = np.zeros(len(state.position))
        if status.touching == 0:
            return forces
        points = int(contacts.header.points)
        pressed, held = state.contact_pressed[0, :points], state.contact_held[0, :points]
        touching = np.flatnonzero(pressed > 0.0)
        impulse = np.sqrt(pressed[touching] ** 2 + np.einsum("ij,ij->i", held[touching], held[touching]))
        shares = contacts.weight[touching] * impulse[:, None]
        np.add.at(forces, contacts.node[touching], shares)
        return forces * (max(status.substeps, 1) / self.tick_time)

    def moving(self) -> Mask:
        """Which nodes the last tick integrated, (n,)."""
        state = self.simulation.state
        if state.status.asleep:
            return np.zeros(len(state.position), dtype=bool)
        if state.status.region == Region.WHOLE:
            return np.ones(len(state.position), dtype=bool)
        return np.asarray(state.region_hop >= 0)

    def snapshot(self, timeout: float = 1.0) -> Longs:
        """The words of the whole state after a tick; a copy.

        Raises TimeoutError when the loop doesn't answer.
        """
        control = self.box.control
        control.snapshot_asked += 1
        end = time.monotonic() + timeout
        while control.snapshot_done != control.snapshot_asked:
            if time.monotonic() > end:
                raise TimeoutError("the physics loop gave no snapshot")
            time.sleep(0.0005)
        return self.box.snapshot.copy()

    def journal(self) -> tuple[Any, Any]:
        """What ticks took up since the last call: (k,) of JournalRow, and (k, T) of BodyInputs."""
        written = int(self.box.journal_written[0])
        chosen = np.arange(max(self._journal_read, written - mb.JOURNAL_ROWS + 64), written) % mb.JOURNAL_ROWS
        self._journal_read = written
        return self.box.journal[chosen], self.box.journal_inputs[chosen]
