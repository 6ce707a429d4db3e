"""Segments that run through a surface, against the places inside it on their path."""

import numpy as np

from helpers.scenes import kidney
from tissue_sim.organ.surfaces.intersections import is_crossed
from tissue_sim.organ.winding import inside


def test_a_segment_crosses_where_one_end_is_outside_or_it_leaves_on_the_way():
    organ = kidney()
    surface, triangles = organ.surface_positions, organ.surface_triangles
    corners = surface[triangles]
    low, high = surface.min(axis=0), surface.max(axis=0)
    ends = np.random.default_rng(2).uniform(low, high, (100, 2, 3))
    crossed = [is_crossed(start, end, corners) for start, end in ends]
    path = ends[:, None, 0] + np.linspace(0.0, 1.0, 200)[None, :, None] * (ends[:, None, 1] - ends[:, None, 0])
    within = inside(path.reshape(-1, 3), surface, triangles).reshape(len(ends), -1)
    changes = np.any(within != within[:, :1], axis=1)
    assert 10 < np.count_nonzero(changes) < 90
    # Between two of the places looked at a segment may leave and come back; never the other way about.
    assert np.all(np.array(crossed)[changes])
    assert np.count_nonzero(np.array(crossed) & ~changes) <= 1


def test_a_segment_through_an_edge_or_a_corner_crosses():
    corners = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    for x, y, expected in ((0.2, 0.2, True), (0.5, 0.0, True), (0.0, 0.0, True), (0.6, 0.6, False), (-0.1, 0.5, False)):
        for height in (1.0, -1.0):
            start, end = np.array([x, y, height]), np.array([x, y, -height])
            assert is_crossed(start, end, corners) is expected
            assert not is_crossed(start, np.array([x, y, 0.5 * height]), corners)
