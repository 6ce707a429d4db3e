"""How thick the tissue around a cut is: its lips, which are reported, and what is left beyond its front."""

import re

import numpy as np
import pytest

from helpers.slabs import INCISION, MIDDLE, SIZE, slab
from tissue_sim.model.cutting.sheet import MAX_DEPTH, sheet_of
from tissue_sim.model.cutting.thickness import lip_thickness, with_ligament
from tissue_sim.model.simulation import Simulation

DOWN = [0.0, 0.0, -1.0]


def beside(x, *between, depth=0.013):
    """A cut of the slab from side to side, through places between, m."""
    return [[x, -0.01, 0.031], *between, [x, 0.04, 0.031]], DOWN, depth


@pytest.mark.parametrize("depth", [0.013, 0.05], ids=["in", "through"])
@pytest.mark.parametrize(("x", "wanted"), [(0.006, 0.006), (MIDDLE, SIZE[0] - MIDDLE), (0.0361, 0.0039)])
def test_the_thickness_of_the_thinner_lip_is_its_distance_from_the_surface(x, wanted, depth):
    assert lip_thickness(slab(), sheet_of(slab(), *beside(x, depth=depth))) == pytest.approx(wanted, abs=1e-9)
    polyline, *rest = beside(x, depth=depth)
    assert lip_thickness(slab(), sheet_of(slab(), polyline[::-1], *rest)) == pytest.approx(wanted, abs=1e-9)


def test_a_cut_that_is_narrow_in_places_has_the_thickness_of_its_middle():
    """Half of this one is 6 mm from the side, the other half recedes from it."""
    bent = [[0.006, -0.01, 0.031], [0.006, 0.015, 0.031], [0.016, 0.03, 0.031]], DOWN, 0.013
    assert 0.006 <= lip_thickness(slab(), sheet_of(slab(), *bent)) < 0.012


def test_a_cut_with_a_thin_lip_is_reported_as_not_resolved():
    thin, thick = (Simulation(slab()).cut(*one).cuts[0] for one in (beside(0.006), INCISION))
    assert (thin.resolved, thick.resolved) == (False, True)
    assert thin.lip == pytest.approx(0.006)
    found = re.search(r"not resolved: its thinner lip is 6\.0 mm thick, and needs ([\d.]+) mm, two edges", str(thin))
    assert float(found[1]) == pytest.approx(1e3 * thin.resolved_from, abs=0.05)
    assert thin.depth > thin.resolved_from, "it is deep enough"
    wanted = float(re.search(r":([\d.]+) --out", thin.finer)[1])
    assert wanted == pytest.approx(3.0, abs=0.05), "half of the lip, mm"
    assert "not resolved" not in str(thick)


# beyond the front ----------------------------------------------------------------------------------
def test_the_tissue_beyond_a_front_is_measured_to_the_surface():
    """This cut ends 10 mm above the floor, 4 mm before one side, and outside of the other."""
    sheet = with_ligament(slab(), sheet_of(slab(), [[MIDDLE, -0.01, 0.031], [MIDDLE, 0.026, 0.031]], DOWN, 0.021))
    found = sheet.ligament
    is_inside = (found.along > 0.0101) & (found.along <= 0.036)
    np.testing.assert_allclose(found.below[is_inside], 0.01, atol=1e-9)
    assert np.all(found.below[found.along < 0.0099] == MAX_DEPTH)
    assert np.all(found.before == MAX_DEPTH), "it begins outside"
    np.testing.assert_allclose(found.after[found.deep > 0.0011], 0.004, atol=1e-9)
    assert np.all(found.after[found.deep < 0.0009] > 10.0 * 0.004), "there it is above the surface"
    assert with_ligament(slab(), sheet) is sheet


@pytest.mark.parametrize("left", [0.001, 0.003])
@pytest.mark.parametrize("turned", [False, True])
def test_tissue_that_a_cut_leaves_holds_both_sides_together(left, turned):
    """The front is moved by 3 mm elsewhere, which would cut these organs through."""
    deep = [[MIDDLE, -0.01, 0.031], [MIDDLE, 0.04, 0.031]], DOWN, 0.031 - left
    wide = [[MIDDLE, -0.01, 0.031], [MIDDLE, SIZE[1] - left, 0.031]], DOWN, 0.05
    through = [[MIDDLE, -0.01, 0.031], [MIDDLE, 0.04, 0.031]], DOWN, 0.05
    for polyline, direction, depth in (deep, wide):
        report = Simulation(slab()).cut(polyline[::-1] if turned else polyline, direction, depth).cuts[0]
        assert report.advance > 0.003
        assert report.pieces == 1
        assert report.front_cells > 0
    assert Simulation(slab()).cut(*through).cuts[0].pieces == 2


@pytest.mark.parametrize("left", [0.002, 0.003, 0.004])
def test_a_part_of_what_is_left_beyond_a_front_stays_whole(left):
    """Half of it beyond an end, and a quarter below, where the rest is a hinge."""
    deep, wide = (
        with_ligament(slab(), sheet_of(slab(), [[MIDDLE, -0.01, 0.031], [MIDDLE, end, 0.031]], DOWN, depth))
        for end, depth in ((0.04, 0.031 - left), (SIZE[1] - left, 0.05))
    )
    beyond = np.linspace(0.0, left, 401)
    middle, far = np.full(401, MIDDLE), np.full(401, 0.015)
    for sheet, places, whole in ((deep, (middle, far, beyond), 0.25), (wide, (middle, SIZE[1] - beyond, far), 0.5)):
        at = np.stack(places, axis=1)
        covered = sheet.covers_advanced(sheet.place(at), left)
        assert beyond[covered].min() == pytest.approx(whole * left, abs=left / 400)
        assert covered.sum() == pytest.approx((1.0 - whole) * 401, abs=2)
        assert sheet.covers_advanced(sheet.place(at), 1e-4).sum() < 0.1 * 401 + 2, "no farther than the advance"
