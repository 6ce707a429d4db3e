"""Benchmark `tissue_sim bench idle`: cost of a node that serves an organ at rest to a viewer, and its latency.

Beside it, at the same time: a node without an organ that sends as many bytes as often as the idle node checks whether
anything moved, and a bare loop that only wakes that often.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from tissue_sim import progress
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines, figure
from tissue_sim.bench.processor_load import processor_load_during, processor_seconds
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.probes.graph import NODE, Graph, ticks

TURN = 2.0  # s of one measurement
RATE = 20.0  # Hz, at which an idle node checks whether anything moved
MOST, MOST_TO_SEE = 3.0, 4.0  # % of a core; s until a late viewer has the organ
SERVED, SENDING, BARE = "node with a viewer", "a node that only publishes", "a bare loop"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, seconds=20.0, check=True)


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    found = measure(args.organ or str(shipped_organ()), args.seconds)
    return Result(found, text(found))


def measure(organ_file: str, seconds: float) -> JsonObject:
    """Return the processor use of node and peers in turns of TURN. Raises UserError where the node can't run."""
    with Graph() as graph, tempfile.TemporaryDirectory() as folder:
        from tissue_sim.ros.probes.viewer import Viewer

        served = graph.start_node(organ_file)
        ticks(served)
        own = graph.client("bench")
        organ = [f"/{NODE}/{name}" for name in ("mesh", "markers", "surface")]
        with Viewer(own, *organ) as viewer:
            viewer.wait()  # the first one; DDS brings the processes together meanwhile
        with Viewer(own, *organ) as viewer:
            seen_after = viewer.wait()
            surface = Path(folder, "surface")
            surface.write_bytes(viewer.newest[f"/{NODE}/surface"])
            children = {
                SERVED: served,
                SENDING: graph.start("probes.sender", "/sender/surface", "surface", str(surface), str(RATE)),
                BARE: graph.start("probes.idle_loop", str(RATE)),
            }
            graph.enter_context(Viewer(own, "/sender/surface")).wait()
            graph.enter_context(Viewer(own, "/diagnostics", "/left/servo_cf"))
            spent = {name: partial(processor_seconds, child.pid) for name, child in children.items()}
            turns = []
            with progress.still(), rows.until_stopped():
                for turn in rows.each(range(max(1, round(seconds / TURN))), "turns"):
                    turns.append(processor_load_during(spent, partial(viewer.look, TURN)))
                    rows.report(
                        f"turn {turn + 1}", *(f"{name} {fraction:.2f} %" for name, fraction in turns[-1].items())
                    )
    return as_json(turns, seen_after)


def as_json(turns: Sequence[Mapping[str, float]], seen_after: float) -> JsonObject:
    """Return percent of a core in every turn, and s until a viewer had the organ, as figures and bounds.

    A machine under load makes every waking more expensive, so that the least of the turns is compared with the bound.
    """
    percents = {name: [turn[name] for turn in turns] for name in turns[0]}
    bounds = [
        Bound("idle node with a viewer, smallest of the turns", min(percents[SERVED]), MOST, "% of a core"),
        Bound("time until a late viewer has the organ", seen_after, MOST_TO_SEE, "s"),
    ]
    return {
        "processor_load_percent": {
            name: {"least": min(of), "median": float(np.median(of)), "most": max(of)} for name, of in percents.items()
        },
        "seen_after_s": seen_after,
        "bounds": [bound.as_json() for bound in bounds],
    }


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    percents = found["processor_load_percent"]
    table = [["% of a core", "least", "median", "most", "node's median relative to this"]]
    for name, of in percents.items():
        ratio = figure(percents[SERVED]["median"] / of["median"]) if of["median"] else "-"
        table.append([name, *(f"{of[key]:.2f}" for key in ("least", "median", "most")), f"{ratio} x"])
    return "\n".join([*aligned(table), "", *bound_lines(found["bounds"])])
