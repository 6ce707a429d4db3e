"""Solids between surfaces that are led, and ticks that are timed."""

import numpy as np
import pytest

from helpers.scenes import ball_of_cells
from tissue_sim.model.simulation import Simulation

pytest.importorskip("skfem")

from helpers.blocks import box
from tissue_sim.bench.measured.body import solve_prescribed_surface, timed
from tissue_sim.errors import UserError


@pytest.fixture
def solid():
    """A box whose surface is led."""
    sides = np.linspace(0.0, 0.02, 4)
    made = box(np.linspace(0.0, 0.03, 5), sides, sides)
    low, high = made.nodes.min(axis=0), made.nodes.max(axis=0)
    made.held[((made.nodes == low) | (made.nodes == high)).any(axis=1)] = True
    assert not made.held.all()
    return made


def test_a_surface_led_affinely_leads_the_inside_likewise(solid):
    """Any homogeneous deformation is in equilibrium, however large."""
    stretch = np.array([[0.8, 0.1, 0.0], [0.0, 1.1, -0.1], [0.05, 0.0, 1.05]]) - np.eye(3)
    found = solve_prescribed_surface(solid, solid.nodes @ stretch.T)
    np.testing.assert_allclose(found, solid.nodes @ stretch.T, atol=1e-8)


def test_a_surface_led_through_itself_is_refused(solid):
    with pytest.raises(UserError, match="don't converge with its surface prescribed"):
        solve_prescribed_surface(solid, -1.5 * solid.nodes)


def test_ticks_are_timed_and_counted():
    simulation, seen = Simulation(ball_of_cells()), []
    rate = timed(simulation, 20, lambda: seen.append(int(simulation.state.status.tick)))
    assert seen == list(range(1, 21))
    assert 0.0 < rate.median <= rate.p99
    assert rate.faults == 0
