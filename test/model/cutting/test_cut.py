"""A cut organ: pieces, masses, forces, the state that it continues with, and several cuts."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from helpers.bars import bar
from helpers.scenes import ball, ball_of_cells, changed
from tissue_sim.commands.build_refine import parse_refine
from tissue_sim.errors import UserError
from tissue_sim.model.elasticity.energy import energy_of
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.cell_mesh import with_cells
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.refined import refined
from tissue_sim.organ.topology import assemble_like

DOWN = [0.0, 0.0, -1.0]
AT = 0.054  # m, where the bar is cut
THROUGH = [[AT, -0.01, 0.021], [AT, 0.03, 0.021]], DOWN, 0.05
ACROSS_BALL = [[-0.02, 0.001, 0.03], [0.02, 0.001, 0.03]], DOWN, 0.02
L_SHAPED = [[-0.02, 0.001, 0.03], [0.001, 0.001, 0.03], [0.001, 0.02, 0.03]], DOWN, 0.02


def uneven(organ, seed=0):
    """The organ with cells of many stiffnesses."""
    factor = np.exp(0.7 * np.random.default_rng(seed).normal(size=(2, len(organ.cell_mu))))
    return replace(organ, cell_mu=factor[0] * organ.cell_mu, cell_lambda=factor[1] * organ.cell_lambda)


def labels(organ):
    """The piece of each node."""
    cells = organ.cell_nodes
    size = organ.n_nodes
    links = coo_array(
        (np.ones(3 * len(cells)), (cells[:, [0, 0, 0]].ravel(), cells[:, 1:].ravel())), shape=(size, size)
    )
    return connected_components(links, directed=False)[1]


def forces(simulation, x):
    pushed = np.zeros_like(x)
    elastic_forces(simulation.model, x, 1.0, pushed)
    return pushed


def energy(simulation, x):
    return energy_of(simulation.model, x, np.zeros_like(x)).elastic


def test_a_bar_cut_through_is_two_bars():
    """Each stretched by itself has the energy of a bar of its own length, as neo-Hookean bars have in closed form."""
    after = Simulation(bar()).cut(*THROUGH)
    assert (after.cuts[0].pieces, after.cuts[0].free_pieces) == (2, 1)
    rest, piece = after.model.rest, labels(after.organ)
    held = piece == piece[after.organ.fixed[0]]
    mu, lam = after.organ.lame_moduli
    x, wanted = rest.copy(), 0.0
    for chosen, length, stretch in ((held, AT, (1.2, 0.95, 1.0)), (~held, 0.12 - AT, (0.9, 1.0, 1.1))):
        x[chosen] *= stretch
        swelling = np.prod(stretch)
        density = 0.5 * mu * (np.sum(np.square(stretch)) - 3.0 - 2.0 * np.log(swelling))
        density += 0.25 * lam * (swelling**2 - 1.0 - 2.0 * np.log(swelling))
        wanted += density * length * 0.02**2
    assert energy(after, x) == pytest.approx(wanted, rel=1e-12)
    # Neither feels the other.
    pushed = forces(after, x)
    size = np.abs(pushed).max()
    alone = x.copy()
    alone[~held] = rest[~held]
    np.testing.assert_allclose(forces(after, alone)[held], pushed[held], atol=1e-12 * size)
    assert np.abs(pushed[~held].sum(axis=0)).max() < 1e-12 * size


def test_a_piece_that_is_cut_off_moves_by_its_own_mass():
    organ = changed(bar(), damping=0.0)
    after = Simulation(organ).cut(*THROUGH)
    piece = labels(after.organ)
    free = piece != piece[after.organ.fixed[0]]
    end = np.flatnonzero(organ.surface_positions[:, 0] > 0.1199)
    force = np.zeros((len(end), 3))
    force[:, 0] = 0.01 / len(end)
    after.positions[free] += [1e-4, 0.0, 0.0]  # apart: waves in the grid would press the lips on each other
    for _ in range(20):
        after.apply_force(end, force)
        after.step()
    momentum = after.organ.mass[free] @ after.velocities[free]
    np.testing.assert_allclose(momentum, [0.01 * 0.02, 0.0, 0.0], rtol=1e-9, atol=1e-15)
    assert np.abs(after.velocities[~free]).max() < 1e-12  # rounding of forces that are 0


@pytest.mark.parametrize("cut", [ACROSS_BALL, L_SHAPED], ids=["flat", "L"])
def test_what_is_not_cut_is_untouched(cut):
    organ = uneven(ball_of_cells(2, 60))
    after = Simulation(organ).cut(*cut).cut_organ
    n, c = organ.n_nodes, len(organ.cell_nodes)
    whole = after.side[:c] == 0
    assert 0 < whole.sum() < c
    for name in ("cell_nodes", "cell_mu", "cell_lambda"):
        np.testing.assert_array_equal(getattr(after.organ, name)[:c][whole], getattr(organ, name)[whole])
    alone = np.setdiff1d(np.arange(n), after.organ.virtual_of)
    np.testing.assert_array_equal(after.organ.mass[alone], organ.mass[alone])
    np.testing.assert_array_equal(after.organ.rest_positions[:n], organ.rest_positions)
    np.testing.assert_array_equal(after.organ.surface_triangles, organ.surface_triangles)


@pytest.mark.parametrize("cut", [ACROSS_BALL, L_SHAPED], ids=["flat", "L"])
def test_copies_add_up_to_their_cells(cut):
    organ = uneven(ball_of_cells(2, 60))
    after = Simulation(organ).cut(*cut).cut_organ
    np.testing.assert_allclose(np.bincount(after.cell_of, after.fraction), 1.0, rtol=1e-12)
    assert after.fraction.min() > 0.0
    np.testing.assert_allclose(after.organ.cell_mu, after.fraction * organ.cell_mu[after.cell_of], rtol=1e-12)
    source = np.concatenate([np.arange(organ.n_nodes), after.organ.virtual_of])
    for name in ("mass", "return_stiffness"):
        found = np.bincount(source, getattr(after.organ, name))
        np.testing.assert_allclose(found, getattr(organ, name), rtol=1e-12, atol=0.0)
    assert (after.organ.damping <= organ.damping[source]).all()  # see test_masses.py
    assert after.organ.mass.min() > 0.0


def test_at_the_moment_of_the_cut_nothing_jumps():
    """Mass, momentum, energy, and the forces on all copies of a node together are those before."""
    organ = uneven(ball_of_cells(2, 60))
    before = Simulation(organ)
    top = [int(np.argmax(organ.surface_positions[:, 2]))]
    for _ in range(30):
        before.apply_force(top, [[0.2, 0.3, 0.4]])
        before.step()
    x, v = before.positions.copy(), before.velocities.copy()
    after = before.cut(*L_SHAPED)
    np.testing.assert_array_equal(before.positions, x)
    source = np.concatenate([np.arange(organ.n_nodes), after.organ.virtual_of])
    np.testing.assert_array_equal(after.positions, x[source])
    np.testing.assert_array_equal(after.velocities, v[source])
    assert after.time == before.time
    assert after.energy.elastic == pytest.approx(before.energy.elastic, rel=1e-12)
    assert after.energy.kinetic == pytest.approx(before.energy.kinetic, rel=1e-12)
    np.testing.assert_allclose(after.organ.mass @ after.velocities, organ.mass @ v, rtol=1e-12)
    pushed = np.zeros_like(x)
    np.add.at(pushed, source, forces(after, after.positions))
    wanted = forces(before, x)
    np.testing.assert_allclose(pushed, wanted, atol=1e-12 * np.abs(wanted).max())


def test_lips_open_where_they_are_pulled_apart():
    organ = uneven(ball_of_cells(2, 60))
    x = organ.surface_positions
    right, left = (int(np.argmin(np.linalg.norm(x - [0.0, side, 0.028], axis=1))) for side in (0.006, -0.006))
    load = np.zeros((organ.n_surface, 3))
    load[right, 1], load[left, 1] = 0.05, -0.05

    def opening(simulation):
        moved, settled = simulation.settle(load)
        assert settled
        return moved[right, 1] - moved[left, 1]

    before = Simulation(organ)
    shallow = before.cut([[-0.02, 0.001, 0.03], [0.02, 0.001, 0.03]], DOWN, 0.015)
    deep = before.cut([[-0.02, 0.001, 0.03], [0.02, 0.001, 0.03]], DOWN, 0.025)
    gaps = [opening(one) for one in (before, shallow, deep)]
    assert gaps[1] > 1.5 * gaps[0]
    assert gaps[2] > gaps[1]


@pytest.mark.parametrize("cut", [ACROSS_BALL, L_SHAPED], ids=["flat", "L"])
def test_neither_rest_nor_a_rigid_motion_costs_energy(cut):
    after = Simulation(uneven(ball_of_cells(2, 60))).cut(*cut)
    rest = after.model.rest
    shaken = rest + 1e-3 * np.random.default_rng(1).standard_normal(rest.shape)
    size = np.abs(forces(after, shaken)).max()
    moved = Rotation.from_rotvec([0.4, -1.0, 0.7]).apply(rest) + [0.01, 0.02, -0.03]
    for x in (rest, moved):
        assert np.abs(forces(after, x)).max() < 1e-11 * size
        assert abs(energy(after, x)) < 1e-12 * energy(after, shaken)
    after.step(10)
    np.testing.assert_array_equal(after.positions, rest)


@pytest.mark.parametrize("seed", range(6))
def test_the_critical_step_remains_but_for_a_few_percent(seed):
    """Random cuts of a ball whose stiffness varies sixteenfold from cell to cell."""
    rng = np.random.default_rng(seed)
    organ = uneven(ball_of_cells(2, 60), seed)
    angle = rng.uniform(0.0, np.pi)
    way = np.array([np.cos(angle), np.sin(angle), 0.0])
    middle = np.array([*rng.uniform(-0.01, 0.01, 2), 0.03])
    after = Simulation(organ).cut([middle - 0.02 * way, middle + 0.02 * way], DOWN, rng.uniform(0.012, 0.06))
    assert after.cuts[0].critical_step_after >= 0.96 * after.cuts[0].critical_step_before
    assert after.cuts[0].critical_step_after == after.critical_step


def test_fixed_nodes_have_no_virtual_ones_and_still_come_apart():
    """A bar cut along its axis from the far end into the clamp: two halves, both held."""
    organ = bar()
    along = [[-0.01, 0.009, 0.021], [0.13, 0.009, 0.021]], DOWN, 0.05
    after = Simulation(organ).cut(*along)
    assert not np.isin(after.organ.virtual_of, organ.fixed).any()
    assert (after.cuts[0].pieces, after.cuts[0].free_pieces) == (2, 0)


# several cuts ------------------------------------------------------------------------------------
FIRST = [[0.034, -0.01, 0.021], [0.034, 0.03, 0.021]], DOWN, 0.012
SECOND = [[0.086, -0.01, 0.021], [0.086, 0.03, 0.021]], DOWN, 0.012


def test_the_order_of_cuts_does_not_matter():
    one = Simulation(bar()).cut(*FIRST).cut(*SECOND)
    other = Simulation(bar()).cut(*SECOND).cut(*FIRST)
    assert len(one.cuts) == 2
    assert one.cuts[0].area == other.cuts[1].area
    assert one.organ.mass.sum() == pytest.approx(bar().mass.sum(), rel=1e-12)
    load = np.zeros((bar().n_surface, 3))
    load[np.flatnonzero(bar().surface_positions[:, 0] > 0.1199), 2] = -1e-4
    (sunk, _), (same, _) = one.settle(load), other.settle(load)
    np.testing.assert_allclose(sunk, same, atol=1e-6 * np.abs(sunk).max())


def test_an_earlier_cut_keeps_its_nodes_and_its_opening():
    first = Simulation(bar()).cut(*FIRST)
    first.positions[first.organ.n_nodes - 1] += [0.001, 0.002, 0.003]
    first.velocities[first.organ.n_nodes - 1] += 0.1
    both = first.cut(*SECOND)
    n = first.organ.n_nodes
    np.testing.assert_array_equal(both.organ.virtual_of[: first.organ.n_virtual], first.organ.virtual_of)
    np.testing.assert_array_equal(both.positions[:n], first.positions)
    np.testing.assert_array_equal(both.velocities[:n], first.velocities)


def test_a_cut_is_continued_deeper():
    polyline, direction, _ = FIRST
    shallow = Simulation(bar()).cut(polyline, direction, 0.008)
    moved = shallow.organ.n_nodes - 1
    shallow.positions[moved] += [0.001, 0.0, 0.0]
    deep = shallow.cut(polyline, direction, 0.03)
    at_once = Simulation(bar()).cut(polyline, direction, 0.03)
    assert len(deep.cuts) == 1
    assert deep.cuts[0].pieces == 2
    np.testing.assert_array_equal(deep.organ.cell_nodes, at_once.organ.cell_nodes)
    np.testing.assert_array_equal(deep.organ.mass, at_once.organ.mass)
    # The virtual node that had moved is one still, where it was.
    there = np.abs(deep.positions - shallow.positions[moved]).max(axis=1) == 0.0
    assert there.sum() >= 1
    assert np.all(np.flatnonzero(there) >= bar().n_nodes)


# what is told and refused --------------------------------------------------------------------------
def test_a_shallow_cut_is_told_as_not_resolved():
    organ = ball_of_cells(2, 60)
    polyline = [[-0.01, 0.0, 0.03], [0.01, 0.0, 0.03]]
    shallow, deep = (Simulation(organ).cut(polyline, DOWN, depth).cuts[0] for depth in (0.01, 0.025))
    assert (shallow.resolved, deep.resolved) == (False, True)
    assert "not resolved: it is 9.6 mm deep, and needs " in str(shallow)
    assert "calibrate ORGAN --refine=-10.0,0.0," in str(shallow)
    assert "times as long" in str(shallow)
    assert "not resolved" not in str(deep)
    assert deep.area > shallow.area
    assert "2 pieces" in str(Simulation(bar()).cut(*THROUGH).cuts[0])


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: Simulation(ball()), "can't be cut; use model cells"),
        (lambda: Simulation(ball_of_cells(2, 60), local_region="modal"), "local_region off"),
        (lambda: Simulation(ball_of_cells(2, 60), gravity=[0.0, 0.0, -9.81]), "shape_gravity"),
        (lambda: Simulation(Simulation(ball_of_cells(2, 60)).cut(*ACROSS_BALL).organ), "was cut before"),
    ],
    ids=["springs", "region", "gravity", "saved"],
)
def test_what_cannot_be_cut_is_refused_in_one_line(make, reason):
    with pytest.raises(UserError, match=reason) as error:
        make().cut(*ACROSS_BALL)
    assert "\n" not in str(error.value)


def test_springs_and_new_cells_are_refused_where_an_organ_was_cut(tmp_path):
    organ = Simulation(ball_of_cells(2, 60)).cut(*ACROSS_BALL).organ
    with pytest.raises(UserError, match="was cut, and springs"):
        Simulation(organ, model="hybrid")
    with pytest.raises(UserError, match="was cut: its cells"):
        with_cells(organ)
    with pytest.raises(UserError, match="would heal"):
        assemble_like(organ)
    with pytest.raises(UserError, match="virtual_of names a node outside"):
        replace(organ, virtual_of=np.full(organ.n_virtual, organ.n_nodes - organ.n_virtual))
    organ.save(tmp_path / "cut.npz")
    back = Organ.load(tmp_path / "cut.npz")
    assert back.digest() == organ.digest()
    assert Simulation(back).critical_step == Simulation(organ).critical_step


def test_a_cut_organ_under_gravity_sags_and_prescribed_nodes_stay_prescribed():
    organ = bar()
    before = Simulation(organ, gravity=[0.0, 0.0, -1.0], shape_gravity=[0.0, 0.0, 0.0])
    held = np.flatnonzero(organ.surface_positions[:, 0] > 0.1199)
    before.prescribe(held, organ.surface_positions[held])
    before.step(3)
    after = before.cut(*FIRST)
    after.step(50)
    np.testing.assert_array_equal(after.positions[held], organ.surface_positions[held])
    middle = np.argmin(np.abs(organ.surface_positions[:, 0] - 0.06))
    assert after.positions[middle, 2] < organ.surface_positions[middle, 2]


def test_the_finer_organ_that_is_proposed_resolves_the_cut():
    organ = ball_of_cells(2, 60)
    polyline = [[-0.01, 0.0, 0.03], [0.01, 0.0, 0.03]]
    report = Simulation(organ).cut(polyline, DOWN, 0.01).cuts[0]
    words = report.finer.split("--refine=")[1].split(" ")[0]
    finer = with_cells(assemble_like(refined(organ, parse_refine([words])), interior_atoms=90, interior_layer=0.7))
    told = int(report.finer.split("about ")[1].split(" ")[0])
    assert finer.n_surface == pytest.approx(told, rel=0.25)
    again = Simulation(finer).cut(polyline, DOWN, 0.01).cuts[0]
    assert again.resolved_from < report.resolved_from
    assert again.depth >= 0.75 * again.resolved_from
