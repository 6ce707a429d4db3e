"""A fold that closes doesn't pass through itself."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import ball, fold
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.self_contact_finder import SelfFinder


def closed(organ, self_contact, by=0.005, ticks=800):
    """The scene of a fold whose legs' outer sides were led together by so many m each, and how far they went across.

    That is, m, by how much the walls in between passed each other at the worst.
    """
    scene = Scene(organ, [], self_contact=self_contact)
    surface, simulation = organ.surface_positions, scene.simulation
    straight, side = surface[:, 2] > 0.004, np.sign(surface[:, 0])
    inner = [straight & (surface[:, 2] < 0.016) & (side == way) & (np.abs(surface[:, 0]) < 0.0045) for way in (-1, 1)]
    outer = np.flatnonzero(straight & (np.abs(surface[:, 0]) > 0.0125))
    simulation.prescribe(outer, surface[outer] - by * side[outer, None] * [1.0, 0.0, 0.0], ticks)
    worst = 0.0
    for _ in range(ticks + 200):
        scene.step()
        x = simulation.positions[: organ.n_surface, 0]
        worst = max(worst, x[inner[0]].max() - x[inner[1]].min())
    return scene, worst


def test_a_fold_that_closes_does_not_pass_through_itself():
    organ = fold()
    _, passed = closed(organ, False)
    scene, held = closed(organ, True)
    assert passed > 0.001, "m: without, its walls go through each other"
    assert held < 1e-4, "m: with it, they don't"
    pairs = scene.joined.pairs
    assert pairs.pressed[: pairs.found[0]].sum() > 0.05, "N"
    assert scene.simulation.state.count.faults == 0


@pytest.mark.extended
def test_it_opens_again_and_stays_where_it_was_before():
    organ = fold()
    scene, _ = closed(organ, True)
    scene.simulation.free()
    for _ in range(4000):
        scene.step()
    np.testing.assert_allclose(scene.simulation.positions, organ.rest_positions, atol=2e-5)
    assert scene.joined.pairs.found[0] == 0


def test_what_does_not_fold_has_nothing_to_do_with_it():
    organ = ball(2)
    finder = SelfFinder(organ)
    nodes, weights = finder.find(organ.surface_positions)
    assert nodes.shape == (0, 4)
    assert weights.shape == (0, 3)
    flat = organ.surface_positions * [1.0, 1.0, 0.02]  # 1.2 mm thick: its walls are near, and back to back
    assert len(finder.find(flat)[0]) == 0


@pytest.mark.parametrize("depth", [-0.0015, -0.0005, 0.0005, 0.001])
def test_a_node_may_be_behind_a_wall_that_it_was_in_front_of(depth):
    """Legs led towards each other, or at once to where they are `depth` m apart, below 0 in each other."""
    organ = fold()
    surface = organ.surface_positions

    def apart(gap):
        moved = surface.copy()
        moved[:, 0] -= np.sign(surface[:, 0]) * np.clip(surface[:, 2] / 0.01, 0.0, 1.0) * 0.5 * (0.006 - gap)
        return moved

    def farthest_behind(nodes, at):
        corners = at[nodes[:, 1:]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        ahead = np.einsum("px,px->p", at[nodes[:, 0]] - corners[:, 0], normal) / np.linalg.norm(normal, axis=1)
        return -ahead.min(initial=0.0)

    followed, at_once = SelfFinder(organ), SelfFinder(organ)
    for gap in np.linspace(0.004, depth, 20):
        nodes, weights = followed.find(apart(gap))
    assert len(nodes) > 4
    assert np.all(np.sign(surface[nodes[:, 0], 0]) == -np.sign(surface[nodes[:, 1], 0])), "of one leg, at the other"
    assert np.all(weights >= 0.0)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert (farthest_behind(nodes, apart(depth)) > 1e-4) == (depth < -0.001)
    # At once it is unknown which side it came from.
    assert farthest_behind(at_once.find(apart(depth))[0], apart(depth)) == 0.0
    followed.forget()
    assert farthest_behind(followed.find(apart(depth))[0], apart(depth)) == 0.0


def test_a_fold_that_claps_together_keeps_its_momentum():
    """Nothing holds it, nothing damps it, and its legs fly against each other."""
    organ = fold()
    free = replace(organ, fixed=organ.fixed[:0], damping=0.0 * organ.damping, return_stiffness=0.0 * organ.damping)
    scene = Scene(free, [], self_contact=True, organ_friction=0.5)
    simulation = scene.simulation
    x, _, z = free.rest_positions.T
    simulation.velocities[:, 0] = -2.0 * np.sign(x) * np.clip(z / 0.02, 0.0, 1.0) + 0.05
    simulation.state.status.asleep = False
    before, touched = free.mass @ simulation.velocities, 0
    size = float(free.mass @ np.abs(simulation.velocities[:, 0]))
    for _ in range(60):
        scene.step()
        pairs = scene.joined.pairs
        touched += np.any(pairs.pressed[: pairs.found[0]] > 0.0)
        np.testing.assert_allclose(free.mass @ simulation.velocities, before, atol=1e-9 * size)
    assert touched > 3, "ticks in which it touched itself"
    assert simulation.state.count.faults == 0
