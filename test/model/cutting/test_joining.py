"""Cuts that lie in one surface: they divide cells as one cut, and the tissue between two of them stays whole."""

from functools import cache

import numpy as np
import pytest

from helpers.bars import bar
from helpers.cuts import assert_whole, closed_surface, cut
from tissue_sim.errors import UserError
from tissue_sim.model.cutting import cut_surface as surface_module
from tissue_sim.model.cutting.crossing import crossing_among
from tissue_sim.model.cutting.cut import cut_again
from tissue_sim.model.cutting.sheet import sheet_of
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ

DOWN, BESIDE = [0.0, 0.0, -1.0], 0.009  # m, where the bar is cut along its axis
INTO = [0.0, 1.0, 0.0]


def along(first, last, depth=0.05, beside=BESIDE):
    """A cut of the bar along its axis, from one place to another."""
    return [[first, beside, 0.021], [last, beside, 0.021]], DOWN, depth


def kidney_cut(first, last, depth=0.03, height=0.0):
    return [[first, height, 0.0], [last, height, 0.0]], INTO, depth


LONG = kidney_cut(0.055, 0.063)


@cache
def kidney():
    return Organ.shipped()


def assert_same(one, other):
    """Both organs are divided in the same way."""
    np.testing.assert_array_equal(one.organ.cell_nodes, other.organ.cell_nodes)
    np.testing.assert_array_equal(one.organ.virtual_of, other.organ.virtual_of)
    np.testing.assert_allclose(one.fraction, other.fraction, rtol=1e-12)
    np.testing.assert_array_equal(one.surface.triangles, other.surface.triangles)
    rest = one.organ.rest_positions
    np.testing.assert_allclose(one.surface.at(rest), other.surface.at(rest), atol=1e-12)


def uncut_area(made, organ):
    """The area of the bar's section along its axis that isn't cut, m^2, by the stiffness that remains."""
    crossing, samples = crossing_among(organ.rest_positions, organ.cell_nodes, sheet_of(organ, *along(-0.01, 0.13)))
    whole = np.bincount(made.cell_of, np.where((made.sides == 0).all(axis=1), made.fraction, 0.0))
    return float(samples.weight.sum(axis=1) @ whole[crossing.cells])


# next to each other ---------------------------------------------------------------------------------
def test_two_cuts_that_adjoin_are_one():
    made, at_once = cut(bar(), along(-0.01, 0.05), along(0.05, 0.13)), cut(bar(), along(-0.01, 0.13))
    assert_same(made, at_once)
    assert [report.pieces for report in made.reports] == [1, 2]
    assert made.reports[0].area + made.reports[1].area == pytest.approx(0.12 * 0.02, rel=0.02)
    volumes = sorted(piece.volume for piece in closed_surface(made).split(only_watertight=True))
    np.testing.assert_allclose(volumes, [0.12 * 0.02 * y for y in (BESIDE, 0.02 - BESIDE)], rtol=1e-9)


@pytest.mark.parametrize("gap", [0.008, 0.012])
def test_half_of_the_tissue_between_two_cuts_stays_whole(gap):
    """Each front by itself is moved by more than 0.7 cm, so that both would meet."""
    organ = bar()
    made = cut(organ, along(-0.01, 0.05), along(0.05 + gap, 0.13))
    assert_whole(made, organ)
    assert made.reports[-1].pieces == 1
    assert uncut_area(made, organ) == pytest.approx(0.5 * gap * 0.02, rel=0.1)
    assert uncut_area(cut(organ, along(-0.01, 0.13)), organ) == 0.0
    assert uncut_area(cut(organ, along(-0.01, 0.05)), organ) < (0.07 - 0.007) * 0.02


def opening(*cuts):
    """How far the free end of the bar opens under two small loads that pull its halves apart."""
    simulation = Simulation(bar())
    for one in cuts:
        simulation = simulation.cut(*one)
    x = bar().surface_positions
    load = np.zeros((bar().n_surface, 3))
    for side, y in ((1.0, 0.02), (-1.0, 0.0)):
        end = np.flatnonzero((x[:, 0] > 0.1199) & (np.abs(x[:, 1] - y) < 1e-9))
        load[end, 1] = side * 1e-4 / len(end)
    moved, settled = simulation.settle(load)
    assert settled
    return float((load * moved[: len(load)]).sum() / 1e-4)


def test_what_is_between_two_cuts_holds_the_halves_together():
    """Each half is a beam that bends from its clamp, or from the tissue between, halfway along it."""
    through, between = opening(along(-0.01, 0.13)), opening(along(-0.01, 0.05), along(0.062, 0.13))
    assert 0.5**3 * through < between < 0.5 * through


def test_open_lips_go_on_when_a_cut_is_made_in_their_surface():
    simulation = Simulation(kidney()).cut(*LONG)
    near = [
        int(np.argmin(np.linalg.norm(kidney().surface_positions - [0.059, -0.002, side], axis=1)))
        for side in (0.006, -0.006)
    ]
    for then in (None, kidney_cut(0.068, 0.076), kidney_cut(0.055, 0.063, 0.025), kidney_cut(0.076, 0.05)):
        simulation = simulation.cut(*then) if then else simulation
        for _ in range(50):
            simulation.apply_force(near, [[0.0, 0.0, 0.02], [0.0, 0.0, -0.02]])
            simulation.step()
        assert np.linalg.norm(simulation.velocities, axis=1).max() < 0.5
    simulation.step(200)
    assert np.isfinite(simulation.cut_organ.surface.at(simulation.positions)).all()
    assert simulation.state.count.faults == 0


def test_a_third_cut_through_what_is_between_joins_them():
    made = cut(bar(), along(-0.01, 0.05), along(0.062, 0.13), along(0.045, 0.07))
    assert_same(made, cut(bar(), along(-0.01, 0.13)))
    assert len(made.sheets) == 3
    assert made.reports[-1].pieces == 2


def test_their_order_does_not_matter():
    one, other = (
        cut(bar(), *cuts) for cuts in ((along(-0.01, 0.05), along(0.06, 0.1)), (along(0.06, 0.1), along(-0.01, 0.05)))
    )
    assert_same(one, other)
    np.testing.assert_array_equal(one.sides, other.sides[:, ::-1])


@pytest.mark.parametrize("gap", [0.0, 0.002, 0.005, 0.012])
def test_two_cuts_of_the_kidney_side_by_side_both_exist(gap):
    cuts = kidney_cut(0.055, 0.063), kidney_cut(0.063 + gap, 0.071 + gap)
    made = cut(kidney(), *cuts)
    assert_whole(made, kidney(), volume=1e-4)
    assert len(made.sheets) == 2
    for number, one in enumerate(cuts):
        alone = cut(kidney(), one)
        assert made.reports[number].area == pytest.approx(alone.reports[0].area, rel=1e-9)
        middle = made.surface.at(made.organ.rest_positions)[made.surface.triangles[made.surface.wall == number + 1]]
        x = middle.mean(axis=(0, 1))[0]
        assert one[0][0][0] < x < one[0][1][0], "its walls are where it is"


# within each other -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "within",
    [
        kidney_cut(0.055, 0.063, 0.029),
        kidney_cut(0.055, 0.063, 0.025),
        kidney_cut(0.057, 0.061),
        kidney_cut(0.063, 0.055),
        kidney_cut(0.055, 0.063, height=-0.004),
    ],
    ids=["shallower", "much shallower", "shorter", "reversed", "from above"],
)
def test_a_path_within_a_cut_changes_nothing(within):
    before = cut(kidney(), LONG)
    made = cut_again(before, sheet_of(kidney(), *within))
    assert_same(made, before)
    np.testing.assert_array_equal(made.organ.mass, before.organ.mass)
    np.testing.assert_array_equal(made.origin(before), np.arange(before.organ.n_nodes))
    assert len(made.reports) == 1
    assert made.reports[0].area == before.reports[0].area
    assert "nothing has changed" in str(made.reports[0])
    assert "nothing has changed" not in str(before.reports[0])


@pytest.mark.parametrize(
    "more",
    [kidney_cut(0.05, 0.07), kidney_cut(0.07, 0.05), kidney_cut(0.055, 0.063, 0.035), kidney_cut(0.05, 0.07, 0.04)],
    ids=["longer", "longer and reversed", "deeper", "both"],
)
def test_a_cut_that_includes_another_continues_it(more):
    made, at_once = cut(kidney(), LONG, more), cut(kidney(), more)
    assert_same(made, at_once)
    assert len(made.reports) == 1
    assert made.reports[0].area == at_once.reports[0].area
    assert set(np.unique(made.surface.wall)) == {0, 1}


@pytest.mark.parametrize(
    ("first", "then"),
    [
        (along(-0.01, 0.05), along(0.13, -0.01)),
        (along(-0.01, 0.05), along(0.07, 0.03)),
        (along(-0.01, 0.05, beside=0.01 + 1e-9), along(-0.01, 0.13, beside=0.01 - 1e-9)),
        (along(-0.01, 0.05, beside=0.01 + 1e-9), along(0.03, 0.09, beside=0.01 - 1e-9)),
    ],
    ids=["reversed", "reversed and beyond", "on nodes", "on nodes and beyond"],
)
def test_open_lips_keep_their_sides(first, then):
    before = cut(bar(), first)
    made = cut_again(before, sheet_of(bar(), *then))
    assert_whole(made, bar())
    side = before.sides[:, 0]
    place, way = made.continued[0]
    mine, origin = way * made.sides[:, place], made.origin(before)
    for copy in np.flatnonzero(side):
        (there,) = np.flatnonzero((made.cell_of == before.cell_of[copy]) & (mine == side[copy]))
        np.testing.assert_array_equal(origin[made.organ.cell_nodes[there]], before.organ.cell_nodes[copy])


# nearly in one surface -------------------------------------------------------------------------------
@pytest.mark.parametrize("offset", [1e-12, -1e-9, 1e-6, -1e-5, 1e-4])
def test_a_cut_nearly_in_the_surface_of_another_is_in_it(offset):
    polyline, direction, depth = kidney_cut(0.06, 0.07, 0.025)
    beside = np.array(polyline) + [0.0, 0.0, offset]
    made, exact = (cut(kidney(), LONG, (line, direction, depth)) for line in (beside, polyline))
    assert_whole(made, kidney(), volume=1e-4)
    np.testing.assert_array_equal(made.organ.cell_nodes, exact.organ.cell_nodes)
    assert len(made.sheets) == 2


def test_a_cut_a_millimetre_beside_another_is_a_cut_of_its_own():
    made = cut(bar(), along(-0.01, 0.13), along(-0.01, 0.13, beside=BESIDE + 0.001))
    assert made.reports[-1].pieces == 3
    assert_whole(made, bar())


def test_a_cut_that_leaves_the_surface_of_another_is_refused_in_one_line():
    before = Simulation(bar()).cut(*along(-0.01, 0.08))
    away = [[0.03, BESIDE, 0.021], [0.06, BESIDE, 0.021], [0.13, 0.016, 0.021]], DOWN, 0.05
    with pytest.raises(UserError, match="partly in the surface of an earlier one") as error:
        before.cut(*away)
    assert "\n" not in str(error.value)
    assert len(before.cuts) == 1


def random_pair(organ, seed):
    """Two cuts in planes that are the same, nearly the same or parallel."""
    rng = np.random.default_rng(seed)
    node = rng.integers(organ.n_surface)
    direction = -organ.surface_normals[node] + 0.3 * (seed % 2) * rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    way = np.cross(direction, rng.normal(size=3))
    way /= np.linalg.norm(way)
    beside, start = np.cross(direction, way), organ.surface_positions[node] - 0.004 * direction
    for number in range(2):
        length, depth = rng.uniform(0.006, 0.025), rng.uniform(0.012, 0.04)
        middle = start + number * rng.uniform(-0.02, 0.02) * way
        offset = number * 10.0 ** rng.uniform(-12.0, -2.5) * beside * (seed % 3 > 0)
        turned = way + number * 10.0 ** rng.uniform(-6.0, -3.0) * beside * (seed % 3 == 2)
        ends = np.array([middle - 0.5 * length * turned, middle + 0.5 * length * turned]) + offset
        yield ends[:: rng.choice([-1, 1])], direction, depth


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(k, marks=pytest.mark.extended) for k in range(4, 60))])
def test_random_pairs_of_cuts_in_nearly_one_plane_are_closed(seed):
    try:
        made = cut(kidney(), *random_pair(kidney(), seed))
    except UserError as refused:
        pytest.skip(str(refused))
    assert_whole(made, kidney(), volume=1e-4)


# what is checked before the surface is used ----------------------------------------------------------
def test_a_surface_with_a_hole_or_without_a_place_is_refused(monkeypatch):
    points = surface_module._points
    monkeypatch.setattr(surface_module, "_points", lambda *given: _without_places(points(*given)))
    with pytest.raises(UserError, match="can't be closed"):
        cut(bar(), along(-0.01, 0.13))
    monkeypatch.undo()
    monkeypatch.setattr(surface_module, "hole_triangles", lambda *given: np.zeros((0, 3), dtype=np.int64))
    walls = surface_module._walls
    monkeypatch.setattr(surface_module, "_walls", lambda *given: walls(*given)[1:])
    with pytest.raises(UserError, match="can't be closed"):
        cut(bar(), along(-0.01, 0.13))


def _without_places(points):
    return points._replace(weights=np.full_like(points.weights, np.nan))
