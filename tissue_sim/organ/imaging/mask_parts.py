"""The separate parts of a mask: refused, one taken, or all joined; what is left out is told with its volume."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tissue_sim.array_types import Floats, Mask
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import Volume

DOMINANT = 0.9  # of the volume of all parts: the largest is meant, the others are scraps
_SCRAP = 0.01  # of the volume of all parts: what is left out when parts are joined
_MOST_FILLED = 0.1  # of the parts' volume that may be filled between them
_SHOWN = 8  # parts named in a message


def one_part(mask: Volume, part: int | None = None, *, merge: bool = False) -> Volume:
    """Return the mask with one part that holds together, with a note on what was left out, or filled.

    part: the part to take, 1 is the largest; merge: join all parts of a hundredth of the volume and more by filling the
    gaps between them. With neither, the largest is taken where it holds nine tenths of the volume. Raises UserError
    naming the parts and their volumes, mL, where it doesn't, where there is no such part, and where parts lie too far
    apart to be joined.
    """
    labels, count = ndimage.label(mask.array, structure=np.ones((3, 3, 3)))
    if count < 2:
        if part not in (None, 1):
            raise UserError(f"mask {mask.name} has no part {part}: it is in one")
        return mask
    voxels = np.bincount(labels.ravel())[1:]
    order = np.argsort(-voxels, kind="stable")
    volumes = voxels[order] * mask.voxel_volume
    listed = _listed(volumes)
    if part is not None and not 1 <= part <= count:
        raise UserError(f"mask {mask.name} has no part {part}; it holds {listed}")
    if merge:
        large = order[: max(int(np.count_nonzero(volumes > _SCRAP * volumes.sum())), 1)]
        kept, told = _merged(mask, labels, large + 1)
        aside, beside = count - len(large), volumes[len(large) :].sum()
        more = (told, *([f"left out {_count(aside)} of {beside:.3g} mL beside them"] if aside else []))
        return replace(mask, array=kept, notes=(*mask.notes, *more))
    if part is None and volumes[0] < DOMINANT * volumes.sum():
        raise UserError(
            f"mask {mask.name} has {count} separate parts: {listed}; take one with --part N (1 is the largest), or join"
            " all with --merge-parts"
        )
    taken = (part or 1) - 1
    aside = float(volumes.sum() - volumes[taken])
    note = f"left out {_count(count - 1)} of {aside:.3g} mL beside {volumes[taken]:.3g} mL"
    return replace(mask, array=labels == order[taken] + 1, notes=(*mask.notes, note))


def _merged(mask: Volume, labels: NDArray[Any], wanted: NDArray[Any]) -> tuple[Mask, str]:
    """The wanted parts with the gaps between them filled, and a line on it."""
    parts = np.isin(labels, wanted)
    joined, gap = join(parts, mask.spacing[::-1])
    before = float(np.count_nonzero(parts)) * mask.voxel_volume
    filled = float(np.count_nonzero(joined & ~parts)) * mask.voxel_volume
    if gap > 0.0 and (filled > _MOST_FILLED * before or ndimage.label(joined)[1] > 1):
        raise UserError(
            f"mask {mask.name} has parts up to {gap:.3g} mm apart, too far to be one organ; build each with --part N,"
            " and put them into a scene"
        )
    return (
        joined,
        f"joined {_count(len(wanted))} of {before:.3g} mL across gaps of up to {gap:.3g} mm: {filled:.3g} mL filled",
    )


def join(solid: Mask, sampling: Floats) -> tuple[Mask, float]:
    """Return a solid (nz, ny, nx) with the gaps between its parts filled, and the widest of these gaps, mm.

    sampling: mm along z, y, x. The parts are joined one by one, the nearest first, and then closed by a ball as large
    as the widest gap, so that the bridges are no threads.
    """
    labels, count = ndimage.label(solid, structure=np.ones((3, 3, 3)))
    left, reached, gap = set(range(2, count + 1)), labels == 1, 0.0
    while left:
        away = ndimage.distance_transform_edt(~reached, sampling)
        nearest = {one: float(away[labels == one].min()) for one in left}
        one = min(nearest, key=nearest.__getitem__)
        gap = max(gap, nearest[one])
        left.remove(one)
        reached |= labels == one
    if gap == 0.0:
        return solid, gap
    margin = [int(np.ceil(gap / step)) + 2 for step in sampling]
    around = np.pad(solid, [(m, m) for m in margin])
    grown = ndimage.distance_transform_edt(~around, sampling) <= gap
    closed = ndimage.distance_transform_edt(grown, sampling) > gap
    inner = tuple(slice(m, -m) for m in margin)
    return solid | closed[inner], gap


def _count(parts: int) -> str:
    return f"{parts} separate part{'s' if parts > 1 else ''}"


def _listed(volumes: NDArray[Any]) -> str:
    more = [f"{len(volumes) - _SHOWN} smaller"] if len(volumes) > _SHOWN else []
    return ", ".join([f"{k} {volume:.3g} mL" for k, volume in enumerate(volumes[:_SHOWN], 1)] + more)
