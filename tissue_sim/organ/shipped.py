"""Locations of the files that come with the package."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from tissue_sim.errors import UserError

AS_BUILT = "kidney_as_built"  # with the paper's 48 atoms, before calibration


def shipped_file(inside: str) -> Path | None:
    """Return the path of a file that ships with the package, in the checkout or in an install's share folder.

    Parameters
    ----------
    inside : str
        Path inside the package's folder.

    Returns
    -------
    Path | None
        The path; None where there is no such file.
    """
    here = Path(__file__).resolve()
    # PREFIX/lib/python3.x/site-packages/tissue_sim/organ/shipped.py, as pip and colcon lay it out.
    prefixes: list[str | Path] = [*here.parents[5:6], sys.prefix]
    prefixes += os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    folders = [Path(prefix) / "share" / "tissue_sim" for prefix in prefixes if prefix]
    return next((folder / inside for folder in (here.parents[2], *folders) if (folder / inside).is_file()), None)


def shipped_organ(name: str = "kidney") -> Path:
    """Return the path of an organ that ships with the package.

    Parameters
    ----------
    name : str, optional
        Name of the organ.

    Raises
    ------
    UserError
        Where no organ of that name ships.
    """
    found = shipped_file(f"config/organs/{name}.npz")
    if found is None:
        raise UserError(f"organ '{name}' is not part of this installation; make one with 'tissue_sim build'")
    return found
