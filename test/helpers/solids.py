"""What every balloon must be, whatever the organ: closed, even, without folds; and how near it lies to the wall."""

from tissue_sim.organ.surfaces.marching_cubes import marching_cubes_surface
from tissue_sim.organ.surfaces.surface import compare, measure


def assert_regular(positions, triangles, points):
    assert positions.shape == (points, 3)
    assert triangles.shape == (2 * points - 4, 3)
    quality = measure(positions, triangles)
    assert (quality.euler, quality.open_edges, quality.self_intersections) == (2, 0, 0)
    assert quality.edge_variation <= 0.25
    assert quality.least_angle >= 20.0
    assert quality.volume > 0.0
    return quality


def assert_near(balloon, wall, hausdorff=1.5):
    """Distances in voxels of the wall's grid, from the wall's marching cubes surface."""
    found = compare(marching_cubes_surface(wall), (balloon.positions, balloon.triangles))
    assert found.hausdorff <= hausdorff * wall.spacing
    assert found.mean <= 0.4 * wall.spacing
    assert abs(found.volume_ratio - 1.0) <= 0.02
    assert balloon.warnings == ()
    return found
