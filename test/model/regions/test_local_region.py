"""The paper's local region: what moves, what stays, and when it is skipped."""

import numpy as np
import pytest

from helpers.naive import hops_from
from helpers.scenes import ball, kidney, near
from tissue_sim.model.data.shapes import sphere_tools
from tissue_sim.model.data.state import Region
from tissue_sim.model.simulation import Simulation


def moved(simulation):
    """Nodes that moved, by more than rounding; the others must not have moved at all."""
    offset = np.abs(simulation.positions - simulation.model.rest).max(axis=1)
    assert np.all((offset == 0.0) | (offset > 1e-15)), "neither at rest nor moved"
    return np.flatnonzero(offset)


UP, SIDE, SLANT = (0.0, 0.0, 1.0), (1.0, 0.0, 0.3), (0.9, 0.2, 0.4)
TOP = near(ball(3), UP)[0]


def region_of(organ, sources):
    return np.setdiff1d(np.flatnonzero(hops_from(organ, sources) <= 2), organ.fixed)


@pytest.mark.parametrize("organ", [ball(3), kidney()], ids=["ball", "kidney"])
@pytest.mark.parametrize("directions", [[UP], [UP, SIDE, SLANT]], ids=["one node", "three nodes"])
def test_only_nodes_within_two_hops_move(organ, directions):
    loaded = near(organ, *directions)
    simulation = Simulation(organ, local_region="frozen")
    for _ in range(40):
        simulation.apply_force(loaded, np.tile([0.01, 0.0, -0.01], (len(loaded), 1)))
        simulation.step()
    expected = region_of(organ, loaded)
    np.testing.assert_array_equal(moved(simulation), expected)
    assert simulation.state.status.active == len(expected) < 120
    assert simulation.state.count.frozen_ticks == 40


def test_region_reaches_no_held_node():
    organ = ball(3)
    edge_of_cap = int(np.argmin(hops_from(organ, organ.fixed) != 1.0))
    simulation = Simulation(organ, local_region="frozen")
    for _ in range(40):
        simulation.apply_force(edge_of_cap, [0.0, 0.0, 0.02])
        simulation.step()
    assert hops_from(organ, [edge_of_cap])[organ.fixed].min() == 1.0
    np.testing.assert_array_equal(moved(simulation), region_of(organ, [edge_of_cap]))


def test_region_grows_with_the_load_that_wanders():
    organ = ball(3)
    simulation = Simulation(organ, local_region="frozen")
    seen = []
    for node in near(organ, UP, SIDE):
        seen.append(node)
        for _ in range(10):
            simulation.apply_force(node, [0.0, 0.0, -0.01])
            simulation.step()
        np.testing.assert_array_equal(moved(simulation), region_of(organ, seen))
        assert simulation.state.status.active == len(region_of(organ, seen))


def test_region_solves_its_nodes_as_the_whole_model_does_with_the_rest_held():
    organ = ball(3)
    local = Simulation(organ, local_region="frozen")
    whole = Simulation(organ)
    held = np.setdiff1d(np.arange(organ.n_nodes), region_of(organ, [TOP])).astype(np.int32)
    inverse_mass = whole.model.inverse_mass.copy()
    inverse_mass[held] = 0.0
    whole.model = whole.model._replace(
        inverse_mass=inverse_mass, moving=np.setdiff1d(whole.model.moving, held).astype(np.int32)
    )
    whole.refer()
    for simulation in (local, whole):
        for _ in range(60):
            simulation.apply_force(TOP, [0.02, 0.01, -0.03])
            simulation.step()
    assert np.abs(whole.positions - whole.model.rest).max() > 1e-5
    np.testing.assert_allclose(local.positions, whole.positions, rtol=0.0, atol=1e-13)


def push_tip(simulation, size):
    """An external force at the tip over node TOP, along -z, N."""
    contacts = simulation.state.contacts
    contacts.tip_node[0], contacts.tip_weight[0] = TOP, [1.0, 0.0, 0.0, 0.0]
    simulation.take_force(0, np.array([0.0, 0.0, -size]), 1)


def test_region_is_skipped_when_a_tool_pushes_harder_than_the_region_force():
    simulation = Simulation(ball(3), local_region="frozen", shapes=sphere_tools(0.005))
    limit = simulation.settings.region_force
    for _ in range(20):
        push_tip(simulation, 0.9 * limit)
        simulation.step()
    assert simulation.state.status.region == Region.FROZEN
    np.testing.assert_array_equal(moved(simulation), region_of(simulation.organ, [TOP]))
    for _ in range(60):
        push_tip(simulation, 1.1 * limit)
        simulation.step()
    assert simulation.state.status.region == Region.WHOLE
    assert simulation.state.status.active == len(simulation.model.moving)
    np.testing.assert_array_equal(moved(simulation), simulation.model.moving)


def test_region_is_skipped_under_nodal_forces_above_the_region_force():
    simulation = Simulation(ball(3), local_region="frozen")
    for _ in range(3):
        simulation.apply_force(TOP, [0.0, 0.0, -2.0 * simulation.settings.region_force])
        simulation.step()
    assert simulation.state.status.region == Region.WHOLE


def test_organ_sleeps_again_and_the_next_load_has_a_region_of_its_own():
    organ = ball(3)
    simulation = Simulation(organ, local_region="frozen")
    for node in near(organ, UP, SIDE):
        for _ in range(5):
            simulation.apply_force(node, [0.0, 0.0, -0.005])
            simulation.step()
        assert simulation.state.status.active == len(region_of(organ, [node]))
        for _ in range(2000):
            simulation.step()
            if simulation.asleep:
                break
        assert simulation.asleep


def test_without_local_region_everything_moves():
    simulation = Simulation(ball(3))
    for _ in range(60):
        simulation.apply_force(TOP, [0.0, 0.0, -0.01])
        simulation.step()
    np.testing.assert_array_equal(moved(simulation), simulation.model.moving)
    assert simulation.state.count.frozen_ticks == 0
