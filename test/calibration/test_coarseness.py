"""Organs whose triangles are too large to be calibrated well are named, with what to build them with."""

import re
from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, kidney
from helpers.shapes import solid
from tissue_sim.calibration.coarseness import AUTO, check_coarseness, coarseness
from tissue_sim.errors import UserError
from tissue_sim.organ.pipeline import organ_from_mask
from tissue_sim.organ.refinement import Refinement
from tissue_sim.organ.request import Request


def asked(organ):
    """Why an organ's triangles are too large, and the points that would do everywhere."""
    text = coarseness(organ)
    return text, int(re.findall(r"--points (\d+)", text)[-1])


EVEN = Refinement()


def tube(points, refinement=EVEN, **provenance):
    """A tube bent to a half circle of 40 mm radius, from 7 to 2 mm in radius, held at its thick end."""

    def outside(x, y, z):
        y = y + 25.0
        along = np.clip(np.arctan2(y, -x), 0.0, np.pi)
        axis = -40.0 * np.cos(along), 40.0 * np.sin(along)
        return np.sqrt((x - axis[0]) ** 2 + (y - axis[1]) ** 2 + z**2) - (7.0 - 5.0 * along / np.pi)

    mask = solid(outside, size=(104, 80, 24))
    request = Request("tube", points, fixed="y<0.1", refinement=refinement, provenance=provenance)
    return organ_from_mask(mask, request)


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


def refined_as_asked(organ, points):
    """The tube as `coarseness` asks for it, and how many points it foretells; points: of the organ at hand."""
    asked_for = re.search(r"--refine auto(?: --points (\d+))? \(about (\d+) points\)", coarseness(organ))
    return tube(int(asked_for[1] or points), AUTO), int(asked_for[2])


@pytest.mark.parametrize("points", [150, 250])
def test_a_thin_bent_tube_that_is_refined_as_asked_for_is_fine_enough(points):
    """With 150 points, refinement alone falls short, and more are asked for with it."""
    found, foretold = refined_as_asked(tube(points), points)
    assert coarseness(found) is None
    assert found.n_surface == pytest.approx(foretold, rel=0.15)


def test_a_thin_bent_tube_with_the_points_asked_for_is_fine_enough():
    assert coarseness(tube(asked(tube(250))[1])) is None


def test_what_was_refined_and_is_still_too_coarse_is_not_asked_for_the_same_again():
    coarse = tube(100, AUTO, refine=["auto"])
    assert re.search(r"build it with --refine auto --points \d+ \(about \d+ points\)$", coarseness(coarse))
    found, foretold = refined_as_asked(coarse, 100)
    assert coarseness(found) is None
    assert found.n_surface < foretold, "an upper bound"


def test_a_refinement_that_falls_short_is_not_recommended():
    flat = replace(ball(3), surface_positions=ball(3).surface_positions * [1.0, 1.0, 0.06])
    assert "--refine" not in coarseness(flat)


def test_nothing_is_recommended_that_takes_too_many_points():
    needle = replace(ball(2), atom_radius=np.full(5, 2e-4))
    assert re.search(r"build it with another --fixed: more than 20000 points would be needed", coarseness(needle))
