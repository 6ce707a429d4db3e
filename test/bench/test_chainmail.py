"""ChainMail: what its limits pass on, in closed form, and what relaxation ends in."""

from types import SimpleNamespace

import numpy as np
import pytest

from tissue_sim.bench.peers.chainmail import SHEAR, STRETCH, ChainMail, linked
from tissue_sim.bench.peers.engine import Load

SPACING = 0.004


def mail(nodes, edges, fixed=(), n_surface=None):
    """ChainMail on any nodes and edges; the first nodes are the surface."""
    organ = SimpleNamespace(fixed=np.array(fixed, dtype=np.int64), n_surface=n_surface or len(nodes))
    return ChainMail(organ, np.asarray(nodes, dtype=float), np.asarray(edges))


def chain(count=12, axis=0, fixed=()):
    nodes = np.zeros((count, 3))
    nodes[:, axis] = SPACING * np.arange(count)
    return mail(nodes, np.stack([np.arange(count - 1), np.arange(1, count)], axis=1), fixed)


def moved(chainmail):
    return chainmail.position - chainmail.rest


@pytest.mark.parametrize("pull", [-1.0, 1.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_stretch_spreads_as_gibson_has_it(pull, axis):
    """Each link takes up STRETCH of its length; the next node moves by what is left."""
    line = chain(axis=axis)
    distance = 3.4 * STRETCH * SPACING
    displacement = np.zeros((1, 3))
    displacement[0, axis] = pull * distance
    line.move(np.array([0]), displacement)
    expected = pull * np.maximum(distance - STRETCH * SPACING * np.arange(12), 0.0)
    np.testing.assert_allclose(moved(line)[:, axis], expected, atol=1e-15)
    assert np.abs(np.delete(moved(line), axis, axis=1)).max() == 0.0


def test_shear_spreads_by_its_own_limit():
    line = chain()
    distance = 2.5 * SHEAR * SPACING
    line.move(np.array([0]), np.array([[0.0, 0.0, distance]]))
    expected = np.maximum(distance - SHEAR * SPACING * np.arange(12), 0.0)
    np.testing.assert_allclose(moved(line)[:, 2], expected, atol=1e-15)


def test_slack_passes_nothing_on():
    line = chain()
    line.move(np.array([5]), np.array([[0.9 * STRETCH * SPACING, 0.0, 0.0]]))
    assert np.flatnonzero(np.any(moved(line) != 0.0, axis=1)).tolist() == [5]


def test_every_link_keeps_its_limits_after_a_move_in_a_grid():
    """Gibson's own case: on a grid one pass leaves no link beyond its limits."""
    place = np.stack(np.meshgrid(*[np.arange(7)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    number = {tuple(p): k for k, p in enumerate(place)}
    edges = [
        (number[tuple(p)], number[tuple(p + step)])
        for p in place
        for step in np.eye(3, dtype=int)
        if tuple(p + step) in number
    ]
    grid = mail(SPACING * place, edges)
    middle = number[(3, 3, 3)]
    grid.move(np.array([middle]), SPACING * np.array([[0.45, -0.2, 0.1]]))
    for i, j in edges:
        rest, now = grid.rest[j] - grid.rest[i], grid.position[j] - grid.position[i]
        slack = STRETCH * np.abs(rest) + SHEAR * (np.abs(rest).sum() - np.abs(rest))
        assert np.all(np.abs(now - rest) <= slack + 1e-12)
    assert 20 < np.count_nonzero(np.any(moved(grid) != 0.0, axis=1)) < len(place)


def test_held_nodes_stay():
    line = chain(fixed=(0,))
    line.move(np.array([11]), np.array([[10.0 * SPACING, 0.0, 0.0]]))
    assert not moved(line)[0].any()
    line.relax(np.array([11]))
    assert not moved(line)[0].any()


def test_relaxation_ends_in_an_even_stretch():
    """A chain held at one end and moved at the other: displacements grow evenly between."""
    line = chain(fixed=(0,))
    force = np.zeros((12, 3))
    force[11, 0] = 1.0
    reached = np.zeros((12, 3))
    reached[11] = [0.006, 0.0, 0.002]
    answer = line.settle(Load(force, reached))
    assert answer.settled
    assert answer.seconds > 0.0
    expected = np.linspace(0.0, 1.0, 12)[:, None] * reached[11]
    np.testing.assert_allclose(answer.displacement, expected, atol=2e-3 * 0.006)


def test_settling_begins_at_rest_and_updates_take_time():
    line = chain(fixed=(0,))
    force, reached = np.zeros((12, 3)), np.zeros((12, 3))
    force[6, 1], reached[6, 1] = 1.0, 0.003
    once = line.settle(Load(force, reached)).displacement
    assert np.median(line.burst(Load(force, reached))(20)) > 0.0
    np.testing.assert_array_equal(line.settle(Load(force, reached)).displacement, once)


def test_links_go_both_ways_and_once():
    start, neighbours = linked(4, np.array([[0, 1], [1, 0], [2, 1]]))
    assert [neighbours[start[k] : start[k + 1]].tolist() for k in range(4)] == [[1], [0, 2], [1], []]
