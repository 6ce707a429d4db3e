"""Benchmark `tissue_sim bench markers`: the cost of showing an organ in motion, plain and coloured.

It measures processor time of the node beside its loop with one subscriber of the markers, minus that without one, in
turns; and that of a node without an organ that sends the same bytes as often, in the same turns. With --loss or
--points it counts instead what arrives behind a link that loses packets, or of a large organ.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissue_sim import progress
from tissue_sim.bench import message_rate as arriving
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines, figure
from tissue_sim.bench.processor_load import processor_load_during, processor_seconds
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.probes.graph import NODE, Graph, ticks

if TYPE_CHECKING:
    from tissue_sim.ros.probes.viewer import Viewer

RATE = 60.0  # Hz, of the markers
TURN = 4.0  # s that is measured at once, with a subscriber or without
COLOURS = {"plain": "none", "coloured": "displacement"}
SERVED, SENDING = "node", "a node that only publishes"
SETTLING = 1.0  # s for a subscriber to be there
MARKERS = {SERVED: f"/{NODE}/markers", SENDING: "/sender/markers"}
MOST, LEAST_RATE = 3.0, 50.0  # % of a core, Hz


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, seconds=48.0, check=True)
    instead = parser.add_mutually_exclusive_group()
    instead.add_argument(
        "--loss",
        type=float,
        help="instead, count surfaces that pass a link that loses this fraction of the packets (Linux, root)",
    )
    instead.add_argument(
        "--points", type=int, help="instead, count markers and surfaces of an organ with this number of points"
    )


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    path = args.organ or str(shipped_organ())
    if not 0.0 <= (args.loss or 0.0) <= 0.5:
        raise UserError(f"--loss {args.loss:g} is outside 0..0.5")
    if args.points is not None and not 100 <= args.points <= 100_000:
        raise UserError(f"--points {args.points} is outside 100..100000")
    if args.loss is None and args.points is None:
        found = as_json(measure_colours(path, args.seconds))
        return Result(found, text(found))
    if args.loss is not None:
        found = arriving.behind_link(path, args.loss, args.seconds)
    else:
        found = arriving.of_large_organ(args.points, args.seconds)
    return Result(found, arriving.text(found))


def measure_colours(organ_file: str, seconds: float) -> dict[str, list[dict[str, dict[str, float]]]]:
    """Return the turns of each colouring, as `measure` has them; only those that have any."""
    found = {}
    with rows.until_stopped():
        for name, colour in rows.each(COLOURS.items(), "colourings"):
            if turns := measure(organ_file, colour, seconds):
                found[name] = turns
    return found


def measure(organ_file: str, colour: str, seconds: float) -> list[dict[str, dict[str, float]]]:
    """Return for every turn the percent of a core that node and peer take for a subscriber, and their rates, Hz.

    Raises UserError when rclpy is missing or the node fails.
    """
    organ = Organ.load(organ_file)
    with Graph() as graph, tempfile.TemporaryDirectory() as folder:
        from tissue_sim.ros.probes.tool_driver import RADIUS, Hand
        from tissue_sim.ros.probes.viewer import Viewer

        # Without damping it oscillates on after its release, so that no pose and no contact adds noise.
        # Ticks must rarely be late, because a node that falls behind slows its markers.
        settings = (
            "damping_scale:=0.0",
            "rate:=100.0",
            f"marker_colour:={colour}",
            f"marker_rate:={RATE}",
            f"left.radius:={RADIUS}",
        )
        served = graph.start_node(organ_file, *settings)
        ticks(served)
        own = graph.client("bench")
        hand = Hand(own, organ)
        hand.meet()
        hand.approach()
        with Viewer(own, MARKERS[SERVED]) as viewer:
            viewer.wait()
            message = Path(folder, "markers")
            message.write_bytes(viewer.newest[MARKERS[SERVED]])
        sender = graph.start("probes.sender", MARKERS[SENDING], "markers", str(message), str(RATE))
        both = Viewer(own, *MARKERS.values())
        with both:
            both.wait()
        time.sleep(1.0)  # until the poses are stale, the tool is forgotten, and there are no subscribers yet
        spent = {
            SERVED: partial(processor_seconds, served.pid, busiest=False),
            SENDING: partial(processor_seconds, sender.pid),
        }
        turns = range(max(1, round(0.5 * seconds / TURN)))
        found = []
        with progress.still(), rows.until_stopped():
            for number in rows.each(turns, f"turns, {colour}"):
                found.append(turn(spent, both))
                loads = (f"{name} {one['percent']:.2f} % at {one['hz']:.0f} Hz" for name, one in found[-1].items())
                rows.report(f"turn {number + 1}, {colour}", *loads)
        return found


def turn(spent: Mapping[str, Callable[[], float]], both: Viewer) -> dict[str, dict[str, float]]:
    """Return what a subscriber adds to node and peer, percent of a core, and the Hz that it gets."""
    without = processor_load_during(spent, partial(time.sleep, TURN))
    with both:
        both.look(SETTLING)
        with_viewer = processor_load_during(spent, partial(both.look, TURN))
    rate = {name: both.count[topic] / TURN for name, topic in MARKERS.items()}
    return {name: {"percent": with_viewer[name] - without[name], "hz": rate[name]} for name in spent}


# telling -------------------------------------------------------------------------------------------


def as_json(turns: Mapping[str, Sequence[Mapping[str, Mapping[str, float]]]]) -> JsonObject:
    """Return medians of the turns of each colouring, and the bounds.

    A node that falls behind rightly slows its markers: the cost of one is reported, and that at the requested rate.
    """
    table, bounds = [], []
    for colouring, measured in turns.items():
        row: JsonObject = {"colouring": colouring, "turns": len(measured)}
        for name in MARKERS:
            percent, hz = (float(np.median([one[name][key] for one in measured])) for key in ("percent", "hz"))
            each = 0.01 * percent / max(hz, 1.0)
            row[name] = {"percent": percent, "hz": hz, "us_each": 1e6 * each, "percent_at_rate": 100.0 * each * RATE}
        table.append(row)
        bounds += [
            Bound(f"{colouring} markers at {RATE:g} Hz", row[SERVED]["percent_at_rate"], MOST, "% of a core"),
            Bound(f"{colouring} markers that arrive", row[SERVED]["hz"], LEAST_RATE, "Hz", least=True),
        ]
    return {"rows": table, "bounds": [bound.as_json() for bound in bounds]}


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    table = [["for each further subscriber", "", "% of a core", "Hz", "us each", "node's relative to this"]]
    for row in found["rows"]:
        for name in MARKERS:
            one = row[name]
            ratio = f"{figure(row[SERVED]['us_each'] / one['us_each'])} x" if one["us_each"] > 0.0 else "-"
            cells = f"{one['percent']:.2f}", f"{one['hz']:.0f}", f"{one['us_each']:.0f}", ratio
            table.append([f"{row['colouring']} markers", name, *cells])
    return "\n".join([*aligned(table, left=2), "", *bound_lines(found["bounds"])])
