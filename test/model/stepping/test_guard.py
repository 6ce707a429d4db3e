"""The guard alone and in whole ticks: what it finds, what it calls it, what it gives back."""

import numpy as np
import pytest

from helpers.kernels import by_reference
from helpers.pressing import poke, top_node
from helpers.scenes import ball, kidney
from tissue_sim.model.data.shapes import sphere_tools
from tissue_sim.model.data.state import FAULT_NAMES
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.guard import (
    CELLS_A_TICK,
    KEEP_EVERY,
    MAX_BACKOFF,
    MAX_INVERTED,
    RETURN_RATE,
    RUNAWAY_RATE,
    check,
    check_cells,
    is_bounded,
    move_towards_rest,
)
from tissue_sim.model.stepping.tick import substep_factor

TOUCH = (0.0, 0.0, -0.05)  # N


def fault_of(simulation):
    return FAULT_NAMES[simulation.state.status.fault_kind]


# what is wrong with a state --------------------------------------------------------------------
def checked(simulation, nodes):
    world = by_reference(simulation)
    return check(world.model, world.state, nodes, 0.1**2, 100.0**2, 10.0**2)


def found(spoil):
    """What `check` says of a ball at 1 mm and 1 m/s that `spoil` has changed; the bounds are 0.1, 100 and 10."""
    simulation = Simulation(ball())
    model, state = simulation.model, simulation.state
    nodes = model.moving
    away, speed = np.zeros_like(model.rest), np.zeros_like(model.rest)
    away[nodes], speed[nodes] = [0.0, 0.001, 0.0], [1.0, 0.0, 0.0]
    spoil(away, speed, nodes[3])
    state.position[:], state.velocity[:] = model.rest + away, speed
    return FAULT_NAMES[checked(simulation, nodes)]


def put(which, value):
    def spoil(away, speed, node):
        (away if which == "position" else speed)[node, 2] = value

    return spoil


def all_at(speeds):
    def spoil(away, speed, node):
        speed[:, 1] = speeds

    return spoil


@pytest.mark.parametrize(
    ("spoil", "name"),
    [
        (lambda away, speed, node: None, "none"),
        (put("position", np.nan), "not finite"),
        (put("velocity", np.nan), "not finite"),
        (put("position", -np.inf), "not finite"),
        (put("velocity", np.inf), "not finite"),
        (put("velocity", 1e200), "not finite"),
        (put("position", 0.098), "none"),
        (put("position", 0.102), "runaway"),
        (put("velocity", 60.0), "none"),
        (put("velocity", 101.0), "runaway"),
        (all_at(9.8), "none"),
        (all_at(10.1), "runaway"),
    ],
)
def test_check_names_what_is_wrong(spoil, name):
    assert found(spoil) == name


def test_nodes_that_are_held_or_not_asked_for_are_not_looked_at():
    simulation = Simulation(ball())
    simulation.state.position[ball().fixed] = np.nan
    model = simulation.model
    assert checked(simulation, model.moving) == 0
    simulation.state.position[model.moving[5:]] = np.nan
    assert checked(simulation, model.moving[:5]) == 0


@pytest.mark.parametrize("size", [1, 15, 16, 17, 126])
def test_coordinate_over_its_bound_is_seen_wherever_it_is(size):
    """One value at a time is put over its bound, or made no number; the same just under it passes."""
    rest = np.random.default_rng(0).standard_normal(size)
    for index in (0, size // 2, size - 1):
        for value, passes in ((0.0999, True), (0.1001, False), (np.nan, False), (np.inf, False)):
            for offsets, speeds in ((value, 0.0), (0.0, 100.0 * value)):
                away, speed = np.zeros(size), np.zeros(size)
                away[index], speed[index] = offsets, speeds
                assert is_bounded(rest + away, speed, rest, 0.1, 10.0) == passes


# whole ticks -----------------------------------------------------------------------------------
@pytest.mark.parametrize("integrator", ["symplectic", "explicit"])
@pytest.mark.parametrize("bad", ["nan velocity", "inf velocity", "nan position", "runaway force", "fast organ"])
def test_fault_is_counted_and_named_and_the_last_good_state_is_back(bad, integrator):
    simulation = Simulation(ball(), integrator=integrator)
    poke(simulation, 20, TOUCH)
    good = simulation.positions.copy()
    assert np.abs(good - simulation.model.rest).max() > 1e-5
    assert fault_of(simulation) == "none"
    node = top_node(ball())
    if bad == "nan velocity":
        simulation.velocities[node, 1] = np.nan
    elif bad == "inf velocity":
        simulation.velocities[node, 1] = np.inf
    elif bad == "nan position":
        simulation.positions[node, 0] = np.nan
    elif bad == "runaway force":
        simulation.apply_force(node, [0.0, 1e7, 0.0])
    else:
        # None alone is too fast, all together are.
        simulation.velocities[simulation.model.moving] = 4.0 * RUNAWAY_RATE * simulation.settings.runaway_span
    simulation.step()
    assert simulation.state.count.faults == 1
    assert fault_of(simulation) == ("runaway" if "runaway" in bad or "fast" in bad else "not finite")
    np.testing.assert_array_equal(simulation.positions, good)
    np.testing.assert_array_equal(simulation.velocities, 0.0)
    for _ in range(1500):
        simulation.step()
    assert simulation.asleep
    assert simulation.state.count.faults == 1


def test_shape_that_comes_back_is_one_of_the_last_few():
    simulation = Simulation(ball(2))
    poke(simulation, 20, TOUCH)
    for _ in range(2 * KEEP_EVERY):
        last = []
        for _ in range(KEEP_EVERY + 1):
            poke(simulation, 1, TOUCH)
            last.append(simulation.positions.copy())
        simulation.velocities[simulation.model.moving[0]] = np.nan
        poke(simulation, 1, TOUCH)
        assert any(np.array_equal(simulation.positions, shape) for shape in last)


def test_good_shape_that_leads_to_nothing_but_faults_is_led_back():
    simulation = Simulation(ball(2))
    poke(simulation, 20, TOUCH)
    away = []
    for _ in range(12):
        away.append(simulation.positions - simulation.model.rest)
        poke(simulation, 1, [0.0, 1e8, 0.0])
    assert simulation.state.count.faults == 12
    left = np.linalg.norm(away, axis=(1, 2)) / np.linalg.norm(away[1])
    back = np.exp(-RETURN_RATE * 1e-3)
    np.testing.assert_allclose(left[1:], [1.0] * 3 + [back] * 4 + [back**2] * 4, rtol=1e-9)


def test_substeps_double_with_each_fault_and_start_again_after_eight():
    simulation = Simulation(ball())
    normal, factors = int(simulation.settings.substeps), []
    for _ in range(9):
        poke(simulation, 1, [0.0, 1e8, 0.0])
        factors.append(int(simulation.state.status.substeps) // normal)
    assert factors == [1, 2, 4, MAX_BACKOFF, 1, 2, 4, MAX_BACKOFF, 1]
    assert simulation.state.count.faults == 9
    poke(simulation, 1, TOUCH)
    assert simulation.state.status.substeps == 2 * normal, "more substeps until the organ has slept"
    for _ in range(1500):
        simulation.step()
    assert simulation.asleep
    poke(simulation, 1, TOUCH)
    assert simulation.state.status.substeps == normal


# inside and outside ----------------------------------------------------------------------------
def volumes(model, x):
    a, b, c, d = (x[model.cells[:, k]] for k in range(4))
    return np.einsum("ck,ck->c", a - d, np.cross(b - d, c - d)) / 6.0


@pytest.mark.parametrize("organ", [ball(), ball(3), kidney()], ids=["ball", "fine ball", "kidney"])
def test_cells_fill_the_inside_the_right_way_round(organ):
    """A triangle and its nearest atom; on a ball they are nearly all of its volume."""
    model = Simulation(organ).model
    found = volumes(model, model.rest)
    np.testing.assert_allclose(model.cell_volume, found, rtol=1e-12)
    assert found.min() > 0.0
    assert len(found) > 0.9 * len(organ.surface_triangles)


@pytest.mark.parametrize("organ", [ball(), kidney()], ids=["ball", "kidney"])
def test_turned_cells_are_counted_within_one_pass_and_forgotten_within_the_next(organ):
    simulation = Simulation(organ)
    model, state = simulation.model, simulation.state
    node = top_node(organ)
    atom = model.cells[np.flatnonzero((model.cells == node).any(axis=1))[0], 3]
    # Through the atom of one of its triangles and out at the other side.
    state.position[node] += 1.4 * (state.position[atom] - state.position[node])
    expected = volumes(model, state.position) < 0.0
    assert 1 <= expected.sum() < 0.2 * len(expected)
    state.status.next_cell = len(expected) // 2
    world = by_reference(simulation)
    once_round = -(-len(expected) // CELLS_A_TICK)
    for _ in range(once_round):
        check_cells(world.model, world.state, world.scratch)
    assert state.status.turned == expected.sum()
    np.testing.assert_array_equal(state.is_turned, expected)
    state.position[:] = model.rest
    for _ in range(once_round):
        check_cells(world.model, world.state, world.scratch)
    assert state.status.turned == 0
    assert not state.is_turned.any()


def inside_out(organ, share=1.0):
    """An organ awake, every moving node on the other side of the middle by a share of the way; a good state."""
    simulation = Simulation(organ)
    state, nodes = simulation.state, simulation.model.moving
    middle = simulation.model.rest[nodes].mean(axis=0)
    state.position[nodes] += share * 2.0 * (middle - state.position[nodes])
    state.good_position[:] = state.position
    state.status.asleep = False
    return simulation


@pytest.mark.parametrize("organ", [ball(2), kidney()], ids=["ball", "kidney"])
def test_collapsed_organ_is_counted_once_and_led_back_to_rest_within_a_second(organ):
    simulation = inside_out(organ)
    state = simulation.state
    turned = volumes(simulation.model, simulation.positions) < 0.0
    assert turned.mean() > MAX_INVERTED
    kinds = []
    for _ in range(1000):
        simulation.step()
        kinds.append(fault_of(simulation))
        assert np.all(np.isfinite(simulation.positions))
        if simulation.asleep:
            break
    assert "collapsed" in kinds
    assert simulation.asleep
    np.testing.assert_array_equal(simulation.positions, simulation.model.rest)
    np.testing.assert_array_equal(simulation.velocities, 0.0)
    assert state.status.turned == 0
    assert not state.is_turned.any()
    assert not state.status.collapsing


def test_collapse_is_one_fault_however_long_it_lasts():
    simulation = inside_out(ball(2))
    state = simulation.state
    state.is_turned[:] = 1
    state.status.turned = len(state.is_turned)
    seen = []
    for _ in range(30):
        before = state.count.faults
        simulation.step()
        seen.append((int(state.status.collapsing), int(state.count.faults - before), fault_of(simulation)))
    collapsing = [entry for entry in seen if entry[0]]
    assert len(collapsing) > 3
    assert sum(entry[1] for entry in seen if entry[2] == "collapsed") == 1


def test_way_back_goes_by_the_same_share_each_tick_and_without_speed():
    simulation = Simulation(ball())
    model, state = simulation.model, simulation.state
    away = np.zeros_like(model.rest)
    away[model.moving] = np.random.default_rng(0).uniform(-0.01, 0.01, (len(model.moving), 3))
    state.position[:], state.velocity[:] = model.rest + away, 1.0
    world = by_reference(simulation)
    left = move_towards_rest(world.model, world.state, world.settings)
    np.testing.assert_allclose(state.position - model.rest, np.exp(-0.02) * away, atol=1e-16)
    assert left == pytest.approx(np.exp(-0.02) * np.abs(away).max())
    assert np.abs(state.velocity[model.moving]).max() == 0.0


def test_substeps_multiply_while_cells_are_turned():
    simulation = Simulation(ball())
    model, state = simulation.model, simulation.state
    cells, world = len(model.cells), by_reference(simulation)
    for turned, factor in ((0, 1), (1, 2), (cells, 4)):
        state.status.turned = turned
        assert substep_factor(world.model, world.state, False) == factor


def test_bodies_that_contact_pushed_out_of_all_bounds_are_put_back_where_they_are_held():
    simulation = Simulation(ball(), shapes=sphere_tools([0.005, 0.005, 0.005]))
    state = simulation.state
    state.held_pose[:, :3] = [0.0, 0.0, 0.1]
    state.body_pose[:, :3] = [[0.0, np.nan, 0.1], [0.0, 1e200, 0.1], [0.001, 0.0, 0.1]]
    state.velocity[simulation.model.moving] = np.nan
    state.status.asleep = False
    simulation.settings.coupling_stiffness, simulation.settings.coupling_damping = 200.0, 1.0
    simulation.step()
    assert fault_of(simulation) == "not finite"
    np.testing.assert_array_equal(state.body_pose[:2, :3], state.held_pose[:2, :3])
    assert 0.0 < state.body_pose[2, 0] < 0.001  # led on, as ever
