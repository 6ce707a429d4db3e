"""The viewer of a node without a browser: a hand on its page, and the nodes that it looks at."""

import asyncio
import itertools
import time
from collections.abc import Callable
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import viser
from rclpy.node import Node

from helpers.patience import LIMIT
from helpers.ros.participant import Participant
from helpers.ros.processes import shipped
from tissue_sim.ports import free_port
from tissue_sim.ros.viewer.loop import Viewer
from tissue_sim.ros.viewer.poke import beside
from tissue_sim.ros.viewer.view import PATIENCE

HAND = 7  # the browser's number


class Page:
    """The viewer of a node with one browser, which this stands in for."""

    def __init__(self, graph: Node, *tools: str) -> None:
        self.server = viser.ViserServer(host="127.0.0.1", port=free_port(), verbose=False)
        camera = SimpleNamespace(position=np.array([0.0, -0.5, 0.0]), look_at=None, image_width=1200, image_height=800)
        hand = MagicMock(camera=camera)
        self.server.get_clients = lambda: {HAND: hand}
        self.viewer = Viewer(self.server, graph, "tissue_sim", tools, PATIENCE)
        (self.poke, *_), (self.view, *_) = self.viewer.tools.pokes, self.viewer.tools.views

    def close(self) -> None:
        self.viewer.close()
        self.server.stop()

    def wait(self, done: Callable[[], bool], timeout: float = LIMIT) -> bool:
        """Whether something becomes so, while pictures are drawn at 30 Hz."""
        end = time.monotonic() + timeout
        while not (found := done()) and time.monotonic() < end:
            self.viewer.update()
            time.sleep(1.0 / 30.0)
        return bool(found)

    def tick(self, on: bool) -> None:
        self.poke._box.value = on
        self.poke._on_box(SimpleNamespace(client_id=HAND))

    def drag(self, place: np.ndarray) -> None:
        asyncio.run(self.poke._on_gizmo(SimpleNamespace(target=SimpleNamespace(position=place))))

    def slide(self, degrees: float) -> None:
        slider = self.poke.jaws._slider
        slider.value = degrees
        asyncio.run(self.poke.jaws._on_slider(SimpleNamespace(client_id=HAND, target=slider)))

    def press_and_release(self) -> None:
        """Take up the tool, press the shipped organ until there is a force, release the tool."""
        assert self.wait(lambda: not self.poke._box.disabled)
        self.tick(True)
        assert self.wait(lambda: self.poke._tool.held and self.view.force is not None)
        assert self.force() == 0.0, "taken in hand outside the organ"
        assert not self.poke._warning.visible
        position, inward = beside(shipped().surface_positions, 0, self.view.reach)
        depths = itertools.cycle([*np.linspace(0.0, 0.024, 60), *[0.024] * 60, *np.linspace(0.024, 0.0, 30)])

        def has_force() -> bool:
            """Again from outside where a busy machine held the poses up, so that the node holds the tool off."""
            self.drag(position + next(depths) * inward)
            return self.wait(lambda: self.force() > 0.1, 0.03)

        assert self.wait(has_force), "no force came"
        self.tick(False)
        participant = Participant("hand")
        try:
            assert participant.set_parameter("stale_time", 0.3).successful
            assert self.wait(lambda: self.force() == 0.0), "it is not released"
            assert participant.set_parameter("stale_time", 5.0).successful
        finally:
            participant.close()

    def force(self) -> float:
        return self.view.force or 0.0
