"""A tool and the force on it, as viser draws them."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Sequence
from typing import TypedDict

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import Marker

from tissue_sim.array_types import Floats
from tissue_sim.rendering.appearance import Colour
from tissue_sim.ros.node.output.markers import ARROW_LENGTH

TOOL_COLOURS: tuple[Colour, ...] = ((120, 150, 190), (130, 175, 150), (170, 150, 190), (180, 170, 140))
FORCE: Colour = (0, 60, 220)
LEAST_FORCE = 0.01  # N, least force with an arrow
Drawn = viser.MeshHandle | viser.IcosphereHandle | viser.CylinderHandle
Dragged = Callable[[viser.SceneNodeDragEvent], Coroutine]  # is called when a user drags a part of a tool


class _Look(TypedDict):
    """What viser's shapes have in common."""

    color: Colour
    opacity: float
    visible: bool
    cast_shadow: bool
    receive_shadow: bool


def arrow(position: Floats, force: Floats, radius: float) -> NDArray[np.float32]:
    """Return start and end (1, 2, 3) m of a force's arrow: from the tool's surface, ARROW_LENGTH m for 1 N."""
    start = position + radius * force / np.linalg.norm(force)
    return np.array([[start, start + ARROW_LENGTH * force]], dtype=np.float32)


class ToolView:
    """A tool, as the node's markers have it, and the force on it."""

    def __init__(self, server: viser.ViserServer, name: str, index: int) -> None:
        self.name = name
        self.force: float | None = None  # N; None while it isn't moved
        self._scene, self._colour = server.scene, TOOL_COLOURS[index % len(TOOL_COLOURS)]
        self._shapes: dict[int, tuple[float, ...]] = {}
        self._reaches: dict[int, float] = {}
        self._parts: dict[int, Drawn] = {}
        self._on_drag: Dragged | None = None
        self._arrow = self._scene.add_arrows(
            f"/forces/{name}",
            np.zeros((1, 2, 3)),
            FORCE,
            shaft_radius=0.0009,
            head_radius=0.0022,
            head_length=0.005,
            visible=False,
        )
        self._label = self._scene.add_label(f"/forces/{name}/label", "", visible=False)

    @property
    def opening(self) -> float | None:
        """Angle between its jaws, the first and the last part, rad; None while the tool's place is unknown."""
        shafts = [
            Rotation.from_quat(np.roll(p.wxyz, -1)).apply([0.0, 0.0, 1.0]) for p in self._parts.values() if p.visible
        ]
        return float(np.arccos(np.clip(shafts[0] @ shafts[-1], -1.0, 1.0))) if shafts else None

    @property
    def reach(self) -> float:
        """Distance from the tool's origin to its surface, across and ahead, m; 0 while its shape is unknown."""
        return max(self._reaches.values(), default=0.0)

    def show(self, markers: Sequence[Marker]) -> None:
        """Draw the tool's markers as they came."""
        for marker in markers:
            if marker.type == Marker.ARROW:
                self._show_force(marker)
            else:
                self._show_part(marker)
        if not any(part.visible for part in self._parts.values()):
            self.force = None

    def hide(self) -> None:
        """Hide the tool, whose place is unknown."""
        self.force = None
        self._arrow.visible = self._label.visible = False
        for part in self._parts.values():
            part.visible = False

    def remove(self) -> None:
        """Remove it from the picture."""
        for handle in (self._label, self._arrow, *self._parts.values()):
            handle.remove()

    def _show_force(self, marker: Marker) -> None:
        start, end = marker.points
        position = np.array([start.x, start.y, start.z])
        force = (np.array([end.x, end.y, end.z]) - position) / ARROW_LENGTH
        self.force = float(np.linalg.norm(force)) if marker.action == Marker.ADD else 0.0
        shown = self.force > LEAST_FORCE
        self._arrow.visible = self._label.visible = shown
        if shown:
            self._arrow.points = arrow(position, force, self.reach)
            self._label.position = self._arrow.points[0, 1]
            self._label.text = f"{self.name} {self.force:.2f} N"

    def drag(self, callback: Dragged | None) -> None:
        """Call back when a user drags the tool with the mouse; None: it can't be dragged."""
        for part in self._parts.values():
            if self._on_drag is not None:
                part.remove_drag_callback("all")
            if callback is not None:
                part.on_drag(callback)
        self._on_drag = callback

    def _show_part(self, marker: Marker) -> None:
        scale = (marker.scale.x, marker.scale.y, marker.scale.z)
        shape = (marker.type, *scale, len(marker.points))
        if self._shapes.get(marker.id) != shape:
            if marker.id in self._parts:
                self._parts[marker.id].remove()
            part, self._reaches[marker.id] = self._drawn(marker, scale)
            self._shapes[marker.id], self._parts[marker.id] = shape, part
            if self._on_drag is not None:
                part.on_drag(self._on_drag)
        part = self._parts[marker.id]
        part.visible = marker.action == Marker.ADD
        if part.visible:
            place, turn = marker.pose.position, marker.pose.orientation
            part.position = (place.x, place.y, place.z)
            part.wxyz = (turn.w, turn.x, turn.y, turn.z)

    def _drawn(self, marker: Marker, scale: tuple[float, float, float]) -> tuple[Drawn, float]:
        name = f"/tools/{self.name}/{marker.id}"
        look = _Look(color=self._colour, opacity=0.6, visible=False, cast_shadow=False, receive_shadow=False)
        if marker.type == Marker.SPHERE:
            return self._scene.add_icosphere(name, radius=0.5 * scale[0], subdivisions=4, **look), 0.5 * scale[0]
        if marker.type == Marker.CYLINDER:
            return self._scene.add_cylinder(name, radius=0.5 * scale[0], height=scale[2], **look), 0.0
        points = np.array([(p.x, p.y, p.z) for p in marker.points], dtype=np.float64).reshape(-1, 3)
        faces = np.arange(len(points)).reshape(-1, 3)
        across = float(np.linalg.norm(points[:, :2], axis=1).max(initial=0.0))
        reach = max(across, float(points[:, 2].max(initial=0.0)))
        return self._scene.add_mesh_simple(name, points, faces, flat_shading=True, side="double", **look), reach
