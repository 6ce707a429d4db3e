"""The viewer's picture: organ and skeleton as viser draws them, its camera and its light."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tissue_sim.array_types import Floats, Longs
from tissue_sim.ros.shared.appearance import BANDS, Colour, tissue_colour
from tissue_sim.ros.viewer.bands import cut_into_bands

SKELETON: Colour = (20, 30, 60)
FIELD_OF_VIEW = np.radians(35.0)
VIEW = np.array([0.55, -1.0, 0.3])  # from the organ to the camera: from the front, the side and above


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
    """A deforming surface, coloured by displacement: vertices at rest (n, 3) m, triangles (t, 3); name: in a scene.

    A mesh of viser has one colour, so each band of displacement is a mesh of its own; updating a mesh
    that is there keeps its buffers and doesn't flicker.
    """

    def __init__(
        self, server: viser.ViserServer, vertices: Floats, triangles: NDArray[np.int64], name: str = ""
    ) -> None:
        below = f"/organ/{name}" if name else "/organ"
        self._is_carried = bool(name)
        self.rest = np.asarray(vertices, dtype=np.float64)
        self._triangles = outermost_first(self.rest, triangles)
        self._levels = [level * 1e-3 for level, _ in BANDS]
        self._meshes = [
            server.scene.add_mesh_simple(
                f"{below}/{band}",
                self.rest,
                self._triangles,
                color=colour,
                cast_shadow=False,
                receive_shadow=False,
            )
            for band, colour in [
                ("at_rest", tissue_colour(name)),
                *((f"over_{level:g}_mm", colour) for level, colour in BANDS),
            ]
        ]
        top = self.rest[np.argmax(self.rest[:, 2])]
        self._label = server.scene.add_label(f"{below}/name", name, position=top + (0.0, 0.0, 0.01)) if name else None
        self.show(self.rest)

    def show(self, positions: Floats) -> None:
        """Draw the surface at positions (n, 3) m."""
        moved = positions - self.rest
        if self._is_carried:  # by the breath: as most of it is
            moved = moved - np.median(moved, axis=0)
        displacement = np.linalg.norm(moved, axis=1)
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
        if self._label is not None:
            self._label.remove()


class SkeletonView:
    """Medial atoms as small spheres, each joined with its parent."""

    def __init__(self, server: viser.ViserServer, name: str = "") -> None:
        self._server, self._below = server, f"/skeleton/{name}" if name else "/skeleton"
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
                    f"{self._below}/bones", bones, SKELETON, thickness=0.0006, thickness_units="world"
                ),
                self._server.scene.add_batched_meshes_simple(
                    f"{self._below}/atoms",
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


def _icosphere(radius: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return np.asarray(ball.vertices), np.asarray(ball.faces)
