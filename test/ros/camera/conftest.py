"""Tests of the camera need something to draw with."""

import pytest
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from helpers.drawing import require_drawing
from helpers.ros.processes import Process
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.qos import RELIABLE


@pytest.fixture(scope="session", autouse=True)
def _can_draw():
    require_drawing()


@pytest.fixture
def begin(tmp_path):
    """Starts cameras of small pictures, at the usual place unless words choose another one; they end with the test."""
    made = []

    def one(*words, **environment):
        command = ["-m", "tissue_sim", "camera", "--width=160", "--height=120", "--nice=0", "--rate=20", *words]
        made.append(Process(command, tmp_path / f"camera{len(made)}.log", **environment))
        return made[-1]

    yield one
    for process in made:
        process.stop()
        assert "Traceback" not in process.text()


@pytest.fixture
def listen(graph):
    """Subscribes topics of the camera, by their names below its own."""
    kinds = {"image_raw": Image, "compressed": CompressedImage, "camera_info": CameraInfo, "pose": PoseStamped}

    def one(*topics, before="/camera"):
        return {
            topic: client.NewestMessage(graph, kinds[topic.rpartition("/")[2]], f"{before}/{topic}", RELIABLE)
            for topic in topics
        }

    return one
