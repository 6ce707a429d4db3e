"""The fit of the cells' stiffening finds the factor of a body whose factor is known."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from helpers.scenes import ball_of_cells
from tissue_sim.calibration.cases import Cases
from tissue_sim.calibration.evaluation import settled_answers
from tissue_sim.calibration.stiffening_fit import SHARP, SMOOTH, STEPS, fit_stiffening
from tissue_sim.model.simulation import Simulation

ORGAN = replace(ball_of_cells(2, 40), stiffening=8.0)


class Found(NamedTuple):
    displacement: np.ndarray
    converged: bool


class Twin:
    """A body of the organ's own cells with a known factor, in place of finite elements."""

    def __init__(self, factor, converges=True):
        self.simulation = Simulation(replace(ORGAN, cell_stiffening=factor))
        self.converges = converges

    def settle_linear(self, forces):
        small = 1e-3
        return np.stack([self.simulation.settle(small * force, 1e-3, 20.0, 0.3)[0] for force in forces]) / small

    def settle_many(self, forces):
        for force in forces:
            yield Found(self.simulation.settle(force, 1e-4, 20.0, 0.3)[0], self.converges)


@pytest.mark.extended
def test_the_factor_of_a_twin_is_found():
    steps = []
    assert fit_stiffening(ORGAN, Twin(1.7), 0, lambda remark="": steps.append(remark)) == pytest.approx(1.7, rel=0.05)
    assert SMOOTH + SHARP < len(steps) <= STEPS
    assert steps[-1].startswith("factor 1.")


def test_without_a_load_that_converges_the_cells_stay_as_they_are():
    assert fit_stiffening(ORGAN, Twin(1.7, converges=False), 0, lambda remark="": None) == 1.0


def test_a_larger_factor_stiffens_what_is_deep():
    twin = Twin(1.0)
    force = np.zeros((1, ORGAN.n_surface, 3))
    force[0, np.argsort(-ORGAN.surface_positions[:, 2])[:5], 2] = -0.1
    depth = [
        np.abs(settled_answers(replace(ORGAN, cell_stiffening=factor), _cases(force)).displacement).max()
        for factor in (1.0, 3.0)
    ]
    assert depth[1] < 0.95 * depth[0]
    assert depth[0] == pytest.approx(np.abs(next(twin.settle_many(force)).displacement).max(), rel=1e-3)


def _cases(force):
    return Cases(force, [np.array([0])], ["sharp"])
