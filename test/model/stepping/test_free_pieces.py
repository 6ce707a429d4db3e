"""A piece that is cut off goes where it goes: no fault, no return to rest, and sleep where it lies."""

import numpy as np
import pytest

from helpers.slabs import THROUGH, slab
from tissue_sim.model.simulation import Simulation

FASTEST = 90.0  # 1/s times the organ's size: from 100 on the guard takes it for a runaway


@pytest.fixture
def parted():
    """A slab held at its left end, cut through: the right half is free."""
    return Simulation(slab("left")).cut(*THROUGH)


def send_off(simulation):
    """Throw the free half along x, and step until it has come to rest; return its nodes."""
    free = np.flatnonzero(simulation.model.free)
    simulation.step()
    simulation.velocities[free, 0] = FASTEST * simulation.settings.runaway_span
    for _ in range(200):
        simulation.step(50)
        if simulation.asleep:
            return free
    raise AssertionError(np.abs(simulation.velocities).max())


def test_only_the_half_without_fixed_nodes_is_free(parted):
    free = np.flatnonzero(parted.model.free)
    assert parted.cuts[0].free_pieces == 1
    assert 0 < len(free) < parted.organ.n_nodes
    assert not np.isin(parted.organ.fixed, free).any()
    cells = np.isin(parted.organ.cell_nodes, free)
    assert np.array_equal(cells.any(axis=1), cells.all(axis=1)), "no cell joins the two"
    assert len(Simulation(slab("left")).model.free) == 0
    assert len(Simulation(slab("")).cut(*THROUGH).model.free) == 0, "nothing is held, and nothing cut off"


def test_a_piece_may_be_farther_away_than_the_organ_is_long_and_sleeps_there(parted):
    parted.apply_force([0], [[0.0, 0.0, 1e-6]])  # wakes it
    free = send_off(parted)
    rest = parted.model.rest
    away = np.linalg.norm(parted.positions - rest, axis=1)
    assert away[free].min() > parted.settings.runaway_span
    assert np.delete(away, free).max() == 0.0, "the held half is at rest, to the last bit"
    assert (parted.state.count.faults, parted.state.count.snaps) == (0, 0)
    lies = parted.positions[free].copy()
    parted.apply_force([0], [[0.0, 0.0, 0.01]])
    parted.step(100)
    assert np.abs(parted.positions[free] - lies).max() < 1e-4, "where the other half is touched, it stays"
    parted.reset()
    np.testing.assert_array_equal(parted.positions, rest)


def test_a_piece_that_is_not_finite_is_a_fault_all_the_same(parted):
    parted.apply_force([0], [[0.0, 0.0, 1e-3]])
    parted.step(8)
    parted.positions[np.flatnonzero(parted.model.free)[0], 1] = np.nan
    parted.step()
    assert parted.state.count.faults == 1
    assert np.isfinite(parted.positions).all()
