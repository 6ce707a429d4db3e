"""How small a ball an organ is fine enough for."""

import re

import pytest

from helpers.scenes import ball
from tissue_sim.organ.tool_resolution import FAIR, FINE, MOST_POINTS, mean_edge, points_for, unresolved_tools_of


def test_so_many_points_make_the_edge_as_short_as_is_needed():
    coarse, fine = ball(2), ball(3)
    radius = mean_edge(fine)
    assert points_for(coarse, radius, FINE) == pytest.approx(fine.n_surface, rel=0.05)
    assert points_for(fine, radius, FINE) == fine.n_surface
    assert points_for(coarse, radius) == pytest.approx(FAIR**2 * fine.n_surface, rel=0.05)


def test_an_organ_is_too_coarse_for_what_is_below_half_its_edge():
    organ = ball(2)
    half = 0.5 * mean_edge(organ)
    assert unresolved_tools_of(organ, half) is None
    why = unresolved_tools_of(organ, 0.5 * half)
    assert why is not None
    assert f"{0.5e3 * half:.3g} mm" in why
    assert f"{2e3 * half:.3g} mm" in why
    assert re.search(r"--points (\d+) \((\d+) for an error of 8 %\)", why).groups() == (
        str(points_for(organ, 0.5 * half)),
        str(points_for(organ, 0.5 * half, FINE)),
    )
    finest = unresolved_tools_of(organ, 0.01 * half)
    assert finest is not None
    assert f"for which --points {MOST_POINTS} is sufficient" in finest
