"""A viewer behind a link that loses 5 % of the packets and takes 50 ms."""

import signal

import pytest

from helpers.ros.processes import PUBLISHER, READY, WATCHER, shipped
from helpers.ros.two_machines import two_machines

LOSS, DELAY, WANTED = 0.05, 0.05, 100  # fraction, s, surfaces that differ


@pytest.mark.extended
def test_a_viewer_behind_a_lossy_link_sees_the_organ_move(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    with two_machines(tmp_path, LOSS, DELAY) as (here, there, start):
        # Few ticks: a link is tried here, not the machine.
        node = start(here, "node", "-m", "tissue_sim.ros.node.program", "--ros-args", "-p", "rate:=100.0")
        node.wait_for(READY)
        publisher = start(here, "publisher", PUBLISHER, "--depth=0.004", "--stroke=0.012")
        publisher.wait_for("pressed")
        watcher = start(there, "watcher", WATCHER, str(WANTED))
        assert watcher.wait() == 0, watcher.text()
        assert f"mesh {shipped().n_surface} points" in watcher.text()
        assert f"{WANTED} surfaces" in watcher.text()
        assert publisher.stop(signal.SIGTERM) == 0, publisher.text()
        assert node.stop() == 0, node.text()
