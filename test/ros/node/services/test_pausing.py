"""A node is paused and stepped: no force, no tick but those asked for, and a bag that repeats all of it."""

from types import SimpleNamespace

import numpy as np
import pytest
from std_srvs.srv import SetBool, Trigger

from helpers.ros.clients import Client
from helpers.ros.processes import UNHURRIED, press_until_contact, running_node
from helpers.ros.replaying import repeated
from tissue_sim.ros.node.services.pausing import Pausing

MOST_KICK = 1.5  # of the force that settles


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pausing")
    with running_node(folder, "tools:=[left]", UNHURRIED, f"record_folder:={folder / 'bags'}") as process:
        yield process


@pytest.fixture(scope="module")
def only_client(node):
    client = Client()
    assert client.spin_until(lambda: client.pose.get_subscription_count() > 0 and client.surface().size > 0)
    yield client
    client.close()


@pytest.fixture
def client(only_client):
    """The client; afterwards the node goes on."""
    yield only_client
    assert pause(only_client, False).success


def pause(client, on):
    return client.call(SetBool, f"{client.target}/pause", SetBool.Request(data=on))


def step(client, ticks):
    assert client.set_parameter("step_ticks", ticks).successful
    return client.call(Trigger, f"{client.target}/step", Trigger.Request())


def tick(client):
    return int(client.report()["tick"])


def test_a_pause_leaves_no_force_a_step_takes_its_ticks_and_a_bag_repeats_both(client, node, capsys):
    assert "not paused" in step(client, 1).message
    bag = client.record(True).message
    inside = press_until_contact(client, client.ask)
    assert pause(client, True).success
    assert pause(client, True).success, "it is already"
    client.wrenches.clear()
    for depth in np.linspace(0.0, 0.001, 20):  # poses that come meanwhile are answered, and the newest is kept
        client.ask(inside + depth * np.array([-1.0, 0.0, 0.0]))
    assert len(client.wrenches) > 5
    assert max(np.abs(wrench).max() for _, wrench in client.wrenches) == 0.0
    before = tick(client)
    assert client.diagnostics["paused"] == "True"
    assert client.diagnostics["left.state"] == "fresh"
    assert "paused: no ticks and no forces" in client.message
    assert "paused: no ticks and no forces" in node.text()
    assert tick(client) == before, "and a second later"
    assert "simulated time" not in client.message

    moved = client.moved()
    for ticks in (1, 40):
        answer = step(client, ticks)
        assert answer.success, answer.message
        assert answer.message == f"{ticks} of {ticks} ticks were taken"
    assert tick(client) == before + 41
    taken = 41

    def is_pressed():
        """The tool goes on to the newest pose in as much simulated time as its poses were apart, whatever that was."""
        nonlocal taken
        taken += 40
        assert step(client, 40).success
        client.spin(0.1)
        return client.moved() > moved + 3e-4

    assert client.spin_until(is_pressed), "the newest pose is taken up"
    assert tick(client) == before + taken
    assert max(np.abs(wrench).max() for _, wrench in client.wrenches) == 0.0
    assert "next tick" in client.reset().message
    assert step(client, 1).success
    assert client.spin_until(lambda: client.moved() < 3e-4)

    client.wrenches.clear()
    assert pause(client, False).success
    inside = press_until_contact(client, client.ask)
    assert tick(client) > before + taken + 1
    assert client.kick(lambda: client.ask(inside)) < MOST_KICK
    assert client.record(False).success
    repeated(bag, capsys)


def test_a_long_step_leaves_the_node_to_others_and_ends_when_it_goes_on(client):
    assert pause(client, True).success
    before = tick(client)
    assert client.set_parameter("step_ticks", 100_000).successful
    service = client.node.create_client(Trigger, f"{client.target}/step")
    assert service.wait_for_service(30.0)
    asked = service.call_async(Trigger.Request())
    assert client.spin_until(lambda: int(client.report()["tick"]) > before)
    assert "another step" in step(client, 1).message
    assert pause(client, False).success
    assert client.spin_until(asked.done)
    assert not asked.result().success
    assert asked.result().message.endswith("of 100000 ticks were taken")


def test_a_pose_after_a_pause_is_resisted_without_a_kick(client):
    inside = press_until_contact(client, client.ask)
    assert client.spin_until(lambda: client.ask(inside) or client.hand_force() > 0.02)
    assert pause(client, True).success
    # Wrenches from before the pause may still be on their way.
    assert client.spin_until(lambda: client.ask(inside) or client.hand_force() == 0.0)
    client.ask(inside)
    assert client.hand_force() == 0.0
    client.wrenches.clear()
    assert pause(client, False).success

    def has_force():
        client.ask(inside)
        return client.hand_force() > 0.02

    assert client.spin_until(has_force), "it was inside all the while, and is not held off"
    assert client.kick(lambda: client.ask(inside)) < MOST_KICK


@pytest.mark.extended
def test_a_clock_that_is_followed_ends_a_pause_and_refuses_another(client, node):
    assert pause(client, True).success
    assert client.set_parameter("use_sim_time", True).successful
    refused = pause(client, True)
    assert not refused.success
    assert "ticks follow /clock" in refused.message
    assert client.report()["paused"] == "False"
    assert "ticks follow /clock" in step(client, 1).message
    assert client.set_parameter("use_sim_time", False).successful
    before = tick(client)
    assert client.spin_until(lambda: tick(client) > before + 100)


class Services:
    """What Pausing needs of a node: a place for its services, and the warnings that it logs."""

    def __init__(self):
        self.warnings = []

    def create_service(self, *_, **__):
        return SimpleNamespace(send_response=None)

    def get_logger(self):
        return SimpleNamespace(warning=self.warnings.append, info=lambda _: None)


@pytest.mark.parametrize("in_time", [True, False])
def test_a_step_that_goes_on_without_new_contacts_says_so_once(in_time):
    node = Services()
    loop = SimpleNamespace(tick_time=1e-3, pause=SimpleNamespace(active=True, step=lambda: True))
    contacts = SimpleNamespace(rate=250.0, catch_up=lambda _: in_time)
    clock = SimpleNamespace(jumped=[], active=False)
    pausing = Pausing(node, loop, clock, lambda: 12, contacts)
    pausing.begin_step()
    assert pausing.take(12) == 12
    assert len(node.warnings) == (0 if in_time else 1)
    assert all("went on with older contacts" in line for line in node.warnings)
