"""The table of hop distances: what it holds, when it is left out, and that both ways find the same region."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import shortest_path

from helpers.scenes import assembled, ball, kidney
from tissue_sim.model.elasticity import hop_distances as hops
from tissue_sim.model.elasticity.hop_distances import LARGEST_TABLE, hop_table
from tissue_sim.model.simulation import Simulation


def searched(model):
    """Hop distances by SciPy's breadth-first search from every node."""
    n, end = model.n_surface, model.neighbour_start[model.n_surface]
    links = csr_matrix((np.ones(end), model.neighbours[:end], model.neighbour_start[: n + 1]), (n, n))
    return shortest_path(links, unweighted=True)


@pytest.mark.parametrize("organ", [ball(3), kidney()], ids=["ball", "kidney"])
def test_the_table_holds_the_shortest_ways(organ):
    model = assembled(organ)
    table = hop_table(model)
    assert table.dtype == np.uint8
    np.testing.assert_array_equal(table, searched(model))
    np.testing.assert_array_equal(table, table.T)


def test_an_organ_above_the_limit_has_none():
    model = assembled(ball(3))
    assert model.n_surface <= LARGEST_TABLE
    assert hop_table(model, largest=model.n_surface - 1).shape == (0, 0)
    assert hop_table(model, largest=model.n_surface).shape == (model.n_surface, model.n_surface)


def test_it_is_made_only_for_a_local_region():
    assert len(Simulation(ball()).model.hops) == 0
    assert len(Simulation(ball(), local_region="frozen").model.hops) == ball().n_surface


@pytest.mark.parametrize("loaded", [[10], [3, 200, 500]])
def test_searched_on_demand_the_region_is_the_same(monkeypatch, loaded):
    runs = []
    for largest in (LARGEST_TABLE, 0):
        monkeypatch.setattr(hops.hop_table, "__defaults__", (largest,))
        simulation = Simulation(ball(3), local_region="frozen")
        assert (len(simulation.model.hops) > 0) == (largest > 0)
        for tick in range(30):
            node = loaded[tick * len(loaded) // 30]
            simulation.apply_force([node], [[0.0, 0.005, -0.01]])
            simulation.step()
        assert simulation.state.status.region_nodes > 5
        runs.append((simulation.state.region_hop.copy(), simulation.positions.copy()))
    np.testing.assert_array_equal(runs[0][0], runs[1][0])
    np.testing.assert_array_equal(runs[0][1], runs[1][1])
