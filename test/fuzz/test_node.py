"""Hostile messages and services to a running node, over DDS: afterwards it is as before."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.fuzz import node
from helpers.fuzz.acts import acts
from helpers.fuzz.examples import examples


@pytest.mark.extended
@pytest.mark.timeout(0)  # there may be any number of examples, each of which has a time limit
@pytest.mark.parametrize("scene", [False, True], ids=["organ", "scene"])
@examples(6, shrink=False)  # every failure takes a new node
@given(data=st.data())
def test_a_node_is_as_before(child, scene, data):
    child.use(node.prepare, scene, data.draw(acts(scene)))
