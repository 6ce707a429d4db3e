"""What a bag says, read from its messages."""

from __future__ import annotations

import math
import struct
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader

from tissue_sim.array_types import Floats
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError, shown
from tissue_sim.model.contact_set import ContactSet
from tissue_sim.model.settings import Settings
from tissue_sim.model.state_check import check_settings, contact_set_of
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags import bag, recovery
from tissue_sim.ros.bags.comparing import Shown
from tissue_sim.ros.bags.config import check_config, read_config
from tissue_sim.ros.bags.journal import SHOWING, check_journal
from tissue_sim.ros.shared.cdr import (
    check_force,
    check_position,
    parse_cloud,
    parse_number,
    parse_octets,
    parse_stamped,
    parse_text,
    unit_pose,
)
from tissue_sim.ros.shared.tool_topics import TOOL_TOPICS

# What comes of messages that say anything at all.
_DAMAGED = (
    *(ValueError, LookupError, TypeError, AttributeError),
    *(ArithmeticError, RecursionError, struct.error),
)


@dataclass
class Recording:
    """The content of a bag, by topic, in the order of recording."""

    config: dict[str, Any]
    organ: bytes
    state: dict[str, np.ndarray]
    settings: dict[int, Settings]
    contact_sets: dict[int, ContactSet]
    journal: dict[str, np.ndarray]  # records by kind, see recorder
    poses: list[dict[int, Floats]] = field(default_factory=list)  # per tool, by sequence
    stamps: list[dict[int, int]] = field(default_factory=list)  # ns, of the poses
    angles: list[dict[int, float]] = field(default_factory=list)  # rad of a gripper, as its poses
    forces: list[dict[int, Floats]] = field(default_factory=list)
    wrenches: list[list[Floats]] = field(default_factory=list)  # per tool
    surfaces: list[np.ndarray] = field(default_factory=list)  # (n_surface, 3) float32

    @classmethod
    def read(cls, path: Path) -> Recording:
        """Read a bag folder; raises UserError naming the bag and what it lacks."""
        if not path.exists():
            raise UserError(f"bag {path} does not exist")
        messages = _read_messages(path)
        try:
            return cls._parsed(path, messages)
        except _DAMAGED as error:
            raise UserError(f"bag {path} is damaged: {shown(str(error), 200) or type(error).__name__}") from None

    @classmethod
    def _parsed(cls, path: Path, messages: dict[str, list[bytes]]) -> Recording:
        name = next((topic[: -len("/config")] for topic in messages if topic.endswith("/config")), None)
        if name is None:
            raise UserError(f"bag {path} was not recorded by a tissue_sim node: it has no configuration")

        def data(topic: str) -> list[NDArray[np.uint8]]:
            return [parse_octets(raw) for raw in messages[f"{name}/{topic}"]]

        config = read_config(parse_text(messages[f"{name}/config"][0]))
        if config["format"] != bag.FORMAT:
            raise UserError(
                f"bag {path} has format {config['format']} (tissue_sim {shown(config['package_version'])}), this"
                f" package reads {bag.FORMAT}: replay it with that version, or record it again"
            )
        check_config(config)
        if not data("state"):
            raise UserError(f"bag {path} holds no state to start from: the recording was too short or broken off")
        if not messages[f"{name}/settings"]:
            raise UserError(f"bag {path} holds no settings: the recording was too short or broken off")
        if not data("journal"):
            raise UserError(f"bag {path} holds nothing that happened: the recording was too short or broken off")
        n_bodies = sum(tool.n_bodies for tool in tools_of(config))
        rows = [bag.unpack(values) for values in data("journal")]
        kinds = rows[0] if rows else {}
        state = bag.unpack(data("state")[0])
        n_nodes = len(state["position"])
        sets = [contact_set_of(bag.unpack(values), n_bodies, n_nodes) for values in data("contact_set")]
        settings = [bag.unpack(values) for values in data("settings")]
        recording = cls(
            config=config,
            organ=data("organ")[0].tobytes(),
            state=state,
            settings={int(found["sequence"]): settings_of(path, found["settings"]) for found in settings},
            contact_sets={int(found.header.sequence): found for found in sets},
            journal={kind: np.concatenate([row[kind] for row in rows]) for kind in kinds},
        )
        for tool in config["tools"]:
            topics = {topic: config["topics"][f"{tool}/{topic}"] for topic in TOOL_TOPICS}
            first = {topic: int(config["first"].get(name, 1)) for topic, name in topics.items()}
            came = [parse_stamped(raw, 7) for raw in messages[topics["measured_cp"]]]
            poses = [_pose_of(message.values) for message in came]
            forces = [_force_of(parse_stamped(raw, 6).values) for raw in messages[topics["measured_cf"]]]
            recording.poses.append(dict(enumerate(poses, start=first["measured_cp"])))
            stamps = [message.stamp for message in came]
            recording.stamps.append(dict(enumerate(stamps, start=first["measured_cp"])))
            angles = messages[config["topics"].get(f"{tool}/measured_js", "")]
            values = [_finite(parse_number(raw)) for raw in angles]
            recording.angles.append(dict(enumerate(values, start=first["measured_cp"])))
            recording.forces.append(dict(enumerate(forces, start=first["measured_cf"])))
            recording.wrenches.append([np.array(parse_stamped(r, 6).values) for r in messages[topics["servo_cf"]]])
        for raw in messages[f"{name}/surface"]:
            recording.surfaces.append(parse_cloud(raw))
        if len({len(surface) for surface in recording.surfaces}) > 1:
            raise ValueError("its surfaces have different numbers of points")
        check_journal(recording.journal, n_bodies, recording.first_tick, float(config["parameters"]["rate"]))
        return recording

    @property
    def first_tick(self) -> int:
        """That of the state."""
        return int(self.state["status"]["tick"].item())

    @property
    def last_tick(self) -> int:
        """The last one that the journal knows."""
        rows = self.journal
        ticks = [rows[kind]["tick"] for kind in SHOWING]
        return int(max([np.max(found) for found in ticks if len(found)], default=0))

    def shown(self) -> Shown:
        """What the bag shows; rows of the journal whose messages were lost are left out, and messages without a row."""
        rows, tools = self.journal, self.config["tools"]
        ticks = [rows["wrenches"]["tick"][rows["wrenches"]["tool"] == tool] for tool in range(len(tools))]
        lengths = [min(len(found), len(wrenches)) for found, wrenches in zip(ticks, self.wrenches, strict=True)]
        n_shapes = min(len(rows["surfaces"]), len(self.surfaces))
        n_surface = len(self.surfaces[0]) if self.surfaces else 0
        return Shown(
            tools,
            [found[:length] for found, length in zip(ticks, lengths, strict=True)],
            [np.array(found[:length]).reshape(-1, 6) for found, length in zip(self.wrenches, lengths, strict=True)],
            np.asarray(rows["surfaces"]["tick"][:n_shapes]),
            np.array(self.surfaces[:n_shapes], dtype=np.float32).reshape(n_shapes, n_surface, 3),
        )


def settings_of(path: Path, recorded: np.ndarray) -> Settings:
    """Settings from a record of them; raises UserError naming a field that one of both lacks."""
    names, wanted = recorded.dtype.names or (), Settings.dtype.names or ()
    if differing := sorted(set(names) ^ set(wanted)):
        raise UserError(
            f"bag {path}: setting '{differing[0]}' is not in both, the bag and this version; record it again"
        )
    settings = Settings.new()
    for name in names:
        setattr(settings, name, recorded[name][()])
    check_settings(settings)
    return settings


def tools_of(config: dict[str, Any]) -> list[Tool]:
    """The tools of a bag's configuration."""
    parameters, keys = config["parameters"], ("shape", "radius", "length", "mesh")
    return [Tool(name, **{key: parameters[f"{name}.{key}"] for key in keys}) for name in config["tools"]]


def recorded_organ(recording: Recording) -> Organ:
    """The organ that a bag holds."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "organ.npz"
        path.write_bytes(recording.organ)
        return Organ.load(path)


def _pose_of(values: Sequence[float]) -> Floats:
    """A pose (7,) as a node takes it up; raises ValueError for one that no node does."""
    pose = unit_pose(np.array(values))
    check_position(pose[:3])
    return pose


def _force_of(values: Sequence[float]) -> Floats:
    """The force (3,) N of a wrench, likewise."""
    force = np.array(values[:3])
    check_force(force)
    return force


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("it holds a jaws' angle that is not finite")
    return value


def _read_messages(path: Path) -> dict[str, list[bytes]]:
    messages: dict[str, list[bytes]] = defaultdict(list)
    with recovery.rubbish_told(path):
        if recovery.is_broken_off(path):
            for connection, _, raw in recovery.messages(path):
                messages[connection.topic].append(bytes(raw))
            return messages
        for file in recovery.listed(path):
            recovery.check_lengths(file)
        with Reader(path) as reader:
            for connection, _, raw in reader.messages():
                messages[connection.topic].append(bytes(raw))
    return messages
