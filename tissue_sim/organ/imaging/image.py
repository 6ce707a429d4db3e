"""CT volumes and masks: reading, refusing, cropping, and the way between voxels and points.

One frame for every format: the patient frame as ITK defines it, LPS (x towards the patient's left,
y towards the back, z towards the head), right-handed. NIfTI headers speak RAS; ITK turns
them into LPS on reading. Lengths are millimetres in headers and here, metres in an organ.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK as sitk
from numpy.typing import ArrayLike, NDArray

from tissue_sim.array_types import Floats
from tissue_sim.environment import environment
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.dicom import read_stack
from tissue_sim.organ.imaging.meta_header import check_meta_header
from tissue_sim.organ.imaging.nifti_header import check_nifti_header
from tissue_sim.organ.imaging.nrrd_header import check_nrrd_header
from tissue_sim.organ.imaging.silence import silenced
from tissue_sim.organ.imaging.voxel_files import check_count, check_room

MM = 1e-3  # metres in a millimetre
AIR = -1024.0  # HU, for voxels without a value
_MOST_LABELS = 200
_LARGEST_AXIS = 1e6  # of a number in a direction, or of mm in a NIfTI's row
_LARGEST_SKEW = 1e-3  # cosine between two axes
_PAIR = re.compile(r"\.(hdr|img)(\.gz)?$", re.IGNORECASE)  # NIfTI in two files
_PERMISSIVE = "ITK_NIFTI_SFORM_PERMISSIVE"
_FORMATS = "NIfTI, NRRD, MHA or a DICOM folder"

sitk.ProcessObject.SetGlobalWarningDisplay(False)  # ITK's multi-line warnings; what matters is checked here


@dataclass(frozen=True, eq=False)
class Volume:
    """A 3-D image in the patient frame.

    array (nz, ny, nx): float32 HU, or bool for a mask. spacing (3,) mm along x, y, z voxel axes;
    origin (3,) mm: centre of voxel (0, 0, 0); direction (3, 3): columns are the voxel axes in LPS, of either
    handedness. notes: remarks on how it was read, one line each.
    """

    array: NDArray[Any]
    spacing: Floats
    origin: Floats
    direction: Floats
    name: str = ""
    notes: tuple[str, ...] = ()

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

    def upright(self) -> Volume:
        """The same image with its voxel axes in the order and sense nearest to x, y, z of the patient; a view, no copy.

        What is computed on voxels then doesn't depend on the order in which the file stored them.
        """
        along = max(itertools.permutations(range(3)), key=lambda order: np.abs(self.direction[range(3), order]).sum())
        axes = list(along)
        array = self.array.transpose([2 - k for k in axes[::-1]])
        flipped = np.diag(self.direction[:, axes]) < 0.0
        array = array[tuple(slice(None, None, -1) if flip else slice(None) for flip in flipped[::-1])]
        corner = np.zeros(3)
        corner[axes] = np.where(flipped, np.array(self.size)[axes] - 1.0, 0.0)
        return replace(
            self,
            array=array,
            spacing=self.spacing[axes],
            origin=self.to_points(corner),
            direction=self.direction[:, axes] * np.where(flipped, -1.0, 1.0),
        )

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
    view = sitk.GetArrayViewFromImage(image)  # one copy less than an array of its own
    with np.errstate(over="ignore", invalid="ignore"):  # infinity and NaN, which are looked for
        array = view != 0 if mask else view.astype(np.float32)
    return Volume(
        array=array,
        spacing=np.array(image.GetSpacing()),
        origin=np.array(image.GetOrigin()),
        direction=np.array(image.GetDirection()).reshape(3, 3),
        name=name,
    )


def read_image(path: str | Path, series: str | None = None) -> Volume:
    """Read a CT: a NIfTI, NRRD or MHA file, or a folder that holds one DICOM series.

    series: the series to take when a folder holds several, by UID or number. Rescale slope and intercept are
    applied, so the values are HU. Voxels that are no numbers (outside the scanned field) are read as air and noted.
    Raises UserError naming the file when it is missing, unreadable, not 3-D, of skewed axes, or holds no finite
    values, and when DICOM slices are missing.
    """
    source = Path(path)
    if not source.exists():
        raise UserError(f"image {source} does not exist; name a {_FORMATS}")
    if series is not None and not source.is_dir():
        raise UserError(f"--series chooses a series in a DICOM folder; {source} is a file")
    volume = _read_folder(source, series) if source.is_dir() else from_sitk(_read_file(source), source.name)
    bad = 0
    for layer in volume.array:  # slice by slice: no second volume in memory
        wrong = ~np.isfinite(layer)
        if wrong.any():
            bad += int(np.count_nonzero(wrong))
            layer[wrong] = AIR
    if bad == volume.array.size:
        raise UserError(f"image {source} holds no finite values")
    note = f"read {bad} voxels without a value (NaN or infinite) as air"
    return replace(volume, notes=(*volume.notes, note)) if bad else volume


def read_mask(path: str | Path, label: int | None = None) -> Volume:
    """Read a segmentation as a bool Volume: voxels equal to `label`, or the only non-zero value.

    Raises UserError naming the file and the labels it holds when the choice isn't clear.
    """
    return read_masks(path, label, ())[0]


def read_masks(path: str | Path, label: int | None, parts: Sequence[int]) -> list[Volume]:
    """Read an organ's segmentation with further labels for parts of it: the whole organ, then each part.

    Raises UserError as read_mask does.
    """
    source = Path(path)
    if not source.exists():
        raise UserError(f"mask {source} does not exist; name a {_FORMATS}")
    image = None if source.is_dir() else _read_file(source)
    found = _read_folder(source, None) if image is None else from_sitk(image, source.name, mask=True)
    array = found.array if image is None else sitk.GetArrayViewFromImage(image)
    labels = _labels(array, str(source))
    if len(labels) == 0:
        raise UserError(f"mask {source} is empty: it holds no value other than 0")
    shown = ", ".join(f"{value:g}" for value in labels[:20])
    for wanted in (label, *parts):
        if wanted is not None and wanted not in labels:
            raise UserError(f"mask {source} has no label {wanted}; it holds {shown}")
    own = [value for value in labels if value not in parts] if label is None else [label]
    if len(own) != 1:
        raise UserError(f"mask {source} holds several labels ({shown}); choose one with --label")
    masks = [replace(found, array=array == part) for part in (*own, *parts)]
    for part in masks[1:]:
        masks[0].array[part.array] = True
    return masks


def _labels(array: NDArray[Any], name: str) -> list[float]:
    """Values other than 0, in order."""
    found: set[float] = set()
    for layer in array:
        found.update(float(value) for value in np.unique(layer) if value != 0 and np.isfinite(value))
        if len(found) > _MOST_LABELS:
            raise UserError(
                f"mask {name} holds over {_MOST_LABELS} different values; it looks like an image, not a mask"
            )
    return sorted(found)


def _read_folder(folder: Path, series: str | None) -> Volume:
    stack = read_stack(folder, series)
    return Volume(stack.array, stack.spacing, stack.origin, stack.direction, folder.name, stack.notes)


def _read_file(path: Path) -> sitk.Image:
    """Read a 3-D image file; its axes are at right angles, to within a thousandth."""
    try:
        try:
            image = _read_strictly(path)
        except _SkewedError:
            # ITK takes rounding errors past 1e-5 in a NIfTI header only then; how skewed it is, is checked here.
            with environment({_PERMISSIVE: "ON"}):
                image = _read_strictly(path)
        if _skew(image) <= _LARGEST_SKEW:
            return image
    except _SkewedError:  # axes that can't be straightened
        pass
    raise UserError(f"{path} has skewed axes (a tilted gantry); resample it onto an upright grid first")


class _SkewedError(Exception):
    """ITK finds no orthonormal axes in a NIfTI header."""


def _skew(image: sitk.Image) -> float:
    """Largest cosine between two of the axes: the header's own where ITK has straightened a NIfTI's."""
    axes = np.array(image.GetDirection()).reshape(3, 3)
    rows = [f"srow_{axis}" for axis in "xyz"]
    if image.HasMetaDataKey("ITK_sform_corrected") and all(image.HasMetaDataKey(row) for row in rows):
        axes = np.array([[float(value) for value in image.GetMetaData(row).split()[:3]] for row in rows])
    if not np.all(np.abs(axes) < _LARGEST_AXIS):
        return math.inf
    length = np.maximum(np.linalg.norm(axes, axis=0), 1e-12)
    return float(np.abs(np.triu((axes / length).T @ (axes / length), 1)).max())


def _read_strictly(path: Path) -> sitk.Image:
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    beside = _checked_header(path)
    try:
        with silenced():
            reader.ReadImageInformation()
        size, dimension = reader.GetSize(), reader.GetDimension()
        components = reader.GetNumberOfComponents()
    except RuntimeError as error:
        if "orthonormal" in str(error):
            raise _SkewedError from None
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
    if beside is None:
        check_count(path, size)
    else:
        check_room(path, beside, size, sitk.Image([1, 1], reader.GetPixelID()).GetSizeOfPixelComponent())
    try:
        with silenced():
            image = reader.Execute()
    except (RuntimeError, MemoryError) as error:
        raise UserError(f"{path} is damaged or truncated ({_reason(error)})") from None
    return image if dimension == 3 else image[(slice(None),) * 3 + (0,) * (dimension - 3)]


def _checked_header(path: Path) -> tuple[Path, ...] | None:
    """The files of voxels beside an image; None where it is packed in an unknown way. Raises UserError, see there."""
    if not path.is_file():
        return None
    name = path.name.lower()
    if name.endswith((".mha", ".mhd")):
        return check_meta_header(path)
    if name.endswith((".nrrd", ".nhdr")):
        return check_nrrd_header(path)
    if name.endswith((".nii", ".nii.gz")):
        check_nifti_header(path)
        return ()
    if not _PAIR.search(name):
        return None
    stem = _PAIR.sub("", str(path))
    pair = [Path(f"{stem}{suffix}") for suffix in (".hdr", ".hdr.gz", ".img", ".img.gz")]
    for header in pair[:2]:
        if header.is_file():
            check_nifti_header(header)
    return tuple(pair[2:])


def _reason(error: BaseException) -> str:
    """The telling line of an ITK exception."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    telling = [line for line in lines if "ERROR" in line or "rror:" in line] or lines or [type(error).__name__]
    text = telling[-1].split("):")[-1].strip()
    return text[:160] if text else "unknown error"
