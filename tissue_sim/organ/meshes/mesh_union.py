"""Union of parts that touch, as the walls of a heart: one solid around all that they enclose, by voxels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage
from skimage.measure import marching_cubes

from tissue_sim.array_types import Floats, Longs, Mask
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.image import MM, Volume
from tissue_sim.organ.imaging.mask_parts import DOMINANT, joined_parts
from tissue_sim.organ.meshes.mesh_holes import capped_volume, fill
from tissue_sim.organ.meshes.mesh_parts import Part
from tissue_sim.organ.meshes.mesh_repair import components
from tissue_sim.organ.meshes.voxels import enclosed, off_grid

_AXIS = 128  # voxels along the longest side
_SEAL = 0.1  # of the longest side: radius of the ball that must not pass an opening of a chamber
_GROWTH = 2.0  # of the ball from step to step
_SPUR = 1.5  # voxels: radius of what is taken off (valves, threads)
_SMOOTHING = 0.7  # voxels


def merged(parts: Sequence[Part], name: str) -> Part:
    """Return one part around all that the parts enclose: their voxels, without chambers, then marching cubes.

    Every part is closed first, whatever the width of its holes: inside a union a cap does no harm. Chambers whose
    openings (vessels, valves) let no ball with a radius of a tenth of the longest side through are filled. Parts that
    can't be closed, sheets thinner than three voxels and loose pieces are left out where they hold less than a tenth of
    the volume; larger loose pieces are joined across their gaps. All of it is reported in the repairs. The points are
    new.

    Parameters
    ----------
    parts : Sequence[Part]
        The parts, largest first.
    name : str
        Name for messages.

    Raises
    ------
    UserError
        Where too much can't be closed, where pieces lie too far apart, and where nothing is left.
    """
    points = np.concatenate([part.positions for part in parts])
    low, high = points.min(axis=0), points.max(axis=0)
    pitch = float((high - low).max()) / _AXIS
    origin = low - 4.0 * pitch
    size = np.ceil((high - low) / pitch).astype(np.int64) + 8
    union = np.zeros(tuple(size[::-1]), dtype=bool)
    capped, joined = 0, 0
    skipped: list[Part] = []
    for part in parts:
        closed = None if part.flaw else fill(part.positions, part.triangles, part.gaps)
        if closed is None:
            skipped.append(part)
            continue
        joined, capped = joined + 1, capped + len(part.gaps)
        inward = capped_volume(part.positions, closed, ()) < 0.0
        outward = (closed[:, ::-1] if inward else closed).astype(np.int32)
        union |= enclosed(off_grid((part.positions - origin) / pitch), np.ascontiguousarray(outward), size)
    if skipped and sum(part.volume for part in skipped) >= (1.0 - DOMINANT) * sum(part.volume for part in parts):
        flaw = skipped[0].flaw or "has a hole that is too long to fill"
        raise UserError(
            f"surface {name} can't be joined: its part {skipped[0].number} {flaw}; separate its solids there, or"
            " make it a single closed surface (in Blender: Remesh, Voxel)"
        )
    sealed = without_chambers(union, _SEAL * _AXIS)
    opened = _opened(sealed, _SPUR)
    if not opened.any():
        raise UserError(f"surface {name} has no parts that enclose a solid")
    notes = [f"joined {joined} parts on a grid of {pitch * 1e3:.2g} mm; the points are new"]
    solid = _largest(opened)
    if np.count_nonzero(solid) < DOMINANT * np.count_nonzero(opened):
        bridged, how = joined_parts(Volume(opened, np.full(3, pitch / MM), origin, np.eye(3), name))
        if bridged is None:
            raise UserError(f"surface {name} {how}; build each with --part N, and join them in a scene")
        solid = bridged
        notes += how
    if capped:
        notes.append(f"capped {capped} holes of the parts")
    changes = {"filled chambers": sealed & ~union, "omitted sheets and loose pieces": union & ~solid}
    for what, changed in changes.items():
        if changed.any():
            notes.append(f"{what} of {np.count_nonzero(changed) * (pitch * 1e2) ** 3:.3g} mL")
    if skipped:
        notes.append(f"omitted {len(skipped)} parts that can't be closed")
    level = ndimage.gaussian_filter(solid.astype(np.float32), _SMOOTHING)
    corners, triangles, _, _ = marching_cubes(level, 0.5, allow_degenerate=False)
    positions = origin + corners[:, ::-1].astype(np.float64) * pitch
    positions, triangles = _outermost(positions, triangles.astype(np.int64))
    volume = abs(capped_volume(positions, triangles, ()))
    return replace(
        parts[0],
        name=name,
        positions=positions,
        triangles=triangles,
        gaps=(),
        volume=volume,
        flaw="",
        repairs=tuple(notes),
    )


def without_chambers(solid: Mask, radius: float) -> Mask:
    """Return the solid (nz, ny, nx) with its chambers filled: hollows wider than their openings.

    An opening is what no ball of `radius` voxels passes. For balls of growing radius, a closing by the ball shuts the
    openings; what it then separates from the outside is a chamber, filled up to the plugs in its openings. Grooves,
    which are as wide as their opening, stay.
    """
    margin = int(radius) + 2
    found = np.pad(solid, margin)
    ball = 2.0
    while True:
        ball = min(ball, radius)
        grown = ndimage.distance_transform_edt(~found) <= ball
        swept = ndimage.distance_transform_edt(grown) <= ball  # by the ball, coming from outside or in a chamber
        labels, count = ndimage.label(swept)
        if count > 1:
            chambers = swept & (labels != labels[0, 0, 0])
            outside = swept & ~chambers
            found |= (ndimage.distance_transform_edt(~chambers) <= ball) & ~outside
        if ball >= radius:
            break
        ball *= _GROWTH
    inner = tuple(slice(margin, -margin) for _ in range(3))
    return np.asarray(ndimage.binary_fill_holes(found[inner]))


def _opened(solid: Mask, radius: float) -> Mask:
    kept = ndimage.distance_transform_edt(solid) > radius
    return np.asarray(ndimage.distance_transform_edt(~kept) <= radius) if kept.any() else kept


def _largest(solid: Mask) -> Mask:
    labels, count = ndimage.label(solid)
    return solid if count < 2 else labels == int(np.bincount(labels.ravel())[1:].argmax()) + 1


def _outermost(positions: Floats, triangles: Longs) -> tuple[Floats, Longs]:
    """Return the part that encloses most."""
    parts = components(triangles)
    volumes = [abs(capped_volume(positions, triangles[part], ())) for part in parts]
    used, inverse = np.unique(triangles[parts[int(np.argmax(volumes))]], return_inverse=True)
    return positions[used], inverse.reshape(-1, 3).astype(np.int64)
