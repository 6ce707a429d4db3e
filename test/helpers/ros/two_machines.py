"""Two machines on one network, as two network namespaces."""

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from helpers.ros.processes import Process
from tissue_sim.ros.probes.lossy_link import ADDRESSES, Unavailable, lossy_link

ADDRESS = ADDRESSES[0]  # of the first


@contextmanager
def link_or_skip(loss: float = 0.0, delay: float = 0.0) -> Iterator[tuple[str, str]]:
    """As `lossy_link`; skips the test where there is none."""
    with ExitStack() as ending:
        try:
            ends = ending.enter_context(lossy_link(loss, delay))
        except Unavailable as reason:
            pytest.skip(f"no network namespaces here: {reason}")
        yield ends


@contextmanager
def two_machines(folder: Path, loss: float = 0.0, delay: float = 0.0) -> Iterator[tuple[str, str, Callable]]:
    """Both names, and start(machine, name, *words, **environment) for a Python process there with its log in a folder.

    loss: fraction of the packets; delay: s. Skips the test where there are no namespaces.
    """
    with ExitStack() as ending:
        here, there = ending.enter_context(link_or_skip(loss, delay))

        def start(machine: str, name: str, *words: str, **environment: str) -> Process:
            command = ["netns", "exec", machine, sys.executable, *words]
            process = Process(command, folder / f"{name}.log", program="ip", **environment)
            ending.callback(process.child.wait)
            ending.callback(process.child.kill)
            return process

        yield here, there, start
