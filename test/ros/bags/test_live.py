"""`tissue_sim replay --live`: the recorded inputs to a real node over DDS, with /clock."""

import subprocess
import sys

import pytest

from helpers.paths import ROOT
from helpers.patience import LIMIT
from helpers.ros.processes import running_node
from tissue_sim.ros.bags.recording import Recording

BAG = ROOT / "bags" / "poke"
LOOSE = ("--live-force-tolerance", "0.5", "--live-position-tolerance", "1e-3")  # a busy machine hands over late


def live(*words):
    command = [sys.executable, "-m", "tissue_sim", "replay", str(BAG), "--live", *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT)


@pytest.fixture
def organ(tmp_path):
    """Parameters of a node that has the organ and the tool of the bag."""
    path = tmp_path / "organ.npz"
    path.write_bytes(Recording.read(BAG).organs[0].file)
    return (f"organ_file:={path}", "tools:=[left]", "marker_rate:=5.0")


def test_a_node_with_the_same_organ_shows_the_same(tmp_path, organ):
    with running_node(tmp_path, "use_sim_time:=true", *organ):
        done = live(*LOOSE)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "parameter marker_rate: recorded 2.0, /tissue_sim has 5.0" in done.stdout
    (line,) = (line for line in done.stdout.splitlines() if line.startswith(f"{BAG} on /tissue_sim: "))
    assert int(line.partition("compared ")[2].split()[0]) > 20, line
    assert done.stdout.count("repeats\n") == 2


def test_another_stiffness_is_named_and_found(tmp_path, organ):
    with running_node(tmp_path, "use_sim_time:=true", "stiffness_scale:=3.0", *organ):
        done = live(*LOOSE)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "parameter stiffness_scale: recorded 1.0, /tissue_sim has 3.0" in done.stdout
    assert "FAILED: beyond force 0.5 N" in done.stdout


def test_a_node_that_follows_the_wall_is_refused(tmp_path, organ):
    with running_node(tmp_path, *organ):
        done = live()
    assert done.returncode == 2
    assert done.stderr == "tissue_sim: error: /tissue_sim does not follow /clock: start it with use_sim_time:=true\n"
