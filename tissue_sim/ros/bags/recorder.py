"""Writes what came in, what went out and why to an MCAP bag, off the tick path."""

from __future__ import annotations

import json
import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_typestore

from tissue_sim.errors import UserError
from tissue_sim.model.contact_set import ContactSet
from tissue_sim.model.records import array_of
from tissue_sim.model.settings import Settings
from tissue_sim.model.state import fields_of, make_state
from tissue_sim.ros.bags import bag
from tissue_sim.ros.shared.physics import Physics
from tissue_sim.ros.shared.report import Report
from tissue_sim.ros.shared.tool_topics import GRIPPER_TOPICS, TOOL_TOPICS

SETTLE_TIME = 0.1  # s of messages in the bag before the state is taken, so that nothing it needs is missing
JOURNAL_EVERY = 0.25  # s
CLOSING_TIME = 0.4  # s that a bag which is closed before all is written may take for that
LONGEST_QUEUE = 200_000  # messages; a disk that can't keep up loses the rest, and that is said


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
        self._queue: queue.SimpleQueue[tuple[Any, int, Any] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None
        self._connections: dict[str, Any] = {}
        self._notes = _Notes()
        self._notes_lock = threading.Lock()
        self._journal_at = 0.0  # monotonic s, when the journal was last written
        self._newest_set: tuple[int, ContactSet] | None = None
        self._state_tick = -1
        self._started = 0.0
        self._epoch = 0
        self._hurry = threading.Event()
        self.path: Path | None = None
        self.active = False
        self.lost = 0
        self.error = ""

    def add_topic(self, tool: str, topic: str, name: str = "") -> str:
        """Give bags a tool's topic, of TOOL_TOPICS or GRIPPER_TOPICS; returns what it is called there.

        name: that of the bridge's own topic, where a bag holds its very bytes.
        """
        return self._tool_topics.setdefault(f"{tool}/{topic}", name or f"{self._node_name}/{tool}/{topic}")

    # life --------------------------------------------------------------------------------------
    def start(
        self, folder: Path, physics: Physics, organ_bytes: bytes, mesh: bytes, newest: dict[str, tuple[int, bytes]]
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
        writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        try:
            writer.open()
        except OSError as error:
            raise UserError(f"cannot record to {path}: {error.strerror}") from None
        types = {self._names[name]: kind for name, kind in bag.PRIVATE_TOPICS.items()}
        tool_types = TOOL_TOPICS | GRIPPER_TOPICS
        types |= {name: tool_types[topic.split("/")[1]] for topic, name in self._tool_topics.items()}
        self._connections = {
            name: writer.add_connection(name, kind, typestore=self._store) for name, kind in types.items()
        }
        self._queue = queue.SimpleQueue()
        self._hurry.clear()
        self._thread = threading.Thread(target=self._drain, args=(writer, self._queue), name="recorder", daemon=True)
        self._thread.start()
        self._epoch = time.time_ns() - time.monotonic_ns()
        physics.journal()  # rows of ticks before this bag
        self._notes, self._state_tick, self._started = _Notes(), -1, time.monotonic()
        self.path, self.lost, self.error = path, 0, ""
        first = {name: sequence for name, (sequence, _) in newest.items()}
        self._typed("config", "data", json.dumps(self._config | {"topics": self._tool_topics, "first": first}))
        self._typed("organ", "data", np.frombuffer(organ_bytes, dtype=np.uint8))
        self._raw(self._names["mesh"], mesh)
        for name, (_, raw) in newest.items():
            self._raw(name, raw)
        # The newest of every input: the loop may take it up only after the state, when the machine is busy.
        if self._newest_set is not None:
            self._whole_set(*self._newest_set)
        self.active = True
        self.settings(int(physics.box.settings.sequence[0]), physics.settings())
        return path

    def stop(self, physics: Physics, patience: float = 30.0) -> Path | None:
        """Close the bag; returns its path, None when none was open.

        What is not written within `patience` s is left out and counted as lost; what is in the bag still replays.
        """
        if not self.active:
            return None
        self._journal_at = 0.0
        self.poll(physics)
        self.active = False
        self._queue.put(None)
        if self._thread is not None:
            self._thread.join(timeout=patience)
            self._hurry.set()
            self._thread.join(timeout=CLOSING_TIME)
            if self._thread.is_alive():
                self.error = f"recording to {self.path} failed: the disk doesn't answer"
        return self.path

    def poll(self, physics: Physics) -> None:
        """Take the state when it is time, and write the journal so far; call it often."""
        if not self.active:
            return
        now = time.monotonic()
        if self._state_tick < 0 and now - self._started > SETTLE_TIME:
            before = physics.simulation.state
            state = make_state(len(before.position), self._n_bodies, len(before.mode_position), len(before.is_turned))
            state.words[:] = physics.snapshot()
            self._packed("state", fields_of(state))
            self._state_tick = int(state.status.tick)
        if now - self._journal_at < JOURNAL_EVERY:
            return
        self._journal_at = now
        inputs, body_inputs = physics.journal()
        with self._notes_lock:
            noted, self._notes = self._notes, _Notes()
        if len(inputs) or noted:
            self._packed("journal", {"inputs": inputs, "body_inputs": body_inputs} | noted.arrays(self._n_bodies))

    def report(self, report: Report) -> None:
        """Add the bag, and what it is missing."""
        report.values["recording"] = str(self.path) if self.active else ""
        report.problems["lost_bag_messages"] = self.lost
        if self.error:
            report.failures.append(self.error)

    # what happens ------------------------------------------------------------------------------
    def received(self, name: str, raw: bytes) -> None:
        """A pose or force that was accepted, as it came."""
        if self.active:
            self._raw(name, raw)

    def wrench(self, name: str, tool: int, tick: int, raw: bytes) -> None:
        """A published servo_cf, and the tick that it shows."""
        if self.active:
            with self._notes_lock:
                self._notes.wrenches.append((tool, tick))
            self._raw(name, raw)

    def surface(self, tick: int, surface: bytes, skeleton: bytes, markers: bytes | None) -> None:
        """A published surface, skeleton and, if wanted, markers, and the tick that they show."""
        if self.active:
            with self._notes_lock:
                self._notes.surfaces.append((tick,))
            self._raw(self._names["surface"], surface)
            self._raw(self._names["skeleton"], skeleton)
            if markers is not None:
                self._raw(self._names["markers"], markers)

    def settings(self, sequence: int, settings: Settings) -> None:
        """New settings."""
        if self.active:
            self._packed("settings", {"sequence": np.array(sequence), "settings": array_of(settings)})

    def contacts(self, sequence: int, surface_tick: int, found: ContactSet, bodies: Sequence[BodyContact]) -> None:
        """A contact set: what it was found from, or all of it while its surface may not be in the bag."""
        self._newest_set = sequence, found
        if not self.active:
            return
        with self._notes_lock:
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

    def _raw(self, name: str, raw: bytes) -> None:
        if self._queue.qsize() > LONGEST_QUEUE:
            self.lost += 1
            return
        # Wall time, but never running backwards within a bag.
        self._queue.put((name, self._epoch + time.monotonic_ns(), raw))

    def _typed(self, topic: str, member: str, value: Any) -> None:
        kind = bag.PRIVATE_TOPICS[topic]
        message = self._store.types[kind]
        if kind.endswith("MultiArray"):
            layout = self._store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
            value = message(layout=layout, data=value)
        else:
            value = message(**{member: value})
        self._raw(self._names[topic], bytes(self._store.serialize_cdr(value, kind)))

    def _drain(self, writer: Writer, messages: queue.SimpleQueue[Any]) -> None:
        """Write until told to stop; a disk that fails ends the bag and is reported, the node goes on."""
        get: Callable[[], Any] = messages.get
        try:
            while (item := get()) is not None:
                name, stamp, raw = item
                if self._hurry.is_set():
                    self.lost += messages.qsize()  # all but the None at the end, and this one
                    break
                writer.write(self._connections[name], stamp, raw)
            writer.close()
        except Exception as error:  # anything that goes wrong on the way to the disk
            self.error = f"recording to {writer.path} failed: {error}"
            self.active = False
            writer.abort()
