"""Writes what came in, what went out and why to an MCAP bag, off the tick path."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.qos import QoSProfile
from rosbags.typesys import Stores, get_typestore

from tissue_sim.errors import UserError
from tissue_sim.model.contact_set import ContactSet
from tissue_sim.model.records import array_of
from tissue_sim.model.settings import Settings
from tissue_sim.model.state import fields_of, make_state
from tissue_sim.ros.bags import bag
from tissue_sim.ros.bags.offered import offered
from tissue_sim.ros.bags.spool import Spool
from tissue_sim.ros.bags.writer import WHOLE, BagWriter, Split, Topic
from tissue_sim.ros.shared.physics import Physics
from tissue_sim.ros.shared.qos import LATCHED, RELIABLE, STREAM
from tissue_sim.ros.shared.report import Report
from tissue_sim.ros.shared.tool_topics import GRIPPER_TOPICS, TOOL_TOPICS

SETTLE_TIME = 0.1  # s of messages in the bag before the state is taken, so that nothing it needs is missing
JOURNAL_EVERY = 0.25  # s
# What a replay can do without, and the share of all that may wait for a slow disk up to which it is kept: markers are
# left out first, as the largest.
PATIENCE = {"markers": 0.25, "surface": 0.5, "skeleton": 0.5}
OFFERED = {"mesh": LATCHED, "markers": LATCHED, "surface": STREAM, "skeleton": STREAM}  # RELIABLE: what only bags hold


BodyContact = tuple[int, float, bool, bool]  # the fields of bag.BodyContactRow


@dataclass
class _Notes:
    """Rows that wait for the journal."""

    contacts: list[tuple[int, int]] = field(default_factory=list)
    body_contacts: list[list[BodyContact]] = field(default_factory=list)
    wrenches: list[tuple[int, int]] = field(default_factory=list)
    surfaces: list[tuple[int]] = field(default_factory=list)

    def __bool__(self) -> bool:
        return bool(self.contacts or self.wrenches or self.surfaces)

    def arrays(self, n_bodies: int) -> dict[str, NDArray[Any]]:
        """The rows as arrays of records."""
        by_body = np.array(self.body_contacts, dtype=bag.BodyContactRow.dtype)
        return {
            "contacts": np.array(self.contacts, dtype=bag.ContactRow.dtype),
            "body_contacts": by_body.reshape(len(self.body_contacts), n_bodies),
            "wrenches": np.array(self.wrenches, dtype=bag.WrenchRow.dtype),
            "surfaces": np.array(self.surfaces, dtype=bag.SurfaceRow.dtype),
        }


class Recorder:
    """Records while started. Messages may be written from any thread; they only go into a queue.

    node_name absolute, like /tissue_sim.
    """

    def __init__(self, node_name: str, n_bodies: int, config: dict[str, Any]) -> None:
        self._node_name = node_name
        self._names = {name: f"{node_name}/{name}" for name in bag.PRIVATE_TOPICS}
        self._n_bodies = n_bodies
        self._tool_topics: dict[str, str] = {}  # tool/topic to the name in a bag
        self._config = config
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._tool_qos: dict[str, QoSProfile] = {}  # by the name in a bag
        self._spool: Spool | None = None
        self._recording = False
        self._notes = _Notes()
        self._polling = threading.Lock()
        self._journal_at = 0.0  # monotonic s, when the journal was last written
        self._newest_set: tuple[int, ContactSet] | None = None
        self._state_tick = -1
        self._started = 0.0
        self._hurry = False  # there is a state, which a bag is nothing without
        self.path: Path | None = None
        # Held while something is posted to the loop and noted here: a journal that tells that it was taken up holds the
        # note, too, or comes after it, so that a bag may break off anywhere.
        self.together = threading.RLock()

    @property
    def active(self) -> bool:
        """Whether messages are recorded."""
        return self._recording and self._spool is not None and self._spool.is_open

    @property
    def lost(self) -> int:
        """Messages that the newest bag lacks."""
        return self._spool.lost if self._spool is not None else 0

    @property
    def error(self) -> str:
        """What ended the newest bag before its time; empty: nothing did."""
        return self._spool.error if self._spool is not None else ""

    def add_topic(self, tool: str, topic: str, name: str = "", qos: QoSProfile = STREAM) -> str:
        """Give bags a tool's topic, of TOOL_TOPICS or GRIPPER_TOPICS; returns what it is called there.

        name: that of the bridge's own topic, where a bag holds its very bytes; qos: how it is delivered.
        """
        name = self._tool_topics.setdefault(f"{tool}/{topic}", name or f"{self._node_name}/{tool}/{topic}")
        self._tool_qos[name] = qos
        return name

    # life --------------------------------------------------------------------------------------
    def start(
        self,
        folder: Path,
        physics: Physics,
        organ_bytes: bytes,
        mesh: bytes,
        newest: dict[str, tuple[int, bytes]],
        split: Split = WHOLE,
    ) -> Path:
        """Start a bag in a folder; newest maps each input topic to its last sequence and bytes.

        Returns the bag's path. Raises UserError when it can't be written.
        """
        if self.active:
            raise UserError(f"already recording to {self.path}; stop that first")
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
        path = folder / f"tissue_sim-{stamp}"
        suffix = 1
        while path.exists():
            path, suffix = folder / f"tissue_sim-{stamp}-{suffix}", suffix + 1
        writer = BagWriter(path, split)
        try:
            writer.open()
        except OSError as error:
            raise UserError(f"cannot record to {path}: {error.strerror}") from None
        patience = {self._names[name]: share for name, share in PATIENCE.items()}
        with self.together:
            self.path, self._spool = path, Spool(writer, writer.add_topics(self._topics()), patience)
            physics.journal()  # rows of ticks before this bag
            self._notes, self._state_tick, self._started = _Notes(), -1, time.monotonic()
            first = {name: sequence for name, (sequence, _) in newest.items()}
            self._typed("config", "data", json.dumps(self._config | {"topics": self._tool_topics, "first": first}))
            self._typed("organ", "data", np.frombuffer(organ_bytes, dtype=np.uint8))
            self._put(self._names["mesh"], mesh)
            for name, (_, raw) in newest.items():
                self._put(name, raw)
            # The newest of every input: the loop may take it up only after the state, when the machine is busy.
            if self._newest_set is not None:
                self._whole_set(*self._newest_set)
            self._recording = True
            self.settings(int(physics.box.settings.sequence[0]), physics.settings())
            self._spool.flush()
        return path

    def stop(self, physics: Physics, patience: float = 30.0) -> Path | None:
        """Close the bag; returns its path, None when none was open.

        What is not written within `patience` s is left out and counted as lost; what is in the bag still replays.
        `error` says what went wrong, then or before.
        """
        if self._spool is None or not self._recording:
            return None
        self._journal_at = 0.0
        try:
            self.poll(physics)
        except TimeoutError:  # a loop that hangs or has ended gives no state: the bag ends without one
            pass
        finally:
            self._recording = False
            self._spool.close(patience)
        return self.path

    def poll(self, physics: Physics) -> None:
        """Take the state when it is time, and write the journal so far; call it often."""
        with self._polling:  # journals stay in their order
            if self.active:
                self._poll(physics)

    def _poll(self, physics: Physics) -> None:
        now = time.monotonic()
        if self._state_tick < 0 and now - self._started > SETTLE_TIME:
            before = physics.simulation.state
            state = make_state(len(before.position), self._n_bodies, len(before.mode_position), len(before.is_turned))
            state.words[:] = physics.snapshot()
            self._packed("state", fields_of(state))
            self._state_tick = int(state.status.tick)
            self._journal_at = 0.0
            self._hurry = True
        if now - self._journal_at < JOURNAL_EVERY:
            return
        self._journal_at = now
        with self.together:
            inputs, body_inputs = physics.journal()
            noted, self._notes = self._notes, _Notes()
            if len(inputs) or noted:
                self._packed("journal", {"inputs": inputs, "body_inputs": body_inputs} | noted.arrays(self._n_bodies))
        if self._hurry and self._spool is not None:
            self._hurry = False
            self._spool.flush()

    def report(self, report: Report) -> None:
        """Add the bag, and what it is missing."""
        report.values["recording"] = str(self.path) if self.active else ""
        report.problems["lost_bag_messages"] = self.lost
        if self.error:
            report.failures.append(self.error)

    # what happens ------------------------------------------------------------------------------
    def received(self, name: str, raw: bytes) -> None:
        """A pose or force that was accepted, as it came; to be called before it is posted."""
        if self.active:
            self._put(name, raw)

    def wrench(self, name: str, tool: int, tick: int, raw: bytes) -> None:
        """A published servo_cf, and the tick that it shows."""
        with self.together:
            if self.active and self._put(name, raw):
                self._notes.wrenches.append((tool, tick))

    def surface(self, tick: int, surface: bytes, skeleton: bytes, markers: bytes | None) -> None:
        """A published surface, skeleton and, if wanted, markers, and the tick that they show."""
        with self.together:
            if not self.active:
                return
            if self._put(self._names["surface"], surface):
                self._notes.surfaces.append((tick,))
            self._put(self._names["skeleton"], skeleton)
            if markers is not None:
                self._put(self._names["markers"], markers)

    def settings(self, sequence: int, settings: Settings) -> None:
        """New settings; to be called with `together` held since they were posted."""
        if self.active:
            self._packed("settings", {"sequence": np.array(sequence), "settings": array_of(settings)})

    def contacts(self, sequence: int, surface_tick: int, found: ContactSet, bodies: Sequence[BodyContact]) -> None:
        """A contact set: what it was found from, or all of it while its surface may not be in the bag.

        To be called with `together` held since it was posted.
        """
        self._newest_set = sequence, found
        if not self.active:
            return
        self._notes.contacts.append((sequence, surface_tick))
        self._notes.body_contacts.append(list(bodies))
        if self._state_tick < 0 or surface_tick <= self._state_tick:
            self._whole_set(sequence, found)

    # inside ------------------------------------------------------------------------------------
    def _whole_set(self, sequence: int, found: ContactSet) -> None:
        found.header.sequence = sequence
        self._packed(
            "contact_set", {name: array_of(value) for name, value in found._asdict().items() if name != "words"}
        )

    def _packed(self, topic: str, arrays: Mapping[str, NDArray[Any]]) -> None:
        self._typed(topic, "data", bag.pack(**arrays))

    def _topics(self) -> dict[str, Topic]:
        kinds = TOOL_TOPICS | GRIPPER_TOPICS
        topics = {
            self._names[name]: Topic(kind, [offered(OFFERED.get(name, RELIABLE))])
            for name, kind in bag.PRIVATE_TOPICS.items()
        }
        return topics | {
            name: Topic(kinds[topic.split("/")[1]], [offered(self._tool_qos[name])])
            for topic, name in self._tool_topics.items()
        }

    def _put(self, name: str, raw: bytes) -> bool:
        return self._spool is not None and self._spool.put(name, raw)

    def _typed(self, topic: str, member: str, value: Any) -> None:
        kind = bag.PRIVATE_TOPICS[topic]
        message = self._store.types[kind]
        if kind.endswith("MultiArray"):
            layout = self._store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
            value = message(layout=layout, data=value)
        else:
            value = message(**{member: value})
        self._put(self._names[topic], bytes(self._store.serialize_cdr(value, kind)))
