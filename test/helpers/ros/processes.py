"""Real processes for the tests: the node, and a second one that publishes tool poses."""

from __future__ import annotations

import atexit
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from helpers.patience import LIMIT, wait_for
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

if TYPE_CHECKING:
    from helpers.ros.clients import Client

HERE = Path(__file__).parent
PUBLISHER, WATCHER, STAND_IN, LATE_NODE = (
    str(HERE / f"{name}.py") for name in ("publish_poses", "watch_surface", "stand_in", "late_node")
)
FAKE_TF = HERE / "fake_tf"  # a folder for PYTHONPATH
OLD_RCLPY = str(HERE / "old_rclpy")  # another one
READY = "surface nodes"  # in the line that the node logs when its first tick is done
PUSHED = "left.external_cf:=left/external_cf"  # the left tool takes external forces
UNHURRIED = "stale_time:=5.0"  # a busy machine is no stale hand
SOON_STALE = "stale_time:=1.0"  # where a test waits for a tool to go stale


class Process:
    """A child process with its output in a file."""

    def __init__(self, words: list[str], log: Path, program: str = sys.executable, **environment: str) -> None:
        self.log = log
        self._stream = log.open("w")
        self.child = subprocess.Popen(
            [program, *words],
            stdout=self._stream,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            env=os.environ | environment,
        )
        atexit.register(self.child.kill)  # a test that fails leaves nothing running

    def text(self) -> str:
        return self.log.read_text()

    def says(self, words: str) -> bool:
        """Whether it has said something; fails when it has ended without that."""
        ended = self.child.poll() is not None  # before its words are read
        if words in self.text():
            return True
        assert not ended, f"ended with {self.child.returncode}, without '{words}':\n{self.text()}"
        return False

    def wait_for(self, words: str) -> None:
        wait_for(lambda: self.says(words), lambda: f"no '{words}':\n{self.text()}")

    def wait(self) -> int:
        """Its exit code, once it has ended by itself."""
        return self.child.wait(LIMIT)

    def stop(self, number: int = signal.SIGINT) -> int:
        if self.child.poll() is None:
            self.child.send_signal(number)
        try:
            return self.child.wait(LIMIT)
        finally:
            self.child.kill()
            self._stream.close()


def start_node(
    folder: Path,
    *parameters: str,
    wait: bool = True,
    remap: tuple[str, ...] = (),
    profile: Path | None = None,
    **environment: str,
) -> Process:
    """A node with a profile's parameters and some like `rate:=500.0`, remaps like `__ns:=/a`; waits until it ticks."""
    words = ["-m", "tissue_sim.ros.node.program", "--ros-args"]
    if profile is not None:
        words += ["--params-file", str(profile)]
    for rule in remap:
        words += ["-r", rule]
    for parameter in parameters:
        words += ["-p", parameter]
    process = Process(words, folder / "node.log", **environment)
    if wait:
        process.wait_for(READY)
    return process


@contextmanager
def running_node(folder: Path, *parameters: str, **environment: str) -> Iterator[Process]:
    """A node that ticks; at the end it has to go without an error."""
    process = start_node(folder, *parameters, **environment)
    yield process
    assert process.stop() == 0, process.text()
    assert "Traceback" not in process.text()


@contextmanager
def stopped(pid: int) -> Iterator[None]:
    """A process stands still meanwhile, however long a busy machine takes to stop it."""
    os.kill(pid, signal.SIGSTOP)
    threads = Path(f"/proc/{pid}/task")
    try:
        wait_for(lambda: all(one.read_text().rpartition(")")[2].split()[0] == "T" for one in threads.glob("*/stat")))
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def cut_process(node: Process) -> int:
    """Number of the process that makes a node's cuts, which it starts before the first one."""

    def found() -> list[int]:
        children = " ".join(one.read_text() for one in Path(f"/proc/{node.child.pid}/task").glob("*/children"))
        return [int(pid) for pid in children.split() if "cut_program" in Path(f"/proc/{pid}/cmdline").read_text()]

    return wait_for(found, "the node makes no cuts")[0]


def start_publisher(folder: Path, depth: float) -> Process:
    """A second process that presses the shipped kidney by depth m with tool `left`; on SIGTERM it leaves and ends."""
    return Process([PUBLISHER, f"--depth={depth}"], folder / "publisher.log")


def poke_path(organ: Organ, radius: float = 0.005) -> tuple[np.ndarray, np.ndarray]:
    """Where a sphere just touches the organ's side, (3,) m, and the direction into it."""
    points = organ.surface_positions
    centre = points.mean(axis=0)
    node = int(np.argmax(points[:, 0] - 0.5 * np.abs(points[:, 2] - centre[2])))
    inward = np.array([-1.0, 0.0, 0.0])
    return points[node] - radius * inward, inward


def press_until_contact(client: Client, move: Callable[[np.ndarray], None], deepest: float = 0.002) -> np.ndarray:
    """Press the left tool in until it feels the organ; returns where it is then, (3,) m.

    move sends a pose at a position and lets a moment pass. A machine that holds poses up has the tool held off; then it
    comes from outside again.
    """
    touch, inward = poke_path(shipped())
    end = time.monotonic() + LIMIT
    while time.monotonic() < end:
        for depth in [*np.linspace(-0.002, deepest, 60), *[deepest] * 60]:
            position = touch + depth * inward
            move(position)
            if depth > 0.9 * deepest and client.wrenches and client.wrenches[-1][1][0] > 0.02:
                return position
    raise AssertionError(f"the tool feels nothing: {client.diagnostics}")


def shipped() -> Organ:
    return Organ.load(shipped_organ())


def start_sabotaged(folder, *parameters):
    """A node that can be made to fail (sabotaged_node.py), ready."""
    words = [word for parameter in (SOON_STALE, *parameters) for word in ("-p", parameter)]
    process = Process([str(HERE / "sabotaged_node.py"), "--ros-args", *words], folder / "node.log")
    process.wait_for(READY)
    return process
