"""Tangent stiffness and vibration modes, against the force kernels and against closed forms."""

import contextlib

import numpy as np
import pytest
from scipy.linalg import eigh

from helpers.kernels import by_reference
from helpers.scenes import ball, changed, free_ball
from tissue_sim.errors import UserError
from tissue_sim.model.data.state import Region
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.model.elasticity.modes import lowest_modes, stiffness_matrix
from tissue_sim.model.regions.mode_motion import FASTEST, advance_modes
from tissue_sim.model.simulation import Simulation


def differences(model):
    """Dense stiffness (3n, 3n) from central differences of the force kernels."""
    size = model.rest.size
    matrix = np.zeros((size, size))
    for column in range(size):
        step = np.zeros(size)
        step[column] = 1e-8
        ahead, behind = np.zeros_like(model.rest), np.zeros_like(model.rest)
        elastic_forces(model, model.rest + step.reshape(-1, 3), 1.0, ahead)
        elastic_forces(model, model.rest - step.reshape(-1, 3), 1.0, behind)
        matrix[:, column] = (behind - ahead).ravel() / 2e-8
    return matrix


@pytest.mark.parametrize("variant", ["surface", "volume", "hybrid"])
def test_stiffness_is_the_slope_of_the_forces(variant):
    model = assemble(ball(), variant)
    expected = differences(model)
    assert np.abs(stiffness_matrix(model).toarray() - expected).max() <= 1e-6 * np.abs(expected).max()


@pytest.mark.parametrize("variant", ["surface", "hybrid"])
def test_modes_solve_the_eigenvalue_problem(variant):
    model = assemble(ball(), variant)
    modes = lowest_modes(model, 20)
    free = (3 * model.moving[:, None] + np.arange(3)).ravel()
    stiffness = stiffness_matrix(model).toarray()[np.ix_(free, free)]
    mass = np.diag(np.repeat(1.0 / model.inverse_mass[model.moving], 3))
    expected = np.sqrt(eigh(stiffness, mass, eigvals_only=True)[:20])
    np.testing.assert_allclose(modes.frequency, expected, rtol=1e-8)
    shape = modes.shape.reshape(-1, 20)[free]
    np.testing.assert_allclose(shape.T @ mass @ shape, np.eye(20), atol=1e-9)
    product = stiffness @ shape - mass @ shape * modes.frequency**2
    assert np.abs(product).max() <= 1e-8 * np.abs(stiffness @ shape).max()


def test_held_nodes_have_no_share_in_the_modes():
    organ = ball()
    modes = lowest_modes(assemble(organ))
    np.testing.assert_array_equal(modes.shape[organ.fixed], 0.0)
    assert np.abs(modes.shape).max() > 0.0


def test_modes_under_a_constant_load_follow_the_damped_oscillators():
    """q'' + c q' + w^2 q = p from rest, in closed form, each mode by itself."""
    organ, force = ball(2), np.array([0.002, 0.0, -0.004])
    simulation = Simulation(organ, local_region="modal")
    node = int(np.argmax(organ.surface_positions[:, 2]))
    simulation.apply_force(node, force)
    simulation.step()
    state, world = simulation.state, by_reference(simulation)
    for moved in (state.static_load, state.mode_position, state.mode_velocity):
        moved[:] = 0.0
    state.static_load[node] = force
    for _ in range(40):
        advance_modes(world.model, world.state, world.settings, world.scratch)
    model, time = simulation.model, 0.040
    pull = model.reduction.shape[node].T @ force
    half = 0.5 * model.damping_rate
    square = model.reduction.frequency**2
    turn = np.sqrt((square - half**2).astype(complex))
    wave = np.cos(turn * time) + half * np.sin(turn * time) / turn
    expected = pull / square * (1.0 - np.exp(-half * time) * wave.real)
    fast = model.reduction.frequency * 1e-3 > FASTEST
    assert not fast.all()
    # What is too fast for a tick follows the load; single precision in the loads.
    expected[fast] = (pull / square)[fast]
    np.testing.assert_allclose(state.mode_position, expected, atol=1e-6 * np.abs(expected).max())


def test_modal_region_settles_near_the_whole_model_and_frozen_does_not():
    organ = ball(3)
    forces = np.zeros((organ.n_surface, 3))
    node = int(np.argmax(organ.surface_positions[:, 2]))
    near = np.argsort(np.linalg.norm(organ.surface_positions - organ.surface_positions[node], axis=1))[:19]
    forces[near, 2] = -0.2 / 19
    answers = {region: Simulation(organ, local_region=region).settle(forces) for region in ("off", "modal", "frozen")}
    whole, settled = answers["off"]
    assert settled
    assert answers["modal"][1]
    size = np.linalg.norm(whole)
    assert np.linalg.norm(answers["modal"][0] - whole) < 0.12 * size
    assert np.linalg.norm(answers["frozen"][0] - whole) > 0.3 * size


def test_auto_hands_over_to_the_whole_model_without_a_jump():
    organ = ball(3)
    simulation = Simulation(organ, local_region="auto")
    node = int(np.argmax(organ.surface_positions[:, 2]))
    regions, heights = [], []
    for tick in range(200):
        simulation.apply_force(node, [0.0, 0.0, -0.6 * min(1.0, tick / 150)])
        simulation.step()
        regions.append(int(simulation.state.status.region))
        heights.append(simulation.positions[node, 2])
    change = regions.index(Region.WHOLE)
    assert 20 < change < 150
    assert set(regions[:change]) == {Region.MODAL}
    assert set(regions[change:]) == {Region.WHOLE}
    # The loaded node goes on as before: no step much larger than the ones around it.
    steps = np.abs(np.diff(heights))
    assert steps[change - 2 : change + 3].max() < 2.0 * np.median(steps[change - 10 : change + 10])
    assert simulation.state.count.faults == 0


def test_organ_with_very_few_free_nodes_has_fewer_modes():
    modes = lowest_modes(assemble(ball()), 1000)
    model = assemble(ball())
    assert len(modes.frequency) == 3 * len(model.moving) - 2
    assert np.all(np.diff(modes.frequency) >= 0.0)


ADRIFT = {
    "free": free_ball(),
    "slack": changed(ball(), spring_stiffness=0.0, angular_stiffness=0.0, return_stiffness=0.0),
}


@pytest.mark.parametrize("organ", ADRIFT.values(), ids=ADRIFT)
def test_organ_without_modes_of_its_own_is_refused_or_moves_all_the_same(organ):
    """A rigid motion has no frequency to divide by: no fault in every tick, and no traceback."""
    with contextlib.suppress(UserError):
        simulation = Simulation(organ, local_region="modal")
        for _ in range(20):
            simulation.apply_force(int(np.argmax(organ.surface_positions[:, 2])), [0.0, 0.0, -0.01])
            simulation.step()
        assert simulation.state.count.faults == 0
        assert np.abs(simulation.positions - organ.rest_positions).max() > 1e-6
