"""One organ of the page: its topics, and how it is drawn."""

from __future__ import annotations

import numpy as np
import viser
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh

from tissue_sim.array_types import Floats, Longs
from tissue_sim.rendering.organ_view import OrganView
from tissue_sim.ros.shared import client
from tissue_sim.ros.shared.organ_topics import path_of
from tissue_sim.ros.viewer.scene import InclusionView, SkeletonView

TURNED = np.cos(np.radians(5.0))  # cosine of the angle from which on two viewpoints count as different


class ViewedOrgan:
    """An organ whose topics lie below a node's name, or below its own there; name: empty for a single one."""

    def __init__(self, server: viser.ViserServer, node: Node, target: str, name: str) -> None:
        below = path_of(f"/{target}", name)
        self.name, self._server = name, server
        self._mesh = client.NewestMessage(node, Mesh, f"{below}/mesh", client.latched_qos())
        self._surface = client.NewestMessage(node, PointCloud2, f"{below}/surface", client.stream_qos())
        self._atoms = client.NewestMessage(node, PointCloud2, f"{below}/skeleton", client.stream_qos())
        self._within = client.NewestMessage(node, Mesh, f"{below}/inclusions", client.latched_qos())
        self._skeleton = SkeletonView(server, name)
        self._inclusions: InclusionView | None = None
        self._inclusion_mesh: tuple[Floats, Longs] | None = None  # the newest
        self.view: OrganView | None = None
        self.points: Floats | None = None  # last positions of the surface, (n, 3) m
        self.frame_id = ""
        self._drawn: Floats | None = None
        self._eye = np.zeros(3)  # m, viewpoint of the last drawing

    def take_mesh(self) -> bool:
        """Take the surface at rest, if it has come; return whether it is a different one."""
        mesh = self._mesh.take()
        if mesh is None:
            return False
        vertices, triangles = client.mesh_arrays(mesh)
        if self.view is not None:
            if np.array_equal(vertices, self.view.rest):
                return False
            self._clear()
        self.view = OrganView(self._server, vertices, triangles, self.name)
        self.points = self._drawn = None
        return True

    def take_surface(self) -> None:
        """Take the present positions."""
        surface = self._surface.take()
        if surface is None or self.view is None:
            return
        positions = client.cloud_array(surface)
        # A different number of nodes belongs to an organ whose mesh is still on its way.
        if positions.shape == self.view.rest.shape and np.isfinite(positions).all():
            self.points, self.frame_id = positions.astype(np.float64), surface.header.frame_id

    def take_inclusions(self) -> None:
        """Take the surfaces of inclusions, once the organ's own has come."""
        mesh = self._within.take()
        if mesh is not None:
            self._inclusion_mesh = client.mesh_arrays(mesh)
            if self._inclusions is not None:
                self._inclusions.remove()
                self._inclusions = None
        # Once for each surface: a cut gives the organ another one.
        if self.view is not None and self._inclusions is None and self._inclusion_mesh is not None:
            self._inclusions = InclusionView(self._server, *self._inclusion_mesh, self.view, self.name)
            self._drawn = None

    def draw(self, eye: Floats | None, opacity: float) -> None:
        """Draw what has changed; surfaces only while a page is open.

        eye (3,) m: the viewpoint; opacity: 1 hides what is within.
        """
        if self.view is not None:
            self.view.turn()
            points = self.view.rest if self.points is None else self.points
            if eye is not None and (
                self.view.set_opacity(opacity) or points is not self._drawn or self._has_turned(eye, opacity)
            ):
                self.view.show(points, eye)
                self._eye = eye
                if self._inclusions is not None:
                    self._inclusions.show(points)
                self._drawn = points
        atoms = self._atoms.take()
        if atoms is not None:
            columns = client.cloud_array(atoms)
            self._skeleton.show(columns[:, :3].astype(np.float64), columns[:, 4].astype(np.int64))

    def _has_turned(self, eye: Floats, opacity: float) -> bool:
        """Return whether a translucent organ is seen from another side than when it was drawn."""
        if opacity >= 1.0 or self.view is None:
            return False
        lines = [one - self.view.rest.mean(axis=0) for one in (eye, self._eye)]
        cosine = lines[0] @ lines[1] / max(float(np.linalg.norm(lines[0]) * np.linalg.norm(lines[1])), 1e-12)
        return bool(cosine < TURNED)

    def remove(self) -> None:
        """Remove it from the picture, and unsubscribe."""
        for inbox in (self._mesh, self._within, self._surface, self._atoms):
            inbox.close()
        self._clear()

    def _clear(self) -> None:
        """Remove everything that is drawn from the picture."""
        for view in (self.view, self._inclusions, self._skeleton):
            if view is not None:
                view.remove()
        self.view = self._inclusions = None
