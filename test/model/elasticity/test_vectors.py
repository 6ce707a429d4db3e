"""Nodes read and pushed four at a time against plain NumPy, to the last bit."""

import numpy as np
import pytest

from tissue_sim.jit import kernel
from tissue_sim.model.data.blocks import BLOCK
from tissue_sim.model.elasticity.vectors import (
    ROW,
    WIDTH,
    gather_arms,
    gather_group,
    put_node,
    scatter_arms,
    scatter_group,
)


@kernel
def through_cells(rows, nodes, work):
    gather_arms(rows, nodes, work)
    scatter_arms(rows, nodes, work)


@kernel
def through_fans(rows, nodes, work):
    gather_group(rows, nodes, work)
    scatter_group(rows, nodes, work)


@pytest.mark.parametrize(("corners", "through"), [(4, through_cells), (6, through_fans)])
def test_vectors_read_and_add_as_one_after_the_other_would_to_the_last_bit(corners, through):
    draw = np.random.default_rng(4)
    nodes = draw.integers(0, 9, (BLOCK, corners)).astype(np.int32)  # many meet at a node
    rows, work = draw.standard_normal((9, ROW)), np.zeros(3 * (corners - 1) * BLOCK)
    position, force = rows[:, :3].copy(), rows[:, WIDTH : WIDTH + 3].copy()
    arms = position[nodes[:, 1:]] - position[nodes[:, :1]]
    for lane in range(BLOCK):
        total = arms[lane, 0].copy()
        for pull in arms[lane, 1:]:
            total += pull
        force[nodes[lane, 0]] += total
        for node, pull in zip(nodes[lane, 1:], arms[lane], strict=True):
            force[node] -= pull
    through(rows, nodes, work)
    np.testing.assert_array_equal(work.reshape(corners - 1, 3, BLOCK).transpose(2, 0, 1), arms)
    np.testing.assert_array_equal(rows[:, :3], position)
    np.testing.assert_array_equal(rows[:, WIDTH : WIDTH + 3], force)


def test_a_node_s_row_has_its_position_and_no_force():
    draw = np.random.default_rng(5)
    position, rows = draw.standard_normal((4, 3)), draw.standard_normal((4, ROW))
    before = rows.copy()
    put_node(position, 2, rows)
    np.testing.assert_array_equal(rows[2], [*position[2], 0.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(np.delete(rows, 2, axis=0), np.delete(before, 2, axis=0))
