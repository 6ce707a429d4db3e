"""A held loop takes exactly the ticks that it is given."""

import time

import pytest

from helpers.patience import wait_for
from helpers.scenes import ball
from tissue_sim.model.data.records import copy_of
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.node.output.loop_timing import TimingReader
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.organs import Organs

MOMENT = 0.06  # s in which a loop that were not held would take 60 ticks, and have some to drop afterwards


@pytest.fixture
def organs():
    made = Organs(Loop(Joined([Simulation(ball(1))])))
    made.loop.start()
    wait_for(lambda: made.loop.ticks > 0)
    yield made
    made.loop.stop()


def test_a_held_loop_takes_the_ticks_that_it_is_given_and_then_goes_on(organs):
    loop, control = organs.loop, organs.loop.words.control
    loop.pause.begin()
    dropped, unheld, released = int(control.dropped), 0.0, time.monotonic()
    for _ in range(3):
        loop.pause.begin()
        unheld += time.monotonic() - released
        assert loop.standing
        assert not loop.clock_stands
        before, stood = loop.ticks, loop.pause.now()
        loop.wake()  # as a pose does
        time.sleep(MOMENT)
        assert loop.ticks == before
        for taken in range(1, 6):
            assert loop.pause.step()
            assert loop.ticks == before + taken
        assert loop.pause.now() == pytest.approx(stood + 5e-3, abs=1e-9), "five ticks of 1 ms"
        assert organs.wrenches()[0] == -1, "no force comes back with the ticks"
        released = time.monotonic()
        loop.pause.end()
        assert loop.ticks > before + 5
        assert not loop.standing
        gone = loop.pause.now() - (stood + 5e-3)
        assert -1e-9 <= gone <= time.monotonic() - released, "the pause doesn't count"
        assert not loop.pause.step(), "it isn't held"
    unheld += time.monotonic() - released
    assert 1e-3 * (int(control.dropped) - dropped) <= unheld, "a busy machine may keep it waiting then, and only then"


def test_a_rate_that_changes_meanwhile_changes_no_number_of_ticks(organs):
    loop = organs.loop
    loop.pause.begin()
    before = loop.ticks
    for taken, tick_time in enumerate((0.01, 0.01, 0.0005, 0.0005, 0.002, 0.001), 1):
        settings = copy_of(organs.settings())
        settings.tick_time = tick_time
        organs.each[0].post_settings(settings)
        loop.pause.step()
        assert loop.ticks == before + taken
        assert loop.tick_time == tick_time, "as of the next one"
    time.sleep(MOMENT)
    assert loop.ticks == before + 6


def test_a_held_loop_is_neither_behind_nor_slow(organs):
    reader = TimingReader(organs)
    organs.loop.pause.begin()
    reader.read()
    time.sleep(MOMENT)
    for _ in range(60):
        organs.loop.pause.step()
    timing = reader.read()
    assert timing.ticks == 60
    assert timing.real_time_factor == pytest.approx(1.0, abs=1e-6)
    assert timing.behind < 0.5 * MOMENT
    assert timing.dropped == 0


def test_a_loop_that_has_ended_says_so(organs):
    organs.loop.pause.begin()
    organs.loop.stop()
    wait_for(lambda: not organs.loop.alive)
    with pytest.raises(TimeoutError, match="doesn't answer"):
        organs.loop.pause.step()
