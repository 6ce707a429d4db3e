"""The scripted bridge as a process: it moves tools, feels forces, and leaves the tissue when it ends."""

import signal
import time
from pathlib import Path

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import PoseStamped
from processes import Process
from stand_in import ball

from tissue_sim.cli import main
from tissue_sim.ros.client import Inbox, stream_qos
from tissue_sim.ros.probing import Surface

STAND_IN = str(Path(__file__).with_name("stand_in.py"))
BRIDGE = ["-m", "tissue_sim.cli", "bridge"]


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    process = Process([STAND_IN], tmp_path_factory.mktemp("node") / "node.log")
    yield process
    assert process.stop() == 0, process.text()


@pytest.fixture
def poses():
    """The newest pose of the left tool, whenever it is asked for."""
    context = rclpy.Context()
    context.init()
    listener = rclpy.create_node("listener", context=context)
    yield Inbox(listener, PoseStamped, "left/measured_cp", stream_qos())
    listener.destroy_node()
    context.try_shutdown()


def test_it_presses_feels_and_leaves(node, poses, tmp_path):
    bridge = Process([*BRIDGE, "--seconds", "2.2", "--script", "stroke"], tmp_path / "bridge.log")
    bridge.wait_for("at 500 Hz", 20.0)
    seen = []
    while bridge.child.poll() is None:
        if (pose := poses.take()) is not None:
            seen.append(pose)
        time.sleep(0.01)
    assert bridge.stop() == 0
    assert {pose.header.frame_id for pose in seen} == {"organ"}
    stamps = [pose.header.stamp.sec + 1e-9 * pose.header.stamp.nanosec for pose in seen]
    assert np.all(np.diff(stamps) > 0.0)
    assert abs(stamps[-1] - time.time()) < 20.0
    surface = Surface(*ball())
    points = np.array([(p.pose.position.x, p.pose.position.y, p.pose.position.z) for p in seen])
    gaps = np.array([surface.closest(point)[0] for point in points]) - 0.005
    assert gaps.min() == pytest.approx(-0.002 * 0.04 / 0.03 * 0.75, abs=8e-4)  # it pressed
    assert gaps[-1] > 0.005  # it left
    last = bridge.text().splitlines()[-1]
    words = last.replace(",", "").split()
    sent, received = int(words[0]), int(words[words.index("wrenches") - 1])
    assert 2 * 0.7 * 500 * 2.2 < sent < 2 * 500 * 4.0, last
    assert received > 0.5 * sent, last
    assert "left 0.50 N" in last, last


def test_a_signal_ends_it_with_0_and_the_tools_outside(node, poses, tmp_path):
    bridge = Process([*BRIDGE, "--script", "poke"], tmp_path / "bridge.log")
    bridge.wait_for("at 500 Hz", 20.0)
    time.sleep(1.3)
    bridge.child.send_signal(signal.SIGTERM)
    assert bridge.child.wait(5.0) == 0
    pose = poses.take().pose.position
    assert Surface(*ball()).closest(np.array([pose.x, pose.y, pose.z]))[0] > 0.01
    assert "poses sent" in bridge.text()
    assert "Traceback" not in bridge.text()


def test_no_node_is_one_line_and_exit_code_1(capfd):
    assert main(["bridge", "--wait", "0.3", "--node", "nobody"]) == 1
    assert capfd.readouterr().err == (
        "tissue_sim bridge: no mesh on /nobody/mesh in 0.3 s; start tissue_node, or name yours with --node\n"
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--rate", "0"], "outside 1..2000 Hz"),
        (["--rate", "fast"], "no number"),
        (["--tools", "left,left"], "no name of its own"),
        (["--script", "stroke,cut"], "'cut' is unknown"),
        (["--node", "a b"], "no name of a node"),
        (["--tools", "left", "--script", "nip"], "two tools"),
    ],
)
def test_wrong_use_is_one_line_and_exit_code_2(words, message, capfd):
    try:
        code = main(["bridge", *words])
    except SystemExit as end:
        code = end.code
    assert code == 2
    error = capfd.readouterr().err
    assert message in error
    assert error.count("\n") == 1
