"""A surface with colours as a GLB: trimesh reads what was written."""

import numpy as np
import pytest
import trimesh

from tissue_sim.rendering.coloured_surface import ColouredSurface, light_of


def read(message):
    loaded = trimesh.load(trimesh.util.wrap_as_stream(message), file_type="glb", process=False)
    (mesh,) = loaded.geometry.values()
    return mesh


def test_trimesh_reads_what_was_written():
    mesh = trimesh.creation.icosphere(2, 0.03)
    surface = ColouredSurface(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    random = np.random.default_rng(1)
    for size in (0.0, 0.001):
        moved, colours = mesh.vertices + size * random.standard_normal((162, 3)), random.random((162, 3))
        found = read(surface.message(moved, colours))
        np.testing.assert_allclose(found.vertices, moved, atol=1e-8)
        np.testing.assert_array_equal(found.faces, mesh.faces)
        np.testing.assert_allclose(found.visual.vertex_attributes["color"][:, :3], colours, atol=1e-6)


def test_normals_are_those_of_a_ball():
    mesh = trimesh.creation.icosphere(3, 0.03)
    message = ColouredSurface(np.asarray(mesh.vertices), np.asarray(mesh.faces)).message(
        mesh.vertices, np.zeros((642, 3))
    )
    np.testing.assert_allclose(read(message).vertex_normals, mesh.vertices / 0.03, atol=0.02)
    assert int.from_bytes(message[8:12], "little") == len(message)
    assert len(message) % 4 == 0


def test_a_point_without_triangles_has_no_normal():
    message = ColouredSurface(np.eye(4, 3), np.array([[0, 1, 2]])).message(np.eye(4, 3), np.zeros((4, 3)))
    assert b"NaN" not in message
    np.testing.assert_allclose(read(message).vertices, np.eye(4, 3))


def test_light_is_that_of_a_screens_colours():
    """IEC 61966-2-1: half of the light is at 188."""
    np.testing.assert_allclose(light_of([0, 255]), [0.0, 1.0])
    assert light_of(188) == pytest.approx(0.5, abs=0.005)
    assert light_of(5) == pytest.approx(5 / 255 / 12.92)


def test_of_a_translucent_surface_what_is_farthest_is_drawn_first():
    mesh = trimesh.creation.icosphere(2, 0.03)
    eye = np.array([0.1, -0.2, 0.05])
    surface = ColouredSurface(np.asarray(mesh.vertices), np.asarray(mesh.faces), opacity=0.5)
    found = read(surface.message(mesh.vertices, np.zeros((162, 3)), eye))
    away = np.linalg.norm(np.asarray(found.vertices)[found.faces].mean(axis=1) - eye, axis=1)
    assert (np.diff(away) <= 1e-8).all()
    assert sorted(map(tuple, found.faces)) == sorted(map(tuple, mesh.faces))
