"""The slider that opens and closes the jaws of a gripper or of scissors from the browser."""

from __future__ import annotations

import math
import time

import viser
from rclpy.node import Node

from tissue_sim.ros.shared.tool_link import ToolLink
from tissue_sim.ros.viewer.poked_jaws import PokedJaws
from tissue_sim.ros.viewer.tool_view import ToolView

WIDEST = 90.0  # degrees
STEP = 0.5  # degrees
UNTOUCHED = 1.0  # s after which the slider shows the jaws' angle again
JAWED = ("gripper", "scissors")  # whose jaws turn; the joint of an instrument may be a slide


class JawSlider:
    """Opening angle of a tool's jaws in degrees; not shown for a tool without.

    It shows the present angle, whoever moves the jaws, and publishes only the requests of somebody in a browser.
    """

    def __init__(self, server: viser.ViserServer, node: Node, view: ToolView) -> None:
        self._node, self._view = node, view
        self._jaws: PokedJaws | None = None
        self._touched = -math.inf  # monotonic s
        self._slider = server.gui.add_slider(
            f"Jaws of {view.name}, degrees", min=0.0, max=WIDEST, step=STEP, initial_value=0.0, visible=False
        )
        # In the server's own loop: in a pool of threads an older value could come last.
        self._slider.on_update(self._on_slider)

    def use(self, link: ToolLink) -> None:
        """Use a link to the tool from now on."""
        if self._jaws is not None and self._jaws.link == link:
            return
        self.close()
        if link.tool.shape in JAWED:
            self._jaws = PokedJaws(self._node, link)
            self._slider.hint = f"Opening of the jaws. Moving the slider publishes {self._jaws.topic}"
        self._slider.visible = self._jaws is not None

    def update(self, now: float) -> None:
        """Show how the jaws are open at a time, s, unless somebody moves the slider."""
        opening = self._view.opening
        if self._jaws is None or self._jaws.moving or opening is None or now - self._touched < UNTOUCHED:
            return
        shown = round(min(math.degrees(opening), WIDEST) / STEP) * STEP
        if shown != self._slider.value:
            self._slider.value = shown  # type: ignore[misc]  # viser declares it read-only

    def other_publishers(self) -> int:
        """Return how many others move the jaws that the slider has just moved."""
        return self._jaws.other_publishers() if self._jaws is not None and self._jaws.moving else 0

    def close(self) -> None:
        """Stop moving the jaws."""
        if self._jaws is not None:
            self._jaws.close()
            self._jaws = None

    def remove(self) -> None:
        """Stop moving the jaws, and remove the slider from the panel."""
        self.close()
        self._slider.remove()

    async def _on_slider(self, event: viser.GuiEvent[viser.GuiSliderHandle[float]]) -> None:
        jaws = self._jaws
        if event.client_id is None or jaws is None:  # our own change
            return
        self._touched = time.monotonic()
        goal = math.radians(float(event.target.value))
        jaws.turn(goal, goal if self._view.opening is None else self._view.opening)
