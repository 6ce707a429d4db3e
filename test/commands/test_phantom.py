"""`tissue_sim phantom`: a CT that `tissue_sim build` can be tried on, with the seed that it prints."""

import re

import numpy as np
import pytest

from tissue_sim.cli import main
from tissue_sim.organ.imaging.image_file import read_image
from tissue_sim.organ.imaging.masks import read_mask


def test_a_phantom_and_its_kidney_are_written(tmp_path, capsys):
    ct, mask = tmp_path / "ct.nii.gz", tmp_path / "kidney.nrrd"
    assert main(["phantom", str(ct), "--mask", str(mask), "--noise", "3"]) == 0
    output = capsys.readouterr().out
    image, kidney = read_image(ct), read_mask(mask)
    assert image.size == kidney.size
    np.testing.assert_allclose(image.to_points([3, 4, 5]), kidney.to_points([3, 4, 5]), atol=1e-3)
    assert f"a left kidney of {kidney.array.sum() * kidney.voxel_volume:.1f} mL" in output
    seed = [float(value) for value in re.search(rf"build {ct} --seed (\S+) --organ kidney", output)[1].split(",")]
    i, j, k = np.round(image.to_index(seed)).astype(int)
    assert kidney.array[k, j, i]
    assert image.array[kidney.array].std() < 25.0  # of the edge, and little noise
    assert 20.0 < np.median(image.array[kidney.array]) < 40.0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["ct.png"], "ct.png: unknown image format; use the extension .nii.gz"),
        (["nowhere/ct.nii"], "folder nowhere for nowhere/ct.nii does not exist"),
        (["ct.nii", "--mask", "ct.nii"], "--mask and the CT are both ct.nii"),
        (["ct.nii", "--noise", "-1"], "--noise -1 must lie within 0..200"),
        (["ct.nii", "--gap", "nan"], "--gap nan must lie within 0..20"),
    ],
)
def test_refusals_take_one_line(tmp_path, monkeypatch, capsys, words, expected):
    monkeypatch.chdir(tmp_path)
    assert main(["phantom", *words]) == 2
    error = capsys.readouterr().err
    assert expected in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())
