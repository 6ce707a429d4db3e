"""Checks of a bag's journal, whose rows a replay follows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tissue_sim.array_types import Array
from tissue_sim.model.data.records import Record
from tissue_sim.model.runtime.mailboxes import BodyInputs, JournalRow
from tissue_sim.model.stepping.state_check import MAX_NUMBER
from tissue_sim.ros.bags.bag import BodyContactRow, ContactRow, SurfaceRow, WrenchRow

MOST_TICKS = 2**62
LONGEST_STILL = 24 * 3600.0  # s without any event: a replay would go through all their ticks

_ROWS: dict[str, type[Record]] = {
    "inputs": JournalRow,
    "contacts": ContactRow,
    "wrenches": WrenchRow,
    "surfaces": SurfaceRow,
}
_BODIES: dict[str, tuple[str, type[Record]]] = {
    "body_inputs": ("inputs", BodyInputs),
    "body_contacts": ("contacts", BodyContactRow),
}
SHOWING = ("inputs", "wrenches", "surfaces")  # whose ticks a replay visits


def check_journal(rows: Mapping[str, Array], n_bodies: int, first_tick: int, rate: float) -> None:
    """Check that the rows of a journal have their fields, fit together and are of possible ticks.

    rows: rows by kind, see recorder; n_bodies: number of bodies; first_tick: tick of the state; rate: ticks per second,
    Hz. Raises ValueError when they don't; the message names the rows.
    """
    for kind, record in _ROWS.items():
        _check_rows(rows, kind, record, (len(rows[kind]) if kind in rows and rows[kind].ndim else 0,))
    for kind, (owner, record) in _BODIES.items():
        _check_rows(rows, kind, record, (len(rows[owner]), n_bodies))
    ticks_shown = [rows[kind]["tick"].astype(np.int64) for kind in SHOWING]
    ticks = np.unique(np.concatenate([np.array([first_tick]), *ticks_shown]))
    if ticks[0] < -1 or ticks[-1] > MOST_TICKS:
        raise ValueError(f"its journal contains tick {ticks[0] if ticks[0] < -1 else ticks[-1]}")
    ticks = ticks[ticks >= first_tick]
    still = np.diff(ticks).max(initial=0) / rate
    if not still <= LONGEST_STILL:
        raise ValueError(f"its journal contains no event for {still / 3600.0:.3g} hours")


def _check_rows(rows: Mapping[str, Array], kind: str, record: type[Record], shape: tuple[int, ...]) -> None:
    found = rows.get(kind)
    if found is None:
        raise ValueError(f"its journal has no {kind}")
    if found.shape != shape:
        raise ValueError(f"its journal's {kind} have shape {found.shape}, expected {shape}")
    for name in record.dtype.names or ():
        if name not in (found.dtype.names or ()):
            raise ValueError(f"its journal's {kind} have no field '{name}'")
        values, wanted = found[name], record.dtype[name].kind
        if values.shape != shape or values.dtype.kind not in ("fiub" if wanted == "f" else "iub"):
            raise ValueError(f"its journal's {kind} have a field '{name}' of another type")
        if wanted == "f" and values.size and not np.abs(values).max() <= MAX_NUMBER:
            raise ValueError(f"its journal's {kind} have a '{name}' that is not finite, or beyond {MAX_NUMBER:g}")
