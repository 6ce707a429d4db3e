"""Poses, forces and contact sets as they are taken up."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from helpers.scenes import ball, free_ball
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.model.data.contact_set import contact_set, padded
from tissue_sim.model.data.shapes import sphere_tools
from tissue_sim.model.simulation import Simulation

FAR = np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0])


def engaged_at(pose):
    """A simulation whose only tool is engaged and stands at a pose."""
    simulation = Simulation(ball(), shapes=sphere_tools(0.005))
    simulation.take_pose(0, pose, 1)
    take_set(simulation, 2)
    return simulation


def take_set(simulation, sequence, tip_node=(-1, -1, -1), tip_weight=(0.0, 0.0, 0.0), engaged=1, releases=None):
    """A contact set without entries, which reaches everywhere."""
    found = contact_set(1, 0)
    found.tip_node[:], found.tip_weight[:] = (
        padded("tip_node", np.array([tip_node])),
        padded("tip_weight", np.array([tip_weight])),
    )
    found.engaged[0] = engaged
    found.reach[0] = 1e3
    found.releases[0] = simulation.state.bodies[0].releases if releases is None else releases
    simulation.take_contacts(found, sequence)


def test_first_pose_is_taken_at_once():
    simulation = Simulation(ball(), shapes=sphere_tools(0.005))
    simulation.take_pose(0, FAR, 7)
    simulation.step()
    np.testing.assert_array_equal(simulation.state.body_pose[0], FAR)
    assert simulation.state.bodies[0].pose_sequence == 7
    assert simulation.state.bodies[0].age == 1


@pytest.mark.parametrize(("smoothing", "ticks"), [(0.0, 1), (0.25, 4), (0.5, 8), (1.0, 16)])
def test_a_tool_takes_its_smoothing_of_the_time_between_poses(smoothing, ticks):
    tools = ToolSet([Tool("left", smoothing=smoothing)])
    simulation = Simulation(ball(), shapes=tools.shapes)
    simulation.take_pose(0, FAR, 1)
    take_set(simulation, 2)
    for _ in range(16):
        simulation.step()
    simulation.take_pose(0, FAR - np.array([0.0, 0.0, 0.016, 0.0, 0.0, 0.0, 0.0]), 2)
    height = []
    for _ in range(18):
        simulation.step()
        height.append(0.2 - simulation.state.body_pose[0, 2])
    np.testing.assert_allclose(height, 0.016 * np.minimum(1.0, np.arange(1, 19) / ticks), atol=1e-15)


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


def test_slow_input_leads_the_tool_no_longer_than_it_may_be_stale():
    simulation = engaged_at(FAR)
    for _ in range(60):
        simulation.step()
    simulation.take_pose(0, FAR + 0.001, 2)
    assert simulation.state.bodies[0].remaining == simulation.settings.stale_time


def led(poses, ticks):
    """The way of a tool, (ticks + 1, 7), that is given poses by the tick that takes them: stamp in ms, pose (7,)."""
    simulation = engaged_at(FAR)
    path = [FAR]
    for tick in range(ticks):
        if tick in poses:
            stamp, pose = poses[tick]
            simulation.take_pose(0, pose, 2 + tick, round(1_000_000 * (1000 + stamp)))
        simulation.step()
        path.append(simulation.state.held_pose[0].copy())
    return np.array(path)


def down_and_turning(milliseconds):
    """A pose that goes down by 0.1 m/s and turns by 0.2 rad/s."""
    turn = Rotation.from_rotvec([0.0, 2e-4 * milliseconds, 0.0]).as_quat()
    return np.array([0.0, 0.0, 0.2 - 1e-4 * milliseconds, *turn])


def moved(path):
    """How far a tool went in each tick, m, and how far it turned, rad."""
    turns = Rotation.from_quat(path[:, 3:])
    return np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1), (turns[:-1].inv() * turns[1:]).magnitude()


SKIPPED = {tick: (tick, down_and_turning(tick)) for tick in range(60) if not 20 <= tick < 40}
BURST = {tick: (60 if tick > 43 else tick, down_and_turning(60 if tick > 43 else tick)) for tick in SKIPPED}
# Each pose is under way for 0 to 3 ms, and the newest that has come is taken.
NEWEST = [max((sent for sent in range(60) if sent + (0, 3, 1, 2)[sent % 4] <= tick), default=0) for tick in range(63)]
JITTER = {
    tick: (sent, down_and_turning(sent)) for tick, sent in enumerate(NEWEST) if sent > max(NEWEST[:tick], default=-1)
}


@pytest.mark.parametrize("poses", [SKIPPED, BURST, JITTER], ids=["skipped", "in a burst", "late"])
def test_tool_goes_no_faster_than_stamps_tell_it_wherever_poses_were_late(poses):
    path = led(poses, 140)
    went, turned = moved(path)
    assert went.max() < 1e-4 * (1.0 + 1e-9)
    assert turned.max() < 2e-4 * (1.0 + 1e-6)
    # And ends where the last pose is.
    np.testing.assert_array_equal(path[-1], poses[max(poses)][1])


def test_tool_is_where_its_poses_are_when_they_come_in_time():
    path = led({tick: (tick, down_and_turning(tick)) for tick in range(50)}, 50)
    np.testing.assert_allclose(path[1:], [down_and_turning(tick) for tick in range(50)], rtol=0.0, atol=1e-12)


def test_stamps_that_stand_still_or_go_wild_leave_the_tool_behind_no_longer_than_stale_time():
    for stamps in (
        lambda tick: 5,
        lambda tick: 1e6 * tick,
        lambda tick: 1e-6 * tick,
        lambda tick: tick if tick % 2 else 3,
    ):
        path = led({tick: (stamps(tick), down_and_turning(tick)) for tick in range(100)}, 151)
        np.testing.assert_array_equal(path[-1], down_and_turning(99))
        assert np.all(np.isfinite(path))
        behind = np.linalg.norm(path[1:101, :3] - [down_and_turning(tick)[:3] for tick in range(100)], axis=1)
        assert behind.max() < 50 * 1e-4


def test_stale_tool_lets_go_and_does_not_engage_without_a_new_pose():
    simulation = engaged_at(FAR)
    assert simulation.state.bodies[0].engaged
    for _ in range(71):
        simulation.step()
    assert not simulation.state.bodies[0].engaged
    unknown = Simulation(ball(), shapes=sphere_tools(0.005))
    take_set(unknown, 1)
    assert not unknown.state.bodies[0].engaged


def test_a_set_of_an_earlier_life_engages_nothing():
    simulation = engaged_at(FAR)
    for _ in range(71):
        simulation.step()
    body = simulation.state.bodies[0]
    assert body.released
    assert body.releases == 1
    simulation.take_pose(0, FAR, 2)
    take_set(simulation, 2, releases=0)  # by a thread that saw nothing of it
    assert not body.engaged
    take_set(simulation, 3)
    assert body.engaged


def test_a_tool_goes_no_farther_than_its_contact_set_reaches():
    """Nor when its poses jump; it gets there once a set has the surface around it. No set that lacks it is taken."""
    simulation = engaged_at(FAR)
    found = contact_set(1, 0)
    found.engaged[0], found.place[0], found.reach[0] = 1, FAR, 0.01
    found.tip_node[0] = -1
    simulation.take_contacts(found, 3)
    goal = FAR + [0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 0.0]
    simulation.take_pose(0, goal, 4)
    pose = simulation.state.body_pose[0]
    for _ in range(20):
        simulation.step()
    np.testing.assert_allclose(pose[2], FAR[2] + 0.01, atol=1e-12)
    found.place[0, 2] += 0.03  # 20 mm from the tool, that is
    simulation.take_contacts(found, 5)
    assert simulation.state.contacts.header.sequence == 3
    found.place[0, 2] -= 0.015
    simulation.take_contacts(found, 6)
    for _ in range(20):
        simulation.step()
    np.testing.assert_allclose(pose[2], FAR[2] + 0.025, atol=1e-12)
    take_set(simulation, 7)
    simulation.step()
    np.testing.assert_array_equal(pose, goal)


@pytest.mark.parametrize(("pause", "goes_on"), [(0.1, True), (1.5, False)])
def test_a_tool_whose_poses_go_on_soon_stays_where_it_was(pause, goes_on):
    """A hand that pressed when its poses stopped is resisted from there; a new one is where it appears."""
    simulation = engaged_at(FAR)
    for _ in range(round(1e3 * pause)):
        simulation.step()
    there = FAR + [0.0, 0.0, -0.1, 0.0, 0.0, 0.0, 0.0]
    simulation.take_pose(0, there, 2)
    simulation.step()
    np.testing.assert_array_equal(simulation.state.body_pose[0], FAR if goes_on else there)
    assert simulation.state.bodies[0].resisted == goes_on
    take_set(simulation, 3)
    simulation.step()
    np.testing.assert_array_equal(simulation.state.body_pose[0], there)


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
