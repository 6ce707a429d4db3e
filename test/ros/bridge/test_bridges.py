"""The profiles in config/bridges, each against a stand-in that speaks as the bridge that it is for."""

import re
import time

import numpy as np
import pytest
from ruamel.yaml import YAML

from helpers.paths import CONFIG, ROOT
from helpers.ros.haptic_bridges import BRIDGES, StandIn
from helpers.ros.processes import READY, Process, poke_path, shipped, start_node
from tissue_sim.ros.shared.parameters import NODE_SPECS, TOOL_SPECS

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
def test_a_bridge_feels_the_kidney(name, tmp_path):
    """It reaches the node, is pushed out along its own axes, and feels nothing once its poses are invalid or stop.

    And without that device, a scripted bridge takes its place.
    """
    # A busy machine may hold these poses up.
    node = start_node(tmp_path, "stale_time:=5.0", profile=PROFILES[name], wait=False)
    stand_in = StandIn(BRIDGES[name])
    tool = parameters(name)["tools"][-1 if name == "saw_force_dimension" else 0]
    try:
        node.wait_for(READY)
        assert stand_in.spin_until(stand_in.connected, 10.0), node.text()
        touch, inward = poke_path(shipped())
        touch = touch + parameters(name)["organ_pose"][:3]
        start, held = time.monotonic(), 0
        while (held < 40 or not np.any(stand_in.forces[-1:])) and time.monotonic() < start + 8.0:
            depth = -0.008 + 0.011 * min(1.0, max(0.0, time.monotonic() - start - 0.2))
            stand_in.send(touch + depth * inward)
            stand_in.spin(0.004)
            held += depth > 0.003 - 1e-9
        pushed = np.array(stand_in.forces[-10:]).mean(axis=0)
        assert 0.03 < np.linalg.norm(pushed) < 3.0, stand_in.diagnostics
        assert pushed @ -inward > 0.9 * np.linalg.norm(pushed)
        assert stand_in.set_parameter("stale_time", 0.05).successful
        cisst = name != "forcedimension_ros2"
        end = time.monotonic() + 5.0
        while stand_in.forces[-1].any() and time.monotonic() < end:
            if cisst:
                stand_in.send(touch + depth * inward, valid=False)
            stand_in.spin(0.02)
        assert not stand_in.forces[-1].any(), "the force fades"
        if cisst:
            stand_in.send(touch, valid=False)
            assert stand_in.spin_until(lambda: f"{tool}.refused.no_stamp" in stand_in.diagnostics, 5.0)
        words = ["-m", "tissue_sim", "bridge", "--script", "poke", "--tools", tool]
        script = Process(words, tmp_path / "bridge.log")
        pressed = stand_in.spin_until(lambda: np.linalg.norm(stand_in.forces[-1]) > 0.15, 15.0)
        assert pressed, "the scripted bridge plays this one"
        script.wait_for(f"{BRIDGES[name].pose_topic} has another publisher: {tool} jumps between both", 10.0)
        assert script.stop() == 0, script.text()
        felt = re.findall(rf"{tool} ([\d.]+) N", script.text())
        assert 0.1 < float(felt[0]) < 2.0, script.text()
        assert node.stop() == 0, node.text()
        assert "Traceback" not in node.text()
    finally:
        stand_in.close()
        node.child.kill()
