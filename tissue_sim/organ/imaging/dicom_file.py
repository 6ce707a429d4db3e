"""A DICOM file: its header and its voxels, read within bounds of time and memory."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.memory import limited
from tissue_sim.organ.imaging.itk_output import silenced

ALIKE = 1e-3  # difference of direction cosines, relative one of pixel spacings, within a stack
_SPARE = 1 << 27  # bytes of address space that GDCM and ITK may reserve beside those of a file
# Storage classes of segmentations: of a bit or a fraction for each segment, and of labels.
SEGMENTATIONS = ("1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7")


@dataclass(frozen=True, eq=False)
class Slice:
    """Header of a file with one slice."""

    file: str
    series: str
    description: str
    kind: str  # DICOM's image type
    storage: str  # UID of its storage class
    instance: str
    size: tuple[int, ...]
    components: int
    position: Floats | None
    axes: Floats | None  # (2, 3): along a row, along a column
    pixel: Floats | None  # (2,) mm: along a row, along a column

    def like(self, other: Slice) -> bool:
        """Return whether the two can lie in one stack."""
        if self.size != other.size or self.components != other.components:
            return False
        if (self.axes is None) != (other.axes is None) or (self.pixel is None) != (other.pixel is None):
            return False
        turned = 0.0 if self.axes is None or other.axes is None else np.abs(self.axes - other.axes).max()
        scaled = 0.0 if self.pixel is None or other.pixel is None else np.abs(self.pixel / other.pixel - 1.0).max()
        return float(max(turned, scaled)) < ALIKE


@dataclass(frozen=True, eq=False)
class Stack:
    """Complete series of slices in the patient frame (LPS).

    Attributes
    ----------
    array : NDArray[np.float32], shape (nz, ny, nx), HU
        Voxels.
    spacing : Floats, shape (3,), mm
        Distance of voxels along x, y, z.
    origin : Floats, shape (3,), mm
        Centre of the first voxel.
    direction : Floats, shape (3, 3)
        Columns are the voxel axes.
    notes : tuple[str, ...]
        Remarks on how it was read, one line each.
    """

    array: NDArray[np.float32]
    spacing: Floats
    origin: Floats
    direction: Floats
    notes: tuple[str, ...]


def read_header(file: str) -> Slice | None:
    """Return the header of an image; None for any other file."""
    reader = sitk.ImageFileReader()
    reader.SetImageIO("GDCMImageIO")
    reader.SetFileName(file)
    try:
        with silenced(), limited(_room(file)):
            reader.ReadImageInformation()
    except (RuntimeError, MemoryError):
        return None
    size, components = reader.GetSize(), reader.GetNumberOfComponents()

    def text(tag: str) -> str:
        return str(reader.GetMetaData(tag)).strip().strip("\0") if reader.HasMetaDataKey(tag) else ""

    axes, spacing = _numbers(text("0020|0037"), 6), _numbers(text("0028|0030"), 2)
    return Slice(
        file=file,
        series=text("0020|000e"),
        description=text("0008|103e"),
        kind=text("0008|0008").upper(),
        storage=text("0008|0016"),
        instance=text("0008|0018"),
        size=tuple(int(n) for n in size),
        components=int(components),
        position=_numbers(text("0020|0032"), 3),
        axes=None if axes is None else axes.reshape(2, 3),
        pixel=None if spacing is None or spacing.min() <= 0.0 else spacing[::-1],
    )


def _room(file: str, voxels: int = 0) -> int:
    """Return the bytes that GDCM may need for a file and for voxels, in double precision and converted.

    A damaged element may claim to be 4 GB long.
    """
    return _SPARE + 4 * os.path.getsize(file) + 32 * voxels


def decoded(file: str, voxels: int) -> sitk.Image:
    """Return a file's image, decoded by GDCM within the memory that so many voxels may need.

    Parameters
    ----------
    file : str
        The file.
    voxels : int
        Their number.

    Raises
    ------
    UserError
        Where it can't be decoded.
    """
    try:
        with silenced(), limited(_room(file, voxels)):
            return sitk.ReadImage(file, sitk.sitkFloat32, "GDCMImageIO")
    except (RuntimeError, MemoryError):
        raise UserError(f"DICOM slice {file} can't be decoded; export the series again, uncompressed") from None


def is_dicom(file: Path) -> bool:
    """Return whether a file begins with the DICOM mark.

    Parameters
    ----------
    file : Path
        The file.
    """
    if not file.is_file():
        return False
    with file.open("rb") as opened:
        return opened.read(132)[128:] == b"DICM"


@contextmanager
def decoding(file: Path, voxels: int = 0) -> Iterator[None]:
    """Suppress output and warnings, and limit memory to what a DICOM file can need, while entered.

    Parameters
    ----------
    file : Path
        File that is decoded.
    voxels : int, optional
        Number of voxels that are decoded.
    """
    with silenced(), warnings.catch_warnings(), limited(_room(str(file), voxels)):
        warnings.simplefilter("ignore")
        yield


def _numbers(text: str, count: int) -> Floats | None:
    try:
        values = np.array([float(part) for part in text.split("\\")])
    except ValueError:
        return None
    return values if len(values) == count and bool(np.all(np.isfinite(values))) else None
