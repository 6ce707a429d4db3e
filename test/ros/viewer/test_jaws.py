"""A gripper's jaws from the viewer: they move gently, and only when somebody asks."""

import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import JointState

from helpers.ros.participant import Participant
from helpers.ros.processes import UNHURRIED, start_node
from tissue_sim.ros.shared.tool_link import ToolLink
from tissue_sim.ros.viewer.poked_jaws import PokedJaws
from tissue_sim.ros.viewer.poked_tool import LONGEST_STEP, TOP_SPEED

pytest.importorskip("viser")
import viser

from helpers.paths import CONFIG
from helpers.ros.node_values import values
from tissue_sim.ports import free_port
from tissue_sim.ros.viewer.jaws import JawSlider
from tissue_sim.ros.viewer.tool_view import ToolView

EVERY = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_EFFORT)  # a busy machine loses none


def test_jaws_turn_without_a_blow_and_then_are_silent(graph):
    listener = Participant("listener")
    heard = []
    listener.node.create_subscription(
        JointState, "left/gripper/measured_js", lambda m: heard.append(m.position[0]), EVERY
    )
    length = 0.06
    jaws = PokedJaws(
        graph, ToolLink.from_parameters(values(left__shape="gripper", left__length=length), "left", "tissue_sim")
    )
    try:
        listener.spin(0.3)
        assert not heard, "nobody touched it"
        jaws.turn(0.8, 0.8)  # until DDS has brought both ends together
        assert listener.spin_until(lambda: heard and not jaws.moving)
        heard.clear()
        jaws.turn(0.2, 0.8)
        assert listener.spin_until(lambda: bool(heard))
        assert jaws.moving
        assert jaws.other_publishers() == 0
        assert listener.spin_until(lambda: not jaws.moving)
        assert listener.spin_until(lambda: heard[-1] == pytest.approx(0.2, abs=1e-3)), heard[-1]
        tips = 0.5 * length * np.array(heard)  # m
        assert abs(tips[0] - 0.5 * length * 0.8) <= 1.01 * TOP_SPEED * LONGEST_STEP
        assert np.abs(np.diff(tips)).max() < 3.0 * TOP_SPEED * LONGEST_STEP, "a leap"
        assert listener.hears_no_more(heard)
    finally:
        jaws.close()
        listener.close()


@pytest.mark.parametrize(("shape", "shown"), [("gripper", True), ("scissors", True), ("blade", False), ("urdf", False)])
def test_the_slider_is_there_for_jaws_that_turn(graph, shape, shown):
    server = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
    try:
        slider = JawSlider(server, graph, ToolView(server, "left", 0))
        slider.use(ToolLink.from_parameters(values(left__shape=shape), "left", "tissue_sim"))
        assert slider._slider.visible is shown
        slider.remove()
    finally:
        server.stop()


@pytest.mark.extended
def test_jaws_open_from_the_page_and_only_when_somebody_asks(tmp_path, open_page):
    node = start_node(tmp_path, UNHURRIED, profile=CONFIG / "gripper.yaml")
    page = open_page("left")
    listener, heard = Participant("listener"), []
    listener.node.create_subscription(JointState, "left/gripper/measured_js", heard.append, qos_profile_sensor_data)
    slider = page.poke.jaws._slider
    try:
        assert page.wait(lambda: slider.visible and not page.poke._box.disabled)
        page.tick(True)
        assert page.wait(lambda: page.view.opening is not None)
        page.wait(lambda: False, 1.0)
        listener.spin(0.1)
        assert not heard

        def is_heard(degrees):
            page.slide(degrees)
            assert page.wait(lambda: abs(np.degrees(page.view.opening or 0.0) - degrees) < 0.1), node.text()
            assert page.wait(lambda: not page.poke.jaws._jaws.moving)
            wanted = pytest.approx(np.radians(degrees), abs=1e-3)
            return listener.spin_until(lambda: heard and heard[-1].position[0] == wanted, timeout=5.0)

        # The last of a move may be lost, as best effort allows, and jaws that stand are silent.
        assert any(is_heard(degrees) for degrees in (40.0, 35.0, 40.0, 35.0, 40.0))

        bridge = listener.node.create_publisher(JointState, "left/gripper/measured_js", qos_profile_sensor_data)
        page.wait(lambda: False, 1.5)

        def other_hand():
            bridge.publish(JointState(position=[np.radians(20.0)]))
            return slider.value == 20.0

        assert page.wait(other_hand), "the slider shows what the jaws do"
        page.slide(30.0)
        assert page.wait(lambda: page.poke._warning.visible)
        assert "A bridge already moves the jaws of `left`" in page.poke._warning.content
        assert node.stop() == 0, node.text()
    finally:
        listener.close()
        node.child.kill()
