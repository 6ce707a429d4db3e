"""The node over an rclpy that has no EventsExecutor: a real process."""

import os

import pytest

from helpers.ros.clients import Client
from helpers.ros.processes import OLD_RCLPY, UNHURRIED, press_until_contact, running_node
from tissue_sim.ros.shared import executors


@pytest.mark.extended
@pytest.mark.parametrize("old", [True, False])
def test_the_organ_is_touched_with_an_old_rclpy_too_and_the_log_says_so(tmp_path, old):
    path = os.pathsep.join(filter(None, [OLD_RCLPY if old else "", os.environ.get("PYTHONPATH", "")]))
    with running_node(tmp_path, UNHURRIED, PYTHONPATH=path) as node:
        client = Client()
        try:
            press_until_contact(client, client.ask)
        finally:
            client.close()
        assert (executors.OLD_RCLPY in node.text()) == old
