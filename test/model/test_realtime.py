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
from tissue_sim.jit import handle
from tissue_sim.model import mailboxes as mb
from tissue_sim.model import realtime as rt
from tissue_sim.model import state as st
from tissue_sim.model.inputs import take_contacts, take_force, take_pose
from tissue_sim.model.simulation import Simulation, sphere_tools
from tissue_sim.model.world import World

RATE = 1000.0
RADIUS = 0.006  # m, of the tool


def make_simulation():
    return Simulation(ball(2), rate=RATE, shapes=sphere_tools(RADIUS))


class Loop:
    """The loop on a simulation of its own, as the node drives it. Keeps what it posts, by sequence number.

    A pose gets stale after stale_time s of ticks; never where it is pressed for as long as this thread takes.
    """

    def __init__(self, stale_time=0.05):
        self.simulation = make_simulation()
        self.simulation.settings[st.STALE_TIME] = self.stale_time = stale_time
        self.box = mb.make_mailboxes(self.simulation.buffer)
        self.poses, self.forces, self.contacts, self.settings = {}, {}, {}, {}
        self.thread = threading.Thread(target=self._run, daemon=True)

    def _run(self):
        one = self.simulation
        world = World(one.model, one.state, one.shapes, one.settings.copy(), one.scratch)
        rt.run_loop(handle(world), handle(self.box), one.buffer.floats, one.buffer.integers)

    def __enter__(self):
        self.thread.start()
        wait_for(lambda: self.box.control[mb.LOOP_TICKS] > 0)
        return self

    def __exit__(self, *_):
        self.box.control[mb.STOP] = 1
        self.thread.join(timeout=LIMIT)
        assert not self.thread.is_alive()

    def ticks(self):
        return int(self.box.control[mb.LOOP_TICKS])

    def wait(self, ticks):
        """Until the loop has done some more ticks."""
        end = self.ticks() + ticks
        wait_for(lambda: self.ticks() >= end)

    def post_pose(self, pose):
        sequence = int(self.box.pose_sequence[0]) + 1
        self.poses[sequence] = np.array(pose)
        self.box.pose[sequence % mb.IN_SLOTS, 0] = pose
        self.box.pose_sequence[0] = sequence

    def post_force(self, force):
        sequence = int(self.box.force_sequence[0]) + 1
        self.forces[sequence] = np.array(force)
        self.box.force[sequence % mb.IN_SLOTS, 0] = force
        self.box.force_sequence[0] = sequence

    def post_contacts(self, tool, node, weight, normal, tip_node, tip_weight, engaged):
        box, sequence = self.box, int(self.box.contact_sequence[0]) + 1
        slot, entries = sequence % mb.IN_SLOTS, len(tool)
        self.contacts[sequence] = (entries, tool, node, weight, normal, tip_node, tip_weight, engaged)
        box.contact_entries[slot] = entries
        box.contact_tool[slot, :entries] = tool
        box.contact_node[slot, :entries] = node
        box.contact_weight[slot, :entries] = weight
        box.contact_normal[slot, :entries] = normal
        box.tip_node[slot], box.tip_weight[slot], box.engaged[slot] = tip_node, tip_weight, engaged
        box.contact_sequence[0] = sequence

    def post_settings(self, settings):
        sequence = int(self.box.settings_sequence[0]) + 1
        self.settings[sequence] = np.array(settings)
        self.box.settings[sequence % mb.IN_SLOTS] = settings
        self.box.settings_sequence[0] = sequence

    def snapshot(self):
        self.box.control[mb.SNAPSHOT_ASKED] += 1
        wait_for(lambda: self.box.control[mb.SNAPSHOT_DONE] == self.box.control[mb.SNAPSHOT_ASKED])
        return self.box.snapshot_floats.copy(), self.box.snapshot_integers.copy()

    def journal(self):
        return self.box.journal[: int(self.box.journal_written[0])].copy()


def above(height, x=0.0):
    """A pose over the ball's top, m above it."""
    return np.array([x, 0.0, 0.03 + RADIUS + height, 0.0, 0.0, 0.0, 1.0])


def all_nodes():
    """A contact set of every surface node, with the point under the tip in the topmost triangle."""
    organ = ball(2)
    nodes = np.repeat(np.arange(organ.n_surface)[:, None], 3, axis=1)
    weights = np.tile([1.0, 0.0, 0.0], (len(nodes), 1))
    middles = organ.surface_positions[organ.surface_triangles].mean(axis=1)
    top = organ.surface_triangles[np.argmax(middles[:, 2])].astype(np.int64)
    normals = organ.surface_positions / np.linalg.norm(organ.surface_positions, axis=1, keepdims=True)
    tools = np.zeros(len(nodes), dtype=np.int64)
    return tools, nodes, weights, normals, top[None], np.full((1, 3), 1.0 / 3.0), np.array([1])


def test_loop_accounts_for_every_tick():
    with Loop() as loop:
        loop.wait(500)
    control = loop.box.control
    ticks, dropped = loop.ticks(), int(control[mb.DROPPED])
    assert loop.simulation.state.count[st.TICK] == ticks
    assert control[mb.SIMULATED] == round(1e9 * ticks / RATE)
    assert control[mb.DUE] <= time.monotonic_ns()
    timing = loop.box.timing[:ticks]
    assert np.all(timing[:, 1] > 0)
    if ticks <= mb.TIMING_ROWS:
        # Late by more than may be made up for: then ticks are given up.
        assert (dropped > 0) == (timing[:, 0].max() > rt.LATEST_CATCH_UP)


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
        assert loop.box.surface_sequence[0] == 1
        np.testing.assert_array_equal(loop.box.surface[1 % mb.OUT_SLOTS], ball(2).rest_positions)
        newest = int(loop.box.out_sequence[0]) % mb.OUT_SLOTS
        assert loop.box.out_count[newest, st.TICK] >= 16, "a nap is a few ticks long"
        assert len(loop.journal()) == 0


def test_journal_tells_which_tick_took_a_pose():
    with Loop() as loop:
        loop.wait(10)
        before = loop.ticks()
        loop.post_pose(above(0.05))
        loop.wait(10)
        rows, after = loop.journal(), loop.ticks()
    assert len(rows) == 1
    assert rows[0, mb.ROW_TOOLS] == 1
    assert rows[0, mb.ROW_TOOLS + 1] == rows[0, mb.ROW_CONTACTS] == rows[0, mb.ROW_SETTINGS] == 0
    assert before < rows[0, mb.ROW_TICK] <= after
    assert loop.simulation.state.tool_count[0, st.POSE_SEQUENCE] == 1
    np.testing.assert_array_equal(loop.simulation.state.tool_goal[0], above(0.05))


def by_hand(loop, ticks):
    """The journal's inputs fed to a simulation of its own, tick by tick."""
    simulation = make_simulation()
    simulation.settings[st.STALE_TIME] = loop.stale_time
    rows = {int(row[mb.ROW_TICK]): row for row in loop.journal()}
    last = np.zeros(mb.ROW_TOOLS + 2, dtype=np.int64)
    for tick in range(1, ticks + 1):
        row = rows.get(tick, last)
        if row[mb.ROW_RESETS] != last[mb.ROW_RESETS]:
            simulation.reset()
        if row[mb.ROW_SETTINGS] != last[mb.ROW_SETTINGS]:
            simulation.settings[:] = loop.settings[row[mb.ROW_SETTINGS]]
        if row[mb.ROW_TOOLS] != last[mb.ROW_TOOLS]:
            take_pose(simulation.state, 0, loop.poses[row[mb.ROW_TOOLS]], row[mb.ROW_TOOLS])
        if row[mb.ROW_TOOLS + 1] != last[mb.ROW_TOOLS + 1]:
            take_force(simulation.state, 0, loop.forces[row[mb.ROW_TOOLS + 1]], row[mb.ROW_TOOLS + 1])
        if row[mb.ROW_CONTACTS] != last[mb.ROW_CONTACTS]:
            take_contacts(simulation.state, *loop.contacts[row[mb.ROW_CONTACTS]], row[mb.ROW_CONTACTS])
        last = row
        simulation.step()
    return simulation


def test_same_inputs_fed_by_hand_give_the_same_state_bit_for_bit():
    with Loop(stale_time=np.inf) as loop:
        loop.post_pose(above(0.002))
        loop.wait(3)
        loop.post_contacts(*all_nodes())
        softer = loop.simulation.settings.copy()
        softer[st.STIFFNESS_SCALE] = 0.8
        for step in range(100):
            loop.post_pose(above(0.002 - 1e-4 * step, x=2e-5 * step))
            if step == 30:
                loop.post_settings(softer)
            if step == 50:
                loop.post_force([0.0, 0.2, 0.0])
            if step == 60:
                loop.box.control[mb.RESETS] += 1
            if step == 65:
                loop.post_contacts(*all_nodes())
            loop.wait(1)
        floats, integers = loop.snapshot()
        newest = int(loop.box.out_sequence[0])
        wrench = loop.box.out_wrench[newest % mb.OUT_SLOTS].copy()
    assert len(loop.journal()) > 50
    simulation = by_hand(loop, loop.simulation.buffer.tick_of(integers))
    moved = np.abs(simulation.positions - simulation.model.rest).max()
    assert moved > 1e-3
    assert simulation.state.count[st.FAULTS] == 0
    assert np.linalg.norm(wrench) > 0.0
    np.testing.assert_array_equal(simulation.buffer.floats, floats)
    np.testing.assert_array_equal(simulation.buffer.integers, integers)


def test_results_are_those_of_the_newest_tick():
    with Loop(stale_time=np.inf) as loop:
        loop.post_pose(above(0.001))
        loop.wait(2)
        loop.post_contacts(*all_nodes())
        for step in range(60):
            loop.post_pose(above(0.001 - 1e-4 * step))
            loop.wait(1)
        assert loop.box.surface_sequence[0] > 10
    box, state = loop.box, loop.simulation.state
    newest = int(box.out_sequence[0]) % mb.OUT_SLOTS
    np.testing.assert_array_equal(box.out_wrench[newest], state.wrench)
    np.testing.assert_array_equal(box.out_count[newest], state.count)
    np.testing.assert_array_equal(box.out_tool_count[newest], state.tool_count)
    surface = int(box.surface_sequence[0]) % mb.OUT_SLOTS
    np.testing.assert_array_equal(box.surface[surface], state.position)
    assert box.surface_tick[surface] == state.count[st.TICK] == box.control[mb.AWAKE_TICK]
    assert np.linalg.norm(state.wrench) > 0.0


def test_reset_while_asleep_hands_out_the_surface_again():
    with Loop() as loop:
        loop.wait(5)
        loop.box.control[mb.RESETS] += 1
        loop.wait(5)
        assert loop.box.surface_sequence[0] == 2
        rows = loop.journal()
    assert len(rows) == 1
    assert rows[0, mb.ROW_RESETS] == 1


def test_only_the_newest_of_several_poses_is_taken():
    """Ten poses between two ticks: the last one counts, and none is half of two."""
    with Loop() as loop:
        loop.wait(5)
        for height in np.linspace(0.01, 0.1, 500):
            loop.post_pose(above(height))
        loop.wait(3)
    taken = [int(row[mb.ROW_TOOLS]) for row in loop.journal()]
    assert taken == sorted(set(taken))
    assert taken[-1] == 500
    np.testing.assert_array_equal(loop.simulation.state.tool_goal[0], loop.poses[500])


def test_pose_ends_a_nap():
    """An idle loop sleeps over several ticks; a pose with the bell is taken, those before are done as if run."""
    libc = ctypes.CDLL(None)
    with Loop() as loop:
        bell = ctypes.c_void_p(loop.box.bell.ctypes.data)
        for turn in range(12):
            loop.wait(80)  # until the last pose is stale
            wait_for(lambda: loop.box.control[mb.NAPPING], "an idle loop naps")
            loop.post_pose(above(0.05 + 0.001 * turn))
            libc.sem_post(bell)
            wait_for(lambda wanted=turn + 1: loop.box.row[mb.ROW_TOOLS] == wanted)
    assert all(np.diff([int(row[mb.ROW_TICK]) for row in loop.journal()]) >= 70)
    simulation = by_hand(loop, loop.ticks())
    np.testing.assert_array_equal(simulation.buffer.integers, loop.simulation.buffer.integers)
    np.testing.assert_array_equal(simulation.buffer.floats, loop.simulation.buffer.floats)


class PostedLoop(Loop):
    """Whose ticks follow posted times."""

    def __enter__(self):
        self.box.control[mb.SIM_TIME] = 1
        self.thread.start()
        wait_for(lambda: self.box.control[mb.STARTED] == 1)
        return self

    def post(self, seconds):
        self.box.control[mb.POSTED_TIME] = round(1e9 * seconds)

    def comes_to(self, ticks):
        """Whether it does so many ticks in all, and no more in the next moments."""
        wait_for(lambda: self.ticks() >= ticks)
        time.sleep(0.1)
        return self.ticks() == ticks


def test_ticks_follow_posted_times():
    """None without a time, as many as it moves, none while it stands; a jump back is taken up, a long one dropped."""
    with PostedLoop() as loop:
        control = loop.box.control
        assert loop.comes_to(0)
        assert control[mb.STANDING] == 1
        assert loop.box.surface_sequence[0] == 1, "the rest shape is there all the same"
        loop.post(5.0)
        assert loop.comes_to(0), "the first time is where it begins"
        wait_for(lambda: loop.box.clock[rt.SEEN] == 5_000_000_000)
        loop.post(5.1)
        assert loop.comes_to(100)
        assert control[mb.DUE] == 5_100_000_000
        wait_for(lambda: control[mb.STANDING] == 1)
        assert loop.ticks() == 100
        floats, _ = loop.snapshot()
        assert len(floats), "a clock that stands keeps nobody waiting"
        loop.post(2.0)
        assert loop.comes_to(100)
        wait_for(lambda: loop.box.clock[rt.SEEN] == 2_000_000_000)
        loop.post(2.05)
        assert loop.comes_to(150)
        assert control[mb.DROPPED] == 0
        loop.post(9.05)
        assert loop.comes_to(151)
        assert control[mb.DROPPED] == pytest.approx(7000, abs=1)
        newest = itertools.count(1)

        def goes_on():
            loop.post(9.05 + 1e-3 * next(newest))
            return control[mb.STANDING] == 0

        wait_for(goes_on)
        control[mb.SIM_TIME] = 0
        before = loop.ticks()
        wait_for(lambda: loop.ticks() > before + 100, "the wall's clock takes over")


def test_tick_time_is_a_setting_that_may_change():
    with PostedLoop() as loop:
        loop.post(1.0)
        wait_for(lambda: loop.box.clock[rt.SEEN] == 1_000_000_000)
        loop.post(1.1)
        assert loop.comes_to(100)
        slower = loop.simulation.settings.copy()
        slower[st.TICK_TIME] = 0.01
        loop.post_settings(slower)
        loop.post(1.101)
        assert loop.comes_to(101), "which takes the setting up"
        simulated = int(loop.box.control[mb.SIMULATED])
        loop.post(2.101)
        assert loop.comes_to(201)
        assert int(loop.box.control[mb.SIMULATED]) - simulated == 1_000_000_000


def test_now_is_the_monotonic_clock():
    clock = np.zeros(4, dtype=np.int64)
    before = time.monotonic_ns()
    middle = rt.now(clock)
    assert before <= middle <= time.monotonic_ns()


def test_sleep_ends_after_the_deadline():
    clock = np.zeros(4, dtype=np.int64)
    deadline = time.monotonic_ns() + 20_000_000
    rt.sleep_until(deadline, clock)
    assert time.monotonic_ns() >= deadline
    rt.sleep_until(deadline - 1_000_000_000, clock)  # in the past: no sleep
