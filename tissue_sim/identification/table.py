"""Measured presses from a CSV file.

Three layouts are distinguished by the names of their columns, in SI units; lines that begin with # are left out:

- one sample a row: `press,depth,force`, and where the place is known `x,y,z` (m, where the tool's surface first
  touched) and `nx,ny,nz` (the outward normal there);
- one press a row: `x,y,z,nx,ny,nz,d0,...,fn0,...`, depths and normal forces in as many columns as there are;
- a stream: `time,x,y,z,fx,fy,fz`, of the tool's middle and the force on it; see `stream.py`.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.identification.measured import MeasuredPress

PLACE, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
STREAM = ("time", "x", "y", "z", "fx", "fy", "fz")
LEAST, UNEVEN = 0.1, 0.25e-3  # N at the deepest, m off the usual depths: rows that are left out
Columns = dict[str, Floats]
LAYOUTS = "columns press,depth,force, or d0,... and fn0,..., or time,x,y,z,fx,fy,fz"


def read_columns(path: Path) -> Columns:
    """Return the columns of a CSV file by name.

    Raises
    ------
    UserError
        For a file that is missing, has no header and rows, or holds something other than numbers.
    """
    try:
        lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line and not line.startswith("#")]
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"cannot read {path}: {getattr(error, 'strerror', None) or 'it is not text'}") from None
    rows = list(csv.reader(lines))
    if len(rows) < 2:
        raise UserError(f"{path} has no rows; expected: a header and rows, {LAYOUTS}")
    names = [name.strip() for name in rows[0]]
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(names):
            raise UserError(f"{path}: row {number} has {len(row)} columns instead of {len(names)}")
    found: Columns = {}
    for name, cells in zip(names, zip(*rows[1:], strict=True), strict=True):
        try:
            found[name] = np.array([float(cell) for cell in cells])
        except ValueError:
            raise UserError(f"{path}: column {name} holds something that is not a number") from None
        if not np.isfinite(found[name]).all():
            raise UserError(f"{path}: column {name} holds what is not finite")
    return found


def is_stream(columns: Columns) -> bool:
    """Return whether columns are those of a stream."""
    return set(STREAM) <= set(columns)


def presses_of(columns: Columns, radius: float, name: str) -> list[MeasuredPress]:
    """Return the presses of a table; name: of the file, for messages; radius of the tool, m.

    Of a table with a press a row, presses that stay below 0.1 N, or whose depths are off the usual ones by more than
    0.25 mm, are left out.

    Raises
    ------
    UserError
        For columns that are not those of presses.
    """
    deep = sorted((key for key in columns if re.fullmatch(r"d\d+", key)), key=lambda key: int(key[1:]))
    force_keys = [f"fn{key[1:]}" for key in deep]
    if deep and set(force_keys) <= set(columns):
        depths, forces = (np.stack([columns[key] for key in keys], axis=1) for keys in (deep, force_keys))
        even = np.abs(depths - np.median(depths, axis=0)).max(axis=1) < UNEVEN
        rows = np.flatnonzero(even & (forces[:, -1] > LEAST))
        return [_press(f"press {row + 1}", columns, row, (depths[row], forces[row]), radius) for row in rows.tolist()]
    if not {"press", "depth", "force"} <= set(columns):
        raise UserError(f"{name} has columns {', '.join(columns)}; expected: {LAYOUTS}")
    found = []
    for number in np.unique(columns["press"]).tolist():
        rows = np.flatnonzero(columns["press"] == number)
        samples = columns["depth"][rows], columns["force"][rows]
        found.append(_press(f"press {number:g}", columns, int(rows[0]), samples, radius))
    return found


def _press(name: str, columns: Columns, row: int, samples: tuple[Floats, Floats], radius: float) -> MeasuredPress:
    """Return a press of depths and forces (d,), up to where it is deepest; its place stands in a row."""
    depths, forces = samples
    last = int(depths.argmax()) + 1
    place, direction = np.full(3, np.nan), np.full(3, np.nan)
    if set(PLACE) <= set(columns):
        place = np.array([columns[axis][row] for axis in PLACE])
    if set(NORMAL) <= set(columns):
        normal = np.array([columns[axis][row] for axis in NORMAL])
        direction = -normal / max(float(np.linalg.norm(normal)), 1e-12)
        place = place - radius * direction
    return MeasuredPress(name, depths[:last], forces[:last], place, direction, np.zeros((0, 3)))
