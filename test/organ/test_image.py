"""Reading CTs and masks: one frame for all formats, and one line for what can't be used."""

import numpy as np
import pytest
import SimpleITK as sitk

from tissue_sim.errors import UserError
from tissue_sim.organ.image import Volume, from_sitk, read_image, read_mask

from .shapes import small_volume, write_dicom

OBLIQUE = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])


def assert_same(found: Volume, expected: Volume):
    np.testing.assert_array_equal(found.array, expected.array)
    corners = [[0, 0, 0], [6, 0, 0], [0, 5, 0], [0, 0, 4], [6, 5, 4]]
    np.testing.assert_allclose(found.to_points(corners), expected.to_points(corners), atol=1e-3)


@pytest.mark.parametrize("name", ["ct.nii.gz", "ct.nii", "ct.nrrd", "ct.mha"])
@pytest.mark.parametrize("direction", [np.eye(3), np.diag([-1.0, -1.0, 1.0]), OBLIQUE], ids=["lps", "ras", "oblique"])
def test_every_format_gives_the_same_points(tmp_path, name, direction):
    volume = small_volume(direction)
    sitk.WriteImage(volume.to_sitk(), str(tmp_path / name))
    assert_same(read_image(tmp_path / name), volume)


def test_a_dicom_folder_gives_the_same_points(tmp_path):
    volume = small_volume()
    write_dicom(tmp_path / "series", volume)
    assert_same(read_image(tmp_path / "series"), volume)


def test_index_and_point_are_inverse():
    volume = small_volume(OBLIQUE)
    index = np.random.default_rng(1).uniform(0, 5, (20, 3))
    np.testing.assert_allclose(volume.to_index(volume.to_points(index)), index, atol=1e-12)
    point = volume.to_points([1, 2, 3])
    np.testing.assert_allclose(point, volume.to_sitk().TransformIndexToPhysicalPoint((1, 2, 3)))


def test_a_crop_keeps_the_points():
    volume = small_volume(OBLIQUE)
    part = volume.crop((2, 1, 1), (99, 4, 3))
    assert part.size == (5, 4, 3)
    assert part.array[0, 0, 0] == volume.array[1, 1, 2]
    np.testing.assert_allclose(part.to_points([0, 0, 0]), volume.to_points([2, 1, 1]))
    with pytest.raises(UserError, match="outside the image"):
        volume.crop((9, 0, 0), (10, 5, 5))


def test_refusals_name_the_file(tmp_path):
    text = tmp_path / "notes.nii.gz"
    text.write_text("no image")
    four = tmp_path / "four.nii.gz"
    sitk.WriteImage(sitk.Image([4, 4, 4, 3], sitk.sitkInt16), str(four))
    flat = tmp_path / "flat.nrrd"
    sitk.WriteImage(sitk.Image([4, 4], sitk.sitkInt16), str(flat))
    colour = tmp_path / "colour.nrrd"
    sitk.WriteImage(sitk.Image([4, 4, 4], sitk.sitkVectorUInt8, 3), str(colour))
    cut = tmp_path / "cut.nrrd"
    sitk.WriteImage(small_volume().to_sitk(), str(cut))
    cut.write_bytes(cut.read_bytes()[:-200])
    (tmp_path / "empty").mkdir()
    for path, reason in {
        tmp_path / "none.nii": "does not exist",
        text: "can't be read as an image",
        four: r"4-D \(4 x 4 x 4 x 3\)",
        flat: "single slice",
        colour: "3 values a voxel",
        cut: "damaged or truncated",
        tmp_path / "empty": "no DICOM series",
    }.items():
        with pytest.raises(UserError, match=reason) as caught:
            read_image(path)
        assert path.name in str(caught.value)
        assert "\n" not in str(caught.value)


def test_several_series_are_named_and_chosen(tmp_path):
    volume = small_volume()
    first, second = "1.2.826.0.1.3680043.2.1125.1", "1.2.826.0.1.3680043.2.1125.2"
    write_dicom(tmp_path, volume, first, description="arterial")
    write_dicom(tmp_path, volume.with_array(volume.array + 100.0), second, description="venous")
    with pytest.raises(UserError, match=r"2 series: .*arterial, 5 slices.*venous, 5 slices.*--series"):
        read_image(tmp_path)
    assert read_image(tmp_path, second).array[0, 0, 0] == 100.0
    with pytest.raises(UserError, match=r"has no series 1\.9"):
        read_image(tmp_path, "1.9")


def test_missing_slices_are_refused(tmp_path):
    write_dicom(tmp_path, small_volume(), skip=(2,))
    with pytest.raises(UserError, match=r"misses slices: spacing is 2\.50 mm, but not between 302\.5 and 307\.5"):
        read_image(tmp_path)


def test_masks_choose_a_label(tmp_path):
    volume = small_volume()
    labels = np.zeros(volume.array.shape, dtype=np.float32)
    labels[1:3] = 2
    labels[3, 2:4] = 5
    path = tmp_path / "labels.nii.gz"
    sitk.WriteImage(sitk.Cast(volume.with_array(labels).to_sitk(), sitk.sitkUInt8), str(path))
    with pytest.raises(UserError, match=r"several labels \(2, 5\); choose one with --label"):
        read_mask(path)
    with pytest.raises(UserError, match="no label 3; it holds 2, 5"):
        read_mask(path, 3)
    np.testing.assert_array_equal(read_mask(path, 5).array, labels == 5)
    sitk.WriteImage(sitk.Image([4, 4, 4], sitk.sitkUInt8), str(path))
    with pytest.raises(UserError, match="is empty"):
        read_mask(path)


def test_an_image_is_no_mask(tmp_path):
    path = tmp_path / "ct.nrrd"
    sitk.WriteImage(small_volume().to_sitk(), str(path))
    with pytest.raises(UserError, match="209 different values"):
        read_mask(path)


def test_bool_survives_the_way_through_sitk():
    volume = small_volume()
    mask = volume.with_array(volume.array > 50)
    again = from_sitk(mask.to_sitk(), mask=True)
    assert again.array.dtype == bool
    np.testing.assert_array_equal(again.array, mask.array)
