"""Ticks that follow /clock: they wait for it, stop with it, and a jump back resets the organ."""

import time

import numpy as np
import pytest
from client import Client
from processes import poke_path, press_until_felt, running_node, shipped
from rclpy.qos import QoSProfile
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

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
        return press_until_felt(self.client, lambda position: self.run(STEP, position))

    def run(self, seconds, pose=None, wall=STEP):
        """Let so many s of simulated time go by, each step in `wall` s."""
        for _ in range(round(seconds / STEP)):
            self.time += STEP
            self.post()
            if pose is not None:
                self.client.send_pose(pose)
            self.client.spin(wall)


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    parameters = ("use_sim_time:=true", "tools:=[left]", "marker_rate:=5.0")
    with running_node(tmp_path_factory.mktemp("sim_time"), *parameters) as process:
        yield process


@pytest.fixture(scope="module")
def client(node):
    client = Client()
    assert client.spin_until(lambda: client.pose.get_subscription_count() > 0 and client.diagnostics, 20.0)
    yield client
    client.close()


@pytest.fixture(scope="module")
def simulator(client):
    return Simulator(client)


def report(client):
    """The next diagnostics."""
    client.diagnostics = {}
    assert client.spin_until(lambda: bool(client.diagnostics), 5.0)
    return client.diagnostics


def test_without_a_clock_nothing_ticks_and_a_line_says_so(client, node):
    assert "waiting for /clock" in node.text()
    values = report(client)
    assert values["clock"] == "no /clock yet"
    assert values["tick"] == "0"
    assert client.spin_until(lambda: len(client.surfaces) > 0, 5.0), "the organ is shown all the same"
    assert np.ptp(client.surfaces[-1], axis=0).min() > 0.01


def test_ticks_follow_the_clock_not_the_wall(client, simulator, node):
    simulator.run(0.5)
    before, start = int(report(client)["tick"]), simulator.time
    assert "ticks follow /clock" in node.text()
    simulator.run(0.7, wall=2.0 * STEP)
    client.spin(0.1)
    ticks = int(report(client)["tick"]) - before
    assert ticks == pytest.approx(1000.0 * (simulator.time - start), abs=5)


def test_a_clock_that_stands_leaves_no_force_and_holds_tools_off(client, simulator, node):
    inside = simulator.press()
    stood = time.monotonic()
    while time.monotonic() - stood < 2.2:  # poses go on, the clock doesn't
        client.send_pose(inside)
        client.spin(0.005)
    forces = [np.abs(wrench).max() for clock, wrench in client.wrenches if clock - stood > 0.8]
    assert len(forces) > 20
    assert max(forces) == 0.0
    assert client.diagnostics["clock"] == "/clock stands"
    assert "/clock stands" in node.text()
    tick = int(client.diagnostics["tick"])
    assert int(report(client)["tick"]) == tick
    client.wrenches.clear()
    simulator.run(0.3, inside)
    assert max(np.abs(wrench).max() for _, wrench in client.wrenches) == 0.0, "no kick when it goes on"
    assert client.spin_until(lambda: "appeared inside the organ" in node.text(), 2.0)


def test_a_jump_back_resets(client, simulator, node):
    away = poke_path(shipped())[0] + np.array([0.05, 0.0, 0.0])
    simulator.run(0.3, away)
    rest = client.surfaces[0]
    position = simulator.press()
    for _ in range(100):  # five markers a second of the wall's clock
        if np.abs(client.surfaces[-1] - rest).max() > 1e-3:
            break
        simulator.run(0.1, position)
    assert np.abs(client.surfaces[-1] - rest).max() > 1e-3
    tick = int(report(client)["tick"])
    simulator.time = 3.0
    simulator.run(0.1)
    assert client.spin_until(lambda: "/clock jumped back by" in node.text(), 2.0)
    simulator.run(0.3, away)
    assert client.spin_until(lambda: np.abs(client.surfaces[-1] - rest).max() < 1e-6, 5.0)
    values = report(client)
    assert tick + 350 < int(values["tick"]) < tick + 450, "ticks go on counting"
    assert "left.refused.backward_stamp" not in values


def test_a_long_jump_forward_is_dropped_and_counted(client, simulator):
    values = report(client)
    tick, dropped = int(values["tick"]), int(values["dropped_ticks"])
    simulator.time += 100.0
    simulator.run(0.1)
    values = report(client)
    assert int(values["dropped_ticks"]) - dropped == pytest.approx(100_000, abs=20)
    assert int(values["tick"]) - tick < 150
    assert "dropped_ticks" in client.message


def test_use_sim_time_can_be_left_and_taken_live(client, simulator):
    assert client.set_parameter("use_sim_time", False).successful
    before = int(report(client)["tick"])
    client.spin(0.5)
    values = report(client)
    assert values["clock"] == "wall"
    assert int(values["tick"]) > before + 400
    assert client.set_parameter("use_sim_time", True).successful
    client.spin(0.6)
    before = int(report(client)["tick"])
    simulator.run(0.2)
    client.spin(0.1)
    assert int(report(client)["tick"]) - before == pytest.approx(200, abs=30)
