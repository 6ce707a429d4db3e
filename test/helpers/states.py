"""States of simulations: copies of them, whether two are the same, and whether one is finite."""

import numpy as np

from tissue_sim.model.data.state import fields_of


def snapshot(simulation):
    """A copy of the state's fields by name, as a bag holds them."""
    return {name: array.copy() for name, array in fields_of(simulation.state).items()}


def is_finite(simulation):
    """True when no number of the state is infinite or none at all."""
    return all(np.all(np.isfinite(array)) for array in fields_of(simulation.state).values() if array.dtype.kind == "f")


def assert_same(one, other):
    """Both simulations are in the same state, to the last bit."""
    found, wanted = fields_of(one.state), fields_of(other.state)
    differing = [name for name, array in wanted.items() if found[name].tobytes() != array.tobytes()]
    assert not differing, f"differ in {differing}"
