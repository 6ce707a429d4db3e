"""Gravity: free fall, weight on what holds, a shape that bears it, and the shape without it."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, ball_of_cells, changed, free_ball
from tissue_sim.errors import UserError
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.cells import swelling
from tissue_sim.model.simulation import Simulation

DOWN = np.array([1.0, -2.0, -9.0])  # m/s^2
NONE = np.zeros(3)


def no_force(organ):
    return np.zeros((organ.n_surface, 3))


def replace_shape(organ, positions):
    surface, atoms, interior = np.split(positions, np.cumsum([organ.n_surface, organ.n_atoms]))
    return replace(organ, surface_positions=surface, atom_positions=atoms, interior_positions=interior)


def settled(simulation):
    _, good = simulation.settle(no_force(simulation.organ), tolerance=1e-6, ramp=0.3)
    assert good
    return simulation.positions.copy()


def test_free_body_falls_as_a_whole():
    organ = free_ball(2)
    simulation = Simulation(organ, gravity=DOWN, shape_gravity=NONE)
    simulation.settings.damping_scale = 0.0
    simulation.set_substeps()
    for _ in range(50):
        simulation.step()
    np.testing.assert_allclose(simulation.velocities, np.tile(0.05 * DOWN, (organ.n_nodes, 1)), atol=1e-9)
    fallen = simulation.positions - simulation.model.rest
    step = 1e-3 / simulation.state.status.substeps
    np.testing.assert_allclose(fallen, np.tile(0.5 * 0.05 * (0.05 + step) * DOWN, (organ.n_nodes, 1)), atol=1e-9)


@pytest.mark.parametrize(
    "organ", [changed(ball(2), return_stiffness=0.0), ball_of_cells(2, 120)], ids=["springs", "cells"]
)
def test_what_holds_the_organ_bears_its_weight(organ):
    simulation = Simulation(organ, gravity=DOWN, shape_gravity=NONE)
    settled(simulation)
    assert not simulation.asleep
    held = simulation.reactions().sum(axis=0)
    moving = simulation.model.moving
    weight = np.sum(1.0 / simulation.model.inverse_mass[moving]) * DOWN
    np.testing.assert_allclose(held, -weight, atol=1e-4 * np.linalg.norm(weight))


def test_shape_that_was_taken_under_gravity_rests_as_it_is():
    organ = ball_of_cells(2, 120)
    simulation = Simulation(organ, gravity=DOWN)
    simulation.state.status.asleep = False
    for _ in range(10):
        simulation.step()
        np.testing.assert_array_equal(simulation.positions, organ.rest_positions)
    assert np.abs(simulation.model.unloaded - organ.rest_positions).max() > 1e-4
    moving = simulation.model.moving
    weight = DOWN / simulation.model.inverse_mass[moving, None]
    assert np.abs(simulation.model.borne[moving] - weight).max() < 1e-8 * np.abs(weight).max()
    for _ in range(50):
        simulation.apply_force([5], [[0.0, 0.0, -0.1]])
        simulation.step()
    assert np.abs(simulation.positions - organ.rest_positions).max() > 1e-4
    for _ in range(2000):
        simulation.step()
    assert simulation.asleep
    np.testing.assert_array_equal(simulation.positions, organ.rest_positions)


def test_unloaded_shape_sags_into_the_one_that_was_known():
    organ = ball_of_cells(2, 120)
    unloaded = assemble(organ, shape_gravity=DOWN).unloaded
    fixed = organ.fixed
    np.testing.assert_array_equal(unloaded[fixed], organ.rest_positions[fixed])
    sagging = Simulation(replace_shape(organ, unloaded), gravity=DOWN, shape_gravity=NONE)
    sag = np.abs(unloaded - organ.rest_positions).max()
    assert np.abs(settled(sagging) - organ.rest_positions).max() < 1e-3 * sag


def test_without_gravity_it_goes_to_its_unloaded_shape():
    simulation = Simulation(ball_of_cells(2, 120), gravity=DOWN)
    simulation.set_gravity(NONE)
    unloaded = simulation.model.unloaded
    sag = np.abs(unloaded - simulation.model.rest).max()
    assert np.abs(settled(simulation) - unloaded).max() < 1e-3 * sag
    assert simulation.energy.elastic < 1e-6


def test_weight_of_an_organ_that_rests_is_never_worked_out():
    simulation = Simulation(ball_of_cells(2, 120), gravity=DOWN)
    for _ in range(5):
        simulation.step()
    assert simulation.asleep
    assert simulation.state.count.asleep_ticks == 5


def test_cells_that_the_weight_squeezes_flat_bear_it_by_their_own_law():
    """Twelve times the weight: under 0.4 of its volume a cell's pressure goes on in a straight line, with a penalty."""
    organ = ball_of_cells()
    model = assemble(organ, shape_gravity=12.0 * DOWN)
    weight = 12.0 * DOWN / model.inverse_mass[model.moving, None]
    loaded = replace_shape(organ, model.unloaded)
    assert swelling(assemble(loaded), organ.rest_positions).min() < 0.5
    assert np.abs(model.borne[model.moving] - weight).max() < 1e-7 * np.abs(weight).max()


@pytest.mark.extended
def test_too_soft_a_tissue_is_named():
    organ = ball_of_cells(2, 120)
    soft = replace(organ, cell_mu=1e-3 * organ.cell_mu, cell_lambda=1e-3 * organ.cell_lambda)
    with pytest.raises(UserError, match="too soft"):
        Simulation(soft, gravity=DOWN)


@pytest.mark.parametrize("bad", [[0.0, 1.0], "down", [0.0, np.nan, 0.0], [0.0, 0.0, -1e4], None])
def test_bad_gravity_is_named(bad):
    with pytest.raises(UserError, match="gravity"):
        Simulation(ball(), gravity=bad)
