"""Patched templates against ROS's own serialisation."""

from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, PoseStamped, Vector3, Wrench, WrenchStamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh, MeshTriangle
from std_msgs.msg import Float64MultiArray, String, UInt8MultiArray

from helpers.ros.processes import shipped
from tissue_sim.ros.shared.cdr import (
    UNSTAMPED,
    BadQuaternion,
    check_force,
    check_position,
    parse_cloud,
    parse_number,
    parse_octets,
    parse_plain,
    parse_stamped,
    parse_text,
    unit_pose,
)
from tissue_sim.ros.shared.client import mesh_arrays
from tissue_sim.ros.shared.messages import CloudTemplate, NumbersTemplate, inclusion_mesh, rest_mesh
from tissue_sim.ros.shared.shown_organ import ShownOrgan
from tissue_sim.ros.shared.tool_messages import POSE_TYPES, ToolTopics

FRAMES = ["", "o", "organ", "frames", "a_rather_long_frame/of_an_arm"]


@pytest.mark.parametrize("frame", FRAMES)
def test_pose_is_read_from_its_bytes(frame):
    message = PoseStamped()
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = 1700000000, 123456789
    values = np.arange(7) + 0.25
    message.pose.position.x, message.pose.position.y, message.pose.position.z = values[:3]
    rotation = message.pose.orientation
    rotation.x, rotation.y, rotation.z, rotation.w = values[3:]
    read = parse_stamped(serialize_message(message), 7)
    assert read.frame_id == frame
    assert read.stamp == 1700000000123456789
    assert read.values == tuple(values)


@pytest.mark.parametrize("child", FRAMES)
@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("kind", ["TransformStamped", "Odometry"])
def test_pose_of_a_named_body_is_read_from_its_bytes(kind, frame, child):
    message = POSE_TYPES[kind].message(child_frame_id=child)
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = 1700000000, 123456789
    place = message.transform if kind == "TransformStamped" else message.pose.pose
    position, turn = (getattr(place, name) for name in list(place.get_fields_and_field_types()))
    values = np.arange(7) + 0.25
    position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w = values
    assert POSE_TYPES[kind].parse(serialize_message(message), 7) == (1700000000123456789, frame, tuple(values))


def test_messages_without_a_header_are_read_from_their_bytes():
    pose = Pose(position=Point(x=1.0, y=2.0, z=3.0))
    assert parse_plain(serialize_message(pose), 7) == (UNSTAMPED, "", (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0))
    wrench = Wrench(force=Vector3(x=4.0), torque=Vector3(z=5.0))
    assert parse_plain(serialize_message(wrench), 6).values == (4.0, 0.0, 0.0, 0.0, 0.0, 5.0)


@pytest.mark.parametrize("kind", POSE_TYPES)
def test_any_pose_that_is_cut_short_is_refused(kind):
    message = POSE_TYPES[kind].message()
    raw = serialize_message(message)
    end = len(raw) if kind != "Odometry" else len(raw) - 8 * (36 + 6 + 36)
    POSE_TYPES[kind].parse(raw[:end], 7)
    for length in range(end - 1):
        with pytest.raises(ValueError, match=r"truncated|not little-endian"):
            POSE_TYPES[kind].parse(raw[:length], 7)


@pytest.mark.parametrize("length", [0, 3, 15, 40, 83])
def test_short_message_is_refused(length):
    message = PoseStamped()
    message.header.frame_id = "organ"
    with pytest.raises(ValueError, match=r"truncated|not little-endian"):
        parse_stamped(serialize_message(message)[:length], 7)


@pytest.mark.parametrize("frame", FRAMES)
def test_wrench_template_is_what_ros_would_write(frame):
    wrench = np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])
    read = deserialize_message(NumbersTemplate(WrenchStamped(), 6, frame).message(5_000_000_007, wrench), WrenchStamped)
    expected = WrenchStamped()
    expected.header.frame_id = frame
    expected.header.stamp.sec, expected.header.stamp.nanosec = 5, 7
    force, torque = expected.wrench.force, expected.wrench.torque
    force.x, force.y, force.z, torque.x, torque.y, torque.z = wrench
    assert read == expected


def test_wrench_without_a_header():
    wrench = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    read = deserialize_message(NumbersTemplate(Wrench(), 6).message(7, wrench), Wrench)
    assert read == Wrench(force=Vector3(x=1.0, y=2.0, z=3.0), torque=Vector3(x=4.0, y=5.0, z=6.0))


@pytest.mark.parametrize("length", [3, 6, 7])
def test_wrench_as_an_array(length):
    topics = ToolTopics({}, "organ", wrench_type="Float64MultiArray", array_length=length)
    raw = NumbersTemplate(topics.outgoing(), length).message(7, np.arange(6) + 1.0)
    assert deserialize_message(raw, Float64MultiArray).data.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 0.0][:length]


def test_unit_pose():
    pose = unit_pose(np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 2.0]))
    assert pose.tolist() == [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("quaternion", "counted", "what"),
    [
        ((0.0, 0.0, 0.0, 0.0), "zero_quaternion", "zero"),
        ((0.0, 1e-7, 0.0, 0.0), "zero_quaternion", "zero"),
        ((1e200, 0.0, 0.0, 1.0), "large_quaternion", "too large"),
        ((0.0, np.nan, 0.0, 1.0), "nan_pose", "not finite"),
        ((0.0, 0.0, np.inf, 1.0), "nan_pose", "not finite"),
    ],
)
def test_a_quaternion_that_is_no_rotation_has_a_name_for_its_reason(quaternion, counted, what):
    with pytest.raises(BadQuaternion, match=f"its quaternion is {what}; send a unit quaternion") as refused:
        unit_pose(np.array([0.0, 0.0, 0.0, *quaternion]))
    assert refused.value.counted == counted


def test_cloud_template():
    template = CloudTemplate("organ", 5, ("x", "y", "z", "radius"))
    template.points[:] = np.arange(20.0).reshape(5, 4)
    read = deserialize_message(template.message(1_000_000_002), PointCloud2)
    assert (read.width, read.height, read.point_step, read.row_step) == (5, 1, 16, 80)
    assert [field.name for field in read.fields] == ["x", "y", "z", "radius"]
    assert np.frombuffer(read.data, dtype="<f4").tolist() == list(range(20))
    assert read.header.stamp.sec == 1
    assert read.header.stamp.nanosec == 2


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("columns", [("x", "y", "z"), ("x", "y", "z", "radius", "parent")])
def test_cloud_is_read_from_its_bytes(frame, columns):
    template = CloudTemplate(frame, 7, columns)
    template.points[:] = np.arange(template.points.size).reshape(template.points.shape)
    assert np.array_equal(parse_cloud(template.message(1_000_000_002)), template.points)


@pytest.mark.parametrize("length", [0, 1, 2, 3, 4, 5, 800])
def test_what_a_bag_holds_is_read_from_its_bytes(length):
    octets = np.arange(length, dtype=np.uint8)
    assert np.array_equal(parse_octets(bytes(serialize_message(UInt8MultiArray(data=octets)))), octets)
    text = "ä" * length
    assert parse_text(bytes(serialize_message(String(data=text)))) == text
    numbers = bytes(serialize_message(Float64MultiArray(data=[0.1] * (1 + length))))
    assert parse_number(numbers) == 0.1


def test_what_a_bag_holds_may_be_cut_short():
    cloud = CloudTemplate("organ", 5, ("x", "y", "z")).message(1)
    messages = (UInt8MultiArray(data=[1] * 9), String(data="a text"), Float64MultiArray(data=[0.1]))
    octets, text, number = (bytes(serialize_message(message)) for message in messages)
    for parse, raw in ((parse_octets, octets), (parse_text, text), (parse_number, number), (parse_cloud, cloud)):
        for end in (0, 3, 6, 14, len(raw) - 8):
            with pytest.raises(ValueError, match=r"truncated|not little-endian"):
                parse(raw[:end])


@pytest.mark.parametrize(("vertices", "triangles"), [(4, 3), (4, 2), (3, 1), (0, 0)])
def test_mesh_is_what_rclpy_writes(vertices, triangles):
    rng = np.random.default_rng(vertices)
    positions, corners = rng.normal(size=(vertices, 3)), rng.integers(0, max(vertices, 1), (triangles, 3))
    message = Mesh(
        triangles=[MeshTriangle(vertex_indices=row) for row in corners.astype(np.uint32)],
        vertices=[Point(x=x, y=y, z=z) for x, y, z in positions.tolist()],
    )
    organ = SimpleNamespace(inclusion_positions=positions, inclusion_triangles=corners)
    made = inclusion_mesh(organ)
    assert len(made) == len(serialize_message(message))  # what it leaves out between them is anything
    for read, given in zip(mesh_arrays(deserialize_message(made, Mesh)), (positions, corners), strict=True):
        np.testing.assert_array_equal(read, given)


def test_rest_mesh_is_the_organ():
    organ = shipped()
    read = deserialize_message(rest_mesh(ShownOrgan(organ)), Mesh)
    assert np.array_equal([t.vertex_indices for t in read.triangles], organ.surface_triangles)
    assert np.array_equal([(v.x, v.y, v.z) for v in read.vertices], organ.surface_positions)


@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf, 1e300, 101.0])
def test_positions_and_forces_of_another_unit_are_refused(odd):
    """What is no number, too: turning a pose of large ones into another frame may make that of it."""
    check_position(np.array([99.0, -99.0, 0.0]))
    check_force(np.array([1e5, 0.0, -1e5]))
    with pytest.raises(ValueError, match="metres"):
        check_position(np.array([0.0, odd, 0.0]))
    with pytest.raises(ValueError, match="newtons"):
        check_force(np.array([0.0, 1e5 * odd, 0.0]))
