"""The compiled loop in a thread: its ticks, its mailboxes, its journal, and that its ticks repeat by hand."""

import ctypes
import itertools
import sys
import threading
import time

import numpy as np
import pytest

from helpers.patience import LIMIT, wait_for
from helpers.scenes import ball
from helpers.states import assert_same
from tissue_sim.handles import handle, row
from tissue_sim.model.data.contact_set import contact_set, padded
from tissue_sim.model.data.records import copy_of, words_of
from tissue_sim.model.data.shapes import sphere_tools
from tissue_sim.model.data.state import results_in
from tissue_sim.model.data.world import make_world
from tissue_sim.model.runtime import loop as rt
from tissue_sim.model.runtime import mailboxes as mb
from tissue_sim.model.runtime.exchange import make_exchange
from tissue_sim.model.runtime.joined_box import make_joined_box
from tissue_sim.model.simulation import Simulation

RATE = 1000.0
RADIUS = 0.006  # m, of the tool
BOXES = ("pose", "force", "contacts", "settings", "results", "shape")


def make_simulation():
    return Simulation(ball(2), rate=RATE, shapes=sphere_tools(RADIUS))


class Loop:
    """The loop on a simulation of its own, as the node drives it. Keeps what it posts, by sequence number.

    A pose gets stale after stale_time s of ticks; never where it is pressed for as long as this thread takes.
    """

    def __init__(self, stale_time=0.05):
        self.simulation = make_simulation()
        self.simulation.settings.stale_time = self.stale_time = stale_time
        self.box, self.words = mb.make_mailboxes(self.simulation.state), mb.make_loop_words()
        self.control = self.words.control
        self.handles = {name: handle(getattr(self.box, name)) for name in BOXES}
        self.poses, self.forces, self.contacts, self.settings = {}, {}, {}, {}
        self.thread = threading.Thread(target=self._run, daemon=True)

    def _run(self):
        one = self.simulation
        world = make_world(one.model, one.state, one.shapes, copy_of(one.settings), one.scratch)
        own, boxes = handle(world), handle(self.box)
        world, box = row([own]), row([boxes])
        exchange = handle(make_exchange(world, box, own, boxes, 0))
        rt.run_loop(world, box, handle(self.words), None, handle(make_joined_box(1)), exchange)

    def __enter__(self):
        self.thread.start()
        wait_for(lambda: self.control.loop_ticks > 0)
        return self

    def __exit__(self, *_):
        self.control.stop = True
        self.thread.join(timeout=LIMIT)
        assert not self.thread.is_alive()

    def ticks(self):
        return int(self.control.loop_ticks)

    def wait(self, ticks):
        """Until the loop has done some more ticks."""
        end = self.ticks() + ticks
        wait_for(lambda: self.ticks() >= end)

    def post_pose(self, pose):
        pose = np.array(pose, dtype=np.float64)
        words = np.append(pose.view(np.int64), time.monotonic_ns())
        self.poses[mb.put(self.handles["pose"], 0, words)] = pose, int(words[7])

    def post_force(self, force):
        force = np.array(force, dtype=np.float64)
        self.forces[mb.put(self.handles["force"], 0, force.view(np.int64))] = force

    def post_contacts(self, found):
        self.contacts[mb.put(self.handles["contacts"], 0, found.words)] = found

    def post_settings(self, settings):
        self.settings[mb.put(self.handles["settings"], 0, words_of(settings))] = copy_of(settings)

    def results(self):
        words = np.zeros(len(self.simulation.state.results), dtype=np.int64)
        mb.take(self.handles["results"], 0, 0, words)
        return results_in(words, 1)

    def shape(self):
        """Tick and positions that were handed out last."""
        words = np.zeros(len(self.simulation.state.shape), dtype=np.int64)
        mb.take(self.handles["shape"], 0, 0, words)
        return words[0], words[4:].view(np.float64).reshape(-1, 3)

    def snapshot(self):
        """The words of the whole state."""
        control = self.control
        control.snapshot_asked += 1
        wait_for(lambda: control.snapshot_done == control.snapshot_asked)
        return self.box.snapshot.copy()

    def journal(self):
        """Rows, and the only body's inputs beside them."""
        written = int(self.box.journal_written[0])
        return self.box.journal[:written].copy(), self.box.journal_inputs[:written, 0].copy()


def above(height, x=0.0):
    """A pose over the ball's top, m above it."""
    return np.array([x, 0.0, 0.03 + RADIUS + height, 0.0, 0.0, 0.0, 1.0])


def all_nodes(releases=0):
    """A contact set of every surface node, with the point under the tip in the topmost triangle."""
    organ = ball(2)
    nodes = np.repeat(np.arange(organ.n_surface)[:, None], 3, axis=1)
    weights = np.tile([1.0, 0.0, 0.0], (len(nodes), 1))
    middles = organ.surface_positions[organ.surface_triangles].mean(axis=1)
    top = organ.surface_triangles[np.argmax(middles[:, 2])].astype(np.int64)
    normals = organ.surface_positions / np.linalg.norm(organ.surface_positions, axis=1, keepdims=True)
    found = contact_set(1, len(nodes))
    found.header.points = len(nodes)
    found.node[:], found.weight[:], found.normal[:] = padded("node", nodes), padded("weight", weights), normals
    found.tip_node[0], found.tip_weight[0], found.engaged[0] = [*top, top[0]], [*[1.0 / 3.0] * 3, 0.0], 1
    found.reach[0], found.releases[0] = 1e3, releases  # everywhere
    return found


def test_loop_accounts_for_every_tick():
    with Loop() as loop:
        loop.wait(500)
    control = loop.control
    ticks, dropped = loop.ticks(), int(control.dropped)
    assert loop.simulation.state.status.tick == ticks
    assert control.simulated == round(1e9 * ticks / RATE)
    assert control.due <= time.monotonic_ns()
    timing = loop.words.timing[:ticks]
    assert np.all(timing.duration > 0)
    if ticks <= mb.TIMING_ROWS:
        # Late by more than may be made up for: then ticks are given up.
        assert (dropped > 0) == (timing.late.max() > rt.LATEST_CATCH_UP)


def test_loop_ticks_while_python_holds_the_gil():
    interval = sys.getswitchinterval()
    with Loop() as loop:
        # Nobody else gets the GIL for as long as this thread computes.
        sys.setswitchinterval(2.0 * LIMIT)
        try:
            before, end = loop.ticks(), time.monotonic() + LIMIT
            while loop.ticks() <= before + 100 and time.monotonic() < end:
                pass
            done = loop.ticks() - before
        finally:
            sys.setswitchinterval(interval)
    assert done > 100


def test_rest_shape_is_handed_out_once_and_nothing_more_while_asleep():
    with Loop() as loop:
        loop.wait(20)
        assert loop.box.shape.sequence[0] == 1
        np.testing.assert_array_equal(loop.shape()[1], ball(2).rest_positions)
        assert loop.results().status.tick >= 16, "a nap is a few ticks long"
        assert len(loop.journal()[0]) == 0


def test_journal_tells_which_tick_took_a_pose():
    with Loop() as loop:
        loop.wait(10)
        before = loop.ticks()
        loop.post_pose(above(0.05))
        loop.wait(10)
        (rows, inputs), after = loop.journal(), loop.ticks()
    assert len(rows) == 1
    assert inputs[0].pose == 1
    assert inputs[0].force == rows[0].contact_set == rows[0].settings == 0
    assert before < rows[0].tick <= after
    assert loop.simulation.state.bodies[0].pose_sequence == 1
    np.testing.assert_array_equal(loop.simulation.state.body_goal[0], above(0.05))


def by_hand(loop, ticks):
    """The journal's inputs fed to a simulation of its own, tick by tick."""
    simulation = make_simulation()
    simulation.settings.stale_time = loop.stale_time
    rows = {int(row.tick): (row, taken) for row, taken in zip(*loop.journal(), strict=True)}
    last, last_taken = mb.JournalRow.new(), mb.BodyInputs.new()
    for tick in range(1, ticks + 1):
        row, taken = rows.get(tick, (last, last_taken))
        if row.resets != last.resets:
            simulation.reset()
        if row.settings != last.settings:
            simulation.take_settings(loop.settings[row.settings])
        if taken.pose != last_taken.pose:
            pose, stamp = loop.poses[taken.pose]
            simulation.take_pose(0, pose, taken.pose, stamp)
        if taken.force != last_taken.force:
            simulation.take_force(0, loop.forces[taken.force], taken.force)
        if row.contact_set != last.contact_set:
            simulation.take_contacts(loop.contacts[row.contact_set], row.contact_set)
        last, last_taken = row, taken
        simulation.step()
    return simulation


def test_same_inputs_fed_by_hand_give_the_same_state_bit_for_bit():
    with Loop(stale_time=np.inf) as loop:
        loop.post_pose(above(0.002))
        loop.wait(3)
        loop.post_contacts(all_nodes())
        softer = copy_of(loop.simulation.settings)
        softer.stiffness_scale = 0.8
        for step in range(100):
            loop.post_pose(above(0.002 - 1e-4 * step, x=2e-5 * step))
            if step == 30:
                loop.post_settings(softer)
            if step == 50:
                loop.post_force([0.0, 0.2, 0.0])
            if step == 60:
                loop.control.resets += 1
            if step == 65:
                loop.post_contacts(all_nodes(releases=1))
            loop.wait(1)
        words = loop.snapshot()
        wrench = loop.results().wrench
    assert len(loop.journal()[0]) > 50
    simulation = by_hand(loop, int(results_in(words[: len(loop.simulation.state.results)], 1).status.tick))
    moved = np.abs(simulation.positions - simulation.model.rest).max()
    assert moved > 1e-3
    assert simulation.state.count.faults == 0
    assert np.linalg.norm(wrench) > 0.0
    snapshot = make_simulation()
    snapshot.state.words[:] = words
    assert_same(simulation, snapshot)


def test_the_journal_tells_what_a_snapshot_had_taken_up():
    with Loop(stale_time=np.inf) as loop:
        loop.post_pose(above(0.002))
        loop.post_pose(above(0.002))
        loop.wait(3)
        before = len(loop.journal()[0])
        loop.snapshot()
        loop.wait(3)
        rows, bodies = loop.journal()
        asked = loop.control.snapshot_done
    assert asked == 1
    assert len(rows) == before + 1
    assert rows[-1].tick >= rows[-2].tick
    assert [rows[-1][name] for name in ("contact_set", "settings", "resets")] == [
        rows[-2][name] for name in ("contact_set", "settings", "resets")
    ]
    assert (bodies[-1].pose, bodies[-1].force) == (2, 0)


def test_results_are_those_of_the_newest_tick():
    with Loop(stale_time=np.inf) as loop:
        loop.post_pose(above(0.001))
        loop.wait(2)
        loop.post_contacts(all_nodes())
        for step in range(60):
            loop.post_pose(above(0.001 - 1e-4 * step))
            loop.wait(1)
        assert loop.box.shape.sequence[0] > 10
    state, found = loop.simulation.state, loop.results()
    np.testing.assert_array_equal(found.wrench, state.wrench)
    for name in ("status", "count", "bodies"):
        assert getattr(found, name).tobytes() == getattr(state, name).tobytes(), name
    tick, positions = loop.shape()
    np.testing.assert_array_equal(positions, state.position)
    assert tick == state.status.tick
    assert np.linalg.norm(state.wrench) > 0.0


def test_reset_while_asleep_hands_out_the_surface_again():
    with Loop() as loop:
        loop.wait(5)
        loop.control.resets += 1
        loop.wait(5)
        assert loop.box.shape.sequence[0] == 2
        rows, _ = loop.journal()
    assert len(rows) == 1
    assert rows[0].resets == 1


def test_only_the_newest_of_several_poses_is_taken():
    """Ten poses between two ticks: the last one counts, and none is half of two."""
    with Loop() as loop:
        loop.wait(5)
        for height in np.linspace(0.01, 0.1, 500):
            loop.post_pose(above(height))
        loop.wait(3)
    taken = loop.journal()[1].pose.tolist()
    assert taken == sorted(set(taken))
    assert taken[-1] == 500
    np.testing.assert_array_equal(loop.simulation.state.body_goal[0], loop.poses[500][0])


def test_pose_ends_a_nap():
    """An idle loop sleeps over several ticks; a pose with the bell is taken, those before are done as if run."""
    libc = ctypes.CDLL(None)
    with Loop() as loop:
        bell = ctypes.c_void_p(loop.words.bell.ctypes.data)
        for turn in range(12):
            loop.wait(80)  # until the last pose is stale
            wait_for(lambda: loop.control.napping, "an idle loop naps")
            loop.post_pose(above(0.05 + 0.001 * turn))
            libc.sem_post(bell)
            wait_for(lambda wanted=turn + 1: loop.box.inputs[0].pose == wanted)
    assert all(np.diff(loop.journal()[0].tick) >= 70)
    simulation = by_hand(loop, loop.ticks())
    assert_same(simulation, loop.simulation)


def test_a_pose_brings_the_next_tick_forward_by_a_period_at_most():
    libc, ahead = ctypes.CDLL(None), []
    slow = copy_of(make_simulation().settings)
    slow.tick_time = 0.05
    with Loop(stale_time=np.inf) as loop:
        loop.post_settings(slow)
        loop.wait(3)
        bell = ctypes.c_void_p(loop.words.bell.ctypes.data)

        def is_ahead():
            loop.post_pose(above(0.05))
            loop.control.asked += 1
            libc.sem_post(bell)
            time.sleep(0.005)
            ahead.append(1e-9 * (int(loop.control.due) - time.monotonic_ns()))
            return ahead[-1] > 0.0

        wait_for(is_ahead, "a tick that a pose brought forward")
        began, before = time.monotonic(), loop.ticks()
        for _ in range(100):
            is_ahead()
        done, elapsed = loop.ticks() - before, time.monotonic() - began
    assert max(ahead) <= 0.05
    assert done <= elapsed / 0.05 + 2.0, "their number is that of the clock"


class PostedLoop(Loop):
    """Whose ticks follow posted times."""

    def __enter__(self):
        self.control.sim_time = True
        self.thread.start()
        wait_for(lambda: self.control.started == 1)
        return self

    def post(self, seconds):
        self.control.posted_time = round(1e9 * seconds)

    def comes_to(self, ticks):
        """Whether it does so many ticks in all, and no more in the next moments."""
        wait_for(lambda: self.ticks() >= ticks)
        time.sleep(0.1)
        return self.ticks() == ticks


def test_ticks_follow_posted_times():
    """None without a time, as many as it moves, none while it stands; a jump back is taken up, a long one dropped."""
    with PostedLoop() as loop:
        control = loop.control
        assert loop.comes_to(0)
        assert control.standing == 1
        assert loop.box.shape.sequence[0] == 1, "the rest shape is there all the same"
        loop.post(5.0)
        assert loop.comes_to(0), "the first time is where it begins"
        wait_for(lambda: loop.words.phase.seen == 5_000_000_000)
        loop.post(5.1)
        assert loop.comes_to(100)
        assert control.due == 5_100_000_000
        wait_for(lambda: control.standing == 1)
        assert loop.ticks() == 100
        assert len(loop.snapshot()), "a clock that stands keeps nobody waiting"
        loop.post(2.0)
        assert loop.comes_to(100)
        wait_for(lambda: loop.words.phase.seen == 2_000_000_000)
        loop.post(2.05)
        assert loop.comes_to(150)
        assert control.dropped == 0
        loop.post(9.05)
        assert loop.comes_to(151)
        assert control.dropped == pytest.approx(7000, abs=1)
        newest = itertools.count(1)

        def goes_on():
            loop.post(9.05 + 1e-3 * next(newest))
            return not control.standing

        wait_for(goes_on)
        control.sim_time = False
        before = loop.ticks()
        wait_for(lambda: loop.ticks() > before + 100, "the wall's clock takes over")


def test_tick_time_is_a_setting_that_may_change():
    with PostedLoop() as loop:
        loop.post(1.0)
        wait_for(lambda: loop.words.phase.seen == 1_000_000_000)
        loop.post(1.1)
        assert loop.comes_to(100)
        slower = copy_of(loop.simulation.settings)
        slower.tick_time = 0.01
        loop.post_settings(slower)
        loop.post(1.101)
        assert loop.comes_to(101), "which takes the setting up"
        simulated = int(loop.control.simulated)
        loop.post(2.101)
        assert loop.comes_to(201)
        assert int(loop.control.simulated) - simulated == 1_000_000_000


def test_now_is_the_monotonic_clock():
    timespec = np.zeros(2, dtype=np.int64)
    before = time.monotonic_ns()
    middle = rt.now(timespec)
    assert before <= middle <= time.monotonic_ns()


def test_sleep_ends_after_the_deadline():
    timespec = np.zeros(2, dtype=np.int64)
    deadline = time.monotonic_ns() + 20_000_000
    rt.sleep_until(deadline, timespec)
    assert time.monotonic_ns() >= deadline
    rt.sleep_until(deadline - 1_000_000_000, timespec)  # in the past: no sleep


@pytest.mark.parametrize("phase", [0.02, 0.3, 0.5, 0.9])
def test_ticks_are_shifted_until_requests_come_midway_between_two(phase):
    requests, period, due = mb.RequestPhase.new(), 1_000_000, 0
    for tick in range(300):
        start = tick * period + int(phase * period)
        due = rt.suited_due(due, start, period, requests)
        assert abs(requests.shift) <= period // 2
        assert due == tick * period + requests.shift, "as many ticks as periods of the clock"
        due += period
    assert abs(start - (due - period) - period // 2) < period // 50


def test_requests_beyond_half_a_period_shift_nothing():
    phase = mb.RequestPhase.new()
    phase.shift = 499_999
    assert rt.suited_due(0, 999_999, 1_000_000, phase) == 0
    assert phase.shift == 499_999


def test_after_a_few_requests_in_a_row_that_had_to_wait_one_waits_for_the_next():
    words, period = mb.make_loop_words(), 20_000_000
    loop = handle(words)
    for waits in (*range(1, rt.MAX_WAITS + 1), 0):
        due = time.monotonic_ns() + period
        words.control.asked += 1  # before it is due
        returned = rt.wait_for_tick(due, period, int(words.control.asked) - 1, loop)
        assert returned >= due + (period if waits == 0 else 0)
        assert words.phase.waits == waits
