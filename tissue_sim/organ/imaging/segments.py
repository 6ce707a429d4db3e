"""Readers of DICOM segmentations: the segments of one file, each a mask on the grid of its frames."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tissue_sim.array_types import Mask, Pixels
from tissue_sim.errors import UserError, shown
from tissue_sim.organ.imaging.dicom_file import SEGMENTATIONS, decoding, is_dicom
from tissue_sim.organ.imaging.dicom_frames import functional_group, read_frame_grid
from tissue_sim.organ.imaging.image import Volume

if TYPE_CHECKING:
    from pydicom.dataset import Dataset


class Segment(NamedTuple):
    """One segment of a DICOM segmentation.

    Attributes
    ----------
    number : int
        Segment number.
    name : str
        Segment label.
    voxels : Callable[[], Mask]
        Makes its mask, shape (nz, ny, nx).
    """

    number: int
    name: str
    voxels: Callable[[], Mask]


def segmentation_in(source: Path) -> Path | None:
    """Return the DICOM segmentation that a path names, or the only one in a folder.

    Parameters
    ----------
    source : Path
        File or folder.

    Returns
    -------
    Path | None
        The file; None where there is none.

    Raises
    ------
    UserError
        Where a folder holds several.
    """
    files = sorted(source.iterdir()) if source.is_dir() else [source]
    found = [file for file in files if is_dicom(file) and _class_of(file) in SEGMENTATIONS]
    if len(found) > 1:
        names = ", ".join(file.name for file in found[:5])
        raise UserError(f"folder {source} contains {len(found)} segmentations ({names}); name the file of one")
    return found[0] if found else None


def _class_of(file: Path) -> str:
    from pydicom import dcmread

    try:
        with decoding(file):
            return str(dcmread(file, stop_before_pixels=True, specific_tags=["SOPClassUID"]).get("SOPClassUID", ""))
    except Exception:  # pydicom raises anything on damaged files
        return ""


def read_segments(file: Path) -> tuple[Volume, list[Segment]]:
    """Read the grid of a DICOM segmentation and its segments.

    Segments may overlap, and frames without voxels may be missing. Of fractional ones, voxels of at least one half are
    taken.

    Parameters
    ----------
    file : Path
        The DICOM file.

    Returns
    -------
    tuple[Volume, list[Segment]]
        A volume of arbitrary content that gives the grid, and the segments in order.

    Raises
    ------
    UserError
        Where the file can't be decoded, or its frames don't form a regular stack.
    """
    grid = read_frame_grid(file, whole=False)
    nx, ny, nz = grid.size
    image = grid.image
    try:
        with decoding(file, len(grid.place) * ny * nx):
            frames: Pixels = np.reshape(image.pixel_array, (len(grid.place), ny, nx))
        names = {int(one.SegmentNumber): str(one.get("SegmentLabel", "")) for one in image.SegmentSequence}
        numbers = (
            [] if image.SegmentationType == "LABELMAP" else [_number(image, frame) for frame in range(len(frames))]
        )
        least = 0.5 * float(image.MaximumFractionalValue) if image.SegmentationType == "FRACTIONAL" else 1.0
    except Exception as error:  # pydicom raises anything on damaged files
        reason = shown(str(error) or type(error).__name__)
        raise UserError(f"{file} can't be read as a DICOM segmentation ({reason}); export it again") from None
    names.pop(0, None)  # the background of a label map

    def voxels(wanted: int) -> Mask:
        found = np.zeros((nz, ny, nx), dtype=bool)
        for frame, pixels in enumerate(frames):
            if not numbers:
                found[grid.place[frame]] |= pixels == wanted
            elif numbers[frame] == wanted:
                found[grid.place[frame]] |= pixels >= least
        return found

    volume = Volume(np.empty((nz, ny, nx), dtype=bool), grid.spacing, grid.origin, grid.direction, file.name)
    return volume, [Segment(number, name, partial(voxels, number)) for number, name in sorted(names.items())]


def _number(image: Dataset, frame: int) -> int:
    """Return the number of the segment that a frame belongs to."""
    return int(functional_group(image, frame, "SegmentIdentificationSequence").ReferencedSegmentNumber)
