"""Bags that ship repeat; altered ones are distinguished; other files are refused."""

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from helpers.paths import ROOT
from tissue_sim.cli import main
from tissue_sim.errors import UserError
from tissue_sim.model.data.records import array_of, copy_of
from tissue_sim.ros.bags import bag
from tissue_sim.ros.bags.comparison import compare
from tissue_sim.ros.bags.organ_recording import settings_of
from tissue_sim.ros.bags.player import replay
from tissue_sim.ros.bags.recording import Recording

TOLERANCE = 1e-6
BAG = ROOT / "bags" / "stroke"


@pytest.fixture(scope="module")
def recording():
    return Recording.read(BAG)


def with_organ(recording, **changed):
    """The recording with other content of its organ."""
    return dataclasses.replace(recording, organs=[dataclasses.replace(recording.organs[0], **changed)])


def compared(recording):
    replayed = replay(recording)
    return compare(replayed.wanted, replayed.shown, TOLERANCE, TOLERANCE)


def test_a_tick_whose_surface_was_published_twice_repeats_twice(recording):
    """As where markers come faster than ticks, on a slow loop."""
    once = recording.shown()
    twice = dataclasses.replace(
        once,
        surface_ticks=[np.repeat(once.surface_ticks[0], 2)],
        surfaces=[np.repeat(once.surfaces[0], 2, axis=0)],
    )
    replayed = replay(recording, wanted=twice)
    np.testing.assert_array_equal(replayed.shown.surfaces[0], replayed.wanted.surfaces[0])
    assert len(replayed.shown.surfaces[0]) >= 2 * (len(once.surfaces[0]) - 1)


def test_replay_repeats_bit_for_bit(recording):
    first, second = replay(recording), replay(recording)
    for tool in range(len(first.shown.tools)):
        assert np.array_equal(first.shown.wrenches[tool], second.shown.wrenches[tool])
        assert np.array_equal(first.shown.wrenches[tool], first.wanted.wrenches[tool])
    assert np.array_equal(first.shown.surfaces[0], second.shown.surfaces[0])
    found = compare(first.wanted, first.shown, 0.0, 0.0)
    assert found.passes
    assert found.wrenches > 100
    assert found.surfaces > 5


def test_another_tool_path_is_noticed(recording):
    """A tenth of a millimetre at one tool changes forces and shape."""
    moved = [{number: pose + [1e-4, 0, 0, 0, 0, 0, 0] for number, pose in poses.items()} for poses in recording.poses]
    found = compared(dataclasses.replace(recording, poses=moved))
    assert found.force.largest > 1e-3
    assert found.position.largest > 5.0 * found.position.tolerance, "a ball moves nodes by less than itself"
    assert 0 < found.force.first_beyond <= found.force.tick


def test_other_friction_is_noticed(recording):
    changed = {number: copy_of(settings) for number, settings in recording.organs[0].settings.items()}
    for settings in changed.values():
        settings.friction *= 0.1
    assert compared(with_organ(recording, settings=changed)).force.largest > 1e-4


def test_a_setting_that_one_of_both_lacks_is_named(recording):
    recorded = array_of(next(iter(recording.organs[0].settings.values())))
    names = [name for name in recorded.dtype.names if name != "friction"]
    with pytest.raises(UserError, match="setting 'friction' is in the bag or in this version only"):
        settings_of(Path("bag"), recorded[names])


def test_a_state_that_lacks_a_field_is_named(recording):
    state = {name: array for name, array in recording.organs[0].state.items() if name != "velocity"}
    with pytest.raises(UserError, match="a different 'velocity'"):
        replay(with_organ(recording, state=state))


def test_lost_input_is_named(recording):
    poses = [dict(list(numbered.items())[:5]) for numbered in recording.poses]
    with pytest.raises(UserError, match="the bag has no pose number"):
        replay(dataclasses.replace(recording, poses=poses))


def test_deviation_gives_exit_code_1(tmp_path, capsys):
    """The recorded wrenches scaled by 1.01."""
    path = tmp_path / "scaled"
    copy_bag(BAG, path, scale=1.01)
    assert main(["replay", str(path)]) == 1
    out = capsys.readouterr().out
    assert "FAILED" in out
    assert "largest deviation: force" in out


def test_refusals(tmp_path, capsys):
    assert main(["replay", str(tmp_path / "none")]) == 2
    assert "does not exist" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert main(["replay", str(tmp_path / "empty")]) == 2
    assert "holds no bag" in capsys.readouterr().err
    broken = tmp_path / "broken"
    shutil.copytree(BAG, broken)
    (data,) = broken.glob("*.mcap")
    data.write_bytes(data.read_bytes()[: data.stat().st_size // 2])
    assert main(["replay", str(broken)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "Traceback" not in error


def test_foreign_bag_is_refused(tmp_path, capsys):
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(tmp_path / "foreign", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        text = store.types["std_msgs/msg/String"](data="hello")
        writer.write(connection, 1, store.serialize_cdr(text, "std_msgs/msg/String"))
    assert main(["replay", str(tmp_path / "foreign")]) == 2
    assert "was not recorded by a tissue_sim node" in capsys.readouterr().err


def test_arrays_survive_packing():
    arrays = {"a": np.arange(5), "b": np.eye(3)}
    read = bag.unpack(bag.pack(**arrays))
    assert all(np.array_equal(read[name], arrays[name]) for name in arrays)


def copy_bag(source: Path, target: Path, scale: float) -> None:
    from rosbags.rosbag2 import Reader

    store = get_typestore(Stores.ROS2_JAZZY)
    kind = "geometry_msgs/msg/WrenchStamped"
    with Reader(source) as reader, Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            connection.topic: writer.add_connection(connection.topic, connection.msgtype, typestore=store)
            for connection in reader.connections
        }
        for connection, stamp, held in reader.messages():
            raw = bytes(held)
            if connection.topic.endswith("servo_cf"):
                message = store.deserialize_cdr(raw, kind)
                message.wrench.force.x *= scale
                raw = bytes(store.serialize_cdr(message, kind))
            writer.write(connections[connection.topic], stamp, raw)
