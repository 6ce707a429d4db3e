"""Region of the image in which an organ was found, as one stage hands it to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tissue_sim.array_types import Mask, Singles

Index = tuple[int, int, int]
Box = tuple[slice, slice, slice]


@dataclass(frozen=True, eq=False)
class Region:
    """Eroded organ and its surroundings on one isotropic grid; arrays (nz, ny, nx), lengths mm, intensities HU.

    Attributes
    ----------
    sharp : Singles
        The image, slightly smoothed.
    smooth : Singles
        The image, strongly smoothed.
    inside : Mask
        Voxels within the image.
    level : Singles
        Local intensity of the organ.
    eroded : Mask
        The organ after erosion.
    others : Mask
        Voxels that surely belong to a neighbour.
    apex : Index
        Deepest voxel of the eroded organ.
    mean : float
        Mean intensity of the organ.
    deviation : float
        Standard deviation of the organ's intensity.
    width : float
        Half of the intensity window.
    dark : float
        Intensity of fat.
    reach : float
        How far the organ may dilate back.
    h : float
        Spacing of the grid.
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
        """Intensity halfway between the organ and fat."""
        return 0.5 * (self.mean + self.dark)

    def cropped(self, box: Box) -> Region:
        """Return the part in a box of array indices that holds the apex; arrays are views."""
        z, y, x = (i - side.start for i, side in zip(self.apex, box, strict=True))
        return replace(
            self,
            sharp=self.sharp[box],
            smooth=self.smooth[box],
            inside=self.inside[box],
            level=self.level[box],
            eroded=self.eroded[box],
            others=self.others[box],
            apex=(z, y, x),
        )
