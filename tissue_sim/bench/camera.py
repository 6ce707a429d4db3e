"""Benchmark `tissue_sim bench camera`: the effect of `tissue_sim camera` on the node beside which it draws.

A hand pokes the organ once a second, with poses at the full rate, in turns without a camera, and with one whose images
a subscriber in another process counts. A bare loop has its turn at the end of each, under the same load. All of it is
done without a real-time priority, and with one, if the system allows it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tissue_sim import progress
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.bare_loop import MOST_OF_BARE, POINTS_BEYOND, RATE, bare, late_percent, name_of
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.probes.graph import NODE, Graph, last_line, ticks
from tissue_sim.ros.shared.children import Child
from tissue_sim.ros.shared.priority import below, is_allowed

if TYPE_CHECKING:
    from tissue_sim.ros.probes.picture_times import PictureTimes
    from tissue_sim.ros.probes.poke_probe import PokeProbe

PRIORITY = 20  # of the second node's loop
ALONE, BESIDE = "without", "with"
TURN, SHORTEST = 10.0, 4.0  # s of poking in a turn, at most and at least
WARMING_UP = 6.0  # s of poking that aren't counted: a camera starts meanwhile
BARE = 4.0  # s that the bare loop runs in each turn
PICTURES, LEAST_PICTURES = 30.0, 29.0  # Hz: that are asked for, that are to arrive
IMAGES = {"images": ("image_raw",), "JPEG": ("image_raw/compressed",)}
STEREO = {"JPEG": ("left/image_raw/compressed", "right/image_raw/compressed")}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, seconds=40.0, check=True)
    parser.add_argument("--jpeg", action="store_true", help="count compressed images, not raw ones")
    parser.add_argument("--stereo", action="store_true", help="a stereo pair, whose compressed images are counted")
    parser.add_argument("--samples", type=int, choices=(1, 2, 4), default=1, help="samples of a pixel, of the camera")
    parser.add_argument("--nice", type=int, choices=range(20), metavar="0..19", help="niceness of the camera")


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    if args.seconds < SHORTEST:
        raise UserError(f"--seconds {args.seconds:g} is less than {SHORTEST:g}")
    words = [f"--samples={args.samples}", f"--rate={PICTURES:g}"]
    words += ["--baseline=0.005"] * args.stereo + ([f"--nice={args.nice}"] if args.nice is not None else [])
    topics = STEREO["JPEG"] if args.stereo else IMAGES["JPEG" if args.jpeg else "images"]
    found = measure(args.organ or str(shipped_organ()), args.seconds, words, topics)
    return Result(found, text(found))


def measure(organ_file: str, seconds: float, words: list[str], topics: tuple[str, ...]) -> JsonObject:
    """Return the figures of a node without a real-time priority and, where that is allowed, of one with it.

    seconds: of poking without and with a camera each; words: arguments of the camera; topics: what is counted, below
    its name. Raises UserError when rclpy is not installed, or a process does not start or report.
    """
    nodes: list[JsonObject] = []
    with rows.until_stopped():
        for priority in rows.each([0, PRIORITY] if is_allowed(PRIORITY) else [0], "nodes"):
            nodes.append({"realtime_priority": priority, "turns": {ALONE: [], BESIDE: []}})
            _measure_node(organ_file, seconds, nodes[-1], words, topics)
    return as_json([node for node in nodes if node["turns"][BESIDE]], words)


def _measure_node(path: str, seconds: float, node: JsonObject, words: list[str], topics: tuple[str, ...]) -> None:
    """Fill in the turns of one node, each when it is over."""
    priority, length = node["realtime_priority"], min(seconds, TURN)
    with Graph() as graph:
        from tissue_sim.ros.probes.picture_times import PictureTimes
        from tissue_sim.ros.probes.poke_probe import PokeProbe
        from tissue_sim.ros.probes.tool_driver import RADIUS

        served = graph.start_node(path, f"rate:={RATE}", f"realtime_priority:={priority}", f"left.radius:={RADIUS}")
        ticks(served)
        own = graph.client("camera_probe")
        hand = PokeProbe(own, NODE, Organ.load(path), rate=RATE, priority=below(below(priority)))
        hand.meet()
        hand.poke(WARMING_UP)
        with progress.still():
            for number in rows.each(range(max(1, round(seconds / length))), "turns"):
                for name in (ALONE, BESIDE):
                    camera: AbstractContextManager[dict[str, float]] = nullcontext({})
                    if name == BESIDE:
                        camera = filming(graph, hand, words, topics, length)
                    with camera as pictures:
                        figures = _turn(hand, length, priority, partial(PictureTimes, own, "camera"))
                    node["turns"][name].append(figures | pictures)
                    rows.report(f"{name_of(node)}, turn {number + 1}, {name}", f"{figures['late_percent']:.2f} % late")


@contextmanager
def filming(
    graph: Graph, hand: PokeProbe, words: list[str], topics: tuple[str, ...], length: float
) -> Iterator[dict[str, float]]:
    """Run a camera, and a process that counts its images, while entered; fill in their rate at the end."""
    camera = graph.start_command("camera", *words)
    lasts = str(WARMING_UP + length + BARE)
    watcher = graph.start("probes.viewer", lasts, *(f"/camera/{topic}" for topic in topics))
    found: dict[str, float] = {}
    try:
        hand.poke(WARMING_UP)  # while both start
        yield found
        rates = json.loads(last_line(watcher))
        found["pictures_hz"] = min(rates.values())
    finally:
        _end(camera)


def _end(camera: Child) -> None:
    camera.stop()
    if camera.exit_code:
        raise UserError(f"the camera failed, {camera.last_words()}")


def _turn(hand: PokeProbe, length: float, priority: int, times: Callable[[], PictureTimes]) -> dict[str, float]:
    """Return the figures of one turn: of the node, of the camera where there is one, and of a bare loop."""
    reports = times()
    found = hand.poke(length)
    spent = reports.close()
    first, last = found.reports[0], found.reports[-1]
    done = last.tick - first.tick
    return {
        "late_percent": 100.0 * (last.late - first.late) / max(1, done),
        "tick_p99_us": 1e6 * float(np.median([one.busy_p99 for one in found.reports])),
        "late_p99_us": 1e6 * float(np.median([one.late_p99 for one in found.reports])),
        "ticks_per_second": done / (last.seconds - first.seconds),
        "bare_late_percent": late_percent(bare(BARE, last.busy, priority)),
        "picture_ms": float(np.median(spent)) if spent else float("nan"),
    }


# telling -------------------------------------------------------------------------------------------


def as_json(nodes: list[JsonObject], words: list[str]) -> JsonObject:
    """Return the medians of each node's turns, and the bounds.

    Late ticks beside a camera are compared with those without one, or with those of a bare loop beside the same camera,
    whichever are more: what the machine itself adds then is not the node's.
    """
    table, bounds = [], []
    for node in nodes:
        of = {name: _medians(turns) for name, turns in node["turns"].items() if turns}
        table += [{"node": name_of(node), "camera": name, **figures} for name, figures in of.items()]
        usual = max(of[ALONE]["late_percent"], of[BESIDE]["bare_late_percent"])
        limit = MOST_OF_BARE * usual + POINTS_BEYOND
        bounds += [
            Bound(f"{name_of(node)}: late ticks beside the camera", of[BESIDE]["late_percent"], limit, "%"),
            Bound(f"{name_of(node)}: images", of[BESIDE]["pictures_hz"], LEAST_PICTURES, "Hz", least=True),
        ]
    return {"camera": words, "rows": table, "bounds": [bound.as_json() for bound in bounds]}


def _medians(turns: list[dict[str, float]]) -> dict[str, float]:
    return {key: float(np.median([turn[key] for turn in turns])) for key in turns[0]}


def text(found: JsonObject) -> str:
    """Return the figures as a table."""
    head = ["node", "camera", "ticks/s", "late", "bare loop", "tick p99", "late by, p99", "images", "a picture"]
    table = [head]
    for row in found["rows"]:
        with_camera = row["camera"] == BESIDE
        table.append(
            [
                row["node"],
                row["camera"],
                f"{row['ticks_per_second']:.1f}",
                f"{row['late_percent']:.2f} %",
                f"{row['bare_late_percent']:.2f} %",
                f"{row['tick_p99_us']:.0f} us",
                f"{row['late_p99_us']:.0f} us",
                f"{row['pictures_hz']:.1f} Hz" if with_camera else "-",
                f"{row['picture_ms']:.1f} ms" if with_camera else "-",
            ]
        )
    about = (
        f"a poke a second, poses at {RATE:g} Hz; camera {' '.join(found['camera'])}, 640 x 480; medians of the turns"
    )
    return "\n".join([about, *aligned(table, left=2), "", *bound_lines(found["bounds"])])
