"""An organ's part of a bag."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tissue_sim.array_types import Array, Floats
from tissue_sim.model.data.contact_set import ContactSet
from tissue_sim.model.data.records import array_of
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.state import fields_of, state_like
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.bags import bag
from tissue_sim.ros.bags.bag_messages import BagMessages
from tissue_sim.ros.bags.recorded_cut import fields_of_cut
from tissue_sim.ros.shared.client import wait_until
from tissue_sim.ros.shared.messages import CloudTemplate, rest_mesh
from tissue_sim.ros.shared.physics import Physics
from tissue_sim.ros.shared.shown_organ import ShownOrgan

STATE_WAIT = 2.0  # s, at most, for a state, which comes within 0.2
BodyContact = tuple[float, int, bool]  # the fields of bag.BodyContactRow


@dataclass
class _Notes:
    """Rows that wait for the journal."""

    contacts: list[tuple[int, int, int]] = field(default_factory=list)
    body_contacts: list[list[BodyContact]] = field(default_factory=list)
    surfaces: list[tuple[int]] = field(default_factory=list)

    def arrays(self, n_bodies: int) -> dict[str, Array]:
        """Return the rows as arrays of records."""
        by_body = np.array(self.body_contacts, dtype=bag.BodyContactRow.dtype)
        return {
            "contacts": np.array(self.contacts, dtype=bag.ContactRow.dtype),
            "body_contacts": by_body.reshape(len(self.body_contacts), n_bodies),
            "surfaces": np.array(self.surfaces, dtype=bag.SurfaceRow.dtype),
        }


class OrganRecorder:
    """Recorder of what an organ applied and showed, while `messages` has a bag open.

    below: the topics' absolute prefix.
    """

    def __init__(self, messages: BagMessages, below: str, physics: Physics) -> None:
        self.lock, self.physics = messages.lock, physics
        self.names = {name: f"{below}/{name}" for name in bag.ORGAN_TOPICS}
        self._messages = messages
        self._file, self._file_version = b"", -1
        self._cut: dict[str, Array] | None = None  # the newest, as it is recorded
        self.exchanging = threading.Lock()  # held while the loop goes on with another organ: no bag begins meanwhile
        self._notes = _Notes()
        self._newest_set: tuple[int, ContactSet] | None = None
        self.state_tick = self.shown_tick = -1  # of the state, and of the newest surface, in the bag; -1: none

    @property
    def active(self) -> bool:
        """Whether messages are recorded."""
        return self._messages.active

    # life --------------------------------------------------------------------------------------
    def prepare(self) -> None:
        """Do what takes a while, before a bag begins."""
        version = self.physics.version
        if version != self._file_version:
            self._file, self._file_version = self.physics.simulation.organ.to_bytes(), version

    def begin(self) -> None:
        """Begin a bag with the organ itself; call this and the following methods with `lock` held."""
        self.physics.journal()  # rows of ticks before this bag
        self._notes, self.state_tick, self.shown_tick = _Notes(), -1, -1
        self._messages.octets(self.names["organ"], np.frombuffer(self._file, dtype=np.uint8))
        self._messages.put(self.names["mesh"], rest_mesh(ShownOrgan.of(self.physics.simulation)))
        if self._cut is not None:
            self._messages.packed(self.names["cut"], self._cut | {"tick": np.array(-1)})

    def begin_inputs(self) -> None:
        """Record the newest of every input: on a busy machine the loop may apply it only after the state."""
        if self._newest_set is not None:
            self._whole_set(*self._newest_set)
        self.settings(int(self.physics.box.settings.sequence[0]), self.physics.settings())

    def state(self) -> int:
        """Record the state that the loop has posted; return its tick."""
        state = state_like(self.physics.simulation.state)
        state.words[:] = self.physics.box.snapshot
        self._messages.packed(self.names["state"], fields_of(state))
        self.state_tick = int(state.status.tick)
        return self.state_tick

    def wait_for_state(self) -> None:
        """Wait until a bag that has just begun has a state: it must be that of the organ which the bag began with.

        Call it with `exchanging` held, and not in the thread that records states.
        """
        wait_until(lambda: not self.active or self.state_tick >= 0, STATE_WAIT)

    def rows(self) -> dict[str, Array]:
        """Return the journal's rows since the last call; call it with `lock` held."""
        inputs, body_inputs = self.physics.journal()
        noted, self._notes = self._notes, _Notes()
        return {"inputs": inputs, "body_inputs": body_inputs} | noted.arrays(self.physics.n_bodies)

    # what happens ------------------------------------------------------------------------------
    def mesh(self, mesh: bytes) -> None:
        """Record a rest surface that a cut has changed, by the bytes of its message."""
        with self.lock:
            if self.active:
                self._messages.put(self.names["mesh"], mesh)

    def cut(self, tick: int, made: Simulation, file: bytes) -> None:
        """Record a simulation that the loop goes on with after a cut, or after the reset of its cuts.

        tick: the first tick with it; file: content of its organ's file.
        """
        fields = fields_of_cut(self.physics.version, tick, made, file)
        with self.lock:
            self._cut = fields if made.cuts else None
            if self.active:
                self._messages.packed(self.names["cut"], fields)

    def searched(self, first_set: int) -> None:
        """Record which contact set is the first that was found on the surface after the newest cut.

        Call it with `lock` held.
        """
        numbers = {"number": np.array(self.physics.version), "first_set": np.array(first_set)}
        if self._cut is not None:
            self._cut["first_set"] = numbers["first_set"]
        if self.active:
            self._messages.packed(self.names["cut"], numbers)

    def surface(self, tick: int, surface: bytes, skeleton: bytes, markers: bytes | None) -> None:
        """Record a published surface, skeleton and, if wanted, markers.

        tick: the tick that they show.
        """
        with self.lock:
            if not self.active:
                return
            self._surface(tick, surface)
            self._messages.put(self.names["skeleton"], skeleton)
            if markers is not None:
                self._messages.put(self.names["markers"], markers)

    def last_shape(self, frame_id: str) -> None:
        """Record the surface that the loop has posted, also of an organ that sleeps, which nothing publishes.

        Call it where the state is posted, with `exchanging` held.

        frame_id: frame of the surface.
        """
        shown = ShownOrgan.of(self.physics.simulation)
        tick, nodes = self._posted()
        rows = np.zeros((shown.n_rows, 3))
        shown.fill(rows, nodes)
        cloud = CloudTemplate(frame_id, shown.n_points, ("x", "y", "z"))
        cloud.points[:] = shown.points(rows)
        with self.lock:
            if self.active and tick > self.state_tick:
                self._surface(tick, cloud.message(time.time_ns()))

    def _posted(self) -> tuple[int, Floats]:
        """Return the tick of the posted state, and the nodes' positions then, (n, 3) m."""
        simulation = self.physics.simulation
        if self.physics.box.demand.on_demand:  # the loop computes them for those who ask
            nodes = simulation.organ.rest_positions.copy()
            tick, carried = self.physics.positions(nodes)
            return tick, nodes + carried
        state = state_like(simulation.state)
        state.words[:] = self.physics.box.snapshot
        return int(state.status.tick), state.position + state.carried

    def _surface(self, tick: int, surface: bytes) -> None:
        """Record a surface; call it with `lock` held."""
        if self._messages.put(self.names["surface"], surface):
            self._notes.surfaces.append((tick,))
            self.shown_tick = max(self.shown_tick, tick)

    def settings(self, sequence: int, settings: Settings) -> None:
        """Record new settings; call it with `lock` held since they were posted. sequence: their number."""
        if self.active:
            fields = {"sequence": np.array(sequence), "settings": array_of(settings)}
            self._messages.packed(self.names["settings"], fields)

    def contacts(self, sequence: int, ticks: tuple[int, int], found: ContactSet, bodies: Sequence[BodyContact]) -> None:
        """Record what a contact set was found from, or all of it while that may not be in the bag.

        Call it with `lock` held since it was posted.

        ticks: tick of its surface, and of the tools' places; bodies: rows of its bodies.
        """
        self._newest_set = sequence, found
        if not self.active:
            return
        self._notes.contacts.append((sequence, *ticks))
        self._notes.body_contacts.append(list(bodies))
        if self.state_tick < 0 or min(ticks) <= self.state_tick:
            self._whole_set(sequence, found)

    def _whole_set(self, sequence: int, found: ContactSet) -> None:
        found.header.sequence = sequence
        fields: Mapping[str, Array] = {
            name: array_of(value) for name, value in found._asdict().items() if name != "words"
        }
        self._messages.packed(self.names["contact_set"], fields)
