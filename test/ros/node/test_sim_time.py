"""Ticks that follow /clock: they wait for it, stop with it, and a jump back resets the organ."""

import numpy as np
import pytest
from rclpy.qos import QoSProfile
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from helpers.ros.clients import Client
from helpers.ros.processes import UNHURRIED, poke_path, press_until_contact, running_node, shipped

STEP = 0.01  # s of simulated time from one /clock to the next


class Simulator:
    """Publishes /clock, and poses in between, as a simulator does."""

    def __init__(self, client):
        self.client, self.time = client, 10.0
        self.publisher = client.node.create_publisher(Clock, "/clock", QoSProfile(depth=1))

    def post(self):
        self.publisher.publish(Clock(clock=Time(nanoseconds=round(1e9 * self.time)).to_msg()))

    def press(self):
        """Press the tool in; returns where it is then."""
        return press_until_contact(self.client, lambda position: self.run(STEP, position))

    def run(self, seconds, pose=None, wall=STEP):
        """Let so many s of simulated time go by, each step in `wall` s at least."""
        for _ in range(round(seconds / STEP)):
            self.time += STEP
            self.post()
            if pose is not None:
                self.client.send_pose(pose)
            self.client.spin(wall)

    def stands(self):
        """The node's tick once it has come to the newest time: that of two reports, one after the other."""
        found = []

        def is_there():
            self.post()
            found.append(int(self.client.report()["tick"]))
            return len(found) > 1 and found[-1] == found[-2]

        assert self.client.spin_until(is_there), found
        return found[-1]

    def ticks(self, wanted):
        """Whether the node comes to a tick, and no farther; the newest time is sent again in case it was lost."""

        def is_there():
            self.post()
            return int(self.client.report()["tick"]) >= wanted

        assert self.client.spin_until(is_there)
        return int(self.client.diagnostics["tick"]) == wanted


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    parameters = ("use_sim_time:=true", "tools:=[left]", "marker_rate:=5.0", UNHURRIED)
    with running_node(tmp_path_factory.mktemp("sim_time"), *parameters) as process:
        yield process


@pytest.fixture(scope="module")
def client(node):
    client = Client()
    client.meet()
    yield client
    client.close()


@pytest.fixture(scope="module")
def simulator(client):
    return Simulator(client)


def test_without_a_clock_nothing_ticks_and_a_line_says_so(client, node):
    assert "waiting for /clock" in node.text()
    values = client.report()
    assert values["clock"] == "no /clock yet"
    assert values["tick"] == "0"
    assert client.spin_until(lambda: len(client.surface()) > 0), "the organ is shown all the same"
    assert client.moved() < 1e-6


# An organ that sleeps: no machine is too slow for that, and none has the node halve its rate. -------
def test_ticks_follow_the_clock_not_the_wall(client, simulator, node):
    def is_followed():
        simulator.run(STEP)
        return client.diagnostics["clock"] == "/clock"

    assert client.spin_until(is_followed)
    assert "ticks follow /clock" in node.text()
    before = simulator.stands()
    simulator.run(0.7, wall=2.0 * STEP)
    assert simulator.ticks(before + 700)


@pytest.mark.extended
def test_ticks_are_as_long_as_the_rate_says(client, simulator):
    """Changed while it runs."""
    for rate in (500.0, 1000.0):
        assert client.set_parameter("rate", rate).successful
        simulator.run(2 * STEP)  # the first tick takes it up
        before = simulator.stands()
        simulator.run(0.5)
        assert simulator.ticks(before + round(0.5 * rate))


def test_a_long_jump_forward_is_dropped_and_counted(client, simulator):
    tick, dropped = simulator.stands(), int(client.diagnostics["dropped_ticks"])
    simulator.time += 100.0
    client.status_messages.clear()
    simulator.run(0.1)
    taken, given_up = simulator.stands() - tick, int(client.diagnostics["dropped_ticks"]) - dropped
    assert taken + given_up == pytest.approx(100_100, abs=1)
    assert given_up >= 99_999, "all that the jump made due, and where its first time was lost, of those behind it"
    assert any("dropped_ticks" in message for message in client.status_messages)


@pytest.mark.extended
def test_use_sim_time_can_be_left_and_taken_live(client, simulator):
    assert client.set_parameter("use_sim_time", False).successful
    before = int(client.report()["tick"])
    assert client.spin_until(lambda: int(client.report()["tick"]) > before + 400)
    assert client.diagnostics["clock"] == "wall"
    assert client.set_parameter("use_sim_time", True).successful
    assert client.spin_until(lambda: client.report()["clock"] != "wall")
    simulator.run(STEP)
    before = simulator.stands()
    simulator.run(0.2)
    assert simulator.ticks(before + 200)


# an organ that is pressed --------------------------------------------------------------------------
def test_a_clock_that_stands_leaves_no_force_and_no_kick_when_it_goes_on(client, simulator, node):
    inside = simulator.press()

    def is_reported():  # poses go on, the clock doesn't
        client.ask(inside)
        return client.diagnostics["clock"] == "/clock stands" and client.hand_force() == 0.0

    assert client.spin_until(is_reported)
    client.wrenches.clear()
    for _ in range(40):
        client.ask(inside)
    assert len(client.wrenches) > 5
    assert max(np.abs(wrench).max() for _, wrench in client.wrenches) == 0.0
    assert "/clock stands" in node.text()
    tick = int(client.report()["tick"])
    assert int(client.report()["tick"]) == tick
    client.wrenches.clear()

    def has_force_again():
        simulator.run(0.3, inside)
        return client.hand_force() > 0.02

    assert client.spin_until(has_force_again), "a tool in touch is resisted again"
    assert node.text().index("/clock stands still") < node.text().index("/clock goes on: ticks follow it again")
    assert client.kick(lambda: simulator.run(STEP, inside)) < 1.5


def test_a_jump_back_resets(client, simulator, node):
    away = poke_path(shipped())[0] + np.array([0.05, 0.0, 0.0])

    def is_pressed():  # a clock that was held up has the tool held off: it comes from outside again
        simulator.run(0.3, away)
        position = simulator.press()
        simulator.run(0.3, position)
        return client.moved() > 1e-3

    assert client.spin_until(is_pressed)
    tick = int(client.report()["tick"])
    begin = simulator.time = 3.0
    simulator.run(0.1)

    def is_back():
        simulator.run(0.1, away)
        return "/clock jumped back by" in node.text() and client.moved() < 1e-6

    assert client.spin_until(is_back)
    values = client.report()
    assert tick < int(values["tick"]) <= tick + 1000.0 * (simulator.time - begin) + 10, "ticks go on counting"
    assert "left.refused.backward_stamp" not in values
