"""A running loop goes on with an organ of another size, and does what a simulation by hand does."""

import numpy as np
import pytest

from helpers.ros.processes import shipped
from tissue_sim.model.data.shapes import sphere_tools
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.organs import Organs

CUT = [[0.055, 0.0, 0.0], [0.075, 0.0, 0.0]], [0.0, 1.0, 0.0], 0.03


def make():
    simulation = Simulation(shipped(), shapes=sphere_tools(0.005))
    simulation.velocities[simulation.model.moving, 1] = 0.05  # it swings
    simulation.state.status.asleep = False
    return simulation


@pytest.fixture
def loop():
    made = Loop(Joined([make()]))
    made.start()
    yield made
    made.stop()


def test_a_loop_that_is_cut_does_what_is_done_by_hand(loop):
    physics = Organs(loop).each[0]
    loop.pause.begin()
    by_hand = make()
    by_hand.step(loop.ticks)
    made = physics.simulation.prepared_cut(*CUT)
    tick = physics.exchange(made)
    assert tick == loop.ticks + 1
    assert physics.version == 1
    cut = by_hand.cut(*CUT)
    for _ in range(5):
        loop.pause.step()
    cut.step(5)
    shown = np.zeros_like(cut.positions)
    assert physics.positions(shown)[0] == tick + 4
    np.testing.assert_array_equal(shown, cut.positions)
    assert np.abs(cut.positions - cut.model.rest).max() > 1e-6


def test_readers_with_room_for_fewer_nodes_get_these(loop):
    physics = Organs(loop).each[0]
    before = physics.surface_sequence
    made = physics.simulation.prepared_cut(*CUT)
    physics.exchange(made)
    assert physics.surface_sequence > before
    fewer, every = np.zeros((shipped().n_nodes, 3)), np.zeros((made.organ.n_nodes, 3))
    loop.pause.begin()
    physics.positions(every)
    physics.positions(fewer)
    np.testing.assert_array_equal(fewer, every[: len(fewer)])


def test_a_running_loop_takes_a_cut_up_between_two_ticks_once_it_is_preloaded(loop):
    physics = Organs(loop).each[0]
    made = physics.simulation.prepared_cut(*CUT)
    tick = physics.exchange(made)
    words = loop._exchange.words
    assert words.loaded == words.asked == 1
    loop.pause.begin()
    by_hand = make()
    by_hand.step(tick - 1)
    cut = by_hand.cut(*CUT)
    cut.step(loop.ticks - tick + 1)
    shown = np.zeros_like(cut.positions)
    newest = physics.positions(shown)[0]
    assert newest == loop.ticks or cut.state.status.asleep, "as it is where a busy machine has taken long"
    np.testing.assert_array_equal(shown, cut.positions)
