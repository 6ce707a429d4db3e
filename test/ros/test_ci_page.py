"""docs/ci.md: what a user copies from it runs as it is printed."""

import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from helpers.paths import ROOT
from helpers.patience import LIMIT

PAGE = (ROOT / "docs" / "ci.md").read_text()


def blocks(kind):
    return re.findall(rf"^```{kind}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("ci")


def run(script, folder):
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "-e", "-c", script],
        cwd=folder,
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )


@pytest.mark.extended
def test_the_shell_blocks_run_as_printed(folder):
    """One records over DDS and keeps the bag, the next replays it."""
    recording, replaying = blocks("bash")
    recorded = run(recording, folder)
    assert recorded.returncode == 0, recorded.stdout + recorded.stderr
    replayed = run(replaying, folder)
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr
    assert "repeats" in replayed.stdout
    # A disk too busy to close the bag when the node ended leaves that to the replay.
    assert (folder / "scenes" / "poke" / "metadata.yaml").is_file()
    assert ElementTree.parse(folder / "replay.xml").getroot().get("failures") == "0"
    assert (folder / "pictures" / "poke.png").is_file()


@pytest.mark.extended
def test_the_workflow_replays(folder):
    """What GitHub runs, but for the installation."""
    yaml = pytest.importorskip("yaml")
    (text,) = blocks("yaml")
    steps = yaml.safe_load(text)["jobs"]["replay"]["steps"]
    (command,) = (step["run"] for step in steps if step.get("run", "").startswith("tissue_sim"))
    done = run(command.replace("scenes/*/", f"{ROOT}/bags/poke {ROOT}/bags/stroke"), folder)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(" ok\n") == 2


def test_a_replay_needs_no_ros():
    code = "import sys; sys.modules.update(rclpy=None, matplotlib=None); import tissue_sim.ros.bags.replay"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
