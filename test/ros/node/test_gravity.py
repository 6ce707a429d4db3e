"""Gravity over ROS: the organ rests in its own shape, sags when gravity changes, and a bag of it replays."""

from contextlib import contextmanager

import pytest

from helpers.ros.clients import Client
from helpers.ros.processes import UNHURRIED, running_node
from helpers.ros.replaying import repeated

# To find the kidney's shape without weight takes ten seconds; test/model shows that of a ball.
pytestmark = pytest.mark.extended
DOWN = [0.0, 0.0, -9.81]  # m/s^2


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("gravity")


@pytest.fixture(scope="module")
def client(folder):
    with running_node(folder, f"gravity:={DOWN}", UNHURRIED, f"record_folder:={folder}"):
        client = Client()
        assert client.spin_until(lambda: client.diagnostics and client.moved() < 1.0)
        yield client
        client.close()


@pytest.fixture
def repeats(client, capsys):
    """Records what is done with the node, some time after the bag's state was taken, and replays it."""

    @contextmanager
    def recorded(before=1.0):
        started = client.record(True)
        assert started.success, started.message
        client.spin(before)
        yield
        assert client.record(False).success
        repeated(started.message, capsys)

    return recorded


@pytest.mark.parametrize("before", [0.0, 1.0])
def test_it_hangs_in_its_own_shape_and_a_bag_of_another_gravity_replays(client, repeats, before):
    """Whether the parameter changes before or after the state is taken that the bag begins with."""
    assert client.moved() < 1e-6
    with repeats(before):
        assert client.set_parameter("gravity", [0.0, 0.0, 0.0]).successful
        assert client.spin_until(lambda: client.moved() > 5e-3)
        assert client.set_parameter("gravity", DOWN).successful
        assert client.spin_until(lambda: client.moved() < 1e-6)


def test_it_sags_without_gravity_and_a_bag_that_begins_with_a_reset_replays(client, repeats):
    assert client.moved() < 1e-6, "it hangs in its own shape"
    assert client.set_parameter("gravity", [0.0, 0.0, 0.0]).successful
    assert client.spin_until(lambda: client.moved() > 5e-3)
    with repeats():
        assert client.reset().success, "to where gravity would hold it"
        client.spin(1.0)
        assert client.spin_until(lambda: client.moved() > 5e-3)
    assert client.set_parameter("gravity", DOWN).successful
    assert client.spin_until(lambda: client.moved() < 1e-6)
