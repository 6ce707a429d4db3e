"""DICOM segmentations: each segment a mask at its place, whatever frames are there; volumes in many frames."""

import numpy as np
import pytest

from helpers.frames import enhanced_ct, label_map, segmentation
from helpers.shapes import small_volume, write_dicom
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image_file import read_image
from tissue_sim.organ.imaging.masks import read_mask, read_masks


def boxes():
    """Two overlapping boxes, (nz, ny, nx) bool; the second has empty slices of its own, and a gap."""
    first, second = np.zeros((8, 7, 9), dtype=bool), np.zeros((8, 7, 9), dtype=bool)
    first[0:8, 1:5, 1:6] = True
    second[3:7, 2:6, 3:8] = True
    second[5] = False
    return {"liver": first, "tumour": second}


@pytest.mark.parametrize("pixel_measures", ["shared", "frame"])
@pytest.mark.parametrize("kind", ["BINARY", "FRACTIONAL"])
def test_segments_lie_where_their_frames_say(tmp_path, kind, pixel_measures):
    path = segmentation(tmp_path / "seg.dcm", boxes(), kind=kind, pixel_measures=pixel_measures)
    for number, (name, expected) in enumerate(boxes().items(), 1):
        for label in (name, number):
            found = read_mask(path, label)
            np.testing.assert_array_equal(found.array, expected)
            np.testing.assert_allclose(found.spacing, [0.7, 0.81, 2.0])
            np.testing.assert_allclose(found.origin, [10.0, 20.0, 30.0])
            np.testing.assert_allclose(found.direction, np.eye(3), atol=1e-12)
    with pytest.raises(UserError, match=r"several labels \(1 liver, 2 tumour\); choose one with --label"):
        read_mask(path)


def test_overlapping_segments_are_whole_and_part(tmp_path):
    path = segmentation(tmp_path / "seg.dcm", boxes())
    whole, part = read_masks(path, "liver", [2])
    np.testing.assert_array_equal(whole.array, boxes()["liver"] | boxes()["tumour"])
    np.testing.assert_array_equal(part.array, boxes()["tumour"])


def test_a_label_map(tmp_path):
    liver, tumour = boxes().values()
    labels = np.where(tumour, 2, liver.astype(int)).astype(np.uint8)
    path = label_map(tmp_path / "seg.dcm", labels, {0: "background", 1: "liver", 2: "tumour"})
    np.testing.assert_array_equal(read_mask(path, "tumour").array, tumour)
    np.testing.assert_array_equal(read_mask(path, 1).array, liver & ~tumour)


def test_the_only_segmentation_of_a_folder_is_read(tmp_path):
    write_dicom(tmp_path, small_volume())
    segmentation(tmp_path / "seg.dcm", boxes())
    np.testing.assert_array_equal(read_mask(tmp_path, "liver").array, boxes()["liver"])
    segmentation(tmp_path / "second.dcm", boxes())
    with pytest.raises(UserError, match=r"contains 2 segmentations \(second.dcm, seg.dcm\); name the file of one"):
        read_mask(tmp_path, "liver")


def test_a_segmentation_is_no_ct(tmp_path):
    path = segmentation(tmp_path / "seg.dcm", boxes())
    with pytest.raises(UserError, match="is a segmentation, not a CT; give it to --mask"):
        read_image(path)


def test_a_damaged_segmentation_takes_one_line(tmp_path):
    path = segmentation(tmp_path / "seg.dcm", boxes())
    data = path.read_bytes()
    for count in range(300, len(data), len(data) // 7):
        path.write_bytes(data[:count])
        with pytest.raises(UserError, match=r"seg\.dcm") as caught:
            read_mask(path, 1)
        assert "\n" not in str(caught.value)


def test_an_element_that_claims_gigabytes_takes_one_line_and_no_room(tmp_path):
    path = segmentation(tmp_path / "seg.dcm", boxes())
    data = path.read_bytes()
    at = data.index(bytes.fromhex("00523092")) + 8  # of the groups of each frame: tag, type, two zeros, length
    path.write_bytes(data[:at] + (2**32 - 256).to_bytes(4, "little") + data[at + 4 :])
    with pytest.raises(UserError, match=r"seg\.dcm") as caught:
        read_mask(path, 1)
    assert "\n" not in str(caught.value)
    assert "MemoryError" not in str(caught.value), "it was not even asked for"


# volumes in many frames ----------------------------------------------------------------------------------


def heights(count, step=2.0):
    return [30.0 + step * k for k in range(count)]


def test_frames_are_ordered_by_their_positions(tmp_path):
    values = np.arange(5 * 6 * 7).reshape(5, 6, 7).astype(np.float32) - 100.0
    order = [3, 0, 4, 1, 2]
    path = enhanced_ct(tmp_path / "ct.dcm", values[order], [heights(5)[k] for k in order])
    for source in (path, tmp_path):
        found = read_image(source)
        np.testing.assert_array_equal(found.array, values)
        np.testing.assert_allclose(found.spacing, [0.7, 0.81, 2.0])
        np.testing.assert_allclose(found.origin, [10.0, 20.0, 30.0])


@pytest.mark.parametrize(
    "positions",
    [[30.0, 32.0, 36.0, 38.0], [30.0, 32.0, 33.0, 35.0], [30.0, 30.0, 32.0, 32.0]],
    ids=["missing", "uneven", "doubled"],
)
def test_frames_that_are_no_regular_stack_are_refused(tmp_path, positions):
    path = enhanced_ct(tmp_path / "ct.dcm", np.zeros((4, 6, 7)), positions)
    with pytest.raises(UserError, match=r"ct\.dcm has frames that don't form a regular stack"):
        read_image(path)


def test_frames_of_several_intercepts_are_refused(tmp_path):
    values = np.arange(4 * 6 * 7).reshape(4, 6, 7).astype(np.float32)
    path = enhanced_ct(tmp_path / "ct.dcm", values, heights(4), [-1024, -1024, -1024, -1024])
    np.testing.assert_array_equal(read_image(path).array, values)
    enhanced_ct(path, values, heights(4), [-1024, -1000, -1024, -1024])
    with pytest.raises(UserError, match=r"ct\.dcm has frames of several rescale slopes or intercepts"):
        read_image(path)


def test_a_mask_in_many_frames_that_is_no_segmentation_lies_where_they_say(tmp_path):
    inside = boxes()["liver"].astype(np.float32)
    path = enhanced_ct(tmp_path / "mask.dcm", inside, heights(8))
    found = read_mask(path, 1)
    np.testing.assert_array_equal(found.array, inside > 0.0)
    np.testing.assert_allclose(found.spacing, [0.7, 0.81, 2.0])
