"""The prefactored implicit step: its matrix, its solve, its stability, and that it rests where the others do."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from helpers.pressing import line
from helpers.scenes import RADIUS, assembled, ball, ball_of_cells, changed, kidney
from helpers.states import assert_same, snapshot
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.data.records import copy_of, words_of
from tissue_sim.model.elasticity.diagonal import diagonal
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.implicit import bounding_stiffness, make_factor, write_factor
from tissue_sim.model.stepping.integrators import implicit_euler


def top_of(organ):
    return int(np.argmax(organ.surface_positions[:, 2]))


def poke(simulation, ticks, force):
    for _ in range(ticks):
        simulation.apply_force(top_of(simulation.organ), force)
        simulation.step()


def matrix_of(model, step, stiffness_scale=1.0, damping_scale=1.0):
    """M + h D + h^2 S of the moving nodes, kg."""
    moving = model.moving
    heavy = diagonal(1.0 / model.inverse_mass[moving] + step * damping_scale * model.damping[moving])
    stiff = bounding_stiffness(model)[moving][:, moving]
    return (heavy + step**2 * stiffness_scale * stiff).tocsc()


# the matrix ------------------------------------------------------------------------------------
@pytest.mark.parametrize("variant", ["surface", "volume", "hybrid", "cells"])
@pytest.mark.parametrize("stretched", [0.0, 0.3])
def test_bounding_stiffness_is_at_least_the_slope_of_the_forces(variant, stretched):
    """v'Kv <= v'Sv, at rest for all; stretched for axial springs, return springs and cells, which get no stiffer."""
    model = assembled(ball_of_cells() if variant == "cells" else ball(), variant)
    if stretched and variant != "cells":
        model = assembled(changed(ball(), angular_stiffness=0.0), variant)
    x = model.rest * (1.0 + stretched)
    bound, random = bounding_stiffness(model), np.random.default_rng(0)
    slopes = []
    for _ in range(40):
        v = random.standard_normal(x.shape)
        ahead, behind = np.zeros_like(x), np.zeros_like(x)
        elastic_forces(model, x + 1e-8 * v, ahead)
        elastic_forces(model, x - 1e-8 * v, behind)
        # Return springs of nodes that don't move are in neither.
        slope, most = np.vdot(v, behind - ahead) / 2e-8, sum(v[:, c] @ (bound @ v[:, c]) for c in range(3))
        slopes.append(slope / most)
    assert max(slopes) <= 1.0 + 1e-6
    assert min(slopes) > 0.05, "a bound without use"


def test_bounding_stiffness_is_tight_along_one_spring():
    model = assembled(ball(), "surface")
    bound = bounding_stiffness(model).toarray()
    expected = np.zeros_like(bound)
    for i, j, k in zip(model.spring_first, model.spring_second, model.spring_stiffness, strict=True):
        expected[i, i] += k
        expected[j, j] += k
        expected[i, j] -= k
        expected[j, i] -= k
    for nodes, weight, k in zip(model.angular_nodes, model.angular_weight, model.angular_stiffness, strict=True):
        expected[np.ix_(nodes, nodes)] += k * np.outer(weight, weight)
    expected[model.return_nodes, model.return_nodes] += model.return_stiffness[model.return_nodes]
    np.testing.assert_allclose(bound, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("organ", [ball(), ball(3), kidney()], ids=["ball", "fine ball", "kidney"])
@pytest.mark.parametrize("step", [1e-4, 1e-2])
def test_solve_is_that_of_the_assembled_matrix(organ, step):
    model, random = assembled(organ), np.random.default_rng(1)
    factor = make_factor(model, step, 2.0, 3.0)
    force, v = random.standard_normal((2, *model.rest.shape))
    x, started = model.rest.copy(), v.copy()
    implicit_euler(x, v, force, factor, 1, model.damping, 3.0, step, np.zeros((len(model.moving), 3)))
    push = step * (force - 3.0 * model.damping[:, None] * started)[model.moving]
    expected = spsolve(matrix_of(model, step, 2.0, 3.0), push)
    changes = (v - started)[model.moving]
    assert np.abs(changes - expected).max() <= 1e-10 * np.abs(expected).max()
    np.testing.assert_array_equal(v[organ.fixed], started[organ.fixed])
    np.testing.assert_allclose(x[model.moving], (model.rest + step * v)[model.moving], rtol=1e-14)


def test_mobility_is_the_diagonal_of_the_inverse():
    model = assembled(ball(2))
    factor = make_factor(model, 2e-3, 1.0, 1.0)
    inverse = np.linalg.inv(matrix_of(model, 2e-3).toarray())
    np.testing.assert_allclose(factor.mobility[0][model.moving], np.diag(inverse), rtol=1e-10)
    np.testing.assert_array_equal(factor.mobility[0][ball(2).fixed], 0.0)


def test_other_slot_is_written_and_the_one_in_use_stays():
    model = assembled(ball())
    model = model._replace(factor=make_factor(model, 1e-3, 1.0, 1.0))
    value, pivot = model.factor.value[0].copy(), model.factor.pivot[0].copy()
    write_factor(model, 1, 1e-3, 9.0, 1.0)
    np.testing.assert_array_equal(model.factor.value[0], value)
    np.testing.assert_array_equal(model.factor.pivot[0], pivot)
    np.testing.assert_array_equal(model.factor.pivot[1], make_factor(model, 1e-3, 9.0, 1.0).pivot[0])
    assert np.abs(model.factor.pivot[1] / pivot - 1.0).max() > 0.1


each_organ = pytest.mark.parametrize(
    "organ",
    [
        ball(2),
        pytest.param(ball_of_cells(), marks=pytest.mark.extended),
        pytest.param(kidney(), marks=pytest.mark.slow),
    ],
    ids=["ball", "cells", "kidney"],
)


def test_each_slot_knows_what_it_was_made_for():
    """Going back to a slot whose factor is another one makes that anew."""
    simulation = Simulation(ball(1), integrator="implicit")
    first = copy_of(simulation.settings)
    before = solved(simulation)
    for scale in (4.0, 9.0):
        simulation.settings.stiffness_scale = scale
        simulation.set_substeps()
    assert simulation.settings.factor_slot == first.factor_slot
    words_of(simulation.settings)[:] = words_of(first)
    simulation.set_substeps()
    np.testing.assert_array_equal(solved(simulation), before)


def solved(simulation):
    """What a force does in one step."""
    simulation.reset()
    simulation.apply_force([0], [[0.0, 0.0, 0.01]])
    simulation.step()
    return simulation.positions.copy()


# whole ticks -----------------------------------------------------------------------------------
@each_organ
@pytest.mark.parametrize("rate", [1000.0, 100.0, 10.0])
@pytest.mark.parametrize("stiffness", [1.0, 1e4])
def test_any_step_and_stiffness_stay_bounded_and_gain_no_energy(organ, rate, stiffness):
    simulation = Simulation(organ, rate=rate, integrator="implicit", substeps=1)
    simulation.settings.stiffness_scale = stiffness
    simulation.set_substeps()
    poke(simulation, 30, np.array([0.05, 0.0, -0.25]) * stiffness)
    before = simulation.energy.total
    assert before > 1e-7 * stiffness
    energies = []
    for _ in range(60):
        simulation.step()
        energies.append(simulation.energy.total)
        assert np.abs(simulation.positions - simulation.model.rest).max() < RADIUS
    assert max(energies) <= before * (1.0 + 1e-9)
    assert energies[-1] < 0.9 * before
    assert simulation.state.count.faults == 0
    assert simulation.state.status.substeps == 1
    assert simulation.critical_step == np.inf


@each_organ
def test_settled_shape_is_that_of_the_symplectic_integrator(organ):
    forces = np.zeros((organ.n_surface, 3))
    forces[top_of(organ)] = [0.02, 0.0, -0.1]
    shapes = []
    for integrator in ("symplectic", "implicit"):
        found, settled = Simulation(organ, integrator=integrator).settle(forces, tolerance=1e-5)
        assert settled
        shapes.append(found)
    assert np.abs(shapes[0]).max() > 5e-4
    assert np.linalg.norm(shapes[1] - shapes[0]) <= 1e-4 * np.linalg.norm(shapes[0])


@pytest.mark.extended
def test_cells_stiffer_than_the_matrix_knows_take_short_steps():
    """A load that squeezes cells under a third: the tick is not one long step, and gains nothing when it is gone."""
    simulation = Simulation(ball_of_cells(), integrator="implicit")
    taken = set()
    for _ in range(60):
        poke(simulation, 1, [0.0, 0.0, -20.0])
        taken.add(int(simulation.state.status.substeps))
    squeezed = simulation.model.tissue.stiff[0]
    before, energies = simulation.energy.total, []
    for _ in range(3000):
        simulation.step()
        energies.append(simulation.energy.total)
    assert squeezed > 0
    assert min(taken) == 1 < max(taken)
    assert max(energies) <= before * 1.01
    assert simulation.asleep


def test_rest_is_exact_and_reached_from_a_poke():
    simulation = Simulation(ball(2), integrator="implicit")
    simulation.state.status.asleep = False
    for _ in range(10):
        simulation.step()
    np.testing.assert_allclose(simulation.positions, simulation.model.rest, rtol=0.0, atol=1e-15)
    poke(simulation, 50, [0.0, 0.0, -0.3])
    for _ in range(2000):
        simulation.step()
    assert simulation.asleep
    np.testing.assert_array_equal(simulation.positions, simulation.model.rest)


def test_short_steps_follow_the_symplectic_path():
    """Both of first order: with a tenth of the step they are a tenth as far apart."""
    apart = []
    for substeps in (20, 200):
        paths = []
        for integrator in ("symplectic", "implicit"):
            simulation = Simulation(ball(), integrator=integrator, substeps=substeps)
            poke(simulation, 20, [0.0, 0.0, -0.1])
            paths.append(simulation.positions - simulation.model.rest)
        apart.append(np.abs(paths[1] - paths[0]).max() / np.abs(paths[0]).max())
    assert apart[1] < 0.01
    assert apart[0] / apart[1] == pytest.approx(10.0, rel=0.25)


def test_stiffness_changed_on_the_way_uses_the_other_slot():
    """The run goes on as one whose factor was made for the new stiffness from the start."""
    simulation, twin = (Simulation(ball(2), integrator="implicit") for _ in range(2))
    for one in (simulation, twin):
        poke(one, 20, [0.0, 0.0, -0.1])
    slot = simulation.settings.factor_slot
    in_use = simulation.model.factor.pivot[int(slot)].copy()
    simulation.settings.stiffness_scale = 5.0
    simulation.set_substeps()
    assert simulation.settings.factor_slot == 1 - slot
    np.testing.assert_array_equal(simulation.model.factor.pivot[int(slot)], in_use)
    fresh = Simulation(ball(2), integrator="implicit")
    fresh.settings.stiffness_scale = 5.0
    fresh.set_substeps()
    fresh.restore(snapshot(simulation))
    for one in (simulation, fresh, twin):
        poke(one, 20, [0.0, 0.0, -0.1])
    assert_same(simulation, fresh)
    assert np.abs(simulation.positions - twin.positions).max() > 1e-5


# contact ---------------------------------------------------------------------------------------
def held_force(integrator, region="off", depth=0.003):
    """Force (3,) N of a probe of 8 mm that is led into a ball and held."""
    scene = Scene(ball(3), [Tool("probe", radius=0.008)], local_region=region, integrator=integrator)
    top = ball(3).surface_positions[top_of(ball(3))] + [0.0, 0.0, 0.008]
    forces = []
    path = line(top + [0.0, 0.0, 0.001], top - [0.0, 0.0, depth], 60)
    for tick in range(360):
        scene.move(0, path[min(tick, 59)])
        scene.step()
        forces.append(scene.wrenches[0, :3].copy())
    assert scene.simulation.state.count.faults == 0
    assert np.ptp(forces[-50:], axis=0).max() < 2e-3, "no hold"
    return np.array(forces)[-1]


@pytest.mark.parametrize(
    "region", ["off", *(pytest.param(one, marks=pytest.mark.extended) for one in ("modal", "frozen"))]
)
def test_held_poke_has_the_force_of_the_symplectic_integrator(region):
    expected, found = (held_force(integrator, region) for integrator in ("symplectic", "implicit"))
    assert expected[2] > 0.03
    assert np.linalg.norm(found - expected) <= 0.02 * np.linalg.norm(expected)


def test_contact_knows_the_stiffness_that_was_set_last():
    """Set twice between two ticks, both slots of the factor are new, and the one in use has the number it had."""
    scene = Scene(ball(), [Tool("probe", radius=0.008)])
    simulation = Simulation(ball(), shapes=scene.tools.shapes, integrator="implicit")
    poke(simulation, 2, [0.0, 0.0, -0.05])
    for scale in (0.25, 4.0):
        simulation.settings.stiffness_scale = scale
        simulation.set_substeps()
    poke(simulation, 2, [0.0, 0.0, -0.05])
    slot = int(simulation.settings.factor_slot)
    np.testing.assert_array_equal(simulation.scratch.mobility, simulation.model.factor.mobility[slot])


@pytest.mark.parametrize("eased", [True, False])
def test_first_step_after_shorter_ones_takes_the_momentum_of_what_moves(eased):
    """S adds mass to an implicit step: speed that it finds must not become energy."""
    organ = ball(2)
    simulation = Simulation(organ, integrator="implicit")
    model, state, step = simulation.model, simulation.state, 1.0 / simulation.rate
    moving = model.moving
    state.status.asleep = False
    state.status.substeps = 4 if eased else 1
    velocity = np.zeros_like(model.rest)
    velocity[moving] = 0.05 * np.random.default_rng(0).standard_normal((len(moving), 3))
    state.velocity[:] = velocity
    before = simulation.energy.total
    at, force = model.rest if eased else model.rest + step * velocity, np.zeros_like(model.rest)
    elastic_forces(model, at, force)
    simulation.step()
    matrix, mass = matrix_of(model, step), 1.0 / model.inverse_mass[moving, None]
    if eased:
        expected = spsolve(matrix, mass * velocity[moving] + step * force[moving])
    else:
        drag = model.damping[moving, None] * velocity[moving]
        expected = velocity[moving] + spsolve(matrix, step * (force[moving] - drag))
    np.testing.assert_allclose(state.velocity[moving], expected, atol=1e-10)
    stiffness = bounding_stiffness(model)
    added = 0.5 * step**2 * np.sum(state.velocity * (stiffness @ state.velocity))
    if eased:
        assert simulation.energy.kinetic + added <= before
    else:
        assert simulation.energy.kinetic + added > before
