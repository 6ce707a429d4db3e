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
    allowed = _Permissions(node, values)
    return {
        allowed.own: allowed.node(),
        f"{allowed.own}/bridge": allowed.bridge(),
        f"{allowed.own}/drive": allowed.driver(),
        f"{allowed.own}/viewer": allowed.viewer(),
        f"{allowed.own}/camera": allowed.camera(),
    }


class _Permissions:
    """Names of a node's topics and services, and what each process may do with them."""

    def __init__(self, node: str, values: JsonObject) -> None:
        from tissue_sim.ros.shared.tool_link import ToolLink

        self.own, self._namespace, self._values = f"/{node}", f"/{node}".rpartition("/")[0], values
        links = [link for tool in values["tools"] if (link := ToolLink.from_parameters(values, tool, node)) is not None]
        self._poses = [name for link in links for name in self._topics(link, "measured_cp", "measured_js")]
        self._forces = [name for link in links for name in self._topics(link, "external_cf")]
        self._wrenches = [name for link in links for name in self._topics(link, "servo_cf")]
        self._shown = self._of_organs("inclusions", "mesh", "skeleton", "surface")
        if values["organs"]:
            self._shown += self._below("ligaments")

    def node(self) -> Allowed:
        """Return what the node may do with tf and simulation_interfaces, where they are installed, and with /clock."""
        from tissue_sim.ros.node.services.simulation_services import SERVICES

        return Allowed(
            self.own,
            [self.own],
            [
                *self._wrenches,
                *self._shown,
                *self._of_organs("cuts", "mesh_version", "markers"),
                *self._below("markers", "tools", "ready"),
                *self._of_tools("contacts", "wrench"),
                *("/diagnostics", "/rosout", "/tf", "/tf_static"),
            ],
            [
                *self._poses,
                *self._forces,
                *("/clock", "/tf", "/tf_static"),
                *self._below(*(["respiration"] if self._values["organs"] else [])),
                *self._of_tools("enable"),
                *self._of_organs("cut_path"),
            ],
            [
                *self._below("pause", "record", "reset", "step", *SERVICES, *PARAMETER_SERVICES),
                *self._of_organs("cut"),
            ],
        )

    def bridge(self) -> Allowed:
        """Return what the scripted bridge may do."""
        name = f"{self._namespace}/haptic_bridge"
        return Allowed(
            name,
            [name, f"{name}_parameters"],
            [*self._poses, *self._forces],
            [*self._wrenches, *self._of_organs("mesh"), "/diagnostics"],
            (),
            self._below("get_parameters"),
        )

    def driver(self) -> Allowed:
        """Return what may drive a tool: it sends poses of the one that it is given."""
        name = f"{self._namespace}/{DRIVER}"
        return Allowed(
            name,
            [name, f"{name}_parameters"],
            self._poses,
            [*self._wrenches, *self._of_organs("mesh", "surface"), *self._of_tools("wrench")],
            (),
            self._below("get_parameters"),
        )

    def viewer(self) -> Allowed:
        """Return what the viewer may do, whose page pokes."""
        name = f"{self._namespace}/viewer"
        return Allowed(
            name,
            [f"{name}{part}" for part in ("", "_parameters", "_services")],
            self._poses,
            [*self._shown, *self._below("tools"), "/diagnostics"],
            (),
            self._below("get_parameters", "record", "reset"),
        )

    def camera(self) -> Allowed:
        """Return what a camera or a pair of them may do; a topic of its pose has a name of the user's."""
        from tissue_sim.ros.camera.topic_names import CAMERA, EYES, NODES, POSE, TOPICS

        name = f"{self._namespace}/{CAMERA}"
        return Allowed(
            name,
            [f"{name}{part}" for part in NODES],
            [
                *(f"{path_of(name, eye)}/{topic}" for eye in ("", *EYES) for topic in TOPICS),
                *(f"{name}/{POSE}", "/diagnostics", "/tf", "/tf_static"),
            ],
            [
                *self._of_organs("mesh", "surface", "inclusions"),
                *self._below("ligaments", "tools"),
                *("/diagnostics", "/tf", "/tf_static"),
            ],
            (),
            self._below("get_parameters"),
        )

    def _topics(self, link: ToolLink, *topics: str) -> list[str]:
        """Return the absolute names of those of a tool's topics that it has; measured_js only of a gripper."""
        names = [link.topics.names[topic] for topic in topics if topic != "measured_js" or link.tool.has_jaws]
        return [name if name.startswith("/") else f"{self._namespace}/{name}" for name in names if name]

    def _of_organs(self, *names: str) -> list[str]:
        """Return topics of every organ: below its name in a scene."""
        organs = [*self._values["organs"]] or [""]
        return [f"{path_of(self.own, organ)}/{name}" for organ in organs for name in names]

    def _of_tools(self, *names: str) -> list[str]:
        return [f"{self.own}/{tool}/{name}" for tool in self._values["tools"] for name in names]

    def _below(self, *names: str) -> list[str]:
        return [f"{self.own}/{name}" for name in names]


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
