"""Options of the tissue's law, which `build` and `calibrate` share."""

from __future__ import annotations

import argparse
from dataclasses import replace

from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ


def add_law(parser: argparse._ActionsContainer) -> None:
    """Add the options to a parser, or to a group of its arguments."""
    parser.add_argument(
        "--stiffening",
        type=float,
        metavar="B",
        help="b of Demiray's law, with which tissue stiffens under strain, 1 to 40 (default: the organ's; 0,"
        " neo-Hookean, for a new one)",
    )
    parser.add_argument(
        "--relaxation",
        metavar="FRACTION,SECONDS",
        help="fraction of the first force that a held tissue loses, and the time in which this part decreases to 1/e;"
        " 0 for elastic tissue (default: the organ's; elastic for a new one)",
    )


def law_of(args: argparse.Namespace) -> dict[str, float]:
    """Return the fields of an organ that the options set.

    Raises UserError where a relaxation is not two numbers; the organ refuses numbers out of range.
    """
    found: dict[str, float] = {}
    if args.stiffening is not None:
        found["stiffening"] = args.stiffening
    if args.relaxation is not None:
        fraction, time = _two_numbers(args.relaxation)
        found |= {"relaxation_fraction": fraction, "relaxation_time": time}
    return found


def _two_numbers(text: str) -> tuple[float, float]:
    """Return a fraction and a time."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if values == [0.0]:
        return 0.0, 0.0
    if len(values) != 2:
        raise UserError(f"--relaxation '{text}' is not a fraction and a time; write them as 0.3,1.5, or 0 for none")
    return values[0], values[1]


def with_law(organ: Organ, args: argparse.Namespace) -> Organ:
    """Return the organ with the law that the options ask for. Raises UserError as `law_of` and `Organ` do."""
    law: JsonObject = {**law_of(args)}
    return replace(organ, **law) if law else organ
