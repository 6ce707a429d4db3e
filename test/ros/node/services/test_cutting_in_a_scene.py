"""A node cuts one of two organs that lie on each other: the other touches the lips of the cut, and bags repeat it."""

from pathlib import Path

import numpy as np
import pytest

from helpers.ros.processes import UNHURRIED, running_node
from helpers.ros.surgeon import Surgeon
from helpers.slabs import INCISION, slab
from tissue_sim.model.stepping.contact_pairs import set_of_words
from tissue_sim.ros.bags.comparison import compare
from tissue_sim.ros.bags.player import replay
from tissue_sim.ros.bags.recording import Recording

SCENE = """
format: 1
organs:
  - {name: lower, file: lower.npz}
  - {name: upper, file: upper.npz, position: [0.0, 0.0, 0.0302]}
friction: 0.3
gravity: [0.0, 0.0, -9.81]
"""
DOWN = (1.0, 0.0, 0.0, 0.0)  # turns z to -z


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Two bags: the upper slab, held at its left end, has sunk onto the lower one, which is then cut; and healed."""
    folder = tmp_path_factory.mktemp("scene")
    slab("below").save(folder / "lower.npz")
    slab("left").save(folder / "upper.npz")
    (folder / "two.yaml").write_text(SCENE)
    words = f"scene_file:={folder / 'two.yaml'}", "shape_is_unloaded:=true", f"record_folder:={folder / 'bags'}"
    with running_node(folder, "tools:=[left]", UNHURRIED, *words):
        client = Surgeon("lower")
        assert client.spin_until(lambda: client.clouds)
        client.spin(1.0)
        first = Path(client.record(True).message)
        client.spin(0.3)
        edge, _, depth = INCISION
        assert client.set_parameter("cut_depth", depth).successful
        client.send_path(edge, DOWN)
        assert client.spin_until(lambda: client.ask_to_cut().success)
        client.spin(1.0)
        assert client.record(False).success
        second = Path(client.record(True).message)
        client.spin(0.5)
        assert client.reset().success
        assert client.spin_until(lambda: not client.events[-1].status)
        client.spin(0.5)
        assert client.record(False).success
        client.close()
    return first, second


def repeats(recording):
    replayed = replay(recording)
    return compare(replayed.wanted, replayed.shown, 0.0, 0.0).passes


@pytest.mark.extended
def test_pairs_follow_the_cut_bit_for_bit(bags):
    recording = Recording.read(bags[0])
    surfaces = recording.joined.journal["pair_surfaces"]
    assert surfaces["organ"].tolist() == [0]
    assert surfaces["number"].tolist() == [1]
    assert int(set_of_words(recording.joined.fields["pairs"]).points[0]) == 0
    assert repeats(recording)


@pytest.mark.extended
def test_a_bag_that_begins_at_the_lips_goes_on_to_the_reset_bit_for_bit(bags):
    recording = Recording.read(bags[1])
    surfaces = recording.joined.journal["pair_surfaces"]
    assert surfaces["number"].tolist() == [1, 2]
    assert np.all(np.diff(surfaces["pairs"]) >= 0)
    assert int(set_of_words(recording.joined.fields["pairs"]).points[0]) > 0
    assert recording.joined.fields["versions"].tolist() == [1, 0]
    assert repeats(recording)
    recording.joined.fields["versions"][:] = 0  # then what lies on the lips is dropped
    assert not repeats(recording)


@pytest.mark.extended
def test_a_replay_with_the_skin_over_the_opening_differs(bags):
    recording = Recording.read(bags[0])
    recording.joined.journal["pair_surfaces"] = recording.joined.journal["pair_surfaces"][:0]
    assert not repeats(recording)
