"""Benchmark `tissue_sim bench latency --busy`: haptic output and degradation beside a busy program on each core.

A hand pokes the organ once a second, with poses at the full rate: on a quiet machine, beside one busy program on each
core, and after that. A bare loop has its turn at the end of each, under the same load. All of it is done without a
real-time priority, and with one, which then the hand has too.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from tissue_sim import progress
from tissue_sim.bench import rows
from tissue_sim.bench.bare_loop import RATE, bare, late_bound, late_percent, name_of
from tissue_sim.bench.printing import Bound, aligned, bound_lines
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.probes.graph import NODE, Graph, ticks
from tissue_sim.ros.shared.children import Child
from tissue_sim.ros.shared.priority import below, is_allowed

if TYPE_CHECKING:
    from tissue_sim.ros.probes.poke_probe import PokeFigures, PokeProbe

PRIORITY = 20  # where none is given
PHASES = QUIET, BUSY, AFTER = "quiet", "busy", "quiet again"
SHORTEST = 4.0  # s of a phase
WARMING_UP = 3.0  # s of poking that aren't counted
BARE_TURN = 5.0  # s that the bare loop runs at once
BARE_FRACTION = 0.25  # fraction of a phase's time for the bare loop after it
LONGEST_BACK = 90.0  # s for the node to recover from degradation
MOST_OFF = 10.0  # %, largest difference of a poke's highest force from the undisturbed ones'
MOST_LACKING = 1.0  # % of the ticks
SPINNING = "while True: pass"


def measure(organ_file: str | None, seconds: float, priority: int = 0) -> JsonObject:
    """Return the figures of a node without a real-time priority and of one with it, with phases of `seconds` each.

    priority: of the second node's loop; 0 for PRIORITY. Where the system doesn't allow it, only the first is measured.
    Raises UserError when rclpy is not installed, a node does not start or report, or the time is too short.
    """
    if seconds < SHORTEST:
        raise UserError(f"--seconds {seconds:g} with --busy is less than {SHORTEST:g}")
    priority = priority or PRIORITY
    path = organ_file or str(shipped_organ())
    wanted = [0, priority] if is_allowed(priority) else [0]
    nodes: list[JsonObject] = []
    with rows.until_stopped():
        for one in rows.each(wanted, "nodes"):
            nodes.append({"realtime_priority": one, "seconds_until_back": None, "phases": {}})
            _measure_node(path, seconds, nodes[-1])
    nodes = [node for node in nodes if node["phases"]]
    return as_json(seconds, priority, nodes)


def _measure_node(path: str, seconds: float, node: JsonObject) -> None:
    """Fill in the phases of one node, each when it is over."""
    priority, phases = node["realtime_priority"], node["phases"]

    def phase(name: str) -> None:
        with progress.task(f"{name}, s", seconds) as poking:
            phases[name] = _phase(hand, seconds, priority, poking.advance)
        figures = phases[name]
        rows.report(
            f"{name_of(node)}, {name}",
            f"{figures['ticks_per_second']:.1f} ticks/s",
            f"{figures['late_percent']:.2f} % late",
        )

    with Graph() as graph:
        from tissue_sim.ros.probes.poke_probe import PokeProbe
        from tissue_sim.ros.probes.tool_driver import RADIUS

        settings = f"rate:={RATE}", f"realtime_priority:={priority}", "marker_rate:=60.0", f"left.radius:={RADIUS}"
        served = graph.start_node(path, *settings)
        graph.start("probes.marker_subscriber", NODE)
        ticks(served)
        own = graph.client("busy_probe")
        hand = PokeProbe(own, NODE, Organ.load(path), rate=RATE, priority=below(below(priority)))
        hand.meet()
        hand.poke(WARMING_UP)
        with progress.still(), progress.task("phases", len(PHASES)) as under_way:
            phase(QUIET)
            under_way.advance()
            with spinning():
                phase(BUSY)
            under_way.advance()
            with progress.task("until no longer degraded") as poking:
                node["seconds_until_back"] = hand.poke_until_whole(LONGEST_BACK, poking.advance)
            phase(AFTER)


@contextmanager
def spinning() -> Iterator[None]:
    """Run a busy program on each core while entered."""
    cores = len(os.sched_getaffinity(0))
    programs = [Child("spinning", [sys.executable, "-c", SPINNING], os.environ) for _ in range(cores)]
    try:
        yield
    finally:
        for program in programs:
            program.stop()


def _phase(hand: PokeProbe, seconds: float, priority: int, watch: Callable[[], object]) -> JsonObject:
    found = hand.poke(seconds, watch)
    turns = max(1, round(BARE_FRACTION * seconds / BARE_TURN))
    late = []
    for _ in range(turns):
        late.append(bare(BARE_FRACTION * seconds / turns, found.reports[-1].busy, priority))
        watch()
    bare_late = late_percent(np.concatenate(late))
    return phase_json(found, bare_late)


# telling -------------------------------------------------------------------------------------------


def phase_json(found: PokeFigures, bare_percent: float) -> JsonObject:
    """Return the figures of one phase: the node's between its first report and its last, and the forces."""
    first, last = found.reports[0], found.reports[-1]
    done, wall = last.tick - first.tick, last.seconds - first.seconds
    between = np.diff([report.seconds for report in found.reports])
    return {
        "peaks_n": found.peaks.tolist(),
        "longest_gap_ms": 1e3 * found.gap,
        "ticks_per_second": done / wall,
        "late_percent": 100.0 * (last.late - first.late) / max(1, done),
        "bare_late_percent": bare_percent,
        "dropped": last.dropped - first.dropped,
        "simulated_fraction": float(np.average([report.pace for report in found.reports[1:]], weights=between)),
        "degraded": sorted({report.degraded for report in found.reports} - {"none"}),
    }


def as_json(seconds: float, priority: int, nodes: list[JsonObject]) -> JsonObject:
    """Return all figures, and the bounds.

    nodes: of the one without a priority, and of the one with it if there was one; each with its phases.
    """
    bounds = []
    for node in nodes:
        phases, whose = node["phases"], name_of(node)
        if not (undisturbed := float(np.median(phases[QUIET]["peaks_n"]))) > 0.0:
            raise UserError("no poke had a force on the quiet machine; use an organ wider than 12 mm along x")
        for phase in phases.values():
            off = np.abs(np.array(phase["peaks_n"]) - undisturbed) / undisturbed
            phase["force_off_percent"] = 100.0 * float(off.max())
        busy, after = phases.get(BUSY), phases.get(AFTER)  # none where it was stopped before
        if busy:
            bounds.append(Bound(f"{whose}: worst poke, busy", busy["force_off_percent"], MOST_OFF, "%"))
        bounds += [
            Bound(
                f"{whose}: missing ticks, {name}", 100.0 * (1.0 - phase["ticks_per_second"] / RATE), MOST_LACKING, "%"
            )
            for name, phase in ((BUSY, busy), (AFTER, after))
            if phase and (name == AFTER or node["realtime_priority"])
        ]
        bounds.append(Bound(f"{whose}: until no longer degraded", node["seconds_until_back"], LONGEST_BACK, "s"))
        if after:
            usual = phases[QUIET]["late_percent"]
            bounds.append(late_bound(f"{whose}: late ticks, {AFTER}", after["late_percent"], usual))
        if busy and node["realtime_priority"]:
            bounds.append(late_bound(f"{whose}: late ticks, {BUSY}", busy["late_percent"], busy["bare_late_percent"]))
    if not any(node["realtime_priority"] for node in nodes):
        name = name_of({"realtime_priority": priority})
        bounds.append(Bound(f"{name}: missing ticks, {BUSY}", None, MOST_LACKING, "%"))
    return {
        "seconds": seconds,
        "rate_hz": RATE,
        "realtime_priority": priority,
        "programs": len(os.sched_getaffinity(0)),
        "nodes": nodes,
        "bounds": [bound.as_json() for bound in bounds],
    }


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    rows = [["node", "ticks/s", "late", "bare loop", "dropped", "simulated", "peak force", "worst", "longest gap"]]
    remarks = []
    for node in found["nodes"]:
        for name, phase in node["phases"].items():
            rows.append(
                [
                    f"{name_of(node)}, {name}",
                    f"{phase['ticks_per_second']:.1f}",
                    f"{phase['late_percent']:.2f} %",
                    f"{phase['bare_late_percent']:.2f} %",
                    f"{phase['dropped']}",
                    f"{100.0 * phase['simulated_fraction']:.2f} %",
                    f"{np.median(phase['peaks_n']):.3f} N",
                    f"{phase['force_off_percent']:.1f} %",
                    f"{phase['longest_gap_ms']:.1f} ms",
                ]
            )
        given_up = sorted({what for phase in node["phases"].values() for what in phase["degraded"]})
        if given_up:
            back = node["seconds_until_back"]
            after = "" if back is None else f"; no longer degraded {back:.0f} s after the load"
            remarks.append(f"{name_of(node)}: degraded: {', '.join(given_up)}{after}")
    if not any(node["realtime_priority"] for node in found["nodes"]):
        remarks.append(f"priority {found['realtime_priority']} was not measured: this user is not allowed it, see"
            " 'ulimit -r'")  # fmt: skip
    lines = [
        f"{found['seconds']:g} s each; a poke a second, poses at {found['rate_hz']:g} Hz, one subscriber of markers"
        f" at 60 Hz; busy: {found['programs']} programs that never sleep",
        *aligned(rows),
        *remarks,
        "late: by more than a period; worst: largest difference of a poke from the quiet ones; longest gap:"
        " between poses",
        "",
        *bound_lines(found["bounds"]),
    ]
    return "\n".join(lines)
