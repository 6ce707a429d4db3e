"""What continues after a cut: all words of a state that have a meaning in the next one."""

import numpy as np
import pytest

from tissue_sim.model.cutting.carry import carry, carry_plan
from tissue_sim.model.data.state import fields_of, make_state

ORIGIN = np.array([0, 1, 2, 3, 4, 5, 6, 7, 2, 5])  # two copies more


@pytest.fixture
def states():
    before, after = make_state(8, 2, 0, 12), make_state(10, 2, 0, 16)
    before.words[:] = np.random.default_rng(1).integers(1, 2**60, len(before.words))
    before.contacts.header.points = 3
    after.words[:] = 7
    carry(before.words, after.words, carry_plan(before, after, ORIGIN, 8))
    return before, after


def test_nodes_continue_where_those_were_that_they_copy(states):
    before, after = states
    for name in ("position", "velocity", "good_position"):
        np.testing.assert_array_equal(
            getattr(after, name).view(np.int64), getattr(before, name)[ORIGIN].view(np.int64), err_msg=name
        )


def test_tools_counts_and_contacts_continue_to_the_last_bit(states):
    before, after = states
    np.testing.assert_array_equal(after.contacts.words, before.contacts.words)
    for name in ("count", "bodies", "wrench", "held_pose", "body_goal", "contact_pressed"):
        old, new = fields_of(before)[name], fields_of(after)[name]
        assert new.tobytes() == old.tobytes(), name


def test_what_belongs_to_cells_is_found_out_again(states):
    _, after = states
    assert np.all(after.is_turned == 7)
    assert (after.status.turned, after.status.next_cell, after.status.region_nodes) == (7, 7, 7)
    assert after.status.tick != 7
