"""Reading CTs and masks: one frame for all formats, and one line for what can't be used."""

import locale
import subprocess
import sys

import numpy as np
import pytest
import SimpleITK as sitk

from helpers.shapes import small_volume, write_dicom
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import Volume, from_sitk
from tissue_sim.organ.imaging.image_file import read_image
from tissue_sim.organ.imaging.masks import read_mask

OBLIQUE = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
TURNED = OBLIQUE @ np.array([[1.0, 0.0, 0.0], [0.0, 0.28, -0.96], [0.0, 0.96, 0.28]])  # every axis oblique


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


def test_the_locale_stays_as_it_was(tmp_path):
    """ITK's reader of VTK images sets another, in which Python reads no text but ASCII."""
    sitk.WriteImage(small_volume().to_sitk(), str(tmp_path / "ct.vtk"))
    before = locale.setlocale(locale.LC_ALL)
    read_image(tmp_path / "ct.vtk")
    assert locale.setlocale(locale.LC_ALL) == before


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
        colour: "3 values per voxel",
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
    with pytest.raises(UserError, match=r"lacks slices: the spacing is 2\.50 mm, but not between 302\.5 and 307\.5"):
        read_image(tmp_path)


def test_dicom_slices_are_ordered_by_position_whatever_the_orientation(tmp_path):
    volume = small_volume(TURNED)
    write_dicom(tmp_path / "turned", volume)
    assert_same(read_image(tmp_path / "turned"), volume)
    behind = volume.array[::-1].copy()  # the same slices with the rows' normal pointing back down the stack
    origin, direction = volume.to_points([0, 0, 4]), TURNED * np.array([1.0, 1.0, -1.0])
    left_handed = Volume(behind, volume.spacing, origin, direction)
    write_dicom(tmp_path / "back", left_handed)
    assert_same(read_image(tmp_path / "back"), volume)


@pytest.mark.parametrize("rescale", [(1.0, -1024.0), (0.5, -1000.25), (2.5, 7.0)])
def test_dicom_rescale_slope_and_intercept_give_hounsfield_units(tmp_path, rescale):
    volume = small_volume()
    hu = volume.with_array((np.arange(210, dtype=np.float32).reshape(5, 6, 7) - 30) * rescale[0] + rescale[1])
    write_dicom(tmp_path / "series", hu, rescale=rescale)
    found = read_image(tmp_path / "series")
    assert found.array.dtype == np.float32
    np.testing.assert_allclose(found.array, hu.array, atol=1e-4)


def test_localizers_are_left_out_and_noted(tmp_path):
    volume = small_volume()
    write_dicom(tmp_path, volume)
    sagittal = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    scout = Volume(volume.array[:1], volume.spacing, volume.origin, sagittal)
    write_dicom(tmp_path / "scout", scout, "1.2.826.0.1.3680043.2.1125.7")
    own = {(0x0020, 0x000E): ("UI", "1.2.826.0.1.3680043.2.1125.1")}  # a scout under the CT's own series
    write_dicom(tmp_path / "within", scout, "1.2.826.0.1.3680043.2.1125.8", changed=own)
    for folder, noted in (("scout", "1 other series"), ("within", "1 pictures of another geometry")):
        both = tmp_path / f"{folder}_both"
        both.mkdir()
        for file in [*tmp_path.glob("*.dcm"), *(tmp_path / folder).glob("*.dcm")]:
            (both / file.name).write_bytes(file.read_bytes())
        (both / "README.txt").write_text("no DICOM")
        found = read_image(both)
        assert_same(found, volume)
        assert len(found.notes) == 1
        assert noted in found.notes[0]


def test_dicom_folders_that_are_not_one_whole_upright_volume(tmp_path):
    volume = small_volume(OBLIQUE)
    again = "1.2.826.0.1.3680043.2.1125.2"
    one_series = {(0x0020, 0x000E): ("UI", "1.2.826.0.1.3680043.2.1125.1")}
    write_dicom(tmp_path / "four", volume)
    write_dicom(tmp_path / "four", volume, again, changed=one_series)
    write_dicom(tmp_path / "mixed", volume)
    other = Volume(volume.array[:, :5, :5], volume.spacing, volume.origin, volume.direction)
    write_dicom(tmp_path / "mixed", other, again, changed=one_series)
    write_dicom(tmp_path / "tilted", volume, shear=0.6)
    write_dicom(tmp_path / "nowhere", volume, changed={(0x0020, 0x0032): None})
    write_dicom(tmp_path / "unscaled", volume, changed={(0x0028, 0x0030): None})
    write_dicom(tmp_path / "one", volume, skip=(1, 2, 3, 4))
    write_dicom(tmp_path / "above" / "series", volume)
    for name, reason in {
        "four": "is 4-D, 2 slices at each position",
        "mixed": r"different geometry \(5 slices of 7 x 6, 5 slices of 5 x 5\)",
        "tilted": r"shift sideways by 2\.4 mm .*tilted gantry",
        "nowhere": "have no position",
        "unscaled": "have no position, orientation or pixel spacing",
        "one": "single slice",
        "above": r"no DICOM series; .*it has the folders series",
    }.items():
        with pytest.raises(UserError, match=reason) as caught:
            read_image(tmp_path / name)
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_slice_exported_twice_counts_once(tmp_path):
    volume = small_volume()
    write_dicom(tmp_path, volume)
    copy = sorted(tmp_path.glob("*.dcm"))[2]
    (tmp_path / "again.dcm").write_bytes(copy.read_bytes())
    found = read_image(tmp_path)
    assert_same(found, volume)
    assert found.notes == ("omitted 1 copies of slices",)


def test_a_series_is_chosen_by_its_number_too(tmp_path):
    volume = small_volume()
    write_dicom(tmp_path, volume)
    write_dicom(tmp_path, volume.with_array(volume.array + 100.0), "1.2.826.0.1.3680043.2.1125.2")
    assert read_image(tmp_path, "2").array[0, 0, 0] == 100.0


def test_voxels_without_a_value_are_read_as_air(tmp_path):
    volume = small_volume()
    holed = volume.array.copy()
    holed[0, 0, :2], holed[4, 5, 6] = np.nan, np.inf
    path = tmp_path / "holed.nrrd"
    sitk.WriteImage(volume.with_array(holed).to_sitk(), str(path))
    found = read_image(path)
    assert found.notes == ("read 3 voxels without a value (NaN or infinite) as air",)
    np.testing.assert_array_equal(found.array, np.where(np.isfinite(holed), holed, -1024.0))
    sitk.WriteImage(volume.with_array(np.full_like(holed, np.nan)).to_sitk(), str(path))
    with pytest.raises(UserError, match="no finite values"):
        read_image(path)


@pytest.mark.extended
def test_a_large_ct_takes_little_more_than_its_own_memory(tmp_path):
    size = (96, 320, 320)
    array = np.random.default_rng(2).integers(-1000, 1000, size).astype(np.float32)
    volume = Volume(array, np.ones(3), np.zeros(3), np.eye(3))
    sitk.WriteImage(sitk.Cast(volume.to_sitk(), sitk.sitkInt16), str(tmp_path / "ct.nrrd"))
    write_dicom(tmp_path / "series", volume)
    small = Volume(array[:8, :8, :8].copy(), np.ones(3), np.zeros(3), np.eye(3))
    sitk.WriteImage(sitk.Cast(small.to_sitk(), sitk.sitkInt16), str(tmp_path / "small.nrrd"))
    code = (  # the first image brings libraries and kernels with it, which are not the image's
        "import re, sys; from tissue_sim.organ.imaging.image_file import read_image; read_image(sys.argv[2])\n"
        "peak = lambda: 1024 * int(re.search(r'VmHWM:\\s+(\\d+)', open('/proc/self/status').read())[1])\n"
        "open('/proc/self/clear_refs', 'w').write('5')  # the peak counts from here\n"
        "before = peak(); volume = read_image(sys.argv[1]); print((peak() - before) / volume.array.size)"
    )
    for source, most in (("ct.nrrd", 6.8), ("series", 5.2)):  # bytes a voxel: float32, and int16 before it
        run = subprocess.run(
            [sys.executable, "-c", code, str(tmp_path / source), str(tmp_path / "small.nrrd")],
            capture_output=True,
            text=True,
            check=True,
        )
        assert 3.5 < float(run.stdout) < most, source


def test_masks_choose_a_label(tmp_path):
    volume = small_volume()
    labels = np.zeros(volume.array.shape, dtype=np.float32)
    labels[1:3] = 2
    labels[3, 2:4] = 5
    path = tmp_path / "labels.nii.gz"
    sitk.WriteImage(sitk.Cast(volume.with_array(labels).to_sitk(), sitk.sitkUInt8), str(path))
    with pytest.raises(UserError, match=r"several labels \(2, 5\); choose one with --label"):
        read_mask(path)
    with pytest.raises(UserError, match="no label 3; it has 2, 5"):
        read_mask(path, 3)
    np.testing.assert_array_equal(read_mask(path, 5).array, labels == 5)
    sitk.WriteImage(sitk.Image([4, 4, 4], sitk.sitkUInt8), str(path))
    with pytest.raises(UserError, match="is empty"):
        read_mask(path)


def test_an_image_is_no_mask(tmp_path):
    path = tmp_path / "ct.nrrd"
    sitk.WriteImage(small_volume().to_sitk(), str(path))
    with pytest.raises(UserError, match="more than 200 different values"):
        read_mask(path)


def test_bool_survives_the_way_through_sitk():
    volume = small_volume()
    mask = volume.with_array(volume.array > 50)
    again = from_sitk(mask.to_sitk(), mask=True)
    assert again.array.dtype == bool
    np.testing.assert_array_equal(again.array, mask.array)
