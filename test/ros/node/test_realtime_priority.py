"""The loop's thread before all others, and those that take and answer poses after it, where the system allows it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.patience import wait_for
from helpers.ros.clients import Client
from helpers.ros.processes import running_node
from helpers.scenes import ball
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.shared.loop import Loop
from tissue_sim.ros.shared.physics import Physics
from tissue_sim.ros.shared.priority import below, is_allowed


def preferred(process: int) -> dict[int, int]:
    """Real-time priorities of those of a process's threads that have one."""
    threads = [int(entry.name) for entry in Path(f"/proc/{process}/task").iterdir()]
    priorities = {thread: os.sched_getparam(thread).sched_priority for thread in threads}
    return {thread: priority for thread, priority in priorities.items() if priority > 0}


def test_what_comes_after_a_priority():
    assert [below(priority) for priority in (0, 1, 2, 99)] == [0, 1, 1, 98], "none after none"


def test_asking_whether_it_is_allowed_changes_nothing():
    allowed = is_allowed(7)
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    ask = "import os\nos.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(7))"
    run = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=False)
    assert allowed == (run.returncode == 0), run.stderr
    assert not is_allowed(1000), "no priority at all"


def test_only_the_loop_goes_first():
    loop = Loop(Joined([Simulation(ball(2))]))
    physics = Physics(loop)
    loop.start()
    try:
        assert loop.priority == 0
        try:
            loop.prefer(7)
        except PermissionError:
            pytest.skip("this user is not allowed to use a real-time priority")
        assert loop.priority == 7
        assert os.sched_getscheduler(0) == os.SCHED_OTHER, "of this thread"
        before = physics.results().status.tick
        wait_for(lambda: physics.results().status.tick > before, "it doesn't tick")
    finally:
        loop.stop()
    assert loop.priority == 0


@pytest.mark.extended
def test_the_node_tells_its_priority_or_why_it_has_none(tmp_path):
    with running_node(tmp_path, "realtime_priority:=7") as node:
        client = Client(markers=False)
        assert client.spin_until(lambda: "realtime_priority" in client.diagnostics)
        refused = "realtime_priority 7 is refused" in node.text()
        assert client.diagnostics["realtime_priority"] == ("0" if refused else "7")
        wanted = [] if refused else [6, 6, 7]
        assert sorted(preferred(node.child.pid).values()) == wanted, "the loop, and what takes poses and answers them"
        assert refused or preferred(node.child.pid)[node.child.pid] == 6
        assert not refused or "rtprio" in node.text(), "and how to allow it"
        client.close()
