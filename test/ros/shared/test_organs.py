"""Organs of a scene as tools meet them: the wrench is the sum of theirs."""

import numpy as np
import pytest

from helpers.patience import wait_for
from helpers.scenes import ball
from tissue_sim.contact.coupling_setup import join
from tissue_sim.contact.finder import ContactFinder, ContactQuery
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.placement import placed
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.organs import Organs

TOOLS = ToolSet([Tool("left", "sphere", 0.02)])
APART = 0.08  # m between the middles of two balls: a tool in the middle would reach 10 mm into both
# m from the middle: there, what both do to the tool cancels out, and it feels something only until they are at rest.
ASIDE = 0.002


@pytest.fixture
def organs():
    """Two balls, and room for half a tool between them."""
    bodies = [placed(ball(2), [side * 0.5 * APART, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]) for side in (-1.0, 1.0)]
    simulations = [Simulation(organ, shapes=TOOLS.shapes) for organ in bodies]
    for one in simulations:
        one.settings.stale_time = 1e9
        one.settings.friction = 0.0
    made = Organs(Loop(join(simulations)))
    made.loop.start()
    yield made
    made.loop.stop()


def press(organs):
    """Put the tool between both, and tell where it touches them."""
    pose = np.array([[ASIDE, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    sequence, all_of_it = organs.post_poses([0], pose), np.ones(1, dtype=np.int64)
    for one in organs.each:
        wait_for(lambda taken=one: taken.results().bodies[0].pose_sequence == sequence)
        organ = one.simulation.organ
        finder = ContactFinder(organ, TOOLS)
        query = ContactQuery(pose, np.zeros(1), all_of_it, 0 * all_of_it, 0 * all_of_it)
        one.post_contacts(finder.find(organ.rest_positions, query))
    wait_for(lambda: all(one.results().status.touching > 0 for one in organs.each))


def both_at_one_tick(organs):
    """What a tool feels of both, and of each, (6,), handed out by the same tick."""
    for _ in range(1000):
        before, of_each = organs.wrenches(), [one.results() for one in organs.each]
        if {before[0]} == {one.status.tick for one in of_each}:
            return before[1][0], [one.wrench[0] for one in of_each]
    raise AssertionError("the results never belong together")


def test_a_tool_feels_the_sum_of_all_organs(organs):
    press(organs)
    wait_for(lambda: np.abs(organs.wrenches()[1]).max() > 0.1)
    total, parts = both_at_one_tick(organs)
    assert np.array_equal(total, parts[0] + parts[1])
    assert parts[0][0] > 0.0 > parts[1][0], "N: each pushes to its own side"
    assert not organs.hold_off([0])


def test_the_sum_is_clamped(organs):
    for one, most in zip(organs.each, (0.1, 0.5), strict=True):
        settings = one.settings()
        settings.force_clamp = most
        one.post_settings(settings)
    press(organs)
    wait_for(lambda: np.linalg.norm(organs.wrenches()[1][0, :3]) > 0.09)
    wait_for(lambda: np.linalg.norm(organs.each[1].wrenches()[1][0, :3]) > 0.4)
    for _ in range(200):
        assert np.linalg.norm(organs.wrenches()[1][0, :3]) <= 0.1 * (1.0 + 1e-12), "N, as the first organ has it"


def test_no_force_comes_from_a_loop_that_has_ended(organs):
    press(organs)
    wait_for(lambda: np.abs(organs.wrenches()[1]).max() > 0.1)
    organs.loop.stop()
    wait_for(lambda: organs.wrenches()[0] == -1)
    assert not organs.wrenches()[1].any()


def test_the_wrench_of_one_organ_alone_is_its_own():
    """To the last bit, though it presses with as much as the clamp allows, which is not applied a second time."""
    simulation = Simulation(placed(ball(2), [0.5 * APART, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]), shapes=TOOLS.shapes)
    simulation.settings.stale_time, simulation.settings.force_clamp = 1e9, 0.1
    organs = Organs(Loop(Joined([simulation])))
    organs.loop.start()
    press(organs)
    wait_for(lambda: np.linalg.norm(organs.wrenches()[1][0, :3]) > 0.099)
    for _ in range(100):
        total, (own,) = both_at_one_tick(organs)
        assert np.array_equal(total, own)
    assert len(organs.each) == len(organs.surface_sequences) == 1
    organs.loop.stop()


def test_a_tick_is_asked_for_when_all_bodies_of_a_tool_were_posted(monkeypatch):
    """Woken in between, the loop would move one jaw of a gripper."""
    jaws = ToolSet([Tool("left", "gripper", 0.003, length=0.04)])
    loop = Loop(Joined([Simulation(ball(1), shapes=jaws.shapes)]))
    organs, asked = Organs(loop), []
    monkeypatch.setattr(loop, "wake", lambda: asked.append(loop.boxes[0].pose.sequence.tolist()))
    poses = jaws.poses(0, np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0]), 0.5)
    assert [organs.post_poses([0, 1], poses) for _ in range(2)] == [1, 2]
    assert asked == [[1, 1], [2, 2]]


def test_what_asks_for_a_tick_is_answered_when_it_has_ended():
    organs = Organs(Loop(Joined([Simulation(ball(1), shapes=TOOLS.shapes)])))
    pose = np.array([[0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0]])
    organs.loop.start()
    assert not organs.loop.wait_for_answer(0.01), "nothing was asked for"
    for _ in range(20):
        sequence = organs.post_poses([0], pose)
        assert organs.loop.wait_for_answer(10.0)
        assert organs.taken().tolist() == [sequence]
    organs.loop.stop()
