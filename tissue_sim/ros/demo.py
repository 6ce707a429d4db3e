"""Command `tissue_sim demo`: node, scripted haptic bridge and viewer, with one line a second about them."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shlex
import shutil
import sys
import time
from collections.abc import Collection, Mapping
from datetime import datetime
from pathlib import Path

from tissue_sim import progress
from tissue_sim.errors import UserError
from tissue_sim.ros.shared import client, dds
from tissue_sim.ros.shared.children import Child, stop_all, wait_a_little
from tissue_sim.ros.shared.domains import chosen_graph
from tissue_sim.ros.shared.priority import is_allowed
from tissue_sim.ros.viewer.tokens import TOKEN_VARIABLE
from tissue_sim.ros.viewer.view import add_page_arguments, address, check_port, page_token
from tissue_sim.unexpected_errors import INTERRUPTED, write_error

NODE = "tissue_sim"
PRIORITY = 20  # of the node, where the system allows it
WAIT = 600.0  # s that the bridge waits for the node, which may compile its kernels first


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "--seconds", type=client.number(0.1, 1e9, "s"), help="end after this time; without it, run until Ctrl-C"
    )
    add_page_arguments(parser)
    parser.add_argument("--no-viewer", action="store_true", help="node and bridge only")
    parser.add_argument("--organ", metavar="FILE", help="organ file (.npz); default: the kidney of this package")
    parser.add_argument("--bag-folder", metavar="DIR", help="folder for the bag (default: recordings/<date-time>)")
    parser.add_argument(
        "--rate", type=client.number(50.0, 2000.0, "Hz"), default=500.0, help="poses per second from the bridge, Hz"
    )


def run(args: argparse.Namespace) -> int:
    """Run the demonstration; return 0, 1 when something ended before its time, 130 when it was stopped too early."""
    if args.organ is not None and not Path(args.organ).is_file():
        raise UserError(f"organ file {args.organ} does not exist; make one with 'tissue_sim build'")
    token = None
    if not args.no_viewer:
        check_port(args.host, args.port)
        token = page_token(args)
    folder = Path(args.bag_folder or Path("recordings") / datetime.now().strftime("%Y%m%d-%H%M%S"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(
            f"cannot make the folder {folder}: {error.strerror}; choose another with --bag-folder"
        ) from None

    watch, there = Watch(args.seconds), set(folder.iterdir())
    with chosen_graph(os.environ), client.Stop() as stop:
        # The node first: the others wait for it. Stopped the other way round.
        # A browser that draws without a GPU takes every core there is: the node goes first where it may.
        priority = PRIORITY if is_allowed(PRIORITY) else 0
        children = [Child("node", node_command(args.organ, folder, priority), os.environ)]
        print(
            f"node: {args.organ or 'the default kidney'}, records to {folder}; ROS domain"
            f" {os.environ['ROS_DOMAIN_ID']}, real-time priority {priority or 'not allowed here'};"
            f" {dds.describe_discovery()}"
        )
        if not args.no_viewer:
            words = _command("view", "--host", args.host, "--port", str(args.port))
            # Not among the words, which every user of the machine can read.
            children.append(Child("viewer", words, {**os.environ, TOKEN_VARIABLE: token or ""}))
            print(f"viewer: open {address(args.host, args.port, token)}")
        words = _command("bridge", "--rate", f"{args.rate:g}", "--wait", f"{WAIT:g}")
        children.append(Child("bridge", words, os.environ))
        print("bridge: strokes, pokes, pinches, lifts and releases; Ctrl-C ends", flush=True)
        progress.report_by(None)  # from here on a line a second
        try:
            dead = watch.run(children, stop)
            last_words = dead.last_words() if dead else ""
        finally:
            killed = stop_all(children[::-1])
            watch.bag = watch.bag or newest_bag(folder, there)
            with contextlib.suppress(OSError):  # only an empty folder goes
                folder.rmdir()
    if dead is None and watch.node_up and children[-1].output:
        print(f"bridge: {children[-1].output[-1]}")
    return _conclude(watch, dead, last_words, killed)


def newest_bag(folder: Path, there: Collection[Path]) -> str:
    """Return the newest bag in a folder that was not there before; empty where there is none."""
    made = sorted((path for path in folder.iterdir() if path.is_dir() and path not in there), key=os.path.getmtime)
    return str(made[-1]) if made else ""


def node_command(organ: str | None, folder: Path, priority: int) -> list[str]:
    """Return the command line of the node."""
    words = ["-p", "record:=true", "-p", f"record_folder:={json.dumps(str(folder.absolute()))}"]
    words += ["-p", f"realtime_priority:={priority}"]
    if organ is not None:
        words += ["-p", f"organ_file:={json.dumps(str(Path(organ).absolute()))}"]
    return [sys.executable, "-m", "tissue_sim.ros.node.program", "--ros-args", *words]


def status_line(values: Mapping[str, str]) -> str:
    """Return the node's physics status in one line."""

    def number(key: str, form: str) -> str:
        try:
            return format(float(values[key]), form)
        except (KeyError, ValueError):
            return "?"

    return (
        f"{number('tick_rate_hz', '6.0f')} Hz | tick p50 {number('tick_p50_us', '4.0f')} us,"
        f" p99 {number('tick_p99_us', '5.0f')} us | overruns {values.get('overruns', '?'):>4} |"
        f" active nodes {values.get('active_nodes', '?'):>4} | contacts {values.get('contact_count', '?'):>3} |"
        f" {number('force_n', '5.2f')} N"
    )


class Watch:
    """Observer of the node's diagnostics until the time is over, which counts from when node and bridge both run."""

    def __init__(self, seconds: float | None) -> None:
        self._seconds = seconds
        self.bag = ""
        self.node_up = False

    def run(self, children: list[Child], stop: client.Stop) -> Child | None:
        """Print a line a second; return the child that ended by itself, or None when it is time to stop."""
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseStamped
        from rclpy.qos import QoSProfile

        with client.client_node("demo", NODE) as node:
            reports = client.NewestMessage(node, DiagnosticArray, "/diagnostics", QoSProfile(depth=10))
            poses: client.NewestMessage | None = client.NewestMessage(
                node, PoseStamped, "left/measured_cp", client.stream_qos(), raw=True
            )
            started = next_line = time.monotonic()
            end, values = float("inf"), None
            counting = False
            while not stop and time.monotonic() < end:
                for child in children:
                    if child.exit_code is not None:
                        return child
                if poses is not None and poses.take() is not None:
                    poses.close()
                    poses = None
                values = client.physics_status(reports.take_all(), NODE) or values
                self.bag = (values or {}).get("recording") or self.bag
                # The node speaks after its first tick, and the bridge may be ready before or after that.
                self.node_up = values is not None
                if not counting and poses is None and self.node_up:
                    counting = True
                    end = time.monotonic() + (self._seconds or float("inf"))
                now = time.monotonic()
                if now >= next_line:
                    next_line += 1.0
                    if values is not None:
                        print(status_line(values), flush=True)
                    elif (waited := round(now - started)) == 2 or (waited > 0 and waited % 10 == 0):
                        print(
                            f"waiting for the node, {waited} s (on its first run it compiles kernels, for a"
                            " minute or two)",
                            flush=True,
                        )
                wait_a_little(min(next_line, end))
        return None


def _conclude(watch: Watch, dead: Child | None, last_words: str, killed: list[str]) -> int:
    if dead is not None:
        write_error(f"tissue_sim demo: the {dead.name} ended by itself, {last_words}\n")
    for name in killed:
        write_error(f"tissue_sim demo: the {name} did not end and was killed\n")
    has_bag = bool(watch.bag) and Path(watch.bag).is_dir()
    if dead is None and not watch.node_up and not has_bag:
        write_error("tissue_sim demo: stopped before the node was up; no bag was recorded\n")
        return INTERRUPTED
    if has_bag:
        print(f"bag: {watch.bag}\nreplay it with: {_program()} replay {shlex.quote(watch.bag)}", flush=True)
    elif dead is None:
        write_error("tissue_sim demo: the node recorded no bag\n")
        return 1
    return 1 if dead is not None or killed else 0


def _program() -> str:
    """Return how this was started, for a command line that works where this one did."""
    called = Path(sys.argv[0])
    return str(called) if called.name == "tissue_sim" and shutil.which(called.name) is None else "tissue_sim"


def _command(*words: str) -> list[str]:
    return [sys.executable, "-m", "tissue_sim", *words]
