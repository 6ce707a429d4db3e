"""Benchmark `tissue_sim bench soak`: a node that is used for a long time.

A node at 1 kHz has two tools that the scripted bridge moves, a subscriber of the markers, and a bag. Every second its
memory and the lateness of its ticks are noted; a bare loop runs beside it in turns. At the end the tools leave, and the
organ's shape at rest is compared with that before the first touch; the bag is closed and read.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_priority, add_shared, check_priority
from tissue_sim.bench.bare_loop import RATE, bare, late_bound, late_percent
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.bench.soak_bag import BagFound, read_bag
from tissue_sim.bench.soak_plot import drawn
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.probes.graph import NODE, Graph, ticks
from tissue_sim.ros.probes.soak_monitor import Sample, Watch
from tissue_sim.ros.shared.children import Child

SHORTEST, LONGEST = 0.1, 1440.0  # min
WINDOW = 60.0  # s at the beginning and the end whose memory is compared; the first begins after one of warming up
TURN, PAUSE = 4.0, 16.0  # s that the bare loop runs, and rests
LEAST_SAMPLES = 2  # least number of samples
MOST_DRIFT, MOST_GROWTH = 1e-6, 1.0  # m, MB


class Soaked(NamedTuple):
    """What was seen of a node that was used for a long time."""

    organ: str  # its name
    minutes: float
    priority: int  # real-time priority of the node's loop and of the bare one
    samples: Sequence[Sample]
    turns: Sequence[tuple[float, Floats]]  # of the bare loop: when each began, s, and how late its ticks were, s
    drift: float  # m, of the shape at rest
    clamp: float  # N, the largest force that the node may publish
    bag: BagFound
    problems: dict[str, int]  # counters of the diagnostics that are not 0
    failures: Sequence[str]  # what the diagnostics called an error
    repeats: bool | None  # whether a replay shows what the bag does; None where it was not replayed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, out="folder for a plot of memory and lateness over time", check=True)
    parser.add_argument("--minutes", type=float, default=30.0, help="duration, minutes")
    add_priority(parser)
    parser.add_argument("--bag-folder", metavar="DIR", help="folder for the bag (default: it is deleted)")
    parser.add_argument(
        "--replay", action="store_true", help="also replay the bag, tick by tick; needs memory for the whole bag"
    )


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    if not SHORTEST <= args.minutes <= LONGEST:
        raise UserError(f"--minutes {args.minutes:g} is outside {SHORTEST:g}..{LONGEST:g}")
    with tempfile.TemporaryDirectory(prefix="tissue_sim-soak-") as folder:
        bag_folder = Path(args.bag_folder or folder).absolute()
        found = as_json(measure(args.organ, args.minutes, bag_folder, args.realtime_priority, replays=args.replay))
    return Result(found, text(found), {} if rows.stopped() else {"soak.png": partial(drawn, found)})


# measuring -----------------------------------------------------------------------------------------


def measure(
    organ_file: str | None, minutes: float, folder: Path, priority: int = 0, *, replays: bool = False
) -> Soaked:
    """Use a node for so many minutes, with its bag in a folder, and look at it meanwhile and at the end.

    priority: real-time priority of the node's loop and of the bare one. Raises UserError when rclpy is not installed,
    the system allows no such priority, the node does not start or ends, or the bag can't be read.
    """
    check_priority(priority)
    path = organ_file or str(shipped_organ())
    organ = Organ.load(path)
    with Graph() as graph:
        parameters = f"rate:={RATE}", f"realtime_priority:={priority}", "marker_rate:=60.0"
        served = graph.start_node(path, *parameters, "record:=true", f"record_folder:={folder}")
        graph.start("probes.marker_subscriber", NODE)
        ticks(served)
        own = graph.client("soak")
        watch = Watch(own, NODE, served.pid)
        before = watch.at_rest()
        clamp = watch.force_clamp()
        bridge = _bridge()
        graph.callback(bridge.stop)
        samples, turns = _soak(watch, served, bridge, 60.0 * minutes, priority)
        bridge.stop()
        drift = float(np.abs(watch.at_rest() - before).max())
        bag = watch.close_bag()
        watch.values = {}
        watch.sample()  # the last counters
        problems, failures = watch.problems(), watch.failures
        served.stop()
        if served.exit_code != 0:
            raise UserError(f"the node did not shut down properly: {served.last_words()}")
    return Soaked(
        organ=organ.name,
        minutes=round((samples[-1].seconds - samples[0].seconds) / 60.0, 2) if rows.stopped() else minutes,
        priority=priority,
        samples=samples,
        turns=turns,
        drift=drift,
        clamp=clamp,
        bag=read_bag(bag),
        problems=problems,
        failures=failures,
        repeats=_repeats(bag) if replays and not rows.stopped() else None,
    )


def _soak(
    watch: Watch, served: Child, bridge: Child, seconds: float, priority: int
) -> tuple[list[Sample], list[tuple[float, Floats]]]:
    """Watch the node every second; return that, and when each turn of the bare loop began and how late it was."""
    samples: list[Sample] = []
    turns: list[tuple[float, Future[Floats]]] = []
    turn, pause = min(TURN, 0.25 * seconds), min(PAUSE, 0.25 * seconds)
    began = next_turn = time.monotonic()
    with (
        ThreadPoolExecutor(1, "bare") as bare_loop,
        progress.still(),
        rows.until_stopped(),
        progress.task("seconds", round(seconds)) as under_way,
    ):
        for second in range(1, max(2, round(seconds)) + 1):
            time.sleep(max(0.0, began + second - time.monotonic()))
            _check_alive(served, bridge)
            samples.append(watch.sample())
            now = time.monotonic()
            if now >= next_turn and now + turn < began + seconds:
                busy = 1e-6 * float(watch.values["tick_p50_us"])
                turns.append((samples[-1].seconds, bare_loop.submit(bare, turn, busy, priority)))
                next_turn = now + turn + pause
            if len(samples) == LEAST_SAMPLES:
                rows.keep()
            if second % 60 == 0:
                rows.report(
                    f"minute {second // 60}", f"{samples[-1].megabytes:.2f} MB", f"{samples[-1].late} late ticks"
                )
            under_way.advance()
    return samples, [(at, made.result()) for at, made in turns]


def _check_alive(*children: Child) -> None:
    for child in children:
        if child.exit_code is not None:
            raise UserError(f"the {child.name} ended too early: {child.last_words()}")


def _bridge() -> Child:
    """Return the bridge that moves two tools."""
    words = [sys.executable, "-m", "tissue_sim", "bridge", "--rate", f"{RATE:g}"]
    return Child("bridge", words, os.environ)


def _repeats(bag: Path) -> bool:
    """Return whether a replay agrees with the bag."""
    from tissue_sim.ros.bags.outcome import Asked, replay_bag

    return bool(replay_bag(bag, Asked(1e-6, 1e-6, None)).comparison.passes)


# telling -------------------------------------------------------------------------------------------


def memory_of(seconds: Sequence[float], megabytes: Sequence[float]) -> dict[str, float | None]:
    """Return medians of the memory in MB in the first WINDOW after warming up and in the last, and their trend.

    The slope, MB per hour, is the median of those between samples half the run apart. None for what a run is too short
    for.
    """
    at, level = np.asarray(seconds) - seconds[0], np.asarray(megabytes)
    if at[-1] < 3.0 * WINDOW:
        return {"first_mb": None, "last_mb": None, "growth_mb": None, "slope_mb_per_hour": None, "most_mb": level.max()}
    first = float(np.median(level[(at >= WINDOW) & (at < 2.0 * WINDOW)]))
    last = float(np.median(level[at >= at[-1] - WINDOW]))
    at, level = at[at >= WINDOW], level[at >= WINDOW]
    half = len(at) // 2
    slopes = (level[half:] - level[: len(level) - half]) / (at[half:] - at[: len(at) - half])
    return {
        "first_mb": first,
        "last_mb": last,
        "growth_mb": last - first,
        "slope_mb_per_hour": 3600.0 * float(np.median(slopes)),
        "most_mb": float(level.max()),
    }


def as_json(soaked: Soaked) -> JsonObject:
    """Return all figures, and the bounds."""
    samples, turns, bag, problems, repeats = soaked.samples, soaked.turns, soaked.bag, soaked.problems, soaked.repeats
    first, last = samples[0], samples[-1]
    done, late = last.ticks - first.ticks, last.late - first.late
    bare_late: Floats = np.concatenate([own for _, own in turns]) if turns else np.zeros(0)
    node_percent = 100.0 * late / max(1, done)
    bare_percent = late_percent(bare_late) if turns else None
    seconds = [one.seconds for one in samples]
    memory = memory_of(seconds, [one.megabytes for one in samples])
    dropped = last.dropped - first.dropped
    bounds = [
        Bound("drift of the rest shape", soaked.drift, MOST_DRIFT, "m"),
        Bound("growth of the node's own memory", memory["growth_mb"], MOST_GROWTH, "MB"),
        Bound("highest force", bag.highest_force, soaked.clamp, "N"),
        Bound("wrenches and surfaces that are not finite", bag.not_finite, 0.0, ""),
        Bound("messages missing from the bag", bag.missing, 0.0, ""),
        Bound("problems in the diagnostics", sum(problems.values()) + len(soaked.failures), 0.0, ""),
        Bound("dropped ticks", dropped, 0.0, ""),
    ]
    if bare_percent is not None:
        bounds.append(late_bound("ticks late by more than a period", node_percent, bare_percent))
    if repeats is not None:
        bounds.append(Bound("deviation of the replay", float(not repeats), 0.0, ""))
    return {
        "organ": soaked.organ,
        "minutes": soaked.minutes,
        "rate_hz": RATE,
        "realtime_priority": soaked.priority,
        "drift_m": soaked.drift,
        "memory": memory,
        "shared_memory": memory_of(seconds, [one.shared_megabytes for one in samples]),
        "force_clamp_n": soaked.clamp,
        "bag": bag._asdict(),
        "repeats": repeats,
        "problems": problems,
        "failures": list(soaked.failures),
        "late": {
            "node_percent": node_percent,
            "bare_percent": bare_percent,
            "ticks": done,
            "bare_ticks": len(bare_late),
            "dropped": dropped,
            "bare_turns": [{"seconds": at, "p99_us": 1e6 * float(np.percentile(own, 99.0))} for at, own in turns],
        },
        "series": {name: [getattr(one, name) for one in samples] for name in Sample._fields},
        "bounds": [bound.as_json() for bound in bounds],
    }


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    late, bag = found["late"], found["bag"]

    def shown(value: float | None, form: Callable[[float], str]) -> str:
        return "-" if value is None else form(value)

    priority = found["realtime_priority"]
    preferred = f", real-time priority {priority}" if priority else ""
    keys = ("first_mb", "last_mb", "growth_mb", "slope_mb_per_hour", "most_mb")
    table = [["memory, MB", "minute 2", "last minute", "growth", "an hour", "most"]]
    for name, memory in (("the node's own", found["memory"]), ("shared with others", found["shared_memory"])):
        table.append([name, *(shown(memory[key], lambda value: f"{value:.2f}") for key in keys)])
    lines = [
        f"{found['minutes']:g} min at {found['rate_hz']:g} Hz{preferred}: two scripted tools, one subscriber of"
        " markers at 60 Hz, a bag",
        *aligned(table),
        "",
        f"ticks late by more than a period: node {late['node_percent']:.2f} % of {late['ticks']}, a bare loop"
        f" {shown(late['bare_percent'], lambda value: f'{value:.2f}')} %",
        f"bag: {1e-6 * bag['bytes']:.0f} MB, {bag['messages']} messages, {bag['wrenches']} wrenches up to"
        f" {bag['highest_force']:.2f} N, {bag['surfaces']} surfaces",
        *(f"problem: {name} {count}" for name, count in found["problems"].items()),
        *(f"failure: {line}" for line in found["failures"]),
        "",
        *bound_lines(found["bounds"]),
    ]
    return "\n".join(lines)
