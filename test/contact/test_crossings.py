"""Inside or outside by the triangles above a point: the same as by the winding number, also above nodes and edges."""

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.contact.crossings import crossings_above
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ
from tissue_sim.organ.winding import winding_number

ORGANS = {"ball": lambda: ball(3), "kidney": lambda: Organ.load(shipped_organ())}


@pytest.mark.parametrize("name", ORGANS)
def test_it_is_the_winding_number(name):
    organ = ORGANS[name]()
    surface, triangles = organ.surface_positions, organ.surface_triangles
    low, high = surface.min(axis=0), surface.max(axis=0)
    random = np.random.default_rng(1).uniform(low, high, (300, 3))
    corners = surface[triangles[:: max(1, len(triangles) // 60)]]
    below = np.concatenate([corners[:, 0], corners[:, :2].mean(axis=1)])  # rays that meet a node or an edge
    below[:, 2] = np.random.default_rng(2).uniform(low[2], high[2], len(below))
    points = np.concatenate([random, below])
    wanted = np.rint(winding_number(points, surface, triangles))
    found = [crossings_above(surface, triangles, *point) for point in points.tolist()]
    np.testing.assert_array_equal(found, wanted)
    assert set(found) == {0, 1}


def test_a_surface_inside_out_counts_backwards():
    organ = ball(2)
    middle = organ.surface_positions.mean(axis=0).tolist()
    assert crossings_above(organ.surface_positions, organ.surface_triangles, *middle) == 1
    assert crossings_above(organ.surface_positions, organ.surface_triangles[:, ::-1].copy(), *middle) == -1
