"""Masses and damping of the copies of nodes: mass is kept, no copy creeps, and a cut organ comes to rest."""

import numpy as np
import pytest

from helpers.slabs import INCISION, slab
from tissue_sim.bench.cutting.cuts import CLOSING, CUTS, OPENING, loads_of, placed
from tissue_sim.model.cutting.masses import MAX_DAMPING_RATIO, MIN_MASS_FRACTION
from tissue_sim.model.elasticity.energy import energy_of
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

BESIDE = [[0.0201, -0.01, 0.031], [0.0201, 0.04, 0.031]], *INCISION[1:]  # 0.1 mm beside nodes: it leaves thin tips


@pytest.fixture(scope="module")
def made():
    """The slab, cut, and the node that each of its nodes copies."""
    simulation = Simulation(slab()).cut(*BESIDE)
    return simulation, np.concatenate([np.arange(slab().n_nodes), simulation.organ.virtual_of])


def test_the_copies_of_a_node_together_have_its_mass(made):
    simulation, source = made
    mass = simulation.organ.mass
    np.testing.assert_allclose(np.bincount(source, mass), slab().mass, rtol=1e-12)
    assert (mass / slab().mass[source]).min() > 0.9 * MIN_MASS_FRACTION


def test_damping_is_that_of_the_node_unless_its_copy_would_creep(made):
    """By the stiffness of each copy as the second difference of the elastic energy."""
    simulation, source = made
    organ, whole = simulation.organ, slab().damping[source]
    several = np.flatnonzero(np.isin(source, organ.virtual_of))
    others = np.setdiff1d(np.arange(len(source)), several)
    np.testing.assert_array_equal(organ.damping[others], whole[others])
    bounded = 0
    tried = several[::4]
    for node in tried:
        least = np.linalg.eigvalsh(stiffness_of(simulation, node))[0]
        most = 2.0 * MAX_DAMPING_RATIO * np.sqrt(least * organ.mass[node])
        assert organ.damping[node] == pytest.approx(min(whole[node], most), rel=1e-3)
        bounded += organ.damping[node] < whole[node]
    assert 0 < bounded < len(tried)


def stiffness_of(simulation, node, size=1e-6):
    """Stiffness (3, 3) N/m of a node about rest with all others held."""
    rest, model = simulation.model.rest, simulation.model
    still = np.zeros_like(rest)

    def energy(way):
        moved = rest.copy()
        moved[node] += way
        return energy_of(model, moved, still).elastic

    axes = size * np.eye(3)
    return np.array(
        [[(energy(a + b) - energy(a - b) - energy(b - a) + energy(-a - b)) / (4 * size**2) for a in axes] for b in axes]
    )


@pytest.mark.parametrize("load", [OPENING, CLOSING, "press far away"])
def test_a_cut_kidney_comes_to_rest(load):
    """Light tips crept for half a minute, and lips that press on each other oscillated."""
    organ = Organ.load(shipped_organ())
    place = placed(
        organ, next(cut for cut in CUTS if (cut.organ, cut.shape, cut.length) == ("kidney", "curved", 0.024))
    )
    loads = loads_of(organ, place)
    simulation = Simulation(organ).cut(place.sheet.polyline, place.sheet.direction, place.sheet.depth)
    _, settled = simulation.settle(0.5 * loads.force[loads.names.index(load)], 1e-4, 10.0, 0.3)
    assert settled
