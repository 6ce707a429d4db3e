"""The node's run until it is asked to end."""

from __future__ import annotations

import sys
import threading

import rclpy
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from tissue_sim import progress
from tissue_sim.errors import UserError, shown, stop_output
from tissue_sim.ros.node.node import NAME, TissueNode
from tissue_sim.ros.shared import dds
from tissue_sim.ros.shared.executors import OLD_RCLPY, make_executor
from tissue_sim.ros.shared.parameter_specs import NODE_SPECS, TOOL_SPECS, Spec
from tissue_sim.ros.shared.shutdown_handler import Interrupted, ShutdownHandler
from tissue_sim.unexpected_errors import described, report_error, write_error
from tissue_sim.version import __version__

RCLError, UnknownROSArgsError = rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError
PROGRAM = "tissue_node"
# Options of rcl that users give without --ros-args before them.
ROS_OPTIONS = ("-p", "--param", "--params-file", "-r", "--remap", "-e", "--enclave", "--log-level")
SPIN, AFTER_FAILURE = 0.1, 0.01  # s for an event to come; s until the next try where rclpy fails
TURN = 0.0005  # s per turn of the GIL, a tenth of Python's own: a pose must not wait for diagnostics


class LoopEnded(Exception):
    """Error: the physics loop has ended, without which the node has no purpose."""


def serve(arguments: list[str], ending: ShutdownHandler) -> int:
    """Run the node until SIGINT or SIGTERM; to be called in the main thread.

    arguments: the program's name, and behind it ROS's arguments.
    """
    asked = {"-h": usage, "--help": usage, "--version": lambda: f"{PROGRAM} {__version__}"}
    for answer in (asked[word] for word in arguments[1:] if word in asked):
        try:
            print(answer(), flush=True)
        except BrokenPipeError:  # piped into head: the rest is not read
            stop_output()
        return 0
    sys.setswitchinterval(TURN)
    node = None
    try:
        dds.prepare()
        _start_rclpy(arguments)
        _check_own(arguments)
        progress.report_by(get_logger(NAME).info)
        with progress.task("starting"):
            node = TissueNode()
            executor = make_executor()
            if isinstance(executor, SingleThreadedExecutor):
                node.get_logger().warning(OLD_RCLPY)
            executor.add_node(node)
            node.start()
        progress.report_by(None)  # nothing of it runs beside the loop
        ending.started()
        _go_on(node, executor, ending)
        return 0
    except Interrupted:
        return 0
    except UserError as error:
        report_error(error, PROGRAM)
        return 2
    except LoopEnded as error:
        write_error(f"{PROGRAM}: error: internal: {error}\n")
        return 1
    finally:
        if node is not None:  # whatever ended it: no force is left standing, no bag open
            ending.closes()
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()


def _go_on(node: TissueNode, executor: Executor, ending: ShutdownHandler) -> None:
    """Spin until asked to end, whatever fails; raise LoopEnded when nothing ticks any more."""
    threading.excepthook = lambda given: _noted(node, given.exc_value)
    while not ending.asked.is_set():
        try:
            executor.spin_once(timeout_sec=SPIN)
        except Exception as error:  # of rclpy itself: callbacks are guarded
            node.unexpected_errors.note(error)
            ending.asked.wait(AFTER_FAILURE)
        if node.loop.ended:
            why = node.loop.failure
            raise LoopEnded("the physics loop ended" + (f": {described(why)}" if why is not None else ""))


def _noted(node: TissueNode, error: BaseException | None) -> None:
    if error is not None:
        node.unexpected_errors.note(error)


def usage() -> str:
    """Return the program's usage, with every parameter."""

    def line(prefix: str, spec: Spec) -> str:
        bounds = f" [{spec.low:g}..{spec.high:g}]" if spec.low is not None else ""
        if spec.choices:
            bounds = f" [{', '.join(spec.choices)}]"
        live = ", may change while running" if spec.live else ""
        return f"  {prefix}{spec.name} (default {spec.default!r}){bounds}{live}: {spec.text}"

    return "\n".join(
        [
            "usage: tissue_node [--help | --version]",
            "       tissue_node [--ros-args -p PARAMETER:=VALUE ... --params-file FILE -r OLD:=NEW ...]",
            "",
            "Serves a deformable organ at a fixed rate: tool poses in, wrenches and the deformed mesh out.",
            "Parameters (by default: the kidney of this package, 1000 Hz, spherical tools 'left' and 'right' of 5 mm):",
            *(line("", spec) for spec in NODE_SPECS),
            "  tools (default ['left', 'right']): names of the tools",
            *(line("<tool>.", spec) for spec in TOOL_SPECS),
        ]
    )


def _check_own(arguments: list[str]) -> None:
    """Raise UserError for arguments that are not ROS's: the node has no others."""
    own = remove_ros_args(args=arguments)[1:]
    if not own:
        return
    if own[0] in ROS_OPTIONS or ":=" in own[0]:
        meant = " ".join(own if own[0] in ROS_OPTIONS else ["-p", *own])
        raise UserError(
            f"'{shown(own[0])}' is an argument of ROS, which needs --ros-args: {PROGRAM} --ros-args {shown(meant, 200)}"
        )
    raise UserError(f"argument '{shown(own[0])}' is unknown; '{PROGRAM} --help' lists all arguments")


def _start_rclpy(arguments: list[str]) -> None:
    """Initialise rclpy; raise UserError for arguments that rcl can't use."""
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except UnknownROSArgsError as error:
        raise UserError(f"ROS does not know {shown(str(error).strip('[]'), 200)} behind --ros-args") from None
    except RCLError as error:
        reason = str(error).split(", at /")[0]  # the place in rcl's sources
        hint = "; write each number of a list as 0.0, not 0" if "same type" in reason else ""
        raise UserError(f"{reason}{hint}") from None
