"""The winding number against counted crossings."""

import numpy as np
import pytest
import trimesh

from helpers.scenes import ball, kidney
from tissue_sim.organ import winding
from tissue_sim.organ.surface_checks import signed_volume
from tissue_sim.organ.winding import inside, winding_number


def crossings(points, triangles):
    """How many triangles lie above each point, along z."""
    a, b, c = (triangles[None, :, k] - points[:, None] for k in range(3))

    def turn(p, q):
        return p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]

    parts = np.stack([turn(b, c), turn(c, a), turn(a, b)])
    hit = np.all(parts > 0.0, axis=0) | np.all(parts < 0.0, axis=0)
    height = np.einsum("kpt,kpt->pt", parts, np.stack([a[..., 2], b[..., 2], c[..., 2]])) / parts.sum(axis=0)
    return np.count_nonzero(hit & (height > 0.0), axis=1)


def test_winding_number_is_one_inside_and_zero_outside():
    organ = kidney()
    mesh = trimesh.Trimesh(organ.surface_positions, organ.surface_triangles, process=False)
    low, high = mesh.bounds
    points = np.random.default_rng(0).uniform(low - 0.01, high + 0.01, (700, 3))
    winding = winding_number(points, organ.surface_positions, organ.surface_triangles)
    within = inside(points, organ.surface_positions, organ.surface_triangles)
    np.testing.assert_allclose(winding, within, atol=1e-9)
    fraction = within.mean() * np.prod(high - low + 0.02)
    assert fraction == pytest.approx(organ.volume, rel=0.15)
    np.testing.assert_array_equal(within, crossings(points, mesh.triangles) % 2 == 1)


def test_a_few_points_are_asked_of_every_triangle_and_far_ones_of_none(monkeypatch):
    organ = kidney()
    low, high = organ.surface_positions.min(axis=0), organ.surface_positions.max(axis=0)
    points = np.random.default_rng(2).uniform(low - 0.01, high + 0.01, (200, 3))
    together = inside(points, organ.surface_positions, organ.surface_triangles)
    alone = [inside(one[None], organ.surface_positions, organ.surface_triangles)[0] for one in points]
    np.testing.assert_array_equal(together, alone)
    monkeypatch.setattr(winding, "winding_number", None)
    far = np.array([high + 0.001, low - 0.001, [np.nan, 0.0, 0.0]])
    assert not inside(far, organ.surface_positions, organ.surface_triangles).any()


def test_winding_number_changes_sign_with_the_triangles():
    organ = ball()
    flipped = organ.surface_triangles[:, ::-1]
    assert signed_volume(organ.surface_positions, flipped) < 0.0
    assert winding_number(np.zeros((1, 3)), organ.surface_positions, flipped)[0] == pytest.approx(-1.0)


def test_winding_number_is_that_of_the_solid_angles_in_numpy():
    organ = kidney()
    corners = organ.surface_positions[organ.surface_triangles]
    points = organ.surface_positions.mean(axis=0) + np.random.default_rng(1).normal(0.0, 0.02, (40, 3))
    a, b, c = (corners[None, :, k] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=2) for side in (a, b, c))
    below = la * lb * lc + (a * b).sum(axis=2) * lc + (b * c).sum(axis=2) * la + (c * a).sum(axis=2) * lb
    angles = 2.0 * np.arctan2(np.linalg.det(np.stack([a, b, c], axis=2)), below)
    expected = angles.sum(axis=1) / (4.0 * np.pi)
    found = winding_number(points, organ.surface_positions, organ.surface_triangles)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_inside_asks_every_triangle_where_groups_leave_a_doubt(monkeypatch):
    """As near to the surface as rounding allows."""
    organ = kidney()
    corner = organ.surface_positions[organ.surface_triangles]
    outward = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    points = np.concatenate([corner.mean(axis=1) + step * outward for step in (-1e-4, -1e-9, 1e-9, 1e-4)])
    wanted = np.repeat([True, False], 2 * len(corner))
    asked = []
    full = winding.winding_number
    monkeypatch.setattr(
        winding, "winding_number", lambda some, *surface: asked.append(len(some)) or full(some, *surface)
    )
    for doubt in (0.2, 1e-3):
        monkeypatch.setattr(winding, "_DOUBT", doubt)
        np.testing.assert_array_equal(winding.inside(points, organ.surface_positions, organ.surface_triangles), wanted)
    assert asked[0] < 0.1 * len(points), "nothing is gained"
    assert 0 < asked[1] < len(points)
