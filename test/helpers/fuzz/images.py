"""Hostile images and masks: wrong headers, names of other files, truncated streams, bombs; DICOM folders."""

import gzip
import struct
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import SimpleITK as sitk
from hypothesis import strategies as st

from helpers.fuzz.child import OUTSIDE, Input, Ready
from helpers.fuzz.dicom import changed_field
from helpers.fuzz.mutations import BOMB, ODD_FLOATS, Draw, chance, gz_bomb, mutation, odd_count, of_bytes, of_text, some
from tissue_sim.organ.imaging.image import Volume
from tissue_sim.organ.imaging.image_file import read_image
from tissue_sim.organ.imaging.itk_output import silenced
from tissue_sim.organ.imaging.masks import read_mask
from tissue_sim.organ.imaging.phantom import PhantomParameters, make_phantom

_SMALL = PhantomParameters(spacing=(12.0, 12.0, 14.0), noise=0.0)
_SLICES = 5  # of a DICOM folder
SERIES = "series"

Files = dict[str, bytes]


class Form(NamedTuple):
    """Format: the name that is read, how its header is falsified, and whether it is packed."""

    file: str
    falsify: Callable[[Draw, bytes], bytes]
    compressed: bool = False


def prepare(path: Path, mask: bool) -> Ready:
    """Read one of each format, intact."""
    _use_intact()
    return lambda: _use(path, mask)


@cache
def _use_intact() -> None:
    folder = Path(tempfile.gettempdir())
    (folder / SERIES).mkdir()
    for form in FORMS:
        for name, data in _written(form.file, False, form.compressed).items():
            (folder / name).write_bytes(data)
        _use(folder / form.file, False)
    for name, data in _slices().items():
        (folder / SERIES / name).write_bytes(data)
    _use(folder / SERIES, False)


def _use(path: Path, mask: bool) -> str:
    volume = read_mask(path) if mask else read_image(path)
    check_place(volume)
    assert mask or np.all(np.isfinite(volume.array)), "voxels that are not finite"
    return f"{' x '.join(map(str, volume.size))} voxels"


def check_place(volume: Volume) -> None:
    """Check that the place of an image is finite, and that it has an extent."""
    for name, values in (("spacing", volume.spacing), ("origin", volume.origin), ("direction", volume.direction)):
        assert np.all(np.isfinite(values)), f"{name} {values} of an image that was read"
    extends = np.all(volume.spacing > 0.0) and abs(np.linalg.det(volume.direction)) >= 0.5
    assert extends, f"an image of spacing {volume.spacing} that was read"


@st.composite
def images(draw: Draw) -> Input:
    """Images and masks with one or more mutations, one in five a DICOM folder."""
    mask = chance(draw, 30)
    if chance(draw, 20):
        slices = {f"{SERIES}/{name}": data for name, data in _mutated_slices(draw).items()}
        return Input({SERIES: None, **slices}, SERIES, prepare, (mask,))
    form: Form = some(draw, FORMS)
    return Input(_mutated(draw, form, mask), form.file, prepare, (mask,))


def _mutated(draw: Draw, form: Form, mask: bool) -> Files:
    files = dict(_written(form.file, mask, form.compressed))
    if form.compressed and chance(draw, 1):
        return files | {form.file: _bomb(form, files[form.file])}
    packed = form.file.endswith(".gz")
    if chance(draw, 30 if packed else 50):  # anything in a file, as it lies on the disk
        name = some(draw, sorted(files))
        return files | {name: of_bytes(draw, files[name])}
    mutate = of_bytes if packed and chance(draw, 30) else form.falsify
    if packed:
        return {form.file: gzip.compress(mutate(draw, gzip.decompress(files[form.file])), 1, mtime=0)}
    return files | {form.file: mutate(draw, files[form.file])}


# whole files --------------------------------------------------------------------------------------


@cache
def _phantom() -> tuple[Volume, Volume]:
    made = make_phantom(_SMALL)
    return made.ct, made.kidney


@cache
def _written(file: str, mask: bool, compressed: bool) -> Files:
    volume = _phantom()[mask]
    image = volume.to_sitk() if mask else sitk.Cast(volume.to_sitk(), sitk.sitkInt16)
    with tempfile.TemporaryDirectory() as folder, silenced():  # ITK may leave another locale
        sitk.WriteImage(image, str(Path(folder) / file), compressed)
        return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


# headers that lie ---------------------------------------------------------------------------------

# Offset and type of those fields of NIfTI-1 that determine how the rest is read.
_NIFTI = (
    *((0, "<i"), (40, "<h"), (42, "<h"), (44, "<h"), (46, "<h"), (48, "<h"), (70, "<h"), (72, "<h"), (76, "<f")),
    *((80, "<f"), (84, "<f"), (88, "<f"), (108, "<f"), (112, "<f"), (116, "<f"), (123, "<b"), (252, "<h")),
    *((254, "<h"), (256, "<f"), (260, "<f"), (268, "<f"), (280, "<f"), (300, "<f"), (320, "<f"), (344, "<i")),
)


def _nifti(draw: Draw, data: bytes) -> bytes:
    made = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        at, kind = some(draw, _NIFTI)
        size = struct.calcsize(kind)
        if kind == "<f":
            with np.errstate(all="ignore"):
                made[at : at + 4] = np.float32(draw(ODD_FLOATS)).tobytes()
        elif chance(draw, 20):
            made[at : at + size] = (2 ** (8 * size - 1) - 1).to_bytes(size, "little")  # as many as there can be
        else:
            value = odd_count(draw, struct.unpack_from(kind, made, at)[0]) % 2 ** (8 * size)
            made[at : at + size] = value.to_bytes(size, "little")
    if chance(draw, 10):
        # An extension that says that it is as long as it likes.
        made[348:360] = b"\1\0\0\0" + struct.pack("<II", odd_count(draw, 16) % 2**32, 4)
    return bytes(made)


_SIZES = (b"1000 1000 1000", b"100000 100000 100000", b"-1 17 12", b"0 0 0", b"24 17", b"24 17 12 5", b"2147483647 2 2")
_OTHER = f"../{OUTSIDE}".encode()
_OTHER_FILES = (_OTHER, b"/etc/passwd", b"LIST", b"LIST 2", b"%d 1 9 1", _OTHER + b" outside", b"image")
_META_FIELDS = (
    (b"DimSize = ", _SIZES),
    (b"ElementDataFile = ", (*_OTHER_FILES, b"LOCAL")),
    (b"ElementSpacing = ", (b"nan nan nan", b"0 0 0", b"-1 -1 -1", b"inf 1 1", b"1e300 1 1", b"1")),
    (b"TransformMatrix = ", (b"0 0 0 0 0 0 0 0 0", b"nan 0 0 0 1 0 0 0 1", b"1 1 0 0 1 0 0 0 1", b"1e9 0 0")),
    (b"Offset = ", (b"nan 0 0", b"1e400 0 0", b"x")),
    (b"ElementType = ", (b"MET_DOUBLE", b"MET_CHAR", b"MET_LONG_LONG", b"MET_NONE", b"MET_STRING", b"x" * 5000)),
    (b"NDims = ", (b"0", b"-1", b"2", b"4", b"11", b"1000000000")),
    (b"ElementNumberOfChannels = ", (b"0", b"3", b"-1", b"1000000000")),
    (b"HeaderSize = ", (b"-1", b"-2", b"1000000000", b"9223372036854775807")),
    (b"CompressedData = ", (b"True", b"False", b"maybe")),
    (b"CompressedDataSize = ", (b"0", b"-1", b"1000000000000", b"10")),
    (b"BinaryDataByteOrderMSB = ", (b"True", b"False")),
    (b"BinaryData = ", (b"False", b"True")),
)
_NRRD_FIELDS = (
    (b"sizes: ", _SIZES),
    (b"data file: ", _OTHER_FILES),
    (b"datafile: ", _OTHER_FILES),
    (b"space directions: ", (b"(nan,0,0) (0,1,0) (0,0,1)", b"(0,0,0) (0,0,0) (0,0,0)", b"none none none", b"(1,1,0)")),
    (b"space origin: ", (b"(nan,0,0)", b"(1e400,0,0)", b"x")),
    (b"type: ", (b"double", b"int8", b"uint64", b"block", b"string")),
    (b"block size: ", (b"1000000000", b"-1")),
    (b"dimension: ", (b"0", b"-1", b"2", b"4", b"17", b"1000000000")),
    (b"encoding: ", (b"raw", b"gzip", b"bzip2", b"ascii", b"hex", b"zrl", b"x")),
    (b"endian: ", (b"big", b"x")),
    (b"line skip: ", (b"1000000000", b"-1")),
    (b"byte skip: ", (b"1000000000000", b"-1", b"-2")),
    (b"kinds: ", (b"vector domain domain", b"x")),
    (b"space: ", (b"right-anterior-superior", b"scanner-xyz-time", b"x")),
)


def _text_header(draw: Draw, data: bytes, end: bytes, fields: Sequence[tuple[bytes, Sequence[bytes]]]) -> bytes:
    """Change the head of a text header: another value of a field, or mutated words and lines."""
    head, mark, rest = data.partition(end)
    if chance(draw, 40):
        return of_text(draw, head) + mark + rest
    lines = (head + mark).split(b"\n")
    field, values = some(draw, fields)
    value = some(draw, values)
    changed = [field + value if line.startswith(field) else line for line in lines]
    if changed == lines:
        changed.insert(1 if len(lines) < 3 else len(lines) - 2, field + value)
    return b"\n".join(changed) + rest


def _meta(draw: Draw, data: bytes) -> bytes:
    return _text_header(draw, data, b"ElementDataFile = LOCAL", _META_FIELDS)


def _nrrd(draw: Draw, data: bytes) -> bytes:
    return _text_header(draw, data, b"\n\n", _NRRD_FIELDS)


def _bomb(form: Form, data: bytes) -> bytes:
    """A file of some MB that unpacks to BOMB zeros, as its header says."""
    if form.file.endswith(".nii.gz"):
        header = bytearray(gzip.decompress(data)[:352])
        struct.pack_into("<4h", header, 40, 3, 1000, 1000, BOMB // 2 // 1_000_000)
        return gz_bomb(bytes(header))
    bomb, end = gz_bomb(), b"\n\n" if form.file.endswith(".nrrd") else b"ElementDataFile = LOCAL\n"
    changed = {
        b"sizes:": b"sizes: 1000 1000 1000",
        b"DimSize": b"DimSize = 1000 1000 1000",
        b"CompressedDataSize": b"CompressedDataSize = %d" % len(bomb),
    }
    lines = [changed.get(line.split(b" ")[0], line) for line in data.partition(end)[0].split(b"\n")]
    return b"\n".join(lines) + end + bomb


FORMS = (
    Form("image.nii", _nifti),
    Form("image.nii.gz", _nifti, compressed=True),
    Form("image.hdr", _nifti),  # its voxels are in image.img
    Form("image.nrrd", _nrrd),
    Form("image.nrrd", _nrrd, compressed=True),
    Form("image.nhdr", _nrrd),  # in image.raw
    Form("image.mha", _meta),
    Form("image.mha", _meta, compressed=True),
    Form("image.mhd", _meta),  # in image.raw
)


# DICOM --------------------------------------------------------------------------------------------


@cache
def _slices() -> Files:
    """A series as GDCM writes it."""
    volume = _phantom()[0]
    uid = "1.2.826.0.1.3680043.2.1125.1"
    with tempfile.TemporaryDirectory() as folder, silenced():
        for k in range(_SLICES):
            image = sitk.Cast(volume.to_sitk()[:, :, k], sitk.sitkInt16)
            tags = {
                "0008|0008": "ORIGINAL\\PRIMARY\\AXIAL",
                "0008|0016": "1.2.840.10008.5.1.4.1.1.2",
                "0008|0018": f"{uid}.{k + 1}",
                "0008|0060": "CT",
                "0020|000d": f"{uid}.99",
                "0020|000e": uid,
                "0020|0013": str(k + 1),
                "0020|0032": "\\".join(f"{value:g}" for value in volume.to_points([0, 0, k])),
                "0020|0037": "1\\0\\0\\0\\1\\0",
            }
            for tag, value in tags.items():
                image.SetMetaData(tag, value)
            writer = sitk.ImageFileWriter()
            writer.KeepOriginalImageUIDOn()
            writer.SetFileName(str(Path(folder) / f"{k}.dcm"))
            writer.Execute(image)
        return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


# Group and element of tags that determine how the pixels are read.
_TAGS = {
    "samples": (0x28, 0x02),
    "frames": (0x28, 0x08),
    "rows": (0x28, 0x10),
    "columns": (0x28, 0x11),
    "pixel spacing": (0x28, 0x30),
    "bits": (0x28, 0x100),
    "bits stored": (0x28, 0x101),
    "high bit": (0x28, 0x102),
    "representation": (0x28, 0x103),
    "intercept": (0x28, 0x1052),
    "slope": (0x28, 0x1053),
    "position": (0x20, 0x32),
    "orientation": (0x20, 0x37),
    "series": (0x20, 0x0E),
    "instance": (0x08, 0x18),
    "transfer syntax": (0x02, 0x10),
    "pixels": (0x7FE0, 0x10),
}


def _mutated_slices(draw: Draw) -> Files:
    files = dict(_slices())
    for name in sorted(draw(st.sets(st.sampled_from(sorted(files)), min_size=1))):
        if chance(draw, 5):
            del files[name]
        else:
            files[name] = mutation(draw, (_tag, _tag, _tag, _tag, of_bytes))(draw, files[name])
    return files


def _tag(draw: Draw, data: bytes) -> bytes:
    return changed_field(draw, data, _TAGS)
