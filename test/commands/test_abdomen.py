"""`tissue_sim abdomen`: organs that touch nowhere, a scene that is read again, and refusals."""

import itertools

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, label

from tissue_sim.cli import main
from tissue_sim.commands.abdomen import BREATHS, DISPLACEMENT, PARTS
from tissue_sim.contact.scene_file import SceneFile

pytest.importorskip("SimpleITK")
GAP = 4.0  # mm

VOLUMES = {"liver": (1000, 1800), "kidney_left": (110, 250), "kidney_right": (110, 250), "spleen": (80, 250)}  # mL


@pytest.fixture(scope="module")
def masks():
    from tissue_sim.organ.imaging.abdomen import make_abdomen

    return make_abdomen()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("abdomen")
    assert main(["abdomen", "--out", str(folder), "--points", "150", "--as-built"]) == 0
    return folder


def test_organs_are_of_a_persons_size_in_one_piece_and_whole(masks):
    assert set(masks) == {part.name for part in PARTS}
    for name, mask in masks.items():
        least, most = VOLUMES[name]
        assert least < mask.array.sum() * mask.voxel_volume < most, name
        assert label(mask.array)[1] == 1, name
        faces = [np.take(mask.array, end, axis) for axis in range(3) for end in (0, -1)]
        assert not any(face.any() for face in faces), f"{name} is cut by the image"


@pytest.mark.parametrize(("one", "other"), itertools.combinations(VOLUMES, 2))
def test_organs_touch_nowhere(masks, one, other):
    """Middles of voxels: their faces are half a voxel nearer."""
    away = distance_transform_edt(~masks[one].array, sampling=masks[one].spacing)
    assert away[masks[other].array].min() >= GAP


def test_the_right_kidney_is_the_left_ones_mirror_image_lower(masks):
    left, right = masks["kidney_left"], masks["kidney_right"]
    lower = round(12.0 / left.spacing[2])
    np.testing.assert_array_equal(right.array[:-lower], left.array[lower:, :, ::-1])


@pytest.mark.extended
def test_the_scene_is_read_again_and_breathes(folder):
    said = SceneFile.read(folder / "abdomen.yaml")
    assert said.names == tuple(part.name for part in PARTS)
    assert said.breathing.rate == BREATHS
    assert len(said.attachments) == 3
    apart = said.organs[0].surface_positions.mean(axis=0) - said.organs[1].surface_positions.mean(axis=0)
    assert apart[0] < -0.05, "the liver lies to the right, and x leads to the left"
    for organ in said.organs:
        assert len(organ.fixed) > 3, organ.name
        assert organ.volume > 0.9e-6 * VOLUMES[organ.name][0] * 0.9, organ.name


@pytest.mark.extended
def test_info_tells_it(folder, capsys):
    assert main(["info", str(folder / "abdomen.yaml")]) == 0
    output = capsys.readouterr().out
    assert all(part.name in output for part in PARTS)
    assert f"{BREATHS:g} a minute, 0, 0, {1e3 * DISPLACEMENT[2]:g} mm" in output


@pytest.mark.extended
def test_masks_of_a_ct_make_the_same_scene(masks, folder, tmp_path):
    import SimpleITK as sitk

    for name, mask in masks.items():
        sitk.WriteImage(sitk.Cast(mask.to_sitk(), sitk.sitkUInt8), str(tmp_path / f"{name}.nii.gz"))
    out = tmp_path / "out"
    assert main(["abdomen", "--masks", str(tmp_path), "--out", str(out), "--points", "150", "--as-built"]) == 0
    for one, other in zip(*(SceneFile.read(at / "abdomen.yaml").organs for at in (folder, out)), strict=True):
        np.testing.assert_allclose(one.surface_positions, other.surface_positions, atol=1e-6)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--masks", "."], "has no mask liver"),
        (["--points", "2"], "2"),
        (["--jobs", "0"], "--jobs 0 is less than 1"),
    ],
)
def test_what_cannot_be_made_takes_one_line(tmp_path, monkeypatch, capsys, words, line):
    monkeypatch.chdir(tmp_path)
    assert main(["abdomen", *words]) == 2
    said = capsys.readouterr().err
    assert line in said
    assert said.count("\n") == 1
