"""Which springs each node has, and the lists of a region, against naive loops and sets."""

import numpy as np
import pytest

from helpers.naive import hops_from
from helpers.scenes import assembled, ball, ball_of_cells, kidney, near
from tissue_sim.model.data.blocks import BLOCK
from tissue_sim.model.elasticity.adjacency import adjacency_of, with_cell_neighbours
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.cell_mesh import with_cells


def slots_with(nodes, constants, stiff_rows):
    """For every node the slots of its springs, by a loop; fillings have no stiffness in any of the rows."""
    found = {}
    for slot, ends in enumerate(nodes.reshape(-1, nodes.shape[2])):
        block, row = divmod(slot, BLOCK)
        if any(constants[block, k * BLOCK + row] != 0.0 for k in stiff_rows):
            for node in ends:
                found.setdefault(int(node), []).append(slot)
    return found


@pytest.mark.parametrize("variant", ["surface", "volume", "hybrid"])
@pytest.mark.parametrize("organ", [ball(), ball(3)], ids=["ball", "fine ball"])
def test_rows_are_those_of_a_naive_loop(organ, variant):
    model = assembled(organ, variant)
    made = adjacency_of(model)
    for start, slots, blocks, rows in (
        (made.edge_start, made.edges, model.edges, (4, 7)),
        (made.link_start, made.links, model.links, (1,)),
    ):
        expected = slots_with(*blocks, rows)
        assert len(start) == organ.n_nodes + 1
        for node in range(organ.n_nodes):
            assert list(slots[start[node] : start[node + 1]]) == expected.get(node, []), node


def test_rows_of_cells_and_neighbours_along_their_edges_are_those_of_a_naive_loop():
    organ = with_cells(ball(2))
    model = with_cell_neighbours(assembled(organ))
    made = adjacency_of(model)
    cells = model.tissue.nodes.reshape(-1, 4)
    real = {slot for slots in slots_with(*model.tissue[:2], (8,)).values() for slot in slots}
    assert len(real) == len(organ.cell_nodes) < len(cells)
    for node in range(organ.n_nodes):
        slots = [slot for slot in sorted(real) if node in cells[slot]]
        assert list(made.cells[made.cell_start[node] : made.cell_start[node + 1]]) == slots
        others = {int(other) for slot in slots for other in cells[slot]} - {node}
        row = model.neighbours[model.neighbour_start[node] : model.neighbour_start[node + 1]]
        assert list(row) == sorted(others)


def test_lists_of_a_region_of_cells_are_those_of_naive_sets():
    organ = ball_of_cells()
    simulation = Simulation(organ, local_region="modal")
    state, scratch = simulation.state, simulation.scratch
    node = near(organ, (0.0, 0.0, 1.0))[0]
    for _ in range(3):
        simulation.apply_force(node, [0.0, 0.0, -0.01])
        simulation.step()
    touching = [set(cell) for cell in organ.cell_nodes.tolist() if node in cell]
    region = set().union(*touching)
    cells = sorted(sorted(cell) for cell in organ.cell_nodes.tolist() if region & set(cell))
    assert scratch.region_node[: state.status.region_nodes].tolist() == sorted(region)
    assert state.status.region_cells == len(cells) > 16
    listed = scratch.cells.nodes.reshape(-1, 4)[: len(cells)].tolist()
    assert sorted(sorted(cell) for cell in listed) == cells
    edge = {other for cell in cells for other in cell} - region
    assert set(scratch.boundary_node[: state.status.region_boundary].tolist()) == edge


@pytest.mark.parametrize("organ", [ball(3), kidney()], ids=["ball", "kidney"])
@pytest.mark.parametrize(("region", "hops"), [("frozen", 2), ("modal", 1)])
@pytest.mark.parametrize("tabled", [True, False], ids=["hop table", "searched"])
def test_lists_of_a_region_are_those_of_naive_sets(organ, region, hops, tabled):
    """Its nodes, the springs that they have, and the other ends of these; also after the load has wandered."""
    simulation = Simulation(organ, local_region=region)
    if not tabled:
        simulation.model = simulation.model._replace(hops=np.zeros((0, 0), dtype=np.uint8))
        simulation.refer()
    model, state, scratch = simulation.model, simulation.state, simulation.scratch
    first = near(organ, (0.0, 0.0, 1.0))[0]
    loaded = [first, int(np.flatnonzero(hops_from(organ, [first]) == 2)[0])]
    for count in (1, 2):
        for _ in range(3):
            simulation.apply_force(loaded[:count], np.tile([0.0, 0.0, -0.01], (count, 1)))
            simulation.step()
        hop = hops_from(organ, loaded[:count])
        nodes = set(np.flatnonzero(hop <= hops).tolist())
        expected_hop = np.full(organ.n_nodes, -1)
        expected_hop[sorted(nodes)] = hop[sorted(nodes)]
        np.testing.assert_array_equal(state.region_hop, expected_hop)
        assert scratch.region_node[: state.status.region_nodes].tolist() == sorted(nodes)
        assert scratch.moved_node[: scratch.n_moved[0]].tolist() == sorted(nodes - set(organ.fixed.tolist()))
        boundary = set()
        for kind, blocks, local, listed, rows in (
            ("edges", model.edges, scratch.edges, state.status.region_hinges, (4, 7)),
            ("links", model.links, scratch.links, state.status.region_springs, (1,)),
        ):
            every = slots_with(*blocks, rows)
            slots = {slot for node in nodes for slot in every.get(node, [])}
            ends = blocks.nodes.reshape(-1, blocks.nodes.shape[2])
            laws = blocks.constants.reshape(len(blocks.nodes), -1, BLOCK).transpose(0, 2, 1).reshape(len(ends), -1)
            local_ends = local.nodes.reshape(-1, local.nodes.shape[2])
            local_laws = local.constants.reshape(len(local.nodes), -1, BLOCK).transpose(0, 2, 1)
            local_laws = local_laws.reshape(len(local_ends), -1)
            assert listed == len(slots) > 0, kind
            wanted = sorted((*ends[slot].tolist(), *laws[slot].tolist()) for slot in slots)
            found = sorted((*local_ends[k].tolist(), *local_laws[k].tolist()) for k in range(listed))
            assert found == wanted, kind
            filling = local_laws[listed : -(-listed // BLOCK) * BLOCK]
            assert np.all(filling[:, list(rows)] == 0.0)
            boundary |= {int(node) for slot in slots for node in ends[slot]} - nodes
        assert set(scratch.boundary_node[: state.status.region_boundary].tolist()) == boundary
        assert state.status.region_boundary == len(boundary)
