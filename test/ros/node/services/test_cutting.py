"""A node cuts its organ while a tool presses: over ROS, in its bag, and until a reset."""

import numpy as np
import pytest
from std_srvs.srv import SetBool, Trigger

from helpers.ros.processes import UNHURRIED, cut_process, press_until_contact, running_node, shipped, stopped
from helpers.ros.replaying import repeated
from helpers.ros.surgeon import DEPTH, EDGE, Surgeon
from tissue_sim.model.simulation import Simulation
from tissue_sim.ros.shared.client import mesh_arrays


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("cutting")


@pytest.fixture(scope="module")
def node(folder):
    with running_node(folder, "tools:=[left]", UNHURRIED, f"record_folder:={folder / 'bags'}") as process:
        yield process


@pytest.fixture(scope="module")
def only_client(node):
    client = Surgeon()
    assert client.spin_until(lambda: client.pose.get_subscription_count() > 0 and client.surface().size > 0)
    yield client
    client.close()


@pytest.fixture
def client(only_client):
    yield only_client
    only_client.call(SetBool, f"{only_client.target}/pause", SetBool.Request(data=False))
    only_client.reset()
    assert only_client.spin_until(lambda: not only_client.events or not only_client.events[-1].status)


def test_a_cut_opens_what_is_shown_repeats_in_its_bag_and_a_reset_heals_it(client, capsys):
    uncut = shipped()
    bag = client.record(True).message
    inside = press_until_contact(client, client.ask)
    answer = client.cut(hand=inside)
    assert answer.success, answer.message
    assert "cells divided" in answer.message
    assert client.hand_force() > 0.02, "the hand goes on"

    expected = Simulation(uncut).prepared_cut(EDGE, [0.0, 1.0, 0.0], DEPTH)
    surface = expected.cut_organ.surface
    assert client.spin_until(lambda: len(client.meshes[-1].triangles) == len(surface.triangles))
    vertices, triangles = mesh_arrays(client.meshes[-1])
    np.testing.assert_allclose(vertices, surface.at(expected.organ.rest_positions), atol=1e-9)
    np.testing.assert_array_equal(triangles, surface.triangles)
    assert client.spin_until(lambda: client.versions[-1].data == 1)
    assert client.spin_until(lambda: client.clouds[-1].width == len(surface.nodes))
    assert client.spin_until(lambda: len(client.surface()) == 3 * len(surface.triangles))

    (status,) = client.events[-1].status
    values = {item.key: float(item.value) for item in status.values}
    report = expected.cuts[0]
    assert values["area_m2"] == pytest.approx(report.area, rel=1e-4)
    assert values["depth_m"] == pytest.approx(report.depth, rel=1e-4)
    assert (values["x_m"], values["y_m"], values["z_m"]) == pytest.approx(report.centre, abs=1e-6)

    client.contacts.clear()
    press_until_contact(client, client.ask)
    assert client.spin_until(lambda: any(cloud.width > 0 for cloud in client.contacts)), "of a state with more nodes"
    assert client.reset().success
    assert client.spin_until(lambda: client.versions[-1].data == 2)
    assert client.spin_until(lambda: len(client.surface()) == 3 * len(uncut.surface_triangles))
    assert not client.events[-1].status
    client.spin(0.2)
    assert client.record(False).success
    repeated(bag, capsys)


def test_a_bag_that_begins_after_a_cut_repeats(client, capsys):
    assert client.cut().success
    bag = client.record(True).message
    press_until_contact(client, client.ask)
    deeper = client.cut(depth=DEPTH + 0.003)
    assert deeper.success, deeper.message
    client.spin(0.3)
    assert client.record(False).success
    repeated(bag, capsys)


def test_a_paused_node_is_cut_at_once(client):
    assert client.call(SetBool, f"{client.target}/pause", SetBool.Request(data=True)).success
    before = client.report()["tick"]
    answer = client.cut()
    assert answer.success, answer.message
    assert client.report()["tick"] == before
    assert client.spin_until(lambda: len(client.surface()) > 3 * len(shipped().surface_triangles))
    assert client.report()["cuts"] == "1"


def test_a_call_that_is_repeated_gets_the_answer_of_the_first(client, node):
    assert client.set_parameter("cut_depth", DEPTH).successful
    client.send_path(EDGE)
    service = client.node.create_client(Trigger, f"{client.below}/cut")
    assert service.wait_for_service(30.0)
    before = int(client.report()["cuts_made"])
    with stopped(cut_process(node)):
        asked = [service.call_async(Trigger.Request()) for _ in range(3)]
        for _ in range(2):  # by the second report the node has handled what came before the first
            client.report()
    assert client.spin_until(lambda: all(one.done() for one in asked))
    first, *others = [one.result() for one in asked]
    assert first.success, first.message
    assert all(other == first for other in others)
    assert int(client.report()["cuts_made"]) == before + 1


def test_another_cut_meanwhile_is_refused_and_told_where_the_first_one_appears(client, node):
    client.send_path(EDGE)
    service = client.node.create_client(Trigger, f"{client.below}/cut")
    assert service.wait_for_service(30.0)
    with stopped(cut_process(node)):
        asked = service.call_async(Trigger.Request())
        assert client.set_parameter("cut_depth", DEPTH + 0.003).successful
        other = service.call_async(Trigger.Request())
        assert client.spin_until(other.done)
        assert not asked.done()
    assert client.spin_until(asked.done)
    assert asked.result().success, asked.result().message
    assert not other.result().success
    assert other.result().message.endswith("is being made, and appears on /tissue_sim/cuts; then call again")


def test_what_cannot_be_cut_is_refused_with_the_reason(client, node):
    def refused(needle, *arguments, **named):
        client.send_path(*arguments, **named)
        assert client.spin_until(lambda: needle in client.ask_to_cut().message), client.ask_to_cut().message
        assert not client.ask_to_cut().success

    refused("expected: the two or more points", [EDGE[0]])
    refused("no transform", EDGE, frame="elsewhere")
    refused("no frame_id", EDGE, frame="")
    refused("length 1", EDGE, quaternion=(0.0, 0.0, 0.0, 0.5))
    refused("misses", [[1.0, 0.0, 0.0], [1.1, 0.0, 0.0]])
    assert "was refused: its frame 'elsewhere'" in node.text()
    assert client.report()["cuts"] == "0"
