"""A human large intestine from CT with a curated midline: long, folded, and its loops touch (a handle)."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from helpers import vessels
from tissue_sim.organ.meshes.voxels import enclosed, off_grid
from tissue_sim.organ.skeletons.skeleton import extract
from tissue_sim.organ.surfaces.surface import Wall
from tissue_sim.organ.surfaces.surface_distance import distance_to_surface

DATA = Path(__file__).parents[3].parent / "shared" / "data" / "large_intestine"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"no {DATA.name} in ../shared/data beside the project")
ATOMS = 250


def read_surface():
    """Points (n, 3) mm and triangles (t, 3) of the legacy VTK file."""
    lines = next(DATA.glob("*.vtk")).read_text().splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("POINTS"))
    n = int(lines[at].split()[1])
    points = np.array([line.split() for line in lines[at + 1 : at + 1 + n]], dtype=float)
    at += 1 + n
    count = int(lines[at].split()[1])
    triangles = np.array([line.split()[1:] for line in lines[at + 1 : at + 1 + count]], dtype=np.int32)
    return points, triangles


@pytest.fixture(scope="module")
def colon():
    """Wall on a 1.5 mm grid with the handle as it is, points, triangles and the curated midline (m, 3) mm."""
    points, triangles = read_surface()
    h = 1.5
    low = points.min(axis=0) - 4.0 * h
    size = np.ceil((points.max(axis=0) - low) / h).astype(np.int64) + 5
    solid = enclosed(off_grid((points - low) / h), triangles, size)
    level = np.where(solid, 0.5 - distance_transform_edt(solid), distance_transform_edt(~solid) - 0.5) * h
    midline = np.array(json.loads(next(DATA.glob("*_path.jsn")).read_text())["points"])
    return Wall(level.astype(np.float32), h, low, np.eye(3)), points, triangles, midline


@pytest.mark.extended
def test_the_curated_midline_is_found(colon, capsys):
    wall, points, triangles, midline = colon
    skeleton = extract(wall, ATOMS, branches="none")
    atoms = wall.to_patient(skeleton.positions) * 1e3
    offset, nearest = cKDTree(midline).query(atoms)
    radius = distance_to_surface(atoms, points, triangles)
    midline_radius = distance_to_surface(midline, points, triangles)
    fraction, fraction_of_midline = (offset / radius).mean(), (offset / midline_radius[nearest]).mean()
    line = vessels.dense(vessels.tube(atoms, 1.0), 0.2)
    back = cKDTree(line).query(midline)[0]
    forwards = nearest[-1] > nearest[0]
    ends = np.linalg.norm(midline[[0, -1] if forwards else [-1, 0]] - atoms[[0, -1]], axis=1)
    with capsys.disabled():
        print(
            f"\nlarge intestine: {skeleton.length:.0f} mm; atoms off the curated midline {offset.mean():.2f} mm,"
            f" {fraction:.1%} of the atom's radius, {fraction_of_midline:.1%} of the midline's; midline off the"
            f" skeleton {back.mean():.2f} mm, {back.mean() / midline_radius.mean():.1%} of its mean radius;"
            f" ends {ends[0]:.1f} and {ends[1]:.1f} mm off, radii there {radius[0]:.1f} and {radius[-1]:.1f} mm"
        )
    assert fraction <= 0.25
    assert fraction_of_midline <= 0.25
    assert back.mean() <= 0.25 * midline_radius.mean()
    assert np.all(ends <= 2.0 * radius[[0, -1]])
    # All along it, no loop is left out.
    assert np.all(back < 2.0 * np.maximum(midline_radius, radius.mean()))
    assert np.all(wall.sample(skeleton.positions) < 0.0)
    spacing = np.linalg.norm(np.diff(atoms, axis=0), axis=1)
    assert spacing.std() < 0.05 * spacing.mean()
