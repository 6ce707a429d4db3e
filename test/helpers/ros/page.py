"""The viewer of a node without a browser: a hand on its page, and the nodes that it looks at."""

import asyncio
import time
from collections.abc import Callable
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import viser
from rclpy.node import Node

from tissue_sim.ros.viewer.loop import Viewer

HAND = 7  # the browser's number


class Page:
    """The viewer of a node with one browser, which this stands in for."""

    def __init__(self, graph: Node, *tools: str) -> None:
        self.server = viser.ViserServer(host="127.0.0.1", port=8000 + time.monotonic_ns() % 900, verbose=False)
        hand = MagicMock()
        self.server.get_clients = lambda: {HAND: hand}
        self.viewer = Viewer(self.server, graph, "tissue_sim", tools)
        (self.poke, *_), (self.view, *_) = self.viewer.tools.pokes, self.viewer.tools.views

    def close(self) -> None:
        self.viewer.close()
        self.server.stop()

    def wait(self, done: Callable[[], bool], timeout: float) -> bool:
        """Whether something is so in time, while pictures are drawn at 30 Hz."""
        end = time.monotonic() + timeout
        while not done() and time.monotonic() < end:
            self.viewer.update()
            time.sleep(1.0 / 30.0)
        return done()

    def tick(self, on: bool) -> None:
        self.poke._box.value = on
        self.poke._on_box(SimpleNamespace(client_id=HAND))

    def drag(self, place: np.ndarray) -> None:
        asyncio.run(self.poke._on_gizmo(SimpleNamespace(target=SimpleNamespace(position=place))))

    def slide(self, degrees: float) -> None:
        slider = self.poke.jaws._slider
        slider.value = degrees
        asyncio.run(self.poke.jaws._on_slider(SimpleNamespace(client_id=HAND, target=slider)))

    def force(self) -> float:
        return self.view.force or 0.0
