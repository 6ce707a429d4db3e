"""A tool that follows a frame of tf, which another process broadcasts; with a stand-in for tf2_ros."""

import os

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TransformStamped, WrenchStamped

from helpers.patience import wait_for
from helpers.ros.processes import FAKE_TF, SOON_STALE, poke_path, shipped
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.qos import STREAM

FRAME = "psm_tip"


@pytest.fixture
def node(start, tmp_path):
    path = f"{FAKE_TF}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    return start(tmp_path, SOON_STALE, f"left.tf_frame:={FRAME}", PYTHONPATH=path)


class Broadcaster:
    """What moves the frame, as a robot's driver does."""

    def __init__(self, graph):
        self._clock, self._publisher = graph.get_clock(), graph.create_publisher(TransformStamped, "/tf", 100)
        self.moved = TransformStamped(child_frame_id=FRAME)
        self.moved.header.frame_id = "organ"

    def send(self, place, is_new=True):
        at = self.moved.transform.translation
        at.x, at.y, at.z = np.asarray(place, dtype=float).tolist()
        if is_new:
            self.moved.header.stamp = self._clock.now().to_msg()
        self._publisher.publish(self.moved)


def test_it_presses_where_the_frame_is_and_fades_without_newer_transforms(node, graph):
    wrenches = client.NewestMessage(graph, WrenchStamped, "/left/servo_cf", STREAM)
    broadcaster, (touch, inward) = Broadcaster(graph), poke_path(shipped())
    newest = {"depth": -0.002, "force": 0.0}

    def is_answered_outside():
        broadcaster.send(touch + newest["depth"] * inward)
        return wrenches.take() is not None

    def feels():
        newest["depth"] = 0.003 if newest["depth"] >= 0.003 else newest["depth"] + 5e-5
        broadcaster.send(touch + newest["depth"] * inward)
        if (message := wrenches.take()) is not None:
            newest["force"] = message.wrench.force.x
        return newest["force"] > 0.02

    wait_for(lambda: "is not there: tf has no transform" in node.text(), node.text)
    wait_for(is_answered_outside, node.text)
    wait_for(feels, node.text)

    def fades():
        broadcaster.send(touch + newest["depth"] * inward, is_new=False)
        if (message := wrenches.take()) is not None:
            newest["force"] = message.wrench.force.x
        return newest["force"] == 0.0

    wait_for(fades, node.text)
    assert node.stop() == 0, node.text()


def test_poses_on_its_topic_are_refused(node, graph):
    poses = graph.create_publisher(PoseStamped, "left/measured_cp", STREAM)
    pose = PoseStamped()
    pose.header.frame_id = "organ"

    def refused():
        pose.header.stamp = graph.get_clock().now().to_msg()
        poses.publish(pose)
        return f"pose refused: the tool follows '{FRAME}' (parameter left.tf_frame)" in node.text()

    wait_for(refused, node.text)


def test_without_tf_the_node_ends_with_one_line(start, tmp_path):
    process = start(tmp_path, f"left.tf_frame:={FRAME}", wait=False)
    assert process.wait() == 2
    assert f"parameter tf_frame '{FRAME}' needs tf2_ros, which is not installed" in process.text()
    assert "Traceback" not in process.text()
