"""Option `tissue_sim view --layout`: the layouts that ship for RViz and Foxglove, adapted to a node."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence

from tissue_sim import progress
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.shipped import shipped_file

LAYOUTS = {"rviz": "config/tissue_sim.rviz", "foxglove": "config/foxglove.json"}
WAIT = 15.0  # s for the node to answer with its parameters
# Names in the layouts that ship.
NODE, FRAME = "tissue_sim", "organ"
DISPLAY = "    - Class: "  # begins a display of RViz
TOOLS = {"left": "/left/servo_cf", "right": "/right/servo_cf"}


def fitted(
    kind: str, node: str, frame_id: str = FRAME, tools: Mapping[str, str] = TOOLS, organs: Sequence[str] = ()
) -> str:
    """Return the text of a layout, of LAYOUTS, for a node.

    kind: name of the layout; node: its name with its namespace; frame_id: frame of the organ; tools: absolute topic of
    each tool's wrenches; organs: names of a scene's organs (empty for a single one). Raises UserError when the layout
    isn't installed.
    """
    path = shipped_file(LAYOUTS[kind])
    if path is None:
        raise UserError(f"{LAYOUTS[kind]} is missing; reinstall tissue_sim")
    text = path.read_text(encoding="utf-8").replace(f"/{NODE}/", f"/{node}/")
    surfaces = {organ: f"/{node}/{organ}/surface" for organ in organs}
    return (_rviz if kind == "rviz" else _foxglove)(text, frame_id, tools, f"/{node}/surface", surfaces)


def write(kind: str, node: str) -> int:
    """Print a layout that fits a node as it answers now, or with its defaults; return 0.

    kind: name of the layout, of LAYOUTS.
    """
    from tissue_sim.ros.shared.node_parameters import parameters_of

    with progress.task(f"waiting for /{node}"):
        values = parameters_of(node, "layout", WAIT)
    namespace = f"/{node}".rpartition("/")[0]
    if values is None:
        sys.stderr.write(f"/{node} doesn't answer: frame {FRAME} and tools {', '.join(TOOLS)} are assumed\n")
        print(fitted(kind, node, tools={tool: namespace + topic for tool, topic in TOOLS.items()}), end="")
        return 0
    given = {tool: _link_line(values, tool, node) for tool in values["tools"]}
    absolute = {tool: topic if topic.startswith("/") else f"{namespace}/{topic}" for tool, topic in given.items()}
    print(fitted(kind, node, values["frame_id"], absolute, list(values["organs"])), end="")
    return 0


def _link_line(values: JsonObject, tool: str, node: str) -> str:
    """Return the topic of a tool's wrenches."""
    from tissue_sim.ros.shared.tool_link import ToolLink

    link = ToolLink.from_parameters(values, tool, node)
    assert link is not None  # it is among the node's tools
    return link.topics.names["servo_cf"]


def _rviz(text: str, frame_id: str, tools: Mapping[str, str], surface: str, surfaces: Mapping[str, str]) -> str:
    for line in ("Fixed Frame", "Target Frame"):
        text = text.replace(f"{line}: {FRAME}\n", f"{line}: {frame_id}\n")
    before = "".join(f"        {tool}: true\n" for tool in TOOLS)
    text = text.replace(before, "".join(f"        {tool}: true\n" for tool in tools))
    if surfaces:
        parts = [f"{organ}/{part}" for organ in surfaces for part in ("skeleton", "surface")]
        before = "".join(f"        {part}: true\n" for part in ("skeleton", "surface"))
        text = text.replace(before, "".join(f"        {part}: true\n" for part in parts))
        display = _display(text, "Surface")
        text = text.replace(
            display, "".join(_of_organ(display, organ, surface, topic) for organ, topic in surfaces.items())
        )
    return text


def _display(text: str, name: str) -> str:
    """Return the lines of one display."""
    begin = text.rindex(DISPLAY, 0, text.index(f"      Name: {name}\n"))
    return text[begin : text.index(DISPLAY, begin + 1)]


def _of_organ(display: str, organ: str, surface: str, topic: str) -> str:
    """Return the display of a surface, adapted to that of an organ."""
    return display.replace("Name: Surface", f"Name: Surface of {organ}").replace(surface, topic)


def _foxglove(text: str, frame_id: str, tools: Mapping[str, str], surface: str, surfaces: Mapping[str, str]) -> str:
    layout = json.loads(text)
    panels = layout["configById"]
    panels["3D!organ"]["followTf"] = frame_id
    plot = panels["Plot!force"]
    like = plot["paths"][0]
    plot["paths"] = [
        like | {"value": f"{topic}.wrench.force.@norm", "label": f"{tool}, N"} for tool, topic in tools.items()
    ]
    if surfaces:
        topics = panels["3D!organ"]["topics"]
        like = topics.pop(surface)
        topics |= dict.fromkeys(surfaces.values(), like)
    return json.dumps(layout, indent=2) + "\n"
