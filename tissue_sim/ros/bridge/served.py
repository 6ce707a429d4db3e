"""The node that a bridge meets: its parameters, and the mesh of its organ."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, NamedTuple

from tissue_sim import progress
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.ros.shared import client
from tissue_sim.unexpected_errors import write_error

if TYPE_CHECKING:
    from rclpy.node import Node
    from shape_msgs.msg import Mesh

    from tissue_sim.ros.shared.node_parameters import NodeParameters


class Served(NamedTuple):
    """What a node serves: its parameters' values, the prefix of the organ's topics, and the organ's meshes."""

    values: JsonObject
    prefix: str
    meshes: client.NewestMessage
    mesh: Mesh


def served_by(node: Node, args: argparse.Namespace, parameters: NodeParameters, stop: client.Stop) -> Served | None:
    """Return what the node serves; None after a line on the standard error, when a signal came or it doesn't answer.

    args: arguments `node`, `organ` and `wait` of the command, and `command`, its name; stop: whether a signal has come.
    Raises UserError for an organ that the node doesn't have.
    """
    from shape_msgs.msg import Mesh

    with progress.task(f"waiting for /{args.node}"):
        values = client.wait_until(parameters.poll, args.wait, stop)
    if values is None:
        write_missing(args, f"answer from /{args.node}/get_parameters", stop)
        return None
    prefix = f"/{args.node}/{_organ_of(values, args)}"
    meshes = client.NewestMessage(node, Mesh, f"{prefix}mesh", client.latched_qos())
    with progress.task(f"waiting for {prefix}mesh"):
        mesh = client.wait_until(meshes.take, args.wait, stop)
    if mesh is None:
        write_missing(args, f"mesh on {prefix}mesh", stop)
        return None
    return Served(values, prefix, meshes, mesh)


def write_missing(args: argparse.Namespace, what: str, stop: client.Stop) -> None:
    """Write a line about what the node hasn't sent within --wait, or until a signal came."""
    if stop:
        line = f"stopped; there was no {what} so far"
    else:
        line = f"no {what} within {args.wait:g} s; start tissue_node, or name yours with --node"
    write_error(f"tissue_sim {args.command}: {line}\n")


def _organ_of(values: JsonObject, args: argparse.Namespace) -> str:
    """Return the prefix of the organ's topics below the node's name: in a scene its name."""
    from tissue_sim.ros.shared.parameter_specs import ORGANS

    names = list(values.get(ORGANS, ()))  # a node without this parameter has one organ
    if args.organ and args.organ not in names:
        there = f"it serves {', '.join(names)}" if names else "it serves one organ, without a name"
        raise UserError(f"/{args.node} has no organ '{args.organ}': {there}")
    return f"{args.organ or names[0]}/" if names else ""
