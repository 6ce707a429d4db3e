"""The gallery of examples: each script is short, stands on the page beside its picture, and runs as it is."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from helpers.paths import ROOT
from helpers.patience import LIMIT

FOLDER = ROOT / "docs" / "examples"
SCRIPTS = sorted(FOLDER.glob("*.py"))
PAGE = (ROOT / "docs" / "examples.md").read_text()
CUTTING = (ROOT / "docs" / "cutting.md").read_text()


def run(name: str, folder: Path) -> str:
    """What an example prints; it has to make its picture in the folder."""
    pytest.importorskip("matplotlib")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    command = [sys.executable, str(FOLDER / f"{name}.py")]
    environment = os.environ | {"PATH": path, "MPLBACKEND": "agg"}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=LIMIT, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    return done.stdout


def test_examples_are_short_and_on_the_page_with_their_pictures():
    included = re.findall(r"^```\{literalinclude\} examples/(\w+)\.py$", PAGE, re.MULTILINE)
    pictures = re.findall(r"\]\(examples/(\w+)\.png\)", PAGE)
    assert sorted(included) == [script.stem for script in SCRIPTS]
    assert pictures == included
    for script in SCRIPTS:
        text = script.read_text()
        assert len(text.splitlines()) <= 40, script.name
        assert f'"{script.stem}.png"' in text, script.name


def test_examples_use_public_names_alone():
    for script in SCRIPTS:
        text = script.read_text()
        assert not re.findall(r"\btissue_sim\.\w+ import", text), script.name
        assert not re.findall(r"\._[a-z]", text), script.name


@pytest.mark.extended  # the tutorial presses, too
def test_a_press_pushes_the_hand_out(tmp_path):
    force = float(re.match(r"([\d.]+) N at 10 mm", run("press", tmp_path))[1])
    assert 0.4 < force < 1.2


@pytest.mark.extended
def test_a_bag_is_listed_with_shapes_and_units(tmp_path):
    text = run("bag_arrays", tmp_path)
    assert re.search(r"left/force +\(\d+, 3\) +N\n", text)
    assert re.search(r"left/angle +\(\d+,\) +rad\n", text)


@pytest.mark.extended
def test_force_is_proportional_to_stiffness(tmp_path):
    rows = re.findall(r"([\d.]+) kPa: ([\d.]+) N", run("sweep", tmp_path))
    moduli, forces = zip(*((float(modulus), float(force)) for modulus, force in rows), strict=True)
    assert moduli == (2.5, 5.0, 10.0, 20.0, 40.0)
    ratio = [force / modulus for modulus, force in zip(moduli, forces, strict=True)]
    assert max(ratio) < 1.4 * min(ratio)  # the damping of the tissue doesn't grow with its stiffness


@pytest.mark.extended
def test_the_tumour_is_where_the_force_is_highest(tmp_path):
    found = re.search(r"up to ([\d.]+) times the force, at (-?\d+), (-?\d+), (-?\d+) mm", run("many_presses", tmp_path))
    ratio, x, _, z = map(float, found.groups())
    assert ratio > 1.04
    assert np.hypot(x - 72.0, z + 6.0) < 12.0, "its centre lies at 72, 27, -6 mm"


@pytest.mark.slow
def test_an_agent_learns_to_press(tmp_path):
    pytest.importorskip("cma")
    rewards = [float(one) for one in re.findall(r"(-[\d.]+) at best", run("learn_press", tmp_path))]
    assert len(rewards) == 12
    assert rewards[-1] > rewards[0] + 0.3
    assert np.load(tmp_path / "learn_press.npy").shape == (5,)


@pytest.mark.extended
def test_learning_curves_rise(tmp_path):
    found = re.findall(r"return (-?[\d.]+) before and (-?[\d.]+) after", run("learning_curves", tmp_path))
    assert len(found) == 5
    assert all(float(after) > float(before) for before, after in found[:3]), "Press, Hold and Cut are learned"


@pytest.mark.extended
def test_a_scene_is_seen_without_ros(tmp_path):
    from helpers.drawing import require_drawing

    require_drawing()
    found = re.findall(r"([\d.]+) s: fingers (\d+) mm apart, mean colour ([\d.]+)", run("render", tmp_path))
    assert [int(apart) for _, apart, _ in found] == [12, 12, 40, 60]
    pressed, opened, released = (float(colour) for _, _, colour in found[1:])
    assert opened < min(pressed, released), "an open cut is dark"


@pytest.mark.extended
def test_an_organ_pulls_another_one_along(tmp_path):
    pushed, pulled = map(
        float, re.match(r"pushed ([\d.]+) mm, pulled along ([\d.]+) mm", run("two_organs", tmp_path)).groups()
    )
    assert 10.0 < pushed < 30.0
    assert 1.0 < pulled < 0.5 * pushed


@pytest.mark.extended
def test_a_gripper_pulls_a_half_aside_and_lets_go(tmp_path):
    text = run("cut", tmp_path)
    assert "cells divided" in text
    forces = [float(force) for force in re.findall(r"mm aside: (-?[\d.]+) N", text)]
    assert len(forces) == 5
    assert forces[3] > 0.1, "the half pulls back while it is spread"
    assert forces[0] == forces[4] == 0.0


@pytest.mark.extended
def test_a_knife_cuts_and_says_how_far_its_force_falls(tmp_path):
    text = run("blade", tmp_path)
    area, force, fall = map(float, re.search(r"^([\d.]+) mm\^2 cut.*\n([\d.]+) N .* (\d+) %", text).groups())
    assert area > 200.0
    assert 2.0 < force < 6.0
    assert abs(fall - int(re.search(r"the force falls by up to (\d+) %", CUTTING)[1])) < 10.0


@pytest.mark.extended
def test_scissors_cut_into_a_pole(tmp_path):
    area = float(re.match(r"([\d.]+) mm\^2 cut", run("scissors", tmp_path))[1])
    assert 500.0 < area < 900.0, "25 mm of a pole that is up to 33 mm thick"


@pytest.mark.extended
def test_frames_of_a_bag_are_drawn(tmp_path):
    assert "24 frames, every 100 ticks, 0.100 to 2.400 s" in run("frames", tmp_path)
    assert len(list((tmp_path / "nip").glob("*.vtu"))) == 72


@pytest.mark.extended
def test_an_organ_of_ones_own_is_calibrated(tmp_path):
    pytest.importorskip("netgen")
    first, second = run("own_organ", tmp_path).splitlines()
    assert "springs" in first
    assert "cells" in second
    assert (tmp_path / "bean.npz").is_file()


@pytest.mark.extended
def test_a_client_feels_the_kidney(tmp_path):
    pytest.importorskip("rclpy")
    from helpers.ros.processes import UNHURRIED, running_node

    with running_node(tmp_path, UNHURRIED):
        force = float(re.match(r"([\d.]+) N at most", run("client", tmp_path))[1])
    assert 0.05 < force < 2.0
