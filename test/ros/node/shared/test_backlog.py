"""An executor that is behind: how that is found, and that what waits stays short."""

import itertools
import threading
import time
from types import SimpleNamespace

import pytest
import rclpy
from rclpy.context import Context
from std_msgs.msg import Float64

from helpers.patience import wait_for
from tissue_sim.ros.node.shared import backlog as module
from tissue_sim.ros.node.shared.backlog import LONGEST, MOST_BEHIND, SHORTEST, Backlog, InputThrottle, executor_of
from tissue_sim.ros.shared.executors import EventsExecutor
from tissue_sim.ros.shared.qos import STREAM
from tissue_sim.ros.shared.report import Report


@pytest.fixture
def clock(monkeypatch):
    """Time that a test sets."""
    now = SimpleNamespace(s=100.0)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now.s))
    return now


def looked(backlog, clock, waited, posted):
    """Look; what it asks is answered after so many s; then it is time for the next look."""
    backlog.look()
    clock.s += waited
    posted.pop()()
    clock.s += 0.25 - waited


def test_pause_doubles_while_it_is_behind_and_goes_when_it_is_not(clock):
    posted = []
    backlog = Backlog(posted.append)
    looked(backlog, clock, 0.01, posted)
    looked(backlog, clock, 0.2, posted)
    assert backlog.pause == 0.0
    pauses = []
    for _ in range(10):
        looked(backlog, clock, 0.2, posted)
        pauses.append(backlog.pause)
    assert pauses[:3] == [SHORTEST, 2.0 * SHORTEST, 4.0 * SHORTEST]
    assert pauses[-1] == LONGEST
    assert backlog.behind == pytest.approx(0.2)
    for _ in range(40):
        looked(backlog, clock, 0.9 * MOST_BEHIND, posted)
    assert backlog.pause == 0.0
    assert backlog.longest == pytest.approx(0.2)


def test_what_is_not_answered_is_behind_and_not_asked_again(clock):
    posted = []
    backlog = Backlog(posted.append)
    for _ in range(5):
        backlog.look()
        clock.s += 0.25
    assert len(posted) == 1
    assert backlog.behind == pytest.approx(1.0)
    assert backlog.pause > 0.0
    backlog.report(report := Report())
    assert report.values["executor_behind_ms"] == pytest.approx(1000.0)
    assert "poses and forces arrive faster" in report.warnings[0]


def test_one_message_in_a_pause_passes_and_all_without_one(clock):
    backlog = Backlog(lambda task: task())
    gate = InputThrottle(backlog)
    assert all(gate.passes() for _ in range(5))
    backlog.pause = 0.004
    passed = 0
    for _ in range(1000):
        clock.s += 0.001
        passed += gate.passes()
    assert passed == pytest.approx(250, abs=60)
    assert gate.passed_over == 1000 - passed


def messages_before(guarded):
    """How many messages are met before what is posted while two streams come, each faster than it is handled."""
    context = Context()
    context.init()
    node, sender = (rclpy.create_node(name, context=context) for name in ("slow", "fast"))
    executor = EventsExecutor(context=context)
    executor.add_node(node)
    backlog, ended, met = Backlog(executor_of(node)), threading.Event(), itertools.count()

    def handle(gate):
        next(met)
        if not guarded or gate.passes():
            time.sleep(0.003)

    for name in ("left", "right"):
        gate = InputThrottle(backlog)
        node.create_subscription(Float64, name, lambda _, gate=gate: handle(gate), STREAM)
    publishers = [sender.create_publisher(Float64, name, STREAM) for name in ("left", "right")]

    def spin():
        while not ended.is_set():
            executor.spin_once(timeout_sec=0.1)

    def flood():
        while not ended.wait(0.001):
            for one in publishers:
                one.publish(Float64())

    threads = [threading.Thread(target=work) for work in (spin, flood)]
    threads[0].start()
    try:
        wait_for(lambda: all(one.get_subscription_count() for one in publishers))
        threads[1].start()
        for _ in range(20):
            time.sleep(0.1)
            backlog.look()
        done, before = threading.Event(), next(met)
        executor_of(node)(done.set)
        done.wait(20.0)
        return next(met) - before
    finally:
        ended.set()
        for thread in threads:  # before the executor ends, which waits with the interpreter's lock in its hand
            thread.join()
        executor.shutdown()
        node.destroy_node()
        sender.destroy_node()
        context.try_shutdown()


@pytest.mark.extended
@pytest.mark.skipif(EventsExecutor is None, reason="an old rclpy waits for messages, and keeps no events")
def test_streams_that_come_faster_than_they_are_handled_leave_room_for_others():
    assert messages_before(guarded=True) < 0.3 * messages_before(guarded=False)
