"""A ROS graph of its own for a benchmark: the node and its references, as processes that end with it."""

from __future__ import annotations

import importlib.util
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Self

from tissue_sim.environment import environment
from tissue_sim.errors import UserError
from tissue_sim.ros.shared.children import Child
from tissue_sim.ros.shared.domains import claim_domain

if TYPE_CHECKING:
    from rclpy.node import Node

NODE = "tissue_sim"
START_TIME = 240.0  # s for the node to start, with kernels to compile


def check_rclpy() -> None:
    """Raise UserError when rclpy is not installed."""
    if importlib.util.find_spec("rclpy") is None:
        raise UserError("this benchmark needs rclpy: pip install 'tissue_sim[ros]', or source a ROS 2")


def first_within[Found](find: Callable[[], Found | None], seconds: float, problem: str) -> Found:
    """Return the first answer that is true.

    find: gives an answer; seconds: time for it, s; problem: what is wrong without one. Raises UserError when there is
    none in time.
    """
    end = time.monotonic() + seconds
    while not (found := find()):
        if time.monotonic() > end:
            raise UserError(f"{problem} within {seconds:g} s")
        time.sleep(0.002)
    return found


class Graph(ExitStack):
    """Context in which this process and its children are in a ROS domain of their own.

    The children end with it.

    reach: range of discovery, LOCALHOST or SUBNET. Raises UserError when rclpy is not installed or no domain is free.
    """

    def __init__(self, reach: str = "LOCALHOST") -> None:
        super().__init__()
        check_rclpy()
        domain, claim = claim_domain()
        self.enter_context(claim)
        self._place = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": reach}

    def __enter__(self) -> Self:
        self.enter_context(environment(self._place))
        return super().__enter__()

    def start(
        self,
        module: str,
        *words: str,
        within: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
    ) -> Child:
        """Start a module of tissue_sim.ros as a program.

        module: its name below tissue_sim.ros; within: the command, if any, that runs it.
        """
        command = [*within, sys.executable, "-m", f"tissue_sim.ros.{module}", *words]
        return self._begin(module.rpartition(".")[2], command, environment)

    def start_command(self, name: str, *words: str) -> Child:
        """Start a command of tissue_sim."""
        return self._begin(name, [sys.executable, "-m", "tissue_sim", name, *words])

    def _begin(self, name: str, command: Sequence[str], environment: Mapping[str, str] | None = None) -> Child:
        child = Child(name, command, {**(environment or os.environ), **self._place})
        self.callback(child.stop)
        return child

    def start_node(
        self,
        organ_file: str,
        *parameters: str,
        within: Sequence[str] = (),
        environment: Mapping[str, str] | None = None,
    ) -> Child:
        """Start the node with an organ and parameters like `rate:=500.0`.

        within: the command, if any, that runs it.
        """
        return self.serve(f"organ_file:={organ_file}", *parameters, within=within, environment=environment)

    def client(self, name: str) -> Node:
        """Return an rclpy node of this process, of that name, in the namespace of the node."""
        from tissue_sim.ros.shared.client import client_node

        return self.enter_context(client_node(name, NODE))

    def serve(
        self, *parameters: str, within: Sequence[str] = (), environment: Mapping[str, str] | None = None
    ) -> Child:
        """Start the node with parameters, of which one names its organ or scene.

        within: the command, if any, that runs it.
        """
        words = [word for parameter in parameters for word in ("-p", parameter)]
        return self.start("node.program", "--ros-args", *words, within=within, environment=environment)


def ticks(node: Child) -> None:
    """Return when the node has done its first tick. Raises UserError when it ends, or has not for START_TIME."""

    def has_ticked() -> bool:
        if node.exit_code is not None:
            raise UserError(f"the node did not start: {node.last_words()}")
        return any("surface nodes" in line for line in (*node.output, *node.errors))

    first_within(has_ticked, START_TIME, "the node did not tick")


def last_line(child: Child) -> str:
    """Return the last line that a process has printed, when it has ended. Raises UserError when it failed."""
    first_within(lambda: child.exit_code is not None, START_TIME, f"the {child.name} did not end")
    words = child.last_words()
    if child.exit_code:
        raise UserError(f"the {child.name} failed, {words}")
    return child.output[-1] if child.output else ""
