"""A fresh process to its first tick."""

import pytest

from helpers.scenes import ball
from tissue_sim.bench.start import first_start
from tissue_sim.errors import UserError
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.shipped import shipped_organ


def test_first_start_takes_time():
    Simulation(ball(1)).step()  # the kernels are on disk now
    start = first_start(shipped_organ(), compiled=True)
    assert 0.1 < start.processor < 60.0
    assert 0.1 < start.wall < 120.0


def test_organ_that_can_not_be_read_is_told(tmp_path):
    with pytest.raises(UserError, match="first tick"):
        first_start(tmp_path / "none.npz", compiled=True)
