"""Benchmark `tissue_sim bench latency`: from a pose to the first wrench computed with it, and late ticks.

A tool in contact goes deeper by a fraction of a millimetre in a stream of poses, and the benchmark takes the time until
the force has changed: a wrench that comes sooner says nothing about the pose. What smoothing between slow poses adds to
that is counted in ticks (`smoothing`). Beside that an echo node sends each pose back, on the same kind of executor, and
a bare loop sleeps and is busy for as long as a tick. They take turns of a few seconds, so that other load of the
machine affects all of them.
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.bench import latency_busy, rows, smoothing
from tissue_sim.bench.arguments import add_priority, add_shared, check_priority
from tissue_sim.bench.bare_loop import RATE, bare, late_bound, late_percent
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.probes.graph import NODE, Graph, ticks
from tissue_sim.ros.shared.priority import below

if TYPE_CHECKING:
    from tissue_sim.ros.probes.probe import Trip

TURN = 5.0  # s of each one's turn
# Limits of p50 and p99, us, by the rate of poses, Hz.
MOST = {1000.0: (450.0, 1000.0), 500.0: (450.0, 1000.0), 100.0: (600.0, None), 30.0: (600.0, None)}
RATES = tuple(MOST)
WOKEN = "any wrench, node napping", "echo after an equally long pause"
MOST_OF_ECHO, TICKS_BEYOND = 1.5, 1.0  # bound of the answer that ends a nap: factor of the echo's, and further ticks


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, seconds=60.0, check=True)
    add_priority(parser)
    parser.add_argument(
        "--busy",
        action="store_true",
        help="with a busy program on each core: haptic output and degradation of the node, without a real-time"
        f" priority and with one (default: {latency_busy.PRIORITY})",
    )


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    mode = latency_busy if args.busy else sys.modules[__name__]
    found = mode.measure(args.organ, args.seconds, args.realtime_priority)
    return Result(found, mode.text(found))


# measuring -----------------------------------------------------------------------------------------


def measure(organ_file: str | None, seconds: float, priority: int = 0) -> JsonObject:
    """Return the figures of the node, the echo and the bare loop, measured for `seconds` each.

    priority: real-time priority of the node's loop and of the bare one; echo and node answer with the one below. Raises
    UserError when rclpy is not installed, the node doesn't start, or the system doesn't allow the priority.
    """
    check_priority(priority)
    path = organ_file or str(shipped_organ())
    organ = Organ.load(path)
    with Graph() as graph:
        from tissue_sim.ros.probes.probe import Probe, together
        from tissue_sim.ros.probes.tool_driver import RADIUS

        settings = f"rate:={RATE}", f"realtime_priority:={priority}", "marker_rate:=60.0", f"left.radius:={RADIUS}"
        served = graph.start_node(path, *settings)
        graph.start("probes.echo", str(below(priority)))
        graph.start("probes.marker_subscriber", NODE)
        ticks(served)
        own = graph.client("latency_probe")
        probe = Probe(own, NODE, organ, RATE)
        probe.meet()
        turns = max(1, round(seconds / TURN))
        trips: dict[str, list[Trip]] = {name: [] for name in names()}
        done, late, busy = 0.0, 0.0, 0.0
        bare_late: list[Floats] = []
        with progress.still(), rows.until_stopped():
            for number in rows.each(range(turns), "turns"):
                turn: dict[str, Trip] = {}
                with progress.task("measurements", 2 * len(RATES) + 2) as under_way:
                    probe.approach()
                    before = probe.report()
                    for rate in RATES:
                        turn[wrench_row_name(rate)] = probe.changes(seconds / turns, rate)
                        under_way.advance()
                    after = probe.report()
                    busy = after["tick_p50_us"]
                    for rate in RATES:
                        turn[echo_at(rate)] = probe.echoes(seconds / turns / len(RATES), rate)
                        under_way.advance()
                    turn |= zip(WOKEN, probe.wakes(0.2 * seconds / turns), strict=True)
                    under_way.advance()
                    bare_late.append(bare(seconds / turns, 1e-6 * busy, priority))
                # A turn counts as a whole.
                done += after["tick"] - before["tick"]
                late += after["overruns"] - before["overruns"]
                for name, trip in turn.items():
                    trips[name].append(trip)
                p50 = turn[wrench_row_name(RATES[0])].as_json()["p50_us"]
                rows.report(f"turn {number + 1}", f"{wrench_row_name(RATES[0])}: p50 {p50:.0f} us")
        percentiles = {name: together(parts).as_json() for name, parts in trips.items()}
        found = as_json(seconds, percentiles, (done, late), np.concatenate(bare_late), busy)
        smoothed = [] if rows.stopped() else smoothing.as_json(smoothing.measure(organ))
        return {"realtime_priority": priority, **found, "smoothing": smoothed}


def wrench_row_name(rate: float) -> str:
    """Return the name of trips to the node at a pose rate, Hz."""
    return f"wrench, poses at {rate:g} Hz"


def echo_at(rate: float) -> str:
    """Return the name of trips to the echo at a pose rate, Hz."""
    return f"echo, {rate:g} Hz"


def names() -> list[str]:
    """Return the names of all trips."""
    return [name for rate in RATES for name in (wrench_row_name(rate), echo_at(rate))] + [*WOKEN]


# reporting -------------------------------------------------------------------------------------------


def as_json(
    seconds: float, trips: dict[str, dict[str, float]], ticks: tuple[float, float], bare_late: Floats, busy: float
) -> JsonObject:
    """Return all figures, and the bounds.

    trips: those of `names`, as Trip.as_json has them; ticks: number of the node's ticks, and of late ones; bare_late:
    lateness of the bare loop's ticks, s; busy: us of each.
    """
    period, (done, late) = 1.0 / RATE, ticks
    percents = 100.0 * late / max(1.0, done), late_percent(bare_late)
    ticks_beyond = TICKS_BEYOND * 1e6 * period
    woken, echo_woken = (trips[name] for name in WOKEN)
    delays = [
        Bound(f"{wrench_row_name(rate)}, {name}", trips[wrench_row_name(rate)][f"{name}_us"], most, "us")
        for rate in RATES
        for name, most in zip(("p50", "p99"), MOST[rate], strict=True)
        if most is not None
    ]
    bounds = [
        *delays,
        Bound("that ends a nap, p50", woken["p50_us"], MOST_OF_ECHO * echo_woken["p50_us"] + ticks_beyond, "us"),
        late_bound("ticks late by more than a period", *percents),
    ]
    return {
        "seconds": seconds,
        "rate_hz": RATE,
        "round_trips": trips,
        "late": {"node_percent": percents[0], "bare_percent": percents[1], "ticks": done, "busy_us": busy},
        "bounds": [bound.as_json() for bound in bounds],
    }


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    table = [["from a pose, us", "p50", "p99", "p99.9", "trips", "lost"]]
    for name, trip in found["round_trips"].items():
        table.append([name, *(f"{trip[key]:.0f}" for key in ("p50_us", "p99_us", "p99_9_us", "trips", "lost"))])
    late, priority = found["late"], found["realtime_priority"]
    urgent = f"; with real-time priority {priority} and {below(priority)}" if priority else ""
    lines = [
        f"{found['seconds']:g} s each in turn; a tool in contact, ticks at {found['rate_hz']:g} Hz, one subscriber"
        f" of markers at 60 Hz{urgent}; wrench: the first one that was computed with the pose",
        *aligned(table),
        "",
        "in ticks, smoothing between poses:",
        *aligned(smoothing.table(found["smoothing"])),
        "",
        f"ticks late by more than a period: node {late['node_percent']:.2f} %, a bare loop as busy"
        f" ({late['busy_us']:.0f} us) {late['bare_percent']:.2f} %",
        "",
        *bound_lines(found["bounds"]),
    ]
    return "\n".join(lines)
