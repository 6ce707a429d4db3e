"""Organs whose triangles are too large to be calibrated well are named, with what to build them with."""

import re
from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, kidney
from tissue_sim.calibration.coarseness import check_coarseness, coarseness
from tissue_sim.errors import UserError


def asked(organ):
    """Why an organ's triangles are too large, and the points that would do."""
    text = coarseness(organ)
    return text, int(re.search(r"--points (\d+)", text)[1])


def test_a_thin_organ_is_reported_how_many_points_it_needs():
    thin = replace(ball(2), atom_radius=[0.03, 0.02, 0.005, 0.005, 0.02])
    reason, points = asked(thin)
    assert re.search(r"'ball' is 10\.0 mm thick in places.* edges of \d\d?\.\d mm; build it with --refine auto", reason)
    assert points > ball(2).n_surface
    with pytest.raises(UserError, match=re.escape(reason)):
        check_coarseness(thin)
    check_coarseness(replace(ball(3), atom_radius=thin.atom_radius))
    assert ball(3).n_surface < points, "some room is left"


def test_one_thin_place_is_let_pass():
    check_coarseness(kidney())
    check_coarseness(replace(kidney(), atom_radius=[1e-3, *kidney().atom_radius[1:]]))


def test_edges_beside_a_large_clamp_are_held_against_their_distance_from_it():
    """A kidney three times as long in all directions, with as many points, held at a quarter of its surface."""
    large = replace(kidney(), surface_positions=3.0 * kidney().surface_positions, atom_radius=3 * kidney().atom_radius)
    check_coarseness(large)
    along = large.surface_positions[:, 1]
    held = replace(large, fixed=np.flatnonzero(along < np.quantile(along, 0.25)).astype(np.int32))
    reason, points = asked(held)
    check_coarseness(held)  # a warning, and no refusal
    assert re.search(r"edges of 1\d\.\d mm at \d+\.\d mm from its clamp, too coarse for accurate loads there", reason)
    assert points > 2 * large.n_surface


def test_a_flat_organ_is_held_against_its_thickness():
    """The medial atoms say nothing of it: their radius is left as it was."""
    flat = replace(ball(3), surface_positions=ball(3).surface_positions * [1.0, 1.0, 0.06])
    reason, points = asked(flat)
    assert re.search(r"has rims \d\.\d mm thick, too thin for triangles with edges of \d\.\d mm", reason)
    assert points > flat.n_surface
