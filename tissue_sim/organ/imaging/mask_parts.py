"""Separate parts of a mask: refused, one taken, or all joined; what is left out is reported with its volume."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from tissue_sim.array_types import Array, Floats, Mask
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import Volume

DOMINANT = 0.9  # of the volume of all parts: the largest is meant, the others are scraps
_SCRAP = 0.01  # of the volume of all parts: what is left out when parts are joined
_MOST_FILLED = 0.1  # of the parts' volume that may be filled between them
_SHOWN = 8  # parts named in a message


def one_part(mask: Volume, part: int | None = None, *, merge: bool = False) -> Volume:
    """Return the mask reduced to one connected part, with a note on what was left out or filled.

    Without `part` and `merge` the largest part is taken where it holds nine tenths of the volume.

    Parameters
    ----------
    mask : Volume
        The voxels of the organ.
    part : int | None, optional
        Number of the part to take; 1 is the largest.
    merge : bool, optional
        Join all parts of more than a hundredth of the volume by filling the gaps between them.

    Returns
    -------
    Volume
        The mask with one part.

    Raises
    ------
    UserError
        Where no part dominates, where there is no such part, and where the parts lie too far apart to be joined.
    """
    labels, count = ndimage.label(mask.array, structure=np.ones((3, 3, 3)))
    if count < 2 and not merge:
        if part not in (None, 1):
            raise UserError(f"mask {mask.name} has no part {part}: it has a single part")
        return mask
    voxels = np.bincount(labels.ravel())[1:]
    order = np.argsort(-voxels, kind="stable")
    volumes = voxels[order] * mask.voxel_volume
    listed = _listed(volumes)
    if part is not None and not 1 <= part <= count:
        raise UserError(f"mask {mask.name} has no part {part}; it contains {listed}")
    if merge:
        joined, notes = joined_parts(mask)
        if joined is None:
            raise UserError(f"mask {mask.name} {notes}; build each with --part N, and join them in a scene")
        return replace(mask, array=joined, notes=(*mask.notes, *notes))
    if part is None and volumes[0] < DOMINANT * volumes.sum():
        raise UserError(
            f"mask {mask.name} has {count} separate parts: {listed}; select one with --part N (1 is the largest),"
            " or join all with --merge-parts"
        )
    taken = (part or 1) - 1
    aside = float(volumes.sum() - volumes[taken])
    note = f"omitted {_count(count - 1)} of {aside:.3g} mL next to {volumes[taken]:.3g} mL"
    return replace(mask, array=labels == order[taken] + 1, notes=(*mask.notes, note))


def joined_parts(mask: Volume) -> tuple[Mask, list[str]] | tuple[None, str]:
    """Return the mask with its parts joined.

    Parts of less than a hundredth of the volume are left out. The others are joined one by one, the nearest first, by a
    closing with a ball one voxel larger than the widest gap, so that the bridges are not too thin.

    Parameters
    ----------
    mask : Volume
        The voxels of the organ.

    Returns
    -------
    tuple[Mask, list[str]] | tuple[None, str]
        The joined mask and lines that describe it; None and the reason where the parts can't be joined.
    """
    labels, count = ndimage.label(mask.array)
    voxels = np.bincount(labels.ravel())[1:]
    large = np.flatnonzero(voxels > _SCRAP * voxels.sum()) + 1
    solid = np.isin(labels, large)
    sampling = mask.spacing[::-1]
    left, reached, gap = set(large[1:].tolist()), labels == large[0], 0.0
    while left:
        away = ndimage.distance_transform_edt(~reached, sampling)
        nearest = {one: float(away[labels == one].min()) for one in left}
        one = min(nearest, key=nearest.__getitem__)
        gap = max(gap, nearest[one])
        left.remove(one)
        reached |= labels == one
    joined = solid | _closed(solid, gap + float(sampling.max()), sampling) if gap > 0.0 else solid
    before, filled, aside = (
        float(np.count_nonzero(part)) * mask.voxel_volume for part in (solid, joined & ~solid, mask.array & ~solid)
    )
    if filled > _MOST_FILLED * before or ndimage.label(joined)[1] > 1:
        return None, f"has parts {gap:.3g} mm apart, too far for one organ"
    notes = []
    if len(large) > 1:
        notes.append(f"joined {_count(len(large))} across gaps of up to {gap:.3g} mm: {filled:.3g} mL filled between")
    if aside > 0.0:
        notes.append(f"omitted {_count(count - len(large))} of {aside:.3g} mL next to {before:.3g} mL")
    return joined, notes


def _closed(solid: Mask, radius: float, sampling: Floats) -> Mask:
    """Return the solid after a closing by a ball of `radius` mm; sampling: mm along z, y, x."""
    margin = [(m, m) for m in (int(np.ceil(radius / step)) + 2 for step in sampling)]
    grown = ndimage.distance_transform_edt(~np.pad(solid, margin), sampling) <= radius
    closed = ndimage.distance_transform_edt(grown, sampling) > radius
    return np.asarray(closed[tuple(slice(m, -m) for m, _ in margin)])


def _count(parts: int) -> str:
    return f"{parts} separate part{'s' if parts > 1 else ''}"


def _listed(volumes: Array) -> str:
    more = [f"{len(volumes) - _SHOWN} smaller"] if len(volumes) > _SHOWN else []
    return ", ".join([f"{k} {volume:.3g} mL" for k, volume in enumerate(volumes[:_SHOWN], 1)] + more)
