"""What a tool's port says about it."""

from types import SimpleNamespace

import pytest

from tissue_sim.ros.node.tools.tool_port import ToolPort


@pytest.mark.parametrize(
    ("bearable", "end"),
    [
        (4.0, "presses on it with at most 4 N until it has been outside"),
        (15.2, "at most 15 N until it has been outside; its published force is clamped to 10 N (force_clamp)"),
    ],
)
def test_a_tool_that_slipped_is_said_to_press_and_what_of_it_is_published(bearable, end):
    port = ToolPort.__new__(ToolPort)  # without a node
    port._tool, port._organs = SimpleNamespace(name="left"), SimpleNamespace(force_clamp=10.0)
    assert port._slipped(bearable).endswith(end)
