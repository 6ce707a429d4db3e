"""The profiles in config/bridges, each against a stand-in that speaks as the bridge that it is for."""

import re

import numpy as np
import pytest
from ruamel.yaml import YAML

from helpers.paths import CONFIG, ROOT
from helpers.ros.haptic_bridges import BRIDGES, StandIn
from helpers.ros.node_values import values as defaults
from helpers.ros.processes import UNHURRIED, Process, poke_path, running_node, shipped
from tissue_sim.ros.policy import enclaves_of
from tissue_sim.ros.shared.frames import tip_frame, wrench_frame
from tissue_sim.ros.shared.parameter_specs import NODE_SPECS, TOOL_SPECS
from tissue_sim.ros.shared.parameter_values import check_frames, placed_frames

PROFILES = {path.stem: path for path in sorted((CONFIG / "bridges").glob("*.yaml"))}


def parameters(name: str) -> dict:
    return YAML(typ="safe").load(PROFILES[name].read_text())["/**"]["ros__parameters"]


def test_every_profile_has_a_stand_in_and_a_line_on_its_page():
    assert PROFILES.keys() == BRIDGES.keys()
    page = (ROOT / "docs" / "bridges.md").read_text()
    for name in PROFILES:
        assert f"config/bridges/{name}.yaml" in page
        assert "github.com/" in PROFILES[name].read_text(), "where the bridge comes from"


@pytest.mark.parametrize("name", PROFILES)
def test_profiles_hold_known_parameters(name):
    values = parameters(name)
    tools = [values.pop(tool) for tool in values.pop("tools")]
    assert values.keys() <= {spec.name for spec in NODE_SPECS}
    assert all(tool.keys() <= {spec.name for spec in TOOL_SPECS} for tool in tools)


@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_hears_nothing_of_a_driver_but_poses_and_says_nothing_that_it_says(name):
    """Of all that the driver publishes, used or not: topics by what the node's policy allows it, and frames of tf."""
    given, bridge = parameters(name), BRIDGES[name]
    flat = {key: value for key, value in given.items() if not isinstance(value, dict)}
    flat |= {f"{tool}.{key}": value for tool in given["tools"] for key, value in given[tool].items()}
    values = defaults(*given["tools"]) | {"organs": []} | flat
    node = enclaves_of("tissue_sim", values)["/tissue_sim"]
    poses = {values[f"{tool}.measured_cp"] for tool in given["tools"]}
    assert set(node.subscribe) & bridge.outputs.keys() == poses
    assert all(bridge.outputs[topic] is bridge.pose_type for topic in poses)
    assert not set(node.publish) & bridge.outputs.keys()
    check_frames(values, given["tools"])
    own = {frame for tool in given["tools"] for frame in (tip_frame(tool), wrench_frame(tool))}
    own |= placed_frames(values, given["tools"]).keys()
    assert not own & set(bridge.frames)


# One shows that a profile, the node and a bridge go together; what differs in the others, test_tool_types shows.
SERVED = [name if name == "geomagic_touch" else pytest.param(name, marks=pytest.mark.extended) for name in PROFILES]


@pytest.fixture(scope="module", params=SERVED)
def served(request, tmp_path_factory):
    """A profile, and a node with it."""
    with running_node(tmp_path_factory.mktemp(request.param), UNHURRIED, profile=PROFILES[request.param]) as node:
        yield request.param, node


@pytest.mark.extended
def test_a_bridge_feels_the_kidney(served, tmp_path):
    """It reaches the node, is pushed out along its own axes, and feels nothing once its poses are invalid or stop.

    And without that device, a scripted bridge takes its place.
    """
    name, node = served
    stand_in = StandIn(BRIDGES[name])
    tool = parameters(name)["tools"][-1 if name == "saw_force_dimension" else 0]
    try:
        assert stand_in.spin_until(stand_in.connected), node.text()
        touch, inward = poke_path(shipped())
        touch = touch + parameters(name)["organ_pose"][:3]
        assert stand_in.spin_until(lambda: stand_in.hold(touch - 0.008 * inward) or len(stand_in.forces) > 0)
        for depth in np.linspace(-0.008, 0.003, 200):
            stand_in.hold(touch + depth * inward)
        stand_in.forces.clear()

        def is_settled():
            stand_in.hold(touch + 0.003 * inward)
            newest = np.linalg.norm(stand_in.forces[-20:], axis=1) if stand_in.forces else np.zeros(0)
            return len(stand_in.forces) > 40 and np.ptp(newest) < 0.01 * newest.mean()

        assert stand_in.spin_until(is_settled), stand_in.diagnostics
        pushed = np.array(stand_in.forces[-10:]).mean(axis=0)
        assert 0.03 < np.linalg.norm(pushed) < 0.8, "the force that the device exerts does not come back on the tissue"
        assert pushed @ -inward > 0.9 * np.linalg.norm(pushed)
        assert stand_in.set_parameter("stale_time", 0.05).successful
        cisst = name != "forcedimension_ros2"

        def is_released():
            if cisst:
                stand_in.send(touch + 0.003 * inward, valid=False)
            stand_in.spin(0.02)
            return not stand_in.forces[-1].any()

        assert stand_in.spin_until(is_released), "the force fades"
        if cisst:
            stand_in.send(touch, valid=False)
            assert stand_in.spin_until(lambda: f"{tool}.refused.no_stamp" in stand_in.diagnostics)
        assert stand_in.set_parameter("stale_time", 5.0).successful
        words = ["-m", "tissue_sim", "bridge", "--script", "poke", "--tools", tool]
        script = Process(words, tmp_path / "bridge.log")
        pressed = stand_in.spin_until(lambda: np.linalg.norm(stand_in.forces[-1]) > 0.15)
        assert pressed, "the scripted bridge plays this one"
        script.wait_for(f"{BRIDGES[name].pose_topic} has another publisher: {tool} jumps between the two")
        assert script.stop() == 0, script.text()
        forces = re.findall(rf"{tool} ([\d.]+) N", script.text())
        assert 0.1 < float(forces[0]) < 2.0, script.text()
    finally:
        stand_in.close()


@pytest.mark.extended
def test_its_tool_can_be_poked_with_in_the_viewer(served, open_page):
    name, node = served
    said = len(node.text())
    page = open_page(parameters(name)["tools"][0])
    page.press_and_release()
    assert page.poke._tool.topic in page.poke._box.hint
    assert not page.poke.jaws._slider.visible
    assert "refused" not in node.text()[said:]
