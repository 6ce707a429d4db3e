"""Cuts that meet or cross: pieces, their closed forms, the surface, and the state that goes on."""

from functools import cache

import numpy as np
import pytest
import trimesh

from helpers.bars import bar
from helpers.cuts import assert_whole, closed_surface, cut
from helpers.scenes import ball_of_cells, changed
from helpers.slabs import THROUGH, slab
from tissue_sim.errors import UserError
from tissue_sim.model.elasticity.energy import energy_of
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.cell_mesh import with_cells
from tissue_sim.organ.inclusions import Inclusion
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.topology import assemble_like, cell_pieces

DOWN = [0.0, 0.0, -1.0]
AT, BESIDE = 0.054, 0.009  # m, where the bar is cut across and along
ACROSS = [[AT, -0.01, 0.021], [AT, 0.03, 0.021]], DOWN, 0.05
ALONG = [[-0.01, BESIDE, 0.021], [0.13, BESIDE, 0.021]], DOWN, 0.05
TO_IT = [[AT, BESIDE, 0.021], [0.13, BESIDE, 0.021]], DOWN, 0.05  # ends at ACROSS, as a T
LEVEL = [[-0.01, -0.001, 0.011], [0.13, -0.001, 0.011]], [0.0, 1.0, 0.0], 0.05
BALL = [[-0.04, 0.001, 0.03], [0.04, 0.001, 0.03]], DOWN
OVER = [[0.002, -0.04, 0.03], [0.002, 0.04, 0.03]], DOWN
SLANTED = [[-0.03, -0.03, 0.03], [0.03, 0.032, 0.03]], DOWN
NEXT_TO = [[-0.04, 0.002, 0.03], [0.04, 0.002, 0.03]], DOWN  # within the same cells as BALL


@cache
def parted(*names):
    both = {"across": ACROSS, "along": ALONG, "to it": TO_IT, "level": LEVEL}
    return cut(bar(), *(both[name] for name in names))


@pytest.mark.parametrize(
    ("names", "volumes"),
    [
        (("along", "level"), [0.12 * y * z for y in (0.009, 0.011) for z in (0.009, 0.011)]),
        (("across", "along"), [x * y * 0.02 for x in (AT, 0.12 - AT) for y in (0.009, 0.011)]),
        (("across", "to it"), [AT * 0.02**2, *((0.12 - AT) * y * 0.02 for y in (0.009, 0.011))]),
        (
            ("across", "along", "level"),
            [x * y * z for x in (AT, 0.12 - AT) for y in (0.009, 0.011) for z in (0.009, 0.011)],
        ),
    ],
    ids=["in four", "crosswise", "T", "in eight"],
)
def test_a_bar_is_cut_into_closed_pieces_of_their_own_volumes(names, volumes):
    made = parted(*names)
    assert made.reports[-1].pieces == len(volumes)
    assert_whole(made, bar())
    found = sorted(piece.volume for piece in closed_surface(made).split(only_watertight=True))
    np.testing.assert_allclose(found, sorted(volumes), rtol=1e-9)


def labels(organ):
    """The piece of each node."""
    return cell_pieces(organ.cell_nodes, organ.n_nodes)


@pytest.mark.parametrize("cuts", [(ACROSS, TO_IT), (ACROSS, ALONG, LEVEL)], ids=["T", "in eight"])
def test_each_piece_has_the_energy_of_its_own_volume(cuts):
    """Free pieces are stretched differently, each by itself, as neo-Hookean bars are in closed form."""
    made = Simulation(bar())
    for one in cuts:
        made = made.cut(*one)
    organ, piece = made.organ, labels(made.organ)
    mu, lam = organ.lame_moduli
    volume = np.bincount(
        piece[organ.cell_nodes[:, 0]],
        made.cut_organ.fraction * np.abs(np.linalg.det(cell_edges(bar(), made.cut_organ.cell_of))) / 6.0,
        piece.max() + 1,
    )
    free = np.setdiff1d(np.unique(piece), piece[organ.fixed])
    assert len(free) == made.cuts[-1].free_pieces
    assert volume[free].sum() == pytest.approx((0.12 - AT) * 0.02**2, rel=1e-12)
    x, wanted, rng = made.model.rest.copy(), 0.0, np.random.default_rng(3)
    for one in free:
        stretch = rng.uniform(0.9, 1.2, 3)
        x[piece == one] *= stretch
        swelling = np.prod(stretch)
        density = 0.5 * mu * (np.sum(np.square(stretch)) - 3.0 - 2.0 * np.log(swelling))
        density += 0.25 * lam * (swelling**2 - 1.0 - 2.0 * np.log(swelling))
        wanted += density * volume[one]
    assert energy_of(made.model, x, np.zeros_like(x)).elastic == pytest.approx(wanted, rel=1e-12)
    pushed = np.zeros_like(x)
    elastic_forces(made.model, x, 1.0, pushed)
    for one in free:
        assert np.abs(pushed[piece == one].sum(axis=0)).max() < 1e-12 * np.abs(pushed).max()


def cell_edges(organ, cells):
    corner = organ.rest_positions[organ.cell_nodes[cells]]
    return corner[:, 1:] - corner[:, :1]


def test_a_piece_between_two_cuts_moves_by_its_own_mass():
    organ = changed(bar(), damping=0.0)
    made = Simulation(organ).cut(*ACROSS).cut(*TO_IT)
    piece = labels(made.organ)
    end = np.flatnonzero((organ.surface_positions[:, 0] > 0.1199) & (organ.surface_positions[:, 1] < 0.001))
    mine = piece == piece[end[0]]
    force = np.zeros((len(end), 3))
    force[:, 0] = 0.01 / len(end)
    made.positions[mine] += [1e-3, -1e-3, 0.0]  # apart from the others
    for _ in range(20):
        made.apply_force(end, force)
        made.step()
    momentum = made.organ.mass[mine] @ made.velocities[mine]
    np.testing.assert_allclose(momentum, [0.01 * 0.02, 0.0, 0.0], rtol=1e-9, atol=1e-15)
    assert np.abs(made.velocities[~mine]).max() < 1e-12


BALL_CUTS = {
    "crosswise": ((*BALL, 0.07), (*OVER, 0.07)),
    "shallow": ((*BALL, 0.02), (*OVER, 0.02)),
    "shallow and deep": ((*BALL, 0.02), (*OVER, 0.07)),
    "three": ((*BALL, 0.07), (*OVER, 0.07), (*SLANTED, 0.07)),
    "side by side": ((*BALL, 0.07), (*NEXT_TO, 0.07)),
}
PIECES = {"crosswise": 4, "shallow": 1, "shallow and deep": 2, "three": 7, "side by side": 3}


@pytest.mark.parametrize("name", BALL_CUTS)
def test_nothing_is_lost_where_cuts_of_a_ball_meet(name):
    organ = ball_of_cells(2, 60)
    made = cut(organ, *BALL_CUTS[name])
    assert_whole(made, organ)
    assert made.reports[-1].pieces == PIECES[name]
    assert set(np.unique(made.surface.wall)) == set(range(len(BALL_CUTS[name]) + 1))


@pytest.mark.parametrize("name", ["crosswise", "shallow and deep", "side by side"])
def test_the_order_of_cuts_that_meet_does_not_matter(name):
    organ = ball_of_cells(2, 60)
    one, other = cut(organ, *BALL_CUTS[name]), cut(organ, *BALL_CUTS[name][::-1])
    np.testing.assert_array_equal(one.organ.cell_nodes, other.organ.cell_nodes)
    np.testing.assert_allclose(one.organ.mass, other.organ.mass, rtol=1e-12)
    np.testing.assert_array_equal(one.sides, other.sides[:, ::-1])


def test_a_cut_that_ends_at_another_does_not_tear_what_is_beyond():
    """The front is not moved through the wall of the other cut; by itself, it is."""
    made, alone = parted("across", "to it"), cut(bar(), TO_IT)
    middle = bar().rest_positions[bar().cell_nodes].mean(axis=1)[:, 0]
    assert middle[alone.cell_of[alone.sides[:, 0] != 0]].min() < AT - 0.005
    across, along = made.sides.T
    held_side = np.sign(made.sheets[0].place(np.array([[0.02, 0.01, 0.01]])).across[0])
    beyond = (across == held_side) | ((across == 0) & (middle[made.cell_of] < AT))
    torn = np.intersect1d(made.cell_of[beyond & (along == 1)], made.cell_of[beyond & (along == -1)])
    assert not len(torn)


@pytest.mark.parametrize(("depth", "change"), [(0.07, 1e-12), (0.02, 1e-3)], ids=["through", "at a front"])
def test_at_the_moment_of_a_crossing_cut_nothing_jumps(depth, change):
    """Energy, and the forces on all copies of a node together, are those of the organ that was cut before.

    Where the front of the first cut is in the cells that the second one divides, each part of these has a share of its
    own, and energy changes by parts of a thousandth.
    """
    organ = ball_of_cells(2, 60)
    before = Simulation(organ).cut(*BALL, depth)
    top = [int(np.argmax(organ.surface_positions[:, 2]))]
    for _ in range(30):
        before.apply_force(top, [[0.1, 0.15, 0.2]])  # compressed cells have a penalty that depends on masses
        before.step()
    x = before.positions.copy()
    after = before.cut(*OVER, 0.03)
    np.testing.assert_array_equal(after.positions[: organ.n_nodes], x[: organ.n_nodes])
    origin = after.cut_organ.origin(before.cut_organ)
    np.testing.assert_array_equal(after.positions, x[origin])
    assert after.energy.elastic == pytest.approx(before.energy.elastic, rel=change)
    found, wanted = (np.zeros((organ.n_nodes, 3)) for _ in range(2))
    for simulation, sums in ((after, found), (before, wanted)):
        pushed = np.zeros_like(simulation.positions)
        elastic_forces(simulation.model, simulation.positions, 1.0, pushed)
        np.add.at(sums, np.concatenate([np.arange(organ.n_nodes), simulation.organ.virtual_of]), pushed)
    np.testing.assert_allclose(found, wanted, atol=30.0 * change * np.abs(wanted).max())
    assert after.cuts[1].critical_step_after > 0.9 * after.cuts[0].critical_step_before
    after.step(200)
    assert np.isfinite(after.positions).all()


def test_a_slab_in_four_pressed_together_is_nearly_as_stiff_as_before():
    """Lips don't touch along the line where cuts cross, for a cell's width: something is missing there, and no more."""
    level = [[-0.01, -0.001, 0.0165], [0.05, -0.001, 0.0165]], [0.0, 1.0, 0.0], 0.05
    way = -0.001

    def reaction(simulation):
        x = simulation.organ.surface_positions[:, 0]
        end = np.flatnonzero(x > x.max() - 1e-9)
        simulation.prescribe(end, simulation.organ.surface_positions[end] + [way, 0.0, 0.0], 50)
        simulation.step(600)
        return simulation.reactions()[end, 0].sum()

    whole, made = reaction(Simulation(slab("left"))), Simulation(slab("left")).cut(*THROUGH).cut(*level)
    assert made.cuts[-1].pieces == 4
    assert reaction(made) == pytest.approx(whole, rel=0.03)


def test_a_tumour_is_cut_with_its_own_moduli():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.012)
    lump = Inclusion(np.asarray(ball.vertices) + [0.0, 0.0, 0.01], np.asarray(ball.faces, dtype=np.int32), 8.0)
    organ = with_cells(assemble_like(ball_of_cells(2, 60), inclusions=(lump,), interior_atoms=60, interior_layer=0.7))
    made = cut(organ, *BALL_CUTS["shallow and deep"])
    assert_whole(made, organ)
    np.testing.assert_allclose(made.organ.cell_mu, made.fraction * organ.cell_mu[made.cell_of], rtol=1e-12)
    divided = made.cell_of[(made.sides != 0).any(axis=1)]
    assert np.ptp(organ.cell_mu[divided]) > 5.0 * organ.cell_mu.min()
    simulation = Simulation(organ)
    for one in BALL_CUTS["shallow and deep"]:
        simulation = simulation.cut(*one)
    assert simulation.critical_step > 0.9 * Simulation(organ).critical_step


def random_cuts(organ, seed, count=2):
    """Cuts about one place of the surface, in directions of their own."""
    rng = np.random.default_rng(seed)
    node = rng.integers(organ.n_surface)
    point, normal = organ.surface_positions[node], organ.surface_normals[node]
    for _ in range(count):
        way = np.cross(normal, rng.normal(size=3))
        way *= rng.uniform(0.008, 0.025) / np.linalg.norm(way)
        bend = np.cross(normal, way) * rng.uniform(-0.4, 0.4)
        aside = np.cross(normal, rng.normal(size=3)) * rng.uniform(0.0, 0.006) + 0.003 * normal
        direction = -normal + 0.4 * (seed % 2) * rng.normal(size=3)
        yield np.array([point - way + bend, point, point + way + bend]) + aside, direction, rng.uniform(0.01, 0.04)


@pytest.mark.parametrize("seed", [0, 1, 2, *(pytest.param(seed, marks=pytest.mark.extended) for seed in range(3, 40))])
def test_random_cuts_of_the_kidney_that_meet_are_closed(seed):
    organ = Organ.shipped()
    try:
        made = cut(organ, *random_cuts(organ, seed, 2 + (seed % 4 == 0)))
    except UserError as refused:
        pytest.skip(str(refused))
    assert_whole(made, organ, volume=1e-4)
