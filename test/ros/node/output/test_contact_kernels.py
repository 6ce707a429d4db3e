"""What is compiled beside a node that starts for the first time."""

import os
import subprocess
import sys

import pytest

from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.node.output.contact_kernels import compile_beside

SEARCH = """
from numba.core import event
from tissue_sim.contact.finder import ContactFinder
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

organ = Organ.load(shipped_organ())
tools = ToolSet([Tool("left"), Tool("right", shape="gripper", radius=0.003, length=0.03)])
finder = ContactFinder(organ, tools)
with event.install_recorder("numba:compile") as recorder:
    finder.warm_up(organ.rest_positions)
print("compiled", len(recorder.buffer))
"""


@pytest.mark.extended
def test_a_node_with_other_tools_finds_its_contact_kernels_on_disk(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    beside = compile_beside(shipped_organ())
    try:
        assert beside._process.wait(110.0) == 0, beside.last_words()
    finally:
        beside.stop()
    done = subprocess.run([sys.executable, "-c", SEARCH], env=os.environ, capture_output=True, text=True, check=True)
    assert done.stdout == "compiled 0\n"
