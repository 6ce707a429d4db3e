"""Calibration of several organs by `tissue_sim calibrate`: some at a time, with a row as each is ready."""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

from tissue_sim import progress
from tissue_sim.calibration.calibrate import Calibrated, calibrate
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.calibration.cohort import spread
from tissue_sim.calibration.progress import Silent
from tissue_sim.calibration.stiffness import Settings
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.version import __version__

_HEAD = ("organ", "smooth %", "worst", "sharp %", "worst", "release %", "settled", "substeps", "reference %", "minutes")
_WIDTHS = (28, 9, 7, 9, 7, 10, 9, 9, 12, 8)


class Task(NamedTuple):
    """Calibration of one organ."""

    organ: Organ
    settings: Settings
    folder: str | None  # folder of its checkpoint; None on a cluster, whose workers may not share one


class Done(NamedTuple):
    """Calibrated organ, its figures, and the minutes that it took."""

    organ: Organ
    figures: JsonObject
    minutes: float


def add_cluster(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say where organs are calibrated."""
    parser.add_argument("--jobs", type=int, metavar="N", help="number of organs calibrated at once (default: 1)")
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="use the workers of a Dask cluster, such as tcp://10.0.0.1:8786"
    )


def check_cluster(args: argparse.Namespace) -> None:
    """Raise UserError for values out of range, or for both options."""
    if args.jobs is not None and args.jobs < 1:
        raise UserError(f"--jobs {args.jobs} is less than 1")
    if args.jobs and args.scheduler:
        raise UserError("--jobs is for this machine; with --scheduler the cluster's workers determine the number")


def outputs_of(organs: Sequence[Path], folder: Path) -> list[Path]:
    """Return the output file of each organ.

    Raises UserError where two would be one file, or an organ would be overwritten.
    """
    found: dict[Path, Path] = {}
    for organ in organs:
        out = folder / f"{organ.stem}.npz"
        if out.resolve() == organ.resolve():
            raise UserError(f"--out {folder} contains {organ}; name another folder")
        if out in found:
            raise UserError(f"{found[out]} and {organ} have the same name, so both would be written to {out}")
        found[out] = organ
    return list(found)


def calibrate_many(
    organs: Sequence[Path], outputs: Sequence[Path], settings: Settings, jobs: int, scheduler: str | None
) -> dict[str, JsonObject | str]:
    """Calibrate organ files into others, and print a table as they become ready.

    An output that was made from the same organ with the same settings isn't made again.

    outputs: files of the calibrated organs; jobs: number of calibrations at a time on this machine; scheduler: address
    of a Dask scheduler, None for this machine. Returns figures by name, or the reason why there are none. Raises
    UserError where the scheduler doesn't answer.
    """
    found: dict[str, JsonObject | str] = {}
    with progress.task("organs", len(organs)) as under_way:

        def report(name: str, cells: Sequence[str]) -> None:
            row = (cell.rjust(w) if k else cell.ljust(w) for k, (cell, w) in enumerate(_row(name, cells)))
            print("  ".join(row), flush=True)
            under_way.advance(name != _HEAD[0])

        report(_HEAD[0], _HEAD[1:])
        todo: list[tuple[Path, Path]] = []
        for source, out in zip(organs, outputs, strict=True):
            before = made_before(source, out, settings)
            if before is None:
                todo.append((source, out))
                continue
            found[source.stem] = before
            report(source.stem, cells_of(before, "kept"))

        def tasks() -> Iterator[Task | str]:
            for source, out in todo:
                yield task_of(source, settings, None if scheduler else out.with_name(f".{out.name}.calibration"))

        for number, done in spread(worked_out, tasks(), jobs=jobs, scheduler=scheduler):
            source, out = todo[number]
            if isinstance(done, UserError):
                found[source.stem] = str(done)
                report(source.stem, [str(done)])
                continue
            write_whole(done.organ, out)
            found[source.stem] = {**done.figures, "minutes": round(done.minutes, 2)}
            report(source.stem, cells_of(done.figures, f"{done.minutes:.1f}"))
    return found


def task_of(source: Path, settings: Settings, folder: Path | None) -> Task | str:
    """Return the task for an organ file, or the reason why it can't be read: that fails one organ only."""
    try:
        return Task(Organ.load(source), settings, None if folder is None else str(folder))
    except UserError as error:
        return str(error)


def worked_out(task: Task | str) -> Done:
    """Calibrate one organ, wherever this runs. Raises UserError as calibrate does."""
    if isinstance(task, str):
        raise UserError(task)
    began = time.perf_counter()
    inputs = {"organ": task.organ.digest(), "version": __version__, **asdict(task.settings)}
    with tempfile.TemporaryDirectory(prefix="tissue_sim-") as spare:
        checkpoint = Checkpoint(Path(task.folder or spare), inputs)
        try:
            found: Calibrated = calibrate(task.organ, task.settings, checkpoint, Silent())
        finally:
            checkpoint.remove()  # also after a refusal, as the organ must change; a process that is killed leaves it
    return Done(found.organ, found.figures, (time.perf_counter() - began) / 60.0)


def made_before(source: Path, out: Path, settings: Settings) -> JsonObject | None:
    """Return the figures of an output made from the same organ with the same settings; None where there is none."""
    try:
        figures = Organ.load(out).provenance.get("calibration")
        made_of = Organ.load(source).digest()
    except UserError:
        return None
    same = {"made_of": made_of, "version": __version__, "settings": asdict(settings)}
    if isinstance(figures, dict) and all(figures.get(key) == value for key, value in same.items()):
        return figures
    return None


def write_whole(organ: Organ, out: Path) -> None:
    """Write the organ completely or not at all. Raises UserError where it can't be written."""
    part = out.with_name(f".{out.name}.part")
    organ.save(part)
    try:
        os.replace(part, out)
    except OSError as error:
        raise UserError(f"cannot write organ file {out}: {error.strerror}") from None


def write_figures(found: dict[str, JsonObject | str], path: Path) -> None:
    """Write all figures as JSON. Raises UserError where the file can't be written."""
    try:
        path.write_text(json.dumps(found, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}") from None


def cells_of(figures: JsonObject, minutes: str) -> list[str]:
    """Return an organ's row, without its name."""
    smooth, sharp = figures["held_out"]["smooth"], figures["held_out"].get("sharp")
    loads = [found for found in (smooth, sharp) if found]
    settled = f"{sum(found['settled'] for found in loads)}/{sum(found['cases'] for found in loads)}"
    return [
        f"{smooth['mean_percent']:.1f}",
        f"{smooth['worst_percent']:.1f}",
        *((f"{sharp['mean_percent']:.1f}", f"{sharp['worst_percent']:.1f}") if sharp else ("-", "-")),
        f"{figures['motion']['release_percent']:.1f}",
        settled,
        str(figures["step"]["substeps_a_ms"]),
        f"{figures['reference']['worst_percent']:.2f}",
        minutes,
    ]


def _row(name: str, cells: Sequence[str]) -> list[tuple[str, int]]:
    """Return cells with their widths; a reason takes the room that it needs."""
    return list(zip((name, *cells), (_WIDTHS[0], *(0,)) if len(cells) == 1 else _WIDTHS, strict=True))
