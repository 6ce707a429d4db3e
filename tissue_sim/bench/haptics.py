"""Benchmark `tissue_sim bench haptics`: largest stable coupling of a haptic device, by pose rate and delay.

Simulated devices are pushed onto a hard ball through the virtual coupling, in simulated time and by the tick that the
node runs. The largest stiffness at which they come to rest is compared with theory: a device of damping b is stable for
K < 2 b / T where poses are T s apart (Colgate and Schenkel 1997, b > K T / 2 + |B|; the coupling's own damping acts on
the tool, so that B = 0), and for K < b / (T / 2 + t) where a force comes t s after its pose (Hulin, Preusche and
Hirzinger 2006; Gil et al. 2009). An encoder's quantum requires dry friction c: K < 2 c / quantum (Abbott and Okamura
2005). That friction also takes energy out of an oscillation, so that real devices are stable beyond what viscous
damping alone allows (Diolaiti, Niemeyer, Barbagli and Salisbury 2006).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from functools import cache, partial
from itertools import product
from typing import NamedTuple

import numpy as np

from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.device_loop import (
    STIFFEST,
    Holder,
    Link,
    ObservedPort,
    Tissue,
    hard_ball,
    stable_stiffness,
    tried,
)
from tissue_sim.bench.devices import DEVICES, GRIP, NO_HAND, Device
from tissue_sim.bench.haptics_plot import drawn
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.bench.processes import on_all_cores
from tissue_sim.bench.rows import each, report, stopped, until_stopped
from tissue_sim.json_types import JsonObject
from tissue_sim.model.contact.virtual_coupling import passive_stiffness
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

RATES = 1000.0, 500.0, 250.0, 100.0  # Hz
DELAYS = 0.0, 0.001, 0.002, 0.005, 0.010, 0.020  # s, of both ways together
OBSERVED = 0.0, 0.005, 0.020  # s, delays at which an observer is tried
LEAST_RATIO = 0.95  # of what theory allows, as a search ends within some percent
MOST_RATIO = 2.0  # for the device that corresponds to the theory
WORTH = 1.25  # median factor by which an observer has to raise the stiffness to be worthwhile


class Row(NamedTuple):
    """Results of a device at a rate, Hz, and a delay, s: stiffness, N/m, found, with an observer, and in theory."""

    device: str
    rate: float
    delay: float
    found: float
    observed: float | None
    without_delay: float
    with_delay: float

    @property
    def ratio(self) -> float:
        """Stiffness found, as a multiple of what theory allows."""
        return self.found / self.with_delay


class Bare(NamedTuple):
    """Device without a coupling on an organ: the longest delay, s, up to which it comes to rest; None for none."""

    device: str
    rate: float
    delay: float | None


class Cell(NamedTuple):
    """Task of one process: a device held by a hand or not, and its connection; with an organ file where uncoupled."""

    device: Device
    link: Link
    held: bool
    observed: bool
    organ: str = ""

    @property
    def name(self) -> str:
        """Name of the device in tables."""
        return f"{self.device.name}, held" if self.held else self.device.name

    @property
    def holder(self) -> Holder:
        """The device, and the hand on it."""
        return Holder(self.device, self.link, GRIP if self.held else NO_HAND)


# measuring -----------------------------------------------------------------------------------------


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, out="draw the stable stiffness over the delay into FOLDER", check=True)
    parser.add_argument("--observer", action="store_true", help="also test the passivity observer, at fewer delays")


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    organ = args.organ or str(shipped_organ())
    Organ.load(organ)
    found = as_json(*measure(cells_of(organ, observed=args.observer)))
    return Result(found, text(found), {} if stopped() else {"haptics.png": partial(drawn, found)})


def cells_of(organ: str, *, observed: bool) -> list[Cell]:
    """Return all cells: first those on the hard ball, then those on an organ without a coupling."""
    pushed, held = [(one, False) for one in DEVICES], [(one, True) for one in DEVICES[:-1]]
    coupled = [
        Cell(device, Link(rate, delay), is_held, observed)
        for (device, is_held), rate, delay in product((*pushed, *held), RATES, OBSERVED if observed else DELAYS)
    ]
    return coupled + [Cell(device, Link(rate), False, False, organ) for device, rate in product(DEVICES, RATES)]


def measure(cells: Sequence[Cell]) -> tuple[list[Row], list[Bare]]:
    """Compute all cells, on all processors."""
    rows: list[Row] = []
    bare: list[Bare] = []
    with until_stopped():
        for found in each(on_all_cores(worked_out, [(cell,) for cell in cells]), "searches", len(cells)):
            at = f"{found.device}, {found.rate:g} Hz"
            if isinstance(found, Row):
                rows.append(found)
                report(f"{at}, {1e3 * found.delay:g} ms", f"{_found(found.found)} N/m", f"{found.ratio:.2f} of theory")
            else:
                bare.append(found)
                report(f"{at}, uncoupled", "none" if found.delay is None else f"{1e3 * found.delay:g} ms")
    return rows, bare


def worked_out(cell: Cell) -> Row | Bare:
    """Search the stability limit of a device."""
    return uncoupled(cell) if cell.organ else coupled(cell)


def coupled(cell: Cell) -> Row:
    """Search the largest stiffness, and compute what theory allows."""
    holder, link = cell.holder, cell.link
    with_observer = holder._replace(port=partial(ObservedPort, holder))
    return Row(
        cell.name,
        link.rate,
        link.delay,
        stable_stiffness(_ball(), holder),
        stable_stiffness(_ball(), with_observer) if cell.observed else None,
        passive_stiffness(holder.damping, link.period, 0.0),
        holder.passive,
    )


def uncoupled(cell: Cell) -> Bare:
    """Search the longest delay up to which a device rests on tissue without a coupling."""
    longest = None
    for delay in DELAYS:
        holder = cell.holder._replace(link=cell.link._replace(delay=delay))
        if tried(_tissue(cell.organ), holder, 0.0).swings:
            break
        longest = delay
    return Bare(cell.device.name, cell.link.rate, longest)


@cache
def _ball() -> Tissue:
    return hard_ball()


@cache
def _tissue(organ: str) -> Tissue:
    return Tissue(Organ.load(organ))


# reporting -----------------------------------------------------------------------------------------


def as_json(rows: Sequence[Row], bare: Sequence[Bare]) -> JsonObject:
    """Return all figures, and the bounds."""
    textbook = [row.ratio for row in rows if row.device == DEVICES[-1].name]
    bounds = [
        Bound(
            "ratio to the theoretical bound, smallest",
            min((row.ratio for row in rows), default=None),
            LEAST_RATIO,
            "",
            least=True,
        ),
        Bound(
            "the textbook device, ratio to the theoretical bound, largest", max(textbook, default=None), MOST_RATIO, ""
        ),
    ]
    if gains := [row.observed / row.found for row in rows if row.observed is not None and row.found > 0.0]:
        bounds.append(
            Bound("with an observer, ratio to without, median", float(np.median(gains)), WORTH, "", least=True)
        )
    return {
        "grip": GRIP._asdict(),
        "devices": [one._asdict() | {"dry_limit": dry_limit(one)} for one in DEVICES],
        "rows": [row._asdict() | {"ratio": row.ratio} for row in rows],
        "uncoupled": [one._asdict() for one in bare],
        "bounds": [bound.as_json() for bound in bounds],
    }


def dry_limit(device: Device) -> float | None:
    """Return the stiffness, N/m, above which a quantum of the encoder exceeds dry friction."""
    return 2.0 * device.friction / device.quantum if device.quantum > 0.0 else None


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    grip = f"held: by {1e3 * GRIP.mass:g} g, {GRIP.damping:g} N s/m, {GRIP.stiffness:g} N/m (assumed: a light grip)"
    observed = any(row["observed"] is not None for row in found["rows"])
    head = ["device", "poses, Hz", "delay ms", "found N/m", "2 b / T", "b / (T/2 + t)", "found / that"]
    rows = [[*head, "observer", "ratio to without"] if observed else head]
    for row in found["rows"]:
        line = [row["device"], f"{row['rate']:g}", f"{1e3 * row['delay']:g}", _found(row["found"])]
        line += [f"{row['without_delay']:.0f}", f"{row['with_delay']:.0f}", f"{row['ratio']:.2f}"]
        if observed:
            gain = "-" if row["observed"] is None else f"{row['observed'] / row['found']:.2f}"
            line += [_found(row["observed"]), gain]
        rows.append(line)
    bare = [["without a coupling, on the organ", "poses, Hz", "comes to rest with a delay of"]]
    for one in found["uncoupled"]:
        most = "none" if one["delay"] is None else f"{1e3 * one['delay']:g} ms"
        bare.append([one["device"], f"{one['rate']:g}", most])
    lines = [
        "largest coupling_stiffness with which a device comes to rest on a hard sphere; t: time from a pose to its"
        " force",
        *(f"{one['name']}: {_data(one)}" for one in found["devices"]),
        grip,
        "",
        *aligned(rows),
        "",
        *aligned(bare),
        "",
        *bound_lines(found["bounds"]),
    ]
    return "\n".join(lines)


def _found(stiffness: float | None) -> str:
    if stiffness is None:
        return "-"
    return f">= {stiffness:.0f}" if math.isclose(stiffness, STIFFEST) else f"{stiffness:.0f}"


def _data(device: JsonObject) -> str:
    limit = "" if device["dry_limit"] is None else f"; 2 c / quantum = {device['dry_limit']:.0f} N/m"
    return (
        f"{1e3 * device['mass']:g} g, b = {device['damping']:g} N s/m, c = {device['friction']:g} N,"
        f" {1e6 * device['quantum']:g} um, {device['most_force']:g} N{limit} ({device['source']})"
    )
