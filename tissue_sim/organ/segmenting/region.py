"""A region of the image that an organ was found in, as one stage hands it to the next."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from tissue_sim.array_types import Mask, Singles

Index = tuple[int, int, int]
Box = tuple[slice, slice, slice]


@dataclass(frozen=True, eq=False)
class Region:
    """The eroded organ and its surroundings on one isotropic grid; arrays (nz, ny, nx), lengths mm, intensities HU.

    sharp, smooth: the image, smoothed little and much; inside: in the image; level: the organ's intensity, from place
    to place; eroded: the organ after erosion; others: what surely is a neighbour; apex: the eroded organ's deepest
    voxel. mean, deviation: of the organ's intensity; width: half of its window; dark: intensity of fat; reach: how far
    the organ may dilate back; h: the grid's spacing.
    """

    sharp: Singles
    smooth: Singles
    inside: Mask
    level: Singles
    eroded: Mask
    others: Mask
    apex: Index
    mean: float
    deviation: float
    width: float
    dark: float
    reach: float
    h: float

    @property
    def wall(self) -> float:
        """Intensity half-way between the organ and fat."""
        return 0.5 * (self.mean + self.dark)

    def cropped(self, box: Box) -> Region:
        """The part in a box of array indices, which holds the apex; arrays are views."""
        arrays = {item.name: getattr(self, item.name) for item in fields(self)}
        parts: dict[str, Any] = {name: array[box] for name, array in arrays.items() if isinstance(array, np.ndarray)}
        z, y, x = (i - side.start for i, side in zip(self.apex, box, strict=True))
        return replace(self, **parts, apex=(z, y, x))
