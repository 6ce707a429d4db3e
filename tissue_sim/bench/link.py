"""Surfaces that come through a link that loses packets, for `tissue_sim bench markers --loss`.

Node and a node that only sends as many bytes, 60 times a second, are at one end, who looks at both at the other.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tissue_sim.bench.printing import Bound, aligned, bound_lines, figure
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.probes.graph import NODE, Graph, ticks, told
from tissue_sim.ros.probes.lossy_link import lossy_link

DELAY = 0.05  # s, each way
RATE, LEAST_RATE = 60.0, 20.0  # Hz: that are sent, that are to come
SURFACES = {"node": f"/{NODE}/surface", "a node that only sends": "/sender/surface"}


def measure(organ_file: str, loss: float, seconds: float) -> dict[str, Any]:
    """Hz of surfaces behind a link that loses a share of the packets, while the organ swings.

    Raises UserError where there are no network namespaces, rclpy is missing, or the node fails.
    """
    with lossy_link(loss, DELAY) as ends, Graph("SUBNET") as graph, tempfile.TemporaryDirectory() as folder:
        from tissue_sim.ros.shared.messages import CloudTemplate

        here, there = (("ip", "netns", "exec", end) for end in ends)
        # Without damping it swings on when the tool is gone. Few ticks: a link is tried here, not the machine.
        settings = "damping_scale:=0.0", "integrator:=implicit", "rate:=100.0", f"marker_rate:={RATE}"
        served = graph.start_node(organ_file, *settings, within=here)
        ticks(served)
        told(graph.start("probes.hand", organ_file, within=here))
        message = Path(folder, "surface")
        message.write_bytes(CloudTemplate("organ", Organ.load(organ_file).n_surface, ("x", "y", "z")).message(0))
        sending = SURFACES["a node that only sends"]
        graph.start("probes.sender", sending, "surface", str(message), str(RATE), within=here)
        rates = json.loads(told(graph.start("probes.viewer", str(seconds), *SURFACES.values(), within=there)))
    return as_json(loss, {name: rates[topic] for name, topic in SURFACES.items()})


def as_json(loss: float, rates: Mapping[str, float]) -> dict[str, Any]:
    """Hz that come of the surfaces of each, and the bound that the node's are held against."""
    bound = Bound("surfaces behind the link", rates["node"], LEAST_RATE, "Hz", least=True)
    return {"loss": loss, "delay_s": DELAY, "sent_hz": RATE, "come_hz": dict(rates), "bounds": [bound.as_json()]}


def text(found: Mapping[str, Any]) -> str:
    """The figures as tables."""
    rates = found["come_hz"]
    rows = [["surfaces that come, of 60 Hz", "Hz", "node's to this"]]
    rows += [[name, f"{hz:.1f}", f"{figure(rates['node'] / hz)} x" if hz else "-"] for name, hz in rates.items()]
    head = f"a link that loses {100.0 * found['loss']:g} % of the packets and takes {1e3 * found['delay_s']:g} ms"
    return "\n".join([head, *aligned(rows), "", *bound_lines(found["bounds"])])
