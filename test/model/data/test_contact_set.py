"""Contact sets: four nodes a point, and those of earlier bags, which have three."""

import numpy as np
import pytest

from helpers.scenes import ball
from tissue_sim.model.data.contact_set import contact_set, nodes_of, padded
from tissue_sim.model.data.records import array_of
from tissue_sim.model.data.shapes import sphere_tools
from tissue_sim.model.data.state import fields_of
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.state_check import contact_set_of

EARLIER = {"node": np.array([[4, 5, 6], [7, 7, 7]]), "weight": np.array([[0.2, 0.3, 0.5], [1.0, 0.0, 0.0]])}


def in_triangles():
    """A set of two points as earlier versions wrote it, by field."""
    found = contact_set(1, 2)
    found.header.points = 2
    fields = {name: array_of(value).copy() for name, value in found._asdict().items() if name != "words"}
    fields |= EARLIER | {"tip_node": np.array([[1, 2, 3]]), "tip_weight": np.full((1, 3), 1.0 / 3.0)}
    return fields


def test_sets_with_three_nodes_a_point_are_read():
    found = contact_set_of(in_triangles(), 1, 20)
    np.testing.assert_array_equal(found.node, [[4, 5, 6, 4], [7, 7, 7, 7]])
    np.testing.assert_array_equal(found.weight, [[0.2, 0.3, 0.5, 0.0], [1.0, 0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(found.tip_node, [[1, 2, 3, 1]])
    assert found.tip_weight[0, 3] == 0.0
    assert [nodes_of(found, entry) for entry in range(2)] == [3, 3]
    found.weight[0] = 0.25
    assert nodes_of(found, 0) == 4


@pytest.mark.parametrize("width", [2, 5])
def test_sets_with_other_numbers_of_nodes_are_refused(width):
    fields = in_triangles() | {"node": np.zeros((2, width), dtype=np.int64)}
    with pytest.raises(ValueError, match="a contact set has a different 'node'"):
        contact_set_of(fields, 1, 20)


def test_states_with_three_nodes_a_point_are_read():
    simulation = Simulation(ball(1), shapes=sphere_tools(0.005))
    state = simulation.state
    state.contacts.header.points = 2
    state.contacts.node[:2], state.contacts.weight[:2] = (padded(name, EARLIER[name]) for name in ("node", "weight"))
    wanted = {name: array.copy() for name, array in fields_of(state).items()}
    earlier = dict(wanted)
    for name in ("node", "weight", "tip_node", "tip_weight"):
        earlier[f"contacts.{name}"] = wanted[f"contacts.{name}"][:, :3]
    simulation.restore(earlier)
    found = fields_of(simulation.state)
    for name, array in wanted.items():
        np.testing.assert_array_equal(found[name], array, err_msg=name)
