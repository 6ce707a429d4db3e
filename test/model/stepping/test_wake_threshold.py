"""What organs don't feel of ligaments and of the breath: bounded, without a jump, and nothing that somebody notices."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, ball_of_cells, free_ball
from tissue_sim.contact.attachments import Attachment, Breathing
from tissue_sim.contact.coupling_setup import join
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.elasticity.gravity import add_weight, write_masses
from tissue_sim.model.elasticity.modes import free_axes, stiffness_matrix
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.wake_threshold import (
    UNBOUNDED,
    WAKE_DISPLACEMENT,
    WAKE_FORCE,
    bounds_of,
    loaded_fraction,
    rounded_up,
)

TOP = int(np.argmax(ball().surface_positions[:, 2]))
UP = (0.0, 0.0, 0.05)  # m, from there to the point that it hangs on


def hanging(stiffness, way=0.0, breathes=(0.0,), damping=0.001):
    """Balls, of which the first hangs on a point that breathes by `way`, m; the others lie where nothing touches."""
    simulations = [Simulation(ball()) for _ in breathes]
    ligament = Attachment(
        (0, None), stiffness, damping, nodes=[TOP], point=ball().surface_positions[TOP] + UP, moves=1.0
    )
    return join(simulations, [ligament], Breathing(30.0, (0.0, 0.0, way)), breathes)


def feeling_all(joined):
    """The same, with organs that feel everything."""
    joined.threshold.limits[:] = 0.0
    return joined


# bounds ------------------------------------------------------------------------------------------
def test_what_is_lacking_is_bounded_and_shrinks_as_loads_grow():
    most = np.array([WAKE_DISPLACEMENT, WAKE_FORCE])
    sizes = np.geomspace(1e-3, 1e3, 500)
    for scale, loads in ((WAKE_DISPLACEMENT, lambda size: (size, 0.0)), (WAKE_FORCE, lambda size: (0.0, size))):
        felt = np.array([loaded_fraction(*loads(scale * size), most) for size in sizes])
        lacking = sizes * (1.0 - felt)
        assert lacking.max() <= 1.0
        assert np.all(np.diff(lacking[sizes > 1.0]) < 0.0)
        assert np.all(felt[sizes < 1.0] == 0.0)
        assert np.abs(np.diff(felt)).max() < 0.06, "no jump"
    assert loaded_fraction(1e-9, 0.0, np.zeros(2)) == 1.0


@pytest.mark.parametrize("organ", [ball(), ball_of_cells(2, 60)], ids=["springs", "cells"])
def test_bounds_are_what_linear_statics_say(organ):
    simulation = Simulation(organ)
    nodes, way = np.array([TOP, TOP - 3, int(organ.fixed[0])]), np.array([0.0, 0.01, 0.02])
    bend, give = bounds_of(simulation.model, nodes, way)
    free = free_axes(simulation.model)
    compliance = np.zeros((3 * organ.n_nodes,) * 2)
    compliance[np.ix_(free, free)] = np.linalg.inv(stiffness_matrix(simulation.model).toarray()[np.ix_(free, free)])
    blocks = compliance.reshape(organ.n_nodes, 3, organ.n_nodes, 3)
    exact = [np.linalg.norm(blocks[:, :, node], ord=2, axis=(1, 2)).max() for node in nodes]
    assert np.all(give >= exact)
    assert np.all(give <= 1.8 * np.array(exact))
    assert give[2] == 0.0, "it is held"

    weight = np.zeros((organ.n_nodes, 3))
    simulation.set_gravity(way / np.linalg.norm(way))
    masses = np.zeros(organ.n_nodes)
    write_masses(simulation.model, masses)
    add_weight(simulation.model, simulation.settings, masses, weight)
    bent = np.linalg.norm((compliance @ weight.ravel()).reshape(-1, 3), axis=1).max()
    assert bent <= bend <= 1.1 * bent


def test_bounds_are_the_same_where_another_processor_rounds_otherwise():
    assert rounded_up(0.0) == 0.0
    for value in (0.0731, 0.07, 1.0, 8.123e-7):
        assert value <= rounded_up(value) <= 1.1 * value
        assert {rounded_up(value * (1.0 + e)) for e in (-1e-12, 0.0, 1e-12)} == {rounded_up(value)}


def test_what_nothing_holds_feels_everything():
    bend, give = bounds_of(Simulation(free_ball()).model, np.array([TOP]), np.array([1.0, 0.0, 0.0]))
    assert bend == UNBOUNDED
    assert give[0] == UNBOUNDED
    assert bounds_of(Simulation(free_ball()).model, np.zeros(0, dtype=np.int64), np.zeros(3)) == (
        0.0,
        pytest.approx([]),
    )


# ticks -------------------------------------------------------------------------------------------
def test_an_organ_whose_ligament_hardly_pulls_sleeps_and_is_counted():
    few, all_of_it = hanging(0.05, 0.01, (0.0, 0.0)), feeling_all(hanging(0.05, 0.01, (0.0, 0.0)))
    for _ in range(2000):
        few.step()
        all_of_it.step()
        assert few.threshold.tension[0] < WAKE_FORCE
        off = few.simulations[0].positions - all_of_it.simulations[0].positions
        assert np.linalg.norm(off, axis=1).max() < WAKE_DISPLACEMENT
    ticks = few.threshold.ticks
    assert ticks[0] > 1900
    assert ticks[1] == 0, "nothing acts on it"
    assert few.simulations[0].state.count.asleep_ticks == 2000
    assert all_of_it.simulations[0].state.count.asleep_ticks < 200, "an organ that is kept awake shows"
    assert all_of_it.threshold.ticks[0] == 0


def test_it_wakes_without_a_kick_when_the_ligament_pulls_more_and_sleeps_again():
    few, all_of_it = hanging(3.0, 0.01), feeling_all(hanging(3.0, 0.01))
    organ, other = few.simulations[0], all_of_it.simulations[0]
    asleep, off, sped, pulled = [], 0.0, 0.0, 0.0
    for _ in range(4000):
        before = organ.velocities.copy()
        few.step()
        all_of_it.step()
        asleep.append(organ.asleep)
        sped = max(sped, np.linalg.norm(organ.velocities - before, axis=1).max())
        off = max(off, np.linalg.norm(organ.positions - other.positions, axis=1).max())
        pulled = max(pulled, few.threshold.tension[0])
    assert off < WAKE_DISPLACEMENT
    assert pulled > 5.0 * WAKE_FORCE
    assert 200 < np.count_nonzero(asleep) < 3500
    assert np.count_nonzero(np.diff(np.array(asleep, dtype=int)) == 1) == 2, "after each of two breaths"
    kick = WAKE_FORCE * 1e-3 / organ.organ.mass[TOP]  # m/s, of all that isn't felt at once
    assert sped < 0.2 * kick
    assert organ.state.count.faults == 0


def test_a_breath_that_hardly_bends_it_lets_an_organ_sleep_and_a_fast_one_does_not():
    for rate, sleeps in ((15.0, True), (120.0, False)):
        soft = replace(ball(), mass=50.0 * ball().mass)
        joined = join([Simulation(soft)], (), Breathing(rate, (0.0, 0.0, 0.015)), (1.0,))
        bent = 0.0
        for _ in range(1000):
            joined.step()
            bent = max(bent, joined.threshold.displacement[0])
        assert (bent < WAKE_DISPLACEMENT) == sleeps
        assert (joined.simulations[0].state.count.asleep_ticks == 1000) == sleeps


def test_an_organ_that_is_handled_feels_all_of_it():
    joined = hanging(0.05, 0.01)
    organ = joined.simulations[0]
    for _ in range(1000):
        organ.apply_force([TOP - 1], [[1e-5, 0.0, 0.0]])
        joined.step()
    assert 0.0 < joined.threshold.tension[0] < WAKE_FORCE
    assert joined.threshold.fraction[0] == 1.0
    assert not organ.asleep
    assert joined.threshold.ticks[0] == 0


def test_an_organ_that_a_tool_touches_feels_all_of_it():
    ligament = Attachment((0, None), 0.05, nodes=[TOP], point=ball().surface_positions[TOP] + UP, slack=0.049)
    scene = Scene([ball()], [Tool("ball", "sphere", radius=0.005)], attachments=[ligament])
    scene.step()
    assert scene.joined.threshold.fraction[0] == 0.0
    side = int(np.argmax(ball().surface_positions[:, 0]))
    at = ball().surface_positions[side]
    for tick in range(100):
        scene.move(0, at * (1.0 + (0.008 - 0.00006 * tick) / np.linalg.norm(at)))
        scene.step()
    assert scene.simulation.state.status.touching > 0
    assert scene.joined.threshold.fraction[0] == 1.0


def test_an_organ_made_softer_or_given_weight_wakes():
    joined = hanging(0.05, 0.0)
    joined.links.slack[:] -= 0.002
    organ = joined.simulations[0]
    for _ in range(5):
        joined.step()
    assert organ.asleep
    bent = joined.threshold.displacement[0]
    assert 0.0 < bent < WAKE_DISPLACEMENT
    organ.settings.stiffness_scale = bent / WAKE_DISPLACEMENT / 4.0
    joined.set_substeps()
    joined.step()
    assert not organ.asleep
    assert 0.0 < joined.threshold.fraction[0] < 1.0

    joined = hanging(0.05, 0.0)
    joined.links.slack[:] -= 0.002
    joined.step()
    joined.simulations[0].set_gravity((0.0, 0.0, -1.0))
    joined.note_gravity()
    joined.step()
    assert not joined.simulations[0].asleep
    assert joined.threshold.fraction[0] == 1.0


def test_an_organ_falls_asleep_while_a_hand_is_on_another_one():
    joined = hanging(0.05, 0.0, (0.0, 0.0))
    first, second = joined.simulations
    for tick in range(1500):
        second.apply_force([TOP], [[0.0, 0.0, -0.02]])
        if tick < 20:
            first.apply_force([TOP - 1], [[0.02, 0.0, 0.0]])
        joined.step()
    assert first.asleep
    assert not second.asleep
