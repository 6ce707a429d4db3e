"""Which tools the page shows: those of the node, whichever it has."""

import numpy as np
import pytest
import viser
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import MarkerArray

from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.ports import free_port
from tissue_sim.ros.node.output.tool_markers import ToolMarkers
from tissue_sim.ros.viewer.tools import SILENT_AFTER, ToolsView
from tissue_sim.ros.viewer.view import PATIENCE


@pytest.fixture
def server():
    server = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
    yield server
    server.stop()


def markers_of(*names):
    """What a node with spheres of these names publishes of them, each 0.1 m from the organ, with a force of 0.5 N."""
    tools = ToolSet([Tool(name) for name in names])
    pose = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    tips, forces = np.tile(pose[:3], (len(names), 1)), np.tile([0.0, 0.0, 0.5], (len(names), 1))
    return deserialize_message(
        ToolMarkers("organ", tools).message(1, [pose[None]] * len(names), tips, forces), MarkerArray
    )


def labels(server):
    """Of the checkboxes in the panel."""
    handles = server.gui._gui_input_handle_from_uuid.values()
    return [handle.label for handle in handles if "Poke" in str(handle.label)]


def test_the_tools_are_those_of_the_node_and_change_with_it(server, graph):
    view = ToolsView(server, graph, "tissue_sim", None, PATIENCE)
    view.update(0.0, [], None, "")
    assert labels(server) == []
    view.take(markers_of("arm", "needle"), 1.0)
    assert [tool.name for tool in view.views] == ["arm", "needle"]
    assert [tool.force for tool in view.views] == pytest.approx([0.5, 0.5])
    assert labels(server) == ["Poke with arm", "Poke with needle"]
    first = view.views[0]
    view.take(markers_of("arm", "needle"), 2.0)
    assert view.views[0] is first, "not made again for every message"
    view.take(markers_of("probe"), 3.0)
    assert labels(server) == ["Poke with probe"]
    view.update(3.1, [], None, "")
    view.take(None, 3.0 + SILENT_AFTER + 0.1)
    assert view.views[0].force is None
    view.close()


def test_only_those_named_are_shown(server, graph):
    view = ToolsView(server, graph, "tissue_sim", ("needle",), PATIENCE)
    view.take(markers_of("arm", "needle"), 1.0)
    assert [tool.name for tool in view.views] == ["needle"]
    assert view.views[0].force == pytest.approx(0.5)
    assert labels(server) == ["Poke with needle"]
    view.close()
