"""Tools, topics and frames as parameters describe them, the node's own or those of another node."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from tissue_sim.contact.quaternions import unit_quaternion
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError
from tissue_sim.ros.shared.frames import Frames, Placed, Transform
from tissue_sim.ros.shared.tool_messages import ToolTopics
from tissue_sim.ros.shared.tool_topics import TOOL_TOPICS


class Values(Protocol):
    """Parameters by name: a node's own, or a dictionary of another node's; their Specs say of which type each is."""

    def __getitem__(self, name: str, /) -> Any:
        """Return the value of a parameter."""


def tool_of(values: Values, name: str) -> Tool:
    """Return the tool of a name as its parameters describe it."""
    keys = ["shape", "radius", "length", "mesh", "smoothing", "tip_link", "jaw_joint", "height"]
    keys += ["cautery_speed", "cautery_stiffening", "cautery_spread"]
    links = tuple(link for link in values[f"{name}.links"] if link)
    return Tool(name, **{key: values[f"{name}.{key}"] for key in keys}, links=links)


def usual_topics(tool: str) -> dict[str, str]:
    """Return the default names of a tool's topics, by the topics of TOOL_TOPICS and measured_js.

    External forces have none: in CRTK a device publishes its own force as measured_cf, which must not return as one on
    the tissue.
    """
    names = {topic: f"{tool}/{topic}" for topic in TOOL_TOPICS}
    return names | {"external_cf": "", "measured_js": f"{tool}/gripper/measured_js"}


def topics_of(values: Values, tool: str) -> ToolTopics:
    """Return the topics and message types of a tool's bridge."""
    words = ["pose_type", "force_type", "wrench_type", "array_length", "wrench_frame", "reliable"]
    words += ["allow_empty_frame", "allow_zero_stamp"]
    return ToolTopics(
        names={topic: values[f"{tool}.{topic}"] or usual for topic, usual in usual_topics(tool).items()},
        frame_id=values[f"{tool}.frame_id"] or values["frame_id"],
        wrench_rotation=unit_quaternion(values[f"{tool}.wrench_rotation"]),
        **{word: values[f"{tool}.{word}"] for word in words},
    )


def frames_of(values: Values, tool: str, lookup: Callable[[str], Transform] | None) -> Frames:
    """Return the frames that a tool's poses may come in.

    lookup: transforms other frames to the node's `tf_target`, None without tf.
    """
    known, led, to_organ = _known(values, lookup)
    known.setdefault(_frame_of(values, tool), to_organ.after(Transform.of_pose(values[f"{tool}.base_pose"])))
    return Frames(known, values[f"{tool}.motion_scale"], led)


def frames_of_node(values: Values, lookup: Callable[[str], Transform] | None) -> Frames:
    """Return the frames that poses of something else than a tool may come in.

    lookup: transforms other frames to the node's `tf_target`, None without tf.
    """
    known, led, _ = _known(values, lookup)
    return Frames(known, 1.0, led)


def _known(
    values: Values, lookup: Callable[[str], Transform] | None
) -> tuple[dict[str, Transform], Callable[[str], Transform] | None, Transform]:
    """Return the transforms from the organ's frame and base_frame to the organ, a lookup of others, and the second."""
    organ_id, base_id = _organ_and_base(values)
    to_organ = Transform.of_pose(values["organ_pose"]).inverse()
    led = None if lookup is None else lambda frame_id: to_organ.after(lookup(frame_id))
    return {base_id: to_organ, organ_id: Transform()}, led, to_organ


def _organ_and_base(values: Values) -> tuple[str, str]:
    """Return the names of the organ's frame and of that of poses in parameters: the organ's, if it has no name."""
    return values["frame_id"], values["base_frame"] or values["frame_id"]


def _frame_of(values: Values, tool: str) -> str:
    """Return the name of the frame that a tool's poses come in."""
    return values[f"{tool}.frame_id"] or values["frame_id"]


def check_organ_pose(values: Values, pose: Sequence[float]) -> None:
    """Raise UserError for a pose (7,) of the organ where there is no other frame that it could be in."""
    organ_id, base_id = _organ_and_base(values)
    if base_id == organ_id and not Transform.of_pose(pose).is_identity:
        raise UserError(
            f"parameter 'organ_pose' is the pose of '{organ_id}' in base_frame, which is that frame itself: set"
            " base_frame to another one"
        )


def check_frames(values: Values, tools: Sequence[str]) -> None:
    """Raise UserError where parameters give a frame two places, so that a header would be ambiguous."""
    organ_id, base_id = _organ_and_base(values)
    check_organ_pose(values, values["organ_pose"])
    placed: dict[str, tuple[str, Transform]] = {}  # by frame: the tool that places it, and where
    for tool in tools:
        frame_id, pose = _frame_of(values, tool), Transform.of_pose(values[f"{tool}.base_pose"])
        if frame_id in (organ_id, base_id):
            if not pose.is_identity:
                raise UserError(
                    f"parameter '{tool}.base_pose' would move '{frame_id}', whose pose is already defined: set"
                    f" {tool}.frame_id to a frame of the tool's own"
                )
            continue
        first, other = placed.setdefault(frame_id, (tool, pose))
        if other != pose:
            raise UserError(
                f"parameters '{first}.base_pose' and '{tool}.base_pose' give the frame '{frame_id}' different"
                f" poses: set {first}.frame_id and {tool}.frame_id to two frames"
            )


def placed_frames(values: Values, tools: Sequence[str]) -> Placed:
    """Return the frames that parameters place in base_frame, which is the organ's where none is named.

    A tool's frame without a base_pose is left to its driver.
    """
    organ_id, base_id = _organ_and_base(values)
    poses = {_frame_of(values, tool): Transform.of_pose(values[f"{tool}.base_pose"]) for tool in tools}
    moved = {frame_id: pose for frame_id, pose in poses.items() if not pose.is_identity}
    if base_id != organ_id:
        moved[organ_id] = Transform.of_pose(values["organ_pose"])
    return {frame_id: (base_id, (*pose.translation, *pose.rotation)) for frame_id, pose in moved.items()}
