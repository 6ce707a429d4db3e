"""The viewer's picture: organ, skeleton, tools and contact forces as viser draws them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import Marker

from tissue_sim.array_types import Floats, Longs
from tissue_sim.ros.node.markers import ARROW_LENGTH
from tissue_sim.ros.shared.appearance import BANDS, TISSUE, Colour
from tissue_sim.ros.viewer.bands import cut_into_bands

SKELETON: Colour = (20, 30, 60)
TOOL_COLOURS: tuple[Colour, ...] = ((120, 150, 190), (130, 175, 150), (170, 150, 190), (180, 170, 140))
FORCE: Colour = (0, 60, 220)
LEAST_FORCE = 0.01  # N that gets an arrow
FIELD_OF_VIEW = np.radians(35.0)
VIEW = np.array([0.55, -1.0, 0.3])  # from the organ to the camera: from the front, the side and above


def arrow(position: Floats, force: Floats, radius: float) -> NDArray[np.float32]:
    """Start and end (1, 2, 3) m of a force's arrow: from the tool's surface, ARROW_LENGTH m for 1 N."""
    start = position + radius * force / np.linalg.norm(force)
    return np.array([[start, start + ARROW_LENGTH * force]], dtype=np.float32)


def camera_for(vertices: Floats) -> tuple[Floats, Floats]:
    """Where the camera stands and what it looks at, (3,) m each, so that a surface fills the view beside the panel."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = 0.5 * (low + high)
    radius = float(np.linalg.norm(vertices - centre, axis=1).max())
    distance = 1.15 * radius / np.sin(0.5 * FIELD_OF_VIEW)
    away = VIEW / np.linalg.norm(VIEW)
    right = np.cross([0.0, 0.0, 1.0], away)
    # A little to the left: the panel is on the right.
    looked_at = centre + 0.25 * radius * right / np.linalg.norm(right)
    return looked_at + distance * away, looked_at


def light(server: viser.ViserServer) -> None:
    """Light from the camera's side, so that the colours look like the legend's."""
    scene = server.scene
    scene.configure_default_lights(False)
    scene.configure_environment_map("studio", environment_intensity=0.25)
    scene.add_light_hemisphere("/lights/sky", sky_color=(255, 250, 245), ground_color=(190, 170, 165), intensity=1.2)
    for name, way, strength in (("key", (-0.9, -1.0, 1.2), 2.2), ("fill", (1.0, -0.6, -0.2), 0.7)):
        scene.add_light_directional(f"/lights/{name}", position=way, intensity=strength, cast_shadow=False)


def outermost_first(vertices: Floats, triangles: Longs) -> Longs:
    """Triangles (t, 3) in the order of their depth under the convex hull of vertices (n, 3).

    A translucent surface then hides its own folds behind what lies before them: drawn first, that fills the depth
    buffer. In another order, pieces of a fold's far wall shine through.
    """
    hull = ConvexHull(vertices).equations
    middle = vertices[triangles].mean(axis=1)
    depth = np.full(len(middle), np.inf)
    for plane in hull:
        np.minimum(depth, -(middle @ plane[:3] + plane[3]), out=depth)
    return triangles[np.argsort(depth, kind="stable")]


class OrganView:
    """A deforming surface, coloured by displacement: vertices at rest (n, 3) m, triangles (t, 3).

    A mesh of viser has one colour, so each band of displacement is a mesh of its own; updating a mesh
    that is there keeps its buffers and doesn't flicker.
    """

    def __init__(self, server: viser.ViserServer, vertices: Floats, triangles: NDArray[np.int64]) -> None:
        self.rest = np.asarray(vertices, dtype=np.float64)
        self._triangles = outermost_first(self.rest, triangles)
        self._levels = [level * 1e-3 for level, _ in BANDS]
        self._meshes = [
            server.scene.add_mesh_simple(
                f"/organ/{name}",
                self.rest,
                self._triangles,
                color=colour,
                cast_shadow=False,
                receive_shadow=False,
            )
            for name, colour in [("at_rest", TISSUE), *((f"over_{level:g}_mm", colour) for level, colour in BANDS)]
        ]
        self.show(self.rest)

    def show(self, positions: Floats) -> None:
        """Draw the surface at positions (n, 3) m."""
        displacement = np.linalg.norm(positions - self.rest, axis=1)
        bands = cut_into_bands(positions, self._triangles, displacement, self._levels)
        for mesh, (vertices, faces) in zip(self._meshes, bands, strict=True):
            if len(faces) == 0:  # a triangle without area: to hide the mesh would show a hole for a moment
                vertices, faces = positions[:1], np.zeros((1, 3), dtype=np.int64)
            if len(vertices) > len(mesh.vertices):  # at no moment may a face name a vertex that isn't there
                mesh.vertices = vertices.astype(np.float32)
                mesh.faces = faces.astype(np.uint32)
            else:
                mesh.faces = faces.astype(np.uint32)
                mesh.vertices = vertices.astype(np.float32)

    def set_opacity(self, opacity: float) -> None:
        """Let the skeleton shine through: 1 hides it."""
        for mesh in self._meshes:
            mesh.opacity = opacity if opacity < 1.0 else None

    def remove(self) -> None:
        """Take it out of the picture."""
        for mesh in self._meshes:
            mesh.remove()


class SkeletonView:
    """Medial atoms as small spheres, each joined with its parent."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._handles: list[Any] = []

    def show(self, atoms: Floats, parent: Longs) -> None:
        """Draw atoms (n, 3) m, each joined with its parent (n,), -1 at a root; another skeleton is made anew."""
        child = np.flatnonzero(parent >= 0)
        bones = np.stack([atoms[parent[child]], atoms[child]], axis=1)
        made = (len(self._handles[1].batched_positions), len(self._handles[0].points)) if self._handles else None
        if made != (len(atoms), len(bones)):
            self.remove()
            ball = _icosphere(0.0008)
            self._handles = [
                self._server.scene.add_line_segments(
                    "/skeleton/bones", bones, SKELETON, thickness=0.0006, thickness_units="world"
                ),
                self._server.scene.add_batched_meshes_simple(
                    "/skeleton/atoms",
                    *ball,
                    batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (len(atoms), 1)),
                    batched_positions=atoms,
                    batched_colors=SKELETON,
                    lod="off",
                    cast_shadow=False,
                    receive_shadow=False,
                ),
            ]
            return
        self._handles[0].points = bones
        self._handles[1].batched_positions = atoms

    def remove(self) -> None:
        """Take it out of the picture."""
        for handle in self._handles:
            handle.remove()
        self._handles = []


class ToolView:
    """A tool, as the node's markers have it, and the force that its hand feels."""

    def __init__(self, server: viser.ViserServer, name: str, index: int) -> None:
        self.name = name
        self.force: float | None = None  # N that its hand feels; None while nobody moves it
        self._scene, self._colour = server.scene, TOOL_COLOURS[index % len(TOOL_COLOURS)]
        self._shapes: dict[int, tuple[Any, ...]] = {}
        self._reaches: dict[int, float] = {}
        self._parts: dict[int, Any] = {}
        self._on_drag: Callable[[Any], Any] | None = None
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
        """Angle in rad between its jaws, the first and the last part; None while nobody knows where the tool is."""
        shafts = [
            Rotation.from_quat(np.roll(p.wxyz, -1)).apply([0.0, 0.0, 1.0]) for p in self._parts.values() if p.visible
        ]
        return float(np.arccos(np.clip(shafts[0] @ shafts[-1], -1.0, 1.0))) if shafts else None

    @property
    def reach(self) -> float:
        """From the tool's origin to its surface, across and ahead, m; 0 while its shape is not known."""
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
        """Nobody knows where the tool is."""
        self.force = None
        self._arrow.visible = self._label.visible = False
        for part in self._parts.values():
            part.visible = False

    def remove(self) -> None:
        """Take it out of the picture."""
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

    def drag(self, callback: Callable[[Any], Any] | None) -> None:
        """Call back when somebody drags the tool with the mouse; None: nobody may."""
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

    def _drawn(self, marker: Marker, scale: tuple[float, float, float]) -> tuple[Any, float]:
        name = f"/tools/{self.name}/{marker.id}"
        look: dict[str, Any] = {
            "color": self._colour,
            "opacity": 0.6,
            "visible": False,
            "cast_shadow": False,
            "receive_shadow": False,
        }
        if marker.type == Marker.SPHERE:
            return self._scene.add_icosphere(name, radius=0.5 * scale[0], subdivisions=4, **look), 0.5 * scale[0]
        if marker.type == Marker.CYLINDER:
            return self._scene.add_cylinder(name, radius=0.5 * scale[0], height=scale[2], **look), 0.0
        points = np.array([(p.x, p.y, p.z) for p in marker.points], dtype=np.float64).reshape(-1, 3)
        faces = np.arange(len(points)).reshape(-1, 3)
        across = float(np.linalg.norm(points[:, :2], axis=1).max(initial=0.0))
        reach = max(across, float(points[:, 2].max(initial=0.0)))
        return self._scene.add_mesh_simple(name, points, faces, flat_shading=True, side="double", **look), reach


def _icosphere(radius: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return np.asarray(ball.vertices), np.asarray(ball.faces)
