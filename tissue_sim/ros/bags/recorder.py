"""Recording of input, output and journal to an MCAP bag, off the tick path."""

from __future__ import annotations

import json
import shutil
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from datetime import datetime
from pathlib import Path

import numpy as np
from rclpy.qos import QoSProfile

from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.ros.bags import bag
from tissue_sim.ros.bags.bag_messages import BagMessages
from tissue_sim.ros.bags.joined_recorder import JoinedRecorder
from tissue_sim.ros.bags.offered_qos import offered
from tissue_sim.ros.bags.organ_recorder import OrganRecorder
from tissue_sim.ros.bags.spool import Spool
from tissue_sim.ros.bags.writer import WHOLE, BagWriter, Split, Topic
from tissue_sim.ros.shared.organ_topics import path_of
from tissue_sim.ros.shared.organs import Organs
from tissue_sim.ros.shared.qos import LATCHED, RELIABLE, STREAM
from tissue_sim.ros.shared.report import Report
from tissue_sim.ros.shared.tool_topics import GRIPPER_TOPICS, TOOL_TOPICS

SETTLE_TIME = 0.1  # s of messages in the bag before the state is taken, so that it lacks nothing
JOURNAL_EVERY = 0.25  # s
NOT_KEPT = "the bag was removed: no tick was simulated while it was recorded, so that it could not be replayed"
# Topics that a replay can do without, each with the fill level of the queue for a slow disk up to which it is kept:
# markers, the largest, are left out first.
PATIENCE = {"markers": 0.25, "surface": 0.5, "skeleton": 0.5}
OFFERED = {"mesh": LATCHED, "markers": LATCHED, "surface": STREAM, "skeleton": STREAM}  # RELIABLE: what only bags hold


class Recorder:
    """Recorder of the node; any thread may write messages, which only go into memory.

    Parameters
    ----------
    node_name : str
        Absolute, like /tissue_sim.
    organs : Organs
        The organs.
    names : Sequence[str]
        Name of each organ, empty for a single one.
    config : JsonObject
        Configuration of the bag.

    Attributes
    ----------
    of_organ
        The organs' parts of a bag.
    joined
        The part of what joins them.
    """

    def __init__(
        self,
        node_name: str,
        organs: Organs,
        names: Sequence[str],
        config: JsonObject,
    ) -> None:
        self._node_name, self._organs, self._config = node_name, organs, config
        self._frame_id = str(config.get("parameters", {}).get("frame_id", ""))
        self._messages = BagMessages()
        self.lock = self._messages.lock
        self.of_organ = [
            OrganRecorder(self._messages, path_of(node_name, name), physics)
            for name, physics in zip(names, organs.each, strict=True)
        ]
        self._names = {name: f"{node_name}/{name}" for name in bag.NODE_TOPICS}
        self.joined = JoinedRecorder(self._messages, node_name, organs.loop)
        self._tool_topics: dict[str, str] = {}  # tool/topic to the name in a bag
        self._tool_qos: dict[str, QoSProfile] = {}  # by the name in a bag
        self._wrenches: list[tuple[int, int]] = []  # rows that wait for the journal
        self._organ_pose = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        self._polling = threading.Lock()
        self._journal_at = 0.0  # monotonic s, when the journal was last written
        self._has_state = False
        self._shown_tick = -1  # the newest of a wrench in the bag
        self._started = 0.0
        self._hurry = False  # there is a state, without which a bag is of no use
        self.path: Path | None = None
        self.kept = True  # whether the newest bag was kept when it ended

    @property
    def active(self) -> bool:
        """Whether messages are recorded."""
        return self._messages.active

    @property
    def lost(self) -> int:
        """Number of messages that the newest bag lacks."""
        return self._messages.spool.lost if self._messages.spool is not None else 0

    @property
    def error(self) -> str:
        """What ended the newest bag before its time; empty where nothing did."""
        return self._messages.spool.error if self._messages.spool is not None else ""

    def add_topic(self, tool: str, topic: str, name: str = "", qos: QoSProfile = STREAM) -> str:
        """Give bags a tool's topic, of TOOL_TOPICS or GRIPPER_TOPICS.

        topic: name in those tables; name: name of the bridge's own topic, where a bag holds its very bytes; qos: how it
        is delivered. Returns its name in the bag.
        """
        name = self._tool_topics.setdefault(f"{tool}/{topic}", name or f"{self._node_name}/{tool}/{topic}")
        self._tool_qos[name] = qos
        return name

    # life --------------------------------------------------------------------------------------
    def start(self, folder: Path, newest: dict[str, tuple[int, bytes]], split: Split = WHOLE) -> Path:
        """Start a bag in a folder.

        newest: last sequence and bytes of each input topic; split: how the bag is split into files. Returns the bag's
        path. Raises UserError when it can't be written.
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
        patience = {one.names[name]: fraction for one in self.of_organ for name, fraction in PATIENCE.items()}
        messages = self._messages
        with ExitStack() as kept:
            for one in self.of_organ:
                kept.enter_context(one.exchanging)
                one.prepare()
            kept.enter_context(self.lock)
            self.path, messages.spool = path, Spool(writer, writer.add_topics(self._topics()), patience)
            self._wrenches, self._has_state, self._started = [], False, time.monotonic()
            self._shown_tick, self.kept = -1, True
            first = {name: sequence for name, (sequence, _) in newest.items()}
            config = self._config | {"topics": self._tool_topics, "first": first}
            messages.text(self._names["config"], json.dumps(config))
            for one in self.of_organ:
                one.begin()
            for name, (_, raw) in newest.items():
                messages.put(name, raw)
            self._put_organ_pose()
            messages.recording = True
            for one in self.of_organ:
                one.begin_inputs()
            self.joined.begin()
            messages.spool.flush()
        return path

    def stop(self, patience: float = 30.0) -> Path | None:
        """Close the bag; return its path, None when none was open.

        What is not written in time is left out and counted as lost; the bag still replays. So does one that ends right
        after its beginning: it gets the state, and a shape after it. One during which nothing ticked is removed, and
        `kept` is false. `error` says what went wrong, then or before.

        patience: time for writing the rest, s.
        """
        messages = self._messages
        if messages.spool is None or not messages.recording:
            return None
        try:
            with suppress(TimeoutError):  # a loop that hangs or has ended gives no state
                self._complete()
            self.kept = self._can_be_replayed
        finally:
            messages.recording = False
            messages.spool.close(patience)
        if not self.kept and not self.error and self.path is not None:
            shutil.rmtree(self.path, ignore_errors=True)
        return self.path

    def _complete(self) -> None:
        """Record what a replay needs and compares, where the bag lacks it, and the rest of the journal."""
        if not self._has_state:
            time.sleep(max(0.0, self._started + SETTLE_TIME - time.monotonic()))
        self._journal_at = 0.0
        self.poll()
        if self.active and not self._can_be_replayed:
            with ExitStack() as kept:
                for one in self.of_organ:
                    kept.enter_context(one.exchanging)
                kept.enter_context(self._organs.loop.snapshots())
                for one in self.of_organ:
                    one.last_shape(self._frame_id)
            self._journal_at = 0.0
            self.poll()

    @property
    def _can_be_replayed(self) -> bool:
        """Whether the bag has a state, and a wrench or surface of a later tick."""
        shown = max(self._shown_tick, *(one.shown_tick for one in self.of_organ))
        return self._has_state and shown > min(one.state_tick for one in self.of_organ)

    def poll(self) -> None:
        """Take the state when it is time, and write the journal so far; call it often."""
        with self._polling:  # journals stay in their order
            if self.active:
                self._poll()

    def _poll(self) -> None:
        now = time.monotonic()
        if not self._has_state and now - self._started >= SETTLE_TIME:
            with self._organs.loop.snapshots():
                tick = min([one.state() for one in self.of_organ])
                self.joined.state(tick)
            self._has_state, self._journal_at, self._hurry = True, 0.0, True
        if now - self._journal_at < JOURNAL_EVERY:
            return
        self._journal_at = now
        with self.lock:
            self._write_journal()
        if self._hurry and self._messages.spool is not None:
            self._hurry = False
            self._messages.spool.flush()

    def _write_journal(self) -> None:
        rows = {one.names["journal"]: one.rows() for one in self.of_organ}
        wrenches = np.array(self._wrenches, dtype=bag.WrenchRow.dtype)
        self._wrenches = []
        # An only organ's journal is also that of all.
        rows.setdefault(self.joined.names["journal"], {}).update(self.joined.rows(), wrenches=wrenches)
        for name, own in rows.items():
            if any(len(found) for found in own.values()):
                self._messages.packed(name, own)

    def report(self, report: Report) -> None:
        """Add the bag, and what it lacks."""
        report.values["recording"] = str(self.path) if self.active else ""
        report.problems["lost_bag_messages"] = self.lost
        if self.error:
            report.failures.append(self.error)

    def organ_pose(self, pose: Sequence[float]) -> None:
        """Note where the organ is in base_frame, now and when a bag begins.

        Poses and forces are recorded in the organ's frame, so that a replay doesn't need it.

        pose (7,) m and quaternion xyzw: the organ's pose.
        """
        with self.lock:
            self._organ_pose = np.array(pose, dtype=np.float64)
            if self.active:
                self._put_organ_pose()

    def _put_organ_pose(self) -> None:
        tick = self._organs.each[0].results().status.tick
        fields = {"tick": np.array(tick, dtype=np.int64), "organ_pose": self._organ_pose}
        self._messages.packed(self._names["organ_pose"], fields)

    # what happens ------------------------------------------------------------------------------
    def received(self, name: str, raw: bytes) -> None:
        """Record a pose or force that was accepted, as it came; call it before it is posted.

        name: its topic.
        """
        if self.active:
            self._messages.put(name, raw)

    def wrench(self, name: str, tool: int, tick: int, raw: bytes) -> None:
        """Record a published servo_cf.

        name: its topic; tool: index of the tool; tick: the tick that it shows.
        """
        with self.lock:
            if self.active and self._messages.put(name, raw):
                self._wrenches.append((tool, tick))
                self._shown_tick = max(self._shown_tick, tick)

    # inside ------------------------------------------------------------------------------------
    def _topics(self) -> dict[str, Topic]:
        kinds = TOOL_TOPICS | GRIPPER_TOPICS
        topics = {self._names[name]: Topic(kind, [offered(RELIABLE)]) for name, kind in bag.NODE_TOPICS.items()}
        for one in self.of_organ:
            for name, kind in bag.ORGAN_TOPICS.items():
                topics[one.names[name]] = Topic(kind, [offered(OFFERED.get(name, RELIABLE))])
        topics |= {name: Topic(bag.OCTETS, [offered(RELIABLE)]) for name in self.joined.names.values()}
        return topics | {
            name: Topic(kinds[topic.split("/")[1]], [offered(self._tool_qos[name])])
            for topic, name in self._tool_topics.items()
        }
