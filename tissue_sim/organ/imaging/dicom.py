"""Readers of DICOM: one stack of slices, placed by their headers, refused where it is incomplete or tilted.

Slices are ordered by their positions along the normal, whatever their files or numbers say. GDCM (in SimpleITK) decodes
them and applies rescale slope and intercept, slice by slice.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import SimpleITK as sitk
from numpy.typing import NDArray

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError, shown
from tissue_sim.memory import limited
from tissue_sim.organ.imaging.itk_output import silenced
from tissue_sim.organ.imaging.voxel_files import check_count

_GAP = 0.1  # relative deviation of a slice distance that counts as a gap
_ALIKE = 1e-3  # difference of direction cosines, relative one of pixel spacings, within a stack
_TILT = 0.5  # pixels that slices may drift sideways over the whole stack
_FEW = 3  # slices: fewer beside a stack are localizers or scraps
_SPARE = 1 << 27  # bytes of address space that GDCM and ITK may reserve beside those of a file
_SHOWN = 12  # series named in a message

# Storage classes of segmentations: of a bit or a fraction for each segment, and of labels.
SEGMENTATIONS = ("1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7")


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


@dataclass(frozen=True, eq=False)
class _Slice:
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

    def like(self, other: _Slice) -> bool:
        """Return whether the two can lie in one stack."""
        if self.size != other.size or self.components != other.components:
            return False
        if (self.axes is None) != (other.axes is None) or (self.pixel is None) != (other.pixel is None):
            return False
        turned = 0.0 if self.axes is None or other.axes is None else np.abs(self.axes - other.axes).max()
        scaled = 0.0 if self.pixel is None or other.pixel is None else np.abs(self.pixel / other.pixel - 1.0).max()
        return float(max(turned, scaled)) < _ALIKE


def read_stack(folder: Path, series: str | None = None) -> Stack:
    """Read the series of a DICOM folder.

    Localizers, and stacks of too few slices, are left out and noted, within a series and beside it.

    Parameters
    ----------
    folder : Path
        Folder that holds the slices.
    series : str | None, optional
        UID of the series, or its number in the list that a refusal shows.

    Returns
    -------
    Stack
        The voxels and where they lie.

    Raises
    ------
    UserError
        Where the folder holds no series or several stacks, where slices are missing, duplicated, tilted or without a
        position, and where one can't be decoded.
    """
    found: dict[str, list[list[_Slice]]] = {}
    for file in sorted(path for path in folder.iterdir() if path.is_file()):
        header = _read_header(str(file))
        if header is not None:
            _sort_in(found.setdefault(header.series, []), header)
    if not found:
        raise UserError(
            f"folder {folder} contains no DICOM series; name the folder that contains the slices{_below(folder)}"
        )
    for stacks in found.values():
        stacks.sort(key=len, reverse=True)
    uid, notes = _choose_series(folder, found, series)
    slices, more = _choose_stack(folder, found[uid])
    notes += more
    if slices[0].components != 1:
        raise UserError(f"DICOM folder {folder} contains colour pictures, not a CT")
    frames = slices[0].size[2] if len(slices[0].size) > 2 else 1
    if len(slices) == 1 and frames < 2:
        raise UserError(f"DICOM folder {folder} contains a single slice, but a 3-D volume is needed")
    if frames > 1:
        if len(slices) > 1:
            raise UserError(f"DICOM folder {folder} is 4-D: {len(slices)} files of {frames} slices; keep one of them")
        return read_frames(Path(slices[0].file), tuple(notes))
    slices, more = _without_copies(slices)
    return _read_slices(folder, slices, tuple(notes + more))


def _read_header(file: str) -> _Slice | None:
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
    return _Slice(
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


def _numbers(text: str, count: int) -> Floats | None:
    try:
        values = np.array([float(part) for part in text.split("\\")])
    except ValueError:
        return None
    return values if len(values) == count and bool(np.all(np.isfinite(values))) else None


def _sort_in(stacks: list[list[_Slice]], found: _Slice) -> None:
    for stack in stacks:
        if stack[0].like(found):
            stack.append(found)
            return
    stacks.append([found])


def _below(folder: Path) -> str:
    names = sorted(path.name for path in folder.iterdir() if path.is_dir())
    return f" (it has the folders {', '.join(names[:5])})" if names else ""


def _is_scrap(stack: Sequence[_Slice]) -> bool:
    """Return whether a stack is a localizer, or has too few slices for a volume."""
    frames = len(stack) * (stack[0].size[2] if len(stack[0].size) > 2 else 1)
    return frames < _FEW or "LOCALIZER" in stack[0].kind or stack[0].components != 1


def _choose_series(folder: Path, found: dict[str, list[list[_Slice]]], series: str | None) -> tuple[str, list[str]]:
    uids = list(found)
    listed = "; ".join(f"{k} {_series_line(uid, found[uid])}" for k, uid in enumerate(uids[:_SHOWN], 1))
    if series is not None:
        if series.isdigit() and 1 <= int(series) <= len(uids):
            return uids[int(series) - 1], []
        if series in found:
            return series, []
        raise UserError(f"folder {folder} has no series {series}; it contains {listed}")
    if len(uids) == 1:
        return uids[0], []
    whole = [uid for uid in uids if not _is_scrap(found[uid][0])]
    if len(whole) == 1:
        others = len(uids) - 1
        return whole[0], [f"omitted {others} other series of the folder: localizers or fewer than {_FEW} slices"]
    raise UserError(f"folder {folder} contains {len(uids)} series: {listed}; choose one with --series UID")


def _series_line(uid: str, stacks: list[list[_Slice]]) -> str:
    count = sum(len(stack) for stack in stacks)
    description = stacks[0][0].description
    return f"{uid} ({description + ', ' if description else ''}{count} slice{'s' if count > 1 else ''})"


def _choose_stack(folder: Path, stacks: list[list[_Slice]]) -> tuple[list[_Slice], list[str]]:
    """Return the only stack of a series; several of different geometry are refused, except for localizers."""
    whole = [stack for stack in stacks if not _is_scrap(stack)]
    if len(stacks) == 1 or not whole:
        return stacks[0], []
    if len(whole) > 1:
        sizes = ", ".join(f"{len(stack)} slices of {stack[0].size[0]} x {stack[0].size[1]}" for stack in whole)
        raise UserError(f"DICOM folder {folder}: one series contains stacks of different geometry ({sizes}); keep one")
    others = sum(len(stack) for stack in stacks) - len(whole[0])
    return whole[0], [f"omitted {others} pictures of another geometry from the series (localizers)"]


def _without_copies(slices: list[_Slice]) -> tuple[list[_Slice], list[str]]:
    """Return each instance once: exports put the same slice into two files."""
    seen: dict[tuple[str, bytes], _Slice] = {}
    for k, one in enumerate(slices):
        place = b"" if one.position is None else one.position.tobytes()
        seen.setdefault((one.instance or str(k), place), one)
    copies = len(slices) - len(seen)
    return list(seen.values()), [f"omitted {copies} copies of slices"] if copies else []


def _read_slices(folder: Path, slices: Sequence[_Slice], notes: tuple[str, ...]) -> Stack:
    first = slices[0]
    if first.axes is None or first.pixel is None or any(one.position is None for one in slices):
        raise UserError(
            f"DICOM folder {folder}: slices have no position, orientation or pixel spacing; export the CT itself,"
            " not pictures of it"
        )
    row, column = first.axes
    if abs(np.linalg.norm(row) - 1.0) > _ALIKE or abs(float(row @ column)) > _ALIKE:
        raise UserError(f"DICOM folder {folder}: the slices' axes are not at right angles; export the CT again")
    normal = np.cross(row, column)
    position = np.array([one.position for one in slices])
    order = np.argsort(position @ normal, kind="stable")
    step = _checked_step(folder, position[order], normal, float(first.pixel.min()))
    nx, ny = first.size[:2]
    check_count(folder, (nx, ny, len(slices)))
    array = np.empty((len(slices), ny, nx), dtype=np.float32)
    for k, at in enumerate(order):
        picture = _decoded(slices[at].file, nx * ny)  # named: a view doesn't keep its image
        array[k] = sitk.GetArrayViewFromImage(picture).reshape(ny, nx)
    direction = np.stack([row, column, normal], axis=1)
    return Stack(array, np.array([*first.pixel, step]), position[order[0]], direction, notes)


def _checked_step(folder: Path, position: Floats, normal: Floats, pixel: float) -> float:
    """Return the slice distance, mm, of sorted positions (n, 3); refuse gaps, duplicates and a tilted gantry."""
    depth = position @ normal
    step = np.diff(depth)
    doubled = int(np.count_nonzero(np.abs(step) < 1e-4))
    if doubled:
        times = len(depth) / (len(depth) - doubled)
        what = f"is 4-D, {times:.0f} slices at each position" if times.is_integer() else "mixes several series"
        raise UserError(f"DICOM folder {folder} contains slices at the same position: it {what}; keep one volume")
    usual = float(np.median(step))
    odd = np.flatnonzero(np.abs(step - usual) > _GAP * usual)
    if len(odd):
        where = ", ".join(f"{depth[i]:.1f} and {depth[i + 1]:.1f}" for i in odd[:3])
        raise UserError(
            f"DICOM folder {folder} lacks slices: the spacing is {usual:.2f} mm, but not between {where} mm"
        )
    across = position - np.outer(depth, normal)
    drift = float(np.linalg.norm(across - across[0], axis=1).max())
    if drift > _TILT * pixel:
        raise UserError(
            f"DICOM folder {folder}: slices shift sideways by {drift:.1f} mm over the stack (tilted gantry);"
            " resample it into an upright one first (for example with dcm2niix)"
        )
    return float(depth[-1] - depth[0]) / len(step)


def _room(file: str, voxels: int = 0) -> int:
    """Return the bytes that GDCM may need for a file and for voxels, in double precision and converted.

    A damaged element may claim to be 4 GB long.
    """
    return _SPARE + 4 * os.path.getsize(file) + 32 * voxels


def _decoded(file: str, voxels: int) -> Any:
    try:
        with silenced(), limited(_room(file, voxels)):
            return sitk.ReadImage(file, sitk.sitkFloat32, "GDCMImageIO")
    except (RuntimeError, MemoryError):
        raise UserError(f"DICOM slice {file} can't be decoded; export the series again, uncompressed") from None


# one file of many frames ---------------------------------------------------------------------------


class FrameGrid(NamedTuple):
    """Positions of the frames of a DICOM file.

    Attributes
    ----------
    image : Any
        The file as highdicom reads it.
    size : tuple[int, int, int]
        Voxels along x, y, z.
    spacing : Floats, shape (3,), mm
        Distance of voxels along x, y, z.
    origin : Floats, shape (3,), mm
        Centre of the first voxel in LPS.
    direction : Floats, shape (3, 3)
        Columns are the voxel axes in LPS.
    place : list[int]
        Slice index of each frame.
    rescales : int
        Number of different rescale slopes and intercepts among the frames.
    """

    image: Any
    size: tuple[int, int, int]
    spacing: Floats
    origin: Floats
    direction: Floats
    place: list[int]
    rescales: int


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


def functional_group(image: Any, frame: int, name: str) -> Any:
    """Return what a DICOM file of many frames says about one of them, or about all of them.

    Parameters
    ----------
    image : Any
        The file as highdicom reads it.
    frame : int
        Index of the frame.
    name : str
        Keyword of the sequence.

    Returns
    -------
    Any
        First item of the sequence.

    Raises
    ------
    KeyError
        Where the file has no such sequence.
    """
    for groups in (
        image.get("PerFrameFunctionalGroupsSequence", ())[frame : frame + 1],
        image.get("SharedFunctionalGroupsSequence", ())[:1],
    ):
        if groups and name in groups[0]:
            return groups[0][name][0]
    raise KeyError(name)


def read_frame_grid(file: Path, *, whole: bool) -> FrameGrid:
    """Read where the frames of a DICOM file lie.

    Their positions are read, because GDCM assumes a spacing of 1 mm for some kinds of files.

    Parameters
    ----------
    file : Path
        The DICOM file.
    whole : bool
        Whether each slice must have exactly one frame; otherwise it may have several or none.

    Returns
    -------
    FrameGrid
        The grid on which the frames lie.

    Raises
    ------
    UserError
        Where the file can't be read, or its frames don't form one regular stack.
    """
    import highdicom

    try:
        with decoding(file):
            # From memory: of a file, pydicom asks for room for as much as an element says that it is long.
            image = highdicom.Image.from_file(BytesIO(file.read_bytes()))
            geometry = image.get_volume_geometry(allow_missing_positions=not whole, allow_duplicate_positions=not whole)
            count = int(image.NumberOfFrames)
            groups = [functional_group(image, frame, "PlanePositionSequence") for frame in range(count)]
            positions = np.array([list(map(float, group.ImagePositionPatient)) for group in groups]).reshape(count, 3)
            rescales = {_rescale(image, frame) for frame in range(count)}
    except Exception as error:  # highdicom and pydicom raise anything on damaged files
        raise UserError(
            f"DICOM file {file} doesn't state the positions of its frames"
            f" ({shown(str(error) or type(error).__name__)}); export it again"
        ) from None
    if geometry is None:
        raise UserError(
            f"DICOM file {file} has frames that don't form a regular stack: some are missing, tilted, or at the"
            " same position; resample it first"
        )
    matrix = geometry.affine[:, [2, 1, 0, 3]]  # highdicom counts slices, rows, columns
    nz, ny, nx = geometry.spatial_shape
    check_count(file, (nx, ny, nz))
    if np.linalg.det(matrix[:3, :3]) < 0.0:  # along the normal of rows and columns, as slices of a folder
        matrix[:3, 3] += (nz - 1) * matrix[:3, 2]
        matrix[:3, 2] *= -1.0
    at = (positions - matrix[:3, 3]) @ np.linalg.inv(matrix[:3, :3]).T
    spacing = np.linalg.norm(matrix[:3, :3], axis=0)
    place = [int(slot) for slot in np.round(at[:, 2])]
    return FrameGrid(image, (nx, ny, nz), spacing, matrix[:3, 3], matrix[:3, :3] / spacing, place, len(rescales))


def _rescale(image: Any, frame: int) -> tuple[str, str]:
    """Return the rescale slope and intercept of a frame as they are written; empty strings where it has none."""
    try:
        found = functional_group(image, frame, "PixelValueTransformationSequence")
    except KeyError:
        return "", ""
    return str(found.get("RescaleSlope", "")), str(found.get("RescaleIntercept", ""))


def read_frames(file: Path, notes: tuple[str, ...] = ()) -> Stack:
    """Read a DICOM file that holds a volume in many frames.

    Parameters
    ----------
    file : Path
        The DICOM file.
    notes : tuple[str, ...], optional
        Remarks that are passed on to the result.

    Returns
    -------
    Stack
        The voxels and where they lie.

    Raises
    ------
    UserError
        Where the file holds no complete upright volume, can't be decoded, or is a segmentation.
    """
    header = _read_header(str(file))
    if header is None:
        raise UserError(f"DICOM file {file} can't be read as an image; export it again, uncompressed")
    if header.components != 1:
        raise UserError(f"DICOM file {file} contains colour pictures, not a CT")
    if len(header.size) < 3 or header.size[2] < 2:
        raise UserError(
            f"{file} is a single slice, but a 3-D volume is needed; name the folder that contains the series"
        )
    if header.storage in SEGMENTATIONS:
        raise UserError(f"DICOM file {file} is a segmentation, not a CT; give it to --mask")
    grid = read_frame_grid(file, whole=True)
    if grid.rescales > 1:  # GDCM takes the first for all
        raise UserError(f"DICOM file {file} has frames of several rescale slopes or intercepts; export them as slices")
    frames = sitk.GetArrayFromImage(_decoded(str(file), math.prod(header.size)))
    if frames.shape[::-1] != grid.size:
        raise UserError(f"DICOM file {file} is damaged: it contains {len(frames)} frames for {grid.size[2]} slices")
    array = np.empty_like(frames)
    array[grid.place] = frames
    return Stack(array, grid.spacing, grid.origin, grid.direction, notes)
