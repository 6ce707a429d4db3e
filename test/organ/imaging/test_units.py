"""Lengths are those that a header means, in every format, or are refused; forms of a NIfTI have to agree."""

import numpy as np
import pytest

from helpers.shapes import write_nifti
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image_file import read_image

SIZE = (7, 6, 5)
VOXELS = np.arange(np.prod(SIZE), dtype="<i2").reshape(SIZE, order="F")


def nrrd(path, *lines):
    fields = ["NRRD0005", "type: short", "dimension: 3", f"sizes: {' '.join(map(str, SIZE))}", *lines]
    head = "\n".join([*fields, "encoding: raw", "endian: little", "", ""])
    path.write_bytes(head.encode() + VOXELS.tobytes(order="F"))
    return path


def directed(path, unit=None, step=2.0):
    """An NRRD of voxels of 2, 2, 4 in its unit, the first at 10, 20, 30."""
    units = [] if unit is None else [f"space units: {' '.join(f'"{one}"' for one in unit.split())}"]
    axes = f"space directions: ({step},0,0) (0,{step},0) (0,0,{2 * step})"
    return nrrd(path, "space: left-posterior-superior", axes, *units, "space origin: (10,20,30)")


def meta(path, *lines):
    fields = ["ObjectType = Image", "NDims = 3", f"DimSize = {' '.join(map(str, SIZE))}", "ElementType = MET_SHORT"]
    path.write_bytes("\n".join([*fields, *lines, "ElementDataFile = LOCAL", ""]).encode() + VOXELS.tobytes(order="F"))
    return path


@pytest.mark.parametrize(
    ("unit", "scale"),
    [(None, 1.0), ("mm mm mm", 1.0), ("um um um", 1e-3), ("cm cm cm", 10.0), ("m m m", 1e3), ("microns " * 3, 1e-3)],
)
def test_space_units_of_an_nrrd(tmp_path, unit, scale):
    volume = read_image(directed(tmp_path / "ct.nrrd", unit))
    np.testing.assert_allclose(volume.spacing, np.array([2.0, 2.0, 4.0]) * scale)
    np.testing.assert_allclose(volume.origin, np.array([10.0, 20.0, 30.0]) * scale)
    np.testing.assert_array_equal(volume.array, VOXELS.T)
    assert volume.notes == ()


def test_units_of_an_nrrd_with_spacings(tmp_path):
    volume = read_image(nrrd(tmp_path / "ct.nrrd", "spacings: 2 2 4", 'units: "cm" "cm" "cm"'))
    np.testing.assert_allclose(volume.spacing, [20.0, 20.0, 40.0])


@pytest.mark.parametrize("unit", ["pixel pixel pixel", "um um mm", "s s s"])
def test_units_that_are_none_are_refused(tmp_path, unit):
    with pytest.raises(UserError, match=r"ct.nrrd has space units .*; write one of mm, cm, m, um, in there") as caught:
        read_image(directed(tmp_path / "ct.nrrd", unit))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("unit", "scale"), [("um", 1e-3), ("mm", 1.0), ("cm", 10.0), ("?", 1.0)])
def test_distance_units_of_a_meta_image(tmp_path, unit, scale):
    volume = read_image(
        meta(tmp_path / "ct.mha", f"DistanceUnits = {unit}", "ElementSpacing = 2 2 4", "Offset = 1 2 3")
    )
    np.testing.assert_allclose(volume.spacing, np.array([2.0, 2.0, 4.0]) * scale)
    np.testing.assert_allclose(volume.origin, np.array([1.0, 2.0, 3.0]) * scale)


@pytest.mark.parametrize("spacing", ["0 1 1", "nan 1 1", "1 inf 1", "a b c"])
def test_spacings_that_are_none_are_refused(tmp_path, spacing):
    with pytest.raises(UserError, match=f"ElementSpacing = {spacing}, expected a number other than 0 for each axis"):
        read_image(meta(tmp_path / "ct.mha", f"ElementSpacing = {spacing}"))


def test_a_header_without_the_size_of_its_voxels_is_reported(tmp_path):
    for path in (
        nrrd(tmp_path / "ct.nrrd"),
        nrrd(tmp_path / "nan.nrrd", "spacings: nan nan nan"),
        meta(tmp_path / "ct.mha"),
    ):
        (note,) = read_image(path).notes
        assert note.startswith(f"warning: {path.name} doesn't state the size of its voxels: 1 mm was assumed")
    assert read_image(meta(tmp_path / "size.mha", "ElementSize = 2 2 4")).notes == ()


def test_a_tiff_is_refused(tmp_path):
    (tmp_path / "stack.tif").write_bytes(b"II*\0")
    with pytest.raises(UserError, match="TIFF, which doesn't state the distance of its slices"):
        read_image(tmp_path / "stack.tif")


# the two forms of a NIfTI ------------------------------------------------------------------------------

NO_TURN = (0.0, 0.0, 0.0)


def form(scale=1.0, turn=None, offset=NO_TURN):
    affine = np.eye(4)
    affine[:3, :3] = (np.eye(3) if turn is None else turn) * scale
    affine[:3, 3] = offset
    return affine


@pytest.mark.parametrize(
    ("sform", "reason"),
    [
        (form(2.0), r"voxels of 2 x 2 x 2 and of 1 x 1 x 1"),
        (form(turn=np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])), "apart"),
        (form(turn=np.diag([-1.0, 1.0, 1.0])), "apart"),
        (form(offset=(0.6, 0.0, 0.0)), r"0\.6 mm apart"),
    ],
    ids=["scaled", "turned", "mirrored", "moved"],
)
def test_forms_that_disagree_are_refused(tmp_path, sform, reason):
    write_nifti(tmp_path / "ct.nii", VOXELS, sform, quaternion=(NO_TURN, NO_TURN, np.ones(3), 1.0))
    with pytest.raises(UserError, match=f"sform and a qform that place its corners up to .*{reason}") as caught:
        read_image(tmp_path / "ct.nii")
    assert "image.set_qform(image.get_sform())" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_forms_that_agree_are_read(tmp_path):
    write_nifti(
        tmp_path / "ct.nii", VOXELS, form(offset=(0.4, 0.0, 0.0)), quaternion=(NO_TURN, NO_TURN, np.ones(3), 1.0)
    )
    volume = read_image(tmp_path / "ct.nii")
    np.testing.assert_allclose(volume.origin, [-0.4, 0.0, 0.0], atol=1e-6)
    assert volume.notes == ()


def test_a_nifti_without_a_form_is_reported(tmp_path):
    write_nifti(tmp_path / "ct.nii", VOXELS)
    assert read_image(tmp_path / "ct.nii").notes == (
        "warning: ct.nii has neither a qform nor an sform, so it is unknown which side is left",
    )
