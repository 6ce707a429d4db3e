"""Benchmark `tissue_sim bench start`: time to the first tick of a new process, and to the node's first answer.

It runs once with every kernel to compile, in an empty cache, and some times with all of them on disk, of which the
fastest counts; beside a process that compiles one small kernel and one that only imports the libraries.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

from tissue_sim import progress
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines, built_or_skipped, figure
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.probes.graph import NODE, Graph, ticks
from tissue_sim.ros.shared.dds import PROFILE_VARIABLES, REACH

TO_COMPILE, ON_DISK = "kernels to compile", "kernels on disk"
MOST = {TO_COMPILE: 20.0, ON_DISK: 1.2}  # s to the first tick
MOST_TO_END, MOST_TO_FIND = 1.0, 0.5  # s from a signal; until a program with ROS's own settings finds the node
FINDERS, APART = 3, 5.0  # such programs, and s between them: one that has just ended delays the next for seconds
FINDER = f"""import rclpy, time
rclpy.init()
node, began = rclpy.create_node("finder"), time.monotonic()
while "{NODE}" not in node.get_node_names() and time.monotonic() < began + 30.0:
    time.sleep(0.005)
print(time.monotonic() - began)
node.destroy_node()
rclpy.shutdown()
"""
IN_HERE = (
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE"  # tells children of an interpreter over the wheels not to start again for them
)
TIMES = 3  # number of starts with kernels on disk
SHOWN = 8  # modules of kernels in the table

IMPORTS = "import numpy, numba, scipy.sparse.linalg, scipy.spatial"
PEERS = {
    "imports numpy, numba and scipy": IMPORTS,
    "compiles a fixed kernel": f"""{IMPORTS}
@numba.njit
def settle(matrix, load, rounds):
    found = numpy.zeros_like(load)
    for _ in range(rounds):
        for row in range(len(load)):
            rest = load[row]
            for column in range(len(load)):
                if column != row:
                    rest -= matrix[row, column] * found[column]
            found[row] = rest / matrix[row, row]
    return numpy.sqrt(numpy.sum((matrix @ found - load) ** 2))
settle(numpy.eye(3), numpy.ones(3), 2)
""",
}


class Start(NamedTuple):
    """Seconds of a new process until it was done: wall clock and processor time."""

    wall: float
    processor: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, check=True)
    parser.add_argument("--quick", action="store_true", help="kernels on disk only")


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    found = measure(Path(args.organ or shipped_organ()), [ON_DISK] if args.quick else [TO_COMPILE, ON_DISK])
    return Result(found, text(found))


# measuring -----------------------------------------------------------------------------------------


def measure(organ: Path, wanted: Sequence[str]) -> JsonObject:
    """Return figures of a process and of a node, with the kernels as wanted, and of the peers."""
    Organ.load(organ)  # reports what is wrong with it
    starts: dict[str, JsonObject] = {}
    nodes: dict[str, dict[str, float] | None] = {}
    peers: dict[str, list[Start]] = {name: [] for name in PEERS}
    remark = ""
    with rows.until_stopped():
        for kernels in rows.each(wanted, "starts"):
            tries = []
            # The first one, which may have to compile what is to be on disk, does not count.
            for turn in progress.steps(range(1 if kernels == TO_COMPILE else 1 + TIMES), kernels):
                with _cache(kernels) as environment:
                    tries.append(first_start(organ, environment))
                    if turn:
                        for name, code in PEERS.items():
                            peers[name].append(peer_start(code, environment))
            starts[kernels] = min(tries[-TIMES:], key=lambda start: start["wall"])
            rows.report(f"a new process, {kernels}", f"{starts[kernels]['wall']:.2f} s to its first tick")
            for _ in range(1 if kernels == TO_COMPILE else 2):
                with _cache(kernels) as environment, progress.task("a node"):
                    nodes[kernels], remark = built_or_skipped(partial(node_start, organ, environment))
    return as_json(starts, nodes, {name: min(found) for name, found in peers.items() if found}, remark)


@contextmanager
def _cache(kernels: str) -> Iterator[dict[str, str]]:
    """Yield the environment of a process started from a shell, with kernels on disk or an empty cache."""
    own = {name: value for name, value in os.environ.items() if name != IN_HERE}
    if kernels == ON_DISK:
        yield own
        return
    own.pop("NUMBA_CACHE_DIR", None)
    with tempfile.TemporaryDirectory(prefix="tissue_sim-") as empty:
        yield own | {"XDG_CACHE_HOME": empty}


def first_start(organ: Path, environment: Mapping[str, str]) -> JsonObject:
    """Return what `tissue_sim.bench.first_tick` reports, in a new process."""
    words = [sys.executable, "-m", "tissue_sim.bench.first_tick", str(time.monotonic()), str(organ.absolute())]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise UserError(f"a fresh process did not reach its first tick: {(done.stderr.splitlines() or ['killed'])[-1]}")
    return dict(json.loads(done.stdout))


def peer_start(code: str, environment: Mapping[str, str]) -> Start:
    """Run some code in a new process."""
    began, before = time.monotonic(), _processor_of_children()
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)
    return Start(time.monotonic() - began, _processor_of_children() - before)


def _processor_of_children() -> float:
    """Return the processor seconds of all children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def node_start(organ_file: Path, environment: Mapping[str, str]) -> tuple[dict[str, float], str]:
    """Return seconds from a node's start to its first tick and its first answered pose, and from SIGINT to its end."""
    organ = Organ.load(organ_file)
    with Graph() as graph:
        from tissue_sim.ros.probes.tool_driver import Hand
        from tissue_sim.ros.shared.client import client_node

        with client_node("hand", NODE) as own:
            hand = Hand(own, organ)
            began = time.monotonic()
            node = graph.start_node(str(organ_file.absolute()), environment=environment)
            ticks(node)
            ticked = time.monotonic()
            hand.wait_for_answer()
            answered = time.monotonic()
            found = to_find(environment)
            ended = time.monotonic()
            node.stop()
            seconds = ticked - began, answered - began, time.monotonic() - ended, found
            return dict(zip(("to_first_tick", "to_first_answer", "to_end", "to_find"), seconds, strict=True)), ""


def to_find(environment: Mapping[str, str]) -> float:
    """Return the longest time, s, in which programs with ROS's own settings find the node of the current graph."""
    ours = (*PROFILE_VARIABLES, REACH, IN_HERE)
    plain = {name: value for name, value in environment.items() if name not in ours}
    plain["ROS_DOMAIN_ID"] = os.environ["ROS_DOMAIN_ID"]
    found = []
    for _ in range(FINDERS):
        time.sleep(APART)
        done = subprocess.run([sys.executable, "-c", FINDER], env=plain, capture_output=True, text=True, check=True)
        found.append(float(done.stdout))
    return max(found)


# telling -------------------------------------------------------------------------------------------


def as_json(
    starts: Mapping[str, JsonObject],
    nodes: Mapping[str, Mapping[str, float] | None],
    peers: Mapping[str, Start],
    remark: str,
) -> JsonObject:
    """Return all figures, s, and the bounds; remark: why there are none of the node."""
    ends = [node["to_end"] for node in nodes.values() if node]
    bounds = [Bound(f"first tick of a new process, {name}", starts[name]["wall"], MOST[name], "s") for name in starts]
    bounds.append(Bound("node, from SIGINT to its end", max(ends, default=None), MOST_TO_END, "s"))
    finds = [node["to_find"] for node in nodes.values() if node]
    bounds.append(Bound("node, until a plain ROS program finds it", max(finds, default=None), MOST_TO_FIND, "s"))
    return {
        "starts": {name: dict(start) for name, start in starts.items()},
        "nodes": dict(nodes),
        "remark": remark,
        "peers": {name: peer._asdict() for name, peer in peers.items()},
        "bounds": [bound.as_json() for bound in bounds],
    }


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    starts, peers = found["starts"], found["peers"]
    parts = list(next(iter(starts.values()))["parts"])
    table = [["a new process up to its first tick, s", *starts]]
    table += [[part, *(f"{start['parts'][part]:.2f}" for start in starts.values())] for part in parts]
    table.append(["total, wall time", *(f"{start['wall']:.2f}" for start in starts.values())])
    table.append(["total, processor time", *(f"{start['processor']:.2f}" for start in starts.values())])
    for name, peer in peers.items():
        ratios = (figure(start["processor"] / peer["processor"]) for start in starts.values())
        table.append([f"times a process that {name}", *(f"{ratio} x" for ratio in ratios)])
    node_rows = {"to_first_tick": "node, to its first tick", "to_first_answer": "node, to its first answered pose"}
    node_rows |= {"to_end": "node, from SIGINT to its end", "to_find": "node, until a plain ROS program finds it"}
    for key, name in node_rows.items():
        table.append([name, *(_seconds(found["nodes"].get(kernels), key) for kernels in starts)])
    lines = aligned(table)
    compiled = next(iter(starts.values()))["compiled"]
    if compiled:
        slowest, everything = sorted(compiled, key=compiled.__getitem__, reverse=True), sum(compiled.values())
        shown = [(name, compiled[name]) for name in slowest[:SHOWN]]
        shown.append(("all others", everything - sum(seconds for _, seconds in shown)))
        rows = [["compiling by module, without called functions", "s", "%"]]
        rows += [[name, f"{seconds:.2f}", f"{100.0 * seconds / everything:.0f}"] for name, seconds in shown]
        lines += ["", *aligned(rows)]
    lines.append("")
    for name, peer in peers.items():
        lines.append(f"a process that {name}: {peer['wall']:.2f} s, {peer['processor']:.2f} s of the processor")
    if found["remark"]:
        lines += ["", f"node: {found['remark']}"]
    return "\n".join([*lines, "", *bound_lines(found["bounds"])])


def _seconds(node: Mapping[str, float] | None, key: str) -> str:
    return f"{node[key]:.2f}" if node else "-"
