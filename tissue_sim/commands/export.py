"""`tissue_sim export`: an organ's surface, its skeleton and its cells, or frames of a bag, for other programs."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.reporting.exchange import CELLS, LINES, SURFACES, UNITS, Writer, bones
from tissue_sim.outputs import check_folder

EVERY = 20  # ticks from one frame of a bag to the next


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("organ", metavar="ORGAN|BAG", help="organ file (.npz), or folder of a recorded bag")
    parser.add_argument(
        "out",
        metavar="OUT",
        help=f"surface to write, in the format of its extension: {', '.join(SURFACES)}; for a bag OUT.pvd, with frames"
        " as VTU files and their times, or OUT.glb, for OUT_0000.glb and so on",
    )
    parser.add_argument(
        "--every", type=int, metavar="TICKS", help=f"of a bag: ticks from one frame to the next (default: {EVERY})"
    )
    parser.add_argument("--skeleton", metavar="FILE", help=f"also write the medial atoms, as lines: {', '.join(LINES)}")
    parser.add_argument("--cells", metavar="FILE", help=f"also write nodes and cells, with moduli: {', '.join(CELLS)}")
    parser.add_argument("--unit", choices=tuple(UNITS), default="m", help="length unit (default: %(default)s)")


def run(args: argparse.Namespace) -> int:
    """Write the surface, and skeleton and cells where asked, or a bag's frames; returns 0. Raises UserError."""
    if Path(args.organ).is_dir():
        from tissue_sim.commands.export_bag import export_bag

        for option, value in (("--skeleton", args.skeleton), ("--cells", args.cells)):
            if value is not None:
                raise UserError(f"{option} belongs to an organ file, and {args.organ} is a bag")
        export_bag(Path(args.organ), Path(args.out), EVERY if args.every is None else args.every, args.unit)
        return 0
    if args.every is not None:
        raise UserError(f"--every belongs to a bag, which {args.organ} is not")
    surface = _writer(args.out, SURFACES, "surface")
    lines = _writer(args.skeleton, LINES, "skeleton") if args.skeleton else None
    cells = _writer(args.cells, CELLS, "cells") if args.cells else None
    if args.skeleton and Path(args.skeleton).resolve() == Path(args.out).resolve():
        raise UserError(f"--skeleton and the surface are both {args.out}; name two files")
    organ = Organ.load(args.organ)
    if cells is not None and not len(organ.cell_nodes):
        raise UserError(f"organ '{organ.name}' has no cells for {args.cells}; tissue_sim calibrate adds them")
    scale = UNITS[args.unit]
    _write(args.out, surface(organ, args.unit))
    low, high = (getattr(organ.surface_positions, side)(axis=0) * scale for side in ("min", "max"))
    spans = ", ".join(f"{axis} {a:.4g}..{b:.4g}" for axis, a, b in zip("xyz", low, high, strict=True))
    print(f"{args.out}: {organ.n_surface} points, {len(organ.surface_triangles)} triangles, {args.unit}, {spans}")
    if lines is not None:
        _write(args.skeleton, lines(organ, args.unit))
        print(f"{args.skeleton}: {organ.n_atoms} atoms, {len(bones(organ))} lines, {args.unit}")
    if cells is not None:
        _write(args.cells, cells(organ, args.unit))
        print(f"{args.cells}: {organ.n_nodes} nodes, {len(organ.cell_nodes)} cells, {args.unit}")
    return 0


def _writer(path: str, formats: Mapping[str, Writer], what: str) -> Writer:
    suffix = Path(path).suffix.lower()
    if suffix not in formats:
        raise UserError(f"{path}: unknown format of the {what}; use the extension {', '.join(formats)}")
    check_folder(Path(path), path)
    return formats[suffix]


def _write(path: str, content: bytes) -> None:
    try:
        Path(path).write_bytes(content)
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from None
