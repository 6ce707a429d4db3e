"""A state's fields by name, as bags hold them."""

import numpy as np
import pytest

from helpers.slabs import slab
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.data.state import fields_of, take_fields


def simulated():
    return Scene(slab(), [Tool("left", radius=0.002)]).simulation


def moved():
    """A slab's state that is not at rest, with numbers in what was renamed."""
    simulation = simulated()
    simulation.apply_force(5, [0.0, 0.0, -0.01])
    simulation.step(3)
    state = simulation.state
    state.unfaded_wrench[0] = np.arange(6.0)
    state.status.oscillating, state.count.oscillations = 7, 3
    return state


def renamed(record, old, new):
    """A record of which one field has another name."""
    names = {new if name == old else name: name for name in record.dtype.names}
    made = np.zeros(record.shape, [(name, record.dtype[own]) for name, own in names.items()])
    for name, own in names.items():
        made[name] = record[own]
    return made


def test_what_fields_of_returns_is_taken_bit_for_bit():
    first, second = moved(), simulated().state
    take_fields(second, fields_of(first))
    for name, value in fields_of(first).items():
        np.testing.assert_array_equal(fields_of(second)[name], value)


def test_a_bag_from_before_fields_were_renamed_is_taken():
    first, second = moved(), simulated().state
    named = dict(fields_of(first))
    named["felt"] = named.pop("unfaded_wrench")
    named["status"] = renamed(named["status"], "oscillating", "shivering")
    named["count"] = renamed(named["count"], "oscillations", "shivers")
    take_fields(second, named)
    np.testing.assert_array_equal(second.unfaded_wrench, first.unfaded_wrench)
    assert (second.status.oscillating, second.count.oscillations) == (7, 3)


def test_a_field_that_is_missing_is_named():
    state = moved()
    named = dict(fields_of(state))
    named["status"] = renamed(named["status"], "oscillating", "unheard_of")
    with pytest.raises(ValueError, match=r"its state has no 'status\.oscillating'"):
        take_fields(state, named)
