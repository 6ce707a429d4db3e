"""`tissue_sim replay --live`: the recorded inputs to a real node over DDS, with /clock."""

import subprocess
import sys

import pytest

from helpers.paths import ROOT
from helpers.patience import LIMIT
from helpers.ros.processes import running_node
from tissue_sim.cli import main
from tissue_sim.ros.bags.recording import Recording

pytestmark = pytest.mark.extended

BAG = ROOT / "bags" / "poke"
LOOSE = ("--live-force-tolerance", "0.5", "--live-position-tolerance", "1e-3")  # a busy machine hands over late


WORDS = ["replay", str(BAG), "--live"]


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    """A node that has the organ and the tool of the bag, and follows /clock."""
    folder = tmp_path_factory.mktemp("live")
    path = folder / "organ.npz"
    path.write_bytes(Recording.read(BAG).organs[0].file)
    words = ("use_sim_time:=true", f"organ_file:={path}", "tools:=[left]", "marker_rate:=5.0")
    with running_node(folder, *words) as process:
        yield process


def test_a_node_with_the_same_organ_shows_the_same(node):
    command = [sys.executable, "-m", "tissue_sim", *WORDS, *LOOSE]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "parameter marker_rate: recorded 2.0, /tissue_sim has 5.0" in done.stdout
    (line,) = (line for line in done.stdout.splitlines() if line.startswith(f"{BAG} on /tissue_sim: "))
    assert int(line.partition("compared ")[2].split()[0]) > 20, line
    assert done.stdout.count("repeats\n") == 2


def test_another_stiffness_is_named_and_found(node, client, capsys):
    assert client.set_parameter("stiffness_scale", 3.0).successful
    code, said = main([*WORDS, *LOOSE]), capsys.readouterr()
    assert client.set_parameter("stiffness_scale", 1.0).successful
    assert code == 1, said.out + said.err
    assert "parameter stiffness_scale: recorded 1.0, /tissue_sim has 3.0" in said.out
    assert "FAILED: deviation above force 0.5 N" in said.out


def test_a_node_that_follows_the_wall_is_refused(node, client, capsys):
    assert client.set_parameter("use_sim_time", False).successful
    assert client.spin_until(lambda: client.diagnostics.get("clock") == "wall")
    code, said = main(WORDS), capsys.readouterr()
    assert client.set_parameter("use_sim_time", True).successful
    assert code == 2
    assert said.err == "tissue_sim: error: /tissue_sim does not follow /clock: start it with use_sim_time:=true\n"
