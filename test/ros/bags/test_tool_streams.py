"""Poses and forces of a tool from bags: this package's own, and others by topic."""

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from helpers.paths import ROOT
from tissue_sim.errors import UserError
from tissue_sim.ros.bags.reading import read_bag
from tissue_sim.ros.bags.tool_streams import in_organ_axes, in_pose_axes, recorded_tool, topics_of

BAGS = ROOT / "bags"
STORE = get_typestore(Stores.ROS2_JAZZY)
TURN = Rotation.from_rotvec([0.3, -0.2, 0.1])


def written(folder, forces=True, stamped=True):
    """A bag of a robot: a pose every 10 ms, a wrench every 5 ms, in other axes than the organ's."""
    types = STORE.types
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    vector, wrench = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Wrench"]
    quaternion = types["geometry_msgs/msg/Quaternion"](*TURN.as_quat())
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        poses = writer.add_connection("/tip", "geometry_msgs/msg/PoseStamped", typestore=STORE)
        wrenches = writer.add_connection("/sensor", "geometry_msgs/msg/WrenchStamped", typestore=STORE)
        for number in range(20 if forces else 0):
            ns = 5_000_000 * (number + 1)
            head = header(stamp(0, ns if stamped else 0), "base")
            if number % 2 == 0:
                pose = types["geometry_msgs/msg/Pose"](
                    types["geometry_msgs/msg/Point"](1e-3 * number, 0.0, 0.5), quaternion
                )
                writer.write(
                    poses, ns, STORE.serialize_cdr(types["geometry_msgs/msg/PoseStamped"](head, pose), poses.msgtype)
                )
            message = types["geometry_msgs/msg/WrenchStamped"](
                head, wrench(vector(0.0, 0.0, 0.1 * number), vector(0.0, 0.0, 0.0))
            )
            writer.write(wrenches, ns, STORE.serialize_cdr(message, wrenches.msgtype))
    return folder


@pytest.mark.parametrize("stamped", [True, False])
def test_topics_are_joined_in_time(tmp_path, stamped):
    found = topics_of(written(tmp_path / "bag", stamped=stamped), "/tip", "/sensor")
    np.testing.assert_allclose(found.time, 0.005 * np.arange(19), atol=1e-9)
    np.testing.assert_allclose(found.positions[:, 0], 1e-3 * np.arange(19), atol=1e-9)
    np.testing.assert_allclose(found.forces[:, 2], 0.1 * np.arange(19))
    assert found.radius is None


def broken_off(folder, lost):
    """The same bag without its metadata and its last bytes, as a recorder leaves it that is killed."""
    bag = written(folder)
    (bag / "metadata.yaml").unlink()
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-lost])
    return bag


def test_a_bag_that_was_broken_off_is_read_as_far_as_it_goes(tmp_path):
    whole = topics_of(written(tmp_path / "whole"), "/tip", "/sensor")
    bag = broken_off(tmp_path / "bag", 9)
    before = sorted(path.name for path in bag.iterdir())
    found = topics_of(bag, "/tip", "/sensor")
    np.testing.assert_array_equal(found.positions, whole.positions)
    np.testing.assert_array_equal(found.forces, whole.forces)
    assert sorted(path.name for path in bag.iterdir()) == before
    with pytest.raises(UserError, match="those of this type: /sensor"):
        topics_of(bag, "/tip", "/tip")


def test_a_bag_of_a_robot_is_reported_how_to_be_read(tmp_path):
    for bag in (written(tmp_path / "whole"), broken_off(tmp_path / "bag", 9)):
        with pytest.raises(UserError, match=r"--pose-topic \(PoseStamped: /tip\) and --wrench-topic .* /sensor"):
            recorded_tool(bag, None)


def test_a_bag_without_any_content_is_refused(tmp_path):
    bag = broken_off(tmp_path / "bag", 9)
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:60])
    with pytest.raises(UserError, match="was interrupted before it had any content"):
        topics_of(bag, "/tip", "/sensor")


def test_axes_are_turned(tmp_path):
    found = topics_of(written(tmp_path / "bag"), "/tip", "/sensor")
    np.testing.assert_allclose(in_pose_axes(found).forces, TURN.apply(found.forces), atol=1e-12)
    moved = in_organ_axes(found, [0.0, 0.0, 0.5, *TURN.as_quat()])
    np.testing.assert_allclose(TURN.apply(moved.positions) + [0.0, 0.0, 0.5], found.positions, atol=1e-12)
    np.testing.assert_allclose(TURN.apply(moved.forces), found.forces, atol=1e-12)
    with pytest.raises(UserError, match="--organ-pose"):
        in_organ_axes(found, [0.0] * 7)


@pytest.mark.parametrize(
    ("topics", "what"),
    [(("/tip", "/tip"), "those of this type: /sensor"), (("/none", "/sensor"), "those of this type: /tip")],
)
def test_topics_that_are_not_there_are_refused(tmp_path, topics, what):
    with pytest.raises(UserError, match=what):
        topics_of(written(tmp_path / "bag"), *topics)


def test_empty_topics_and_missing_bags_are_refused(tmp_path):
    with pytest.raises(UserError, match="no message on /tip"):
        topics_of(written(tmp_path / "bag", forces=False), "/tip", "/sensor")
    with pytest.raises(UserError, match="does not exist"):
        topics_of(tmp_path / "none", "/tip", "/sensor")


def test_a_bag_of_this_package_has_its_tool():
    bag = read_bag(BAGS / "poke")
    (tool,) = [one for one in bag.tools if f"{one.name}/force" in bag][:1]
    found = recorded_tool(BAGS / "poke", tool.name)
    assert found.radius == tool.radius
    force = bag[f"{tool.name}/force"]
    np.testing.assert_array_equal(found.forces, force.values[-len(found.forces) :])
    assert (np.diff(found.time) > 0.0).all()
    assert len(found.positions) == len(found.time)


def test_tools_that_are_not_round_are_refused():
    with pytest.raises(UserError, match="no spherical tool; it has left"):
        recorded_tool(BAGS / "gripper", None)
    with pytest.raises(UserError, match="no spherical tool nobody"):
        recorded_tool(BAGS / "poke", "nobody")
