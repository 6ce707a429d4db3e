"""Poking from the browser: a checkbox takes hold of a tool, a gizmo or the tool itself drags it, a slider its jaws."""

from __future__ import annotations

import queue
import threading
from collections.abc import Collection

import numpy as np
import viser
from rclpy.node import Node
from scipy.spatial.transform import Rotation

from tissue_sim.array_types import Floats
from tissue_sim.directions import across
from tissue_sim.rendering.organ_view import picture_axes
from tissue_sim.ros.shared.tool_link import ToolLink
from tissue_sim.ros.viewer.jaws import JawSlider
from tissue_sim.ros.viewer.poked_tool import PokedTool
from tissue_sim.ros.viewer.tool_view import ToolView

CLEAR = 0.008  # m between a tool that is taken and the organ
GIZMO = 0.03  # m, length of its arrows
LOOK_EVERY = 0.5  # s between two checks for other publishers
PROBE_EVERY = 1.0  # s between two requests to the browser that holds a tool


def beside(points: Floats, index: int, radius: float) -> tuple[Floats, Floats]:
    """Return where a tool of a radius, m, is taken: a place (3,) m beyond the points (n, 3) m, and the direction in.

    The first tool is at the left of the picture, the second at the right, further ones below and above.
    """
    right, up, _ = picture_axes()
    out = (-right, right, -up, up)[index % 4]
    offset = points - points.mean(axis=0)
    along = offset @ out
    aside = np.linalg.norm(offset - along[:, None] * out, axis=1)
    chosen = int(np.argmax(along - 0.5 * aside))
    return points[chosen] + (along.max() - along[chosen] + radius + CLEAR) * out, -out


def pointing(inward: Floats) -> Floats:
    """Return the quaternion (4,) xyzw of a tool whose shaft, along its -z, comes from outside."""
    return np.asarray(Rotation.from_matrix(np.column_stack([*across(inward), inward])).as_quat())


class Poke:
    """A tool that one browser at a time may hold: its checkbox, its gizmo, its poses.

    patience: time without an answer after which a page loses the tool, s.
    """

    def __init__(self, server: viser.ViserServer, node: Node, view: ToolView, index: int, patience: float) -> None:
        self._server, self._view, self._index, self._patience = server, view, index, patience
        self.name = view.name
        self._tool = PokedTool(node, self.name)
        self._ready = False  # the link to the tool is known
        self._holder: int | None = None
        self._gizmo: viser.TransformControlsHandle | None = None
        self._offset = np.zeros(3)  # m, from where the mouse grabbed the tool to its goal
        self._asked: queue.SimpleQueue[tuple[bool, int | None]] = queue.SimpleQueue()
        self._gone = threading.Event()  # of the hand that holds it now
        self._next_look = -np.inf
        gui = server.gui
        self._box = gui.add_checkbox(
            f"Poke with {self.name}",
            False,
            disabled=True,
            hint=self._hint(),
        )
        self.jaws = JawSlider(server, node, view)
        self._warning = gui.add_markdown("", visible=False)
        self._box.on_update(self._on_box)

    def _hint(self) -> str:
        return f"Take control of the tool: drag it, or one of its arrows. Publishes {self._tool.topic}"

    def use(self, link: ToolLink | None) -> None:
        """Use a link to the tool; None: the default one."""
        self._ready = True
        if link is not None:
            self._tool.use(link)
            self.jaws.use(link)
            self._box.hint = self._hint()

    def _on_box(self, event: viser.GuiEvent[viser.GuiCheckboxHandle]) -> None:
        if event.client_id is not None:  # not our own change
            self._asked.put((self._box.value, event.client_id))

    def update(self, now: float, watchers: Collection[int], points: Floats | None, frame_id: str) -> None:
        """Apply the requests of the checkbox.

        now: the present time, s; watchers: ids of the browsers that look; points (n, 3) m: points of the organ in a
        frame, or None without one.
        """
        self._box.disabled = points is None or self._view.reach == 0.0 or not self._ready
        self.jaws.update(now)
        while not self._asked.empty():
            wanted, who = self._asked.get()
            if not wanted:
                self.release()
            elif who is not None and points is not None:
                self._take(who, points, frame_id)
        if self._holder is not None and (self._holder not in watchers or not self._tool.held):
            self.release()
        if now >= self._next_look:
            self._next_look = now + LOOK_EVERY
            of_tool, of_jaws = self._tool.other_publishers(), self.jaws.other_publishers()
            self._warning.visible = of_tool + of_jaws > 0
            if of_tool > 0:
                self._warning.content = (
                    f"**A bridge already moves `{self.name}`.** Stop it before you poke: otherwise the tool jumps"
                    " between its poses and yours."
                )
            elif of_jaws > 0:
                self._warning.content = f"**A bridge already moves the jaws of `{self.name}`**, and closes them again."

    def close(self) -> None:
        """Release the tool, and its jaws."""
        self.jaws.close()
        self.release()

    def remove(self) -> None:
        """Release the tool, and remove its parts from the panel."""
        self.close()
        self.jaws.remove()
        for handle in (self._box, self._warning):
            handle.remove()

    def release(self) -> None:
        """Release the tool, and clear its checkbox."""
        self._release()
        if self._box.value:
            self._box.value = False  # type: ignore[misc]  # viser declares it read-only

    def _take(self, who: int, points: Floats, frame_id: str) -> None:
        self._release()
        holder = self._server.get_clients().get(who)
        if holder is None:
            return
        position, inward = beside(points, self._index, self._view.reach)
        turn = pointing(inward)
        # Only the browser that requested the tool gets the gizmo.
        self._gizmo = holder.scene.add_transform_controls(
            f"/poke/{self.name}",
            scale=GIZMO,
            disable_rotations=True,
            depth_test=False,
            position=position,
            wxyz=np.roll(turn, 1),
        )
        # Both run in the server's own loop: in a pool of threads an older position could come last.
        self._gizmo.on_update(self._on_gizmo)
        self._view.drag(self._on_drag)
        self._holder = who
        self._tool.take(position, turn, frame_id)
        self._gone = threading.Event()
        threading.Thread(target=self._watch, args=(holder, self._gone), name="hand", daemon=True).start()

    def _release(self) -> None:
        self._tool.release()
        self._holder = None
        self._gone.set()
        if self._gizmo is not None:
            self._view.drag(None)
            self._gizmo.remove()
            self._gizmo = None

    def _watch(self, holder: viser.ClientHandle, gone: threading.Event) -> None:
        """Release the tool when the page no longer answers: one that was left or is hidden stays connected."""
        while not gone.wait(PROBE_EVERY):
            try:
                holder.local_storage.get_item("hand", timeout=self._patience)
            except TimeoutError:
                if not gone.is_set():
                    self._asked.put((False, None))
                return
            except RuntimeError:  # disconnected, which `update` sees; or a browser without storage, which answers
                continue

    async def _on_gizmo(self, event: viser.TransformControlsEvent) -> None:
        self._tool.goal = np.array(event.target.position, dtype=np.float64)

    async def _on_drag(self, event: viser.SceneNodeDragEvent) -> None:
        gizmo = self._gizmo
        if event.client_id != self._holder or gizmo is None:
            return
        pointer = np.array(event.end_position, dtype=np.float64)
        if event.phase == "start":
            self._offset = self._tool.goal - pointer
        self._tool.goal = pointer + self._offset
        gizmo.position = self._tool.goal
