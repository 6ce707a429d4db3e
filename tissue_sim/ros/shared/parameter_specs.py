"""Every parameter: its default, range, unit and description, and whether it may change while the node runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tissue_sim.contact.quaternions import unit_quaternion
from tissue_sim.contact.tools import SHAPE_NAMES
from tissue_sim.errors import UserError
from tissue_sim.model.data.settings import INTEGRATORS, LOCAL_REGIONS
from tissue_sim.model.elasticity.gravity import acceleration_of
from tissue_sim.rendering.appearance import MARKER_COLOURS
from tissue_sim.ros.shared.frames import IDENTITY, Transform
from tissue_sim.ros.shared.priority import HIGHEST
from tissue_sim.ros.shared.tool_messages import FORCE_TYPES, POSE_TYPES, WRENCH_FRAMES, WRENCH_TYPES

SERVED_MODELS = ("auto", "hybrid", "cells")


@dataclass(frozen=True)
class Spec:
    """One parameter; `setting` is the field of the simulation's settings that it changes, if any."""

    name: str
    default: bool | float | str | list[float] | list[str]
    text: str
    low: float | None = None
    high: float | None = None
    live: bool = False
    choices: tuple[str, ...] = ()
    setting: str = ""
    check: Callable[..., object] | None = None  # of a value; raises ValueError with the reason


def _check_pose(value: Sequence[float]) -> None:
    Transform.of_pose(value)


def _check_gravity(value: Sequence[float]) -> None:
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
    Spec("cautery_stiffening", 1.0, "factor by which cautery stiffens the walls of its cut; 1: not at all", 1.0, 20.0),
    Spec("cautery_spread", 0.001, "m from its cut that the heat of cautery reaches", 0.0, 0.01),
    Spec("smoothing", 1.0, "fraction of the time between two poses in which the tool moves to the newer one", 0.0, 1.0),
    Spec("device_damping", 0.0, "N s/m of the device, which limits the coupling; 0: unknown", 0.0, 100.0, True),
    Spec("passivity_damping", 0.0, "N s/m, most that a passivity observer adds; 0: none", 0.0, 100.0, True),
    Spec("frame_id", "", "frame of its poses; empty for the organ's frame"),
    Spec("allow_empty_frame", False, "accept messages without a frame_id, as expressed in frame_id"),
    Spec("allow_zero_stamp", False, "accept messages with a stamp of 0, which marks invalid data, as of their arrival"),
    Spec("measured_cp", "", "topic of its poses; empty for <tool>/measured_cp"),
    Spec("tf_frame", "", "frame of tf whose pose the tool has, in place of measured_cp; empty for none"),
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
