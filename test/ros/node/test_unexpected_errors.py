"""Errors that nobody thought of, in a real node: it goes on, or ends with its wrenches zeroed; and says where."""

import re
from functools import partial

import numpy as np
import pytest
from std_srvs.srv import Trigger

from helpers.ros.processes import press_until_contact, start_sabotaged

OUTSIDE = (0.3, 0.0, 0.0)  # m


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    process = start_sabotaged(tmp_path_factory.mktemp("sabotaged"))
    yield process
    assert process.stop() == 0, process.text()
    assert "Traceback" not in process.text()


def sabotage(client, kind):
    return client.call(Trigger, f"/tissue_sim/{kind}", Trigger.Request())


def moved(client, position):
    """Send a pose, and hear for a moment."""
    client.send_pose(position)
    client.spin(0.005)


def lines(process, place):
    """What it logged about a place in the package."""
    return [line for line in process.text().splitlines() if f"(tissue_sim/{place}:" in line]


def test_callback_that_fails_is_reported_once_and_counted_and_the_node_goes_on(node, client):
    assert sabotage(client, "break_poses").success

    def is_counted():
        moved(client, OUTSIDE)
        return int(client.diagnostics.get("callback_failures", 0)) > 10

    assert client.spin_until(is_counted), client.diagnostics
    (line,) = lines(node, "ros/node/input/tool_input.py")
    assert re.search(r"callback failed: ZeroDivisionError: sabotaged, in two lines \(tissue_sim/\S+:\d+\)$", line)
    (key,) = (
        key
        for key in client.diagnostics
        if key.startswith("callback_failures.tissue_sim/ros/node/input/tool_input.py:")
    )
    assert int(client.diagnostics[key]) > 10
    assert any("callback_failures" in message for message in client.status_messages), "it is a warning"
    assert sabotage(client, "mend").success
    client.ask(OUTSIDE)
    assert client.spin_until(lambda: bool(client.wrenches) or client.send_pose(OUTSIDE))


def test_a_hand_goes_on_feeling_tissue_where_answers_fail(node, client):
    """The outlet goes on publishing what nobody has published for a while."""

    def goes_on():
        """From outside again where a busy machine held the poses up until they were stale."""
        assert sabotage(client, "mend").success
        where = press_until_contact(client, partial(moved, client))
        failures = int(client.report().get("answers_failures", 0))
        assert sabotage(client, "break_answers").success
        assert client.spin_until(
            lambda: int(client.diagnostics.get("answers_failures", 0)) > failures + 10 or client.send_pose(where)
        )
        client.wrenches.clear()
        client.spin_until(lambda: len(client.wrenches) > 20 or client.send_pose(where), 5.0)
        return len(client.wrenches) > 20 and client.hand_force() > 0.01  # N

    assert client.spin_until(goes_on), client.diagnostics
    assert sabotage(client, "mend").success
    client.ask(OUTSIDE)


def test_who_calls_a_service_that_fails_is_reported(node, client):
    answer = sabotage(client, "fail")
    assert not answer.success
    assert "ZeroDivisionError: sabotaged, in two lines" in answer.message
    assert client.reset().success


def test_who_sets_a_parameter_is_reported(node, client):
    assert sabotage(client, "break_parameters").success
    answer = client.set_parameter("marker_rate", 30.0)
    assert not answer.successful
    assert "ZeroDivisionError" in answer.reason
    assert client.reset().success


def test_thread_that_fails_is_reported(node, client):
    before = int(client.report()["callback_failures"])
    assert sabotage(client, "fail_in_thread").success
    assert client.spin_until(lambda: int(client.diagnostics["callback_failures"]) > before)


def test_no_force_stands_while_the_loop_hangs(node, client):
    where = press_until_contact(client, partial(moved, client))
    assert sabotage(client, "hang").success
    assert client.spin_until(lambda: client.hand_force() == 0.0 or client.send_pose(where))
    before = len(client.wrenches)
    assert client.spin_until(lambda: len(client.wrenches) > before + 50 or client.send_pose(where))
    assert not any(np.any(wrench) for _, wrench in client.wrenches[before:])
    assert client.spin_until(lambda: "loop hangs" in client.message)
    assert sabotage(client, "resume").success
    client.ask(OUTSIDE)
    press_until_contact(client, partial(moved, client))
    assert client.spin_until(lambda: "loop hangs" not in client.message)
