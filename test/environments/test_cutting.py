"""The task Cut: a path of the blade, the cut that it makes, and what is worth more or less."""

import numpy as np
import pytest

pytest.importorskip("gymnasium")

from helpers.scenes import ball_of_cells
from tissue_sim.environments.blade_path import LINE, MOST_FORCE
from tissue_sim.environments.cut_copies import MISSED, CutCopies
from tissue_sim.environments.policies import CutPolicy
from tissue_sim.environments.tasks import DECLARED

STEADY = np.array([2.0, 2.0, 1.0, 0.0, 0.0, 1.0])  # weights that slide along the line at the wanted depth


def begun(count=1, threads=1):
    copies = CutCopies("Cut", count, ball_of_cells(), threads=threads)
    copies.begin(np.arange(count), [np.random.default_rng(seed) for seed in range(count)])
    return copies


def path_along(copies, beside=0.0, depth=1.0, fraction=1.0):
    """A path (k, 4) along the line of the first copy, moved sideways by some m, with a part of the wanted depth."""
    half, outward = copies._half[0], copies._outward[0]
    across = np.cross(outward, half / np.linalg.norm(half))
    along = np.linspace(-fraction, fraction, 41)[:, None] * half
    points = copies._place[0] + along + beside * across
    points += (0.03 - np.linalg.norm(points, axis=1))[:, None] * points / np.linalg.norm(points, axis=1)[:, None]
    return [np.append(point, depth * copies._wanted[0]) for point in points]


def worth(**path):
    copies = begun()
    copies._paths[0].points = path_along(copies, **path)
    return copies._worth(0)


def test_a_cut_on_the_line_to_the_depth_is_worth_most():
    reward, is_good = worth()
    assert is_good
    assert reward > 0.8 * DECLARED


def test_a_cut_beside_the_line_too_short_too_shallow_or_pressed_too_hard_is_worth_less():
    best, _ = worth()
    near, is_good = worth(beside=0.001)
    assert is_good
    assert near == pytest.approx(best - DECLARED * 0.001 / LINE, abs=0.1 * DECLARED)
    for fault in ({"beside": 0.004}, {"depth": 0.6}, {"fraction": 0.3}):
        reward, is_good = worth(**fault)
        assert not is_good, fault
        assert reward < best - 0.3 * DECLARED, fault
    copies = begun()
    copies._paths[0].points, copies._paths[0].peak = path_along(copies), 1.5 * MOST_FORCE
    reward, is_good = copies._worth(0)
    assert not is_good
    assert reward == pytest.approx(best - 0.5 * DECLARED)


def test_a_way_that_is_no_cut_is_missed():
    copies = begun()
    assert copies._worth(0) == (-MISSED, False), "nothing was touched"
    there = path_along(copies)
    copies._paths[0].points = [*there, *there[::-1], *there]
    assert copies._worth(0) == (-MISSED, False), "it comes back to itself, which a cut must not"


def finished(threads):
    """Rewards and successes of three copies that a steady hand moves, until all have finished."""
    copies, policy, found = begun(3, threads), CutPolicy(3), []
    ended = np.zeros(3, dtype=bool)
    for _ in range(150):
        stepped = copies.step(policy.act(STEADY, copies.observe()))
        found.append([*stepped.reward[~ended], *stepped.succeeded[~ended]])
        ended |= stepped.terminated
        if ended.all():
            return copies, found
    raise AssertionError("not finished")


def test_a_steady_hand_cuts_well_and_the_same_on_any_number_of_threads():
    copies, found = finished(1)
    ends = [one for step in found for one in step if one > 1.0]
    assert len(ends) == 3, "all three were worth something"
    assert min(ends) > 0.2 * DECLARED
    assert all(path.peak < MOST_FORCE for path in copies._paths)
    assert all(np.array(path.points)[:, 3].max() > 0.0 for path in copies._paths)
    _, others = finished(2)
    assert others == found


def test_the_blade_touches_where_the_tissue_was_before_the_guard_moved_it():
    """The path is in rest coordinates: it lies on the surface at rest, though the guard has dented it."""
    copies, _ = finished(1)
    for path in copies._paths:
        points = np.array(path.points)[:, :3]
        np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.03, atol=3e-4)
