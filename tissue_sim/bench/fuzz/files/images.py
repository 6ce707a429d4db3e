"""Hostile images and masks: wrong headers, names of other files, truncated streams, bombs; DICOM folders."""

from __future__ import annotations

import gzip
import struct
import tempfile
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import SimpleITK as sitk

from tissue_sim.bench.fuzz.cases import Broken, Case, Input
from tissue_sim.bench.fuzz.files.mutations import BOMB, Rng, gz_bomb, odd_count, odd_float, of_bytes, of_text, some
from tissue_sim.bench.fuzz.files.zips import OUTSIDE
from tissue_sim.organ.imaging.image import Volume, read_image
from tissue_sim.organ.imaging.masks import read_mask
from tissue_sim.organ.imaging.phantom import PhantomParameters, make_phantom

_SMALL = PhantomParameters(spacing=(12.0, 12.0, 14.0), noise=0.0)
_SLICES = 5  # of a DICOM folder
_BOMBS = 0.01  # fraction of the cases

Files = dict[str, bytes]


class Form(NamedTuple):
    """Format: the name that is read, whether it is packed, and how its header is falsified."""

    name: str
    file: str
    lie: Callable[[Rng, Files, str], str]
    beside: str = ""  # the file of the voxels, where it is another
    compressed: bool = False


def prepare(case: Case, folder: Path) -> Input:
    """Make an image or a mask with one or more mutations."""
    rng = case.rng()
    as_mask = rng.random() < 0.3
    if rng.random() < 0.2:
        files, what = _dicom(rng)
        path = folder / "series"
        path.mkdir()
        what = f"DICOM: {what}"
    else:
        form = some(rng, _FORMS)
        files, what = mutated(rng, form, as_mask)
        path, what = folder, f"{form.name}{' mask' if as_mask else ''}: {what}"
    for name, data in files.items():
        (path / name).write_bytes(data)
    source = path if path != folder else folder / form.file
    return Input(what, lambda: use(source, mask=as_mask))


def warm_up(folder: Path) -> None:
    """Read one of each format."""
    for form in _FORMS:
        for name, data in _written(form.file, False, form.compressed).items():
            (folder / name).write_bytes(data)
        use(folder / form.file, mask=False)
    series = folder / "series"
    series.mkdir()
    for name, data in _slices().items():
        (series / name).write_bytes(data)
    use(series, mask=False)


def use(path: Path, *, mask: bool) -> str:
    """Read an image or a mask and check that its voxels and its position are finite."""
    volume = read_mask(path) if mask else read_image(path)
    check_place(volume)
    if not mask and not np.all(np.isfinite(volume.array)):
        raise Broken("voxels that are not finite")
    return f"{' x '.join(map(str, volume.size))} voxels"


def check_place(volume: Volume) -> None:
    """Raise Broken for an image whose place is not finite, or that has no extent."""
    for name, values in (("spacing", volume.spacing), ("origin", volume.origin), ("direction", volume.direction)):
        if not np.all(np.isfinite(values)):
            raise Broken(f"{name} {values} of an image that was read")
    if np.any(volume.spacing <= 0.0) or abs(np.linalg.det(volume.direction)) < 0.5:
        raise Broken(f"an image of spacing {volume.spacing} that was read")


def mutated(rng: Rng, form: Form, mask: bool) -> tuple[Files, str]:
    """Return the files of an image with a mutation, and its description."""
    files = dict(_written(form.file, mask, form.compressed))
    if rng.random() < _BOMBS and form.compressed:
        return _bomb(form, files)
    packed = form.file.endswith(".gz")
    if rng.random() < 0.5:
        if packed:
            files[form.file] = gzip.decompress(files[form.file])
        told = form.lie(rng, files, form.file)
        if packed:
            files[form.file] = gzip.compress(files[form.file], 1, mtime=0)
        return files, told
    if packed and rng.random() < 0.4:
        data, told = of_bytes(rng, gzip.decompress(files[form.file]))
        files[form.file] = gzip.compress(data, 1, mtime=0)
        return files, f"{told}, then packed"
    name = some(rng, sorted(files))
    files[name], told = of_bytes(rng, files[name])
    return files, told if len(files) == 1 else f"{name}: {told}"


# whole files --------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _phantom() -> tuple[Volume, Volume]:
    made = make_phantom(_SMALL)
    return made.ct, made.kidney


@lru_cache(maxsize=32)
def _written(file: str, mask: bool, compressed: bool) -> Files:
    volume = _phantom()[mask]
    image = volume.to_sitk() if mask else sitk.Cast(volume.to_sitk(), sitk.sitkInt16)
    with tempfile.TemporaryDirectory() as folder:
        sitk.WriteImage(image, str(Path(folder) / file), compressed)
        return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


# headers that lie ---------------------------------------------------------------------------------

# Offset and type of those fields of NIfTI-1 that determine how the rest is read.
_NIFTI = (
    *((0, "<i"), (40, "<h"), (42, "<h"), (44, "<h"), (46, "<h"), (48, "<h"), (70, "<h"), (72, "<h"), (76, "<f")),
    *((80, "<f"), (84, "<f"), (88, "<f"), (108, "<f"), (112, "<f"), (116, "<f"), (123, "<b"), (252, "<h")),
    *((254, "<h"), (256, "<f"), (260, "<f"), (268, "<f"), (280, "<f"), (300, "<f"), (320, "<f"), (344, "<i")),
)


def _nifti(rng: Rng, files: Files, name: str) -> str:
    data, told = bytearray(files[name]), []
    for _ in range(int(rng.integers(1, 4))):
        at, kind = some(rng, _NIFTI)
        if kind == "<f":
            value = odd_float(rng)
            with np.errstate(all="ignore"):
                data[at : at + 4] = np.float32(value).tobytes()
            told.append(f"{value:g} at {at}")
            continue
        size = struct.calcsize(kind)
        number = odd_count(rng, struct.unpack_from(kind, data, at)[0]) % 2 ** (8 * size)
        if rng.random() < 0.2:
            number = 2 ** (8 * size - 1) - 1  # as many as there can be
        data[at : at + size] = number.to_bytes(size, "little")
        told.append(f"{number} at {at}")
    if rng.random() < 0.1:
        # An extension that says that it is as long as it likes.
        data[348:352] = b"\1\0\0\0"
        data[352:360] = struct.pack("<II", odd_count(rng, 16) % 2**32, 4)
        told.append("an extension")
    files[name] = bytes(data)
    return ", ".join(told)


_SIZES = (b"1000 1000 1000", b"100000 100000 100000", b"-1 17 12", b"0 0 0", b"24 17", b"24 17 12 5", b"2147483647 2 2")


def _text_header(rng: Rng, files: Files, name: str, end: bytes, fields: Sequence[tuple[bytes, Sequence[bytes]]]) -> str:
    """Change the head of a text header: another value of a field, or mutated words and lines."""
    head, mark, rest = files[name].partition(end)
    if rng.random() < 0.4:
        head, told = of_text(rng, head)
        files[name] = head + mark + rest
        return told
    lines = (head + mark).split(b"\n")
    field, values = some(rng, fields)
    value = some(rng, values)
    changed = [field + value if line.startswith(field) else line for line in lines]
    if changed == lines:
        changed.insert(1 if len(lines) < 3 else len(lines) - 2, field + value)
    files[name] = b"\n".join(changed) + rest
    return f"'{(field + value).decode(errors='replace')[:50]}'"


_OTHER_FILES = (
    OUTSIDE.encode(),
    b"/etc/passwd",
    b"LIST",
    b"LIST 2",
    b"%d 1 9 1",
    OUTSIDE.encode() + b" outside",
    b"image",
)


def _meta(rng: Rng, files: Files, name: str) -> str:
    fields = (
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
    return _text_header(rng, files, name, b"ElementDataFile = LOCAL", fields)


def _nrrd(rng: Rng, files: Files, name: str) -> str:
    fields = (
        (b"sizes: ", _SIZES),
        (b"data file: ", _OTHER_FILES),
        (b"datafile: ", _OTHER_FILES),
        (
            b"space directions: ",
            (b"(nan,0,0) (0,1,0) (0,0,1)", b"(0,0,0) (0,0,0) (0,0,0)", b"none none none", b"(1,1,0)"),
        ),
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
    return _text_header(rng, files, name, b"\n\n", fields)


def _bomb(form: Form, files: Files) -> tuple[Files, str]:
    """Make a file of some MB that unpacks to BOMB zeros, as its header says."""
    voxels = BOMB // 2
    if form.file.endswith(".nii.gz"):
        header = bytearray(gzip.decompress(files[form.file])[:352])
        struct.pack_into("<4h", header, 40, 3, 1000, 1000, voxels // 1_000_000)
        files[form.file] = gz_bomb(bytes(header))
    elif form.file.endswith(".nrrd"):
        head = files[form.file].partition(b"\n\n")[0]
        lines = [b"sizes: 1000 1000 1000" if line.startswith(b"sizes") else line for line in head.split(b"\n")]
        files[form.file] = b"\n".join(lines) + b"\n\n" + gz_bomb()
    else:
        bomb = gz_bomb()
        head = files[form.file].partition(b"ElementDataFile = LOCAL\n")[0]
        told = {b"DimSize": b"DimSize = 1000 1000 1000", b"CompressedDataSize": b"CompressedDataSize = %d" % len(bomb)}
        lines = [told.get(line.split(b" ")[0], line) for line in head.split(b"\n")]
        files[form.file] = b"\n".join(lines) + b"ElementDataFile = LOCAL\n" + bomb
    return files, f"unpacks to {BOMB} bytes"


_FORMS = (
    Form("NIfTI", "image.nii", _nifti),
    Form("packed NIfTI", "image.nii.gz", _nifti, compressed=True),
    Form("NIfTI in two files", "image.hdr", _nifti, "image.img"),
    Form("NRRD", "image.nrrd", _nrrd),
    Form("packed NRRD", "image.nrrd", _nrrd, compressed=True),
    Form("NRRD in two files", "image.nhdr", _nrrd, "image.raw"),
    Form("MHA", "image.mha", _meta),
    Form("packed MHA", "image.mha", _meta, compressed=True),
    Form("MHD", "image.mhd", _meta, "image.raw"),
)


# DICOM --------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _slices() -> Files:
    """Return a series as GDCM writes it."""
    volume = _phantom()[0]
    uid = "1.2.826.0.1.3680043.2.1125.1"
    with tempfile.TemporaryDirectory() as folder:
        for k in range(_SLICES):
            image = sitk.Cast(volume.to_sitk()[:, :, k], sitk.sitkInt16)
            origin = volume.to_points([0, 0, k])
            tags = {
                "0008|0008": "ORIGINAL\\PRIMARY\\AXIAL",
                "0008|0016": "1.2.840.10008.5.1.4.1.1.2",
                "0008|0018": f"{uid}.{k + 1}",
                "0008|0060": "CT",
                "0020|000d": f"{uid}.99",
                "0020|000e": uid,
                "0020|0013": str(k + 1),
                "0020|0032": "\\".join(f"{value:g}" for value in origin),
                "0020|0037": "1\\0\\0\\0\\1\\0",
            }
            for tag, value in tags.items():
                image.SetMetaData(tag, value)
            writer = sitk.ImageFileWriter()
            writer.KeepOriginalImageUIDOn()
            writer.SetFileName(str(Path(folder) / f"{k}.dcm"))
            writer.Execute(image)
        return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


# Group and element of tags that determine how the pixels are read, little-endian as in the file.
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


def _dicom(rng: Rng) -> tuple[Files, str]:
    files = dict(_slices())
    told = []
    for name in rng.permutation(sorted(files))[: int(rng.integers(1, len(files) + 1))]:
        draw = rng.random()
        if draw < 0.15:
            files[name], what = of_bytes(rng, files[name])
        elif draw < 0.2:
            del files[name]
            what = "left out"
        else:
            files[name], what = _dicom_tag(rng, files[name])
        told.append(f"{name} {what}")
    return files, "; ".join(told)


def _dicom_tag(rng: Rng, data: bytes) -> tuple[bytes, str]:
    """Change a field of the header at its first occurrence."""
    name = some(rng, sorted(_TAGS))
    at = data.find(struct.pack("<HH", *_TAGS[name]))
    return of_bytes(rng, data) if at < 0 else changed_field(rng, data, name, at)


def changed_field(rng: Rng, data: bytes, name: str, at: int) -> tuple[bytes, str]:
    """Return a DICOM file in which a field has another value of the same length, another length or another type.

    Parameters
    ----------
    rng, data : draws what is changed, and the whole file
    name : of the field, for the report of the mutation
    at : where its tag begins, bytes
    """
    made = bytearray(data)
    # Explicit VR: two letters, then two bytes of length; of OB and OW two zeros and four.
    wide = bytes(made[at + 4 : at + 6]) in (b"OB", b"OW", b"UN", b"SQ")
    start, size = (at + 12, 4) if wide else (at + 8, 2)
    length = int.from_bytes(made[start - size : start], "little")
    way = rng.random()
    if way < 0.25:
        value = odd_count(rng, length) % 2 ** (8 * size)
        made[start - size : start] = value.to_bytes(size, "little")
        return bytes(made), f"{name} of {value} bytes"
    if way < 0.35:
        made[at + 4 : at + 6] = some(rng, (b"SQ", b"UN", b"OW", b"DS", b"US", b"FL", b"??", b"AT"))
        return bytes(made), f"{name} of another type"
    if made[at + 4 : at + 6] == b"US":
        value = some(rng, (0, 1, 3, 7, 8, 12, 16, 32, 64, 255, 32_767, 65_535))
        struct.pack_into("<H", made, start, value)
        return bytes(made), f"{name} {value}"
    texts = (
        b"nan\\nan\\nan",
        b"inf",
        b"1e400\\0\\0",
        b"0\\0\\0\\0\\0\\0",
        b"-1",
        b"99999999999",
        b"1.2.840.10008.1.2.4.90",
        b"",
    )
    text = some(rng, texts)[:length].ljust(length)
    made[start : start + length] = text
    return bytes(made), f"{name} '{text.decode().strip()}'"
