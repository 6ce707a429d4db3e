"""Contents of a bag, read from its messages."""

from __future__ import annotations

import math
import struct
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError, shown
from tissue_sim.json_types import JsonObject
from tissue_sim.ros.bags import bag, recovery
from tissue_sim.ros.bags.comparison import Shown
from tissue_sim.ros.bags.config import check_config, organs_of, read_config
from tissue_sim.ros.bags.joined_recording import JoinedRecording, Sizes
from tissue_sim.ros.bags.journal import check_journal
from tissue_sim.ros.bags.organ_recording import OrganRecording
from tissue_sim.ros.shared.cdr import (
    check_force,
    check_position,
    parse_number,
    parse_octets,
    parse_stamped,
    parse_text,
    unit_pose,
)
from tissue_sim.ros.shared.organ_topics import path_of
from tissue_sim.ros.shared.tool_topics import TOOL_TOPICS

# Errors that messages with arbitrary contents may cause.
_DAMAGED = (
    *(ValueError, LookupError, TypeError, AttributeError),
    *(ArithmeticError, RecursionError, struct.error),
)


@dataclass
class Recording:
    """The content of a bag, by topic, in the order of recording."""

    config: JsonObject
    organs: list[OrganRecording]
    joined: JoinedRecording
    registrations: list[tuple[int, Floats]] = field(
        default_factory=list
    )  # first tick and value (7,) of each organ_pose
    poses: list[dict[int, Floats]] = field(default_factory=list)  # per tool, by sequence
    stamps: list[dict[int, int]] = field(default_factory=list)  # ns, of the poses
    angles: list[dict[int, float]] = field(default_factory=list)  # rad of a gripper, like its poses
    forces: list[dict[int, Floats]] = field(default_factory=list)
    wrenches: list[list[Floats]] = field(default_factory=list)  # per tool

    @classmethod
    def read(cls, path: Path) -> Recording:
        """Read a bag folder. Raises UserError when it can't be read; the message names the bag and what it lacks."""
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
        config = read_config(parse_text(messages[f"{name}/config"][0]))
        if config["format"] not in bag.READ:
            raise UserError(
                f"bag {path} has format {config['format']} (tissue_sim {shown(config['package_version'])}), this"
                f" package reads format {' and '.join(map(str, bag.READ))}: replay it with that version, or record"
                " it again"
            )
        check_config(config)
        n_bodies = sum(tool.n_bodies for tool in tools_of(config))
        organs = [OrganRecording.parsed(path, messages, path_of(name, one), n_bodies) for one in organs_of(config)]
        sizes = [
            Sizes(len(one.state["position"]), {cut.number: cut.organ.n_nodes for cut in one.cuts}) for one in organs
        ]
        if "organs" in config:
            joined = JoinedRecording.parsed(messages, name, sizes)
        else:
            joined = JoinedRecording.alone(organs[0].journal["wrenches"])
        recording = cls(config, organs, joined, [_registration(raw) for raw in messages[f"{name}/organ_pose"]])
        for tool in config["tools"]:
            topics = {topic: _topic(config["topics"], tool, topic) for topic in TOOL_TOPICS}
            first = {topic: int(config["first"].get(name, 1)) for topic, name in topics.items()}
            came = [parse_stamped(raw, 7) for raw in messages[topics["measured_cp"]]]
            poses = [_pose_of(message.values) for message in came]
            forces = [_force_of(parse_stamped(raw, 6).values) for raw in messages[topics["external_cf"]]]
            recording.poses.append(dict(enumerate(poses, start=first["measured_cp"])))
            stamps = [message.stamp for message in came]
            recording.stamps.append(dict(enumerate(stamps, start=first["measured_cp"])))
            angles = messages[config["topics"].get(f"{tool}/measured_js", "")]
            values = [_finite(parse_number(raw)) for raw in angles]
            recording.angles.append(dict(enumerate(values, start=first["measured_cp"])))
            recording.forces.append(dict(enumerate(forces, start=first["external_cf"])))
            recording.wrenches.append([np.array(parse_stamped(r, 6).values) for r in messages[topics["servo_cf"]]])
        rate = float(config["parameters"]["rate"])
        for one in organs:
            check_journal(one.journal | {"wrenches": recording.wrench_rows}, n_bodies, one.first_tick, rate)
        return recording

    @property
    def wrench_rows(self) -> np.ndarray:
        """Which tick each wrench shows, records of bag.WrenchRow."""
        return self.joined.journal["wrenches"]

    @property
    def is_scene(self) -> bool:
        """True where organs have names."""
        return "organs" in self.config

    def used_poses(self, body: int, kind: str) -> tuple[list[int], list[int]]:
        """Return the ticks that took up a new input of a body, and its sequence numbers; kind: pose or force."""
        journal = self.organs[0].journal
        sequences = journal["body_inputs"][kind][:, body]
        is_new = np.diff(sequences, prepend=0) != 0
        return journal["inputs"]["tick"][is_new].tolist(), sequences[is_new].tolist()

    @property
    def first_tick(self) -> int:
        """Tick of the states."""
        return self.organs[0].first_tick

    @property
    def last_tick(self) -> int:
        """Last tick that the journal knows."""
        rows = [one.journal[kind]["tick"] for one in self.organs for kind in ("inputs", "surfaces")]
        return int(max([np.max(found) for found in [*rows, self.wrench_rows["tick"]] if len(found)], default=0))

    def shown(self) -> Shown:
        """Return what the bag shows, without rows of lost messages and messages without a row."""
        rows, tools = self.wrench_rows, self.config["tools"]
        ticks = [rows["tick"][rows["tool"] == tool] for tool in range(len(tools))]
        lengths = [min(len(found), len(wrenches)) for found, wrenches in zip(ticks, self.wrenches, strict=True)]
        shapes = [min(len(one.journal["surfaces"]), len(one.surfaces)) for one in self.organs]
        return Shown(
            tools,
            [found[:length] for found, length in zip(ticks, lengths, strict=True)],
            [np.array(found[:length]).reshape(-1, 6) for found, length in zip(self.wrenches, lengths, strict=True)],
            [one.journal["surfaces"]["tick"][:count] for one, count in zip(self.organs, shapes, strict=True)],
            [
                np.array(one.surfaces[:count], dtype=np.float32).reshape(count, len(one.surfaces[0]) if count else 0, 3)
                for one, count in zip(self.organs, shapes, strict=True)
            ],
        )


def tools_of(config: JsonObject) -> list[Tool]:
    """Return the tools of a bag's configuration."""
    parameters, keys = config["parameters"], ("shape", "radius", "length", "mesh")
    return [
        Tool(
            name,
            **{key: parameters[f"{name}.{key}"] for key in keys},
            # Their values before they were parameters.
            smoothing=parameters.get(f"{name}.smoothing", 1.0),
            links=tuple(parameters.get(f"{name}.links", ())),
            tip_link=parameters.get(f"{name}.tip_link", ""),
            jaw_joint=parameters.get(f"{name}.jaw_joint", ""),
            height=parameters.get(f"{name}.height", Tool.height),
            cautery_speed=parameters.get(f"{name}.cautery_speed", 0.0),
            cautery_stiffening=parameters.get(f"{name}.cautery_stiffening", Tool.cautery_stiffening),
            cautery_spread=parameters.get(f"{name}.cautery_spread", Tool.cautery_spread),
        )
        for name in config["tools"]
    ]


def _registration(raw: bytes) -> tuple[int, Floats]:
    """Return the tick of a message on organ_pose and the pose (7,); raises ValueError for one that no node writes."""
    found = bag.unpack(parse_octets(raw))
    tick, pose = found["tick"], found["organ_pose"]
    if tick.shape != () or tick.dtype.kind != "i" or pose.shape != (7,) or pose.dtype.kind != "f":
        raise ValueError("its organ_pose is of another type")
    return int(tick), _pose_of(pose.tolist())


def _topic(names: Mapping[str, str], tool: str, topic: str) -> str:
    """Return what a tool's topic is called in a bag; empty for external forces where it has none."""
    if topic != "external_cf":
        return names[f"{tool}/{topic}"]
    return names.get(f"{tool}/{topic}", names.get(f"{tool}/measured_cf", ""))  # its name in format 8


def _pose_of(values: Sequence[float]) -> Floats:
    """Return a pose (7,) as a node applies it; raise ValueError for one that no node applies."""
    pose = unit_pose(np.array(values))
    check_position(pose[:3])
    return pose


def _force_of(values: Sequence[float]) -> Floats:
    """Return the force (3,) N of a wrench; raise ValueError for one that no node applies."""
    force = np.array(values[:3])
    check_force(force)
    return force


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("it contains a jaw angle that is not finite")
    return value


def _read_messages(path: Path) -> dict[str, list[bytes]]:
    messages: dict[str, list[bytes]] = defaultdict(list)
    with recovery.opened(path) as readers:
        for reader in readers:
            for connection, _, raw in reader.messages(reader.connections):
                messages[connection.topic].append(bytes(raw))
    return messages
