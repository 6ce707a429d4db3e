"""Placement of the voxels by a NIfTI's header: numbers on which ITK never ends, and forms that disagree."""

from __future__ import annotations

import gzip
import math
import zlib
from pathlib import Path

import numpy as np
from nibabel import Nifti1Header, Nifti2Header
from nibabel.spatialimages import HeaderDataError

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.organ.imaging.voxel_files import Header, millimetres

_LARGEST = 1e9  # of a number in a transform
_GZIP = b"\x1f\x8b"
_KINDS = (Nifti1Header, Nifti2Header)
_FORMS = {  # the fields of the numbers of each
    "qform": ("quatern_b", "quatern_c", "quatern_d", "qoffset_x", "qoffset_y", "qoffset_z", "pixdim"),
    "sform": ("srow_x", "srow_y", "srow_z"),
}
_RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


def read_nifti_header(path: Path) -> Header:
    """Read where a NIfTI's header places its voxels: by its sform, or by its qform where that is alone.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    Header
        The affine, the unit of length, and the bytes that the voxels' file needs.

    Raises
    ------
    UserError
        Where a transform holds numbers that are huge or not finite, and where sform and qform place a corner of the
        image more than half a voxel apart, because programs differ in which they use.
    """
    data = _head(path)
    for kind in _KINDS:
        if kind.may_contain_header(data):
            return _placed(path, kind(data[: kind.sizeof_hdr], check=False))
    return Header()


def _placed(path: Path, header: Nifti1Header) -> Header:
    size = [int(n) for n in header["dim"][1 : 1 + max(1, min(7, int(header["dim"][0])))]]
    if not 1 <= int(header["dim"][0]) <= 7 or min(size) < 1:
        raise UserError(
            f"{path} has a damaged header: its size is {' x '.join(map(str, size))} voxels; export the image again"
        )
    for form, fields in _FORMS.items():
        numbers = np.concatenate([np.ravel(header[field]) for field in fields])
        if header[f"{form}_code"] > 0 and not np.all(np.abs(numbers) <= _LARGEST):
            raise UserError(
                f"{path} has a damaged header: its {form} contains numbers that are not finite, or too large"
            )
    try:
        sform, qform = header.get_sform(coded=True)[0], header.get_qform(coded=True)[0]
        unit = millimetres(path, [header.get_xyzt_units()[0]], "xyzt_units")
    except (HeaderDataError, KeyError, ValueError) as error:
        raise UserError(f"{path} has a damaged header ({error})") from None
    least = math.prod(size) * int(header["bitpix"]) // 8 + int(header["vox_offset"])
    if sform is None and qform is None:
        note = f"warning: {path.name} has neither a qform nor an sform, so it is unknown which side is left"
        return Header(unit=unit, notes=(note,), least=least)
    if sform is not None and qform is not None:
        _check_agreement(path, header, sform, qform)
    affine = _RAS_TO_LPS @ (qform if sform is None else sform)
    affine[:3] *= unit
    return Header(affine=affine, least=least)


def _check_agreement(path: Path, header: Nifti1Header, sform: Floats, qform: Floats) -> None:
    last = np.maximum(np.asarray(header["dim"][1:4], dtype=np.float64) - 1.0, 0.0)
    corners = np.stack(np.meshgrid(*([0.0, n] for n in last)), axis=-1).reshape(-1, 3)
    between = corners @ (sform - qform)[:3, :3].T + (sform - qform)[:3, 3]
    spacing = [np.linalg.norm(form[:3, :3], axis=0) for form in (sform, qform)]
    apart = float(np.linalg.norm(between, axis=1).max())
    if apart <= 0.5 * min(float(one.min()) for one in spacing):
        return
    sizes = [" x ".join(f"{value:.3g}" for value in one) for one in spacing]
    raise UserError(
        f"{path} has an sform and a qform that place its corners up to {apart:.3g} mm apart (voxels of {sizes[0]}"
        f" and of {sizes[1]}): it isn't clear which is correct; write the correct one into both, with nibabel"
        " image.set_qform(image.get_sform()) or image.set_sform(image.get_qform()), and save it"
    )


def _head(path: Path) -> bytes:
    longest = max(kind.sizeof_hdr for kind in _KINDS)
    with path.open("rb") as file:
        data = file.read(longest)
        if data[:2] != _GZIP:
            return data
        file.seek(0)
        try:
            with gzip.open(file) as unpacked:
                return unpacked.read(longest)
        except (OSError, EOFError, zlib.error):  # ITK says what is wrong with it
            return b""
