"""Organs with a finer surface in some places, of the same shape."""

import numpy as np
import pytest

from helpers.bars import bar
from helpers.scenes import ball_of_cells
from tissue_sim.errors import UserError
from tissue_sim.organ.refined import places_on, refined
from tissue_sim.organ.refinement import Along, Ball, Refinement
from tissue_sim.organ.surface_checks import signed_volume
from tissue_sim.organ.surfaces.sizing import local_edges
from tissue_sim.organ.surfaces.surface_quality import measure

LINE = Along(np.array([[-0.01, 0.0, 0.03], [0.01, 0.0, 0.03]]), 0.006, 0.003)


def test_the_shape_stays_and_points_are_added_where_they_are_wanted():
    organ = ball_of_cells(2, 60)
    finer = refined(organ, Refinement(places=(LINE,)))
    n = organ.n_surface
    assert finer.n_surface > n
    np.testing.assert_array_equal(finer.surface_positions[:n], organ.surface_positions)
    assert signed_volume(finer.surface_positions, finer.surface_triangles) == pytest.approx(organ.volume, rel=1e-12)
    assert measure(finer.surface_positions, finer.surface_triangles).euler == 2
    near = np.linalg.norm(finer.surface_positions - [0.0, 0.0, 0.03], axis=1) < 0.008
    edges = local_edges(finer.surface_positions, finer.surface_triangles)
    assert edges[near].mean() < 1.35 * 0.003
    far = finer.surface_positions[:, 2] < -0.01
    np.testing.assert_array_equal(np.sort(np.flatnonzero(far)), np.flatnonzero(organ.surface_positions[:, 2] < -0.01))
    assert finer.provenance["refined_from_points"] == n


def test_new_points_lie_between_those_that_were_there():
    organ = ball_of_cells(2, 60)
    finer = refined(organ, Refinement(places=(LINE,)))
    corner, fraction = places_on(organ, finer.surface_positions)
    found = np.einsum("kc,kcx->kx", fraction, organ.surface_positions[corner])
    np.testing.assert_allclose(found, finer.surface_positions, atol=1e-12)
    with pytest.raises(UserError, match="does not lie on the surface"):
        places_on(organ, np.zeros((1, 3)))


def test_what_was_held_is_held_and_no_more():
    organ = bar()
    finer = refined(organ, Refinement(places=(Ball(np.array([0.0, 0.01, 0.01]), 0.02, 0.003),)))
    assert len(finer.fixed) > len(organ.fixed)
    np.testing.assert_array_equal(finer.fixed, np.flatnonzero(finer.surface_positions[:, 0] == 0.0))


def test_nothing_to_refine_is_an_error():
    with pytest.raises(UserError, match="changes nothing"):
        refined(bar(), Refinement(places=(Ball(np.array([0.0, 0.0, 0.0]), 0.01, 0.05),)))
