"""Bags that end right after their beginning: each replays, or none is left."""

from pathlib import Path

import pytest
from std_srvs.srv import SetBool

from helpers.ros.clients import Client
from helpers.ros.processes import running_node
from tissue_sim.cli import main
from tissue_sim.ros.bags.recorder import NOT_KEPT

EXACT = ("--force-tolerance", "0", "--position-tolerance", "0")


def repeats(bag, capsys):
    assert main(["replay", str(bag), *EXACT]) == 0, capsys.readouterr()
    said = capsys.readouterr().out
    assert "repeats" in said
    return said


@pytest.fixture(scope="module")
def recording_node(tmp_path_factory):
    """A node with a sleeping organ, and its folder of bags."""
    folder = tmp_path_factory.mktemp("short")
    with running_node(folder, "tools:=[left]", f"record_folder:={folder / 'bags'}"):
        yield folder / "bags"


@pytest.fixture
def client(recording_node):
    made = Client(markers=False)
    made.meet()
    yield made
    made.close()


def test_a_bag_that_ends_at_once_replays(client, capsys):
    """Nothing moves, no tool is there, and the recorder had no time for a state."""
    for _ in range(3):
        assert client.record(True).success
        ended = client.record(False)
        assert ended.success, ended.message
        assert "0 wrenches and 1 surfaces" in repeats(ended.message, capsys)


def test_a_bag_without_a_tick_is_not_kept(recording_node, client):
    def pause(on):
        assert client.call(SetBool, f"{client.target}/pause", SetBool.Request(data=on)).success

    pause(True)
    try:
        bag = Path(client.record(True).message)
        assert bag.is_dir()
        ended = client.record(False)
    finally:
        pause(False)
    assert (ended.success, ended.message) == (False, NOT_KEPT)
    assert not bag.exists()
    assert recording_node.is_dir()


def test_a_node_that_is_stopped_as_soon_as_it_runs_leaves_a_whole_bag(tmp_path, start, capsys):
    node = start(tmp_path, "record:=true", f"record_folder:={tmp_path / 'bags'}")
    assert node.stop() == 0
    (bag,) = (tmp_path / "bags").iterdir()
    assert (bag / "metadata.yaml").exists()
    repeats(bag, capsys)
