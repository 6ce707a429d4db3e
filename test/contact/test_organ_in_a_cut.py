"""Another organ in an open cut: it rests on the walls, and takes no momentum from nowhere."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.bars import bar
from helpers.scenes import changed
from helpers.slabs import INCISION, MIDDLE, SIZE, THROUGH, hold_open, slab
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.triangles import nearest_weights
from tissue_sim.organ.placement import placed
from tissue_sim.organ.winding import inside


def block(edge, place):
    """A cube of free tissue of twice an edge's size, with its lowest corner at a place, m."""
    return placed(replace(bar(2, edge, 2), fixed=np.zeros(0, dtype=np.int32)), place)


def undamped(organ):
    return changed(organ, damping=0.0, return_stiffness=0.0)


def at_cut_points(scene):
    """The pairs in contact one of whose sides is a cut point, and those that are not."""
    pairs = scene.joined.pairs
    count = int(pairs.found[0])
    touching = np.linalg.norm(pairs.loaded[:count], axis=1) > 0.0
    made = (pairs.node[:count] < 0).any(axis=1)
    return np.flatnonzero(touching & made), np.flatnonzero(touching & ~made)


def force_on(scene, organ):
    """Force of the other organ on one, (3,) N."""
    pairs = scene.joined.pairs
    count = int(pairs.found[0])
    sign = np.where(pairs.organ[:count, 0] == organ, 1.0, -1.0)
    return sign @ pairs.loaded[:count]


def deepest(scene):
    """How deep a node of the second organ lies behind the first one's surface with its walls, m."""
    surface, second = scene.organs[0].finder.surface, scene.simulations[1]
    points, triangles = surface.at(scene.simulations[0].positions), surface.triangles
    nodes = second.positions[: second.organ.n_surface]
    within = nodes[inside(nodes, points, triangles)]
    depth = [nearest_weights(points[triangles], np.tile(node, (len(triangles), 1)))[1].min() for node in within]
    return max(depth, default=0.0)


def parted(friction):
    """A free slab that is cut through, its right half moved aside, and a cube that flies against the right wall."""
    cube = undamped(block(0.005, [MIDDLE + 0.003, 0.0097, 0.0142]))
    scene = Scene([undamped(slab("")), cube], [], organ_friction=friction)
    scene.joined.coarse.square[:] = 0.0  # where one takes longer substeps than the other, impulses are equal on average
    scene.cut(0, *THROUGH)
    cut = scene.simulation.cut_organ
    is_right = scene.simulation.model.rest[:, 0] > MIDDLE
    is_right[cut.uncut.n_nodes :] = ~is_right[cut.uncut.n_nodes :]  # a virtual node lies on the other side
    scene.simulation.positions[is_right] += [0.016, 0.0, 0.0]
    scene.simulations[1].velocities[:] = [0.3, 0.05, 0.02]
    for one in scene.simulations:
        one.state.status.asleep = False
    return scene


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_what_flies_against_a_wall_keeps_the_momentum_of_both(friction):
    scene = parted(friction)

    def momentum():
        return sum(one.organ.mass @ one.velocities for one in scene.simulations)

    before, first = momentum(), scene.simulations[1].velocities[:, 0].mean()
    touched = 0
    for _ in range(60):
        scene.step()
        at_cut, elsewhere = at_cut_points(scene)
        assert len(elsewhere) == 0
        touched += len(at_cut)
        np.testing.assert_allclose(momentum(), before, atol=1e-9 * np.linalg.norm(before))
    assert touched > 10
    assert scene.simulations[1].velocities[:, 0].mean() < 0.2 * first, "the wall has stopped it"
    assert deepest(scene) < 2e-4
    assert all(one.state.count.faults == 0 for one in scene.simulations)


def test_what_is_pressed_into_an_open_cut_rests_on_its_walls():
    scene = Scene([slab(), block(0.004, [MIDDLE - 0.0037, 0.0111, SIZE[2] + 0.001])], [])
    scene.cut(0, *INCISION)
    hold_open(scene, 0.004)
    cube = scene.simulations[1]
    load = np.outer(cube.organ.mass, [0.0, 0.0, -20.0])
    nodes = np.arange(cube.organ.n_nodes)
    felt = np.zeros(3)
    for tick in range(1500):
        cube.apply_force(nodes, load)
        scene.step()
        felt += force_on(scene, 1) / 500 if tick >= 1000 else 0.0
    at_cut, elsewhere = at_cut_points(scene)
    assert len(at_cut) > 2
    assert len(elsewhere) == 0
    assert cube.positions[:, 2].min() < SIZE[2] - 0.003, "it is in the cut"
    np.testing.assert_allclose(felt, -load.sum(axis=0), atol=0.01 * np.linalg.norm(load.sum(axis=0)))
    assert deepest(scene) < 2e-4
    assert all(one.state.count.faults == 0 for one in scene.simulations)


def test_a_further_cut_and_a_reset_leave_no_pair_on_points_that_are_gone():
    scene = parted(0.0)
    scene.step(20)
    pairs = scene.joined.pairs
    assert (pairs.node[: int(pairs.found[0])] < 0).any()
    scene.cut(0, [[0.01, -0.01, 0.031], [0.01, 0.04, 0.031]], [0.0, 0.0, -1.0], 0.011)
    count = int(pairs.found[0])
    points = np.unique(-1 - pairs.node[:count][pairs.node[:count] < 0])
    assert len(points)
    assert (pairs.point_version[points] == 2).all()
    scene.step(20)
    scene.reset()
    assert pairs.version[0] == 3
    scene.step(5)
    assert not (pairs.node[: int(pairs.found[0])] < 0).any()


def test_pairs_of_a_surface_that_an_organ_no_longer_has_are_not_taken():
    scene = parted(0.0)
    scene.step(20)
    found = scene.pairs_finder.find([one.positions for one in scene.simulations])
    made = (found.node[: int(found.found[0])] < 0).any(axis=1)
    assert made.any()
    scene.joined.pairs.version[0] += 1
    scene.joined.take_pairs(found)
    assert int(scene.joined.pairs.found[0]) == np.count_nonzero(~made)


def test_walls_of_a_shut_cut_are_not_touched():
    scene = Scene([slab(), block(0.002, [MIDDLE - 0.002, 0.013, SIZE[2] - 0.0003])], [])
    scene.cut(0, *INCISION)
    found = scene.pairs_finder.find([one.positions for one in scene.simulations])
    count, surface = int(found.found[0]), scene.organs[0].finder.surface
    points = np.where(found.node[:count] < 0, found.point_number[-1 - found.node[:count]], found.node[:count])
    touched = points[found.organ[:count, 1] == 0, 1:]
    walls = {tuple(sorted(row)) for row in surface.triangles[~surface.is_outer].tolist()}
    assert len(touched) > 3
    assert not walls & {tuple(sorted(row)) for row in touched.tolist()}
