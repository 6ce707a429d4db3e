"""Contents of an organ file, and reading of one: header, arrays, checksum, and the versions of its schema."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tissue_sim.array_types import Array
from tissue_sim.errors import UserError, shown
from tissue_sim.file_kinds import ORGAN, wrong_kind
from tissue_sim.json_types import JsonObject
from tissue_sim.npz import read_npz

# 2: interior_spoke; 3: springs that harden, gone; 4: cells; 5: inclusions; 6: virtual nodes; 7: tissue that stiffens or
# relaxes
SCHEMA_VERSION = 7
# Fields of the header, with their types.
_HEADER = {"name": str, "youngs_modulus": float, "poisson_ratio": float, "density": float, "provenance": dict}
# Those of tissue that stiffens or relaxes: the value that other tissue has, which the header leaves out, and the range.
LAW = {
    "stiffening": (0.0, 0.0, 100.0),
    "cell_stiffening": (1.0, 0.1, 10.0),
    "relaxation_fraction": (0.0, 0.0, 0.9),
    "relaxation_time": (0.0, 0.01, 60.0),
}
_SHOWN, _LONGEST_NAME = 40, 200  # characters of an array's name in a message, of an organ's at all


def read_fields(path: str | os.PathLike[str], arrays: Collection[str]) -> dict[str, Any]:
    """Return the fields of an organ file by name.

    Parameters
    ----------
    path : str | os.PathLike[str]
        The file.
    arrays : Collection[str]
        Names of the arrays of an organ, of which older files lack some.

    Raises
    ------
    UserError
        Where the file is missing, not an organ, truncated, altered, or of an unknown schema version.
    """
    try:
        content = read_npz(Path(path))
    except FileNotFoundError:
        raise UserError(f"organ file {path} does not exist; make one with 'tissue_sim build'") from None
    except IsADirectoryError:
        raise UserError(f"organ file {path} is a folder; name the .npz file") from None
    except OSError as error:
        raise UserError(f"organ file {path} can't be read: {error.strerror}") from None
    except ValueError as error:
        if other := wrong_kind(Path(path), ORGAN):
            raise UserError(f"{path} {other}, and not an organ file; make one with 'tissue_sim build'") from None
        raise UserError(
            f"organ file {path} is damaged or not an organ file ({shown(str(error), 200)}); build it again"
        ) from None
    if "header" not in content or "sha256" not in content:
        raise UserError(f"{path} is not an organ file: it has no header; make one with 'tissue_sim build'")
    text = str(content.pop("header"))
    digest = str(content.pop("sha256"))
    header = _header(text)
    if header is None:
        raise UserError(f"organ file {path} has a damaged header; build it again")
    version = header["schema_version"]
    if version > SCHEMA_VERSION:
        raise UserError(
            f"organ file {path} has schema version {version}, this package reads up to {SCHEMA_VERSION};"
            " update tissue_sim"
        )
    expected = set(arrays)
    if version < 2:
        expected -= {"interior_spoke"}
    if version < 4:
        expected -= {"cell_nodes", "cell_mu", "cell_lambda"}
    if version < 5:
        expected -= {name for name in expected if name.startswith("inclusion_")}
    if version < 6:
        expected -= {"virtual_of"}
    if set(content) != expected:
        odd = ", ".join(shown(name, _SHOWN) for name in sorted(expected ^ set(content)))
        raise UserError(f"organ file {path} is damaged: missing or unknown arrays: {odd}")
    if digest != content_digest(text, content):
        raise UserError(f"organ file {path} was altered: its checksum does not match; build it again")
    if header.get("hardening", 0.0):
        raise UserError(
            f"organ file {path} was calibrated with hardening springs, which are no longer supported; build and"
            " calibrate it again, with cells, which harden as tissue does"
        )
    content.setdefault("interior_spoke", np.empty((0, 2)))  # version 1 had no interior atoms
    return {**{key: header[key] for key in (*_HEADER, *LAW) if key in header}, **content}


def check_law(whose: str, **law: float) -> None:
    """Raise UserError unless a tissue can stiffen and relax so.

    Parameters
    ----------
    whose : str
        Beginning of the message.
    law : float
        Fields of the law by name, as Organ has them; others are those of neo-Hookean, elastic tissue.

    Raises
    ------
    UserError
        Where a number is out of range, or a relaxation lacks one.
    """
    for name, value in law.items():
        usual, least, most = LAW[name]
        if value != usual and not least <= value <= most:
            raise UserError(f"{whose}{name.replace('_', ' ')} {value:g} is outside {least:g}..{most:g}")
    if bool(law.get("relaxation_fraction")) != bool(law.get("relaxation_time")):
        raise UserError(f"{whose}relaxation needs a fraction and a time, or neither")


def _header(text: str) -> JsonObject | None:
    """Return what an organ file's header says; None where it is not a header."""
    try:
        header = json.loads(text)
        header["schema_version"] = int(header["schema_version"])
        if header["schema_version"] > SCHEMA_VERSION:
            return dict(header)
        for key, kind in _HEADER.items():
            header[key] = kind(header[key])
        for key in LAW.keys() & header.keys():
            header[key] = float(header[key])
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None
    numbers = [header[key] for key in (*_HEADER, *LAW) if isinstance(header.get(key), float)]
    if len(header["name"]) > _LONGEST_NAME or not np.all(np.isfinite(numbers)):
        return None
    return dict(header)


def content_digest(text: str, arrays: Mapping[str, Array]) -> str:
    """Return the SHA-256 (hex) of an organ file's header and arrays, which the file itself holds.

    Parameters
    ----------
    text : str
        The header.
    arrays : Mapping[str, Array]
        Arrays by name.
    """
    digest = hashlib.sha256(text.encode())
    for key in sorted(arrays):
        array = np.ascontiguousarray(arrays[key])
        digest.update(f"{key}{array.dtype.str}{array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
