"""An organ's mailboxes as Python methods."""

from __future__ import annotations

import threading
import time

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs, Mask
from tissue_sim.handles import handle
from tissue_sim.model.data.contact_set import ContactSet
from tissue_sim.model.data.records import words_of
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.state import Region, Results, results_in
from tissue_sim.model.joined import ExchangePlan
from tissue_sim.model.runtime import mailboxes as mb
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.shared.loop import Loop

LONGEST = 0.1  # s that a wrench may be published again without a new one


def unread_rows(read: int, written: int) -> Longs:
    """Return the places (k,) of a journal's rows from number `read` on, without those that the loop may overwrite."""
    return np.arange(max(read, written - mb.JOURNAL_ROWS + 64), written) % mb.JOURNAL_ROWS


class Physics:
    """One organ of a running loop; methods may be called from any one thread each.

    Everything that is posted is applied by the next tick; the journal says which.

    organ: number of the organ in the loop.
    """

    def __init__(self, loop: Loop, organ: int = 0) -> None:
        self.loop, self._number = loop, organ
        self.version = 0  # raised whenever the organ was exchanged for one of other nodes
        self._pose, self._force = handle(self.box.pose), handle(self.box.force)
        self._contacts, self._settings = handle(self.box.contacts), handle(self.box.settings)
        self._results = handle(self.box.results)
        self._shape = handle(self.box.shape), len(self.simulation.state.shape)
        self.n_bodies = len(self.simulation.shapes.kind)
        self._journal_read = 0
        self._oldest = 0  # ns, the age up to which a wrench may be published
        self.stale_time = self.ramp_time = self.tick_time = 0.0  # s, of the newest settings
        self.force_clamp = 0.0  # N, of these
        size = len(self.simulation.state.results)
        place = results_in(np.arange(size), self.n_bodies)  # positions of the haptic output in these words
        self._result_words, self._tick_at = size, int(place.status.tick)
        self._wrench_at = place.wrench.view(np.int64).copy()
        self._taken_at = np.array(place.bodies.pose_sequence)
        self._settings_lock = threading.Lock()
        self.post_settings(self.simulation.settings)

    @property
    def simulation(self) -> Simulation:
        """The simulation that the loop advances now."""
        return self.loop.simulations[self._number]

    @property
    def box(self) -> mb.Mailboxes:
        """Its mailboxes."""
        return self.loop.boxes[self._number]

    @property
    def answers(self) -> bool:
        """Whether the loop's last post is younger than a tool's force may be without poses, or two ticks."""
        return self.loop.answers_within(self._oldest)

    # in ----------------------------------------------------------------------------------------
    def post_pose(self, body: int, pose: Floats, stamp: int = 0) -> int:
        """Post the newest pose of a tool's body; return its sequence number.

        The next tick applies it; `Loop.wake` requests one, once everything that belongs together has been posted.

        pose (7,) m and quaternion xyzw; stamp: its time, ns.
        """
        words = np.empty(mb.POSE_WORDS, dtype=np.int64)
        words[:7], words[7] = pose.view(np.int64), stamp
        return int(mb.put(self._pose, body, words))

    def post_force(self, body: int, force: Floats) -> int:
        """Post the newest external force at the tip of a body; return its sequence number.

        force (3,) N.
        """
        return int(mb.put(self._force, body, force.view(np.int64)))

    def post_contacts(self, found: ContactSet) -> int:
        """Post the newest contact set; return its sequence number."""
        return int(mb.put(self._contacts, 0, found.words))

    def post_settings(self, settings: Settings) -> int:
        """Post new settings; return their sequence number."""
        with self._settings_lock:
            self.stale_time, self.ramp_time = float(settings.stale_time), float(settings.ramp_time)
            self.tick_time, self.force_clamp = float(settings.tick_time), float(settings.force_clamp)
            lasts = min(self.stale_time + self.ramp_time, LONGEST)
            self._oldest = round(1e9 * max(lasts, 2.0 * self.tick_time))
            return int(mb.put(self._settings, 0, words_of(settings)))

    def settings(self) -> Settings:
        """Return a copy of the newest settings."""
        words = np.empty(Settings.words(), dtype=np.int64)
        mb.take(self._settings, 0, 0, words)
        return Settings.at(words)

    def exchange(self, made: Simulation, plan: ExchangePlan | None = None, patience: float | None = None) -> int:
        """Go on with a simulation that continues this organ's, see Loop.exchange; return the first tick with it.

        plan: what changes for all organs, None for an organ alone; patience: how long to wait for that tick, None: as
        long as a running loop may take, s.
        """
        tick = self.loop.exchange(self._number, made, plan, patience)
        self.version += 1  # before others can read the new positions
        self._shape = handle(self.box.shape), len(made.state.shape)
        return tick

    # out ---------------------------------------------------------------------------------------
    def results(self) -> Results:
        """Return a copy of what the newest tick posted."""
        return results_in(self._newest(), self.n_bodies)

    def _newest(self) -> Longs:
        words = np.zeros(self._result_words, dtype=np.int64)
        mb.take(self._results, 0, 0, words)
        return words

    def taken(self) -> Longs:
        """Return the sequence number of each body's pose that the newest tick had applied, (T,); 0: none."""
        return np.asarray(self._newest()[self._taken_at])

    def wrenches(self) -> tuple[int, Floats]:
        """Return the newest tick and a copy of its wrenches (T, 6) N, N m.

        Tick -1 and zeros while the clock or the loop stands: a force that no tick renews must not stay in the hand.
        """
        if self.loop.standing or not self.answers:
            return -1, np.zeros((self.n_bodies, 6))
        words = self._newest()
        return int(words[self._tick_at]), words[self._wrench_at].view(np.float64)

    @property
    def surface_sequence(self) -> int:
        """Number that rises whenever the positions moved."""
        return self.loop.ticks if self.box.demand.on_demand else int(self.box.shape.sequence[0])

    def positions(self, out: Floats, timeout: float = 0.02) -> tuple[int, Floats]:
        """Copy the newest positions; return their tick, and the (3,) m that breathing adds to them.

        With a modal region the loop computes them for this, after its next tick; when it doesn't in time, they are the
        last ones that it computed. Of an organ that was cut meanwhile, `out` gets the nodes that it has room for.

        out (n, 3) m: the positions (updated); timeout: that time, s.
        """
        demand = self.box.demand
        if demand.on_demand:
            asked = int(demand.asked) + 1
            demand.asked = asked
            deadline = time.monotonic() + timeout
            while demand.done < asked and time.monotonic() < deadline and self.loop.alive:
                time.sleep(2e-4)
        shape, size = self._shape
        words = np.zeros(size, dtype=np.int64)
        mb.take(shape, 0, 0, words)
        numbers = words[1:].view(np.float64)
        flat = out.reshape(-1)
        shared = min(len(flat), size - 4)
        flat[:shared] = numbers[3 : 3 + shared]
        return int(words[0]), numbers[:3]

    # For colours only: they are read beside the running loop, so that a tick may write in between.
    def contact_forces(self) -> Floats:
        """Return the size of the contact force on each node in the last substep, (n,) N."""
        state, contacts = self.simulation.state, self.simulation.state.contacts
        status = self.results().status  # of a whole tick: the running one has counted no contact so far
        forces = np.zeros(len(state.position))
        if status.touching == 0:
            return forces
        points = int(contacts.header.points)
        pressed, held = state.contact_pressed[0, :points], state.contact_held[0, :points]
        touching = np.flatnonzero(pressed > 0.0)
        impulse = np.sqrt(pressed[touching] ** 2 + np.einsum("ij,ij->i", held[touching], held[touching]))
        parts = contacts.weight[touching] * impulse[:, None]
        np.add.at(forces, contacts.node[touching], parts)
        return forces * (max(status.substeps, 1) / self.tick_time)

    def moving(self) -> Mask:
        """Return which nodes the last tick integrated, (n,)."""
        state = self.simulation.state
        if state.status.asleep:
            return np.zeros(len(state.position), dtype=bool)
        if state.status.region == Region.WHOLE:
            return np.ones(len(state.position), dtype=bool)
        return np.asarray(state.region_hop >= 0)

    def snapshot(self, timeout: float = 1.0) -> Longs:
        """Return a copy of the words of the whole state after a tick.

        timeout: the longest time, s. Raises TimeoutError when the loop doesn't answer.
        """
        with self.loop.snapshots(timeout):
            return self.box.snapshot.copy()

    def journal(self) -> tuple[NDArray[np.record], NDArray[np.record]]:
        """Return what ticks applied since the last call: (k,) of JournalRow, and (k, T) of BodyInputs."""
        written = int(self.box.journal_written[0])
        chosen = unread_rows(self._journal_read, written)
        self._journal_read = written
        return self.box.journal[chosen], self.box.journal_inputs[chosen]
