"""Pairs of organs in words, in a mailbox, and taken up: cut points come along, and bear what lies on them."""

import numpy as np
import pytest

from tissue_sim.model.stepping.contact_pairs import (
    POINTS_AT,
    make_organ_contacts,
    organ_contact_set,
    renew_surface,
    separate_points,
    set_of_words,
    take_pairs,
    used_words,
)


def made(numbers=(40, 41, 43), version=1):
    """Four pairs of two organs: between nodes, a cut point on nodes, and nodes on triangles with cut points."""
    found = organ_contact_set()
    found.found[0], found.points[0] = 4, 3
    found.organ[:4] = [(0, 1), (0, 1), (1, 0), (1, 0)]
    found.node[:4] = [(5, 7, 8, 9), (-1, 7, 8, 9), (3, 6, -1, -2), (4, -3, -2, -1)]
    found.weight[:4] = [(0.2, 0.3, 0.5), (0.0, 0.4, 0.6), (0.5, 0.25, 0.25), (0.0, 1.0, 0.0)]
    found.point_organ[:3], found.point_version[:3], found.point_number[:3] = 0, version, numbers
    found.point_node[:3] = [(10, 11, 10, 10), (11, 6, 11, 11), (10, 12, 13, 14)]
    found.point_weight[:3] = [(0.25, 0.75, 0.0, 0.0), (0.6, 0.4, 0.0, 0.0), (0.1, 0.2, 0.3, 0.4)]
    return found


def taken(found):
    pairs = make_organ_contacts()
    pairs.version[0] = 1
    take_pairs(pairs, found)
    return pairs


def bearers(pairs, pair):
    own, every = pairs.bearing[pair].tolist()
    rows = list(zip(pairs.bearer[pair].tolist(), pairs.part[pair].round(12).tolist(), strict=True))
    return rows[:own], rows[own:every]


def test_words_come_back():
    found = made()
    again = set_of_words(used_words(found).copy())
    np.testing.assert_array_equal(used_words(again), used_words(found))
    np.testing.assert_array_equal(again.point_weight[:3], found.point_weight[:3])
    found.points[0] = 0
    assert len(used_words(found)) == 1 + 4 * 9, "as bags had them before there were cut points"
    assert int(set_of_words(used_words(found)).points[0]) == 0


@pytest.mark.parametrize("change", [lambda w: w[:-1], lambda w: np.append(w, 0), lambda w: w * (np.arange(len(w)) > 0)])
def test_words_that_are_not_as_many_as_they_say_are_refused(change):
    with pytest.raises(ValueError, match="contains another number"):
        set_of_words(change(used_words(made())))


@pytest.mark.parametrize("count", [4, 0])
def test_points_follow_the_pairs_in_a_mailbox(count):
    found, box = made(), organ_contact_set()
    box.words[:] = 77
    if count == 0:
        found.found[0] = found.points[0] = 0
    words = used_words(found)
    message = words if count else np.append(words, 0)
    box.words[: len(message)] = message
    separate_points(box)
    np.testing.assert_array_equal(used_words(box), words)
    assert box.words[POINTS_AT] == found.points[0]


def test_nodes_bear_what_lies_on_the_points_between_them():
    pairs = taken(made())
    assert bearers(pairs, 0) == ([(5, 1.0)], [(7, 0.2), (8, 0.3), (9, 0.5)])
    assert bearers(pairs, 1) == ([(10, 0.25), (11, 0.75)], [(7, 0.0), (8, 0.4), (9, 0.6)])
    assert bearers(pairs, 2) == ([(3, 1.0)], [(6, 0.6), (10, 0.0625), (11, 0.3375)])
    assert bearers(pairs, 3) == ([(4, 1.0)], [(11, 0.6), (6, 0.4)])


def test_forces_go_on_at_the_same_point_of_the_same_surface():
    pairs = taken(made())
    pairs.pressed[:4] = [1.0, 2.0, 3.0, 4.0]
    take_pairs(pairs, made(numbers=(39, 41, 43)))
    assert pairs.pressed[:4].tolist() == [1.0, 0.0, 3.0, 4.0]


def test_a_further_cut_drops_what_lies_on_points_of_the_one_before():
    pairs = taken(made())
    pairs.pressed[:4] = [1.0, 2.0, 3.0, 4.0]
    renew_surface(pairs, 1, 1)
    assert int(pairs.found[0]) == 4, "another organ was cut"
    renew_surface(pairs, 0, 2)
    assert int(pairs.found[0]) == 1
    assert pairs.pressed[0] == 1.0
    take_pairs(pairs, made(version=1))
    assert int(pairs.found[0]) == 1
    take_pairs(pairs, made(version=2))
    assert int(pairs.found[0]) == 4
