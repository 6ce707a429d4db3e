"""The wall, marching cubes on it, and the measures of surfaces."""

import numpy as np
import pytest
from scipy import ndimage

from helpers.shapes import ball, solid
from tissue_sim.errors import UserError
from tissue_sim.organ.meshes.voxels import enclosed, off_grid
from tissue_sim.organ.surfaces.balloon import fibonacci_sphere
from tissue_sim.organ.surfaces.marching_cubes import largest_component, marching_cubes_report, marching_cubes_surface
from tissue_sim.organ.surfaces.surface import (
    _smoothed,
    closed_wall,
    compare,
    intersecting_pairs,
    make_wall,
    measure,
    wall_of_surface,
)
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface


@pytest.mark.parametrize(("spacing", "size"), [((1, 1, 1), (50, 50, 50)), ((1.0, 1.5, 3.0), (50, 34, 18))])
def test_the_wall_of_a_ball_is_a_sphere(spacing, size):
    wall = make_wall(solid(ball(18.0), spacing, size))
    positions, triangles = marching_cubes_surface(wall)
    radius = np.linalg.norm(wall.to_patient(positions) * 1e3, axis=1)
    assert abs(radius.mean() - 18.0) < 0.2
    assert radius.std() < 0.12 * max(spacing)
    quality = measure(positions, triangles)
    assert (quality.euler, quality.open_edges, quality.self_intersections) == (2, 0, 0)
    assert abs(quality.volume / (4 / 3 * np.pi * 18.0**3) - 1) < 0.03
    assert abs(wall.area() / (4 * np.pi * 18.0**2) - 1) < 0.1


def tube(radius):
    return lambda x, y, z: np.hypot(np.hypot(x, z), np.maximum(np.abs(y) - 20.0, 0.0)) - radius


@pytest.mark.parametrize(("spacing", "size"), [((1, 1, 1), (15, 55, 15)), ((1.0, 1.5, 1.2), (15, 37, 13))])
@pytest.mark.parametrize("radius", [1.7, 2.4])
def test_a_tube_of_a_few_voxels_keeps_its_volume(spacing, size, radius):
    """A Gaussian alone takes 16 to 40 % of it, and parts a thin one into pieces."""
    mask = solid(tube(radius), spacing, size)
    read = np.count_nonzero(mask.array) * mask.voxel_volume * 1e3
    wall = make_wall(mask)
    positions, triangles = marching_cubes_surface(wall)
    assert measure(positions, triangles).volume == pytest.approx(read, rel=0.02)
    assert np.ptp(positions[:, 1]) == pytest.approx(2 * (20.0 + radius), abs=1.0)
    again = wall_of_surface(positions, triangles, wall)
    voxels = np.count_nonzero(enclosed(off_grid(positions / wall.spacing), triangles, np.array(wall.level.shape[::-1])))
    assert measure(*marching_cubes_surface(again)).volume == pytest.approx(voxels * wall.spacing**3, rel=0.02)


def test_a_thick_body_is_smoothed_by_a_gaussian_alone():
    """So that organs that were built before come out bit for bit."""
    mask = solid(ball(18.0)).array
    inner, outer = (ndimage.distance_transform_edt(side) for side in (mask, ~mask))
    rough = np.where(mask, 0.5 - inner, outer - 0.5).astype(np.float32)
    np.testing.assert_array_equal(_smoothed(rough, np.ones(3)), ndimage.gaussian_filter(rough, 0.8))


def test_a_mirrored_image_keeps_triangles_outward():
    wall = make_wall(solid(ball(12.0), size=(40, 40, 40), direction=np.diag([-1.0, 1.0, 1.0])))
    positions, triangles = marching_cubes_surface(wall)
    turned = measure(wall.to_patient(positions), wall.outward(triangles))
    assert turned.volume > 0.0


def test_fragments_are_left_out_and_cavities_filled():
    def shape(x, y, z):
        shell = np.maximum(ball(16.0)(x, y, z), -ball(5.0)(x, y, z))
        return np.minimum(shell, ball(2.5)(x - 21, y, z))

    wall = make_wall(solid(shape))
    assert wall.fragments == 1
    assert 0.4 < wall.filled < 0.65  # the 5 mm cavity, mL
    assert measure(*marching_cubes_surface(wall)).euler == 2


def test_a_handle_is_closed():
    def bridge(x, y, z):
        """A ball with a groove across that a thin bar spans."""
        groove = np.maximum(np.abs(x) - 3.0, 8.0 - z)
        bar = np.maximum(np.hypot(y, z - 14.0) - 2.0, np.abs(x) - 5.0)
        return np.minimum(np.maximum(ball(20.0)(x, y, z), -groove), bar)

    wall = make_wall(solid(bridge))
    assert measure(*marching_cubes_surface(wall)).euler == 2
    assert 0.0 < wall.filled + wall.cut < 0.1  # mL: the bar's or the hole's cross-section, one voxel thick


def test_touching_loops_are_parted_and_a_pinhole_is_filled():
    def horseshoe(x, y, z):
        """Its ends touch over a neck of 2 mm radius; a pinhole of 2 mm radius goes through the bow."""
        arc = np.hypot(np.hypot(x, y) - 20.0, z) - 7.0
        open_end = np.maximum(np.abs(x) - 4.0, y)
        neck = np.maximum(np.hypot(y + 20.0, z) - 2.0, np.abs(x) - 6.0)
        pinhole = np.maximum(np.hypot(x, y - 20.0) - 2.0, -10.0 - z)
        return np.maximum(np.minimum(np.maximum(arc, -open_end), neck), -pinhole)

    mask = solid(horseshoe, size=(60, 60, 22))
    wall = make_wall(mask)
    assert measure(*marching_cubes_surface(wall)).euler == 2
    volume = mask.array.sum() * 1e-3  # mL
    assert 0.0 < wall.cut < 0.003 * volume
    assert 0.0 < wall.filled < 0.003 * volume


def test_what_marching_cubes_gives_is_counted():
    def shape(x, y, z):
        shell = np.maximum(ball(14.0)(x, y, z), -ball(3.0)(x + 6, y, z))
        bored = np.maximum(shell, 3.0 - np.hypot(x - 4.0, y))
        return np.minimum(bored, ball(2.5)(x - 21, y, z))

    mask = solid(shape)
    found = marching_cubes_report(mask)
    assert (found.islands, found.hollows, found.fragments, found.handles) == (1, 1, 2, 1)
    assert found.triangles == 2 * found.points
    assert found.quality.open_edges == 0
    wall = marching_cubes_report(make_wall(solid(ball(14.0))))
    assert (wall.fragments, wall.handles) == (0, 0)
    assert wall.triangles == 2 * wall.points - 4
    with pytest.raises(UserError, match="is empty"):
        marching_cubes_report(solid(ball(-1.0)))


def test_concentric_spheres_compare_as_they_lie():
    positions, triangles = fibonacci_sphere(4000)
    same = compare((positions, triangles), (positions, triangles))
    assert same.hausdorff == pytest.approx(0.0, abs=1e-9)
    far = compare((20.0 * positions, triangles), (21.5 * positions, triangles))
    assert far.mean == pytest.approx(1.5, rel=0.01)
    assert far.hausdorff == pytest.approx(1.5, rel=0.02)
    assert far.volume_ratio == pytest.approx(1.075**3, rel=1e-6)


def test_a_spike_counts_in_the_hausdorff_distance_only():
    positions, triangles = fibonacci_sphere(4000)
    spiked = positions.copy()
    spiked[1000] *= 1.5
    found = compare((positions, triangles), (spiked, triangles))
    assert found.hausdorff == pytest.approx(0.5, rel=0.01)
    assert found.mean < 0.002


def test_distances_to_a_surface_are_exact():
    rng = np.random.default_rng(9)
    box = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 2.0) for x in (0.0, 3.0)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], dtype=np.int32)
    points = rng.uniform(-4.0, 6.0, (2000, 3))
    low, high = box.min(axis=0), box.max(axis=0)
    outside = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
    within = np.minimum(points - low, high - points).min(axis=1)
    np.testing.assert_allclose(
        distance_to_surface(points, box, triangles), np.where(within > 0.0, within, outside), atol=1e-9
    )


def test_a_ring_is_refused():
    def torus(x, y, z):
        return np.hypot(np.hypot(x, y) - 18.0, z) - 4.0

    with pytest.raises(UserError, match="through hole"):
        make_wall(solid(torus))


def test_empty_and_tiny_masks_are_refused():
    empty = solid(ball(-1.0))
    with pytest.raises(UserError, match="is empty"):
        make_wall(empty)
    with pytest.raises(UserError, match=r"has only \d+ voxels"):
        make_wall(solid(ball(2.0)))


def test_a_closing_fills_a_slot_and_leaves_the_rest():
    def slotted(x, y, z):
        return np.maximum(ball(20.0)(x, y, z), -np.maximum(np.abs(x) - 2.0, 5.0 - z))

    wall = make_wall(solid(slotted))
    closed = closed_wall(wall, 4.0)
    middle = 0.5 * wall.spacing * (np.array(wall.level.shape[::-1]) - 1)
    in_slot, outside = [middle + np.array([0.0, 0.0, 11.0])], [middle - np.array([0.0, 0.0, 22.0])]
    assert wall.sample(in_slot)[0] > 0.0 > closed.sample(in_slot)[0]
    assert closed.sample(outside)[0] == pytest.approx(wall.sample(outside)[0])


def test_the_wall_of_a_surface_is_where_the_surface_is():
    wall = make_wall(solid(ball(18.0)))
    positions, triangles = fibonacci_sphere(2000)
    middle = np.full(3, 0.5 * wall.spacing * (wall.level.shape[0] - 1))
    again = wall_of_surface(middle + 12.0 * positions, triangles, wall)
    assert np.abs(again.sample(middle + 12.0 * positions)).mean() < 0.15
    np.testing.assert_allclose(np.linalg.norm(again.points() - middle, axis=1), 12.0, atol=0.4)
    assert again.sample([middle])[0] == pytest.approx(-12.0, abs=1.5)


def test_intersections_are_counted():
    positions, triangles = fibonacci_sphere(60)
    assert len(intersecting_pairs(positions, triangles)) == 0
    pushed = positions.copy()
    pushed[30] = -1.3 * pushed[30]  # through the far side
    assert len(intersecting_pairs(pushed, triangles)) > 0


def test_a_fold_at_a_single_point_is_an_intersection():
    """Two triangles joined at one point, the far edge of one through the other."""
    positions = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, -1], [1, 1, 1]])
    crossing = np.array([[0, 1, 2], [0, 3, 4]], dtype=np.int32)
    assert len(intersecting_pairs(positions, crossing)) == 1
    beside = positions + np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 0], [-4, -4, 0], [-4, -4, 0]])
    assert len(intersecting_pairs(beside, crossing)) == 0


def test_the_largest_component_is_kept_and_turned_outward():
    positions, triangles = fibonacci_sphere(100)
    both = np.concatenate([0.3 * positions + 5.0, positions])
    inward = np.concatenate([triangles, triangles[:, ::-1] + 100])
    kept, faces = largest_component(both, inward.astype(np.int32))
    np.testing.assert_allclose(kept, positions)
    assert measure(kept, faces).volume > 0


def test_projection_lands_on_the_wall():
    wall = make_wall(solid(ball(18.0)))
    positions, _ = fibonacci_sphere(300)
    middle = np.full(3, 0.5 * wall.spacing * (wall.level.shape[0] - 1))
    landed = wall.project(middle + 17.0 * positions)
    assert np.abs(wall.sample(landed)).max() < 0.02
    np.testing.assert_allclose(np.linalg.norm(landed - middle, axis=1), 18.0, atol=0.4)
