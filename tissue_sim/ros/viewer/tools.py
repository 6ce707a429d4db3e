"""The page's parts for the tools: their shapes, controls for poking with them, the plot of their forces."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import viser
from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from tissue_sim.array_types import Floats
from tissue_sim.json_types import JsonObject
from tissue_sim.ros.shared.tool_link import ToolLink
from tissue_sim.ros.viewer.plot import ForcePlot
from tissue_sim.ros.viewer.poke import Poke
from tissue_sim.ros.viewer.tool_view import ToolView

SILENT_AFTER = 3.0  # s without markers, or without diagnostics


class ToolsView:
    """The tools of the node `target`: those named, or else all that its markers show.

    Parameters
    ----------
    server : viser.ViserServer
        The viser server.
    node : Node
        The rclpy node that publishes.
    target : str
        Name of the viewed node.
    names : tuple[str, ...] | None
        Names of the tools.
    patience : float, s, optional
        As in `Poke`.

    Attributes
    ----------
    views
        View of each tool.
    pokes
        Control of each tool.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        node: Node,
        target: str,
        names: tuple[str, ...] | None,
        patience: float,
    ) -> None:
        self._server, self._node, self._target, self._follows = server, node, target, names is None
        self._names: tuple[str, ...] = ()
        self._patience = patience
        self.views: list[ToolView] = []
        self.pokes: list[Poke] = []
        self._plot: ForcePlot | None = None
        self._parameters: JsonObject | None = None
        self._last_message = -np.inf
        if names is not None:
            self._make(names)

    def take(self, message: MarkerArray | None, now: float) -> None:
        """Show the node's newest markers at a time, s, if there are new ones."""
        if message is None:
            if now - self._last_message > SILENT_AFTER:
                for view in self.views:
                    view.hide()
            return
        self._last_message = now
        names = tuple(dict.fromkeys(marker.ns for marker in message.markers))
        if self._follows and names != self._names:
            self._make(names)
        for view in self.views:
            view.show([marker for marker in message.markers if marker.ns == view.name])

    def use(self, parameters: JsonObject) -> None:
        """Use the links to the tools in the node's parameters."""
        self._parameters = parameters
        for poke in self.pokes:
            poke.use(ToolLink.from_parameters(parameters, poke.name, self._target))

    def update(self, now: float, watchers: Collection[int], points: Floats | None, frame_id: str) -> None:
        """Apply the requests of the page.

        now: the present time, s; watchers: ids of the browsers that look; points (n, 3) m: points of the organ in a
        frame, or None without one.
        """
        for poke in self.pokes:
            poke.update(now, watchers, points, frame_id)
        if self._plot is not None:
            self._plot.update(now, {view.name: view.force for view in self.views}, bool(watchers))

    def close(self) -> None:
        """Release every tool."""
        for poke in self.pokes:
            poke.close()

    def _make(self, names: tuple[str, ...]) -> None:
        gone: list[Poke | ToolView | ForcePlot] = [*self.pokes, *self.views]
        for part in gone + ([self._plot] if self._plot is not None else []):
            part.remove()
        self._names = names
        self.views = [ToolView(self._server, name, index) for index, name in enumerate(names)]
        self.pokes = [
            Poke(self._server, self._node, view, index, self._patience) for index, view in enumerate(self.views)
        ]
        self._plot = ForcePlot(self._server, names) if names else None
        if self._parameters is not None:
            self.use(self._parameters)
