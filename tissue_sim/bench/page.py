"""Benchmark `tissue_sim bench page`: frames per second that the page sends of a scene whose organs all move.

The organs of a scene are moved by breathing so gentle that they sleep meanwhile, because the page is tested and not the
ticks. A watcher on the page's websocket, in a process of its own, counts in those seconds in which the node sends
(nearly) as many surfaces as it may: at the ends of a breath nothing moves. A bare loop runs beside it at the same time.
With --delay the watcher is behind a link, as on another machine.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path

import numpy as np

from tissue_sim import progress
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.bench.processor_load import processor_load_during, processor_seconds
from tissue_sim.contact.scene_file import SceneFile
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.shipped import shipped_file
from tissue_sim.ports import free_port
from tissue_sim.ros.probes.graph import NODE, START_TIME, Graph, first_within, last_line, ticks
from tissue_sim.ros.probes.lossy_link import ADDRESSES, inside, lossy_link
from tissue_sim.ros.shared.children import Child

SCENE = "config/scenes/abdomen.yaml"
LEAST = 30.0  # frames per second
HERE: tuple[str, Sequence[str]] = ("127.0.0.1", ())  # address of the page, and the command that runs its watcher
BREATHS, DISPLACEMENT = 6.0, 0.015  # per minute; m
MOVING = 50  # surfaces, of 60, that the node sends in a second in which frames are counted
LOOK = 0.05  # s for which the node's messages are read at a time
PAGE, SERVED, BARE = "the page", "the node", "a bare loop"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, seconds=20.0, check=True, organ=None)
    parser.add_argument("--scene", metavar="FILE", help="scene (.yaml) whose organs are shown; default: the abdomen")
    parser.add_argument(
        "--delay", type=float, metavar="S", help="view across a link with this delay in each direction, s (Linux, root)"
    )


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    if not 0.0 <= (args.delay or 0.0) <= 1.0:
        raise UserError(f"--delay {args.delay:g} is outside 0..1")
    path = Path(args.scene) if args.scene else shipped_file(SCENE)
    if path is None:
        raise UserError("no scene is part of this installation; name one with --scene")
    with nullcontext(HERE) if args.delay is None else far(args.delay) as (host, within):
        found = measure(SceneFile.read(path), args.seconds, host, within)
    return Result(found, text(found))


@contextmanager
def far(delay: float) -> Iterator[tuple[str, Sequence[str]]]:
    """Yield an address for the page, and the command that runs its watcher behind a link with a delay each way, s.

    Raises Unavailable, see `lossy_link`.
    """
    with lossy_link(0.0, delay) as (here, there), inside(here):
        yield ADDRESSES[0], ("ip", "netns", "exec", there)


def measure(scene: SceneFile, seconds: float, host: str, within: Sequence[str]) -> JsonObject:
    """Return the frames of each organ, bytes, and processor use.

    host: address at which the page is served; within: the command, if any, that runs the watcher. Raises UserError when
    rclpy or viser is missing, or a process fails.
    """
    with Graph() as graph, tempfile.TemporaryDirectory() as folder:
        from tissue_sim.ros.probes.viewer import Viewer

        node = graph.serve(f"scene_file:={carried(scene, Path(folder))}")
        ticks(node)
        page = graph.start_command("view", "--host", host, "--port", str(free_port()), "--node", NODE)
        children = {PAGE: page, SERVED: node, BARE: graph.start("probes.idle_loop", str(LEAST))}
        watcher = graph.start("probes.websocket_counter", served_at(page), str(seconds), within=within)
        first_within(lambda: watcher.output or watcher.exit_code is not None, START_TIME, "no picture arrived")
        own = graph.client("bench")
        topic = f"/{NODE}/{scene.names[0]}/surface"
        viewer = graph.enter_context(Viewer(own, topic))
        sent: list[float] = []

        def note() -> None:
            began = time.monotonic()
            with progress.still(), progress.task("pictures, s", seconds) as under_way:
                while watcher.exit_code is None:
                    viewer.look(LOOK)
                    sent.extend([time.monotonic()] * viewer.count[topic])
                    under_way.reach(min(round(time.monotonic() - began), seconds))

        spent = {name: partial(processor_seconds, child.pid) for name, child in children.items()}
        percents = processor_load_during(spent, note)
        arrivals = json.loads(last_line(watcher))
    return as_json(scene, arrivals, sent, percents, seconds)


def served_at(page: Child) -> str:
    """Return the address that a viewer prints. Raises UserError when it ends, or prints none."""

    def printed_address() -> str:
        if page.exit_code is not None:
            raise UserError(f"the page did not start: {page.last_words()}")
        return next((line.partition(" ")[2] for line in page.output if line.startswith("open ")), "")

    return first_within(printed_address, START_TIME, "no page was served")


def carried(scene: SceneFile, folder: Path) -> Path:
    """Write a scene of the same organs, which breathe together and are not attached."""
    entries = []
    for name, organ in zip(scene.names, scene.organs, strict=True):
        organ.save(folder / f"{name}.npz")
        entries.append(f"  - {{name: {name}, file: {name}.npz, breathes: 1.0}}")
    file = folder / "scene.yaml"
    lines = ["format: 1", "organs:", *entries, f"breathing: {{rate: {BREATHS}, way: [0.0, 0.0, {-DISPLACEMENT}]}}"]
    file.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return file


def as_json(
    scene: SceneFile,
    arrivals: JsonObject,
    sent: Sequence[float],
    percents: Mapping[str, float],
    seconds: float,
) -> JsonObject:
    """Return the frames per second of each organ, on average and in the worst second, and the bounds.

    arrivals: see `page_watcher.watch`; sent: when the node sent a surface, s. Raises UserError where there was no
    second in which to count.
    """
    began = float(arrivals["began"])
    edges = began + np.arange(math.floor(seconds) + 1)
    moving = np.histogram(sent, edges)[0] >= MOVING
    if not moving.any():
        raise UserError(f"the node never sent {MOVING} surfaces in a second: this machine is too slow, or too busy")
    rows: list[JsonObject] = []
    for name, organ in zip(scene.names, scene.organs, strict=True):
        came = np.array(arrivals["came"].get(f"/organ/{name}", []))
        count = np.histogram(came, edges)[0][moving]
        rows.append(
            {
                "organ": name,
                "points": organ.n_surface,
                "pictures_hz": float(count.mean()),
                "worst_second": int(count.min()),
            }
        )
    least = min(row["pictures_hz"] for row in rows)
    bounds = [Bound("pictures of each organ, fewest", least, LEAST, "a second", least=True)]
    return {
        "organs": rows,
        "seconds": int(moving.sum()),
        "megabytes_a_second": arrivals["bytes"] / seconds / 1e6,
        "processor_load_percent": dict(percents),
        "bounds": [bound.as_json() for bound in bounds],
    }


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    rows = [["organ", "points", "pictures a second", "in the worst second"]]
    for row in found["organs"]:
        rows.append([row["organ"], str(row["points"]), f"{row['pictures_hz']:.1f}", str(row["worst_second"])])
    loads = found["processor_load_percent"].items()
    percents = [["% of a core", ""], *([name, f"{percent:.1f}"] for name, percent in loads)]
    about = (
        f"{found['seconds']} s in which all organs move; {found['megabytes_a_second']:.1f} MB a second over the"
        " websocket"
    )
    return "\n".join([about, "", *aligned(rows), "", *aligned(percents), "", *bound_lines(found["bounds"])])
