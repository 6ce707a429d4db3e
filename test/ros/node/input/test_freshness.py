"""How fresh input is, by the clock that ticks follow."""

import itertools
import math
from types import SimpleNamespace

import pytest

from helpers.scenes import ball
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.node.input import freshness
from tissue_sim.ros.node.input.freshness import Freshness
from tissue_sim.ros.shared.cdr import UNSTAMPED
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.organs import Organs


@pytest.fixture
def scene():
    """Freshness by a clock that the test moves, with the settings that a simulation has at first."""
    clock = SimpleNamespace(
        time=10.0, now=lambda: clock.time, jumped=[], age_of=lambda stamp: clock.time - 1e-9 * stamp
    )
    made = Organs(Loop(Joined([Simulation(ball(1))])))
    organs = SimpleNamespace(
        loop=SimpleNamespace(standing=False, clock_stands=False), stale_time=made.stale_time, ramp_time=made.ramp_time
    )
    return SimpleNamespace(clock=clock, organs=organs, freshness=Freshness(clock, organs), stamps=itertools.count(1))


def states(scene, *ages):
    """Whether a message that came so many s ago is fresh, and whether it counts."""
    found = []
    for age in ages:
        scene.freshness.came(next(scene.stamps))
        scene.clock.time += age
        found.append((scene.freshness.is_fresh, scene.freshness.counts))
    return found


def test_what_is_stale_counts_until_it_has_faded(scene):
    """After 50 ms stale, 20 ms later faded: of the clock's time, however long the wall waits."""
    assert states(scene, 0.0, 0.049, 0.051, 0.069, 0.071) == [
        *((True, True), (True, True), (False, True)),
        *((False, True), (False, False)),
    ]


def test_nothing_counts_before_the_first_message_nor_while_the_clock_stands(scene):
    assert scene.freshness.age == math.inf
    assert not scene.freshness.counts
    scene.organs.loop.standing = scene.organs.loop.clock_stands = True
    assert states(scene, 0.0) == [(False, False)]
    scene.organs.loop.standing = scene.organs.loop.clock_stands = False
    assert states(scene, 0.0) == [(True, True)]


def test_while_the_loop_is_held_what_is_fresh_stays_so_and_a_stream_may_begin_anew(scene):
    scene.freshness.came(5_000)
    scene.organs.loop.standing = True
    assert scene.freshness.is_fresh
    assert scene.freshness.counts
    assert scene.freshness.last_stamp == 0, "of a bridge that was started again"


def test_a_stream_that_begins_anew_may_have_any_stamp(scene):
    scene.freshness.came(5_000)
    assert scene.freshness.last_stamp == 5_000
    scene.clock.time += 0.1
    assert scene.freshness.last_stamp == 0, "faded"
    scene.freshness.came(5_000)
    scene.clock.time = 3.0
    for begin_anew in scene.clock.jumped:
        begin_anew()
    assert scene.freshness.last_stamp == 0, "the clock jumped back"
    assert not scene.freshness.counts


def test_the_period_is_that_of_the_times_at_which_messages_come(scene):
    """Several at one time of /clock are one to the ticks; a pause is none."""
    for _ in range(400):
        scene.clock.time += 0.01
        for _ in range(3):
            scene.freshness.came(next(scene.stamps))
    scene.clock.time += 5.0
    scene.freshness.came(1)
    assert 0.0099 < scene.freshness.period <= 0.0125


def test_the_delay_is_how_old_messages_are_when_they_come(scene):
    def come(age, count=400):
        for _ in range(count):
            scene.clock.time += 0.01
            scene.freshness.came(round(1e9 * (scene.clock.time - age)))

    assert scene.freshness.delay == 0.0
    come(0.004)
    assert scene.freshness.delay == pytest.approx(0.004, rel=0.01)
    come(-0.02)
    assert scene.freshness.delay == pytest.approx(0.0, abs=1e-5), "a clock that is ahead"
    come(0.004)
    come(30.0)
    assert scene.freshness.delay == pytest.approx(0.0, abs=1e-5), "a clock that is far behind"
    for _ in range(400):
        scene.freshness.came(UNSTAMPED)
    assert scene.freshness.delay == pytest.approx(0.0, abs=1e-5)


def test_poses_that_are_stale_before_the_next_are_reported_by_their_gap(scene):
    def come(gap, count=9):
        for _ in range(count):
            scene.clock.time += gap
            scene.freshness.came(UNSTAMPED)

    come(0.01)
    assert scene.freshness.too_slow == 0.0
    come(1.0 / 16.0)
    assert scene.freshness.too_slow == pytest.approx(1.0 / 16.0)
    come(0.6, count=1)
    assert scene.freshness.too_slow == pytest.approx(1.0 / 16.0), "a pause does not count for more than one"
    come(2.0, count=1)
    assert scene.freshness.too_slow == 0.0, "a stream that begins again"
    come(0.3)
    assert scene.freshness.too_slow == pytest.approx(0.3)
    scene.clock.time += 2.0
    assert scene.freshness.too_slow == 0.0, "one that has ended"


def test_a_stamp_that_stands_keeps_nothing_fresh(scene):
    """A driver whose device has gone may repeat its last message for ever."""
    for _ in range(10):
        scene.clock.time += 0.01
        scene.freshness.came(7_000)
    assert not scene.freshness.is_fresh
    assert scene.freshness.stands_at(7_000)
    assert not scene.freshness.stands_at(7_001)
    scene.freshness.came(7_001)
    assert scene.freshness.is_fresh
    assert not scene.freshness.stands_at(7_001), "not before it is stale"


def test_a_stamp_may_advance_by_the_time_that_has_passed_and_a_second(scene, monkeypatch):
    wall = SimpleNamespace(now=100.0)
    monkeypatch.setattr(freshness.time, "monotonic", lambda: wall.now)
    assert scene.freshness.latest_stamp == math.inf, "of the first message"
    scene.freshness.came(5_000_000_000)
    scene.clock.time += 0.03
    assert scene.freshness.latest_stamp == pytest.approx(6.03e9)
    wall.now += 0.04
    assert scene.freshness.latest_stamp == pytest.approx(6.04e9), "also where the simulation's clock is slower"
    scene.clock.time += 0.1
    assert scene.freshness.latest_stamp == math.inf, "of a stream that begins again"
