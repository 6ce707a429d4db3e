"""Organs of any size, patches and loads."""

import numpy as np
import pytest

from helpers.scenes import ball, kidney
from tissue_sim.bench.organs import ATOMS, bean, patch, patch_load, press_node, spread_nodes
from tissue_sim.organ.normals import surface_normals

ORGANS = [ball(2), kidney(), bean(1000)]
NAMES = ["ball", "kidney", "bean"]


@pytest.mark.parametrize("points", [300, 1000])
def test_bean_has_the_points_asked_for(points):
    organ = bean(points)
    assert organ.n_surface == points
    assert len(organ.surface_triangles) == 2 * points - 4
    assert organ.n_atoms == ATOMS
    assert organ.surface_positions[organ.fixed, 2].max() < np.quantile(organ.surface_positions[:, 2], 0.06)


def test_beans_of_all_sizes_are_one_shape():
    small, large = bean(1000), bean(4000)
    assert large.volume == pytest.approx(small.volume, rel=0.01)
    pressed = [organ.surface_positions[press_node(organ)] for organ in (small, large)]
    assert np.linalg.norm(pressed[0] - pressed[1]) < 0.004


@pytest.mark.parametrize("organ", ORGANS, ids=NAMES)
def test_patch_is_free_and_around_its_middle(organ):
    nodes = patch(organ, press_node(organ))
    assert nodes[0] == press_node(organ)
    assert len(np.unique(nodes)) == 19
    assert not set(nodes) & set(organ.fixed)
    apart = np.linalg.norm(organ.surface_positions - organ.surface_positions[nodes[0]], axis=1)
    others = np.setdiff1d(np.arange(organ.n_surface), [*nodes, *organ.fixed])
    assert apart[nodes].max() <= apart[others].min()


@pytest.mark.parametrize("organ", ORGANS, ids=NAMES)
def test_patch_load_pushes_inward_with_the_force_asked_for(organ):
    nodes, forces = patch_load(organ, 0.1)
    assert np.linalg.norm(forces.sum(axis=0)) == pytest.approx(0.1)
    normal = surface_normals(organ.surface_positions, organ.surface_triangles)[nodes]
    assert np.all(np.einsum("kx,kx->k", normal, forces) < 0.0)


def test_normals_of_a_ball_are_radial():
    organ = ball(3)
    normal = surface_normals(organ.surface_positions, organ.surface_triangles)
    radial = organ.surface_positions / np.linalg.norm(organ.surface_positions, axis=1, keepdims=True)
    assert np.einsum("kx,kx->k", normal, radial).min() > 0.999


@pytest.mark.parametrize("organ", ORGANS, ids=NAMES)
def test_spread_nodes_are_apart_free_and_on_one_side(organ):
    nodes = spread_nodes(organ, 10)
    assert nodes[0] == press_node(organ)
    surface = organ.surface_positions
    apart = np.linalg.norm(surface[nodes][:, None] - surface[nodes][None], axis=2) + np.eye(10)
    assert apart.min() > 0.1 * np.ptp(surface, axis=0).max()
    assert not set(nodes) & set(organ.fixed)
    normal = surface_normals(surface, organ.surface_triangles)[nodes]
    assert np.all(normal @ normal[0] > 0.0)
