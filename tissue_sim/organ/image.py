"""CT volumes and masks: reading, refusing, cropping, and the way between voxels and points.

One frame for every format: the patient frame as ITK defines it, LPS (x towards the patient's left,
y towards the back, z towards the head), right-handed. NIfTI headers speak RAS; ITK turns
them into LPS on reading. Lengths are millimetres in headers and here, metres in an organ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK as sitk
from numpy.typing import ArrayLike, NDArray

from tissue_sim.errors import UserError

Floats = NDArray[np.float64]

MM = 1e-3  # metres in a millimetre
_SLICE_GAP = 0.1  # relative deviation of a slice distance that counts as a gap
_FORMATS = "NIfTI, NRRD, MHA or a DICOM folder"

sitk.ProcessObject.SetGlobalWarningDisplay(False)  # ITK's multi-line warnings; what matters is checked here


@dataclass(frozen=True, eq=False)
class Volume:
    """A 3-D image in the patient frame.

    array (nz, ny, nx): float32 HU, or bool for a mask. spacing (3,) mm along x, y, z voxel axes;
    origin (3,) mm: centre of voxel (0, 0, 0); direction (3, 3): columns are the voxel axes in LPS.
    """

    array: NDArray[Any]
    spacing: Floats
    origin: Floats
    direction: Floats
    name: str = ""

    @property
    def size(self) -> tuple[int, int, int]:
        """Voxels along x, y, z."""
        nz, ny, nx = self.array.shape
        return nx, ny, nz

    @property
    def voxel_volume(self) -> float:
        """Volume of one voxel, mL."""
        return float(np.prod(self.spacing)) * 1e-3

    def to_points(self, index: ArrayLike) -> Floats:
        """Points (..., 3) mm in the patient frame of continuous voxel indices (..., 3) in order x, y, z."""
        return self.origin + (np.asarray(index, dtype=np.float64) * self.spacing) @ self.direction.T

    def to_index(self, points: ArrayLike) -> Floats:
        """Continuous voxel indices (..., 3), order x, y, z, of points (..., 3) mm."""
        return ((np.asarray(points, dtype=np.float64) - self.origin) @ np.linalg.inv(self.direction).T) / self.spacing

    def contains(self, index: ArrayLike) -> bool:
        """Whether a continuous voxel index (3,) lies within the image, to the outer voxels' faces."""
        i = np.asarray(index, dtype=np.float64)
        return bool(np.all(np.isfinite(i)) and np.all(i >= -0.5) and np.all(i <= np.array(self.size) - 0.5))

    def crop(self, lower: Sequence[int], upper: Sequence[int]) -> Volume:
        """The part from voxel `lower` to `upper` (both x, y, z, inclusive, clipped to the image)."""
        low = np.maximum(np.asarray(lower, dtype=int), 0)
        high = np.minimum(np.asarray(upper, dtype=int), np.array(self.size) - 1)
        if np.any(low > high):
            raise UserError(f"the crop {tuple(lower)}..{tuple(upper)} lies outside the image of {self.size} voxels")
        part = self.array[low[2] : high[2] + 1, low[1] : high[1] + 1, low[0] : high[0] + 1]
        return replace(self, array=np.ascontiguousarray(part), origin=self.to_points(low))

    def with_array(self, array: NDArray[Any]) -> Volume:
        """Another image on the same grid."""
        return replace(self, array=array)

    def to_sitk(self) -> sitk.Image:
        """The same image as SimpleITK has it (bool becomes uint8)."""
        array = self.array.astype(np.uint8) if self.array.dtype == bool else self.array
        image = sitk.GetImageFromArray(array)
        image.SetSpacing(self.spacing.tolist())
        image.SetOrigin(self.origin.tolist())
        image.SetDirection(self.direction.ravel().tolist())
        return image


def from_sitk(image: sitk.Image, name: str = "", *, mask: bool = False) -> Volume:
    """Volume of a 3-D SimpleITK image: float32, or bool (non-zero) for a mask."""
    array = sitk.GetArrayFromImage(image)
    return Volume(
        array=array != 0 if mask else array.astype(np.float32, copy=False),
        spacing=np.array(image.GetSpacing()),
        origin=np.array(image.GetOrigin()),
        direction=np.array(image.GetDirection()).reshape(3, 3),
        name=name,
    )


def read_image(path: str | Path, series: str | None = None) -> Volume:
    """Read a CT: a NIfTI, NRRD or MHA file, or a folder that holds one DICOM series.

    series: the series UID to take when a folder holds several. Rescale slope and intercept are
    applied by ITK, so the values are HU. Raises UserError naming the file when it is
    missing, unreadable, not 3-D, or when DICOM slices are missing.
    """
    source = Path(path)
    if not source.exists():
        raise UserError(f"image {source} does not exist; name a {_FORMATS}")
    if source.is_dir():
        return from_sitk(_read_dicom(source, series), source.name)
    if series is not None:
        raise UserError(f"--series chooses a series in a DICOM folder; {source} is a file")
    return from_sitk(_read_file(source), source.name)


def read_mask(path: str | Path, label: int | None = None) -> Volume:
    """Read a segmentation as a bool Volume: voxels equal to `label`, or the only non-zero value.

    Raises UserError naming the file and the labels it holds when the choice isn't clear.
    """
    source = Path(path)
    if not source.exists():
        raise UserError(f"mask {source} does not exist; name a {_FORMATS}")
    image = _read_dicom(source, None) if source.is_dir() else _read_file(source)
    array = sitk.GetArrayFromImage(image)
    labels = np.unique(array)
    labels = labels[labels != 0]
    if len(labels) == 0:
        raise UserError(f"mask {source} is empty: it holds no value other than 0")
    shown = ", ".join(f"{value:g}" for value in labels[:20])
    if len(labels) > 200:
        raise UserError(f"mask {source} holds {len(labels)} different values; it looks like an image, not a mask")
    if label is None and len(labels) > 1:
        raise UserError(f"mask {source} holds several labels ({shown}); choose one with --label")
    if label is not None and label not in labels:
        raise UserError(f"mask {source} has no label {label}; it holds {shown}")
    chosen = labels[0] if label is None else label
    return replace(from_sitk(image, source.name, mask=True), array=array == chosen)


def _read_file(path: Path) -> sitk.Image:
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    try:
        reader.ReadImageInformation()
        size, dimension = reader.GetSize(), reader.GetDimension()
        components = reader.GetNumberOfComponents()
    except RuntimeError as error:
        raise UserError(f"{path} can't be read as an image ({_reason(error)}); name a {_FORMATS}") from None
    if components != 1:
        raise UserError(f"{path} has {components} values a voxel; a CT or mask has one")
    if dimension > 3 and any(n != 1 for n in size[3:]):
        shape = " x ".join(str(n) for n in size)
        raise UserError(f"{path} is {dimension}-D ({shape}); extract one 3-D volume first")
    if dimension < 3 or min(size[:3]) < 2:
        shape = " x ".join(str(n) for n in size)
        hint = "; name the folder that holds the series" if path.suffix.lower() in (".dcm", ".ima", "") else ""
        raise UserError(f"{path} is a single slice ({shape}), a 3-D volume is needed{hint}")
    try:
        image = reader.Execute()
    except (RuntimeError, MemoryError) as error:
        raise UserError(f"{path} is damaged or truncated ({_reason(error)})") from None
    return image if dimension == 3 else image[(slice(None),) * 3 + (0,) * (dimension - 3)]


def _read_dicom(folder: Path, series: str | None) -> sitk.Image:
    found = list(sitk.ImageSeriesReader.GetGDCMSeriesIDs(str(folder)))
    if not found:
        raise UserError(f"folder {folder} holds no DICOM series; name the folder that holds the slices")
    if series is None and len(found) > 1:
        names = "; ".join(_series_line(folder, uid) for uid in found)
        raise UserError(f"folder {folder} holds {len(found)} series: {names}; choose one with --series UID")
    if series is not None and series not in found:
        raise UserError(f"folder {folder} has no series {series}; it holds {', '.join(found)}")
    files = sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(folder), series or found[0])
    if len(files) > 1:
        _check_slices(folder, files)
    reader = sitk.ImageSeriesReader()
    reader.SetFileNames(files)
    try:
        image = reader.Execute()
    except RuntimeError as error:
        raise UserError(f"DICOM folder {folder} can't be read ({_reason(error)})") from None
    if image.GetNumberOfComponentsPerPixel() != 1:
        raise UserError(f"DICOM folder {folder} holds colour pictures, not a CT")
    if image.GetDimension() != 3 or min(image.GetSize()) < 2:
        raise UserError(f"DICOM folder {folder} holds a single slice, a 3-D volume is needed")
    return image


def _header(file: str, *tags: str) -> list[str]:
    reader = sitk.ImageFileReader()
    reader.SetFileName(file)
    reader.ReadImageInformation()
    return [reader.GetMetaData(tag).strip() if reader.HasMetaDataKey(tag) else "" for tag in tags]


def _series_line(folder: Path, uid: str) -> str:
    files = sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(folder), uid)
    description = _header(files[0], "0008|103e")[0]
    return f"{uid} ({description + ', ' if description else ''}{len(files)} slices)"


def _check_slices(folder: Path, files: Sequence[str]) -> None:
    """Refuse a series with missing, doubled or tilted slices: ITK would quietly stretch the organ."""
    position, normal = [], np.array([0.0, 0.0, 1.0])
    for file in files:
        where, axes = _header(file, "0020|0032", "0020|0037")
        if not where or not axes:
            return  # no geometry in the header: ITK takes the files in order, one voxel apart
        position.append([float(v) for v in where.split("\\")])
        row, column = np.array([float(v) for v in axes.split("\\")]).reshape(2, 3)
        normal = np.cross(row, column)
    depth = np.array(position) @ normal
    step = np.diff(depth)
    usual = float(np.median(step))
    if usual <= 0.0 or np.any(np.abs(step) < 1e-4):
        raise UserError(f"DICOM folder {folder} holds slices at the same position; it mixes several series")
    odd = np.flatnonzero(np.abs(step - usual) > _SLICE_GAP * usual)
    if len(odd):
        where = ", ".join(f"{depth[i]:.1f} and {depth[i + 1]:.1f}" for i in odd[:3])
        raise UserError(f"DICOM folder {folder} misses slices: spacing is {usual:.2f} mm, but not between {where} mm")


def _reason(error: BaseException) -> str:
    """The telling line of an ITK exception."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    telling = [line for line in lines if "ERROR" in line or "rror:" in line] or lines or [type(error).__name__]
    text = telling[-1].split("):")[-1].strip()
    return text[:160] if text else "unknown error"
