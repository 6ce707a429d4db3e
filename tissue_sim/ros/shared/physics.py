"""The compiled loop in a thread of its own, and the mailboxes as Python methods."""

from __future__ import annotations

import ctypes
import os
import threading
import time
from functools import partial

import numpy as np

from tissue_sim.array_types import Floats, Longs, Mask
from tissue_sim.contact.finder import ContactSet
from tissue_sim.jit import handle
from tissue_sim.model import mailboxes as mb
from tissue_sim.model import realtime as rt
from tissue_sim.model import state as st
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.world import World
from tissue_sim.ros.shared.priority import prefer

_libc = ctypes.PyDLL(None)  # keeps the GIL: what is called here waits for nothing


class Physics:
    """Runs a simulation at its rate. Methods may be called from any one thread each.

    Everything that is posted is taken up by the next tick; the journal tells which.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.box = mb.make_mailboxes(simulation.buffer)
        self._box = handle(self.box)
        self.n_tools = len(simulation.shapes.kind)
        self._thread = threading.Thread(target=self._run, name="physics", daemon=True)
        self._journal_read = 0
        bell = ctypes.c_void_p(self.box.bell.ctypes.data)
        _libc.sem_init(bell, 0, 0)
        self._ring = partial(_libc.sem_post, bell)
        self._settings_lock = threading.Lock()
        self.post_settings(simulation.settings.copy())

    def _run(self) -> None:
        simulation = self.simulation
        # Settings of its own: those of the simulation change between ticks, when a parameter does.
        own = World(
            simulation.model, simulation.state, simulation.shapes, simulation.settings.copy(), simulation.scratch
        )
        run = rt.run_implied_loop if simulation.implied else rt.run_loop
        run(
            handle(own),
            self._box,
            simulation.buffer.floats,
            simulation.buffer.integers,
        )

    def start(self) -> None:
        """Start the loop; returns when it runs (compiling takes a while)."""
        self._thread.start()
        while self.box.control[mb.STARTED] == 0 and self._thread.is_alive():
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
        self.box.control[mb.STOP] = 1
        self._ring()
        if self._thread.is_alive() and self.box.control[mb.STARTED]:  # one that still compiles can't be stopped
            self._thread.join(timeout=0.5)

    @property
    def alive(self) -> bool:
        """True while the loop runs."""
        return self._thread.is_alive()

    # in ----------------------------------------------------------------------------------------
    def post_pose(self, tool: int, pose: Floats) -> int:
        """The newest pose (7,) of a tool; returns its sequence number."""
        sequence = int(self.box.pose_sequence[tool]) + 1
        self.box.pose[sequence % mb.IN_SLOTS, tool] = pose
        self.box.pose_sequence[tool] = sequence
        self._wake()
        return sequence

    def post_force(self, tool: int, force: Floats) -> int:
        """The newest external force (3,) N at a tool's tip; returns its sequence number."""
        sequence = int(self.box.force_sequence[tool]) + 1
        self.box.force[sequence % mb.IN_SLOTS, tool] = force
        self.box.force_sequence[tool] = sequence
        self._wake()
        return sequence

    def post_contacts(self, found: ContactSet) -> int:
        """The newest contact set; returns its sequence number."""
        box = self.box
        sequence = int(box.contact_sequence[0]) + 1
        slot, entries = sequence % mb.IN_SLOTS, len(found.tool)
        box.contact_entries[slot] = entries
        box.contact_tool[slot, :entries] = found.tool
        box.contact_node[slot, :entries] = found.node
        box.contact_weight[slot, :entries] = found.weight
        box.contact_normal[slot, :entries] = found.normal
        box.tip_node[slot] = found.tip_node
        box.tip_weight[slot] = found.tip_weight
        box.engaged[slot] = found.engaged
        box.contact_sequence[0] = sequence
        return sequence

    def post_settings(self, settings: Floats) -> int:
        """New settings (N_SETTINGS,); returns their sequence number."""
        with self._settings_lock:
            sequence = int(self.box.settings_sequence[0]) + 1
            self.box.settings[sequence % mb.IN_SLOTS] = settings
            self.box.settings_sequence[0] = sequence
            return sequence

    def settings(self) -> Floats:
        """The newest settings, a copy."""
        return self.box.settings[int(self.box.settings_sequence[0]) % mb.IN_SLOTS].copy()

    def reset(self) -> None:
        """Back to the rest shape before the next tick."""
        self.box.control[mb.RESETS] += 1
        self._wake()

    def follow_posted_time(self, follow: bool) -> None:
        """Let ticks follow the times of `post_time` instead of the monotonic clock, or no longer."""
        self.box.control[mb.SIM_TIME] = int(follow)
        self._ring()

    def post_time(self, nanoseconds: int) -> None:
        """The newest time of /clock: ticks up to it are due."""
        self.box.control[mb.POSTED_TIME] = nanoseconds
        self._ring()

    def _wake(self) -> None:
        if self.box.control[mb.NAPPING]:
            self._ring()

    # out ---------------------------------------------------------------------------------------
    @property
    def standing(self) -> bool:
        """True while ticks follow a posted time that has not come yet, or that has stood still for half a second."""
        return bool(self.box.control[mb.STANDING])

    @property
    def resets(self) -> int:
        """How often it was asked to go back to the rest shape."""
        return int(self.box.control[mb.RESETS])

    @property
    def tick_time(self) -> float:
        """Simulated time of a tick, s, by the newest settings."""
        return float(self.settings()[st.TICK_TIME])

    def wrenches(self) -> tuple[int, Floats]:
        """The newest tick and its wrenches (T, 6) N, N m; a copy. Tick -1 and zeros while the clock stands.

        A force that no tick renews must not stay in the hand.
        """
        if self.standing:
            return -1, np.zeros((self.n_tools, 6))
        while True:
            sequence = int(self.box.out_sequence[0])
            slot = sequence % mb.OUT_SLOTS
            wrench, tick = self.box.out_wrench[slot].copy(), int(self.box.out_count[slot, st.TICK])
            if int(self.box.out_sequence[0]) - sequence < mb.OUT_SLOTS - 1:
                return tick, wrench

    def counts(self) -> tuple[Longs, Longs]:
        """Newest counters (N_COUNT,) and tool counters (T, N_TOOL_COUNT); copies."""
        while True:
            sequence = int(self.box.out_sequence[0])
            slot = sequence % mb.OUT_SLOTS
            count, tools = self.box.out_count[slot].copy(), self.box.out_tool_count[slot].copy()
            if int(self.box.out_sequence[0]) - sequence < mb.OUT_SLOTS - 1:
                return count, tools

    @property
    def surface_sequence(self) -> int:
        """Raised whenever the positions moved."""
        control = self.box.control
        return int(control[mb.LOOP_TICKS] if control[mb.ON_DEMAND] else self.box.surface_sequence[0])

    def positions(self, out: Floats, timeout: float = 0.02) -> int:
        """Copy the newest positions into out (n, 3) m; returns their tick.

        With a modal region the loop works them out for this, after its next tick; when it doesn't within timeout s,
        they are the last ones that it did.
        """
        control = self.box.control
        if control[mb.ON_DEMAND]:
            asked = int(control[mb.SURFACE_ASKED]) + 1
            control[mb.SURFACE_ASKED] = asked
            deadline = time.monotonic() + timeout
            while control[mb.SURFACE_DONE] < asked and time.monotonic() < deadline and self.alive:
                time.sleep(2e-4)
        while True:
            sequence = int(self.box.surface_sequence[0])
            slot = sequence % mb.OUT_SLOTS
            np.copyto(out, self.box.surface[slot])
            tick = int(self.box.surface_tick[slot])
            if int(self.box.surface_sequence[0]) - sequence < mb.OUT_SLOTS - 1:
                return tick

    # For colours: read beside the running loop, so that a tick may write in between. Nothing else may rest on them.
    def contact_forces(self) -> Floats:
        """Size of the contact force on each node, (n,) N, as the last substep had it."""
        state = self.simulation.state
        count, _ = self.counts()  # of a whole tick: the running one has counted no contact until its first substep ends
        forces = np.zeros(len(state.position))
        if count[st.TOUCHING] == 0:
            return forces
        entries = int(count[st.ENTRIES])
        pressed, held = state.contact_pressed[0, :entries], state.contact_held[0, :entries]
        touching = np.flatnonzero(pressed > 0.0)
        impulse = np.sqrt(pressed[touching] ** 2 + np.einsum("ij,ij->i", held[touching], held[touching]))
        shares = state.contact_weight[touching] * impulse[:, None]
        np.add.at(forces, state.contact_node[touching], shares)
        return forces * (max(int(count[st.SUBSTEPS]), 1) / self.tick_time)

    def moving(self) -> Mask:
        """Which nodes the last tick integrated, (n,)."""
        state = self.simulation.state
        if state.count[st.ASLEEP]:
            return np.zeros(len(state.position), dtype=bool)
        if state.count[st.REGION] == st.WHOLE:
            return np.ones(len(state.position), dtype=bool)
        return np.asarray(state.region_hop >= 0)

    def snapshot(self, timeout: float = 1.0) -> tuple[Floats, Longs]:
        """The whole state after a tick: copies of the two buffers.

        Raises TimeoutError when the loop doesn't answer.
        """
        box = self.box
        box.control[mb.SNAPSHOT_ASKED] += 1
        end = time.monotonic() + timeout
        while box.control[mb.SNAPSHOT_DONE] != box.control[mb.SNAPSHOT_ASKED]:
            if time.monotonic() > end:
                raise TimeoutError("the physics loop gave no snapshot")
            time.sleep(0.0005)
        return box.snapshot_floats.copy(), box.snapshot_integers.copy()

    def journal(self) -> Longs:
        """Journal rows since the last call, (k, columns); ROW_* of model.mailboxes name the columns."""
        written = int(self.box.journal_written[0])
        first = max(self._journal_read, written - mb.JOURNAL_ROWS + 64)
        rows = self.box.journal[np.arange(first, written) % mb.JOURNAL_ROWS].copy()
        self._journal_read = written
        return rows
