"""What continues after a cut: all words of a state that have a meaning in the next one."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.bars import bar
from tissue_sim.model.cutting.carry import carry, carry_plan
from tissue_sim.model.data.state import fields_of, make_state
from tissue_sim.model.simulation import Simulation

ORIGIN = np.array([0, 1, 2, 3, 4, 5, 6, 7, 2, 5])  # two copies more


@pytest.fixture
def states():
    before, after = make_state(8, 2, 0, 12), make_state(10, 2, 0, 16)
    before.words[:] = np.random.default_rng(1).integers(1, 2**60, len(before.words))
    before.contacts.header.points = 3
    after.words[:] = 7
    carry(before.words, after.words, carry_plan(before, after, ORIGIN, 8, np.ones(10)))
    return before, after


def test_nodes_continue_where_those_were_that_they_copy(states):
    before, after = states
    for name in ("position", "velocity", "good_position"):
        np.testing.assert_array_equal(
            getattr(after, name).view(np.int64), getattr(before, name)[ORIGIN].view(np.int64), err_msg=name
        )


def test_tools_counts_and_contacts_continue_to_the_last_bit(states):
    before, after = states
    np.testing.assert_array_equal(after.contacts.words, before.contacts.words)
    for name in ("count", "bodies", "wrench", "held_pose", "body_goal", "contact_pressed"):
        old, new = fields_of(before)[name], fields_of(after)[name]
        assert new.tobytes() == old.tobytes(), name


def test_what_belongs_to_cells_is_found_out_again(states):
    _, after = states
    assert np.all(after.is_turned == 7)
    assert (after.status.turned, after.status.next_cell, after.status.region_nodes) == (7, 7, 7)
    assert after.status.tick != 7


def test_unrelaxed_forces_are_divided_among_the_nodes_that_take_a_place():
    before, after = make_state(8, 2, 0, 12, relaxes=True), make_state(10, 2, 0, 16, relaxes=True)
    before.unrelaxed[:] = np.random.default_rng(2).normal(size=(8, 3))
    before.relaxing.energy[0], before.relaxing.step[0] = 0.25, 1e-3
    mass = np.arange(1.0, 11.0)
    carry(before.words, after.words, carry_plan(before, after, ORIGIN, 8, mass))
    for axis in range(3):
        sums = np.bincount(ORIGIN, after.unrelaxed[:, axis])
        np.testing.assert_allclose(sums, before.unrelaxed[:, axis], rtol=1e-14)
    np.testing.assert_allclose(after.unrelaxed[8], after.unrelaxed[2] * mass[8] / mass[2], rtol=1e-14)
    np.testing.assert_array_equal(after.unrelaxed[[0, 1, 3]], before.unrelaxed[[0, 1, 3]])
    assert (after.relaxing.energy[0], after.relaxing.step[0]) == (0.25, 0.0), "no past forces"


def test_held_tissue_goes_on_relaxing_when_it_is_cut_elsewhere():
    organ = replace(bar(8, 0.01, 4), relaxation_fraction=0.4, relaxation_time=0.5)
    pulled = int(np.argmin(np.linalg.norm(organ.surface_positions - (0.03, 0.02, 0.04), axis=1)))
    edge, down = np.array([[0.064, -0.01, 0.05], [0.066, 0.05, 0.05]]), (0.0, 0.0, -1.0)  # near the free end

    def forces(cut):
        """Forces, N, that hold a node which has been pulled by 2 mm within 20 ticks."""
        simulation, found = Simulation(organ, rate=500.0), []
        for tick in range(120):
            lifted = (0.0, 0.0, 0.002 * min(tick / 20, 1.0))
            simulation.prescribe([pulled], [organ.surface_positions[pulled] + lifted])
            if tick == 60:
                assert abs(simulation.state.unrelaxed[pulled, 2]) > 0.2 * found[-1], "it has not relaxed yet"
                simulation = simulation.cut(edge, down, 0.03) if cut else simulation
            simulation.step()
            found.append(simulation.reactions()[pulled, 2])
        return np.array(found)

    whole, divided = forces(cut=False), forces(cut=True)
    np.testing.assert_allclose(divided[60:], whole[60:], rtol=0.01)
