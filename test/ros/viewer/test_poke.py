"""Poking from the browser: how a held tool moves, what it publishes, and a hand on a real page."""

import io
import itertools

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from scipy.spatial.transform import Rotation

from helpers.ros.clients import Client
from helpers.ros.participant import Participant
from helpers.ros.processes import UNHURRIED, Process, shipped, start_node
from tissue_sim.ports import free_port
from tissue_sim.ros.viewer.poked_tool import ACCELERATION, TOP_SPEED, PokedTool, follow

pytest.importorskip("viser")
from helpers.ros import browser as browsers
from tissue_sim.rendering.organ_view import FIELD_OF_VIEW, camera_for
from tissue_sim.ros.viewer.poke import beside, pointing

RADIUS = 0.005
SIZE = (900, 600)
EVERY = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_EFFORT)  # a busy machine loses none


# the hand --------------------------------------------------------------------------------------
@pytest.mark.parametrize("step", [0.001, 0.004, 0.02])
@pytest.mark.parametrize("distance", [0.0005, 0.01, 0.3])
def test_a_tool_follows_its_goal_without_a_blow(step, distance):
    goal = distance * np.array([0.6, 0.0, -0.8])
    position, velocity = np.zeros(3), np.zeros(3)
    for _ in range(round((distance / TOP_SPEED + 0.5) / step)):
        after, speed = follow(position, velocity, goal, step)
        assert np.linalg.norm(after - position) <= TOP_SPEED * step * (1 + 1e-9)
        assert np.linalg.norm(speed - velocity) <= ACCELERATION * step * (1 + 1e-9)
        position, velocity = after, speed
        assert position @ goal <= distance**2 * (1 + 0.02) + 1e-6, "past the goal"
    assert np.linalg.norm(position - goal) < 1e-5 + 0.001 * distance


@pytest.mark.parametrize("index", range(5))
def test_a_tool_is_taken_outside_and_points_in(index):
    points = shipped().surface_positions
    position, inward = beside(points, index, RADIUS)
    assert np.linalg.norm(points - position, axis=1).min() > RADIUS + 0.005
    assert ((points - position) @ inward).min() > RADIUS
    ahead = points - position
    assert np.linalg.norm(ahead - np.outer(ahead @ inward, inward), axis=1).min() < RADIUS, "nothing to poke"
    assert Rotation.from_quat(pointing(inward)).apply([0.0, 0.0, 1.0]) == pytest.approx(inward)


@pytest.fixture
def graph():
    rclpy.init()
    node = rclpy.create_node("hand")
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def test_a_held_tool_publishes_until_it_is_released(graph):
    listener = Participant("listener")
    poses = []
    listener.node.create_subscription(PoseStamped, "left/measured_cp", poses.append, EVERY)
    tool = PokedTool(graph, "left")
    assert not tool.held
    tool.take(np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.6, 0.0, 0.8]), "theatre")
    assert listener.spin_until(lambda: len(poses) > 0)
    tool.goal = np.array([0.2, 0.2, 0.3])
    assert listener.spin_until(lambda: poses[-1].pose.position.x > 0.19)
    assert tool.other_publishers() == 0
    message = poses[-1]
    assert message.header.frame_id == "theatre"
    assert (message.pose.orientation.y, message.pose.orientation.w) == (0.6, 0.8)
    stamps = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in poses])
    x = np.array([m.pose.position.x for m in poses])
    assert (np.diff(stamps) > 0.0).all()
    assert np.diff(x).max() <= TOP_SPEED * 0.021, "a leap"
    assert x[-1] <= 0.2002
    listener.node.create_publisher(PoseStamped, "left/measured_cp", qos_profile_sensor_data)
    assert listener.spin_until(lambda: tool.other_publishers() == 1)
    tool.release()
    assert listener.hears_no_more(poses)
    listener.close()


# the page --------------------------------------------------------------------------------------
BOXES = "[...document.querySelectorAll('input[type=checkbox]')].filter(e => e.getBoundingClientRect().width > 0)"
CENTRES = f"{BOXES}.map(e => e.getBoundingClientRect()).map(r => [r.x + r.width / 2, r.y + r.height / 2])"


def pixel(point):
    """Where the page shows a point (3,) m."""
    eye, looked_at = camera_for(shipped().surface_positions, SIZE)
    forward = (looked_at - eye) / np.linalg.norm(looked_at - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    ray = point - eye
    scale = 0.5 * SIZE[1] / np.tan(0.5 * FIELD_OF_VIEW) / (ray @ forward)
    return 0.5 * SIZE[0] + scale * (ray @ right), 0.5 * SIZE[1] - scale * (ray @ np.cross(right, forward))


def fraction_of_yellow(png):
    """Of the organ's part of a screenshot, how much has the colour of a displacement of mm."""
    image = pytest.importorskip("PIL.Image").open(io.BytesIO(png)).convert("RGB")
    red, green, blue = np.asarray(image).astype(int).transpose(2, 0, 1)[:, :, : SIZE[0] - 350]  # beside the panel
    return ((red > 180) & (green > 130) & (blue < 0.8 * green)).mean()


@pytest.fixture
def page(tmp_path):
    """A node, its viewer and a browser with the viewer's page."""
    if browsers.program() is None:
        pytest.skip("no Chromium on this machine (apt install chromium)")
    port = free_port()
    node = start_node(tmp_path, "tools:=[left]", UNHURRIED)
    words = ["-m", "tissue_sim", "view", "--port", str(port), "--tools", "left", "--patience", "20"]
    viewer = Process(words, tmp_path / "view.log")
    page = None
    try:
        viewer.wait_for("open http")
        page = browsers.Browser(tmp_path, *SIZE)
        page.open(f"http://127.0.0.1:{port}")
        yield page
    finally:
        if page is not None:
            page.close()
        codes = viewer.stop(), node.stop()
    assert codes == (0, 0), viewer.text() + node.text()
    assert "Traceback" not in viewer.text()


@pytest.mark.extended
@pytest.mark.timeout(1200)
def test_a_drag_in_the_browser_presses_the_organ(page, tmp_path):
    client = Client()
    poses = []
    client.node.create_subscription(PoseStamped, "left/measured_cp", poses.append, qos_profile_sensor_data)

    def force():
        return float(np.linalg.norm(client.wrenches[-1][1][:3])) if client.wrenches else 0.0

    try:
        page.wait_for_text("Tick rate")
        page.wait_for(f"{BOXES}.length == 1 && !{BOXES}[0].disabled")
        assert client.spin_until(lambda: "A bridge already moves" in page.text()), "the client publishes too"
        client.node.destroy_publisher(client.pose)
        assert client.spin_until(lambda: "A bridge already moves" not in page.text())
        assert fraction_of_yellow(page.picture()) < 0.001

        position, inward = beside(shipped().surface_positions, 0, RADIUS)
        arrow = position + 0.022 * inward  # on the one that points into the organ

        def tick():
            if not page.run(f"{BOXES}[0].checked"):
                page.click(page.run(CENTRES)[0])

        def is_released():
            poses.clear()
            client.spin(0.5)
            return not poses and force() == 0.0

        tries = itertools.count(1)

        def is_pressed():  # a page that has no time loses moves of the mouse, or the tool: then from the start
            tick()
            poses.clear()
            if not client.spin_until(lambda: len(poses) > 50, 20.0):
                return False
            assert force() == 0.0, "taken in hand outside the organ"
            client.spin(0.5 * next(tries))  # until the page has the arrows, too
            page.drag(pixel(arrow), pixel(arrow + 0.02 * inward))
            if client.spin_until(lambda: force() > 0.1, 15.0):
                return True
            page.mouse("Released", pixel(arrow))
            page.call("Page.reload")  # what is dragged without arrows is the camera
            page.wait_for(f"{BOXES}.length == 1 && !{BOXES}[0].disabled")
            client.spin_until(is_released, 10.0)
            return False

        browsers.wait_for(is_pressed, page.text)
        browsers.wait_for(lambda: fraction_of_yellow(page.picture(tmp_path / "poked.png")) > 0.03, "no colour")
        plotted = "Math.max(...Object.values(window.__viserTestpoints.uplots)[0].chart.data[1].filter(isFinite))"
        browsers.wait_for(lambda: (page.run(plotted) or 0.0) > 0.1, "no curve")

        page.open("about:blank")  # the hand leaves without letting go: the browser keeps the connection open
        assert client.spin_until(is_released)
    finally:
        client.close()
