"""Rate at which messages arrive, for `tissue_sim bench markers`: behind a lossy link, or of a large organ.

The comparison is a node without an organ that sends as many bytes as often, at the same end and in the same run.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path

from tissue_sim.bench.organs import bean
from tissue_sim.bench.printing import Bound, aligned, bound_lines, figure
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.probes.graph import NODE, Graph, last_line, ticks
from tissue_sim.ros.probes.lossy_link import lossy_link

DELAY = 0.05  # s, each way
LINK_RATE, LINK_LEAST = 60.0, 20.0  # Hz behind the link: that are sent, that are to arrive
LARGE_RATE, LARGE_LEAST = 20.0, 5.0  # Hz of a large organ
SENDER = "sender"
UNDAMPED = "damping_scale:=0.0"  # it keeps moving when the tool is gone


def behind_link(organ_file: str, loss: float, seconds: float) -> JsonObject:
    """Return the rates of surfaces, Hz, behind a link that loses a fraction of the packets.

    loss: fraction of the packets. Raises UserError where there are no network namespaces, rclpy is missing, or the node
    fails.
    """
    with lossy_link(loss, DELAY) as ends, Graph("SUBNET") as graph, tempfile.TemporaryDirectory() as folder:
        from tissue_sim.ros.shared.messages import CloudTemplate

        here, there = (("ip", "netns", "exec", end) for end in ends)
        # Few ticks, because the link is measured here and not the machine.
        settings = UNDAMPED, "rate:=100.0", f"marker_rate:={LINK_RATE}"
        ticks(graph.start_node(organ_file, *settings, within=here))
        last_line(graph.start("probes.tool_driver", organ_file, within=here))
        message = Path(folder, "surface")
        message.write_bytes(CloudTemplate("organ", Organ.load(organ_file).n_surface, ("x", "y", "z")).message(0))
        graph.start("probes.sender", f"/{SENDER}/surface", "surface", str(message), str(LINK_RATE), within=here)
        topics = f"/{NODE}/surface", f"/{SENDER}/surface"
        rates = json.loads(last_line(graph.start("probes.viewer", str(seconds), *topics, within=there)))
    about = (
        f"a link that loses {100.0 * loss:g} % of the packets and delays by {1e3 * DELAY:g} ms; {LINK_RATE:g} Hz"
        " are sent"
    )
    return as_json(about, rates, LINK_LEAST)


def of_large_organ(points: int, seconds: float) -> JsonObject:
    """Return the rates of markers and surfaces, Hz, of a large organ.

    points: number of surface points. Raises UserError as in `behind_link`.
    """
    with Graph() as graph, tempfile.TemporaryDirectory() as folder:
        from tissue_sim.ros.probes.viewer import Viewer

        organ_file = str(Path(folder, "bean.npz"))
        bean(points).save(organ_file)
        # Soft tissue needs fewer substeps, because the sending is measured here.
        settings = UNDAMPED, "stiffness_scale:=0.02", f"marker_rate:={LARGE_RATE}"
        ticks(graph.start_node(organ_file, *settings))
        last_line(graph.start("probes.tool_driver", organ_file))
        own = graph.client("bench")
        topics = {kind: f"/{NODE}/{kind}" for kind in ("markers", "surface")}
        with Viewer(own, *topics.values()) as viewer:
            viewer.wait()
        for kind, topic in topics.items():
            message = Path(folder, kind)
            message.write_bytes(viewer.newest[topic])
            graph.start("probes.sender", f"/{SENDER}/{kind}", kind, str(message), str(LARGE_RATE))
        with Viewer(own, *topics.values(), *(f"/{SENDER}/{kind}" for kind in topics)) as viewer:
            viewer.wait()
            viewer.look(seconds)
        rates = {topic: count / seconds for topic, count in viewer.count.items()}
    return as_json(f"an organ of {points} points; {LARGE_RATE:g} Hz are sent", rates, LARGE_LEAST)


def as_json(about: str, rates: Mapping[str, float], least: float) -> JsonObject:
    """Return the rates by topic, of the node and of the sender beside it, and the bounds of the node's."""
    own = {topic.rpartition("/")[2]: hz for topic, hz in rates.items() if topic.startswith(f"/{NODE}/")}
    rows = {kind: {"node_hz": hz, "sender_hz": rates[f"/{SENDER}/{kind}"]} for kind, hz in own.items()}
    bounds = [Bound(f"arriving: {kind}", hz, least, "Hz", least=True).as_json() for kind, hz in own.items()]
    return {"about": about, "arriving": rows, "bounds": bounds}


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    rows = [["Hz that arrive", "node", "a node that only publishes", "ratio"]]
    for kind, one in found["arriving"].items():
        ratio = f"{figure(one['node_hz'] / one['sender_hz'])} x" if one["sender_hz"] else "-"
        rows.append([kind, f"{one['node_hz']:.1f}", f"{one['sender_hz']:.1f}", ratio])
    return "\n".join([found["about"], *aligned(rows), "", *bound_lines(found["bounds"])])
