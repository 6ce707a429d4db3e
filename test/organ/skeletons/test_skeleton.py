"""Centrelines of shapes whose middle is known."""

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree
from skimage.measure import euler_number

from helpers import vessels
from helpers.shapes import ball, solid
from tissue_sim.errors import UserError
from tissue_sim.organ.skeletons.skeleton import extract
from tissue_sim.organ.surfaces.marching_cubes import marching_cubes_surface
from tissue_sim.organ.surfaces.surface import Wall, make_wall
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface


def patient_mm(wall, skeleton):
    return wall.to_patient(skeleton.positions) * 1e3


def test_a_bent_tube():
    """Quarter of a torus: middle on a circle of 40 mm, radius 8 mm, to within a voxel."""

    def tube(x, y, z):
        u, v = x + 30.0, y + 30.0
        section = np.hypot(np.hypot(u, v) - 40.0, z) - 8.0
        return np.maximum(section, np.maximum(4.0 - u, 4.0 - v))

    wall = make_wall(solid(tube, size=(90, 90, 26)))
    skeleton = extract(wall, 48)
    points = patient_mm(wall, skeleton) + np.array([30.0, 30.0, 0.0])
    offset = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 40.0, points[:, 2])
    assert offset.mean() < 0.5
    assert offset.max() < 1.0
    assert np.abs(skeleton.radius[5:-5] - 8.0).max() < 0.7
    assert skeleton.length > 0.6 * (np.pi / 2 * 40.0 - 8.0)


def test_atoms_are_even_inside_and_a_chain(kidney_wall):
    skeleton = extract(kidney_wall, 48)
    assert skeleton.positions.shape == (48, 3)
    np.testing.assert_array_equal(skeleton.parent, np.arange(-1, 47))
    gaps = np.linalg.norm(np.diff(skeleton.positions, axis=0), axis=1)
    assert gaps.std() < 0.02 * gaps.mean()
    assert np.all(kidney_wall.sample(skeleton.positions) < -5.0)
    surface = marching_cubes_surface(kidney_wall)
    exact = distance_to_surface(skeleton.positions, *surface)
    np.testing.assert_allclose(skeleton.radius, exact, atol=0.1 * kidney_wall.spacing)


def test_an_ellipsoids_skeleton_is_its_long_axis():
    def ellipsoid(x, y, z):
        return np.sqrt((x / 10) ** 2 + (y / 12) ** 2 + (z / 35) ** 2) - 1.0

    wall = make_wall(solid(ellipsoid, size=(30, 34, 80)))
    points = patient_mm(wall, extract(wall, 20))
    assert np.hypot(points[:, 0], points[:, 1]).max() < 1.0
    assert 45.0 < np.ptp(points[:, 2]) < 62.0


def test_the_balls_skeleton_is_short_and_central():
    wall = make_wall(solid(ball(18.0)))
    points = patient_mm(wall, extract(wall, 7))
    assert np.linalg.norm(points, axis=1).max() < 9.0
    one = extract(wall, 1)
    assert one.positions.shape == (1, 3)
    assert np.linalg.norm(patient_mm(wall, one)) < 1.5
    assert one.radius[0] == pytest.approx(18.0, abs=1.2)


def test_the_middle_is_found_between_voxels_of_any_spacing():
    def rod(x, y, z):
        return np.maximum(np.hypot(x - 0.4, y - 0.3) - 7.0, np.abs(z) - 30.0)

    wall = make_wall(solid(rod, spacing=(1.0, 1.2, 2.5), size=(24, 20, 32)))
    points = patient_mm(wall, extract(wall, 30))
    away = cKDTree(np.stack([np.full(601, 0.4), np.full(601, 0.3), np.linspace(-30, 30, 601)], axis=1)).query(points)[0]
    assert away.mean() < 0.3
    assert away.max() < 1.2


def test_thin_organs_and_no_atoms_are_refused():
    wall = make_wall(solid(ball(18.0)))
    with pytest.raises(UserError, match="--atoms 0 is too few"):
        extract(wall, 0)

    def sheet(x, y, z):
        return np.maximum(np.abs(z) - 1.2, np.hypot(x, y) - 18.0)

    with pytest.raises(UserError, match="too thin"):
        extract(make_wall(solid(sheet)), 48)


TUBES = {
    "straight": vessels.straight(direction=(1, 2, 3)),
    "quarter torus": vessels.quarter_torus(),
    "S-bend": vessels.s_bend(),
    "helix": vessels.helix(),
    "thin helix": vessels.helix(radius=3.5),
    "tapered": vessels.straight(4.0, 80.0, (1, 2, 3), 12.0),
    "bent capsule": vessels.quarter_torus(30.0, 10.0),
}


UNEVEN = {"straight", "S-bend", "thin helix"}  # of the tubes, in voxels that are no cubes; the others in cubes


@pytest.mark.parametrize(
    ("name", "spacing"),
    [
        pytest.param(name, spacing, marks=[] if (name in UNEVEN) == uneven else pytest.mark.extended)
        for name in TUBES
        for uneven, spacing in ((False, (1.0, 1.0, 1.0)), (True, (0.9, 1.1, 2.0)))
    ],
)
def test_tubes_to_half_a_voxel(name, spacing, capsys):
    tube = TUBES[name]
    wall = make_wall(vessels.mask_of([tube], spacing, shift=(0.37, 0.21, 0.44)))
    skeleton = extract(wall, 60)
    points = patient_mm(wall, skeleton)
    offset = cKDTree(vessels.dense(tube)).query(points)[0] / wall.spacing
    with capsys.disabled():
        print(f"\n{name}, {spacing} mm: mean offset {offset.mean():.3f} voxels, most {offset.max():.2f}")
    assert offset.mean() <= 0.5
    # The middle of the row; the ends may lie a little past the tube's own, towards its round caps.
    assert offset[3:-3].max() <= 1.0
    assert np.all(wall.sample(skeleton.positions) < -0.4 * tube.radius.min())
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert apart.std() < 0.02 * apart.mean()
    assert skeleton.length == pytest.approx(tube.arc[-1], rel=0.1)


@pytest.mark.parametrize(
    ("axes", "spacing"),
    [
        ((10, 12, 35), (1.0, 1.0, 1.0)),
        ((12, 12, 40), (0.8, 1.0, 1.6)),
        ((8, 16, 40), (1.0, 1.0, 1.0)),
        ((10, 20, 30), (0.8, 1.0, 1.6)),
        pytest.param((10, 12, 35), (0.8, 1.0, 1.6), marks=pytest.mark.extended),
        pytest.param((12, 12, 40), (1.0, 1.0, 1.0), marks=pytest.mark.extended),
        pytest.param((8, 16, 40), (0.8, 1.0, 1.6), marks=pytest.mark.extended),
        pytest.param((10, 20, 30), (1.0, 1.0, 1.0), marks=pytest.mark.extended),
    ],
)
def test_ellipsoids_to_half_a_voxel(axes, spacing, capsys):
    """The middle is the long axis, also where a flat ellipsoid's ridge is a sheet."""
    a, b, c = axes

    def ellipsoid(x, y, z):
        return np.sqrt((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2) - 1.0

    size = tuple(int(2 * r / s) + 10 for r, s in zip(axes, spacing, strict=True))
    wall = make_wall(solid(ellipsoid, spacing=spacing, size=size))
    points = patient_mm(wall, extract(wall, 40))
    offset = np.hypot(points[:, 0], points[:, 1]) / wall.spacing
    with capsys.disabled():
        print(f"\nellipsoid {axes}, {spacing} mm: mean offset {offset.mean():.3f} voxels, most {offset.max():.2f}")
    assert offset.mean() <= 0.5
    assert np.ptp(points[:, 2]) > 1.1 * c
    apart = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert apart.std() < 0.02 * apart.mean()


def test_touching_loops_are_followed_the_long_way():
    """A ring that touches itself: its middle goes round, not through the touching place."""
    a = np.linspace(0.0, 2.0 * np.pi - 0.30, 181)
    ring = vessels.tube(np.stack([40.0 * np.cos(a), 40.0 * np.sin(a), 0.0 * a], axis=1), 7.0)
    mask = vessels.mask_of([ring])
    solid_ = np.pad(mask.array, 3)
    level = np.where(solid_, 0.5 - distance_transform_edt(solid_), distance_transform_edt(~solid_) - 0.5)
    assert euler_number(solid_, connectivity=1) == 0, "the ends must touch"
    skeleton = extract(Wall(level.astype(np.float32), 1.0, np.zeros(3), np.eye(3)), 60)
    assert skeleton.branches == 1
    assert skeleton.length > 0.9 * 40.0 * (2.0 * np.pi - 0.30)


def test_the_skeleton_keeps_to_a_grid_larger_than_the_organ():
    mask = vessels.mask_of([vessels.quarter_torus()])
    wall = make_wall(mask)
    large = replace(wall, level=np.pad(wall.level, 20, constant_values=9.0), origin=wall.origin - 20.0 * wall.spacing)
    np.testing.assert_allclose(
        large.to_patient(extract(large, 30).positions), wall.to_patient(extract(wall, 30).positions), atol=1e-9
    )


@pytest.mark.slow
def test_a_grid_of_300_voxels_a_side(capsys):
    g = np.arange(300) - 149.5
    z, y, x = np.meshgrid(g, g, g, indexing="ij", sparse=True)
    inside = np.sqrt((x / 60) ** 2 + (y / 70) ** 2 + (z / 140) ** 2) < 1.0
    level = np.where(inside, 0.5 - distance_transform_edt(inside), 0.5).astype(np.float32)
    extract(make_wall(solid(ball(18.0))), 10)  # compiles
    started = time.process_time()
    skeleton = extract(Wall(level, 1.0, np.full(3, -149.5), np.eye(3)), 100)
    took = time.process_time() - started
    with capsys.disabled():
        print(f"\n300^3 grid, {np.count_nonzero(inside)} voxels inside: {took:.1f} s of CPU")
    assert took < 20.0
    assert np.hypot(*(skeleton.positions[:, :2] - 149.5).T).mean() < 0.5
