"""Ticks of a running node around a cut, and delay of its answers: a hand presses over DDS while a service cuts."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.bare_loop import RATE
from tissue_sim.bench.cutting.cuts import CUTS, Cut, Place, placed
from tissue_sim.bench.cutting.organs import kidney
from tissue_sim.bench.printing import Bound, aligned, figure
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.organ.surfaces.sizing import mean_edge
from tissue_sim.ros.probes.graph import Graph, ticks
from tissue_sim.ros.shared.children import Child

if TYPE_CHECKING:
    from tissue_sim.ros.probes.cut_probe import CutPlace, Window

MOST_TICK, MOST_P99 = 1000.0, 250.0  # us
UNDISTURBED = 2.0  # s of pressing before each cut
WARMING_UP = 2.0  # s of pressing that aren't counted
BESIDE = 2.0  # mean edges from a cut to where the hand presses
WHEN = BEFORE, AROUND = "before", "around"


class CutInNode(NamedTuple):
    """Measurements around one cut."""

    cut: Cut
    before: Window
    around: Window


def measure(priority: int = 0) -> list[CutInNode]:
    """Return what was measured of the kidney's cuts in a running node.

    priority: real-time priority of the node's loop. Raises UserError when rclpy is not installed, the node does not
    start, does not cut or does not report.
    """
    organ, found = kidney(), list[CutInNode]()
    with Graph() as graph:
        from tissue_sim.ros.probes.cut_probe import CutProbe
        from tissue_sim.ros.probes.tool_driver import RADIUS

        served = served_by(graph, f"rate:={RATE}", f"realtime_priority:={priority}", f"left.radius:={RADIUS}")
        ticks(served)
        own = graph.client("cut_probe")
        hand = CutProbe(own, organ, RATE)
        hand.meet()
        cuts = [one for one in CUTS if one.organ == "kidney"]
        hand.press(beside(organ, placed(organ, cuts[0])))
        hand.hold(WARMING_UP)
        with progress.still(), rows.until_stopped():
            for cut in rows.each(cuts, "cuts in a node"):
                place = beside(organ, placed(organ, cut))
                hand.press(place)
                found.append(CutInNode(cut, hand.hold(UNDISTURBED), hand.cut(place)))
                rows.report(cut.name, f"longest tick {1e6 * longest(found[-1].around):.0f} us")
    return found


def served_by(graph: Graph, *parameters: str) -> Child:
    """Start a node that serves the kidney."""
    return graph.start_node(str(shipped_organ()), *parameters)


def beside(organ: Organ, place: Place) -> CutPlace:
    """Return a cut and where a hand presses beside it: some edges away, on the surface."""
    from tissue_sim.ros.probes.cut_probe import CutPlace

    edge = mean_edge(organ.surface_positions, organ.surface_triangles)
    wanted = place.middle - BESIDE * edge * place.across
    facing = np.ones(organ.n_surface, dtype=bool)
    facing[organ.fixed[organ.fixed < organ.n_surface]] = False
    nodes = np.flatnonzero(facing)
    touch = organ.surface_positions[nodes[np.argmin(np.linalg.norm(organ.surface_positions[nodes] - wanted, axis=1))]]
    sheet = place.sheet
    return CutPlace(sheet.polyline, sheet.direction, sheet.depth, touch, place.into)


def longest(window: Window) -> float:
    """Return the time, s, of the longest tick in the reports of a window."""
    return max(one.longest for one in window.reports[1:])


# telling -------------------------------------------------------------------------------------------


def as_json(found: list[CutInNode], priority: int = 0) -> JsonObject:
    """Return all figures and bounds.

    found: what was measured of each cut (nothing where the node was left out); priority: real-time priority of the
    node's loop.
    """
    table = [_row(one) for one in found]

    def worst(key: str) -> float | None:
        return max((row[f"{AROUND}_{key}"] for row in table), default=None)

    bounds = [
        Bound("longest tick of the node around a cut", worst("longest_us"), MOST_TICK, "us"),
        Bound("ticks of the node around a cut, p99 of the slowest second", worst("p99_us"), MOST_P99, "us"),
    ]
    return {"realtime_priority": priority, "rows": table, "bounds": [bound.as_json() for bound in bounds]}


def _row(one: CutInNode) -> JsonObject:
    """Return the figures of a cut."""
    row: JsonObject = {"cut": one.cut.name, "answer": one.around.answer, "took_ms": 1e3 * one.around.took}
    for name, window in zip(WHEN, (one.before, one.around), strict=True):
        first, *reports = window.reports
        row |= {
            f"{name}_ticks": reports[-1].tick - first.tick,
            f"{name}_late": reports[-1].late - first.late,
            f"{name}_dropped": reports[-1].dropped - first.dropped,
            f"{name}_p50_us": 1e6 * float(np.median([each.busy for each in reports])),
            f"{name}_p99_us": 1e6 * max(each.busy_p99 for each in reports),
            f"{name}_longest_us": 1e6 * longest(window),
            f"{name}_latest_us": 1e6 * max(each.latest for each in reports),
            f"{name}_substeps": max(each.substeps for each in reports),
            f"{name}_delay_us": _percentiles(window.delays),
        }
    return row


def _percentiles(delays: Floats) -> list[float]:
    """Return median, 99th percentile and the longest of delays, us."""
    return [1e6 * float(one) for one in np.percentile(delays, [50.0, 99.0, 100.0])]


def text(found: JsonObject) -> list[str]:
    """Return the figures as lines of a table."""
    if not found["rows"]:
        return ["ticks of a running node: left out, as rclpy is not installed (pip install 'tissue_sim[ros]')"]
    head = ["ticks of a node, us", "", "p50", "p99", "longest", "late by", "late", "ticks", "substeps"]
    table = [[*head, "answers p50", "p99", "longest", "service ms"]]
    for row in found["rows"]:
        for name in WHEN:
            cells = [figure(row[f"{name}_{key}_us"]) for key in ("p50", "p99", "longest", "latest")]
            counts = [str(row[f"{name}_{key}"]) for key in ("late", "ticks", "substeps")]
            answers = [figure(delay) for delay in row[f"{name}_delay_us"]]
            took = figure(row["took_ms"]) if name == AROUND else "-"
            table.append([row["cut"] if name == BEFORE else "", name, *cells, *counts, *answers, took])
    priority = found["realtime_priority"]
    return [
        "a running node at 1 kHz" + (f" with real-time priority {priority}" if priority else "") + ", in whose organ a"
        f" hand presses over DDS, {UNDISTURBED:g} s before each cut, and from before the service is called until after",
        "its answer; times by the clock, which the node reports once a second: p99 of the slowest one, late by more",
        "than a period; answers: from a pose to its wrench",
        *aligned(table, left=2),
    ]
