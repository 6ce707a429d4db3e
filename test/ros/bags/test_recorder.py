"""Rows that wait for a bag's journal."""

import pytest

from tissue_sim.ros.bags.organ_recorder import _Notes


@pytest.mark.parametrize("rows", [0, 2])
@pytest.mark.parametrize("bodies", [0, 1, 3])
def test_a_journal_has_one_row_for_each_body_of_each_contact_set(rows, bodies):
    """Without tools there are none, and a surface is noted before any contact set."""
    notes = _Notes(contacts=[(1, 2, 3)] * rows, body_contacts=[[(0.5, 1, False)] * bodies] * rows, surfaces=[(7,)])
    found = notes.arrays(bodies)
    assert found["contacts"].shape == (rows,)
    assert found["body_contacts"].shape == (rows, bodies)
    assert found["surfaces"].shape == (1,)
    assert all((row[0], row[1]) == (0.5, 1) for row in found["body_contacts"].ravel())
