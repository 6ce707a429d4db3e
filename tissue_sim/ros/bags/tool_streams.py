"""Poses of a tool and forces on it from any bag: of a node of this package, or of a robot with a force sensor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.ros.bags import recovery
from tissue_sim.ros.bags.reading import read_bag
from tissue_sim.ros.shared.cdr import Stamped, parse_stamped, unit_pose

POSE, WRENCH = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped"
NS = 1e-9


class ToolStream(NamedTuple):
    """Times (k,) s, positions (k, 3) m, quaternions (k, 4) xyzw and forces (k, 3) N of a tool, and its radius, m.

    The radius is None where the bag doesn't know it.
    """

    time: Floats
    positions: Floats
    quaternions: Floats
    forces: Floats
    radius: float | None


def recorded_tool(path: Path, name: str | None) -> ToolStream:
    """Return what a node of this package recorded of a tool, in the organ's axes.

    path: folder of the bag; name: the tool, None for the only one that is round. Raises UserError for a bag that can't
    be read, and a tool that it doesn't have.
    """
    if path.exists():
        _check_own(path)
    bag = read_bag(path)
    names = [tool.name for tool in bag.tools]
    round_ones = [tool for tool in bag.tools if tool.shape == "sphere" and name in (None, tool.name)]
    if not round_ones:
        raise UserError(f"bag {path} has no spherical tool{f' {name}' if name else ''}; it has {', '.join(names)}")
    recorded = [tool for tool in round_ones if {f"{tool.name}/position", f"{tool.name}/force"} <= set(bag)]
    if not recorded:
        idle = ", ".join(tool.name for tool in round_ones)
        raise UserError(f"bag {path} has no poses with forces of {idle}; record while a tool presses the organ")
    if len(recorded) > 1:
        which = ", ".join(tool.name for tool in recorded)
        raise UserError(f"bag {path} has several tools with poses and forces, {which}; choose one with --tool")
    tool = recorded[0]
    positions, turns, forces = (bag[f"{tool.name}/{what}"] for what in ("position", "quaternion", "force"))
    known = forces.time >= positions.time[0]
    time = forces.time[known]
    return ToolStream(
        time,
        _between(positions.time, positions.values, time),
        _nearest(turns.time, turns.values, time),
        forces.values[known],
        tool.radius,
    )


def topics_of(path: Path, pose_topic: str, wrench_topic: str) -> ToolStream:
    """Return a tool's stream from two topics of a bag, in the axes that these have.

    path: folder of the bag; pose_topic: topic of PoseStamped; wrench_topic: topic of WrenchStamped. Raises UserError
    for a bag that can't be read, and topics that it doesn't have or that are of another type.
    """
    pose_time, poses = _messages(path, pose_topic, POSE, 7)
    wrench_time, wrenches = _messages(path, wrench_topic, WRENCH, 6)
    try:
        poses = np.array([unit_pose(pose) for pose in poses])
    except ValueError as error:
        raise UserError(f"bag {path}: {pose_topic} has an invalid pose: {error}") from None
    known = (wrench_time >= pose_time[0]) & (wrench_time <= pose_time[-1])
    if not known.any():
        raise UserError(f"bag {path}: {pose_topic} and {wrench_topic} have no time in common")
    time = wrench_time[known]
    return ToolStream(
        time - time[0],
        _between(pose_time, poses[:, :3], time),
        _nearest(pose_time, poses[:, 3:], time),
        wrenches[known, :3],
        None,
    )


def in_pose_axes(stream: ToolStream) -> ToolStream:
    """Return a stream whose forces were in the tool's axes with forces in those of its poses."""
    return stream._replace(forces=Rotation.from_quat(stream.quaternions).apply(stream.forces))


def in_organ_axes(stream: ToolStream, organ_pose: Sequence[float]) -> ToolStream:
    """Return a stream in the axes of an organ whose pose (7,), m and xyzw, is given in the stream's axes.

    Raises UserError for an invalid pose.
    """
    try:
        pose = unit_pose(np.array(organ_pose, dtype=np.float64))
    except ValueError as error:
        raise UserError(f"--organ-pose is invalid: {error}") from None
    back = Rotation.from_quat(pose[3:]).inv()
    return stream._replace(positions=back.apply(stream.positions - pose[:3]), forces=back.apply(stream.forces))


def _messages(path: Path, topic: str, kind: str, size: int) -> tuple[Floats, Floats]:
    """Return times (k,) s and values (k, size) of a topic, in the order of their stamps."""
    if not path.exists():
        raise UserError(f"bag {path} does not exist")
    found: list[tuple[int, Stamped]] = []
    with recovery.opened(path, of_node=False) as readers:
        types = {one.topic: one.msgtype for reader in readers for one in reader.connections}
        if types.get(topic) != kind:
            some = ", ".join(sorted(name for name, own in types.items() if own == kind)) or "none"
            raise UserError(f"bag {path} has no topic {topic} of {kind}; those of this type: {some}")
        for reader in readers:
            chosen = [one for one in reader.connections if one.topic == topic]
            if chosen:  # rosbags takes none for all
                found += [(logged, parse_stamped(bytes(raw), size)) for _, logged, raw in reader.messages(chosen)]
    if not found:
        raise UserError(f"bag {path}: no message on {topic}")
    time = NS * np.array([message.stamp or logged for logged, message in found], dtype=np.float64)
    values = np.array([message.values for _, message in found])
    if not np.isfinite(values).all():
        raise UserError(f"bag {path}: {topic} holds what is not finite")
    order = np.argsort(time, kind="stable")
    return time[order], values[order]


def _check_own(path: Path) -> None:
    """Raise UserError for a bag of others, with the topics that it has."""
    with recovery.opened(path, of_node=False) as readers:
        types = {one.topic: one.msgtype for reader in readers for one in reader.connections}
    if any(topic.endswith("/config") for topic in types):
        return
    poses, wrenches = (
        ", ".join(sorted(name for name, own in types.items() if own == kind)) or "none" for kind in (POSE, WRENCH)
    )
    raise UserError(
        f"bag {path} was not recorded by a tissue_sim node; name its topics with --pose-topic (PoseStamped: {poses})"
        f" and --wrench-topic (WrenchStamped: {wrenches})"
    )


def _between(time: Floats, values: Floats, at: Floats) -> Floats:
    """Return values (k, c) at other times (m,)."""
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)


def _nearest(time: Floats, values: Floats, at: Floats) -> Floats:
    """Return the values (k, c) that were the newest at other times (m,)."""
    return np.asarray(values[np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 1)])
