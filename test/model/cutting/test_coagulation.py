"""Walls that heat has coagulated: a stretched bar in closed form, what stays as it is, and the critical step."""

import numpy as np
import pytest

from helpers.bars import bar
from helpers.slabs import INCISION, slab
from tissue_sim.model.cutting.cut import CutOrgan, cut_again, without_cuts
from tissue_sim.model.cutting.sheet import Coagulation, sheet_of
from tissue_sim.model.elasticity.cells import shapes_of
from tissue_sim.model.simulation import Simulation

BESIDE = 0.009  # m, where the bar is cut along its whole length
ALONG = [[-0.01, BESIDE, 0.021], [0.13, BESIDE, 0.021]], [0.0, 0.0, -1.0], 0.05
ACROSS = [[0.054, -0.01, 0.021], [0.054, 0.03, 0.021]], [0.0, 0.0, -1.0], 0.05
STRETCH = np.array([1.2, 0.93, 0.93])


def cut(organ, *cuts, heat=None) -> CutOrgan:
    """The organ after cuts, all of which are as hot."""
    made = without_cuts(organ)
    for one in cuts:
        made = cut_again(made, sheet_of(organ, *one)._replace(coagulation=heat or Coagulation()))
    return made


def energy(organ, stretch) -> float:
    """J in neo-Hookean cells that are all stretched alike."""
    volume, swelling = shapes_of(organ.rest_positions, organ.cell_nodes)[1], np.prod(stretch)
    of_shape = 0.5 * (np.sum(np.square(stretch)) - 3.0 - 2.0 * np.log(swelling))
    of_volume = 0.25 * (swelling**2 - 1.0 - 2.0 * np.log(swelling))
    return float(volume @ (organ.cell_mu * of_shape + organ.cell_lambda * of_volume))


@pytest.mark.parametrize("spread", [0.0005, 0.003, 0.02], ids=["thin", "beyond the divided cells", "through"])
def test_a_bar_with_coagulated_walls_is_stiffer_by_the_volume_that_the_heat_reaches(spread):
    """Stretched along the wall all tissue works in parallel, so that the mean of its volume is exact."""
    cold, hot = bar(), cut(bar(), ALONG, heat=Coagulation(4.0, spread)).organ
    reached = min(spread, BESIDE) + min(spread, 0.02 - BESIDE)  # m of the bar's width, on both sides
    wanted = energy(cold, STRETCH) * (1.0 + 3.0 * reached / 0.02)
    assert energy(hot, STRETCH) == pytest.approx(wanted, rel=1e-9)


def test_heat_of_two_cuts_counts_once_where_it_meets():
    hot = cut(bar(), ALONG, ACROSS, heat=Coagulation(4.0, 0.02))
    factor = hot.organ.cell_mu / (bar().cell_mu[hot.cell_of] * hot.fraction)
    assert factor.max() == pytest.approx(4.0, rel=1e-12)
    assert factor.min() > 1.0


def test_a_cold_cut_has_the_same_bits_and_a_hot_one_the_same_masses():
    plain, without = cut(bar(), ACROSS), cut(bar(), ACROSS, heat=Coagulation(1.0, 0.003))
    hot = cut(bar(), ACROSS, heat=Coagulation(4.0, 0.003))
    assert plain.organ.to_bytes() == without.organ.to_bytes()
    assert plain.reports[0].stiffer_cells == 0
    np.testing.assert_array_equal(plain.organ.mass, hot.organ.mass)
    stiffer = int((hot.organ.cell_mu > plain.organ.cell_mu).sum())
    assert stiffer == hot.reports[0].stiffer_cells > 0
    assert f"{stiffer} cells at coagulated walls are stiffer" in str(hot.reports[0])


def test_heat_ends_where_the_cut_does():
    """What is still whole of a torn cell stays cold, and so do cells below the front."""
    plain, hot = cut(slab(), INCISION), cut(slab(), INCISION, heat=Coagulation(4.0, 0.004))
    ratio = hot.organ.cell_mu / plain.organ.cell_mu
    whole = np.isin(hot.cell_of, hot.cell_of[hot.side != 0]) & (hot.side == 0)
    assert whole.any()
    assert np.all(ratio[whole] == 1.0)
    below = plain.organ.rest_positions[plain.organ.cell_nodes].max(axis=1)[:, 2] < 0.0051
    assert below.any()
    assert np.all(ratio[below] == 1.0)


def test_substeps_follow_the_stiffer_walls():
    """No mode is faster than by the root of the factor, as no cell is stiffer by more."""
    uncut, factor = Simulation(slab()), 16.0
    cold, hot = (
        uncut.prepared_sheet(sheet_of(slab(), *INCISION)._replace(coagulation=Coagulation(stiffening, 0.004)))
        for stiffening in (1.0, factor)
    )
    assert cold.critical_step / np.sqrt(factor) <= hot.critical_step < 0.6 * cold.critical_step
    assert hot.settings.substeps > cold.settings.substeps
    hot.continue_from(uncut)
    place = hot.model.rest
    ends = np.flatnonzero((place[:, 0] == 0.0) | (place[:, 0] == place[:, 0].max()))
    hot.prescribe(ends, place[ends] + [0.0, 0.0, 0.002], 20)
    hot.step(200)
    assert hot.state.count.faults == 0
    assert hot.energy.kinetic < 1e-3 * hot.energy.elastic
