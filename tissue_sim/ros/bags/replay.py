"""`tissue_sim replay`: run a recorded bag again, tick by tick and without DDS, and compare."""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.errors import ReaderError
from rosbags.typesys import Stores, get_typestore
from tqdm import tqdm

from tissue_sim.array_types import Floats
from tissue_sim.contact.finder import ContactFinder
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.errors import UserError
from tissue_sim.model.contact_set import ContactSet, contact_set
from tissue_sim.model.mailboxes import BodyInputs, JournalRow
from tissue_sim.model.records import array_of
from tissue_sim.model.settings import Settings
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags import bag, recovery
from tissue_sim.ros.shared.cdr import parse_stamped, unit_pose
from tissue_sim.ros.shared.tool_topics import GRIPPER_TOPICS, TOOL_TOPICS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("bag", metavar="BAG", help="folder of a recorded bag")
    parser.add_argument("--organ", metavar="ORGAN", help="replay with this organ instead of the recorded one")
    parser.add_argument("--force-tolerance", type=float, default=1e-6, help="largest deviation of a wrench, N and N m")
    parser.add_argument("--position-tolerance", type=float, default=1e-6, help="largest deviation of a position, m")


def run(args: argparse.Namespace) -> int:
    """Replay a bag; returns 0 when it repeats within the tolerances, else 1."""
    path = Path(args.bag)
    if recovery.is_broken_off(path):
        print(recovery.complete(path))
    recording = Recording.read(path)
    result = replay(recording, Organ.load(args.organ) if args.organ else None)
    print(
        f"{args.bag}: {result.ticks} ticks, {result.inputs} inputs, {result.contact_sets} contact sets;"
        f" compared {result.wrenches} wrenches and {result.surfaces} surfaces"
    )
    found = (
        ("force", result.force, "N", result.force_tick),
        ("torque", result.torque, "N m", result.torque_tick),
        ("position", result.position, "m", result.position_tick),
    )
    told = (f"{what} {most:.3g} {unit}{f' (tick {tick})' if most else ''}" for what, most, unit, tick in found)
    print(f"largest deviation: {', '.join(told)}")
    if result.wrenches == 0 and result.surfaces == 0:
        print("FAILED: the bag holds nothing to compare; record for longer than a second, with tools moving")
        return 1
    within = max(result.force, result.torque) <= args.force_tolerance and result.position <= args.position_tolerance
    print("repeats" if within else f"FAILED: beyond {args.force_tolerance:g} N or {args.position_tolerance:g} m")
    return 0 if within else 1


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
        store: Any = get_typestore(Stores.ROS2_JAZZY)
        name = next((topic[: -len("/config")] for topic in messages if topic.endswith("/config")), None)
        if name is None:
            raise UserError(f"bag {path} was not recorded by a tissue_sim node: it has no configuration")

        def data(topic: str) -> list[Any]:
            kind = bag.PRIVATE_TOPICS[topic]
            return [store.deserialize_cdr(raw, kind).data for raw in messages[f"{name}/{topic}"]]

        config = json.loads(data("config")[0])
        if config["format"] != bag.FORMAT:
            raise UserError(
                f"bag {path} has format {config['format']} (tissue_sim {config['package_version']}), this package reads"
                f" {bag.FORMAT}: replay it with that version, or record it again"
            )
        if not data("state"):
            raise UserError(f"bag {path} holds no state to start from: the recording was too short or broken off")
        if not data("journal"):
            raise UserError(f"bag {path} holds nothing that happened: the recording was too short or broken off")
        n_bodies = sum(tool.n_bodies for tool in _tools(config))
        rows = [bag.unpack(values) for values in data("journal")]
        kinds = rows[0] if rows else {}
        sets = [_contact_set(bag.unpack(values), n_bodies) for values in data("contact_set")]
        settings = [bag.unpack(values) for values in data("settings")]
        recording = cls(
            config=config,
            organ=bytes(data("organ")[0]),
            state=bag.unpack(data("state")[0]),
            settings={int(found["sequence"]): settings_of(path, found["settings"]) for found in settings},
            contact_sets={int(found.header.sequence): found for found in sets},
            journal={kind: np.concatenate([row[kind] for row in rows]) for kind in kinds},
        )
        for tool in config["tools"]:
            topics = {topic: config["topics"][f"{tool}/{topic}"] for topic in TOOL_TOPICS}
            first = {topic: int(config["first"].get(name, 1)) for topic, name in topics.items()}
            poses = [unit_pose(np.array(parse_stamped(raw, 7).values)) for raw in messages[topics["measured_cp"]]]
            forces = [np.array(parse_stamped(raw, 6).values[:3]) for raw in messages[topics["measured_cf"]]]
            recording.poses.append(dict(enumerate(poses, start=first["measured_cp"])))
            angles = messages[config["topics"].get(f"{tool}/measured_js", "")]
            kind = GRIPPER_TOPICS["measured_js"]
            values = [float(store.deserialize_cdr(raw, kind).data[0]) for raw in angles]
            recording.angles.append(dict(enumerate(values, start=first["measured_cp"])))
            recording.forces.append(dict(enumerate(forces, start=first["measured_cf"])))
            recording.wrenches.append([np.array(parse_stamped(r, 6).values) for r in messages[topics["servo_cf"]]])
        for raw in messages[f"{name}/surface"]:
            cloud: Any = store.deserialize_cdr(raw, "sensor_msgs/msg/PointCloud2")
            recording.surfaces.append(np.frombuffer(cloud.data, dtype="<f4").reshape(-1, 3))
        return recording


@dataclass
class Result:
    """How far a replay was from its bag."""

    ticks: int = 0
    inputs: int = 0
    contact_sets: int = 0
    wrenches: int = 0
    surfaces: int = 0
    force: float = 0.0
    force_tick: int = -1
    torque: float = 0.0
    torque_tick: int = -1
    position: float = 0.0
    position_tick: int = -1

    def compare_wrench(self, tick: int, recorded: Floats, replayed: Floats) -> None:
        """Note how far a wrench (6,) of a tick is from the recorded one."""
        self.wrenches += 1
        force, torque = (float(np.abs(recorded - replayed)[part].max()) for part in (slice(0, 3), slice(3, 6)))
        if force > self.force:
            self.force, self.force_tick = force, tick
        if torque > self.torque:
            self.torque, self.torque_tick = torque, tick

    def compare_surface(self, tick: int, recorded: np.ndarray, replayed: Floats) -> None:
        """Note how far the surface (n_surface, 3) of a tick is from the recorded one."""
        self.surfaces += 1
        position = float(np.abs(recorded - replayed.astype(np.float32)).max())
        if position > self.position:
            self.position, self.position_tick = position, tick


def replay(recording: Recording, organ: Organ | None = None) -> Result:
    """Feed the recorded inputs at the ticks that took them up; compare what the bag shows."""
    player = _Player(recording, organ or _recorded_organ(recording))
    return player.run()


class _Player:
    def __init__(self, recording: Recording, organ: Organ) -> None:
        parameters = recording.config["parameters"]
        self.recording = recording
        self.tools = ToolSet(_tools(recording.config))
        self.simulation = Simulation(
            organ,
            model=parameters["model"],
            rate=parameters["rate"],
            local_region=parameters["local_region"],
            shapes=self.tools.shapes,
            return_target=parameters.get("return_target", "rest"),
            integrator=parameters.get("integrator", "symplectic"),
            shape_gravity=recording.config["shape_gravity"],
        )
        self.poses = self._body_poses()
        self.forces = self._body_forces()
        self.simulation.restore(recording.state)
        self.state = self.simulation.state
        self.finder = ContactFinder(organ.rest_positions, organ.surface_triangles, organ.n_surface, self.tools)
        first = self.tick = int(self.state.status.tick)
        journal = recording.journal
        self.inputs = {
            int(row["tick"]): (row, bodies)
            for row, bodies in zip(journal["inputs"], journal["body_inputs"], strict=True)
        }
        self.found_from = {
            int(row["contact_set"]): (int(row["surface_tick"]), bodies)
            for row, bodies in zip(journal["contacts"], journal["body_contacts"], strict=True)
        }
        self.needed = {tick for tick, _ in self.found_from.values()}  # ticks whose surface a contact set was found from
        self.kept: dict[int, Floats] = {}
        self.wrench_at: dict[int, list[tuple[int, int]]] = defaultdict(list)  # tick -> tool, index
        seen = [0] * len(self.tools.tools)
        for tool, tick in journal["wrenches"].tolist():
            self.wrench_at[tick].append((tool, seen[tool]))
            seen[tool] += 1
        self.surface_at = {tick: index for index, (tick,) in enumerate(journal["surfaces"].tolist())}
        self.last = max([first, *self.inputs, *self.wrench_at, *self.surface_at])
        # What the state had already taken up: only what is new in a row is taken up again.
        before = max((tick for tick in self.inputs if tick <= first), default=None)
        self.taken = self.inputs[before] if before is not None else self._taken_from_state()

    def _body_poses(self) -> list[dict[int, Floats]]:
        """Poses of each body by sequence: a tool's own, or those of a gripper's jaws."""
        made: list[dict[int, Floats]] = []
        for tool, bodies in enumerate(self.tools.bodies):
            poses, angles = self.recording.poses[tool], self.recording.angles[tool]
            placed = {n: self.tools.poses(tool, pose, angles.get(n, 0.0)) for n, pose in poses.items()}
            made += [{n: at[k] for n, at in placed.items()} for k in range(len(bodies))]
        return made

    def _body_forces(self) -> list[dict[int, Floats]]:
        """Forces at each body's tip by sequence: a tool's first body takes them."""
        made: list[dict[int, Floats]] = []
        for tool, bodies in enumerate(self.tools.bodies):
            made += [self.recording.forces[tool], *({} for _ in bodies[1:])]
        return made

    def _wrench(self, tool: int, recorded: Floats) -> Floats:
        """A tool's wrench, (6,). Of a gripper the force: its torque is about a pose that the journal lacks."""
        bodies = self.tools.bodies[tool]
        if len(bodies) == 1:
            return np.asarray(self.state.wrench[bodies[0]])
        return np.concatenate([self.state.wrench[bodies, :3].sum(axis=0), recorded[3:]])

    def _taken_from_state(self) -> tuple[np.ndarray, np.ndarray]:
        """Nothing was taken up between the bag's start and the state: the state's own numbers count."""
        row = np.zeros((), dtype=JournalRow.dtype)
        row["contact_set"] = self.state.contacts.header.sequence
        if self.inputs:
            newest, _ = self.inputs[min(self.inputs)]
            row["settings"], row["resets"] = newest["settings"], newest["resets"]
        bodies = np.zeros(len(self.poses), dtype=BodyInputs.dtype)
        bodies["pose"], bodies["force"] = self.state.bodies.pose_sequence, self.state.bodies.force_sequence
        return row, bodies

    def run(self) -> Result:
        result = Result()
        settings = self.recording.settings
        start = max((number for number in settings if number <= self.taken[0]["settings"]), default=min(settings))
        self.simulation.take_settings(settings[start])
        for tick in tqdm(
            range(self.tick + 1, self.last + 1), disable=None, desc="replay", unit="tick", mininterval=0.5
        ):
            row = self.inputs.get(tick)
            if row is not None and tick > self.tick:
                self._take(*row, result)
                result.inputs += 1
            self.simulation.step()
            result.ticks += 1
            if tick in self.needed:
                self.kept[tick] = self.simulation.positions.copy()
            for tool, index in self.wrench_at.get(tick, ()):
                if index < len(self.recording.wrenches[tool]):
                    recorded = self.recording.wrenches[tool][index]
                    result.compare_wrench(tick, recorded, self._wrench(tool, recorded))
            index = self.surface_at.get(tick, -1)
            if 0 <= index < len(self.recording.surfaces):
                recorded = self.recording.surfaces[index]
                result.compare_surface(tick, recorded, self.simulation.positions[: len(recorded)])
        return result

    def _take(self, row: np.ndarray, bodies: np.ndarray, result: Result) -> None:
        """Take up what is new in a journal row, in the order of the node's loop."""
        last, last_bodies = self.taken
        simulation = self.simulation
        if row["resets"] != last["resets"]:
            simulation.reset()
        if row["settings"] != last["settings"]:
            simulation.take_settings(self.recording.settings[int(row["settings"])])
        for body in range(len(self.poses)):
            pose, force = int(bodies["pose"][body]), int(bodies["force"][body])
            if pose != last_bodies["pose"][body]:
                simulation.take_pose(body, self._input(self.poses[body], pose, "pose"), pose)
            if force != last_bodies["force"][body]:
                simulation.take_force(body, self._input(self.forces[body], force, "force"), force)
        contacts = int(row["contact_set"])
        if contacts != last["contact_set"]:
            result.contact_sets += 1
            simulation.take_contacts(self._contact_set(contacts), contacts)
        self.taken = row, bodies

    def _input(self, values: dict[int, Floats], sequence: int, what: str) -> Floats:
        if sequence not in values:
            raise UserError(f"the bag lacks {what} number {sequence}; its recording lost messages")
        return values[sequence]

    def _contact_set(self, sequence: int) -> ContactSet:
        whole = self.recording.contact_sets.get(sequence)
        if whole is not None:
            return whole
        tick, bodies = self.found_from.get(sequence, (-1, None))
        if bodies is None or tick not in self.kept:
            raise UserError(f"the bag lacks contact set number {sequence}; its recording lost messages")
        poses = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (len(self.poses), 1))
        for body, number in enumerate(bodies["pose"].tolist()):
            if number:
                poses[body] = self._input(self.poses[body], number, "pose")
        engaged, pushing = (bodies[name].astype(np.int64) for name in ("engaged", "pushing"))
        return self.finder.find(self.kept[tick], poses, np.ascontiguousarray(bodies["margin"]), engaged, pushing)


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
    return settings


def _contact_set(fields: dict[str, np.ndarray], n_bodies: int) -> ContactSet:
    """A contact set from its fields by name."""
    made = contact_set(n_bodies, len(fields["body"]))
    for name, value in made._asdict().items():
        if name != "words":
            array_of(value)[...] = fields[name]
    return made


def _tools(config: dict[str, Any]) -> list[Tool]:
    """The tools of a bag's configuration."""
    parameters, keys = config["parameters"], ("shape", "radius", "length", "mesh")
    return [Tool(name, **{key: parameters[f"{name}.{key}"] for key in keys}) for name in config["tools"]]


def _recorded_organ(recording: Recording) -> Organ:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "organ.npz"
        path.write_bytes(recording.organ)
        return Organ.load(path)


def _read_messages(path: Path) -> dict[str, list[bytes]]:
    messages: dict[str, list[bytes]] = defaultdict(list)
    try:
        if recovery.is_broken_off(path):
            for connection, _, raw in recovery.messages(path):
                messages[connection.topic].append(bytes(raw))
            return messages
        with Reader(path) as reader:
            for connection, _, raw in reader.messages():
                messages[connection.topic].append(bytes(raw))
    except (ReaderError, OSError, ValueError, KeyError, AssertionError) as error:
        raise UserError(f"bag {path} can't be read: {error}") from None
    return messages
