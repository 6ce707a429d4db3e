"""The page of programs of one's own: its client and what it has in place of ros2, run as they are printed."""

import re
import subprocess
import sys

import pytest

from helpers.paths import ROOT
from helpers.patience import LIMIT
from helpers.ros.processes import UNHURRIED, running_node

pytestmark = pytest.mark.extended

PAGE = (ROOT / "docs" / "clients.md").read_text()
BLOCKS = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    """What all of it prints beside a node, line by line."""
    folder = tmp_path_factory.mktemp("client")
    with running_node(folder, UNHURRIED, f"record_folder:={folder}"):
        command = [sys.executable, "-c", "\n".join(BLOCKS)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_the_client_has_15_lines_and_feels_the_kidney(said):
    assert len(BLOCKS[0].splitlines()) == 15
    x, y, z = map(float, re.fullmatch(r".*Vector3\(x=(.+), y=(.+), z=(.+)\)", said[0]).groups())
    assert 0.05 < x < 1.0, "out of the side that it pressed"
    assert abs(y) + abs(z) < 0.5 * x


def test_what_is_in_place_of_ros2_is_answered(said):
    _, parameters, started, stopped, diagnostics = said
    assert "successful=True" in parameters
    assert started == stopped
    assert "'tissue_sim: physics':" in diagnostics
    assert "'tissue_sim: tool left':" in diagnostics


def test_every_page_that_uses_ros2_says_what_to_do_without(said):
    for page in sorted((ROOT / "docs").glob("*.md")):
        text = page.read_text()
        if page.stem != "clients" and re.search(r"ros2 (param|topic|service) \w+", text):
            assert "(clients.md" in text, page.name
