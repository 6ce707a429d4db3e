"""`tissue_sim bench latency`: from a pose to the wrench that answers it, and how late ticks are.

A node with a tool in contact and a subscriber of its markers; an echo node that sends each pose back, on the same kind
of executor; and a bare loop that sleeps and is busy for as long as a tick. They take turns of a few seconds, so that
what else the machine does falls on all of them.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from tissue_sim.array_types import Floats
from tissue_sim.bench.arguments import add_shared, check_shared
from tissue_sim.bench.printing import Bound, aligned, bound_lines, emit
from tissue_sim.errors import UserError
from tissue_sim.jit import kernel
from tissue_sim.model.realtime import now, sleep_until
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.ros.shared.priority import HIGHEST, below, is_allowed, preferred

if TYPE_CHECKING:
    from tissue_sim.ros.latency.probe import Trip

NODE = "tissue_sim"
TURN = 5.0  # s that each of them is measured for before the next one's turn
RATE = 1000.0  # Hz, of ticks and poses
START_TIME = 240.0  # s for the node to be there, with kernels to compile
MOST_OF_ECHO, TICKS_BEYOND = 1.5, 1.0  # bound of the node's p99: so many times the echo's, and so many ticks
MOST_OF_BARE, POINTS_BEYOND = 2.0, 0.2  # bound of the share of late ticks, and percentage points


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    add_shared(parser)
    parser.add_argument("--seconds", type=float, default=60.0, help="to measure each of them for (default: 60)")
    parser.add_argument(
        "--realtime-priority",
        type=int,
        default=0,
        help="of the node and of what it is held against, 1 to 99, where the system allows it (default: 0, none)",
    )
    parser.add_argument("--check", action="store_true", help="exit with 1 when a bound is missed")


def run(args: argparse.Namespace) -> int:
    """Measure and print; returns 0, or with --check 1 when a bound is missed."""
    check_shared(args)
    if not 1.0 <= args.seconds <= 3600.0:
        raise UserError(f"--seconds {args.seconds:g} is outside 1..3600")
    if not 0 <= args.realtime_priority <= HIGHEST:
        raise UserError(f"--realtime-priority {args.realtime_priority} is outside 0..{HIGHEST}")
    found = measure(args.organ, args.seconds, args.realtime_priority)
    emit(found, text(found), args.json)
    return 1 if args.check and not all(bound["met"] for bound in found["bounds"]) else 0


# measuring -----------------------------------------------------------------------------------------


def measure(organ_file: str | None, seconds: float, priority: int = 0) -> dict[str, Any]:
    """Figures of the node, the echo and the bare loop, measured for so many seconds each.

    priority: real-time priority of the node's loop and of the bare one; echo and node answer with the one below.
    Raises UserError when rclpy is not installed, the node doesn't start, or the system allows no such priority.
    """
    if importlib.util.find_spec("rclpy") is None:
        raise UserError("this benchmark needs rclpy: pip install 'tissue_sim[ros]', or source a ROS 2")
    from tissue_sim.ros.latency.probe import Probe, together
    from tissue_sim.ros.shared.client import client_node

    if not is_allowed(priority):
        raise UserError(f"this user may not ask for real-time priority {priority}: see 'ulimit -r'")

    path = organ_file or str(shipped_organ())
    organ = Organ.load(path)
    with children(path, priority), client_node("latency_probe", NODE) as own:
        probe = Probe(own, NODE, organ, RATE)
        probe.meet()
        turns = max(1, round(seconds / TURN))
        node, echo, ticks, late = [], [], [], []
        bare_late: list[Floats] = []
        for _ in tqdm(range(turns), disable=None, desc="turns", unit="turn"):
            probe.approach()
            before = probe.report()
            node.append(probe.trips(seconds / turns))
            after = probe.report()
            ticks.append(after["tick"] - before["tick"])
            late.append(after["overruns"] - before["overruns"])
            busy = after["tick_p50_us"]
            echo.append(probe.echoes(seconds / turns))
            bare_late.append(bare(seconds / turns, 1e-6 * busy, priority))
        found = as_json(seconds, together(node), together(echo), ticks, late, np.concatenate(bare_late), busy)
        return {"realtime_priority": priority, **found}


def bare(seconds: float, busy: float, priority: int = 0) -> Floats:
    """How late, s, the ticks of a loop at RATE are that does nothing but be busy for so many s of each."""
    late = np.zeros(round(seconds * RATE), dtype=np.int64)
    with preferred(priority):
        bare_loop(round(1e9 / RATE), round(1e9 * busy), late, np.zeros(4, dtype=np.int64))
    return np.multiply(1e-9, late, dtype=np.float64)


@kernel
def bare_loop(period: int, busy: int, late: Any, clock: Any) -> None:
    """Sleep to each deadline, `period` ns apart, and be busy for `busy` ns; late (n,) ns."""
    deadline = now(clock)
    for tick in range(len(late)):
        deadline += period
        sleep_until(deadline, clock)
        start = now(clock)
        late[tick] = start - deadline
        while now(clock) - start < busy:
            pass


@contextmanager
def children(organ_file: str, priority: int) -> Iterator[None]:
    """The node, the echo and a listener in a ROS graph of their own."""
    from tissue_sim.ros.demo import free_domain
    from tissue_sim.ros.latency.probe import RADIUS
    from tissue_sim.ros.shared.children import Child, stop_all

    os.environ |= {"ROS_DOMAIN_ID": str(free_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    python = [sys.executable, "-m"]
    parameters = [
        f"organ_file:={organ_file}",
        f"rate:={RATE}",
        f"realtime_priority:={priority}",
        "marker_rate:=60.0",
        f"left.radius:={RADIUS}",
    ]
    words = [word for parameter in parameters for word in ("-p", parameter)]
    started = [
        Child("tissue_node", [*python, "tissue_sim.ros.node.program", "--ros-args", *words], os.environ),
        Child("echo", [*python, "tissue_sim.ros.latency.echo", str(below(priority))], os.environ),
        Child("listener", [*python, "tissue_sim.ros.latency.echo", "0", f"/{NODE}/markers"], os.environ),
    ]
    try:
        end = time.monotonic() + START_TIME
        while not any("surface nodes" in line for line in (*started[0].output, *started[0].errors)):
            if started[0].exit_code is not None or time.monotonic() > end:
                raise UserError(f"the node did not start: {started[0].last_words()}")
            time.sleep(0.1)
        yield
    finally:
        stop_all(started)


# telling -------------------------------------------------------------------------------------------


def as_json(
    seconds: float, node: Trip, echo: Trip, ticks: list[float], late: list[float], bare_late: Floats, busy: float
) -> dict[str, Any]:
    """All figures, and the bounds that they are held against."""
    period = 1.0 / RATE
    shares = 100.0 * sum(late) / max(1.0, sum(ticks)), 100.0 * float(np.mean(bare_late > period))
    trips = {"node": node.as_json(), "echo": echo.as_json()}
    limits = (
        MOST_OF_ECHO * trips["echo"]["p99_us"] + TICKS_BEYOND * 1e6 * period,
        MOST_OF_BARE * shares[1] + POINTS_BEYOND,
    )
    return {
        "seconds": seconds,
        "rate_hz": RATE,
        "round_trips": trips,
        "late": {"node_percent": shares[0], "bare_percent": shares[1], "ticks": sum(ticks), "busy_us": busy},
        "bounds": [
            Bound("round trip of the node, p99", trips["node"]["p99_us"], limits[0], "us").as_json(),
            Bound("ticks late by more than a period", shares[0], limits[1], "%").as_json(),
        ],
    }


def text(found: dict[str, Any]) -> str:
    """The figures as tables."""
    rows = [["pose to answer, us", "p50", "p99", "p99.9", "trips", "lost"]]
    for name, trip in found["round_trips"].items():
        rows.append([name, *(f"{trip[key]:.0f}" for key in ("p50_us", "p99_us", "p99_9_us", "trips", "lost"))])
    late, priority = found["late"], found["realtime_priority"]
    urgent = f"; with real-time priority {priority} and {below(priority)}" if priority else ""
    lines = [
        f"{found['seconds']:g} s each in turns; a tool in contact, poses at {found['rate_hz']:g} Hz, one subscriber of"
        f" markers at 60 Hz{urgent}",
        *aligned(rows),
        "",
        f"ticks late by more than a period: node {late['node_percent']:.2f} %, a bare loop as busy"
        f" ({late['busy_us']:.0f} us) {late['bare_percent']:.2f} %",
        "",
        *bound_lines(found["bounds"]),
    ]
    return "\n".join(lines)
