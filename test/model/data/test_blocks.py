"""Springs in blocks: every one once, in its kind, whatever their number."""

import numpy as np
import pytest

from helpers.scenes import assembled, ball, changed, kidney
from tissue_sim.model.data.blocks import BLOCK, empty_blocks, pack
from tissue_sim.model.elasticity.assembly import packed


@pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 5 * BLOCK])
def test_packed_springs_come_out_as_they_went_in(count):
    random = np.random.default_rng(count)
    nodes, constants = random.integers(0, 99, (count, 4)), random.standard_normal((count, 3))
    blocks = pack(nodes, constants, np.array([7.0, 8.0, 9.0]))
    assert len(blocks.nodes) == len(blocks.constants) == -(-count // BLOCK)
    rows = blocks.constants.reshape(-1, 3, BLOCK).transpose(0, 2, 1).reshape(-1, 3)
    np.testing.assert_array_equal(blocks.nodes.reshape(-1, 4)[:count], nodes)
    np.testing.assert_array_equal(rows[:count], constants)
    np.testing.assert_array_equal(rows[count:], np.broadcast_to([7.0, 8.0, 9.0], rows[count:].shape))
    assert blocks.nodes.reshape(-1, 4)[count:].max(initial=0) == 0
    room = empty_blocks(count, 4, 3)
    assert room.nodes.shape == blocks.nodes.shape
    assert room.constants.shape == blocks.constants.shape


def laws(blocks):
    """Nodes (s, c) and constants (s, k) of blocks, fillings too."""
    kinds = blocks.constants.shape[1] // BLOCK
    rows = blocks.constants.reshape(len(blocks.nodes), kinds, BLOCK).transpose(0, 2, 1).reshape(-1, kinds)
    return blocks.nodes.reshape(-1, blocks.nodes.shape[2]), rows


@pytest.mark.parametrize("variant", ["surface", "volume", "hybrid"])
@pytest.mark.parametrize("organ", [ball(), kidney()], ids=["ball", "kidney"])
def test_every_spring_of_a_model_is_packed_once(organ, variant):
    model = assembled(organ, variant)
    edge_ends, edge_laws = laws(model.edges)
    link_ends, link_laws = laws(model.links)
    bent, pulled, tied = edge_laws[:, 4] > 0.0, edge_laws[:, 7] > 0.0, link_laws[:, 1] > 0.0
    assert bent.sum() == len(model.angular_nodes)
    np.testing.assert_array_equal(edge_ends[bent], model.angular_nodes)
    found = [
        (*sorted(ends), inverse, stiffness)
        for ends, inverse, stiffness in (
            *zip(edge_ends[pulled, :2].tolist(), edge_laws[pulled, 6], edge_laws[pulled, 7], strict=True),
            *zip(link_ends[tied].tolist(), link_laws[tied, 0], link_laws[tied, 1], strict=True),
        )
    ]
    expected = [
        (*sorted((int(i), int(j))), 1.0 / rest, stiffness)
        for i, j, rest, stiffness in zip(
            model.spring_first, model.spring_second, model.spring_rest_length, model.spring_stiffness, strict=True
        )
    ]
    assert sorted(found) == sorted(expected)
    if variant == "volume":
        assert len(edge_ends) == 0
    else:
        assert pulled.sum() == bent.sum(), "every hinge has its edge's axial spring"


def test_hinges_without_axial_springs_and_springs_without_hinges_are_packed_too():
    model = assembled(changed(ball(), spring_stiffness=0.0))
    _, rows = laws(model.edges)
    assert (rows[:, 4] > 0.0).sum() == len(model.angular_nodes)
    assert not rows[:, 7].any()
    assert len(model.links.nodes) == 0
    none = {name: getattr(model, name)[:0] for name in model._fields if name.startswith("angular_")}
    assert len(packed(model._replace(**none)).edges.nodes) == 0
    stretched = assembled(changed(ball(), angular_stiffness=0.0))
    assert len(stretched.edges.nodes) == 0
    assert (laws(stretched.links)[1][:, 1] > 0.0).sum() == len(stretched.spring_first)
