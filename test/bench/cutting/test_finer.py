"""Loads on a finer organ: the same tractions, each on its own side of the cut."""

import numpy as np
import pytest

from helpers.scenes import ball_of_cells
from tissue_sim.bench.cutting.finer import onto_finer
from tissue_sim.model.cutting.sheet import sheet_of
from tissue_sim.organ.refined import refined
from tissue_sim.organ.refinement import Along, Refinement

CUT = [[-0.01, 0.001, 0.03], [0.01, 0.001, 0.03]], [0.0, 0.0, -1.0], 0.02


@pytest.fixture(scope="module")
def organs():
    organ = ball_of_cells(2, 60)
    return organ, refined(organ, Refinement(places=(Along(np.array(CUT[0]), 0.008, 0.003),)))


def test_force_is_kept_and_stays_where_nothing_is_finer(organs):
    organ, finer = organs
    onto = onto_finer(organ, finer, sheet_of(organ, *CUT))
    force = np.random.default_rng(0).normal(size=(organ.n_surface, 3))
    np.testing.assert_allclose(onto.spread(force).sum(axis=0), force.sum(axis=0), rtol=1e-12)
    force[organ.surface_positions[:, 2] > -0.01] = 0.0
    np.testing.assert_allclose(onto.spread(force)[: organ.n_surface], force, rtol=1e-9, atol=1e-12)


def test_no_force_passes_the_cut(organs):
    organ, finer = organs
    sheet = sheet_of(organ, *CUT)
    onto = onto_finer(organ, finer, sheet)
    place, own = sheet.place(finer.surface_positions), sheet.place(organ.surface_positions)
    beyond = (place.across < 0.0)[:, None] != (own.across < 0.0)[None]
    shut = beyond & sheet.covers(place)[:, None]
    assert shut.any()
    assert not onto.fraction[shut].any()
    assert onto.fraction.min() >= 0.0
