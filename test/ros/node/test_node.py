"""The node as others meet it: real processes that talk over DDS."""

import itertools
import math
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import DescribeParameters
from rosbags.rosbag2 import Reader
from visualization_msgs.msg import Marker

from helpers.diagnostics_page import is_explained
from helpers.ros.clients import Client
from helpers.ros.processes import (
    PUSHED,
    UNHURRIED,
    Process,
    poke_path,
    press_until_contact,
    running_node,
    shipped,
    start_node,
    start_publisher,
)
from helpers.ros.replaying import repeated
from tissue_sim.ros.shared.parameter_specs import NODE_SPECS, TOOL_SPECS


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    folder = tmp_path_factory.mktemp("node")
    with running_node(folder, "marker_rate:=30.0", UNHURRIED, PUSHED, f"record_folder:={folder / 'bags'}") as process:
        yield process


@pytest.fixture(scope="module")
def only_client(node):
    client = Client()
    assert client.spin_until(lambda: client.pose.get_subscription_count() > 0)
    assert client.spin_until(lambda: len(client.surface()) > 0), "late joiners get no markers"
    yield client
    client.close()


@pytest.fixture
def client(only_client):
    """The client, with an organ at rest, and no messages received but its shape then."""
    assert only_client.set_parameter("stale_time", 5.0).successful
    only_client.reset()
    assert only_client.spin_until(lambda: only_client.moved() < 1e-6)
    only_client.wrenches.clear()
    return only_client


def test_poses_from_a_second_process_deform_the_organ_and_let_it_return(client, tmp_path):
    """Wrench and markers rise on contact and come back to within 1 % of their peak."""
    publisher = start_publisher(tmp_path, depth=0.004)
    assert client.spin_until(lambda: publisher.says("pressed")), publisher.text()
    assert client.spin_until(lambda: client.moved() > 0.0025), "4 mm, less what lies between nodes gives"
    moved = client.moved()
    assert client.spin_until(lambda: client.hand_force() > 0.05), client.diagnostics
    publisher.child.terminate()
    assert client.spin_until(lambda: publisher.child.poll() is not None)
    assert publisher.stop() == 0, publisher.text()
    force = np.array([np.linalg.norm(wrench[:3]) for _, wrench in client.wrenches])
    assert force.max() < 2.0
    assert moved < 0.006
    pushed = client.wrenches[int(np.argmax(force))][1]
    assert pushed[0] > 0.9 * force.max(), "the tissue pushes the tool back out"
    assert client.spin_until(lambda: client.hand_force() <= 0.01 * force.max())
    assert client.spin_until(lambda: client.moved() <= 0.01 * moved)


def test_markers_are_what_rviz_can_bear(client):
    markers = {(marker.ns, marker.id): marker for marker in client.markers().markers}
    organ = shipped()
    surface = markers["surface", 0]
    assert surface.type == Marker.TRIANGLE_LIST
    assert len(surface.points) == 3 * len(organ.surface_triangles)
    assert surface.header.frame_id == "organ"
    assert surface.pose.orientation.w == 1.0
    corners = np.array([(p.x, p.y, p.z) for p in surface.points]).reshape(-1, 3, 3)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert area.min() > 0.0
    assert len(markers["skeleton", 0].points) == 2 * (organ.n_atoms - 1)
    arrows = [marker for (namespace, _), marker in markers.items() if namespace == "contacts"]
    assert len(arrows) == 2
    assert all(arrow.action == Marker.DELETE for arrow in arrows), "no force, no arrow"
    assert all(marker.points for marker in markers.values()), "an empty list crashes RViz"


def test_force_fades_when_poses_stop(client):
    """A stale pose ramps the wrench to zero and leaves no force standing; after how many ticks, test/contact shows."""
    position = press_until_contact(client, client.ask, deepest=0.003)
    assert client.spin_until(lambda: client.ask(position) or client.hand_force() > 0.03)
    assert client.set_parameter("stale_time", 0.05).successful
    assert client.spin_until(lambda: client.hand_force() == 0.0), client.diagnostics
    client.spin(0.2)
    assert np.abs(client.wrenches[-1][1]).max() == 0.0


@pytest.mark.extended
def test_force_fades_when_who_sends_poses_is_killed(client, tmp_path):
    publisher = start_publisher(tmp_path, depth=0.003)
    assert client.spin_until(lambda: publisher.says("pressed") and client.hand_force() > 0.03), publisher.text()
    publisher.child.kill()
    assert client.set_parameter("stale_time", 0.05).successful
    assert client.spin_until(lambda: client.hand_force() == 0.0), client.diagnostics
    client.spin(0.2)
    assert np.abs(client.wrenches[-1][1]).max() == 0.0


def test_external_force_moves_the_tissue(client):
    touch, inward = poke_path(shipped(), radius=0.0)

    def is_pushed():
        client.send_pose(touch - 0.0055 * inward)  # the tip stays clear of the surface
        client.send_force(0.1 * inward)
        client.spin(0.005)
        moved = client.surface() - client.rest
        return moved[np.argmax(np.linalg.norm(moved, axis=1))] @ inward > 0.0005

    assert client.spin_until(is_pushed), client.diagnostics
    assert client.set_parameter("stale_time", 0.05).successful
    assert client.spin_until(lambda: client.moved() < 5e-6), "it goes back when nobody pushes"


BAD_POSES = {
    "unknown_frame": {"frame": "moon"},
    "nan_pose": {"position": (math.nan, 0.0, 0.0)},
    "zero_quaternion": {"quaternion": (0.0, 0.0, 0.0, 0.0)},
    "large_quaternion": {"quaternion": (0.0, 1e200, 0.0, 1.0)},
    "no_stamp": {"stamp": 0.0},
    "far_pose": {"position": (150.0, 0.0, 0.0)},
}


def test_bad_poses_are_refused_by_name(client, node):
    """A clear line, a counter in diagnostics, and a node that goes on."""

    def all_are_reported():
        for bad in BAD_POSES.values():
            client.send_pose(**{"position": (1.0, 0.0, 0.0)} | bad)
        return all(reason in client.message for reason in BAD_POSES)

    assert client.spin_until(all_are_reported), client.message
    unknown = [key for key in client.diagnostics if not is_explained(key, ("left", "right"))]
    assert not unknown, "the page on diagnostics lacks these"
    for reason in BAD_POSES:
        assert int(client.diagnostics[f"left.refused.{reason}"]) > 0, client.diagnostics
    assert client.level != b"\x00"
    assert node.text().count("tool 'left': pose refused: ") >= len(BAD_POSES)
    before = int(client.diagnostics["tick"])
    assert client.spin_until(lambda: int(client.diagnostics["tick"]) > before + 500), "the node went on"


def test_stamp_that_runs_backwards_is_refused(client):
    now, sent = time.time(), itertools.count()

    def is_refused():
        client.ask((1.0, 0.0, 0.0), stamp=now - 0.01 * (next(sent) % 2))
        return int(client.diagnostics.get("left.refused.backward_stamp", 0)) > 0

    assert client.spin_until(is_refused)
    # A bridge that starts again with an older clock is accepted after a pause.
    assert client.set_parameter("stale_time", 0.05).successful
    poses = int(client.report()["left.poses"])

    def is_heard():
        client.spin(0.5)
        client.send_pose((1.0, 0.0, 0.0), stamp=now - 1000.0)
        return int(client.diagnostics["left.poses"]) > poses

    assert client.spin_until(is_heard)


def test_stamp_that_stands_or_leaps_is_refused(client):
    """A driver repeats its last message when its device has gone; one wrong stamp must not refuse those that follow."""
    stands = time.time()

    def is_stale():
        client.ask((1.0, 0.0, 0.0), stamp=stands)
        return int(client.diagnostics.get("left.refused.same_stamp", 0)) > 0

    assert client.spin_until(is_stale)

    def has_leapt():
        client.ask((1.0, 0.0, 0.0), stamp=time.time())
        client.ask((1.0, 0.0, 0.0), stamp=time.time() + 3600.0)
        return int(client.diagnostics.get("left.refused.forward_stamp", 0)) > 0

    assert client.spin_until(has_leapt)


def test_tool_that_appears_inside_is_held_off(client, node):
    assert client.set_parameter("stale_time", 0.05).successful
    inside = shipped().atom_positions[20]

    def is_reported():
        client.spin(0.3)  # the last pose, wherever it was, is stale
        client.ask(inside)
        return "appeared inside the organ" in node.text()

    assert client.spin_until(is_reported)
    assert client.set_parameter("stale_time", 5.0).successful
    client.wrenches.clear()
    for _ in range(60):
        client.ask(inside)
    assert len(client.wrenches) > 5
    assert all(np.all(wrench == 0.0) for _, wrench in client.wrenches)

    def warns():
        client.ask(inside)
        state = client.diagnostics.get("left.state")
        return state == "held_off" and client.message.startswith("tool 'left' is inactive")

    assert client.spin_until(warns), client.message
    said, counted = node.text().count("'left' is inactive"), int(client.diagnostics["left.held_off"])
    client.reset()  # the tool is inside still
    assert client.spin_until(lambda: client.ask(inside) or node.text().count("'left' is inactive") > said)
    assert client.spin_until(lambda: client.ask(inside) or int(client.diagnostics["left.held_off"]) > counted)


def test_tool_that_is_pressed_too_deep_is_held_and_reported(client, node):
    assert client.set_parameter("stale_time", 5.0).successful
    organ = shipped()
    top = int(np.argmax(organ.surface_positions[:, 0]))
    place, inward = organ.surface_positions[top], -organ.surface_normals[top]
    depths = iter(np.concatenate([np.linspace(-0.01, 0.06, 700), np.full(10**6, 0.06)]).tolist())

    def warns():
        client.ask(place + next(depths) * inward)
        state = client.diagnostics.get("left.state")
        return state == "slipped" and "slipped into the tissue" in client.message

    assert client.spin_until(warns), client.message

    def is_true(holds):
        """Of the log, and of a report that may have come just when the tool was put back: as soon as it is."""
        return client.spin_until(lambda: client.ask(place + next(depths) * inward) or holds())

    assert is_true(lambda: "deeper than the surface can bear, and presses on it with at most" in node.text())
    assert is_true(lambda: float(client.diagnostics["left.force_n"]) > 0.1), "and felt"
    client.ask(place - 0.02 * inward)
    outside = place - 0.02 * inward
    assert client.spin_until(lambda: client.ask(outside) or client.diagnostics.get("left.state") == "fresh")


def test_parameters_change_live_or_say_why_not(client):
    assert client.set_parameter("friction", 0.3).successful
    assert client.set_parameter("marker_rate", 20.0).successful
    refused = client.set_parameter("model", "hybrid")
    assert not refused.successful
    assert "restart the node" in refused.reason
    refused = client.set_parameter("organ_pose", [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert not refused.successful
    assert "which is that frame itself" in refused.reason
    assert not client.set_parameter("friction", -1.0).successful
    assert client.set_parameter("friction", 0.6).successful
    assert client.set_parameter("marker_rate", 30.0).successful


def test_descriptors_tell_what_may_change_while_the_node_runs(client):
    specs = {spec.name: spec for spec in NODE_SPECS} | {f"left.{spec.name}": spec for spec in TOOL_SPECS}
    request = DescribeParameters.Request(names=[*specs, "tools", "organs"])
    descriptors = client.call(DescribeParameters, "/tissue_sim/describe_parameters", request).descriptors
    assert {one.name: one.read_only for one in descriptors} == {
        **{name: not spec.live for name, spec in specs.items()},
        "tools": True,
        "organs": True,
    }
    friction = next(one for one in descriptors if one.name == "friction")
    assert friction.additional_constraints == "may change while the node runs"


def test_diagnostics_have_a_status_for_each_tool_and_organ(client):
    reports = []
    client.node.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 10)

    def is_reported():
        client.send_pose((1.0, 0.0, 0.0), stamp=0.0)
        client.spin(0.02)
        statuses = {status.name: status for status in reports[-1].status} if reports else {}
        return "refused.no_stamp" in statuses["tissue_sim: tool left"].message and statuses if statuses else None

    found = []
    assert client.spin_until(lambda: found.append(is_reported()) or bool(found[-1]))
    statuses = found[-1]
    names = ("physics", "tool left", "tool right", "organ kidney")
    assert sorted(statuses) == sorted(f"tissue_sim: {name}" for name in names)
    values = {name: {item.key for item in statuses[f"tissue_sim: {name}"].values} for name in names}
    assert {"state", "poses", "refused.no_stamp", "pose_rate_hz"} <= values["tool left"]
    assert {"region", "contact_count", "faults"} <= values["organ kidney"]
    assert {"left.state", "left.refused.no_stamp", "right.pose_rate_hz", "region", "tick"} <= values["physics"]
    assert statuses["tissue_sim: tool left"].level == DiagnosticStatus.WARN
    assert statuses["tissue_sim: tool right"].level == DiagnosticStatus.OK


@pytest.mark.parametrize("bad", [[0.0, 0.0], [0.0, float("nan"), 0.0], [0.0, 0.0, -1000.0]])
def test_bad_gravity_is_refused(client, bad):
    answer = client.set_parameter("gravity", bad)
    assert not answer.successful
    assert "gravity" in answer.reason


def test_recording_on_demand_replays_bit_for_bit(client, capsys):
    started = client.record(True)
    assert started.success, started.message
    assert not client.record(True).success, "one bag at a time"
    before = int(client.report()["left.poses"])
    client.set_parameter("stiffness_scale", 2.0)
    client.set_parameter("left.passivity_damping", 5.0)  # a bag holds forces without what that adds
    position = press_until_contact(client, client.ask, deepest=0.004)
    for _ in range(300):
        client.ask(position)
    assert client.spin_until(lambda: client.ask(position) or client.hand_force() > 0.05)
    for depth in np.tile(np.linspace(-0.003, 0.004, 4), 25):  # so fast that contact sets need their margin
        client.ask(position + (depth - 0.004) * np.array([-1.0, 0.0, 0.0]))

    def rocking_is_damped():
        """Whether forces are: those that act late drive a hand that rocks in the tissue."""
        for turn in np.linspace(0.0, 4.0 * np.pi, 17):
            client.ask(position + 0.0015 * (np.sin(turn) - 1.0) * np.array([-1.0, 0.0, 0.0]))
        return int(client.report()["left.damped_forces"]) > 0

    assert client.spin_until(rocking_is_damped)
    client.reset()
    assert client.spin_until(lambda: client.moved() < 1e-6)
    arrived = int(client.report()["left.poses"]) - before
    client.set_parameter("stiffness_scale", 1.0)
    client.set_parameter("left.passivity_damping", 0.0)
    stopped = client.record(False)
    assert stopped.success
    assert stopped.message == started.message
    with Reader(stopped.message) as reader:
        topics = {connection.topic: connection.msgcount for connection in reader.connections}
    assert topics["/left/measured_cp"] >= arrived > 100, "all that reached the node: DDS loses some on a busy machine"
    assert topics["/left/servo_cf"] >= topics["/left/measured_cp"] - 1, "a wrench for each pose that arrives"
    assert topics["/tissue_sim/surface"] > 1, "how many depends on how fast the machine is"
    repeated(stopped.message, capsys)
    assert not client.record(False).success


def test_diagnostics_tell_the_state_of_the_loop(client):
    reports = []

    def is_reported():
        """Whether the rate is that of the ticks between two reports; a machine may do something else in between."""
        reports.append((int(client.report()["tick"]), client.reported, float(client.diagnostics["tick_rate_hz"])))
        (tick, then, _), (newest, now, rate) = reports[-2:] if len(reports) > 1 else reports * 2
        return newest > tick and rate == pytest.approx((newest - tick) / (now - then), rel=0.05)

    assert client.spin_until(is_reported), reports
    values = client.diagnostics
    assert float(values["tick_p50_us"]) > 0.0
    assert values["region"] in ("asleep", "whole")
    for key in ("overruns", "active_nodes", "contact_count", "force_n", "recording", "real_time_factor", "left.state"):
        assert key in values
    for key in ("coupling_stiffness", "coupling_bound", "left.pose_rate_hz", "left.delay_ms"):
        assert key in values
    for key in ("skipped.asleep", "skipped.mesh_unchanged", "skipped.nothing_moved"):
        assert int(values[key]) > 0, key


ARM = "left.frame_id:=arm -p right.frame_id:=arm -p left.base_pose:=[0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]"
REFUSED_STARTS = {
    "organ_file:=nowhere.npz": "does not exist",
    "rate:=1.0": "outside",
    "rate:=fast": "wrong type",
    "model:=solid": "choose one of auto, hybrid, cells",
    **{
        f"{name}:=[]": f"parameter '{name}' is empty; expected a list like ["
        for name in ("tools", "gravity", "organ_pose", "left.base_pose", "left.wrench_rotation")
    },
    "rate:=[]": "parameter 'rate' is empty; expected a float",
    "tools:=[a, a]": "not a valid or unique name",
    "left.shape:=cube": "sphere, capsule, gripper, mesh",
    "left.pose_type:=Twist": "choose one of PoseStamped, Pose, TransformStamped, Odometry",
    "organ_pose:=[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]": "'organ_pose' has a zero quaternion",
    "organ_pose:=[0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]": "'organ_pose' is the pose of 'organ' in base_frame, which is",
    f"{ARM}": "'left.base_pose' and 'right.base_pose' give the frame 'arm' different poses",
    "left.base_pose:=[0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]": "'left.base_pose' would move 'organ', whose pose is",
    "scene_file:=none.yaml": "none.yaml can't be read",
    "scene_file:=none.yaml -p organ_file:=nowhere.npz": "organ_file and scene_file are both set",
}


# Nodes that never come up, one after the other in a process: to start one for each would take half a minute.
STARTS = """
import sys
from tissue_sim.ros.shared.shutdown_handler import ShutdownHandler
from tissue_sim.ros.node.serve import serve

ending = ShutdownHandler()
for parameter in sys.argv[1:]:
    print("start", parameter, flush=True)
    words = [word for one in parameter.split(" -p ") for word in ("-p", one)]
    code = serve(["tissue_node", "--ros-args", *words], ending)
    print("code", code, flush=True)
"""


@pytest.fixture(scope="module")
def starts(tmp_path_factory):
    """What each of those parameters has the node say, and its exit code."""
    process = Process(["-c", STARTS, *REFUSED_STARTS], tmp_path_factory.mktemp("starts") / "node.log")
    assert process.wait() == 0, process.text()
    said = {}
    for part in process.text().split("start ")[1:]:
        parameter, *lines = part.splitlines()
        said[parameter] = [line for line in lines if line.strip()]
    return said


@pytest.mark.parametrize("parameter", REFUSED_STARTS)
def test_bad_parameter_ends_with_one_line_and_2(starts, parameter):
    line, code = starts[parameter]
    assert code == "code 2"
    assert line.startswith("tissue_node: error: ")
    assert REFUSED_STARTS[parameter] in line


def test_damaged_organ_file_is_refused_by_name(tmp_path):
    organ = tmp_path / "organ.npz"
    organ.write_bytes(b"PK\x03\x04 nothing else")
    process = start_node(tmp_path, f"organ_file:={organ}", wait=False)
    assert process.wait() == 2
    assert "organ.npz is damaged" in process.text()


def test_help_lists_every_parameter(tmp_path):
    process = Process(["-m", "tissue_sim.ros.node.program", "--help"], tmp_path / "help.log")
    assert process.wait() == 0
    for name in ("organ_file", "local_region", "<tool>.radius", "force_clamp"):
        assert name in process.text()
    assert "local_region (default 'off') [off, frozen, modal, auto]: " in process.text()
