"""Output of benchmarks: tables, bounds, JSON."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from tissue_sim.bench import rows
from tissue_sim.errors import UserError
from tissue_sim.figures import save
from tissue_sim.json_types import JsonObject
from tissue_sim.outputs import write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def aligned(rows: Sequence[Sequence[str]], left: int = 1) -> list[str]:
    """Return the lines of a table with aligned columns.

    rows: cells of each row (the first row is the head); left: number of columns, from the first, that are aligned left
    (the others are aligned right).
    """
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]

    def line(cells: Sequence[str]) -> str:
        parts = [c.ljust(w) if k < left else c.rjust(w) for k, (c, w) in enumerate(zip(cells, widths, strict=True))]
        return "  ".join(parts).rstrip()

    return [line(rows[0]), "  ".join("-" * width for width in widths), *map(line, rows[1:])]


def with_remarks(table: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table whose last column is aligned left, after all others.

    table: cells of each row (the first row is the head).
    """
    lines = aligned([row[:-1] for row in table])
    remarks = [table[0][-1], "", *(row[-1] for row in table[1:])]
    width = max(len(line) for line in lines)
    return [f"{line.ljust(width)}  {remark}".rstrip() for line, remark in zip(lines, remarks, strict=True)]


class Result(NamedTuple):
    """Result of a benchmark: figures for --json, with `bounds` where it has any, text, and pictures for --out."""

    found: JsonObject
    text: str
    pictures: Mapping[str, Callable[[], Figure]] = MappingProxyType({})  # by the names of files in --out


NOISY = 1.5  # p99 over median of a fixed loop, beyond which only ratios of times are meaningful
STOPPED = "stopped by Ctrl-C: these are the measurements so far"


class Bound(NamedTuple):
    """Bound on a figure.

    Attributes
    ----------
    name : str
        Its name.
    value : float | None
        The figure; None where it wasn't measured.
    limit : float
        The limit.
    unit : str
        Their unit.
    least : bool
        Whether the limit is a lower one.
    """

    name: str
    value: float | None
    limit: float
    unit: str
    least: bool = False

    @property
    def met(self) -> bool | None:
        """Whether it is met; None when the figure is missing, or only holds so far because measuring was stopped."""
        if self.value is None:
            return None
        held = bool(self.value >= self.limit if self.least else self.value <= self.limit)
        return None if held and rows.stopped() else held

    def as_json(self) -> JsonObject:
        """Return its fields, and whether it is met."""
        return self._asdict() | {"met": self.met}


def bound_lines(bounds: Iterable[JsonObject]) -> list[str]:
    """Return the lines of a table of bounds. bounds: bounds, as Bound.as_json has them."""
    table = [["bound", "measured", "limit", ""]]
    for bound in bounds:
        sign = ">=" if bound["least"] else "<="
        value = "-" if bound["value"] is None else f"{bound['value']:.4g} {bound['unit']}"
        unknown = "not measured" if bound["value"] is None else "met so far"
        verdict = {True: "held", False: "missed", None: unknown}[bound["met"]]
        table.append([bound["name"], value, f"{sign} {bound['limit']:g} {bound['unit']}", verdict])
    return with_remarks(table)


def figure(value: float) -> str:
    """Return a number with three significant digits, without an exponent."""
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def built_or_skipped[Made](make: Callable[[], tuple[Made, str]], *also: type[Exception]) -> tuple[Made | None, str]:
    """Return what can be measured here and a remark on it; None and the reason where it can't be made.

    make: makes it; also: further exceptions that are reasons, besides a missing package and UserError. Returns the
    result and the remark.
    """
    known: tuple[type[Exception], ...] = (UserError, *also)
    try:
        return make()
    except known as error:
        return None, f"skipped: {error}"
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("tissue_sim"):
            raise
        return None, f"skipped: {error.name} is not installed: pip install 'tissue_sim[bench]'"


def noise_lines(noise: float | None) -> list[str]:
    """Return a remark on noise, the p99 of a fixed loop over its median, where it is high.

    noise: the ratio, None where it isn't known. Returns one line, or none.
    """
    if noise is None or noise < NOISY:
        return []
    return [
        f"noise: a fixed loop's p99 is {noise:.1f} times its median on this machine now; rely on medians and ratios"
    ]


def emit(found: JsonObject, text: str, json_to: str | None) -> None:
    """Print the text and write JSON to a file, or with - print the JSON instead; both say when it was stopped.

    json_to: file for the JSON, `-` for the standard output, None for no JSON. Raises UserError where the file can't be
    written.
    """
    if rows.stopped():
        found, text = {**found, "stopped": True}, f"{STOPPED}\n\n{text}"
    if json_to == "-":
        print(json.dumps(found, indent=2))
        return
    print(text)
    if json_to:
        write_json(Path(json_to), found)


def finish(result: Result, args: argparse.Namespace) -> int:
    """Print what was found, write the pictures; return 1 when bounds are checked and one of them is missed, else 0.

    args: `json`, `out` and `check`, which all benchmarks have. Raises UserError where a file can't be written.
    """
    emit(result.found, result.text, args.json)
    for name, draw in result.pictures.items() if args.out else ():
        path = Path(args.out) / name
        save(draw(), path)
        print(f"picture: {path}", file=sys.stderr)
    return int(args.check and any(bound["met"] is False for bound in result.found["bounds"]))
