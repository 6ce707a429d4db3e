"""Organs that are too thin for their triangles are refused, with the points that would do."""

import re
from dataclasses import replace

import pytest

from helpers.scenes import ball, kidney
from tissue_sim.calibration.thickness import check_thickness
from tissue_sim.errors import UserError


def test_a_thin_organ_is_told_how_many_points_it_needs():
    thin = replace(ball(2), atom_radius=[0.03, 0.02, 0.005, 0.005, 0.02])
    with pytest.raises(UserError, match=r"'ball' is 10\.0 mm thick in places.* edges of 9\.\d mm") as refusal:
        check_thickness(thin)
    points = int(re.search(r"--points (\d+)", str(refusal.value))[1])
    assert points > ball(2).n_surface
    check_thickness(replace(ball(3), atom_radius=thin.atom_radius))
    assert ball(3).n_surface < points, "some room is left"


def test_one_thin_place_is_let_pass():
    check_thickness(kidney())
    check_thickness(replace(kidney(), atom_radius=[1e-3, *kidney().atom_radius[1:]]))
