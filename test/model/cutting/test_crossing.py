"""Which cells a sheet divides, and by how much: closed forms, and what is refused."""

import numpy as np
import pytest

from helpers.bars import bar
from helpers.scenes import ball_of_cells
from tissue_sim.errors import UserError
from tissue_sim.model.cutting.crossing import SECTIONS, crossing_among, fractions_of, section_of
from tissue_sim.model.cutting.sheet import sheet_of

DOWN = [0.0, 0.0, -1.0]
ACROSS = [[0.054, -0.01, 0.021], [0.054, 0.03, 0.021]]  # of the bar


def test_fractions_are_those_of_sampled_cells():
    rng = np.random.default_rng(0)
    height = rng.normal(size=(40, 4))
    height = height[(height.min(axis=1) < 0.0) & (height.max(axis=1) > 0.0)]
    inside = rng.dirichlet(np.ones(4), 200_000)  # uniform in a cell
    found = (inside @ height.T > 0.0).mean(axis=0)
    np.testing.assert_allclose(fractions_of(height), found, atol=5e-3)
    np.testing.assert_allclose(fractions_of(height) + fractions_of(-height), 1.0, rtol=1e-13)


def test_small_fractions_are_accurate():
    height = np.array([[1e-6, -1.0, -1.0, -1.0]])
    assert fractions_of(height)[0] == pytest.approx(1e-18 / (1.0 + 1e-6) ** 3, rel=1e-9)


def test_sections_face_the_negative_side():
    corner = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    for pattern in range(1, 15):
        positive = np.array([[bool(pattern >> k & 1) for k in range(4)]])
        pairs = section_of(positive)[0]
        assert positive[0, pairs[:, 0]].all()
        assert not positive[0, pairs[:, 1]].any()
        points = corner[pairs].mean(axis=1)
        normal = np.cross(points[1] - points[0], points[2] - points[0])
        way = corner[~positive[0]].mean(axis=0) - corner[positive[0]].mean(axis=0)
        assert normal @ way > 0.0
    assert len(SECTIONS) == 16


def test_a_section_has_the_area_of_the_bar():
    organ = bar()
    found = crossing_among(organ.rest_positions, organ.cell_nodes, sheet_of(organ, ACROSS, DOWN, 0.03))[0]
    assert found.area == pytest.approx(0.02**2, rel=1e-12)
    np.testing.assert_array_equal(found.cut_fraction, 1.0)
    assert len(found.cells) == 24  # all of a layer of cubes


def test_the_front_is_moved_by_a_part_of_an_edge():
    organ = bar()
    found = crossing_among(organ.rest_positions, organ.cell_nodes, sheet_of(organ, ACROSS, DOWN, 0.011))[0]
    mean = 0.01 * (3.0 + 2.0 * np.sqrt(2.0) + np.sqrt(3.0)) / 6.0  # edges and diagonals of a cube
    assert found.advance == pytest.approx(0.6 * mean, rel=1e-12)
    assert found.area == pytest.approx(0.02 * 0.01, rel=0.02)  # the front cells' sections are sampled
    front = found.cut_fraction < 1.0
    assert 0 < front.sum() < len(found.cells)
    assert np.all((found.cut_fraction > 0.0) & (found.cut_fraction <= 1.0))


def test_no_node_lies_on_the_sheet():
    organ = bar()
    through = [[0.05, -0.01, 0.021], [0.05, 0.03, 0.021]]  # a layer of nodes
    found = crossing_among(organ.rest_positions, organ.cell_nodes, sheet_of(organ, through, DOWN, 0.03))[0]
    assert np.abs(found.height).min() > 1e-4
    assert found.area == pytest.approx(0.02**2, rel=1e-6)


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.5])
def test_a_corner_has_two_sides(angle):
    """An L, and points on both sides of each leg, before and behind its ends."""
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    organ = ball_of_cells(2, 60)
    corners = np.array([[-0.015, 0.0, 0.03], [0.0, 0.0, 0.03], [0.0, 0.015, 0.03]]) @ turn.T
    sheet = sheet_of(organ, corners, DOWN, 0.02)
    points = [[-0.01, 0.002, 0], [-0.03, 0.002, 0], [-0.002, 0.01, 0], [-0.002, 0.05, 0], [-0.001, 0.001, 0]]
    others = [[-0.01, -0.002, 0], [-0.03, -0.002, 0], [0.002, 0.01, 0], [0.002, 0.05, 0], [0.001, -0.001, 0]]
    within, beyond = (sheet.place(np.array(some) @ turn.T) for some in (points, others))
    assert len({*np.sign(within.across)}) == len({*np.sign(beyond.across)}) == 1
    assert np.sign(within.across[0]) == -np.sign(beyond.across[0])
    np.testing.assert_allclose(np.abs(within.across), [0.002, 0.002, 0.002, 0.002, 0.001], rtol=1e-9)
    np.testing.assert_allclose(within.along[:4], [0.005, -0.015, 0.025, 0.065], rtol=1e-9)
    np.testing.assert_allclose(within.below, 0.03, rtol=1e-9)


def test_it_begins_at_the_surface_wherever_the_polyline_is_given():
    organ = ball_of_cells(2, 60)
    high, low = (sheet_of(organ, [[-0.01, 0, z], [0.01, 0, z]], DOWN, far) for z, far in ((0.04, 0.03), (0.025, 0.015)))
    assert high.reached == pytest.approx(0.02, abs=1e-3)
    assert low.reached == pytest.approx(high.reached, rel=1e-9)


ABOVE = [[-0.01, 0.0, 0.03], [0.01, 0.0, 0.03]]
BAD = {
    "a point": ([[0.0, 0.0, 0.03]], DOWN, 0.01, "polyline has shape"),
    "words": ("here", DOWN, 0.01, "polyline has shape"),
    "NaN": ([[np.nan, 0.0, 0.0], [0.0, 0.0, 0.03]], DOWN, 0.01, "not finite"),
    "direction": (ABOVE, [0.0, 0.0, np.inf], 0.01, "direction is"),
    "no direction": (ABOVE, [0.0, 0.0, 0.0], 0.01, "no length"),
    "depth": (ABOVE, DOWN, np.nan, "depth is"),
    "upward": (ABOVE, DOWN, -0.01, "outside 0..10"),
    "twice": ([ABOVE[0], ABOVE[0]], DOWN, 0.01, "lie on each other"),
    "along": ([[0.0, 0.0, 0.05], [0.0, 0.0, 0.03]], DOWN, 0.01, "behind each other"),
    "elsewhere": ([[1.0, 0.0, 0.03], [1.1, 0.0, 0.03]], DOWN, 0.1, "misses organ 'ball'"),
    "above": ([[-0.01, 0.0, 0.06], [0.01, 0.0, 0.06]], DOWN, 0.02, "misses organ 'ball'"),
    "shallow": ([[-0.001, 0.0, 0.03], [0.001, 0.0, 0.03]], DOWN, 0.002, "too shallow.*cut at least"),
    "deep inside": ([[-0.01, 0.0, 0.0], [0.01, 0.0, 0.0]], DOWN, 0.01, "begins 30 mm inside|begins 29.. mm inside"),
    "doubled": (
        [[-0.02, 0, 0.03], [0.02, 0, 0.03], [0.02, 0.004, 0.03], [-0.02, 0.004, 0.03]],
        DOWN,
        0.02,
        "another part of itself",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_in_one_line(case):
    polyline, direction, depth, reason = BAD[case]
    with pytest.raises(UserError, match=reason) as error:
        sheet_of(ball_of_cells(2, 60), polyline, direction, depth)
    assert "\n" not in str(error.value)
