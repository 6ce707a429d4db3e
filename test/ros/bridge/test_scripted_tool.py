"""What the scripted bridge feels, whatever the type of the wrench."""

from dataclasses import replace

import pytest
from geometry_msgs.msg import Wrench, WrenchStamped
from std_msgs.msg import Float64MultiArray

from helpers.patience import wait_for
from tissue_sim.ros.bridge.scripted_tool import ScriptedTool
from tissue_sim.ros.shared.qos import RELIABLE, STREAM
from tissue_sim.ros.shared.tool_link import ToolLink

FORCE = {"x": 0.3, "y": 0.0, "z": -0.4}


def pushed(kind):
    message = kind()
    if kind is Float64MultiArray:
        message.data = [*FORCE.values(), 7.0, 7.0, 7.0]
        return message
    wrench = message.wrench if kind is WrenchStamped else message
    for axis, value in FORCE.items():
        setattr(wrench.force, axis, value)
        setattr(wrench.torque, axis, 7.0)
    return message


@pytest.mark.parametrize("is_reliable", [False, True])
@pytest.mark.parametrize("kind", [WrenchStamped, Wrench, Float64MultiArray])
def test_it_feels_a_wrench_of_every_type(graph, kind, is_reliable):
    link = ToolLink.by_default("left", "organ")
    link = replace(link, topics=replace(link.topics, wrench_type=kind.__name__, reliable=is_reliable))
    tool = ScriptedTool(graph, link)
    publisher = graph.create_publisher(kind, "left/servo_cf", RELIABLE if is_reliable else STREAM)

    def has_force():
        publisher.publish(pushed(kind))
        tool.receive()
        return tool.received > 0

    wait_for(has_force)
    assert tool.peak == pytest.approx(0.5)
