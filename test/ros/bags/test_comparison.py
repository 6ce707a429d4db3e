"""How far two runs are apart: the largest deviation, and the first tick beyond what is tolerated."""

import numpy as np
import pytest

from tissue_sim.ros.bags.comparison import Shown, compare


def shown(forces, surfaces=((0.0, 0.0, 0.0),)):
    """One tool's x-force at ticks 10, 11, ..., and a surface of one point at ticks 10, 20, ..."""
    wrenches = np.zeros((len(forces), 6))
    wrenches[:, 0] = forces
    points = np.array(surfaces, dtype=np.float32).reshape(-1, 1, 3)
    return Shown(["left"], [10 + np.arange(len(forces))], [wrenches], [10 * (1 + np.arange(len(points)))], [points])


def test_largest_and_first_beyond_are_distinguished():
    found = compare(shown([1.0, 1.0, 1.0, 1.0]), shown([1.0, 1.1, 1.5, 1.2]), 0.05, 1e-6)
    assert found.force.largest == pytest.approx(0.5)
    assert found.force.tick == 12
    assert found.force.first_beyond == found.first_beyond == 11
    assert found.torque.largest == found.position.largest == 0.0
    assert not found.passes


def test_the_first_of_all_quantities_counts():
    moved = ((1e-3, 0.0, 0.0), (0.0, 0.0, 0.0))
    found = compare(shown([0.0] * 5, moved), shown([0.0] * 4 + [1.0], ((0.0, 0.0, 0.0),) * 2), 0.1, 1e-6)
    assert (found.position.first_beyond, found.force.first_beyond) == (10, 14)
    assert found.first_beyond == 10


def test_what_is_tolerated_passes():
    assert compare(shown([1.0]), shown([1.05]), 0.1, 1e-6).passes


def test_no_number_is_off_by_infinity():
    found = compare(shown([1.0, 1.0]), shown([1.0, np.nan]), 1e9, 1.0)
    assert found.force.largest == np.inf
    assert found.force.first_beyond == 11


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("bits", [0x7FA00000, 0x7FC00000, 0x7F800000], ids=["signalling", "quiet", "infinite"])
def test_what_a_damaged_bag_calls_numbers_is_off_without_a_word(bits):
    damaged = shown([1.0])
    damaged.surfaces[0].view(np.uint32)[0, 0, 0] = bits
    assert compare(damaged, shown([1.0]), 1.0, 1.0).position.largest == np.inf
    assert not compare(damaged, damaged, 1.0, 1.0).passes


def test_nothing_to_compare_is_no_success():
    nothing = shown([], np.zeros((0, 3)))
    found = compare(nothing, nothing, 1.0, 1.0)
    assert found.is_empty_comparison
    assert not found.passes
    assert found.force.tick == found.first_beyond == -1


def test_ticks_of_several_tools_are_in_order():
    one = shown([1.0, 2.0])
    ticks, wrenches = [one.wrench_ticks[0] + 5, one.wrench_ticks[0]], [one.wrenches[0], one.wrenches[0]]
    both = Shown(["left", "right"], ticks, wrenches, one.surface_ticks, one.surfaces)
    off = Shown(["left", "right"], ticks, [wrenches[0] + 1.0, wrenches[1] + 1.0], one.surface_ticks, one.surfaces)
    found = compare(both, off, 0.5, 1.0)
    assert found.force.ticks.tolist() == [10, 11, 15, 16]
    assert found.force.first_beyond == 10


def test_a_part_of_the_ticks():
    part = shown([1.0, 2.0, 3.0], np.zeros((3, 3))).within(11, 20)
    assert part.wrench_ticks[0].tolist() == [11, 12]
    assert part.surface_ticks[0].tolist() == [20]
    assert part.later(5).wrench_ticks[0].tolist() == [16, 17]
