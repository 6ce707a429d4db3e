"""Benchmark `tissue_sim bench measured`: bodies that others have measured, finite elements and the real-time model."""

from __future__ import annotations

import argparse
from pathlib import Path

from tissue_sim import progress
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.measured import beam, truth_cube
from tissue_sim.bench.measured.plots import pictures_of
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.bench.timing import in_one_thread
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject

BODIES = ("cube", "beam")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("--data", metavar="FOLDER", required=True, help="folder of the measured tables")
    parser.add_argument(
        "--out",
        metavar="FOLDER",
        required=True,
        help="folder for pictures, the calibrated bodies and intermediate results",
    )
    parser.add_argument("--bodies", nargs="+", choices=BODIES, default=BODIES, help="which")
    add_shared(parser, organ=None, check=True)


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    data = Path(args.data)
    for body, file in (("cube", truth_cube.FILE), ("beam", beam.FILE)):
        if body in args.bodies and not (data / file).is_file():
            raise UserError(f"{data / file} does not exist; name the folder of the measured tables with --data")
    found, cube, bent = in_one_thread(measure, data, Path(args.out), tuple(args.bodies))
    return Result(found, text(found), {} if rows.stopped() else pictures_of(cube, bent))


def measure(
    data: Path, folder: Path, bodies: tuple[str, ...]
) -> tuple[JsonObject, list[truth_cube.Compressed] | None, list[beam.Bent] | None]:
    """Return figures with bounds, and the results of both bodies. Raises UserError as the bodies do."""
    found: JsonObject = {}
    bounds: list[Bound] = []
    cube: list[truth_cube.Compressed] | None = None
    bent: list[beam.Bent] | None = None
    with rows.until_stopped():
        if "cube" in bodies:
            cube = truth_cube.measure(data, folder, progress.Stages())
    if cube:
        found["truth_cube"] = truth_cube.as_json(cube)
        last = found["truth_cube"][-1]
        behind = last["model_mean_mm"] - last["elements_mean_mm"]
        at = f"at {last['strain_percent']:g} %"
        bounds += [
            Bound(f"truth cube: inner beads {at}, mean", last["model_mean_mm"], truth_cube.MOST_OFF, "mm"),
            Bound(f"truth cube: relative to finite elements {at}", behind, truth_cube.MOST_BEHIND, "mm"),
        ]
    fit: beam.Fitted | None = None
    with rows.until_stopped():
        if "beam" in bodies and not rows.stopped():
            fit, bent = beam.measure(data, folder, progress.Stages())
    if fit is not None and bent:
        found["beam"] = beam.as_json(fit, bent)
        for weight in (load for load in beam.WEIGHTS if beam.WEIGHTS[load] > 0.0):
            some = [one for one in bent if one.run.startswith(weight)]
            still = max((abs(one.off["model"]) for one in some), default=None)
            moving = max((one.off_moving["model"] for one in some), default=None)
            bounds += [
                Bound(f"beam, {weight}: displacement at rest, the worse run", still, beam.MOST_OFF, "%"),
                Bound(f"beam, {weight}: motion, the worse run", moving, beam.MOST_OFF_MOVING, "%"),
            ]
    found["bounds"] = [bound.as_json() for bound in bounds]
    return found, cube, bent


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    lines: list[str] = []
    if "truth_cube" in found:
        rows = [["strain %", "finite elements mm", "worst", "model mm", "worst", "us a ms", "faults"]]
        for one in found["truth_cube"]:
            means = [f"{one[f'{who}_{what}_mm']:.3f}" for who in ("elements", "model") for what in ("mean", "worst")]
            rows.append([f"{one['strain_percent']:g}", *means, f"{one['tick_us']:.0f}", str(one["faults"])])
        lines += [
            "truth cube (Kerdok et al. 2003): 125 inner beads, distance from the measured ones",
            *aligned(rows),
            "",
        ]
    if "beam" in found:
        rest = [["run", "at rest mm", "finite elements", "%", "model", "%", "motion: finite elements %", "model %"]]
        rest[0] += ["us a ms", "faults"]
        for one in found["beam"]["runs"]:
            travel, off, moving = one["rest_mm"], one["rest_off_percent"], one["motion_off_percent"]
            rest.append(
                [
                    one["run"],
                    f"{travel['measured']:.2f}",
                    *(cell for who in ("elements", "model") for cell in (f"{travel[who]:.2f}", f"{off[who]:+.1f}")),
                    *(f"{moving[who]:.1f}" for who in ("elements", "model")),
                    f"{one['tick_us']:.0f}",
                    str(one["faults"]),
                ]
            )
        fit = found["beam"]
        lines += [
            f"beam (Zhang et al. 2021): fitted without a weight, {1e-3 * fit['modulus_at_rest_pa']:.0f} kPa at rest,"
            f" {1e-3 * fit['modulus_moving_pa']:.0f} kPa within a second, damping ratio {fit['damping_ratio']:.3f}",
            *aligned(rest),
            "",
        ]
    return "\n".join([*lines, *bound_lines(found["bounds"])])
