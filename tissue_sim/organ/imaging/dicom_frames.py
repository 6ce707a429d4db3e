"""DICOM files of many frames: enhanced CT and MR, and segmentations."""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import SimpleITK as sitk

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError, shown
from tissue_sim.organ.imaging.dicom_file import SEGMENTATIONS, Stack, decoded, decoding, read_header
from tissue_sim.organ.imaging.voxel_files import check_count

if TYPE_CHECKING:
    from pydicom.dataset import Dataset


class FrameGrid(NamedTuple):
    """Positions of the frames of a DICOM file.

    Attributes
    ----------
    image : Dataset
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

    image: Dataset
    size: tuple[int, int, int]
    spacing: Floats
    origin: Floats
    direction: Floats
    place: list[int]
    rescales: int


def functional_group(image: Dataset, frame: int, name: str) -> Dataset:
    """Return what a DICOM file of many frames says about one of them, or about all of them.

    Parameters
    ----------
    image : Dataset
        The file as highdicom reads it.
    frame : int
        Index of the frame.
    name : str
        Keyword of the sequence.

    Returns
    -------
    Dataset
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


def _rescale(image: Dataset, frame: int) -> tuple[str, str]:
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

    Raises
    ------
    UserError
        Where the file holds no complete upright volume, can't be decoded, or is a segmentation.
    """
    header = read_header(str(file))
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
    frames = sitk.GetArrayFromImage(decoded(str(file), math.prod(header.size)))
    if frames.shape[::-1] != grid.size:
        raise UserError(f"DICOM file {file} is damaged: it contains {len(frames)} frames for {grid.size[2]} slices")
    array = np.empty_like(frames)
    array[grid.place] = frames
    return Stack(array, grid.spacing, grid.origin, grid.direction, notes)
