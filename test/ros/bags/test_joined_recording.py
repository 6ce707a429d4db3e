"""What joins the organs of a scene, in a bag: it comes back as it was, and what can't be is refused."""

from types import SimpleNamespace

import numpy as np
import pytest

from helpers.patience import wait_for
from helpers.scenes import ball
from tissue_sim.contact.attachments import Attachment, Breathing
from tissue_sim.contact.coupling_setup import join
from tissue_sim.contact.organ_contact_finder import OrganContactFinder
from tissue_sim.model.joined import Joined
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.contact_pairs import organ_contact_set, used_words
from tissue_sim.organ.placement import placed
from tissue_sim.ros.bags.joined_recorder import JoinedRecorder
from tissue_sim.ros.bags.joined_recording import JoinedRecording, Sizes, _check_fields, _pairs_of
from tissue_sim.ros.shared.loop import Loop

SIZES = [Sizes(ball(2).n_nodes, {1: ball(2).n_nodes + 5})] * 2


def simulations():
    return [Simulation(organ) for organ in (ball(2), placed(ball(2), [0.0592, 0.0, 0.0]))]


@pytest.fixture(scope="module")
def written():
    """What a recorder writes of two balls that touch, hang on each other and have breathed, by topic; and the loop."""
    both = simulations()
    hang = Attachment((0, 1), stiffness=5.0, within=0.01, slack=0.0)
    loop = Loop(join(both, [hang], Breathing(60.0, [0.0, 0.0, 0.01]), [1.0, 0.0], 0.3))
    messages, topics = SimpleNamespace(lock=None, active=True), {}
    messages.packed = lambda name, arrays: topics.setdefault(name.rpartition("/")[2], []).append(arrays)
    recorder = JoinedRecorder(messages, "/node", loop)
    loop.start()
    found = OrganContactFinder([one.organ for one in both]).find([one.organ.rest_positions for one in both])
    recorder.pairs(loop.post_organ_contacts(found), [0, 0], found)
    wait_for(lambda: loop.ticks > 300)
    loop.take_snapshots()
    recorder.state(300)
    topics["journal"] = [recorder.rows()]
    loop.stop()
    return topics, loop


def test_it_comes_back_as_it_was(written):
    topics, loop = written
    (fields,) = topics["joined"]
    _check_fields(fields, SIZES)
    again = JoinedRecording(fields, {}, {}).join(simulations())
    kept, links = loop.joined_box.snapshot, loop.joined.links
    count = int(kept.pairs.found[0])
    assert count > 0
    assert again.pairs.found[0] == count
    np.testing.assert_array_equal(again.pairs.node[:count], kept.pairs.node[:count])
    np.testing.assert_array_equal(again.pairs.pressed[:count], kept.pressed[:count])
    np.testing.assert_array_equal(again.links.stiffness, links.stiffness)
    assert again.carried.breath.time > 0.2
    assert again.carried.breath.period == 1.0
    (rows,) = topics["journal"]
    assert rows["pairs"]["pairs"].tolist() == [1]
    assert rows["joined"]["pairs"].max() == 1
    assert int(topics["organ_contact_set"][0]["sequence"]) == 1


def test_of_an_organ_alone_there_is_nothing_but_the_journal():
    recorder = JoinedRecorder(SimpleNamespace(lock=None, active=True), "/node", Loop(Joined(simulations()[:1])))
    assert recorder.names == {"journal": "/node/journal"}
    recorder.begin()
    recorder.state(300)
    assert recorder.rows() == {}
    assert JoinedRecording({}, {}, {}).join(simulations()[:1]).alone


@pytest.mark.parametrize(
    ("name", "change", "expected"),
    [
        ("links.organ", lambda a: a + 5, "an organ that doesn't exist"),
        ("links.node", lambda a: a + 10_000, "a node that doesn't exist"),
        ("links.node", lambda a: a - 10_000, "a node that doesn't exist"),
        ("links.stiffness", lambda a: np.nan * a, "not finite"),
        ("links.stiffness", lambda a: a[:-1], "has shape"),
        ("links.point", lambda a: a.astype(np.float32), "has shape"),
        ("moves", lambda a: a[:1], "has shape"),
        ("friction", lambda a: a * np.inf, "not finite"),
        ("breath", lambda a: np.zeros(3), "has shape"),
        ("pairs", lambda a: a[:-1], "but contains another number"),
        ("pairs", lambda a: a.astype(float), "are not whole words"),
        ("pairs", lambda a: np.where(np.arange(len(a)) == 1, 9, a), "an organ that doesn't exist"),
        ("pairs", lambda a: np.where(np.arange(len(a)) == 3, -7, a), "a node that doesn't exist"),
        ("held", lambda a: a[:, :2], "has shape"),
        ("versions", lambda a: a[:1], "has shape"),
    ],
)
def test_what_can_not_be_is_refused(written, name, change, expected):
    (fields,) = written[0]["joined"]
    with pytest.raises(ValueError, match=expected), np.errstate(invalid="ignore"):
        _check_fields({**fields, name: change(fields[name])}, SIZES)


def test_what_is_missing_is_refused(written):
    (fields,) = written[0]["joined"]
    for name in fields:
        with pytest.raises(LookupError):
            _check_fields({key: value for key, value in fields.items() if key != name}, SIZES)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, None),
        ({"version": 7, "node": 9_999}, None),  # of a surface from before the bag
        ({"version": 1, "node": 9_999}, "a node that doesn't exist"),
        ({"node": -1}, "a node that doesn't exist"),
        ({"named": -2}, "a point of a cut that doesn't exist"),
        ({"organ": 1}, "a point of a cut of another organ"),
        ({"organ": 5}, "a point of a cut that doesn't exist"),
        ({"weight": np.nan}, "invalid weights"),
    ],
)
def test_points_of_cuts_that_can_not_be_are_refused(change, expected):
    one = {"organ": 0, "version": 1, "node": ball(2).n_nodes + 4, "named": -1, "weight": 0.5} | change
    found = organ_contact_set()
    found.found[0] = found.points[0] = 1
    found.organ[0], found.node[0], found.weight[0] = (1, 0), (3, 4, 5, one["named"]), (0.5, 0.25, 0.25)
    found.point_organ[0], found.point_version[0], found.point_number[0] = one["organ"], one["version"], 500
    found.point_node[0], found.point_weight[0] = one["node"], one["weight"]
    if expected is None:
        assert int(_pairs_of(used_words(found), SIZES).points[0]) == 1
        return
    with pytest.raises(ValueError, match=expected):
        _pairs_of(used_words(found), SIZES)
