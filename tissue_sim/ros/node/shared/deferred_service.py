"""A service that may answer later, from a thread of its own.

rclpy's executors wait for a callback's response before they handle anything else, and its EventsExecutor awaits no
coroutine; so the response is held back where the executor would send it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from tissue_sim.ros.node.shared.guarded_node import GuardedNode, failed

Work = Callable[[], None]  # fills in a response


class DeferredService[Request, Response]:
    """Service whose `begin` is called with a request and its response by the executor.

    What it returns is done in a thread of its own before the response is sent; None: the response is complete.
    """

    def __init__(
        self, node: GuardedNode, kind: type, name: str, begin: Callable[[Request, Response], Work | None]
    ) -> None:
        self._node, self._begin = node, begin
        self._works: dict[int, tuple[Work, Request]] = {}  # with its request, by the identity of the response
        service = node.create_service(kind, name, self._on_request)
        self._send = service.send_response
        service.send_response = self._on_response  # type: ignore[method-assign, assignment]

    def _on_request(self, request: Request, response: Response) -> Response:
        work = self._begin(request, response)
        if work is not None:
            self._works[id(response)] = work, request
        return response

    def _on_response(self, response: Response, header: object) -> None:
        found = self._works.pop(id(response), None)
        if found is None:
            self._send(response, header)
        else:
            threading.Thread(target=self._finish, args=(*found, response, header), daemon=True).start()

    def _finish(self, work: Work, request: Request, response: Response, header: object) -> None:
        try:
            work()
        except Exception as error:  # of any kind: the caller gets the message
            response = failed(type(response)(), request, self._node.unexpected_errors.note(error))
        with self._node.unexpected_errors.noted():
            self._send(response, header)
