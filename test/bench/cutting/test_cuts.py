"""The cuts of the benchmark: where they lie, and the loads on them."""

import numpy as np
import pytest

from helpers.bars import bar
from tissue_sim.bench.cutting.cuts import (
    CLOSING,
    CUTS,
    GENTLE,
    MOST_TRACTION,
    OPENING,
    PATCH,
    Cut,
    loads_of,
    placed,
    scaled,
)
from tissue_sim.calibration.cases import tractions
from tissue_sim.errors import UserError

TOP = (0.2, 0.05, 1.0)


@pytest.fixture(scope="module")
def organ():
    return bar(12, 0.01, 4)


@pytest.mark.parametrize("shape", ["flat", "curved", "L"])
def test_a_cut_follows_the_surface_and_keeps_clear_of_its_nodes(organ, shape):
    place = placed(organ, Cut("bar", shape, 0.03, 0.012, TOP, 35.0))
    np.testing.assert_allclose(place.sheet.polyline[:, 2], 0.04, atol=1e-9)
    assert place.into[2] < -0.9
    assert place.sheet.reached == pytest.approx(0.012, rel=1e-3)
    lengths = np.linalg.norm(np.diff(place.sheet.polyline, axis=0), axis=1)
    assert lengths.sum() == pytest.approx(0.03, rel=0.03)
    near = organ.surface_positions[np.abs(organ.surface_positions[:, 2] - 0.04) < 1e-9]
    at = place.sheet.place(near)
    assert np.abs(at.across[place.sheet.covers(at)]).min(initial=1.0) > 2e-4
    side = place.sheet.place((place.middle + 1e-3 * place.across)[None]).across[0]
    assert side == pytest.approx(np.sqrt(0.5) * 1e-3 if shape == "L" else 1e-3, rel=0.02)


def test_nine_loads_of_a_newton_on_patches_of_one_side(organ):
    place = placed(organ, Cut("bar", "flat", 0.03, 0.012, TOP, 90.0))
    loads = loads_of(organ, place)
    assert len(set(loads.names)) == len(loads.names) == 9
    size = np.linalg.norm(loads.force, axis=2).sum(axis=1)
    np.testing.assert_allclose(size, [1, 2, 1, 1, 1, 2, 1, 1, 1], rtol=1e-6)
    both = loads.force[loads.names.index(OPENING)]
    np.testing.assert_allclose(both.sum(axis=0), 0.0, atol=1e-9)
    side = place.sheet.place(organ.surface_positions).across
    assert (both @ place.across)[side > 0.0].min() >= 0.0
    assert (both @ place.across)[side < 0.0].max() <= 0.0
    assert (loads.force.any(axis=2).sum(axis=1) % PATCH == 0).all()
    assert not loads.force[:, organ.fixed].any()


def test_loads_are_limited_by_reach_force_and_traction(organ):
    loads = loads_of(organ, placed(organ, Cut("bar", "flat", 0.03, 0.012, TOP, 90.0)))
    weak = scaled(organ, loads, np.full(9, 10.0))
    gentle = np.where([name == CLOSING for name in loads.names], GENTLE, 1.0)[:, None, None]
    np.testing.assert_allclose(weak.force, 0.0008 * gentle * loads.force)
    strong = scaled(organ, loads, np.full(9, 1e-9))
    assert tractions(strong.force, organ).max() <= MOST_TRACTION * organ.youngs_modulus * (1.0 + 1e-9)


def test_a_cut_that_leaves_the_organ_and_an_unknown_shape_are_named(organ):
    with pytest.raises(UserError, match="leaves organ 'bar'"):
        placed(organ, Cut("bar", "flat", 0.2, 0.012, TOP))
    with pytest.raises(UserError, match="no shape 'round'"):
        placed(organ, Cut("bar", "round", 0.03, 0.012, TOP))


def test_cuts_are_of_three_organs_and_three_shapes():
    assert {cut.organ for cut in CUTS} == {"kidney", "slab", "liver"}
    assert {cut.shape for cut in CUTS} == {"flat", "curved", "L"}
    assert len(CUTS) >= 8
    assert min(cut.depth for cut in CUTS) == 0.005
    assert max(cut.depth for cut in CUTS) == 0.02
