"""Lips of a cut: they press on each other where they meet, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.bars import bar
from helpers.scenes import ball_of_cells, changed
from helpers.slabs import INCISION, THROUGH, slab
from helpers.states import assert_same
from tissue_sim.model.cutting.lips import lips_of
from tissue_sim.model.data.lips import make_lips
from tissue_sim.model.data.state import fields_of
from tissue_sim.model.elasticity.energy import energy_of
from tissue_sim.model.simulation import Simulation

BAR_THROUGH = [[0.054, -0.01, 0.021], [0.054, 0.03, 0.021]], [0.0, 0.0, -1.0], 0.05
BALL_CUT = [[-0.02, 0.001, 0.03], [0.02, 0.001, 0.03]], [0.0, 0.0, -1.0], 0.02


def without_lips(simulation):
    simulation.model = simulation.model._replace(lips=make_lips())
    simulation.refer()
    return simulation


def gaps(simulation):
    """Distance of both sides along the rest wall's normal, x, at each place, m."""
    lips, position = simulation.model.lips, simulation.positions
    return np.einsum("qe,qe->q", lips.weight, position[lips.upper, 0] - position[lips.lower, 0])


def far_end(organ):
    x = organ.surface_positions[:, 0]
    return np.flatnonzero(x > x.max() - 1e-9)


def reaction(simulation, way, ticks=600):
    """Force, N, with which the far end resists being moved by `way` m along x, at rest."""
    end = far_end(simulation.organ)
    simulation.prescribe(end, simulation.organ.surface_positions[end] + [way, 0.0, 0.0], 50)
    simulation.step(ticks)
    return simulation.reactions()[end, 0].sum()


def halves(simulation):
    """Nodes of the left piece and of the right one."""
    cells, cut = simulation.organ.cell_nodes, simulation.cut_organ
    right = np.zeros(simulation.organ.n_nodes, dtype=bool)
    middle = simulation.model.rest[cells].mean(axis=1)[:, 0] > 0.0215
    sided = np.where(cut.side == 0, np.where(middle, 1, -1), cut.side)
    if (sided > 0)[middle].mean() < 0.5:
        sided = -sided
    right[cells[sided > 0]] = True
    return ~right, right


@pytest.mark.parametrize("way", [-0.001, -0.003])
def test_a_slab_cut_through_and_pressed_together_is_as_stiff_as_before(way):
    """The traction across the cut is normal to it, so that lips without friction carry all of it."""
    whole = reaction(Simulation(slab("left")), way)
    cut = Simulation(slab("left")).cut(*THROUGH)
    found = reaction(cut, way)
    assert whole < -0.2
    assert found == pytest.approx(whole, rel=0.01)
    assert np.abs(gaps(cut)).max() < 1e-5
    if way == -0.001:
        assert abs(reaction(without_lips(Simulation(slab("left")).cut(*THROUGH)), way)) < 1e-3


def test_a_slab_cut_through_and_pulled_apart_resists_nothing():
    cut = Simulation(slab("left")).cut(*THROUGH)
    assert abs(reaction(cut, 0.002)) < 1e-4
    assert gaps(cut).min() > 0.0019
    assert cut.model.lips.counts[1] == 0


def test_lips_that_are_apart_change_nothing():
    """Once they are apart, not a bit of any position."""
    both = [Simulation(slab("below")).cut(*INCISION), without_lips(Simulation(slab("below")).cut(*INCISION))]
    for simulation in both:
        end = far_end(simulation.organ)
        end = end[simulation.organ.surface_positions[end, 2] > 0.0101]
        simulation.prescribe(end, simulation.organ.surface_positions[end] + [0.004, 0.0, 0.0], 100)
    both[0].step(20)
    both[1].restore({name: array.copy() for name, array in fields_of(both[0].state).items()})
    for simulation in both:
        simulation.step(100)
    assert both[0].model.lips.counts[0] > 0
    np.testing.assert_array_equal(both[0].positions, both[1].positions)


def test_nothing_is_computed_while_there_is_no_cut():
    whole = Simulation(slab("left"))
    reaction(whole, -0.001, 20)
    assert (len(whole.model.lips.upper), whole.model.lips.counts.sum()) == (0, 0)
    cut = Simulation(slab("left")).cut(*THROUGH)
    reaction(cut, -0.001, 20)
    assert cut.model.lips.counts[0] == 20 * cut.settings.substeps


def test_pieces_that_collide_keep_their_momentum_and_gain_no_energy():
    organ = changed(slab(""), damping=0.0, return_stiffness=0.0)
    cut = Simulation(organ).cut(*THROUGH)
    cut.step()
    left, right = halves(cut)
    mass = cut.organ.mass
    cut.apply_force([0], [[1e-9, 0.0, 0.0]])  # awake
    cut.step()
    cut.state.velocity[left], cut.state.velocity[right] = [0.1, 0.0, 0.0], [-0.2, 0.0, 0.0]
    momentum = mass @ cut.velocities
    before = energies(cut)
    touched, most = 0, before
    for _ in range(60):
        cut.apply_force([0], [[0.0, 0.0, 0.0]])
        cut.step()
        touched = max(touched, int(cut.model.lips.counts[1]))
        np.testing.assert_allclose(mass @ cut.velocities, momentum, rtol=1e-9, atol=1e-9 * np.abs(momentum).max())
        most = max(most, energies(cut))
    assert touched > 20
    assert most < 1.01 * before
    assert energies(cut) > 0.3 * before  # most of it is in waves, as no damping takes it
    assert gaps(cut).min() > -5e-4
    speed = [mass[side] @ cut.velocities[side, 0] / mass[side].sum() for side in (left, right)]
    assert speed[0] < speed[1] + 0.02  # they don't go on through each other


def energies(simulation):
    energy = energy_of(simulation.model, simulation.positions, simulation.velocities)
    return energy.kinetic + energy.elastic


def test_forces_at_a_place_are_equal_opposite_and_along_the_normal():
    cut = Simulation(slab("left")).cut(*THROUGH)
    reaction(cut, -0.002, 100)
    lips = cut.model.lips
    contacts = lips.contacts[: lips.counts[2]]
    assert (contacts.pressed > 0.0).sum() > 50
    np.testing.assert_allclose(contacts.weight.sum(axis=1), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(contacts.normal, axis=1), 1.0, rtol=1e-12)
    # The resultant across the cut is the reaction of the end.
    step = cut.settings.tick_time / int(cut.state.status.substeps)
    across = (contacts.pressed[:, None] * contacts.normal).sum(axis=0) / step
    cut.step(500)
    contacts = lips.contacts[: lips.counts[2]]
    across = (contacts.pressed[:, None] * contacts.normal).sum(axis=0) / step
    assert abs(across[0]) == pytest.approx(abs(cut.reactions()[far_end(cut.organ), 0].sum()), rel=0.01)


@pytest.mark.parametrize("turned", [False, True])
def test_places_lie_on_each_other_at_rest_and_normals_point_to_the_upper_side(turned):
    organ = ball_of_cells(2, 60)
    line, direction, depth = BALL_CUT
    if turned:
        line = line[::-1]
    made = Simulation(organ).cut(line, direction, depth)
    lips, rest = made.model.lips, made.model.rest
    upper = np.einsum("qe,qex->qx", lips.weight, rest[lips.upper])
    lower = np.einsum("qe,qex->qx", lips.weight, rest[lips.lower])
    np.testing.assert_array_equal(upper, lower)
    assert len(lips.upper) > 40
    apart = (lips.upper != lips.lower).any(axis=1)
    assert 0 < (~apart).sum() < apart.sum()  # both sides meet at the front
    # One of the edge's nodes is on each side, and there it is not a virtual one.
    sheet = made.cut_organ.sheets[0]
    for nodes, side in ((lips.upper[apart], 1.0), (lips.lower[apart], -1.0)):
        across = side * sheet.place(rest[nodes].reshape(-1, 3)).across.reshape(nodes.shape)
        assert ((nodes < organ.n_nodes) & (across > 0.0)).any(axis=1).all()
    corner = upper[lips.triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    shifted = sheet.place(corner.mean(axis=1) - 1e-4 * normal / np.linalg.norm(normal, axis=1, keepdims=True)).across
    assert (shifted - sheet.place(corner.mean(axis=1)).across > 0.0).mean() > 0.95


def test_lips_that_have_slid_past_each_other_do_not_touch():
    """A flap that was moved sideways by more than a cell, and lies lower, presses on nothing."""
    cut = Simulation(bar()).cut(*BAR_THROUGH)
    lips = cut.model.lips
    _, right = halves_of_bar(cut)
    for slid, touches in ((0.5, True), (1.5, False)):
        cut.reset()
        cut.apply_force([0], [[0.0, 0.0, 0.0]])
        shift = slid * lips.slide.max()
        cut.positions[right] += [-1e-3, shift, 0.0]
        cut.step()
        assert (lips.counts[2] > 0) == touches, slid


def test_only_places_that_have_not_slid_far_touch():
    """Of a piece that was twisted about the bar's axis those near it."""
    cut = Simulation(bar()).cut(*BAR_THROUGH)
    lips, rest = cut.model.lips, cut.model.rest
    _, right = halves_of_bar(cut)
    axis, turn = np.array([0.0, 0.01, 0.01]), Rotation.from_rotvec([2.0, 0.0, 0.0])
    cut.apply_force([0], [[0.0, 0.0, 0.0]])
    cut.positions[right] = turn.apply(rest[right] - axis) + axis - [1e-3, 0.0, 0.0]
    cut.step()
    place = np.einsum("qe,qex->qx", lips.weight, rest[lips.upper])
    slid = 2.0 * np.sin(1.0) * np.linalg.norm((place - axis)[:, 1:], axis=1)
    assert 0 < (slid < lips.slide).sum() < 0.5 * len(slid)
    assert lips.counts[2] == (slid < lips.slide).sum()


def halves_of_bar(cut):
    right = np.zeros(cut.organ.n_nodes, dtype=bool)
    cells = cut.organ.cell_nodes
    middle = cut.model.rest[cells].mean(axis=1)[:, 0]
    sided = np.where(cut.cut_organ.side == 0, np.where(middle > 0.054, 1, -1), cut.cut_organ.side)
    if middle[sided > 0].mean() < 0.054:
        sided = np.where(cut.cut_organ.side == 0, sided, -cut.cut_organ.side)
    right[cells[sided > 0]] = True
    return ~right, right


def test_an_organ_without_a_cut_has_no_lips():
    made = Simulation(ball_of_cells(2, 60)).cut(*BALL_CUT)
    surface = made.cut_organ.surface
    outer = surface.wall == 0
    alone = surface._replace(triangles=surface.triangles[outer], wall=surface.wall[outer])
    assert len(lips_of(alone, made.model.rest).upper) == 0


def test_a_continued_cut_has_lips_to_its_new_depth():
    line, direction, depth = INCISION
    first = Simulation(slab("below")).cut(line, direction, 0.5 * depth)
    second = first.cut(line, direction, depth)
    apart = [(one.model.lips.upper != one.model.lips.lower).any(axis=1).sum() for one in (first, second)]
    assert apart[1] > 1.5 * apart[0]
    rest = second.model.rest
    np.testing.assert_array_equal(
        np.einsum("qe,qex->qx", second.model.lips.weight, rest[second.model.lips.upper]),
        np.einsum("qe,qex->qx", second.model.lips.weight, rest[second.model.lips.lower]),
    )


def test_settling_counts_what_lips_press():
    organ = slab("below")
    cut = Simulation(replace(organ)).cut(*INCISION)
    force = np.zeros((organ.n_surface, 3))
    place = organ.surface_positions
    left, right = (place[:, 2] > 0.0199) & (place[:, 0] == 0.0), (place[:, 2] > 0.0199) & (place[:, 0] > 0.0399)
    force[left, 0], force[right, 0] = 0.3 / left.sum(), -0.3 / right.sum()
    _, settled = cut.settle(force, longest=3.0)
    assert settled
    assert cut.model.lips.counts[1] > 10


def test_a_run_goes_on_from_its_state_bit_for_bit():
    """Lips keep nothing from one substep to the next: a bag of a cut organ may begin anywhere."""
    first, second = (Simulation(slab("left")).cut(*THROUGH) for _ in range(2))
    reaction(first, -0.002, 60)
    assert first.model.lips.counts[1] > 20
    second.restore({name: array.copy() for name, array in fields_of(first.state).items()})
    for simulation in (first, second):
        simulation.step(60)
    assert_same(first, second)


def test_walls_that_do_not_face_each_other_do_not_touch():
    """A piece that was turned over by 90 degrees about the cut's edge, and lies behind the other wall."""
    cut = Simulation(bar()).cut(*BAR_THROUGH)
    lips = cut.model.lips
    _, right = halves_of_bar(cut)
    pivot = np.array([0.054, 0.01, 0.01])
    for turned, touches in ((0.1, True), (0.5 * np.pi, False)):
        cut.reset()
        cut.apply_force([0], [[0.0, 0.0, 0.0]])
        turn = Rotation.from_rotvec([0.0, turned, 0.0])
        cut.positions[right] = turn.apply(cut.model.rest[right] - pivot) + pivot
        cut.step()
        assert (lips.counts[2] > 0) == touches, turned
