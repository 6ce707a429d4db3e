"""Pictures agree with the lens: places, distances, labels, both eyes, shadows, and a texture that sticks."""

from dataclasses import replace

import numpy as np
import pytest

from tissue_sim.errors import UserError
from tissue_sim.rendering.bodies import METAL, Look
from tissue_sim.rendering.offscreen import Light, Offscreen
from tissue_sim.rendering.pinhole import Pinhole, beside, inverse_of, look_at, matrix_of
from tissue_sim.rendering.primitives import ball, tubes

# Pixels that are not square, and an axis off the middle: what mistakes one for the other is seen.
LENS = Pinhole(640, 400, 520.0, 460.0, 282.6, 225.6)
POSE = look_at([0.30, -0.20, 0.15], [0.05, 0.02, 0.01], up=[0.1, 0.2, 1.0])
RADIUS = 0.003
PLACES = np.array([[-0.03, -0.02, 0.15], [0.06, 0.01, 0.18], [0.0, 0.05, 0.2], [-0.05, -0.06, 0.25]])  # optical frame
NOWHERE = Light(wall=(0.0, 0.0, 0.0))


def world(points, pose=POSE):
    matrix = matrix_of(pose)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def middle(mask):
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()])


@pytest.fixture(scope="module")
def balls():
    """Small balls at PLACES of the camera at POSE, with the labels 11, 12 and so on."""
    with Offscreen(LENS, NOWHERE, samples=1) as made:
        for number, at in enumerate(world(PLACES)):
            vertices, triangles = ball(RADIUS)
            made.add(f"ball {number}", vertices + at, triangles, Look((1.0, 1.0, 1.0), label=11 + number, texture=0.0))
        yield made


def test_points_appear_where_the_matrix_projects_them(balls):
    picture = balls.take(POSE, depth=True, labels=True)
    for number, expected in enumerate(LENS.project(PLACES)):
        seen = picture.labels == 11 + number
        assert np.linalg.norm(middle(seen) - expected) < 0.15, number
        assert np.linalg.norm(middle((picture.colour.max(axis=2) > 20) & seen) - expected) < 0.3, number
    assert not picture.colour[picture.labels == 0].any()


def test_a_lens_that_is_half_a_pixel_off_is_noticed(balls):
    """The bound above is tight enough: the convention of OpenGL's pixels would miss it."""
    picture = balls.take(POSE, colour=False, labels=True)
    shifted = replace(LENS, cx=LENS.cx + 0.5).project(PLACES)
    assert all(np.linalg.norm(middle(picture.labels == 11 + k) - shifted[k]) > 0.3 for k in range(len(PLACES)))


def test_depth_is_the_distance_along_the_axis(balls):
    picture = balls.take(POSE, colour=False, depth=True, labels=True)
    for number, at in enumerate(PLACES):
        rows, columns = np.nonzero(picture.labels == 11 + number)
        depth = picture.depth[rows, columns].astype(np.float64)
        rays = np.column_stack([(columns - LENS.cx) / LENS.fx, (rows - LENS.cy) / LENS.fy, np.ones(len(rows))])
        off = np.linalg.norm(rays * depth[:, None] - at, axis=1) - RADIUS
        assert np.abs(off).max() < 0.03 * RADIUS  # of facets that approximate the ball
    assert np.array_equal(np.isinf(picture.depth), picture.labels == 0)


def test_depth_of_a_plane_is_exact():
    with Offscreen(LENS) as made:
        made.add("plate", *plate(0.3), Look(label=3))
        picture = made.take(POSE, colour=False, depth=True)
        rows, columns = np.nonzero(np.isfinite(picture.depth))
        rays = np.column_stack([(columns - LENS.cx) / LENS.fx, (rows - LENS.cy) / LENS.fy, np.ones(len(rows))])
        assert len(rows) > 10_000
        assert np.abs(world(rays * picture.depth[rows, columns, None])[:, 2]).max() < 1e-6


def test_disparity_of_a_stereo_pair(balls):
    baseline = 0.006
    left, right = (balls.take(pose, colour=False, labels=True) for pose in (POSE, beside(POSE, baseline)))
    for number, at in enumerate(PLACES):
        moved = middle(left.labels == 11 + number) - middle(right.labels == 11 + number)
        assert moved == pytest.approx([LENS.fx * baseline / at[2], 0.0], abs=0.15)


def test_the_nearer_body_is_seen():
    with Offscreen(LENS) as made:
        made.add("far", *ball(0.02), Look(label=1))
        made.add("near", *ball(0.004), METAL)
        made.place("far", [*world(np.array([0.0, 0.0, 0.2])), 0.0, 0.0, 0.0, 1.0])
        made.place("near", [*world(np.array([0.0, 0.0, 0.1])), 0.0, 0.0, 0.0, 1.0])
        labels = made.take(POSE, colour=False, labels=True).labels
        column, row = np.round(LENS.project(np.array([[0.0, 0.0, 0.1]]))[0]).astype(int)
        assert labels[row, column] == METAL.label
        assert {0, 1, METAL.label} == set(np.unique(labels))
        made.place("near", None)
        assert made.take(POSE, colour=False, labels=True).labels[row, column] == 1


def test_a_shadow_falls_away_from_the_light():
    """A ball's shadow lies where the line from the light through its middle meets the plate."""
    lens = Pinhole.of_view(320, 240, 60.0)
    lamp = np.array([0.012, -0.008, 0.0])
    pose = look_at([0.0, 0.0, 0.1], [0.0, 0.0, 0.0], up=[0.0, 1.0, 0.0])
    pictures = []
    for shadows in (True, False):
        with Offscreen(lens, Light(tuple(lamp), shadows=shadows), samples=1) as made:
            made.add("plate", *plate(0.2), Look(texture=0.0))
            made.add("ball", *ball(0.003), METAL)
            made.place("ball", [*world(np.array([-0.004, 0.003, 0.05]), pose), 0.0, 0.0, 0.0, 1.0])
            pictures.append(made.take(pose, labels=True))
    darker = pictures[1].colour.sum(axis=2).astype(int) - pictures[0].colour.sum(axis=2) > 60
    darker &= pictures[0].labels == 1
    direction = np.array([-0.004, 0.003, 0.05]) - lamp
    expected = lens.project((lamp + direction * (0.1 / direction[2]))[None])[0]
    assert np.linalg.norm(middle(darker) - expected) < 2.0


def test_the_texture_sticks_to_tissue_that_deforms():
    """Where a point of the tissue goes, its colour goes; a surface that is added in that shape looks different."""
    lens = Pinhole.of_view(320, 320, 60.0)
    pose = look_at([0.0, 0.0, 0.1], [0.0, 0.0, 0.0], up=[0.0, 1.0, 0.0])
    vertices, triangles = plate(0.06)
    deformed = vertices * [1.4, 0.8, 1.0] + [0.004, -0.006, 0.0]
    places = np.random.default_rng(4).uniform(-0.025, 0.025, (3000, 2))

    def colours(shape, scale, shift):
        points = np.column_stack([places * scale + shift, np.zeros(len(places))])
        matrix = inverse_of(matrix_of(pose))
        seen = np.round(lens.project(points @ matrix[:3, :3].T + matrix[:3, 3])).astype(int)
        return shape[seen[:, 1], seen[:, 0], 0].astype(float)

    with Offscreen(lens, Light(wetness=0.0, shadows=False), samples=1) as made:
        made.add("tissue", vertices, triangles)
        before = colours(made.take(pose).colour, [1.0, 1.0], [0.0, 0.0])
        made.move("tissue", deformed)
        moved = colours(made.take(pose).colour, [1.4, 0.8], [0.004, -0.006])
        made.add("tissue", deformed, triangles)
        other = colours(made.take(pose).colour, [1.4, 0.8], [0.004, -0.006])
    assert np.corrcoef(before, moved)[0, 1] > 0.75
    assert np.corrcoef(before, other)[0, 1] < 0.4


def test_pictures_repeat(balls):
    first, second = (balls.take(POSE, depth=True, labels=True) for _ in range(2))
    assert all(np.array_equal(*pair) for pair in zip(first, second, strict=True))


def test_what_cannot_be_drawn_is_refused():
    with Offscreen(LENS) as made:
        made.add("plate", *plate(0.1))
        for attempt, reason in (
            (lambda: made.move("plat", np.zeros((4, 3))), "no body 'plat' was added; there are: plate"),
            (lambda: made.move("plate", np.zeros((4, 3))), "finite positions"),
            (lambda: made.add("a", np.zeros((2, 3)), [[0, 1, 2]]), "vertex 2 of 2"),
            (lambda: made.add("a", [[0.0, np.nan, 0.0]], [[0, 0, 0]]), "finite"),
            (lambda: made.take([0.0] * 7), "quaternion is zero"),
            (lambda: made.take([0.0] * 6), "7 finite numbers"),
            (lambda: Look(label=256), r"outside 1\.\.255"),
            (lambda: Pinhole.of_view(8, 480, 60.0), "8 x 480 pixels"),
            (lambda: look_at([0.0, 0.0, 1.0], [0.0, 0.0, 0.0]), "upward"),
            (lambda: Offscreen(LENS, samples=3), "choose 1, 2 or 4"),
        ):
            with pytest.raises(UserError, match=reason):
                attempt()


def plate(side):
    """A square in z = 0 that looks along +z, of 16 x 16 cells."""
    steps = np.linspace(-0.5 * side, 0.5 * side, 17)
    x, y = np.meshgrid(steps, steps, indexing="ij")
    corner = (np.arange(16)[:, None] * 17 + np.arange(16)).ravel()
    first = np.stack([corner, corner + 17, corner + 18], axis=1)
    second = np.stack([corner, corner + 18, corner + 1], axis=1)
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), np.concatenate([first, second])


def test_vertices_in_other_tissue_have_its_colour_and_no_others():
    looks = Look((0.0, 0.0, 1.0), texture=0.0, inner=(0.0, 1.0, 0.0)), Look((0.0, 0.0, 1.0), texture=0.0)
    vertices, triangles = plate(0.3)
    fraction = (vertices[:, 0] > 0.0).astype(float)
    with Offscreen(LENS, NOWHERE, samples=1) as made:
        made.add("plate", vertices, triangles, looks[0], fraction)
        colour = made.take(POSE).colour.astype(int)
        made.add("plate", vertices, triangles, looks[1], fraction)
        plain = made.take(POSE).colour.astype(int)
        with pytest.raises(UserError, match=r"fractions of shape"):
            made.add("plate", vertices, triangles, looks[0], fraction[:-1])
    lit, green = colour.max(axis=2) > 20, colour[..., 1] > 2 * colour[..., 2]
    assert 0.2 < green[lit].mean() < 0.8
    matrix = inverse_of(matrix_of(POSE))
    seen = np.rint(LENS.project(vertices @ matrix[:3, :3].T + matrix[:3, 3])).astype(int)
    for (column, row), within in zip(seen.tolist(), fraction > 0.5, strict=True):
        if 0 <= row < LENS.height and 0 <= column < LENS.width and lit[row, column]:
            assert green[row, column] == within
    assert not (plain[..., 1] > 2 * plain[..., 2]).any()


def test_a_tube_is_as_thick_as_its_radius_says_and_seen_from_all_sides():
    ends = np.array([[[-0.02, 0.0, 0.0], [0.02, 0.0, 0.0]], [[0.0, -0.02, 0.03], [0.0, 0.02, 0.03]]])
    vertices, triangles = tubes(ends, RADIUS)
    corner = vertices[triangles]
    outward = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    axis = np.repeat(ends.mean(axis=1), len(triangles) // 2, axis=0)
    assert (np.einsum("tx,tx->t", outward, corner.mean(axis=1) - axis) > 0.0).all()
    for line, (start, end) in enumerate(ends):
        own = vertices.reshape(2, -1, 3)[line]
        direction = (end - start) / np.linalg.norm(end - start)
        away = own - start - np.outer((own - start) @ direction, direction)
        assert np.linalg.norm(away, axis=1) == pytest.approx(RADIUS)
