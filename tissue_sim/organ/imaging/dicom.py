"""Readers of DICOM: one stack of slices, placed by their headers, refused where it is incomplete or tilted.

Slices are ordered by their positions along the normal, whatever their files or numbers say. GDCM (in SimpleITK) decodes
them and applies rescale slope and intercept, slice by slice.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import SimpleITK as sitk

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.dicom_file import ALIKE, Slice, Stack, decoded, read_header
from tissue_sim.organ.imaging.dicom_frames import read_frames
from tissue_sim.organ.imaging.voxel_files import check_count

_GAP = 0.1  # relative deviation of a slice distance that counts as a gap
_TILT = 0.5  # pixels that slices may drift sideways over the whole stack
_FEW = 3  # slices: fewer beside a stack are localizers or scraps
_SHOWN = 12  # series named in a message


def read_stack(folder: Path, series: str | None = None) -> Stack:
    """Read the series of a DICOM folder.

    Localizers, and stacks of too few slices, are left out and noted, within a series and beside it.

    Parameters
    ----------
    folder : Path
        Folder that holds the slices.
    series : str | None, optional
        UID of the series, or its number in the list that a refusal shows.

    Raises
    ------
    UserError
        Where the folder holds no series or several stacks, where slices are missing, duplicated, tilted or without a
        position, and where one can't be decoded.
    """
    found: dict[str, list[list[Slice]]] = {}
    for file in sorted(path for path in folder.iterdir() if path.is_file()):
        header = read_header(str(file))
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


def _sort_in(stacks: list[list[Slice]], found: Slice) -> None:
    for stack in stacks:
        if stack[0].like(found):
            stack.append(found)
            return
    stacks.append([found])


def _below(folder: Path) -> str:
    names = sorted(path.name for path in folder.iterdir() if path.is_dir())
    return f" (it has the folders {', '.join(names[:5])})" if names else ""


def _is_scrap(stack: Sequence[Slice]) -> bool:
    """Return whether a stack is a localizer, or has too few slices for a volume."""
    frames = len(stack) * (stack[0].size[2] if len(stack[0].size) > 2 else 1)
    return frames < _FEW or "LOCALIZER" in stack[0].kind or stack[0].components != 1


def _choose_series(folder: Path, found: dict[str, list[list[Slice]]], series: str | None) -> tuple[str, list[str]]:
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


def _series_line(uid: str, stacks: list[list[Slice]]) -> str:
    count = sum(len(stack) for stack in stacks)
    description = stacks[0][0].description
    return f"{uid} ({description + ', ' if description else ''}{count} slice{'s' if count > 1 else ''})"


def _choose_stack(folder: Path, stacks: list[list[Slice]]) -> tuple[list[Slice], list[str]]:
    """Return the only stack of a series; several of different geometry are refused, except for localizers."""
    whole = [stack for stack in stacks if not _is_scrap(stack)]
    if len(stacks) == 1 or not whole:
        return stacks[0], []
    if len(whole) > 1:
        sizes = ", ".join(f"{len(stack)} slices of {stack[0].size[0]} x {stack[0].size[1]}" for stack in whole)
        raise UserError(f"DICOM folder {folder}: one series contains stacks of different geometry ({sizes}); keep one")
    others = sum(len(stack) for stack in stacks) - len(whole[0])
    return whole[0], [f"omitted {others} pictures of another geometry from the series (localizers)"]


def _without_copies(slices: list[Slice]) -> tuple[list[Slice], list[str]]:
    """Return each instance once: exports put the same slice into two files."""
    seen: dict[tuple[str, bytes], Slice] = {}
    for k, one in enumerate(slices):
        place = b"" if one.position is None else one.position.tobytes()
        seen.setdefault((one.instance or str(k), place), one)
    copies = len(slices) - len(seen)
    return list(seen.values()), [f"omitted {copies} copies of slices"] if copies else []


def _read_slices(folder: Path, slices: Sequence[Slice], notes: tuple[str, ...]) -> Stack:
    first = slices[0]
    if first.axes is None or first.pixel is None or any(one.position is None for one in slices):
        raise UserError(
            f"DICOM folder {folder}: slices have no position, orientation or pixel spacing; export the CT itself,"
            " not pictures of it"
        )
    row, column = first.axes
    if abs(np.linalg.norm(row) - 1.0) > ALIKE or abs(float(row @ column)) > ALIKE:
        raise UserError(f"DICOM folder {folder}: the slices' axes are not at right angles; export the CT again")
    normal = np.cross(row, column)
    position = np.array([one.position for one in slices])
    order = np.argsort(position @ normal, kind="stable")
    step = _checked_step(folder, position[order], normal, float(first.pixel.min()))
    nx, ny = first.size[:2]
    check_count(folder, (nx, ny, len(slices)))
    array = np.empty((len(slices), ny, nx), dtype=np.float32)
    for k, at in enumerate(order):
        picture = decoded(slices[at].file, nx * ny)  # named: a view doesn't keep its image
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
