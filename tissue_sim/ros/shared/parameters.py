"""The node's parameters: descriptor, range and unit of each, and which may change while it runs."""

from __future__ import annotations

import array
import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from tissue_sim.contact.quaternions import unit_quaternion
from tissue_sim.contact.tools import SHAPE_NAMES, Tool
from tissue_sim.errors import UserError
from tissue_sim.model.data.settings import INTEGRATORS, LOCAL_REGIONS, Settings
from tissue_sim.model.simulation import acceleration_of
from tissue_sim.rendering.appearance import MARKER_COLOURS
from tissue_sim.ros.shared.frames import IDENTITY, Frames, Placed, Transform
from tissue_sim.ros.shared.priority import HIGHEST
from tissue_sim.ros.shared.tool_messages import FORCE_TYPES, POSE_TYPES, WRENCH_FRAMES, WRENCH_TYPES, ToolTopics
from tissue_sim.ros.shared.tool_topics import TOOL_TOPICS

SERVED_MODELS = ("auto", "hybrid", "cells")


@dataclass(frozen=True)
class Spec:
    """One parameter; `setting` is the field of the simulation's settings that it changes, if any."""

    name: str
    default: Any
    text: str
    low: float | None = None
    high: float | None = None
    live: bool = False
    choices: tuple[str, ...] = ()
    setting: str = ""
    check: Callable[[Any], object] | None = None  # raises ValueError with the reason


def _check_pose(value: Any) -> None:
    Transform.of_pose(value)


def _check_gravity(value: Any) -> None:
    try:
        acceleration_of(list(value), "of")
    except UserError as error:
        raise ValueError(str(error)) from None


NODE_SPECS = (
    Spec("organ_file", "", "organ file (.npz); empty for the default kidney"),
    Spec("scene_file", "", "scene file (.yaml) of several organs, instead of organ_file; empty for a single organ"),
    Spec("frame_id", "organ", "frame of the organ and of everything published"),
    Spec("base_frame", "", "reference frame of organ_pose and of each <tool>.base_pose; empty for the organ's frame"),
    Spec(
        "organ_pose",
        list(IDENTITY),
        "pose of the organ in base_frame, its registration: x, y, z (m), quaternion x, y, z, w",
        live=True,
        check=_check_pose,
    ),
    Spec("broadcast_tf", True, "publish the frames of organ, tools and tips to tf; needs tf2_ros"),
    Spec("rate", 1000.0, "ticks per second, Hz", 50.0, 4000.0, live=True),
    Spec(
        "realtime_priority",
        0,
        "SCHED_FIFO priority of the loop's thread, and one less for the threads that receive and answer poses; 0: none",
        0,
        HIGHEST,
    ),
    Spec("marker_rate", 60.0, "markers and surfaces published per second, Hz", 1.0, 240.0, live=True),
    Spec("marker_colour", "none", "quantity that the markers' colours show", live=True, choices=MARKER_COLOURS),
    Spec("contact_rate", 250.0, "contact sets found per second, Hz", 20.0, 1000.0, live=True),
    Spec("model", "auto", "model variant; auto: cells if the organ has them, otherwise hybrid", choices=SERVED_MODELS),
    Spec("integrator", "symplectic", "time integration of the nodes", choices=INTEGRATORS),
    Spec("local_region", "off", "part of the organ that moves under a small load", choices=LOCAL_REGIONS),
    Spec("region_force", 0.3, "N, load above which the whole organ moves", 0.0, 100.0, True, setting="region_force"),
    Spec("friction", 0.6, "Coulomb coefficient between tools and tissue", 0.0, 5.0, True, setting="friction"),
    Spec("toughness", 120.0, "J/m^2 that a blade needs to cut", 0.0, 1e5, True, setting="toughness"),
    Spec(
        "flank_friction",
        500.0,
        "Pa of friction on the flanks of a blade in a cut",
        0.0,
        1e6,
        True,
        setting="flank_friction",
    ),
    Spec("force_clamp", 10.0, "N, largest published force", 0.0, 100.0, True, setting="force_clamp"),
    Spec("force_slew", 1000.0, "N/s, fastest change of a published force", 1.0, 1e6, True, setting="force_slew"),
    Spec(
        "coupling_stiffness",
        0.0,
        "N/m between the device's pose and the tool, limited to what is passive with device_damping; 0: rigid",
        0.0,
        2e4,
        True,
        setting="coupling_stiffness",
    ),
    Spec("coupling_damping", 1.0, "N s/m, damping of a coupled tool", 0.1, 100.0, True, setting="coupling_damping"),
    Spec("stale_time", 0.05, "s after which a pose or force is stale", 0.005, 5.0, True, setting="stale_time"),
    Spec("ramp_time", 0.02, "s in which a stale force decreases to zero", 0.001, 1.0, True, setting="ramp_time"),
    Spec("stiffness_scale", 1.0, "factor on the tissue's stiffness", 0.01, 100.0, True, setting="stiffness_scale"),
    Spec("damping_scale", 1.0, "factor on the tissue's damping", 0.0, 100.0, True, setting="damping_scale"),
    Spec("gravity", [0.0, 0.0, 0.0], "gravity in the organ's frame, m/s^2", live=True, check=_check_gravity),
    Spec("shape_is_unloaded", False, "the shape in the organ file is the one without gravity, not the one under it"),
    Spec("cut_depth", 0.01, "depth below the path that ~/cut cuts, m", 1e-4, 1.0, True),
    Spec("step_ticks", 1, "ticks that ~/step takes while the node is paused", 1, 100_000, live=True),
    Spec("record", False, "record a bag from the start"),
    Spec("record_folder", "recordings", "folder for bags; while the node runs, only a folder below it", live=True),
    Spec("record_markers", False, "record the markers, too (9 to 14 MB per second)", live=True),
    Spec(
        "record_split_size",
        0.0,
        "MB after which the next bag continues in another file; 0: never",
        0.0,
        1e6,
        live=True,
    ),
    Spec(
        "record_split_duration",
        0.0,
        "s after which the next bag continues in another file; 0: never",
        0.0,
        86400.0,
        live=True,
    ),
)

TOOL_SPECS = (
    Spec("shape", "sphere", "shape of the tool; its origin is the tip", choices=SHAPE_NAMES),
    Spec("radius", 0.005, "m, of a sphere or capsule; half the thickness of an edge", 5e-4, 0.5),
    Spec("length", 0.05, "m, of a capsule or edge from its tip along -z; from a gripper's tips to its hinge", 0.0, 2.0),
    Spec("mesh", "", "mesh file of the tool, or of a gripper's jaw, in metres, closed unless convex; or a URDF"),
    Spec("links", [""], "links of a URDF whose collision elements are the tool's bodies; empty for all that have any"),
    Spec("tip_link", "", "link of a URDF whose frame is the tool's, the frame of its poses' axes; empty for its root"),
    Spec("jaw_joint", "", "joint of a URDF that measured_js moves, by its name there; empty for none"),
    Spec("height", 0.01, "m of a blade behind its edge", 1e-3, 0.5),
    Spec("cautery_speed", 0.0, "m/s at which a blade parts tissue without force; 0: it cuts by force", 0.0, 0.1),
    Spec("smoothing", 1.0, "fraction of the time between two poses in which the tool moves to the newer one", 0.0, 1.0),
    Spec("device_damping", 0.0, "N s/m of the device, which limits the coupling; 0: unknown", 0.0, 100.0, True),
    Spec("passivity_damping", 0.0, "N s/m, most that a passivity observer adds; 0: none", 0.0, 100.0, True),
    Spec("frame_id", "", "frame of its poses; empty for the organ's frame"),
    Spec("allow_empty_frame", False, "accept messages without a frame_id, as expressed in frame_id"),
    Spec("allow_zero_stamp", False, "accept messages with a stamp of 0, which marks invalid data, as of their arrival"),
    Spec("measured_cp", "", "topic of its poses; empty for <tool>/measured_cp"),
    Spec("measured_js", "", "topic of a gripper's opening angle, rad; empty for <tool>/gripper/measured_js"),
    Spec("external_cf", "", "topic of external forces on the tissue at its tip; empty for none"),
    Spec("servo_cf", "", "topic of the wrench for the device; empty for <tool>/servo_cf"),
    Spec("pose_type", "PoseStamped", "message type of measured_cp", choices=tuple(POSE_TYPES)),
    Spec("force_type", "WrenchStamped", "message type of external_cf", choices=tuple(FORCE_TYPES)),
    Spec("wrench_type", "WrenchStamped", "message type of servo_cf", choices=tuple(WRENCH_TYPES)),
    Spec("array_length", 3, "numbers in a Float64MultiArray: 3 forces, then up to 3 torques, then a zero", 3, 7),
    Spec("base_pose", list(IDENTITY), "pose of its frame_id in base_frame: x, y, z (m), quaternion", check=_check_pose),
    Spec("motion_scale", 1.0, "displacement of the tool over that of the device; forces are not scaled", 0.01, 1.0),
    Spec("wrench_frame", "base", "axes of servo_cf: the poses' frame or the tool's own", choices=WRENCH_FRAMES),
    Spec(
        "wrench_rotation",
        [0.0, 0.0, 0.0, 1.0],
        "quaternion of the wrench's axes in wrench_frame, for a bridge that rotates its poses",
        check=unit_quaternion,
    ),
    Spec("reliable", False, "reliable instead of best effort for this tool's topics"),
)


RENAMED = {"measured_cf": "external_cf"}  # former and present names of a tool's parameters
OFF = "off"  # YAML, and so rcl and the ros2 command line, read it as false
ORGANS = "organs"  # read-only parameter with the organs that were found
OF_RCLPY = ("qos_overrides.", "start_type_description_service", "use_sim_time")


class Values(Protocol):
    """Parameters by name: a node's own, or a dictionary of another node's."""

    def __getitem__(self, name: str, /) -> Any:
        """Return the value of a parameter."""


def tool_of(values: Values, name: str) -> Tool:
    """Return the tool of a name as its parameters describe it.

    Parameters
    ----------
    values : Values
        The parameters.
    name : str
        Name of the tool.
    """
    keys = "shape", "radius", "length", "mesh", "smoothing", "tip_link", "jaw_joint", "height", "cautery_speed"
    links = tuple(link for link in values[f"{name}.links"] if link)
    return Tool(name, **{key: values[f"{name}.{key}"] for key in keys}, links=links)


def usual_topics(tool: str) -> dict[str, str]:
    """Return the default names of a tool's topics, by the topics of TOOL_TOPICS and measured_js.

    External forces have none: in CRTK a device publishes its own force as measured_cf, which must not return as one on
    the tissue.

    Parameters
    ----------
    tool : str
        Name of the tool.
    """
    names = {topic: f"{tool}/{topic}" for topic in TOOL_TOPICS}
    return names | {"external_cf": "", "measured_js": f"{tool}/gripper/measured_js"}


def topics_of(values: Values, tool: str) -> ToolTopics:
    """Return the topics and message types of a tool's bridge.

    Parameters
    ----------
    values : Values
        The parameters.
    tool : str
        Name of the tool.
    """
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

    Parameters
    ----------
    values : Values
        The parameters.
    tool : str
        Name of the tool.
    lookup : Callable[[str], Transform] | None
        Transforms other frames to the node's `tf_target`; None without tf.
    """
    known, led, to_organ = _known(values, lookup)
    known.setdefault(_frame_of(values, tool), to_organ.after(Transform.of_pose(values[f"{tool}.base_pose"])))
    return Frames(known, values[f"{tool}.motion_scale"], led)


def frames_of_node(values: Values, lookup: Callable[[str], Transform] | None) -> Frames:
    """Return the frames that poses of something else than a tool may come in.

    Parameters
    ----------
    values : Values
        The parameters.
    lookup : Callable[[str], Transform] | None
        Transforms other frames to the node's `tf_target`; None without tf.
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

    Parameters
    ----------
    values : Values
        The parameters.
    tools : Sequence[str]
        Names of the tools.
    """
    organ_id, base_id = _organ_and_base(values)
    poses = {_frame_of(values, tool): Transform.of_pose(values[f"{tool}.base_pose"]) for tool in tools}
    moved = {frame_id: pose for frame_id, pose in poses.items() if not pose.is_identity}
    if base_id != organ_id:
        moved[organ_id] = Transform.of_pose(values["organ_pose"])
    return {frame_id: (base_id, (*pose.translation, *pose.rotation)) for frame_id, pose in moved.items()}


class Parameters:
    """The parameters of a node: declared here, and read by name.

    Parameters
    ----------
    node : Node
        The node.

    Raises
    ------
    UserError
        When a value is out of range or of the wrong type; the message names the parameter.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._specs: dict[str, Spec] = {}
        self.changed: list[Callable[[set[str]], None]] = []  # called with the names after a live change
        # Checks of live changes, by name; they raise UserError.
        self.checks: dict[str, Callable[[Any], object]] = {"organ_pose": partial(check_organ_pose, self)}
        for spec in NODE_SPECS:
            self._declare(spec.name, spec)
        self._declare("tools", Spec("tools", ["left", "right"], "names of the tools"))
        self.tools: list[str] = list(self["tools"])
        for tool in self.tools:
            if not tool.isidentifier() or self.tools.count(tool) > 1:
                raise UserError(f"parameter 'tools': '{tool}' is not a valid or unique name; use letters, digits and _")
            for spec in TOOL_SPECS:
                self._declare(f"{tool}.{spec.name}", spec)
        check_frames(self, self.tools)
        self._warn_of_unknown()
        node.add_pre_set_parameters_callback(lambda given: [self._as_meant(parameter) for parameter in given])
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._notify)

    def __getitem__(self, name: str) -> Any:
        return self._node.get_parameter(name).value

    @property
    def tf_target(self) -> str:
        """Frame that other frames are looked up against."""
        return self["base_frame"] or self["frame_id"]

    def apply(self, settings: Settings) -> None:
        """Write the parameters that are settings of the simulation.

        Parameters
        ----------
        settings : Settings
            The settings; updated.
        """
        for spec in NODE_SPECS:
            if spec.setting:
                setattr(settings, spec.setting, self[spec.name])
        settings.gravity_x, settings.gravity_y, settings.gravity_z = self["gravity"]

    def prefer(self, name: str, value: Any) -> None:
        """Give a live parameter another default; a parameter file may contain the old one.

        Parameters
        ----------
        name : str
            Name of the parameter.
        value : Any
            The other default.
        """
        if _plain(self[name]) == self._specs[name].default:
            self._node.set_parameters([Parameter(name, value=value)])

    def report_organs(self, names: Sequence[str]) -> None:
        """Declare the read-only parameter with the names of a scene's organs; none for a single one.

        Parameters
        ----------
        names : Sequence[str]
            The names.
        """
        text = "names of a scene's organs, with which their topics begin; empty for a single organ"
        # Dynamic: rclpy takes an empty list for one of bytes.
        descriptor = ParameterDescriptor(description=text, dynamic_typing=True, read_only=True)
        self._node.declare_parameter(ORGANS, list(names), descriptor, ignore_override=True)
        self._specs[ORGANS] = Spec(ORGANS, list(names), text)

    def values(self) -> dict[str, Any]:
        """Return all parameters by name, as plain values."""
        return {name: _plain(self[name]) for name in self._specs}

    # inside ------------------------------------------------------------------------------------
    def _declare(self, name: str, spec: Spec) -> None:
        descriptor = ParameterDescriptor(description=spec.text, read_only=not spec.live)
        constraints = ["one of " + ", ".join(spec.choices)] if spec.choices else []
        constraints.append("may change while the node runs" if spec.live else "fixed when the node starts")
        descriptor.additional_constraints = "; ".join(constraints)
        if spec.low is not None and spec.high is not None:
            if isinstance(spec.default, int):
                bounds = IntegerRange(from_value=int(spec.low), to_value=int(spec.high), step=1)
                descriptor.integer_range = [bounds]
            else:
                descriptor.floating_point_range = [
                    FloatingPointRange(from_value=spec.low, to_value=spec.high, step=0.0)
                ]
        descriptor.dynamic_typing = OFF in spec.choices  # or rclpy would refuse it before _as_meant
        self._specs[name] = spec
        given = self._node._parameter_overrides.get(name)  # rclpy shows no other way to it
        if given is not None:
            self._node._parameter_overrides[name] = self._as_meant(given)
        try:
            self._node.declare_parameter(name, spec.default, descriptor)
        except InvalidParameterTypeException:
            kind = type(spec.default).__name__
            if kind == "list":
                kind = f"list like {spec.default}"
            raise UserError(f"parameter '{name}' has the wrong type; expected a {kind}: {spec.text}") from None
        except InvalidParameterValueException:
            value = given.value if given is not None else "its value"
            raise UserError(
                f"parameter '{name}': {value} is outside {spec.low:g}..{spec.high:g} ({spec.text})"
            ) from None
        if problem := _problem(name, spec, self[name]):
            raise UserError(problem)

    def _warn_of_unknown(self) -> None:
        """Warn about unknown parameters: a misspelt one changes nothing, though a shared file may hold others' too."""
        for name in self._node._parameter_overrides:
            if self._node.has_parameter(name) or name.startswith(OF_RCLPY) or name == ORGANS:
                continue
            tool, _, was = name.partition(".")
            if tool in self.tools and was in RENAMED:
                now = f"{tool}.{RENAMED[was]}"
                self._node.get_logger().warning(
                    f"parameter '{name}' has no effect: its name is now '{now}', {self._specs[now].text}"
                )
                continue
            nearest = difflib.get_close_matches(name, self._specs, 1)
            hint = f"did you mean '{nearest[0]}'?" if nearest else "'tissue_node --help' lists all"
            self._node.get_logger().warning(f"parameter '{name}' is unknown and has no effect; {hint}")

    def _as_meant(self, parameter: Parameter) -> Parameter:
        """Return a parameter as it was meant: a choice that YAML reads as false, or decimals read as whole numbers."""
        spec = self._specs.get(parameter.name)
        if spec is None:
            return parameter
        if OFF in spec.choices and parameter.value is False:
            return Parameter(parameter.name, value=OFF)
        kind = Parameter.Type
        if isinstance(spec.default, float) and parameter.type_ == kind.INTEGER:
            return Parameter(parameter.name, value=float(parameter.value))
        if _is_decimals(spec.default) and parameter.type_ == kind.INTEGER_ARRAY:
            return Parameter(parameter.name, value=[float(value) for value in parameter.value])
        return parameter

    def decided(self, parameter: Parameter) -> SetParametersResult | None:
        """Return the result of setting a parameter that is fixed; None for one that isn't.

        Its present value is accepted, as in a dump of the node's own that is loaded again; rclpy would refuse it.

        Parameters
        ----------
        parameter : Parameter
            The parameter.
        """
        spec = self._specs.get(parameter.name)
        if spec is None or spec.live:
            return None
        if _plain(self._as_meant(parameter).value) == _plain(self[parameter.name]):
            return SetParametersResult(successful=True)
        reason = f"'{parameter.name}' can't change while the node runs; restart the node with the new value"
        if parameter.name == ORGANS:
            reason = f"'{ORGANS}' reports which organs the node serves, and can't be set"
        return SetParametersResult(successful=False, reason=reason)

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        """Accept live parameters in range; refuse others with the reason."""
        for parameter in parameters:
            spec = self._specs.get(parameter.name)
            if spec is None:
                continue
            if problem := _problem(parameter.name, spec, parameter.value):
                return SetParametersResult(successful=False, reason=problem)
            try:
                self.checks.get(parameter.name, bool)(parameter.value)
            except UserError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _notify(self, parameters: list[Parameter]) -> None:
        """Notify the listeners after a change that was not refused."""
        names = {parameter.name for parameter in parameters} & set(self._specs)
        for call in self.changed if names else []:
            call(names)


def _problem(name: str, spec: Spec, value: Any) -> str:
    if spec.choices and value not in spec.choices:
        return f"parameter '{name}': '{value}' is unknown; choose one of {', '.join(spec.choices)}"
    if spec.low is not None and spec.high is not None:
        if not np.isfinite(value) or not spec.low <= value <= spec.high:
            return f"parameter '{name}': {value} is outside {spec.low:g}..{spec.high:g} ({spec.text})"
    if spec.check is not None:
        try:
            spec.check(value)
        except ValueError as error:
            return f"parameter '{name}' {error}"
    return ""


def _is_decimals(value: Any) -> bool:
    """Return whether it is a list of numbers that need not be whole."""
    return isinstance(value, list) and bool(value) and isinstance(value[0], float)


def _plain(value: Any) -> Any:
    if isinstance(value, Path):
        return str(value)
    return list(value) if isinstance(value, (list, tuple, array.array)) else value
