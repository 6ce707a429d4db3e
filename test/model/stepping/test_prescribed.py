"""Prescribed displacements: a patch test with its closed form, the way there, reactions, and contact."""

import numpy as np
import pytest

from helpers.scenes import ball, ball_of_cells, filled
from helpers.states import snapshot
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.cell_mesh import with_cells

STRETCH = np.array([[1.1, 0.05, 0.0], [0.0, 0.95, -0.08], [0.02, 0.0, 1.0]])


def test_surface_led_by_one_matrix_strains_all_of_it_alike():
    """The patch test; and the reactions' moments are the first Piola-Kirchhoff stress times the volume."""
    organ = with_cells(filled(ball(1), 8))  # without gaps between its cells
    simulation = Simulation(organ)
    surface = np.arange(organ.n_surface)
    wanted = organ.rest_positions @ STRETCH.T
    simulation.prescribe(surface, wanted[surface])
    _, good = simulation.settle(np.zeros((organ.n_surface, 3)), tolerance=1e-9, ramp=0.3)
    assert good
    reach = np.abs(wanted - organ.rest_positions).max()
    assert np.abs(simulation.positions - wanted).max() < 1e-6 * reach
    mu, lam = organ.cell_mu, organ.cell_lambda
    assert np.ptp(mu) <= 1e-9 * mu[0], "not of one tissue"
    swollen, back = np.linalg.det(STRETCH), np.linalg.inv(STRETCH).T
    stress = mu[0] * (STRETCH - back) + 0.5 * lam[0] * (swollen**2 - 1.0) * back
    moments = simulation.reactions().T @ organ.rest_positions
    volume = simulation.model.cell_volume.sum()
    np.testing.assert_allclose(moments, volume * stress, atol=1e-5 * np.abs(volume * stress).max())


@pytest.mark.parametrize("integrator", ["symplectic", "explicit"])
@pytest.mark.parametrize("held", [False, True])
def test_nodes_are_led_evenly_and_held(integrator, held):
    organ = ball()
    simulation = Simulation(organ, integrator=integrator)
    node = int(organ.fixed[0]) if held else int(np.argmax(organ.surface_positions[:, 2]))
    start, goal = organ.rest_positions[node], organ.rest_positions[node] + [0.0, 0.001, 0.002]
    simulation.prescribe([node], [goal], ticks=10)
    for tick in range(1, 15):
        simulation.step()
        share = min(1.0, tick / 10)
        np.testing.assert_allclose(simulation.positions[node], start + share * (goal - start), atol=1e-12)
    np.testing.assert_array_equal(simulation.velocities[node], 0.0)
    assert not simulation.asleep
    simulation.free()
    for _ in range(3000):
        simulation.step()
    if held:
        np.testing.assert_allclose(simulation.positions[node], goal, atol=1e-12)
        simulation.reset()
    # The paper's forward Euler takes longer to be quiet.
    assert simulation.asleep or integrator == "explicit"
    np.testing.assert_allclose(
        simulation.positions, organ.rest_positions, atol=1e-6 if integrator == "explicit" else 0.0
    )


def test_settle_keeps_what_is_prescribed_and_finds_the_force_of_the_same_dent():
    """A node pushed by a force, and led to where that brought it, is held by that force."""
    organ = ball_of_cells()
    simulation = Simulation(organ)
    node, force = int(np.argmax(organ.surface_positions[:, 2])), np.zeros((organ.n_surface, 3))
    force[node] = [0.01, 0.0, -0.05]
    pushed, good = simulation.settle(force, tolerance=1e-7, ramp=0.3)
    assert good
    simulation.reset()
    simulation.prescribe([node], [organ.rest_positions[node] + pushed[node]])
    led, good = simulation.settle(np.zeros_like(force), tolerance=1e-7, ramp=0.3)
    assert good
    assert np.abs(led - pushed).max() < 1e-4 * np.abs(pushed).max()
    np.testing.assert_allclose(simulation.reactions()[node], force[node], atol=1e-3 * 0.05)


def test_tool_finds_a_led_surface_as_hard_as_what_leads_it():
    organ = ball_of_cells()
    scene = Scene(organ, [Tool("probe", radius=0.008)])
    surface = np.arange(organ.n_surface)
    scene.simulation.prescribe(surface, organ.surface_positions)
    top = organ.surface_positions[np.argmax(organ.surface_positions[:, 2])]
    for tick in range(60):
        scene.move(0, top + [0.0, 0.0, 0.009 - 5e-5 * tick])
        scene.step()
        np.testing.assert_array_equal(scene.simulation.positions[surface], organ.surface_positions)


def test_a_region_hands_over_when_nodes_are_led():
    organ = ball(3)
    simulation = Simulation(organ, local_region="modal")
    node = int(np.argmax(organ.surface_positions[:, 2]))
    simulation.apply_force([node], [[0.0, 0.0, -0.02]])
    simulation.step()
    few = simulation.state.status.active
    simulation.prescribe([node], [organ.surface_positions[node]])
    for _ in range(2):
        simulation.step()
    assert few < simulation.state.status.active == len(simulation.model.moving)


def test_node_outside_a_region_sets_out_from_where_it_is():
    organ = ball(3)
    simulation, twin = (Simulation(organ, local_region="modal") for _ in range(2))
    top, far = int(np.argmax(organ.surface_positions[:, 2])), int(np.argmax(organ.surface_positions[:, 0]))
    for one in (simulation, twin):
        for _ in range(30):
            one.apply_force([top], [[0.0, 0.0, -0.05]])
            one.step()
    start = twin.positions[far].copy()
    assert np.abs(start - organ.surface_positions[far]).max() > 1e-6
    goal = start + [0.001, 0.0, 0.0]
    simulation.prescribe([far], [goal], ticks=2)
    simulation.step()
    np.testing.assert_allclose(simulation.positions[far], 0.5 * (start + goal), atol=1e-12)


def test_restored_state_has_its_own_prescribed_nodes():
    """Prescribed as often, but other nodes: what contact may push is worked out anew."""
    organ = ball(2)
    simulation, other = Simulation(organ), Simulation(organ)
    first, second = (int(node) for node in simulation.model.moving[:2])
    for one, node in ((simulation, first), (other, second)):
        one.prescribe([node], [organ.rest_positions[node]])
        one.step()
    simulation.restore(snapshot(other))
    simulation.step()
    assert simulation.scratch.mobility[first] > 0.0 == simulation.scratch.mobility[second]


def test_bad_nodes_and_positions_are_named():
    simulation = Simulation(ball())
    for nodes, positions, ticks, name in (
        ([10_000], [[0.0, 0.0, 0.0]], 1, "nodes"),
        ([0], [[0.0, np.nan, 0.0]], 1, "positions"),
        ([0], [[0.0, 0.0]], 1, "positions"),
        ([0], [[0.0, 0.0, 0.0]], 0, "ticks"),
    ):
        with pytest.raises(UserError, match=name):
            simulation.prescribe(nodes, positions, ticks)
