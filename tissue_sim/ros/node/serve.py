"""Runs the node until it is asked to end."""

from __future__ import annotations

import sys

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerOptions

from tissue_sim.errors import UserError, give_up_output
from tissue_sim.ros.node.node import TissueNode
from tissue_sim.ros.shared import dds
from tissue_sim.ros.shared.ending import Ending, Interrupted
from tissue_sim.ros.shared.executors import OLD_RCLPY, make_executor
from tissue_sim.ros.shared.parameters import NODE_SPECS, TOOL_SPECS, Spec

RCLError, UnknownROSArgsError = rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError
TURN = 0.0005  # s at the GIL, ten times shorter than Python's own: a pose must not wait for a diagnostics message


def serve(arguments: list[str], ending: Ending) -> int:
    """Run the node until SIGINT or SIGTERM; returns the exit code. To be called in the main thread.

    arguments: the program's name, and behind it what ROS takes.
    """
    if any(word in ("-h", "--help") for word in arguments[1:]):
        try:
            print(usage(), flush=True)
        except BrokenPipeError:  # piped into head: the rest has nowhere to go
            give_up_output()
        return 0
    sys.setswitchinterval(TURN)
    dds.prepare()
    node = None
    try:
        _start_rclpy(arguments)
        node = TissueNode()
        executor = make_executor()
        if isinstance(executor, SingleThreadedExecutor):
            node.get_logger().warning(OLD_RCLPY)
        executor.add_node(node)
        node.start()
        ending.started()
        while not ending.asked.is_set():
            executor.spin_once(timeout_sec=0.1)
        return 0
    except Interrupted:
        return 0
    except UserError as error:
        sys.stderr.write(f"tissue_node: error: {error}\n")
        return 2
    finally:
        if node is not None:  # whatever ended it: no force is left standing, no bag open
            ending.closes()
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()


def usage() -> str:
    """What the program takes, with every parameter."""

    def line(prefix: str, spec: Spec) -> str:
        bounds = f" [{spec.low:g}..{spec.high:g}]" if spec.low is not None else ""
        live = ", may change while running" if spec.live else ""
        return f"  {prefix}{spec.name} (default {spec.default!r}){bounds}{live}: {spec.text}"

    return "\n".join(
        [
            "usage: tissue_node [--ros-args -p PARAMETER:=VALUE ... --params-file FILE -r OLD:=NEW ...]",
            "",
            "Serves a deformable organ at a fixed rate: tool poses in, wrenches and the deformed mesh out.",
            "Parameters (defaults: the kidney that ships, 1000 Hz, spherical tools 'left' and 'right' of 5 mm):",
            *(line("", spec) for spec in NODE_SPECS),
            "  tools (default ['left', 'right']): names of the tools",
            *(line("<tool>.", spec) for spec in TOOL_SPECS),
        ]
    )


def _start_rclpy(arguments: list[str]) -> None:
    """Raises UserError for arguments that rcl can't use."""
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except (RCLError, UnknownROSArgsError) as error:
        reason = str(error).split(", at /")[0]  # where in rcl's sources
        hint = "; write each number of a list as 0.0, not 0" if "same type" in reason else ""
        raise UserError(f"{reason}{hint}") from None
