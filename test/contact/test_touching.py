"""Organs that touch each other: momentum, no penetration, friction, sleep."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.scenes import RADIUS, ball, free_ball
from tissue_sim.contact.attachments import Breathing
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.contact.triangles import nearest_weights
from tissue_sim.errors import UserError
from tissue_sim.organ.placement import placed
from tissue_sim.organ.winding import inside

TOOL = [Tool("ball", "sphere", radius=0.005)]


def deepest(scene):
    """How deep a node of one lies in the other, m."""
    first, second = (
        (one.positions[: one.organ.n_surface] + offset, one.organ.surface_triangles)
        for one, offset in zip(scene.simulations, scene.offsets, strict=True)
    )
    found = 0.0
    for (points, _), (surface, triangles) in ((first, second), (second, first)):
        for point in points[inside(points, surface, triangles)]:
            _, apart = nearest_weights(surface[triangles], np.tile(point, (len(triangles), 1)))
            found = max(found, float(apart.min()))
    return found


def momentum(scene):
    return sum(one.organ.mass @ one.velocities for one in scene.simulations)


def thrown(friction, way=(0.4, 0.05, 0.02)):
    """Two free balls, of which one flies against the other; the scene, and its momentum after each tick."""
    scene = Scene(
        [free_ball(2), placed(free_ball(2), [2.0 * RADIUS + 0.004, 0.01, 0.0])], TOOL, organ_friction=friction
    )
    first = scene.simulations[0]
    first.velocities[:] = way
    first.state.status.asleep = False
    momenta = []
    for _ in range(120):  # at a quarter of a second it would be farther away than it is large: the guard's business
        scene.step()
        momenta.append(momentum(scene))
    return scene, np.array(momenta)


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_collision_keeps_momentum(friction):
    scene, momenta = thrown(friction)
    first, second = scene.simulations
    assert np.linalg.norm(second.organ.mass @ second.velocities) > 0.2 * np.linalg.norm(momenta[0]), "it was hit"
    np.testing.assert_allclose(
        momenta, np.broadcast_to(momenta[0], momenta.shape), atol=1e-9 * np.linalg.norm(momenta[0])
    )
    assert first.state.count.faults == second.state.count.faults == 0


def pressed(friction=0.0, ticks=1500, across=0.0):
    """A ball above another, held at its top, which is led down by 6 mm, and then sideways."""
    upper = placed(ball(2), [0.0, 0.0, 2.0 * RADIUS + 0.001])
    top = np.flatnonzero(upper.surface_positions[:, 2] > 2.7 * RADIUS)
    upper = replace(upper, fixed=top)
    scene = Scene([ball(2), upper], TOOL, organ_friction=friction)
    above = scene.simulations[1]
    above.prescribe(top, upper.surface_positions[top] + [0.0, 0.0, -0.006], ticks=300)
    for _ in range(ticks // 2):
        scene.step()
    above.prescribe(top, upper.surface_positions[top] + [across, 0.0, -0.006], ticks=300)
    for _ in range(ticks // 2):
        scene.step()
    return scene


def test_what_is_pressed_gives_way_and_is_not_entered_and_not_after_a_fault_either():
    scene = pressed(ticks=1000)
    lower, upper = scene.simulations
    assert deepest(scene) < 5e-4
    assert (lower.positions - lower.model.rest)[:, 2].min() < -1e-3
    pairs = scene.joined.pairs
    count = int(pairs.found[0])
    assert np.count_nonzero(pairs.pressed[:count]) > 3
    speed = max(float(np.abs(one.velocities).max()) for one in (lower, upper))
    assert speed < 1e-3, "it holds still"
    for one in scene.simulations:
        one.state.status.faulted = True
    for _ in range(300):
        scene.step()
    assert scene.simulations[1].state.status.faulted
    assert deepest(scene) < 5e-4


@pytest.mark.parametrize(
    "what", ["sound", *(pytest.param(what, marks=pytest.mark.extended) for what in ("faulted", "snapped"))]
)
def test_organs_that_were_driven_through_each_other_are_let_go_until_they_are_out(what):
    """After a fault, which tells that no force leads out, or when one is led back; else they press."""
    scene = Scene([ball(2), placed(ball(2), [2.0 * RADIUS + 0.001, 0.0, 0.0])], TOOL)
    second = scene.simulations[1]
    second.positions[second.model.moving] -= [0.012, 0.0, 0.0]
    for one in scene.simulations:
        one.state.status.asleep = False
    if what != "sound":
        setattr(second.state.status, what, True)
    scene.step()
    pairs = scene.joined.pairs
    count = int(pairs.found[0])
    assert count > 0
    assert np.any(pairs.pressed[:count] > 0.0) == (what == "sound")
    for _ in range(4000):
        scene.step()
        if all(one.asleep for one in scene.simulations):
            break
    assert all(one.asleep for one in scene.simulations)
    assert max(float(np.abs(one.positions - one.model.rest).max()) for one in scene.simulations) < 1e-4


def test_more_organs_than_a_scene_may_have_are_refused():
    with pytest.raises(UserError, match="17 organs are joined; expected: at most 16"):
        Scene([placed(ball(), [0.2 * place, 0.0, 0.0]) for place in range(17)], TOOL)


def test_friction_takes_along_what_it_presses_on():
    sideways = [
        float((one.simulations[0].positions - one.simulations[0].model.rest)[:, 0].max())
        for one in (pressed(0.0, 700, across=0.004), pressed(0.8, 700, across=0.004))
    ]
    assert sideways[1] > 5.0 * sideways[0]


@pytest.mark.extended
def test_organs_that_part_sleep_again_and_those_far_away_are_never_looked_at():
    scene = pressed(ticks=600)
    upper = scene.simulations[1]
    top = np.asarray(upper.organ.fixed)
    upper.prescribe(top, upper.model.rest[top], ticks=100)
    for tick in range(4000):
        scene.step()
        if tick == 500:
            upper.reset()
    assert scene.simulations[0].asleep
    far = Scene([ball(), placed(ball(), [0.2, 0.0, 0.0])], TOOL)
    far.simulations[0].apply_force([0], [[0.0, 0.0, 0.02]])
    for _ in range(20):
        far.step()
    counters = far.pairs_finder.counters
    assert counters.far_skips == counters.searches > 0
    assert far.simulations[1].state.count.asleep_ticks == 20


def test_organs_that_the_breath_carries_asleep_wake_where_they_touch():
    """One goes 5 mm towards the other, from 2 mm away, so slowly that neither would wake for it."""
    pair = [ball(2), placed(ball(2), [2.0 * RADIUS + 0.002, 0.0, 0.0])]
    scene = Scene(pair, TOOL, breathing=Breathing(10.0, (0.005, 0.0, 0.0)), breathes=[1.0, 0.0], ticks_a_set=4)
    depth, asleep = 0.0, 0
    for tick in range(3000):
        scene.step()
        asleep += all(simulation.asleep for simulation in scene.simulations)
        if tick % 250 == 0:
            depth = max(depth, deepest(scene))
    moved = min(np.abs(one.positions - one.model.rest).max() for one in scene.simulations)
    assert 500 < asleep < 2500
    assert depth < 1e-4
    assert moved > 2e-4
