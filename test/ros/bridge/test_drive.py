"""A learned policy moves a tool of a real node over DDS, and reaches the force that it was to reach."""

import re
from contextlib import contextmanager

import numpy as np
import pytest

pytest.importorskip("gymnasium")

from diagnostic_msgs.msg import DiagnosticArray

from helpers.paths import CONFIG
from helpers.patience import wait_for
from helpers.ros.processes import UNHURRIED, Process, shipped, start_node
from helpers.scenes import ball_of_cells
from tissue_sim.contact.tools import Tool
from tissue_sim.environments.blade_path import GOOD_DEPTH
from tissue_sim.environments.cut_copies import copies_of
from tissue_sim.environments.policies import Learned
from tissue_sim.environments.steering import observation_of
from tissue_sim.environments.tasks import FOUND, PRECISION, RADIUS, Palpate, task_of
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bridge.driven_tool import DrivenTool, Goal, check_tool
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.qos import LATCHED

FORCE = 0.25  # N


def driven(folder, *words):
    """What the command prints, and its exit code."""
    process = Process(["-m", "tissue_sim", "drive", *words], folder / "drive.log", TISSUE_SIM_PROGRESS="0")
    code = process.wait()
    return process.text(), code


@contextmanager
def node_of(folder, profile, *parameters):
    node = start_node(folder, UNHURRIED, *parameters, profile=CONFIG / profile)
    try:
        yield node
    finally:
        assert node.stop() == 0, node.text()


@pytest.mark.extended
def test_a_learned_policy_reaches_the_force_over_dds(tmp_path):
    surface = shipped().surface_positions
    place = surface[np.argmax(surface[:, 0])]
    given = ["--place", *map(str, place.tolist()), "--force", str(FORCE)]
    with node_of(tmp_path, "finger.yaml"):
        text, code = driven(tmp_path, "press", *given)
        assert code == 0, text
        found = re.search(r"goal met: ([\d.]+) N of 0.250 N, ([\d.]+) mm beside", text)
        assert float(found[1]) == pytest.approx(FORCE, rel=PRECISION)
        assert float(found[2]) < 3.0
        # A policy that does nothing meets no force: the one above came through the topics.
        none = Learned("Press", np.zeros(3))
        none.save(tmp_path / "none.json")
        text, code = driven(tmp_path, str(tmp_path / "none.json"), *given, "--seconds", "0.5")
        assert code == 1
        assert "goal not met: 0.000 N" in text


@pytest.mark.extended
def test_a_learned_policy_lifts_the_pole_over_dds(tmp_path):
    with node_of(tmp_path, "gripper.yaml"):
        text, code = driven(tmp_path, "retract")
        assert code == 0, text
        assert "Retract: goal met" in text
        none = Learned("Retract", np.zeros(6))
        none.save(tmp_path / "none.json")
        text, code = driven(tmp_path, str(tmp_path / "none.json"), "--seconds", "0.5")
        assert code == 1
        assert "goal not met" in text


@pytest.mark.extended
def test_a_learned_policy_finds_the_tumour_over_dds(tmp_path):
    """It doesn't know that the organ lies at its usual place; what it says is checked here, not by itself.

    A node that a busy machine holds up shows the policy tissue that lags: one of three searches has to find it.
    """
    organ = Organ.shipped("kidney_tumour")
    node = Palpate.node_over_tumour(organ)
    over_tumour = organ.surface_positions[node] + RADIUS * organ.surface_normals[node]
    missed = []
    with node_of(tmp_path, "finger.yaml", "organ:=kidney_tumour"):
        while not missed or missed[-1] >= FOUND:
            assert len(missed) < 3, missed
            text, code = driven(tmp_path, "palpate")
            assert code == 0, text
            found = re.search(r"says that it is here .* tool at ([-\d.]+), ([-\d.]+), ([-\d.]+) mm", text)
            tip = 1e-3 * np.array([float(found[part]) for part in (1, 2, 3)])
            missed.append(np.linalg.norm(tip - over_tumour))


@pytest.mark.extended
def test_a_learned_policy_cuts_along_the_line_over_dds(tmp_path, graph):
    """What the node reports of the cut is checked here, not by what the command says of itself."""
    given = ["--depth", "0.012", "--length", "0.02", "--along", "0", "0", "1"]
    cuts = client.NewestMessage(graph, DiagnosticArray, "/tissue_sim/cuts", LATCHED)
    with node_of(tmp_path, "guard.yaml"):
        none = Learned("Cut", np.zeros(6))
        none.save(tmp_path / "none.json")
        text, code = driven(tmp_path, str(tmp_path / "none.json"), *given, "--seconds", "0.5")
        assert code == 1
        assert "Cut: goal not met: not finished" in text
        assert cuts.take() is None, "nothing was cut"
        text, code = driven(tmp_path, "cut", *given)
        assert code == 0, text
        (cut,) = wait_for(cuts.take, text).status
    values = {item.key: float(item.value) for item in cut.values if item.key.endswith(("_m", "_m2"))}
    assert values["depth_m"] == pytest.approx(0.012, rel=GOOD_DEPTH)
    assert values["area_m2"] == pytest.approx(0.012 * 0.02, rel=0.35)


@pytest.mark.parametrize("task", ["Press", "Cut"])
def test_what_is_seen_over_ros_is_what_the_environment_shows(task):
    """The same tool, wrench and goal give the same observations, in an environment whose organ lies straight."""
    copies = copies_of(task, 1, ball_of_cells())
    copies.begin(np.arange(1), [np.random.default_rng(1)])
    copies._heading[:], copies._shift[:] = 0.0, 0.0
    for _ in range(16 if task == "Cut" else 8):  # a guard is smaller than a finger
        copies.step(np.hstack([-copies._outward, [[0.5, 0.0]]])[:, : copies.task.actions])
    seen = copies.observe()
    assert np.linalg.norm(seen["wrench"][0, :3]) > 0.01, "it touches"
    driver = DrivenTool.__new__(DrivenTool)
    driver.wrench, driver._turn, driver._angle = copies.batch.wrenches[0, 0], np.array([0.0, 0.0, 0.0, 1.0]), 0.0
    driver._blade = copies._blade
    wanted, half = float(copies._wanted[0]), copies._half[0]
    goal = Goal(int(copies._node[0]), *[copies._place[0]] * 2, copies._outward[0], wanted, half=half)
    over_ros = observation_of(task_of(task), driver._sensed(copies._tip[0], goal))
    assert list(over_ros) == list(seen)
    for name, values in seen.items():
        np.testing.assert_allclose(over_ros[name], values, atol=1e-6, err_msg=name)


@pytest.mark.parametrize(
    ("tool", "task", "message"),
    [
        (Tool("left"), "Press", "radius of 5 mm; .* -p left.shape:=sphere -p left.radius:=0.008$"),
        (Tool("left"), "Cut", "radius of 5 mm; .* -p left.shape:=sphere -p left.radius:=0.002$"),
        (Tool("left", radius=RADIUS), "Retract", "isn't the gripper .* --params-file config/gripper.yaml$"),
    ],
)
def test_another_tool_than_the_one_that_was_learned_with_is_refused(tool, task, message):
    with pytest.raises(UserError, match=message):
        check_tool(task_of(task), tool, "tissue_sim")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere.json"], "there is no policy 'nowhere.json'"),
        (["press", "--place", "0", "nan", "0"], "--place has numbers that are not finite"),
        (["cut", "--along", "inf", "0", "0"], "--along has numbers that are not finite"),
        (["press", "--force", "0"], "0 is outside 0.01..20 N"),
        (["press", "--wait", "0.1", "--node", "nobody"], "no answer from /nobody/get_parameters within 0.1 s"),
    ],
)
def test_what_cannot_be_driven_is_named(tmp_path, words, message):
    text, code = driven(tmp_path, *words)
    assert message in text
    assert code == (1 if "--wait" in words else 2)
