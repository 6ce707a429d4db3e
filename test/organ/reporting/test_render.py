"""Drawing of solids: what hides what, glass, and the rasterizer itself."""

import numpy as np
import pytest
import trimesh

from tissue_sim.organ.reporting.render import Solid, draw, rasterize, view_of


def test_nearer_hides_farther_whatever_the_order():
    small = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    near, far = ([0.0, -4.0, 0.0], [0.0, 4.0, 0.5])
    red = Solid(small.vertices + near, small.faces.astype(np.int32), (1.0, 0.0, 0.0))
    blue = Solid(2.0 * small.vertices + far, small.faces.astype(np.int32), (0.0, 0.0, 1.0))
    view = view_of(np.concatenate([red.positions, blue.positions]), (0, -1, 0), (0, 0, 1), (200, 200))
    first, second = draw(view, [red, blue]), draw(view, [blue, red])
    np.testing.assert_array_equal(first, second)
    at = view.project([near, [0.0, 4.0, 2.2]])[:, :2] / 2.0
    (red_x, red_y), (blue_x, blue_y) = at.astype(int)
    assert first[red_y, red_x, 0] > 2 * int(first[red_y, red_x, 2])
    assert first[blue_y, blue_x, 2] > 2 * int(first[blue_y, blue_x, 0])


def test_glass_lets_what_is_inside_be_seen():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    faces = ball.faces.astype(np.int32)
    inside = Solid(0.3 * ball.vertices, faces, (1.0, 0.0, 0.0))
    view = view_of(ball.vertices, (1, 0, 0), (0, 0, 1), (120, 120))
    behind_glass = draw(view, [inside], Solid(ball.vertices, faces, (0.4, 0.5, 0.7)))
    hidden = draw(view, [inside, Solid(ball.vertices, faces, (0.4, 0.5, 0.7))])
    middle = behind_glass[60, 60].astype(int)
    assert middle[0] > middle[2] + 40
    assert hidden[60, 60, 0] < hidden[60, 60, 2]
    assert (behind_glass[2, 2] == 255).all()


def test_the_rasterizer_finds_triangle_height_and_edge_distance():
    # Height 10 + x/10 + y/5 over a triangle that faces the viewer: y runs down, so its corners run clockwise there.
    corner = np.array([[2.0, 2.0], [12.0, 30.0], [38.0, 6.0]])
    pixels = np.column_stack([corner, 10.0 + corner @ [0.1, 0.2]])
    depth = np.full((40, 40), -np.inf)
    owner, weight, rim = rasterize(pixels, np.array([[0, 1, 2]], dtype=np.int32), depth, +1)
    rows, columns = np.nonzero(owner == 0)
    assert len(rows) == pytest.approx(0.5 * abs(np.linalg.det(corner[1:] - corner[0])), rel=0.02)
    np.testing.assert_allclose(depth[rows, columns], 10.0 + 0.1 * (columns + 0.5) + 0.2 * (rows + 0.5), rtol=1e-12)
    np.testing.assert_allclose(weight[rows, columns] @ corner, np.column_stack([columns, rows]) + 0.5, rtol=1e-12)
    centre = np.column_stack([columns, rows]) + 0.5
    distances = []
    for k in range(3):
        a, along = corner[k], corner[(k + 1) % 3] - corner[k]
        distances.append(np.abs(np.cross(np.insert(along, 2, 0.0), np.insert(centre - a, 2, 0.0, axis=1))[:, 2]))
        distances[-1] /= np.linalg.norm(along)
    np.testing.assert_allclose(rim[rows, columns], np.min(distances, axis=0), rtol=1e-9)
    other, _, _ = rasterize(pixels, np.array([[0, 1, 2]], dtype=np.int32), np.full((40, 40), -np.inf), -1)
    assert (other == -1).all()
    hidden, _, _ = rasterize(pixels, np.array([[0, 1, 2]], dtype=np.int32), np.full((40, 40), 100.0), +1)
    assert (hidden == -1).all()
