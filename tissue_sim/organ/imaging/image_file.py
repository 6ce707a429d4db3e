"""Images in files: formats, headers and their checks."""

from __future__ import annotations

import re
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import SimpleITK as sitk

from tissue_sim.array_types import Floats
from tissue_sim.environment import environment
from tissue_sim.errors import UserError
from tissue_sim.file_kinds import IMAGE, unpacked_size, wrong_kind
from tissue_sim.memory import limited
from tissue_sim.organ.imaging.dicom import read_stack
from tissue_sim.organ.imaging.dicom_file import Stack, is_dicom
from tissue_sim.organ.imaging.dicom_frames import read_frames
from tissue_sim.organ.imaging.image import AIR, Volume, from_sitk
from tissue_sim.organ.imaging.itk_output import silenced
from tissue_sim.organ.imaging.meta_header import read_meta_header
from tissue_sim.organ.imaging.nifti_header import read_nifti_header
from tissue_sim.organ.imaging.nrrd_header import read_nrrd_header
from tissue_sim.organ.imaging.voxel_files import LONGEST_HEADER, Header, check_count, check_room

_LARGEST_AXIS = 1e9  # mm, of a step between voxels
_LARGEST_SKEW = 1e-3  # cosine between two axes
_PAIR = re.compile(r"\.(hdr|img)(\.gz)?$", re.IGNORECASE)  # NIfTI in two files
_PERMISSIVE = "ITK_NIFTI_SFORM_PERMISSIVE"  # how skewed a NIfTI is, is checked here
_UNSCALED = (".tif", ".tiff", ".lsm")  # ITK takes the distance of their slices for 1 mm
_BLANK = re.compile(rb"\r?\n\r?\n")  # ends a NRRD's header
_NRRD_PACKED = re.compile(rb"^encoding: *gz(ip)?\s", re.MULTILINE | re.IGNORECASE)
_NRRD_ELSEWHERE = re.compile(rb"^(data ?file|byte ?skip|line ?skip):", re.MULTILINE | re.IGNORECASE)
_META_DATA = re.compile(rb"^ElementDataFile *= *local *\r?\n", re.MULTILINE | re.IGNORECASE)  # ends a MetaImage's
_META_PACKED = re.compile(rb"^CompressedData *= *True", re.MULTILINE | re.IGNORECASE)
_ROOM = 1 << 28  # bytes that reading a header may need beside those of the file, whatever its counts say
FORMATS = "NIfTI, NRRD, MHA or a DICOM folder"


def read_image(path: str | Path, series: str | None = None) -> Volume:
    """Read a CT: a NIfTI, NRRD or MHA file, or a folder that holds one DICOM series.

    Rescale slope and intercept are applied, so the values are HU. Voxels that are not numbers (outside the scanned
    field) are read as air and noted.

    Parameters
    ----------
    path : str | Path
        File or folder.
    series : str | None, optional
        Series to take when a folder holds several, by UID or number.

    Raises
    ------
    UserError
        Where the image is missing, unreadable, not 3-D, of skewed axes, or without finite values, and where DICOM
        slices are missing.
    """
    source = Path(path)
    if not source.exists():
        raise UserError(f"image {source} does not exist; name a {FORMATS}")
    if series is not None and not source.is_dir():
        raise UserError(f"--series chooses a series in a DICOM folder; {source} is a file")
    if source.is_dir():
        volume = of_stack(read_stack(source, series), source.name)
    elif is_dicom(source):
        volume = of_stack(read_frames(source), source.name)
    else:
        image, notes = read_file(source)
        volume = replace(from_sitk(image, source.name), notes=notes)
    bad = 0
    for layer in volume.array:  # slice by slice: no second volume in memory
        wrong = ~np.isfinite(layer)
        if wrong.any():
            bad += int(np.count_nonzero(wrong))
            layer[wrong] = AIR
    if bad == volume.array.size:
        raise UserError(f"image {source} has no finite values")
    note = f"read {bad} voxels without a value (NaN or infinite) as air"
    return replace(volume, notes=(*volume.notes, note)) if bad else volume


def of_stack(stack: Stack, name: str) -> Volume:
    """Return a DICOM series, or the frames of a DICOM file, as a Volume.

    Parameters
    ----------
    stack : Stack
        The series.
    name : str
        Name for messages.
    """
    return Volume(stack.array, stack.spacing, stack.origin, stack.direction, name, stack.notes)


def read_file(path: Path, *, layers: bool = False) -> tuple[sitk.Image, tuple[str, ...]]:
    """Read a 3-D image file, placed in mm in LPS as its header says.

    Parameters
    ----------
    path : Path
        The file.
    layers : bool, optional
        Whether voxels may hold several values, as in segmentations whose segments overlap.

    Returns
    -------
    tuple[sitk.Image, tuple[str, ...]]
        The image, and remarks, one line each.

    Raises
    ------
    UserError
        Where the file can't be read, isn't 3-D, or has axes that deviate from right angles by more than a thousandth.
    """
    _check_kind(path)
    if path.suffix.lower() in _UNSCALED:
        raise UserError(f"{path} is a TIFF, which doesn't state the distance of its slices; save it as NRRD or MHA")
    header = _header(path)
    if header is not None and header.affine is not None:
        _check_axes(path, header.affine[:3, :3])  # ITK finds no direction in some that are not at right angles
    if header is not None:
        _check_whole(path, header)
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    # A header of ours was looked at before; others ITK takes at their word.
    bounds = nullcontext() if header is not None else limited(_ROOM + 4 * path.stat().st_size)
    try:
        with silenced(), environment({_PERMISSIVE: "ON"}), bounds:
            reader.ReadImageInformation()
        size, dimension = reader.GetSize(), reader.GetDimension()
        components = reader.GetNumberOfComponents()
    except (RuntimeError, MemoryError) as error:
        reason = "a length that is more than it can hold" if isinstance(error, MemoryError) else _reason(error)
        raise UserError(f"{path} can't be read as an image ({reason}); name a {FORMATS}") from None
    if components != 1 and not layers:
        raise UserError(f"{path} has {components} values per voxel; a CT or mask has one")
    if dimension > 3 and any(n != 1 for n in size[3:]):
        shape = " x ".join(str(n) for n in size)
        raise UserError(f"{path} is {dimension}-D ({shape}); extract one 3-D volume first")
    if dimension < 3 or min(size[:3]) < 2:
        shape = " x ".join(str(n) for n in size)
        raise UserError(f"{path} is a single slice ({shape}), but a 3-D volume is needed")
    if header is None:
        check_count(path, size)
    else:
        check_room(path, header.beside, size, sitk.Image([1, 1], reader.GetPixelID()).GetSizeOfPixelComponent())
    try:
        with silenced(), environment({_PERMISSIVE: "ON"}):
            image = reader.Execute()
    except (RuntimeError, MemoryError) as error:
        raise UserError(f"{path} is damaged or truncated ({_reason(error)})") from None
    image = image if dimension == 3 else image[(slice(None),) * 3 + (0,) * (dimension - 3)]
    _place(path, image, header or Header())
    return image, header.notes if header else ()


def _check_kind(path: Path) -> None:
    """Refuse a file that is empty, or of another kind than an image."""
    try:
        if other := wrong_kind(path, IMAGE):
            raise UserError(f"{path} {other}, and not an image; name a {FORMATS}")
    except OSError as error:
        raise UserError(f"{path} can't be read: {error.strerror}") from None


def _check_whole(path: Path, header: Header) -> None:
    """Refuse a file whose voxels are cut off or whose compressed data is changed: ITK reads what is there."""
    file = next((one for one in header.beside if one.is_file()), path)
    held = unpacked_size(file, _packed_from(file))
    if held is None:
        raise UserError(f"{file} is damaged: its compressed data is cut off or changed; copy or export it again")
    if held < header.least:
        raise UserError(
            f"{file} is cut off: it has {held} bytes, and its header states {header.least}; copy or export it again"
        )


def _packed_from(path: Path) -> int:
    """Return where a NRRD's or a MetaImage's own voxels begin if they are compressed; otherwise 0."""
    with path.open("rb") as stream:
        head = stream.read(LONGEST_HEADER)
    is_nrrd = head.startswith(b"NRRD")
    end = (_BLANK if is_nrrd else _META_DATA).search(head)
    if end is None:
        return 0
    said = head[: end.end()]
    if is_nrrd:
        is_packed = bool(_NRRD_PACKED.search(said)) and not _NRRD_ELSEWHERE.search(said)
    else:
        is_packed = bool(_META_PACKED.search(said))
    return end.end() if is_packed else 0


def _place(path: Path, image: sitk.Image, header: Header) -> None:
    """Place an image where its header says, in mm. Raises UserError as _check_axes does."""
    axes = np.array(image.GetDirection()).reshape(3, 3) * image.GetSpacing() * header.unit
    origin = np.array(image.GetOrigin()) * header.unit
    if header.affine is not None:
        axes, origin = header.affine[:3, :3], header.affine[:3, 3]
    spacing = _check_axes(path, axes)
    image.SetSpacing(spacing.tolist())
    image.SetOrigin(origin.tolist())
    image.SetDirection((axes / spacing).ravel().tolist())


def _check_axes(path: Path, axes: Floats) -> Floats:
    """Return the lengths (3,) of the columns of axes (3, 3); raises UserError where they are huge or skewed."""
    if not np.all(np.abs(axes) <= _LARGEST_AXIS):
        raise UserError(f"{path} has a damaged header: its axes contain numbers that are not finite, or too large")
    length = np.linalg.norm(axes, axis=0)
    unit = axes / np.maximum(length, 1e-300)
    if length.min() <= 0.0 or np.abs(np.triu(unit.T @ unit, 1)).max() > _LARGEST_SKEW:
        raise UserError(f"{path} has skewed axes (a tilted gantry); resample it onto an upright grid first")
    return length


def _header(path: Path) -> Header | None:
    """Return what an image's header says; None for an unknown format. Raises UserError as the readers do."""
    if not path.is_file():
        return None
    name = path.name.lower()
    if name.endswith((".mha", ".mhd")):
        return read_meta_header(path)
    if name.endswith((".nrrd", ".nhdr")):
        return read_nrrd_header(path)
    if name.endswith((".nii", ".nii.gz")):
        return read_nifti_header(path)
    if not _PAIR.search(name):
        return None
    stem = _PAIR.sub("", str(path))
    pair = [Path(f"{stem}{suffix}") for suffix in (".hdr", ".hdr.gz", ".img", ".img.gz")]
    found = [read_nifti_header(header) for header in pair[:2] if header.is_file()]
    return (found[0] if found else Header())._replace(beside=tuple(pair[2:]))


def _reason(error: BaseException) -> str:
    """Return the informative line of an ITK exception."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if any("Unable to determine ImageIO reader" in line for line in lines):
        return "its format is unknown"
    telling = [line for line in lines if "ERROR" in line or "rror:" in line] or lines or [type(error).__name__]
    text = telling[-1].split("):")[-1].strip()
    return text[:160] if text else "unknown error"
