"""The viewer's picture."""

import numpy as np
import pytest
import trimesh

pytest.importorskip("viser")

from tissue_sim.ros.viewer.scene import outermost_first


def test_triangles_of_a_fold_are_drawn_after_those_before_it():
    mesh = trimesh.creation.icosphere(2, 0.03)
    vertices, triangles = np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)
    vertices[7] *= 0.3
    ordered = outermost_first(vertices, triangles)
    np.testing.assert_array_equal(np.sort(ordered, axis=0), np.sort(triangles, axis=0))
    inward = np.any(ordered == 7, axis=1)
    assert np.all(np.flatnonzero(inward) >= len(triangles) - inward.sum())
