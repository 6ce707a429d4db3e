"""Volumes of CT images and masks: reading, refusing, cropping, and conversion between voxels and points.

One frame for every format: the patient frame as ITK defines it, LPS (x towards the patient's left,
y towards the back, z towards the head), right-handed. NIfTI headers speak RAS; ITK turns
them into LPS on reading. Lengths are millimetres in headers and here, metres in an organ.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import SimpleITK as sitk
from numpy.typing import ArrayLike

from tissue_sim.array_types import Array, Floats
from tissue_sim.errors import UserError

MM = 1e-3  # metres in a millimetre
AIR = -1024.0  # HU, for voxels without a value


@dataclass(frozen=True, eq=False)
class Volume:
    """Three-dimensional image in the patient frame.

    Attributes
    ----------
    array : Array, shape (nz, ny, nx)
        float32 HU, or bool for a mask.
    spacing : Floats, shape (3,), mm
        Distance of voxels along their axes x, y, z.
    origin : Floats, shape (3,), mm
        Centre of voxel (0, 0, 0).
    direction : Floats, shape (3, 3)
        Columns are the voxel axes in LPS, of either handedness.
    name : str
        Name for messages.
    notes : tuple[str, ...]
        Remarks on how it was read, one line each.
    """

    array: Array
    spacing: Floats
    origin: Floats
    direction: Floats
    name: str = ""
    notes: tuple[str, ...] = ()

    @property
    def size(self) -> tuple[int, int, int]:
        """Number of voxels along x, y, z."""
        nz, ny, nx = self.array.shape
        return nx, ny, nz

    @property
    def voxel_volume(self) -> float:
        """Volume of one voxel, mL."""
        return float(np.prod(self.spacing)) * 1e-3

    def to_points(self, index: ArrayLike) -> Floats:
        """Return the points of voxel indices.

        Parameters
        ----------
        index : ArrayLike, shape (..., 3)
            Continuous voxel indices in order x, y, z.

        Returns
        -------
        Floats, shape (..., 3), mm
            Points in the patient frame.
        """
        return self.origin + (np.asarray(index, dtype=np.float64) * self.spacing) @ self.direction.T

    def to_index(self, points: ArrayLike) -> Floats:
        """Return the voxel indices of points.

        Parameters
        ----------
        points : ArrayLike, shape (..., 3), mm
            Points in the patient frame.

        Returns
        -------
        Floats, shape (..., 3)
            Continuous voxel indices in order x, y, z.
        """
        return ((np.asarray(points, dtype=np.float64) - self.origin) @ np.linalg.inv(self.direction).T) / self.spacing

    def contains(self, index: ArrayLike) -> bool:
        """Return whether a place lies within the image, up to the outer voxels' faces.

        Parameters
        ----------
        index : ArrayLike, shape (3,), voxels
            Continuous voxel index.
        """
        i = np.asarray(index, dtype=np.float64)
        return bool(np.all(np.isfinite(i)) and np.all(i >= -0.5) and np.all(i <= np.array(self.size) - 0.5))

    def crop(self, lower: Sequence[int], upper: Sequence[int]) -> Volume:
        """Return the part between two voxels.

        Parameters
        ----------
        lower : Sequence[int], x, y, z
            First voxel, clipped to the image.
        upper : Sequence[int], x, y, z
            Last voxel, inclusive, clipped to the image.

        Raises
        ------
        UserError
            Where the part lies outside the image.
        """
        low = np.maximum(np.asarray(lower, dtype=int), 0)
        high = np.minimum(np.asarray(upper, dtype=int), np.array(self.size) - 1)
        if np.any(low > high):
            raise UserError(f"the crop {tuple(lower)}..{tuple(upper)} lies outside the image of {self.size} voxels")
        part = self.array[low[2] : high[2] + 1, low[1] : high[1] + 1, low[0] : high[0] + 1]
        return replace(self, array=np.ascontiguousarray(part), origin=self.to_points(low))

    def upright(self) -> Volume:
        """Return the image with its voxel axes in the order and direction nearest to x, y, z of the patient.

        Results computed on voxels then don't depend on the order in which the file stored them. The array is a view,
        not a copy.
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

    def with_array(self, array: Array) -> Volume:
        """Return an image of another array on the same grid.

        Parameters
        ----------
        array : Array, shape (nz, ny, nx)
            The array.
        """
        return replace(self, array=array)

    def to_sitk(self) -> sitk.Image:
        """Return the image as a SimpleITK image; bool becomes uint8."""
        array = self.array.astype(np.uint8) if self.array.dtype == bool else self.array
        image = sitk.GetImageFromArray(array)
        image.SetSpacing(self.spacing.tolist())
        image.SetOrigin(self.origin.tolist())
        image.SetDirection(self.direction.ravel().tolist())
        return image


def from_sitk(image: sitk.Image, name: str = "", *, mask: bool = False) -> Volume:
    """Return a 3-D SimpleITK image as a Volume.

    Parameters
    ----------
    image : sitk.Image
        The image.
    name : str, optional
        Name for messages.
    mask : bool, optional
        Whether the result is bool, True for non-zero voxels; float32 otherwise.

    Returns
    -------
    Volume
        The volume, placed as the image is.
    """
    view = sitk.GetArrayViewFromImage(image)  # one copy less than an array of its own
    with np.errstate(over="ignore", invalid="ignore"):  # infinity and NaN, which are looked for
        array = view != 0 if mask else view.astype(np.float32)
    return placed(array, image, name)


def placed(array: Array, image: sitk.Image, name: str, notes: tuple[str, ...] = ()) -> Volume:
    """Return an array as a Volume that is placed as a SimpleITK image is.

    Parameters
    ----------
    array : Array, shape (nz, ny, nx)
        Voxels.
    image : sitk.Image
        The image that gives spacing, origin and direction.
    name : str
        Name for messages.
    notes : tuple[str, ...], optional
        Remarks, one line each.
    """
    direction = np.array(image.GetDirection()).reshape(3, 3)
    return Volume(array, np.array(image.GetSpacing()), np.array(image.GetOrigin()), direction, name, notes)
