"""The viewer's picture: what viser draws besides the organs, which are views of `rendering.organ_view`."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Longs
from tissue_sim.organ.mean_value import mean_value_weights
from tissue_sim.rendering.appearance import INCLUSION, LIGAMENT, Colour
from tissue_sim.rendering.organ_view import OrganView
from tissue_sim.ros.shared.organ_topics import path_of

SKELETON: Colour = (20, 30, 60)


class InclusionView:
    """Surfaces of inclusions within an organ's, which move along with it; seen while the organ is translucent.

    vertices (p, 3) m: positions at rest; triangles (t, 3); organ: view of the organ; name: name of the organ in a
    scene.
    """

    def __init__(
        self, server: viser.ViserServer, vertices: Floats, triangles: Longs, organ: OrganView, name: str = ""
    ) -> None:
        self._weights = mean_value_weights(vertices, organ.rest, organ.triangles)
        self._mesh = server.scene.add_mesh_simple(
            path_of("/inclusions", name),
            vertices,
            triangles,
            color=INCLUSION,
            cast_shadow=False,
            receive_shadow=False,
        )

    def show(self, surface: Floats) -> None:
        """Draw them within the organ's surface (n, 3) m."""
        self._mesh.vertices = (self._weights @ surface).astype(np.float32)

    def remove(self) -> None:
        """Remove them from the picture."""
        self._mesh.remove()


class LigamentView:
    """Ligaments: a line for each link."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._lines: viser.LineSegmentsHandle | None = None

    def show(self, ends: Floats) -> None:
        """Draw lines between their ends (l, 2, 3) m; a different number of them is created again."""
        if self._lines is not None and len(self._lines.points) == len(ends):
            self._lines.points = ends.astype(np.float32)
            return
        self.remove()
        if len(ends):
            self._lines = self._server.scene.add_line_segments(
                "/ligaments", ends, LIGAMENT, thickness=0.0008, thickness_units="world"
            )

    def remove(self) -> None:
        """Remove them from the picture."""
        if self._lines is not None:
            self._lines.remove()
            self._lines = None


class SkeletonView:
    """Medial atoms as small spheres, each joined with its parent."""

    def __init__(self, server: viser.ViserServer, name: str = "") -> None:
        self._server, self._below = server, path_of("/skeleton", name)
        self._handles: tuple[viser.LineSegmentsHandle, viser.BatchedMeshHandle] | None = None

    def show(self, atoms: Floats, parent: Longs) -> None:
        """Draw atoms, each joined with its parent; a different skeleton is created again.

        atoms (n, 3) m: positions of the atoms; parent (n,): parent of each, -1 at a root.
        """
        child = np.flatnonzero(parent >= 0)
        bones = np.stack([atoms[parent[child]], atoms[child]], axis=1)
        if self._handles is not None:
            lines, balls = self._handles
            if (len(balls.batched_positions), len(lines.points)) == (len(atoms), len(bones)):
                lines.points, balls.batched_positions = bones.astype(np.float32), atoms.astype(np.float32)
                return
        self.remove()
        lines = self._server.scene.add_line_segments(
            f"{self._below}/bones", bones, SKELETON, thickness=0.0006, thickness_units="world"
        )
        balls = self._server.scene.add_batched_meshes_simple(
            f"{self._below}/atoms",
            *_icosphere(0.0008),
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (len(atoms), 1)),
            batched_positions=atoms,
            batched_colors=SKELETON,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )
        self._handles = lines, balls

    def remove(self) -> None:
        """Remove it from the picture."""
        for handle in self._handles or ():
            handle.remove()
        self._handles = None


def _icosphere(radius: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return np.asarray(ball.vertices), np.asarray(ball.faces)
