"""Poses, forces and contact sets as they are taken up."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from helpers.scenes import ball, free_ball
from tissue_sim.model.contact_set import contact_set
from tissue_sim.model.inputs import LONGEST_PERIOD
from tissue_sim.model.simulation import Simulation, sphere_tools

FAR = np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0])


def engaged_at(pose):
    """A simulation whose only tool is engaged and stands at a pose."""
    simulation = Simulation(ball(), shapes=sphere_tools(0.005))
    simulation.take_pose(0, pose, 1)
    take_set(simulation, 2)
    return simulation


def take_set(simulation, sequence, tip_node=(-1, -1, -1), tip_weight=(0.0, 0.0, 0.0), engaged=1):
    """A contact set without entries."""
    found = contact_set(1, 0)
    found.tip_node[0], found.tip_weight[0], found.engaged[0] = tip_node, tip_weight, engaged
    simulation.take_contacts(found, sequence)


def test_first_pose_is_taken_at_once():
    simulation = Simulation(ball(), shapes=sphere_tools(0.005))
    simulation.take_pose(0, FAR, 7)
    simulation.step()
    np.testing.assert_array_equal(simulation.state.body_pose[0], FAR)
    assert simulation.state.bodies[0].pose_sequence == 7
    assert simulation.state.bodies[0].age == 1


@pytest.mark.parametrize("period", [1, 4, 16])
def test_tool_is_led_evenly_to_a_pose_that_took_several_ticks(period):
    simulation = engaged_at(FAR)
    for _ in range(period):
        simulation.step()
    turn = Rotation.from_rotvec([0.0, 0.02, 0.01])
    # The same turn with the other sign of the quaternion: no long way round.
    goal = np.array([0.01, -0.02, 0.18, *-turn.as_quat()])
    simulation.take_pose(0, goal, 2)
    path = [simulation.state.body_pose[0].copy()]
    for _ in range(period):
        simulation.step()
        path.append(simulation.state.body_pose[0].copy())
    share = np.linspace(0.0, 1.0, period + 1)
    np.testing.assert_allclose([p[:3] for p in path], FAR[:3] + share[:, None] * (goal - FAR)[:3], atol=1e-15)
    even = Slerp([0.0, 1.0], Rotation.concatenate([Rotation.identity(), turn]))(share)
    assert max((even.inv() * Rotation.from_quat([p[3:] for p in path])).magnitude()) < 1e-6
    np.testing.assert_allclose([np.linalg.norm(p[3:]) for p in path], 1.0, atol=1e-12)
    simulation.step()
    np.testing.assert_array_equal(simulation.state.body_pose[0], goal)


def test_slow_input_leads_the_tool_no_longer_than_the_limit():
    simulation = engaged_at(FAR)
    for _ in range(LONGEST_PERIOD + 15):
        simulation.step()
    simulation.take_pose(0, FAR + 0.001, 2)
    assert simulation.state.bodies[0].remaining == LONGEST_PERIOD


def test_stale_tool_lets_go_and_does_not_engage_without_a_new_pose():
    simulation = engaged_at(FAR)
    assert simulation.state.bodies[0].engaged
    for _ in range(71):
        simulation.step()
    assert not simulation.state.bodies[0].engaged
    unknown = Simulation(ball(), shapes=sphere_tools(0.005))
    take_set(unknown, 1)
    assert not unknown.state.bodies[0].engaged


def test_body_that_was_let_go_engages_once_a_set_has_let_go_of_it_too():
    simulation = engaged_at(FAR)
    for _ in range(71):
        simulation.step()
    body = simulation.state.bodies[0]
    simulation.take_pose(0, FAR, 2)
    take_set(simulation, 2)  # by a thread that saw nothing of it
    assert body.lapsed
    assert not body.engaged
    take_set(simulation, 3, engaged=0)
    assert not body.lapsed
    assert not body.engaged
    take_set(simulation, 4)
    assert body.engaged


def test_force_at_a_tip_acts_on_its_triangle_until_it_is_stale():
    organ = free_ball()
    simulation = Simulation(organ, shapes=sphere_tools(0.005))
    simulation.settings.stale_time, simulation.settings.ramp_time = 0.010, 0.005
    triangle, weight = organ.surface_triangles[3].astype(np.int64), np.array([0.2, 0.3, 0.5])
    take_set(simulation, 1, triangle, weight, engaged=0)
    simulation.take_force(0, np.array([0.0, 0.0, 0.3]), 5)
    momentum = [np.zeros(3)]
    for _ in range(20):
        simulation.step()
        momentum.append(organ.mass @ simulation.velocities)
    pull = np.diff(momentum, axis=0) / 1e-3
    # Ten fresh ticks, then down to nothing in five.
    expected = 0.3 * np.clip((15 - np.arange(1, 21)) / 5, 0.0, 1.0)
    np.testing.assert_allclose(pull, expected[:, None] * [0.0, 0.0, 1.0], atol=1e-10)
    assert simulation.state.bodies[0].force_sequence == 5
    # Spread over the triangle's corners by the weights.
    first = Simulation(organ, shapes=sphere_tools(0.005))
    first.apply_force(triangle, weight[:, None] * [0.0, 0.0, 0.3])
    first.step()
    again = Simulation(organ, shapes=sphere_tools(0.005))
    take_set(again, 1, triangle, weight)
    again.take_force(0, np.array([0.0, 0.0, 0.3]), 1)
    again.step()
    np.testing.assert_allclose(again.positions, first.positions, rtol=0.0, atol=1e-15)


def test_force_without_tissue_near_the_tip_does_nothing():
    simulation = engaged_at(FAR)
    simulation.take_force(0, np.array([0.0, 0.0, 5.0]), 3)
    simulation.step()
    assert simulation.asleep
    np.testing.assert_array_equal(simulation.positions, simulation.model.rest)
