"""Images whose headers lie: refused with one line, before a file elsewhere is opened or room is asked for."""

import gzip
import re
import subprocess
import sys

import numpy as np
import pytest
import SimpleITK as sitk

from helpers.shapes import small_volume, write_dicom
from tissue_sim.errors import UserError
from tissue_sim.memory import limited
from tissue_sim.organ.imaging.dicom_file import _room
from tissue_sim.organ.imaging.image import AIR
from tissue_sim.organ.imaging.image_file import read_image
from tissue_sim.organ.imaging.masks import read_mask
from tissue_sim.organ.imaging.voxel_files import MOST_VOXELS, check_room

ELSEWHERE = ["../outside.raw", "/etc/passwd", "a/../../outside.raw", "-", ""]
EXTENDED = pytest.mark.extended
SEVERAL = ["LIST", "LIST 2", "%03d.raw 1 5 1"]


def written(folder, name, packed=False):
    """An image in a folder, and the path of its header."""
    folder.mkdir(exist_ok=True)
    (folder.parent / "outside.raw").write_bytes(bytes(1000))
    sitk.WriteImage(sitk.Cast(small_volume().to_sitk(), sitk.sitkInt16), str(folder / name), packed)
    return folder / name


def altered(path, pattern, line):
    """A line of its header replaced; the line is put before the last one where there is none."""
    data = path.read_bytes()
    made, count = re.subn(rb"(?m)^" + pattern.encode() + rb"[^\n]*", lambda _: line.encode(), data, count=1)
    assert count
    path.write_bytes(made)
    return path


FIELDS = [
    ("ct.nhdr", "data file: "),
    ("ct.nhdr", "Data  File:"),
    ("ct.nhdr", "datafile: "),
    ("ct.mhd", "ElementDataFile = "),
    ("ct.mhd", "ElementDataFile : "),
]


@pytest.mark.parametrize(
    ("name", "field", "other"),
    [
        # Every other file in the usual field of each format, and one in every way to write the field.
        pytest.param(
            *field, other, marks=[] if field in (FIELDS[0], FIELDS[3]) or other == "a/../../outside.raw" else EXTENDED
        )
        for other in ELSEWHERE + SEVERAL
        for field in FIELDS
    ],
)
def test_voxels_elsewhere_are_not_opened(tmp_path, name, field, other):
    path = written(tmp_path / "ct", name)
    path = altered(path, "(data file|ElementDataFile)", f"{field}{other}")
    reason = "several files" if other in SEVERAL else "not in its folder"
    with pytest.raises(UserError, match=reason) as caught:
        read_image(path)
    assert "\n" not in str(caught.value)


def test_an_attached_header_names_no_file_elsewhere_either(tmp_path):
    path = written(tmp_path / "ct", "ct.nrrd")
    path.write_bytes(path.read_bytes().replace(b"\n\n", b"\ndata file: ../outside.raw\n\n", 1))
    with pytest.raises(UserError, match="not in its folder"):
        read_image(path)


@pytest.mark.parametrize(("name", "field"), [("ct.nhdr", "data file: "), ("ct.mhd", "ElementDataFile = ")])
def test_voxels_in_a_folder_below_are_read(tmp_path, name, field):
    path = written(tmp_path / "ct", name)
    (raw,) = (tmp_path / "ct").glob("*raw*")
    (tmp_path / "ct" / "below").mkdir()
    raw.rename(tmp_path / "ct" / "below" / raw.name)
    expected = read_image(written(tmp_path / "other", "ct.nrrd")).array
    found = read_image(altered(path, "(data file|ElementDataFile)", f"{field}./below/{raw.name}")).array
    np.testing.assert_array_equal(found, expected)


def test_a_folder_in_place_of_voxels_is_refused(tmp_path):
    path = written(tmp_path / "ct", "ct.nhdr")
    (tmp_path / "ct" / "raw").mkdir()
    with pytest.raises(UserError, match="which is not a file"):
        read_image(altered(path, "data file", "data file: raw"))


@pytest.mark.parametrize(
    ("name", "pattern", "line", "reason"),
    [
        ("ct.nrrd", "sizes", "sizes: 2147483647 2 2", "million; crop it"),
        ("ct.nrrd", "sizes", "sizes: 800 800 800", "can't contain"),
        ("ct.nhdr", "sizes", "sizes: 4294967295 5 6", "million; crop it"),
        ("ct.mha", "DimSize", "DimSize = 800 800 800", "can't contain"),
        ("ct.mhd", "DimSize", "DimSize = 100000 100000 100000", "DimSize"),
        ("ct.mha", "DimSize", "DimSize =", "DimSize"),
    ],
)
@pytest.mark.parametrize("packed", [False, True])
def test_more_voxels_than_the_files_hold_are_refused(tmp_path, name, pattern, line, reason, packed):
    path = altered(written(tmp_path / "ct", name, packed), pattern, line)
    with pytest.raises(UserError, match=reason) as caught:
        read_image(path)
    assert "llocat" not in str(caught.value)


@pytest.mark.parametrize("size", ["1000000000000", "-1", "nan", "x"])
def test_a_packed_size_beyond_the_file_is_refused(tmp_path, size):
    path = altered(written(tmp_path / "ct", "ct.mha", True), "CompressedDataSize", f"CompressedDataSize = {size}")
    with pytest.raises(UserError, match="CompressedDataSize = "):
        read_image(path)


def test_nifti_of_more_voxels_than_it_holds_is_refused(tmp_path):
    for name in ("ct.nii", "ct.hdr", "ct.img"):
        path = written(tmp_path / "ct", name)
        head = path.with_suffix(".hdr") if name == "ct.img" else path
        data = bytearray(head.read_bytes())
        data[40:48] = np.array([3, 800, 800, 800], dtype="<i2").tobytes()
        head.write_bytes(data)
        with pytest.raises(UserError, match="is cut off: it has"):
            read_image(path)


PLAIN, PACKED = ["ct.nii", "ct.nrrd", "ct.mha"], ["ct.nii.gz", "packed.nrrd", "packed.mha"]


@pytest.mark.parametrize(
    ("name", "damage"),
    [*((name, damage) for name in PLAIN + PACKED for damage in ("none", "cut off")), *((n, "changed") for n in PACKED)],
)
def test_an_image_that_was_cut_off_or_changed_is_not_read_in_part(tmp_path, name, damage):
    """ITK reads what is there, and leaves the rest of the voxels as it finds them."""
    voxels = np.random.default_rng(1).integers(-900, 900, (12, 14, 16), dtype=np.int16)
    path = tmp_path / name
    sitk.WriteImage(sitk.GetImageFromArray(voxels), str(path), useCompression=name in PACKED)
    data = path.read_bytes()
    if damage == "none":
        np.testing.assert_array_equal(read_image(path).array, voxels)
        return
    half = len(data) // 2
    path.write_bytes(data[: len(data) - 40] if damage == "cut off" else data[:half] + bytes(40) + data[half + 40 :])
    with pytest.raises(UserError, match=r"is cut off|is damaged|has a damaged header"):
        read_image(path)


def test_a_mask_that_packs_well_has_room(tmp_path):
    """Of zeros a byte unpacks to a thousand."""
    path = tmp_path / "mask.nii.gz"
    path.write_bytes(bytes(3000))
    check_room(path, (), (150, 150, 130), 1)
    with pytest.raises(UserError, match="can't contain"):
        check_room(path, (), (150, 150, 150), 1)
    with pytest.raises(UserError, match="million"):
        check_room(path, (), (MOST_VOXELS, 2), 1)


def test_a_header_without_its_end_is_refused(tmp_path):
    path = tmp_path / "ct.mha"
    path.write_bytes(b"ObjectType = Image\nNDims = 3\n")
    with pytest.raises(UserError, match="no ElementDataFile"):
        read_image(path)
    path = tmp_path / "ct.nrrd"
    path.write_bytes(b"NRRD0004\n" + b"# long\n" * 200_000)
    with pytest.raises(UserError, match="no empty line"):
        read_image(path)


def test_nrrd_as_text_is_refused(tmp_path):
    """ITK dies of text that breaks off; in a process of its own, where that would be seen."""
    path = altered(written(tmp_path / "ct", "ct.nrrd"), "encoding", "encoding: ASCII")
    head, _, _ = path.read_bytes().partition(b"\n\n")
    path.write_bytes(head + b"\n\n" + bytes(1000))
    code = f"from tissue_sim.organ.imaging.image_file import read_image; read_image({str(path)!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "as text (encoding: ASCII)" in done.stderr.splitlines()[-1]


def test_axes_that_cannot_be_straightened_are_refused(tmp_path):
    """Another transform than ITK puts up with, with the permission, too."""
    path = written(tmp_path / "ct", "ct.nii")
    data = bytearray(path.read_bytes())
    data[252:256] = np.array([0, 1], dtype="<i2").tobytes()
    data[280:328] = np.array([[1, 1, 0, 0], [1, 1, 0, 0], [0, 0, 0, 0]], dtype="<f4").tobytes()
    path.write_bytes(data)
    with pytest.raises(UserError, match="skewed axes"):
        read_image(path)


# An element of a DICOM header that says it is 1 GB long, in place of one that is.
def test_a_dicom_element_of_a_gigabyte_asks_for_no_room(tmp_path):
    write_dicom(tmp_path / "series", small_volume())
    last = sorted((tmp_path / "series").iterdir())[-1]
    data = last.read_bytes()
    at = data.index(b"\x28\x00\x02\x00")  # samples per pixel
    long = data[:at] + b"\x27\x00\x10\x00OB\0\0" + (1 << 30).to_bytes(4, "little") + data[at:]
    last.write_bytes(long)
    code = (
        "import re, sys\n"
        "from tissue_sim.organ.imaging import dicom_file\n"
        "peak = lambda: int(re.search(r'VmHWM:\\s*(\\d+)', open('/proc/self/status').read())[1]) / 1024\n"
        "before = peak()\n"
        f"assert dicom_file.read_header({str(last)!r}) is None\n"
        "sys.exit(int(peak() - before))\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode < 200  # MB
    found = read_image(tmp_path / "series")
    assert found.size[2] == small_volume().size[2] - 1
    with pytest.raises(UserError, match=r"labels|more than 200 different values"):
        read_mask(tmp_path / "series")


def test_the_limit_holds_and_is_lifted(tmp_path):
    (tmp_path / "a.dcm").write_bytes(bytes(100))
    with limited(_room(str(tmp_path / "a.dcm"))), pytest.raises(MemoryError):
        np.ones(1 << 27)
    assert np.ones(1 << 25).size == 1 << 25


@pytest.mark.parametrize("name", ["ct.nii", "ct.nii.gz", "ct.hdr", "ct.img"])
@pytest.mark.parametrize(("at", "form"), [(300, "sform"), (320, "sform"), (256, "qform")])
def test_a_transform_that_is_not_finite_is_refused(tmp_path, name, at, form):
    """ITK would look for its axes without end."""
    path = written(tmp_path / "ct", name)
    head = path.with_suffix(".hdr") if name == "ct.img" else path
    data = bytearray(gzip.decompress(head.read_bytes()) if name.endswith(".gz") else head.read_bytes())
    data[280:284] = bytes(4)
    data[at : at + 4] = np.float32(np.inf).tobytes()
    head.write_bytes(gzip.compress(data) if name.endswith(".gz") else data)
    with pytest.raises(UserError, match=f"its {form} contains numbers that are not finite"):
        read_image(path)


def test_values_beyond_single_precision_are_read_as_air(tmp_path, recwarn):
    volume = small_volume()
    array = volume.array.astype(np.float64)
    array[0, 0, 0] = 1e300
    sitk.WriteImage(sitk.GetImageFromArray(array), str(tmp_path / "ct.nrrd"))
    found = read_image(tmp_path / "ct.nrrd")
    assert found.array[0, 0, 0] == AIR
    assert found.notes == ("read 1 voxels without a value (NaN or infinite) as air",)
    assert not recwarn.list
