"""What the search for organs that touch leaves out changes nothing that it finds."""

import numpy as np
import pytest

from helpers.scenes import RADIUS, ball
from tissue_sim.contact.broad_phase import approach
from tissue_sim.contact.organ_contact_finder import DEEPEST, MARGIN, OrganContactFinder
from tissue_sim.contact.self_contact_finder import SelfFinder
from tissue_sim.contact.triangles import nearest_weights
from tissue_sim.model.stepping.contact_pairs import used_words
from tissue_sim.organ.placement import placed
from tissue_sim.organ.winding import inside

# The first two are 6 mm apart, but their boxes are not.
ASIDE = (2.0 * RADIUS + 0.006) / np.sqrt(2.0)
BALLS = [ball(2), placed(ball(2), [ASIDE, ASIDE, 0.0]), placed(ball(2), [0.0, 0.3, 0.0])]


def surfaces(step, closing):
    """Three balls that a breath carries, and that wobble; the second comes nearer to the first, and goes."""
    breath = 0.01 * np.sin(0.05 * step) * np.array([0.2, 1.0, 0.5])
    nearer = closing * np.sin(np.pi * step / 200.0) ** 2
    shift = np.array([[0.0, 0.0, 0.0], [-0.7 * nearer, -0.7 * nearer, 0.0], [0.0, 0.0, 0.0]])
    found = []
    for organ, way in zip(BALLS, shift, strict=True):
        rest = organ.surface_positions
        found.append(rest + breath + way + 2e-4 * np.sin(200.0 * rest + 0.3 * step))
    return found


@pytest.mark.parametrize("closing", [0.002, 0.009, 0.02])
def test_one_that_remembers_finds_what_a_new_one_finds(closing):
    finder, found = OrganContactFinder(BALLS), 0
    for step in range(200):
        now = surfaces(step, closing)
        words = used_words(finder.find(now)).copy()
        np.testing.assert_array_equal(words, used_words(OrganContactFinder(BALLS).find(now)))
        found += int(words[0])
    counters = finder.counters
    assert (found > 0) == (closing > 0.004)
    assert counters.searches == 6 * 200
    assert counters.far_skips == 4 * 200, "the third is far from both"
    assert counters.apart_skips > (300 if closing < 0.004 else 20)


def test_pairs_are_the_nodes_near_the_other_surface():
    now = surfaces(100, 0.012)
    found = OrganContactFinder(BALLS).find(now)
    count = int(found.found[0])
    for first, second in ((0, 1), (1, 0)):
        surface, triangles = now[second], BALLS[second].surface_triangles
        wanted = set()
        within = inside(now[first], surface, triangles)
        for node, point in enumerate(now[first]):
            apart = nearest_weights(surface[triangles], np.tile(point, (len(triangles), 1)))[1].min()
            if apart < (DEEPEST if within[node] else MARGIN):
                wanted.add(node)
        of_both = np.all(found.organ[:count] == (first, second), axis=1)
        assert set(found.node[:count][of_both, 0].tolist()) == wanted
        assert len(wanted) > 3


def test_approach_is_a_bound_and_zero_for_what_goes_along():
    random = np.random.default_rng(0)
    first, second = random.standard_normal((30, 3)), random.standard_normal((40, 3)) + (4.0, 0.0, 0.0)
    shift = np.array([0.3, -0.2, 0.1])
    assert approach(first + shift, first, second + shift, second) == pytest.approx(0.0, abs=1e-14)
    for _ in range(20):
        moved = [one + shift + 0.1 * random.standard_normal(one.shape) for one in (first, second)]
        before, after = (np.linalg.norm(a[:, None] - b[None], axis=2) for a, b in ((first, second), moved))
        assert (before - after).max() <= approach(moved[0], first, moved[1], second)


def test_a_surface_that_folds_is_found_the_same_by_one_that_looks_at_all_of_it():
    organ = ball(3)
    rest = organ.surface_positions
    quick, whole, found = SelfFinder(organ), SelfFinder(organ), 0
    for step in range(120):
        # Pressed flat from both sides, until the walls turn their backs on each other at less than what is near.
        flat = 1.0 - 0.97 * np.sin(np.pi * step / 119.0)
        now = rest * (1.0, 1.0, flat) + 0.3 * (1.0 - flat) * np.outer(rest[:, 0] ** 2 / RADIUS, (0.0, 0.0, 1.0))
        whole._before = None
        pairs, weights = quick.find(now)
        all_pairs, all_weights = whole.find(now)
        np.testing.assert_array_equal(pairs, all_pairs)
        np.testing.assert_array_equal(weights, all_weights)
        found += len(quick._within_reach(now)) < organ.n_surface
    assert found > 20, "some of it was left out"
