"""Parameters of a running node, for the programs beside it; requested without waiting."""

from __future__ import annotations

import time
from collections.abc import Sequence

from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.task import Future

from tissue_sim.json_types import JsonObject
from tissue_sim.ros.shared.client import client_node, node_beside, wait_until
from tissue_sim.ros.shared.parameter_specs import NODE_SPECS, ORGANS, TOOL_SPECS

NODE_NAMES = ("tools", ORGANS, *(spec.name for spec in NODE_SPECS))
ASK_AGAIN = 1.0  # s; a server drops the answer to a client that it has not discovered completely


class NodeParameters:
    """Parameters of the node `target` and of its tools, read for the node `client`.

    It has a node of its own, for an executor that handles nothing but the answers.
    """

    def __init__(self, client: Node, target: str) -> None:
        self._node = node_beside(client, "parameters")
        self._client = self._node.create_client(GetParameters, f"/{target}/get_parameters")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._values: JsonObject = {}
        self._to_ask: list[Sequence[str]] = []
        self._pending: Future | None = None
        self._asked = 0.0  # monotonic s
        self.ask()

    def ask(self) -> None:
        """Read all of them again."""
        self._values, self._to_ask = {}, [NODE_NAMES]
        self._forget()

    def poll(self) -> JsonObject | None:
        """Return all of them by name, once they have come after `ask`; before and afterwards None."""
        if not self._to_ask:
            return None
        if self._pending is not None:
            self._executor.spin_once(timeout_sec=0.0)
            if self._pending.done():
                self._take(self._to_ask.pop(0), self._pending.result().values)
                self._pending = None
                if not self._to_ask:
                    return self._values
        if self._pending is None or time.monotonic() - self._asked > ASK_AGAIN:
            self._forget()
            if self._client.service_is_ready():
                self._pending = self._client.call_async(GetParameters.Request(names=self._to_ask[0]))
                self._asked = time.monotonic()
        return None

    def _take(self, names: Sequence[str], values: Sequence[ParameterValue]) -> None:
        # A node that lacks one of them returns none: then nothing is known about it.
        found = dict(zip(names, map(parameter_value_to_python, values), strict=False))
        self._values |= found
        if names is NODE_NAMES:
            self._to_ask += [[f"{tool}.{spec.name}" for spec in TOOL_SPECS] for tool in found.get("tools", ())]

    def _forget(self) -> None:
        if self._pending is not None:
            self._client.remove_pending_request(self._pending)
            self._pending = None


def parameters_of(target: str, asker: str, longest: float) -> JsonObject | None:
    """Return the parameters of a node; None where it doesn't answer in time.

    asker: name of the asking node; longest: that time, s.
    """
    with client_node(asker, target) as own:
        return wait_until(NodeParameters(own, target).poll, longest) or None
