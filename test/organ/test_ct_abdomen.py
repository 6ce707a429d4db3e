"""A real CT, 3 mm and without contrast agent: one seed in the left kidney."""

from pathlib import Path

import numpy as np
import pytest

from tissue_sim.cli import main
from tissue_sim.organ.image import read_image, read_mask
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.segmentation import dice, segment
from tissue_sim.organ.surface import measure

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "ct_abdomen"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"no {DATA.name} in ../shared/data beside the project")

SEED = np.array([85.0, -110.3, 364.3])


def test_the_left_kidney_becomes_an_organ(tmp_path, capsys):
    out = tmp_path / "kidney.npz"
    code = main(["build", str(DATA / "ct.nii.gz"), "--seed", ",".join(map(str, SEED)), "--out", str(out)])
    assert code == 0, capsys.readouterr().err
    organ = Organ.load(out)
    assert (organ.n_surface, len(organ.surface_triangles), organ.n_atoms) == (994, 1984, 48)
    assert 110e-6 < organ.volume < 170e-6
    quality = measure(organ.surface_positions, organ.surface_triangles)
    assert quality.self_intersections == 0
    assert quality.least_angle > 10.0
    assert organ.provenance["wall_distance_mm"] < 0.75  # half a voxel of the working grid


@pytest.mark.parametrize("offset", [(0, 0, 0), (0, -30, -42), (-9, 6, 18)])
def test_dice_of_the_left_kidney_from_one_seed(offset, capsys):
    ct = read_image(DATA / "ct.nii.gz")
    overlap = dice(segment(ct, SEED + np.array(offset)).mask, read_mask(DATA / "kidney_left.nii.gz"))
    with capsys.disabled():
        print(f"\nleft kidney, seed {SEED + np.array(offset)}: Dice {overlap:.3f}")
    assert overlap > 0.9
