"""The page of programs of one's own: its client and what it has in place of ros2, run as they are printed."""

import re
import subprocess
import sys

import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.duration import Duration
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Bool

from helpers.paths import ROOT
from helpers.patience import LIMIT
from helpers.ros.clients import LATCHED
from helpers.ros.participant import Participant
from helpers.ros.processes import UNHURRIED, running_node

pytestmark = pytest.mark.extended

PAGE = (ROOT / "docs" / "clients.md").read_text()
BLOCKS = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """What all of it prints beside a node, line by line."""
    folder = tmp_path_factory.mktemp("client")
    with running_node(folder, UNHURRIED, f"record_folder:={folder}"):
        command = [sys.executable, "-c", "\n".join(BLOCKS)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_the_client_has_20_lines_and_feels_the_kidney(said):
    assert sum(map(bool, BLOCKS[0].splitlines())) == 20
    x, y, z = map(float, re.fullmatch(r".*Vector3\(x=(.+), y=(.+), z=(.+)\)", said[0]).groups())
    assert 0.05 < x < 1.0, "out of the side that it pressed"
    assert abs(y) + abs(z) < 0.5 * x


class PlayedNode(Participant):
    """Plays a node that ends, and another that begins, to a client.

    places: x of the poses, m; is_late: whether its wrenches are of long ago.
    """

    def __init__(self):
        super().__init__("played")
        self.places: list[float] = []
        self.is_late = False
        self.ready = self.node.create_publisher(Bool, "/tissue_sim/ready", LATCHED)
        self.wrenches = self.node.create_publisher(WrenchStamped, "/left/servo_cf", qos_profile_sensor_data)
        self.node.create_subscription(PoseStamped, "/left/measured_cp", self._on_pose, qos_profile_sensor_data)

    def _on_pose(self, pose):
        self.places.append(pose.pose.position.x)
        wrench = WrenchStamped(header=pose.header)
        wrench.header.stamp = (self.node.get_clock().now() - Duration(seconds=3600.0 * self.is_late)).to_msg()
        wrench.wrench.force.x = 0.0 if self.is_late else pose.pose.position.x
        self.wrenches.publish(wrench)

    def hears(self, more):
        """Whether so many more poses come."""
        wanted = len(self.places) + more
        return self.spin_until(lambda: len(self.places) >= wanted)


def test_the_client_stays_outside_until_a_node_that_is_ready_answers_its_pose():
    node = PlayedNode()
    node.ready.publish(Bool(data=False))
    client = subprocess.Popen([sys.executable, "-c", BLOCKS[0]], stdout=subprocess.PIPE, text=True)
    try:
        assert node.hears(20)  # it answers, but is not ready
        assert set(node.places) == {0.13}
        node.is_late = True
        assert node.hears(20)  # what was under way is over
        node.ready.publish(Bool(data=True))
        assert node.hears(20)
        assert set(node.places) == {0.13}
        node.is_late = False
        assert node.spin_until(lambda: client.poll() is not None)
        assert min(node.places) == 0.101
        assert "x=0.101," in client.stdout.read()
    finally:
        client.kill()
        client.wait()
        client.stdout.close()
        node.close()


def test_what_is_in_place_of_ros2_is_answered(said):
    _, parameters, started, stopped, diagnostics, _ = said
    assert "successful=True" in parameters
    assert started == stopped
    assert "'tissue_sim: physics':" in diagnostics
    assert "'tissue_sim: tool left':" in diagnostics


def test_the_organ_is_cut_as_deep_as_the_page_says(said):
    depth = float(re.search(r"([\d.]+) mm deep", said[-1])[1])
    assert round(depth) == int(re.search(r"the organ, (\d+) mm deep", PAGE)[1])


def test_every_page_that_uses_ros2_says_what_to_do_without(said):
    for page in sorted((ROOT / "docs").glob("*.md")):
        text = page.read_text()
        if page.stem != "clients" and re.search(r"ros2 (param|topic|service) \w+", text):
            assert "(clients.md" in text, page.name
