"""Command `tissue_sim policy`: what DDS Security (sros2) has to allow a node and the programs beside it."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.organ_topics import path_of

if TYPE_CHECKING:
    from tissue_sim.ros.shared.tool_link import ToolLink

VERSION = "0.2.0"  # of sros2's format
WAIT = 15.0  # s for the node to answer with its parameters
ABOUT = " Printed by `tissue_sim policy` for a running node; read by `ros2 security generate_artifacts -p`. "
DRIVER = "drive"  # node of a learned policy
PARAMETER_SERVICES = (
    *("describe_parameters", "get_parameter_types", "get_parameters", "list_parameters"),
    *("set_parameters", "set_parameters_atomically"),
)
OF_EVERY_NODE = "get_type_description"


@dataclass(frozen=True)
class Allowed:
    """Permissions of a process, by absolute names.

    Attributes
    ----------
    node : str
        Name that its policy is noted under.
    nodes : Sequence[str]
        Names of all its nodes.
    publish : Iterable[str]
        Topics that it publishes.
    subscribe : Iterable[str]
        Topics that it subscribes.
    reply : Iterable[str]
        Services that it answers.
    request : Iterable[str]
        Services that it calls.
    """

    node: str
    nodes: Sequence[str]
    publish: Iterable[str] = ()
    subscribe: Iterable[str] = ()
    reply: Iterable[str] = ()
    request: Iterable[str] = ()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--node", type=client.node_name, default="tissue_sim", help="name of the running node")


def run(args: argparse.Namespace) -> int:
    """Print the policy that fits a node as it answers now; return 0. Raises UserError when it doesn't answer."""
    from tissue_sim.ros.shared.node_parameters import parameters_of

    values = parameters_of(args.node, "policy", WAIT)
    if values is None:
        raise UserError(f"/{args.node} doesn't answer; start it as it will run, without security, and try again")
    print(fitted(args.node, values), end="")
    return 0


def fitted(node: str, values: JsonObject) -> str:
    """Return the policy, XML, for a node of this name (with its namespace) and these parameters."""
    root = ElementTree.Element("policy", version=VERSION)
    root.append(ElementTree.Comment(ABOUT))
    enclaves = ElementTree.SubElement(root, "enclaves")
    for path, allowed in enclaves_of(node, values).items():
        profiles = ElementTree.SubElement(ElementTree.SubElement(enclaves, "enclave", path=path), "profiles")
        _write(profiles, allowed)
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def enclaves_of(node: str, values: JsonObject) -> dict[str, Allowed]:
    """Return what each process may do, by its enclave."""
    from tissue_sim.ros.camera.topic_names import CAMERA, EYES, NODES, POSE, TOPICS
    from tissue_sim.ros.node.services.simulation_services import SERVICES
    from tissue_sim.ros.shared.tool_link import ToolLink

    links = [link for tool in values["tools"] if (link := ToolLink.from_parameters(values, tool, node)) is not None]
    namespace = f"/{node}".rpartition("/")[0]
    poses = [name for link in links for name in _topics(namespace, link, "measured_cp", "measured_js")]
    forces = [name for link in links for name in _topics(namespace, link, "external_cf")]
    wrenches = [name for link in links for name in _topics(namespace, link, "servo_cf")]
    own = f"/{node}"
    shown = _of_organs(own, values, "inclusions", "mesh", "skeleton", "surface")
    cut = _of_organs(own, values, "cuts", "mesh_version")
    if values["organs"]:
        shown += _below(own, "ligaments")
    return {
        own: Allowed(
            own,
            [own],
            # tf and simulation_interfaces where they are installed, and the clock with use_sim_time.
            [*wrenches, *shown, *cut, *_of_organs(own, values, "markers"), *_below(own, "markers", "tools", "ready")]
            + _below(own, *(f"{tool}/{topic}" for tool in values["tools"] for topic in ("contacts", "wrench")))
            + ["/diagnostics", "/rosout", "/tf", "/tf_static"],
            [
                *poses,
                *forces,
                "/clock",
                "/tf",
                "/tf_static",
                *_below(own, *(["respiration"] if values["organs"] else [])),
                *_below(own, *(f"{tool}/enable" for tool in values["tools"])),
                *_of_organs(own, values, "cut_path"),
            ],
            [
                *_below(own, "pause", "record", "reset", "step", *SERVICES, *PARAMETER_SERVICES),
                *_of_organs(own, values, "cut"),
            ],
        ),
        f"{own}/bridge": Allowed(
            f"{namespace}/haptic_bridge",
            [f"{namespace}/haptic_bridge", f"{namespace}/haptic_bridge_parameters"],
            [*poses, *forces],
            [*wrenches, *_of_organs(own, values, "mesh"), "/diagnostics"],
            (),
            [f"{own}/get_parameters"],
        ),
        f"{own}/drive": Allowed(
            f"{namespace}/{DRIVER}",
            [f"{namespace}/{DRIVER}", f"{namespace}/{DRIVER}_parameters"],
            poses,  # of the tool that it is given
            [*wrenches, *_of_organs(own, values, "mesh", "surface")]
            + _below(own, *(f"{tool}/wrench" for tool in values["tools"])),
            (),
            [f"{own}/get_parameters"],
        ),
        f"{own}/viewer": Allowed(
            f"{namespace}/viewer",
            [f"{namespace}/viewer{part}" for part in ("", "_parameters", "_services")],
            poses,  # its page pokes
            [*shown, f"{own}/tools", "/diagnostics"],
            (),
            _below(own, "get_parameters", "record", "reset"),
        ),
        f"{own}/camera": Allowed(
            f"{namespace}/{CAMERA}",
            [f"{namespace}/{CAMERA}{part}" for part in NODES],
            # Those of a single camera and of a pair; a topic of its pose has a name of the user's.
            [path_of(f"{namespace}/{CAMERA}", eye) + f"/{topic}" for eye in ("", *EYES) for topic in TOPICS]
            + [f"{namespace}/{CAMERA}/{POSE}", "/diagnostics", "/tf", "/tf_static"],
            [
                *_of_organs(own, values, "mesh", "surface", "inclusions"),
                *(f"{own}/{topic}" for topic in ("ligaments", "tools")),
                *("/diagnostics", "/tf", "/tf_static"),
            ],
            (),
            [f"{own}/get_parameters"],
        ),
    }


def _topics(namespace: str, link: ToolLink, *topics: str) -> list[str]:
    """Return the absolute names of those of a tool's topics that it has; measured_js only of a gripper."""
    names = [link.topics.names[topic] for topic in topics if topic != "measured_js" or link.tool.has_jaws]
    return [name if name.startswith("/") else f"{namespace}/{name}" for name in names if name]


def _of_organs(own: str, values: JsonObject, *names: str) -> list[str]:
    """Return topics of every organ: below its name in a scene."""
    return [topic for organ in [*values["organs"]] or [""] for topic in _below(path_of(own, organ), *names)]


def _below(own: str, *names: str) -> list[str]:
    return [f"{own}/{name}" for name in names]


def _write(profiles: ElementTree.Element, allowed: Allowed) -> None:
    namespace, _, name = allowed.node.rpartition("/")
    profile = ElementTree.SubElement(profiles, "profile", ns=namespace or "/", node=name)
    described = [f"{node}/{OF_EVERY_NODE}" for node in allowed.nodes]
    for kind, verb, names in (
        ("topic", "publish", [*allowed.publish, "/parameter_events"]),
        ("topic", "subscribe", allowed.subscribe),
        ("service", "reply", [*allowed.reply, *described]),
        ("service", "request", allowed.request),
    ):
        if wanted := sorted(set(names)):
            listed = ElementTree.SubElement(profile, f"{kind}s", {verb: "ALLOW"})
            for one in wanted:
                ElementTree.SubElement(listed, kind).text = one
