"""Requests of the viewer's buttons to the node, without waiting for the answer."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable

from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from tissue_sim.ros.shared.client import node_beside
from tissue_sim.ros.viewer.panel import Request

PATIENCE = 5.0  # s


class Services:
    """Clients of the node's services `~/reset` and `~/record`.

    They have a node of their own, for an executor that handles nothing but their answers.
    """

    def __init__(self, viewer: Node, target: str) -> None:
        self._node = node_beside(viewer, "services")
        self._reset = self._node.create_client(Trigger, f"/{target}/reset")
        self._record = self._node.create_client(SetBool, f"/{target}/record")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._pending: list[tuple[Client, Future, Request, float]] = []

    def poll(self, requests: queue.SimpleQueue[Request], report: Callable[[str, bool], None]) -> None:
        """Send new requests and report the answers that have come.

        requests: the requests; report: takes a text, and whether the request was met.
        """
        while not requests.empty():
            request = requests.get()
            client = self._reset if request is Request.RESET else self._record
            if not client.service_is_ready():
                report(f"service {client.srv_name} is not available: {request.value} was not requested", False)
                continue
            sent = Trigger.Request() if request is Request.RESET else SetBool.Request(data=request is Request.RECORD)
            self._pending.append((client, client.call_async(sent), request, time.monotonic()))
        if not self._pending:
            return
        self._executor.spin_once(timeout_sec=0.0)
        waiting = []
        for client, future, request, asked in self._pending:
            if future.done():
                report(future.result().message, future.result().success)
            elif time.monotonic() - asked > PATIENCE:
                client.remove_pending_request(future)
                report(f"no answer to the request: {request.value}", False)
            else:
                waiting.append((client, future, request, asked))
        self._pending = waiting
