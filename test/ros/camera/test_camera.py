"""The camera as a process beside a real node: images over DDS that agree with their CameraInfo, and a bag of them."""

import io
import os
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TransformStamped
from PIL import Image as Pillow
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from helpers.exit_codes import exit_code_of
from helpers.patience import wait_for
from helpers.ros.pictures import EYE, LOOKING, POSE, first_hit, pixels, stamp_of, together
from helpers.ros.processes import FAKE_TF, UNHURRIED, running_node, shipped
from tissue_sim.rendering.offscreen import Light
from tissue_sim.rendering.pinhole import inverse_of, matrix_of
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.qos import STREAM

BASELINE = 0.005


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    with running_node(
        tmp_path_factory.mktemp("node"),
        UNHURRIED,
        "base_frame:=table",
        "organ_pose:=[0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0]",
    ):
        yield


def test_a_stereo_pair_sends_what_its_lenses_see(node, begin, listen, tmp_path):
    started = time.time_ns()
    camera = begin(*LOOKING, f"--baseline={BASELINE}", f"--record={tmp_path}/bag")
    topics = ["image_raw", "image_raw/compressed", "camera_info", "depth/image_raw", "depth/camera_info"]
    topics += ["segmentation/image_raw", "segmentation/camera_info"]
    found = together(listen("pose", *(f"{eye}/{topic}" for eye in ("left", "right") for topic in topics)))

    assert started < stamp_of(found["pose"]) < time.time_ns()
    assert found["pose"].header.frame_id == "organ"
    assert {one.header.frame_id for name, one in found.items() if name != "pose"} == {"camera_optical_frame"}
    pose = found["pose"].pose
    place = [getattr(pose.position, axis) for axis in "xyz"] + [getattr(pose.orientation, axis) for axis in "xyzw"]
    assert place == pytest.approx(POSE)

    # Depth and segmentation are those of rays from the pose through the pixels, by the CameraInfo, to the organ.
    organ, matrix = shipped(), matrix_of(POSE)
    k = np.array(found["left/camera_info"].k).reshape(3, 3)
    depth, labels = pixels(found["left/depth/image_raw"]), pixels(found["left/segmentation/image_raw"])
    assert np.array_equal(np.isfinite(depth), labels == 1)
    for row, column in np.random.default_rng(1).integers(0, [120, 160], (60, 2)):
        ray = np.linalg.solve(k, [column, row, 1.0])
        expected = first_hit(matrix[:3, 3], matrix[:3, :3] @ ray, organ.surface_positions, organ.surface_triangles)
        assert depth[row, column] == pytest.approx(expected, abs=2e-5), (row, column)

    # The right one is as far to the right as the baseline says, and its CameraInfo, too.
    projections = [np.array(found[f"{eye}/camera_info"].p).reshape(3, 4) for eye in ("left", "right")]
    assert projections[0][:, 3] == pytest.approx([0.0, 0.0, 0.0])
    assert projections[1][:, 3] == pytest.approx([-k[0, 0] * BASELINE, 0.0, 0.0])
    assert np.array_equal(projections[0][:, :3], k)
    right = pixels(found["right/depth/image_raw"])
    shift = np.array([k[0, 0] * BASELINE / depth[60, 80], 0.0])
    assert right[60, round(80 - shift[0])] == pytest.approx(depth[60, 80], abs=1e-3)
    assert right[60, 80] != depth[60, 80]

    seen = np.asarray(Pillow.open(io.BytesIO(bytes(found["left/image_raw/compressed"].data))).convert("RGB"))
    assert np.abs(seen.astype(int) - pixels(found["left/image_raw"])).mean() < 5.0
    assert seen[..., 0].mean() > seen[..., 1].mean()  # red first

    assert camera.stop() == 0, camera.text()
    assert_bag(tmp_path / "bag", k)


def assert_bag(folder, k):
    """A bag holds as many compressed images as CameraInfo, of both eyes, and the poses."""
    store, counts = get_typestore(Stores.ROS2_JAZZY), {}
    with Reader(folder) as reader:
        for connection, _, raw in reader.messages():
            counts[connection.topic] = counts.get(connection.topic, 0) + 1
            message = store.deserialize_cdr(raw, connection.msgtype)
            if connection.topic.endswith("info"):
                assert np.array_equal(message.k.reshape(3, 3), k)
    eyes = [f"/camera/{eye}/{topic}" for eye in ("left", "right") for topic in ("image_raw/compressed", "camera_info")]
    assert counts.keys() == {"/camera/pose", *eyes}
    assert len(set(counts.values())) == 1


def test_the_pose_of_a_topic_in_another_frame_and_other_axes(node, graph, begin, listen):
    """A pose at a place on the table whose x axis looks ahead, where the organ lies half a metre above the table."""
    camera = begin("--pose-topic=/arm/pose", "--axes=body", "--name=scope", "--frame-id=lens")
    poses = graph.create_publisher(PoseStamped, "/arm/pose", STREAM)
    boxes = listen("pose", "image_raw", "segmentation/image_raw", before="/scope")
    forward = matrix_of(POSE)[:3, 2]
    assert forward @ [0.0, 0.0, 1.0] < 0.0  # it looks down
    from scipy.spatial.transform import Rotation

    optical = Rotation.from_quat(POSE[3:])
    body = optical * Rotation.from_matrix([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    message = PoseStamped()
    message.header.frame_id = "elsewhere"
    place, turn = message.pose.position, message.pose.orientation
    place.x, place.y, place.z = EYE[0], EYE[1], EYE[2] + 0.5
    turn.x, turn.y, turn.z, turn.w = body.as_quat().tolist()

    def refused():
        poses.publish(message)
        return "'elsewhere' can't be used" in camera.text()

    wait_for(refused, camera.text)
    assert not any(box.take_all() for box in boxes.values())
    message.header.frame_id = "table"
    seen = {}

    def came():
        poses.publish(message)
        seen.update({name: new for name, box in boxes.items() if (new := box.take()) is not None})
        return len(seen) == len(boxes)

    wait_for(came, camera.text)
    pose = seen["pose"].pose
    assert [pose.position.x, pose.position.y, pose.position.z] == pytest.approx(EYE)
    turned = Rotation.from_quat([pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w])
    assert (turned.inv() * optical).magnitude() < 1e-9
    assert seen["image_raw"].header.frame_id == "lens"
    assert (pixels(seen["segmentation/image_raw"]) == 1).mean() > 0.1


def test_the_pose_of_a_frame_in_tf(node, graph, begin, listen):
    """With a stand-in for tf2_ros: the frame lies in base_frame, and the camera's own is given in the organ's."""
    begin("--tf=ecm", "--name=ecm_camera", PYTHONPATH=f"{FAKE_TF}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    boxes = listen("pose", "segmentation/image_raw", before="/ecm_camera")
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    frames = graph.create_publisher(TransformStamped, "/tf_static", latched)
    transforms = client.NewestMessage(graph, TransformStamped, "/tf", QoSProfile(depth=10))
    placed = TransformStamped(child_frame_id="ecm")
    placed.header.frame_id = "table"
    offset, turn = placed.transform.translation, placed.transform.rotation
    offset.x, offset.y, offset.z = EYE[0], EYE[1], EYE[2] + 0.5
    turn.x, turn.y, turn.z, turn.w = POSE[3:].tolist()
    frames.publish(placed)
    found = together(boxes)
    place = found["pose"].pose.position
    assert [place.x, place.y, place.z] == pytest.approx(EYE)
    assert (pixels(found["segmentation/image_raw"]) == 1).mean() > 0.1
    own = wait_for(transforms.take, "the camera's frame is not on tf")
    assert (own.header.frame_id, own.child_frame_id) == ("organ", "ecm_camera_optical_frame")
    assert own.transform.translation.x == pytest.approx(EYE[0])


def test_a_tool_is_seen_where_its_bridge_moves_it(node, graph, begin, listen):
    begin(*LOOKING)
    boxes = listen("segmentation/image_raw", "camera_info")
    poses = graph.create_publisher(PoseStamped, "right/measured_cp", STREAM)
    at = np.array([0.014, -0.01, 0.07])  # in the optical frame: a ball of 5 mm
    matrix = matrix_of(POSE)
    message = PoseStamped()
    message.header.frame_id = "organ"
    place = message.pose.position
    place.x, place.y, place.z = (matrix[:3, :3] @ at + matrix[:3, 3]).tolist()
    seen = {}

    def appeared():
        message.header.stamp = graph.get_clock().now().to_msg()
        poses.publish(message)
        seen.update({name: new for name, box in boxes.items() if (new := box.take()) is not None})
        return len(seen) == 2 and (pixels(seen["segmentation/image_raw"]) == 102).any()

    wait_for(appeared, "the tool never appears")
    rows, columns = np.nonzero(pixels(seen["segmentation/image_raw"]) == 102)
    expected = np.array(seen["camera_info"].k).reshape(3, 3) @ at
    assert [columns.mean(), rows.mean()] == pytest.approx(expected[:2] / expected[2], abs=0.5)
    assert inverse_of(matrix) @ matrix == pytest.approx(np.eye(4))


def test_nothing_is_drawn_until_somebody_subscribes(node, graph, begin, listen):
    begin("--name=idle")
    reports = client.NewestMessage(graph, DiagnosticArray, "/diagnostics", 10)

    def newest():
        found = [one for report in reports.take_all() for one in report.status if one.name == "idle: pictures"]
        return {item.key: item.value for item in found[-1].values} if found else None

    assert wait_for(newest, "no diagnostics")["pictures"] == "0"
    assert wait_for(newest, "no more diagnostics")["pictures"] == "0"
    box = listen("image_raw", before="/idle")
    wait_for(lambda: box["image_raw"].take() is not None, "no picture for a subscriber")
    wait_for(lambda: float((newest() or {"rate_hz": 0.0})["rate_hz"]) > 0.0, "no rate of pictures")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--eye=1,2"], "'1,2' is not 3 numbers"),
        (["--eye=1,2,3"], "give both"),
        (["--record-depth"], "name a bag with --record"),
        (["--record=."], ". is there already"),
        (["--name=a/b"], "'a/b' is not a name"),
        (["--width=8"], "16..4096"),
        (["--tf=ecm"], "needs tf2_ros"),
        (["--pose=0,0,0,0,0,0,0"], "--pose has a zero quaternion"),
    ],
)
def test_what_it_cannot_do_is_said_in_one_line(words, reason, capsys, monkeypatch):
    monkeypatch.setattr("tissue_sim.ros.node.input.tf_lookup.tf2_ros", None)
    assert exit_code_of("camera", "--nice=0", *words) == 2
    assert reason in capsys.readouterr().err


def test_help_names_the_reach_that_the_light_has(capsys):
    assert exit_code_of("camera", "--help") == 0
    assert f"(default: {Light().reach:g})" in " ".join(capsys.readouterr().out.split())
