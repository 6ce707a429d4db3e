"""Where the organs that come with the package are."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from tissue_sim.errors import UserError


def shipped_organ(name: str = "kidney") -> Path:
    """Path of an organ that ships with the package: in the checkout, or in an install's share folder.

    Raises UserError when there is none of that name.
    """
    inside = Path("config") / "organs" / f"{name}.npz"
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    shares = [Path(prefix) / "share" / "tissue_sim" for prefix in prefixes if prefix]
    for folder in (Path(__file__).resolve().parents[2], *shares):
        if (folder / inside).is_file():
            return folder / inside
    raise UserError(f"no organ '{name}' comes with this installation; make one with 'tissue_sim build'")
