"""An organ of the page whose mesh changes: after a cut it has walls, and inclusions stay in it."""

import numpy as np
import pytest
import trimesh
from geometry_msgs.msg import Point
from shape_msgs.msg import Mesh, MeshTriangle

pytest.importorskip("viser")

from helpers.ros.picture import Server
from helpers.ros.stand_in import ball
from tissue_sim.ros.viewer import viewed_organ
from tissue_sim.ros.viewer.viewed_organ import ViewedOrgan


def mesh_of(vertices, triangles):
    corners = [MeshTriangle(vertex_indices=row) for row in np.asarray(triangles).astype(np.uint32)]
    return Mesh(vertices=[Point(x=float(x), y=float(y), z=float(z)) for x, y, z in vertices], triangles=corners)


class Inbox:
    """What came on a topic, once."""

    def __init__(self, *_, **__):
        self.newest = None

    def take(self):
        taken, self.newest = self.newest, None
        return taken

    def close(self):
        """Nothing is open."""


def test_an_organ_that_was_cut_is_drawn_anew_with_its_inclusions(monkeypatch):
    monkeypatch.setattr(viewed_organ.client, "NewestMessage", Inbox)
    server, (vertices, triangles) = Server(), ball()
    organ = ViewedOrgan(server, None, "tissue_sim", "")
    inner = trimesh.creation.icosphere(1, 0.2 * np.abs(vertices).max())
    organ._within.newest = mesh_of(inner.vertices, inner.faces)
    organ.take_inclusions()
    assert organ._inclusions is None, "the organ's own surface has not come"
    organ._mesh.newest = mesh_of(vertices, triangles)
    assert organ.take_mesh()
    organ.take_inclusions()
    first = organ._inclusions
    assert first is not None
    cut = trimesh.creation.icosphere(3, np.abs(vertices).max())
    server.drawn.clear()
    organ._mesh.newest = mesh_of(cut.vertices, cut.faces)
    assert organ.take_mesh()
    organ.take_inclusions()
    assert organ._inclusions not in (None, first)
    organ._inclusions.show(1.1 * np.asarray(cut.vertices))
    np.testing.assert_allclose(server.drawn["/inclusions"].vertices, 1.1 * inner.vertices, atol=1e-5)
