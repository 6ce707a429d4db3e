"""Calibration as a script calls it: an organ in, a calibrated organ out."""

from __future__ import annotations

import os
import tempfile
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import TypedDict, Unpack

from tissue_sim.calibration import calibrate as calibration
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.calibration.coarseness import accuracy_warning
from tissue_sim.calibration.progress import Progress, Silent
from tissue_sim.calibration.stiffness import Settings
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.version import __version__


class CalibrationOptions(TypedDict, total=False):
    """What a calibration is made with; the defaults are those of `tissue_sim calibrate`.

    aim, which that calls `--for`: fast, balanced or accurate; method: cells, or groups of springs as in the paper;
    seed of the fitted loads; cases, how many of them; evaluations of the misfit; interior atoms; smooth and sharp,
    how many loads are held out.
    """

    aim: str
    method: str
    seed: int
    cases: int
    evaluations: int
    interior: int | None
    smooth: int
    sharp: int


def calibrate(
    organ: Organ | str | os.PathLike[str],
    *,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    **options: Unpack[CalibrationOptions],
) -> Organ:
    """Fit an organ to finite elements of its shape and tissue, and judge it by loads that were held out.

    The finite elements run in a process of their own beside the fit. A kidney of 994 points takes two minutes.

    Parameters
    ----------
    organ
        An organ with fixed nodes, or its file.
    checkpoint
        Folder that keeps what is done, so that the same call goes on after it was interrupted; None: nothing is kept.
    progress
        Where the stages report, such as `tissue_sim.progress.Stages()`; None: nowhere.
    **options
        See `CalibrationOptions`.

    Returns
    -------
    Organ
        With fitted cells and masses. Its `provenance["calibration"]` has the figures: `held_out`, `motion` and others.

    Raises
    ------
    UserError
        When the organ has no fixed nodes, is too thin for its triangles or can't be filled; for options out of range;
        and without the extra `calibration`.
    """
    if unknown := sorted(options.keys() - CalibrationOptions.__annotations__.keys()):
        raise TypeError(f"calibrate() got an unexpected keyword argument '{unknown[0]}'")
    settings = Settings(**options)
    given = organ if isinstance(organ, Organ) else Organ.load(organ)
    if warning := accuracy_warning(given):
        warnings.warn(warning, stacklevel=2)
    inputs = {"organ": given.digest(), "version": __version__, **asdict(settings)}
    with tempfile.TemporaryDirectory() as folder:
        kept = Checkpoint(Path(checkpoint or folder), inputs)
        try:
            made = calibration.calibrate(given, settings, kept, progress or Silent())
        except ModuleNotFoundError as error:
            raise UserError(f"a calibration needs {error.name}: pip install 'tissue_sim[calibration]'") from None
        if checkpoint is not None:
            kept.remove()
    return made.organ
