"""Signed distances of meshes that are not convex."""

import numpy as np
import pytest
import trimesh

from helpers.pressing import deepest
from helpers.scenes import kidney
from tissue_sim.contact.grid import distance_grid
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import MARGIN, Tool, ToolSet
from tissue_sim.model.contact.shapes import signed_distance
from tissue_sim.model.data.shapes import GRID


def ring():
    """A ring of 20 mm radius, 4 mm thick, in the xy plane."""
    return trimesh.creation.torus(0.02, 0.004, 64, 32)


def ring_distance(points):
    return np.hypot(np.hypot(points[:, 0], points[:, 1]) - 0.02, points[:, 2]) - 0.004


@pytest.fixture(scope="module")
def ring_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("tools") / "ring.stl"
    ring().export(path)
    return str(path)


@pytest.fixture(scope="module")
def grid():
    return distance_grid(ring(), MARGIN)


@pytest.fixture
def _grid_is_made_once(monkeypatch, grid):
    """A tool of the ring takes the grid that was made of it before: each would take seconds."""

    def made(mesh, margin):
        np.testing.assert_allclose(mesh.bounds, ring().bounds, atol=1e-8)
        assert margin == MARGIN
        return grid

    monkeypatch.setattr("tissue_sim.contact.grid.distance_grid", made)


def test_grid_of_a_ring_is_its_distance_inside_and_out(grid):
    axes = [grid.origin[c] + grid.spacing * np.arange(grid.distance.shape[c]) for c in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    assert np.all(points.min(axis=0) <= -np.array([0.024, 0.024, 0.004]) - MARGIN + 1e-4)
    error = grid.distance.ravel() - ring_distance(points)
    assert np.abs(error).max() < 1.2e-4  # the mesh's own chords; spacing 0.6 mm
    assert (grid.distance < 0.0).sum() * grid.spacing**3 == pytest.approx(ring().volume, rel=0.03)


@pytest.mark.usefixtures("_grid_is_made_once")
def test_tool_that_is_not_convex_keeps_its_hole(ring_file):
    tools = ToolSet([Tool("left", "mesh", mesh=ring_file)])
    assert tools.shapes.kind[0] == GRID
    assert signed_distance(tools.shapes, 0, 0.0, 0.0, 0.0)[0] == pytest.approx(
        0.016, abs=3e-4
    )  # in the middle it has a kink
    assert signed_distance(tools.shapes, 0, 0.02, 0.0, 0.0)[0] == pytest.approx(-0.004, abs=3e-4)


@pytest.mark.usefixtures("_grid_is_made_once")
def test_ring_presses_with_its_rim_and_lets_the_tissue_bulge_into_its_hole(ring_file):
    organ = kidney()
    scene = Scene(organ, [Tool("left", "mesh", mesh=ring_file)])
    node = np.argmin(organ.surface_positions[:, 1])  # in front; the back is held
    top = organ.surface_positions[node]
    turn = [0.7071067811865475, 0.0, 0.0, 0.7071067811865476]  # its axis along y
    for step in range(250):
        depth = min(1.0, step / 150) * 0.006
        scene.move(0, top - [0.0, 0.004 - depth + 0.001, 0.0], turn)
        scene.step()
    state = scene.simulation.state
    assert scene.wrenches[0, 1] < -0.05
    local = scene.simulation.positions[: organ.n_surface] - state.body_pose[0, :3]
    assert deepest(scene) < 2e-4
    moved = np.linalg.norm(scene.simulation.positions - organ.rest_positions, axis=1)[: organ.n_surface]
    middle = np.linalg.norm(local - [0.0, local[node, 1], 0.0], axis=1).argmin()
    assert moved[middle] < 0.8 * moved.max()
