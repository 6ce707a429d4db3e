"""`make demo` installs less than the other targets, and runs with that; the node runs with less still."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAKEFILE = (ROOT / "Makefile").read_text()
# What only finite elements, peers, images, plots and checks need.
OTHERS = (
    "skfem",
    "netgen",
    "mujoco",
    "pypbd",
    "SimpleITK",
    "skimage",
    "matplotlib",
    "jinja2",
    "joblib",
    "distributed",
    "moderngl",
    "fast_simplification",
    "pytest",
    "mypy",
)


def extras(name):
    (value,) = re.findall(rf"^{name} := (\S+)$", MAKEFILE, re.MULTILINE)
    return value.replace("$(DEMO_EXTRAS)", "").strip(",").split(",")


def test_demo_installs_what_it_needs_and_no_more():
    assert extras("DEMO_EXTRAS") == ["ros", "viewer"]
    assert set(extras("EXTRAS")) == {
        "camera",
        "instruments",
        "learn",
        "image",
        "calibration",
        "cluster",
        "bench",
        "test",
    }


@pytest.mark.extended
def test_node_loads_without_any_extra_and_programs_of_the_demo_without_the_others():
    """In one process, as rclpy takes a second to load: the viewer's library comes once the node is there."""
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({(*OTHERS, 'viser')!r}))\n"
        "import tissue_sim.ros.node.serve\n"
        "del sys.modules['viser']\n"
        "import tissue_sim.ros.demo, tissue_sim.ros.bags.replay\n"
        "import tissue_sim.ros.viewer.loop, tissue_sim.ros.viewer.view\n"
        "import tissue_sim.ros.bridge.play, tissue_sim.ros.bridge.scripted_tool, tissue_sim.ros.bridge.trajectory"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
