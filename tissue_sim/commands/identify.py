"""Command `tissue_sim identify`: fit an organ's stiffness to measured presses."""

from __future__ import annotations

import argparse
import importlib.util
from pathlib import Path

import numpy as np

from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.errors import UserError
from tissue_sim.identification.identify import LAWS, Settings, identify, lines_of, provenance_of
from tissue_sim.identification.measured import Measurement
from tissue_sim.identification.mixed_effects import Priors
from tissue_sim.identification.report import write_report
from tissue_sim.identification.slab import PREFIX, cached_slab, slab_size
from tissue_sim.identification.stream import Stream, found_in
from tissue_sim.identification.table import STREAM, is_stream, presses_of, read_columns
from tissue_sim.interrupts import leaving
from tissue_sim.organ.organ import Organ
from tissue_sim.outputs import check_file, write_json
from tissue_sim.version import __version__

LARGEST = 0.5  # m, radius of a tool


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "organ",
        metavar="ORGAN",
        help="organ file (.npz), or a slab that is built and calibrated once, in four minutes, by its size in mm:"
        f" {PREFIX}60x60x25",
    )
    recorded = parser.add_mutually_exclusive_group()
    recorded.add_argument("--bag", metavar="BAG", help="folder of a bag: of this package, or with the topics named")
    recorded.add_argument("--csv", metavar="FILE", help="CSV file of presses or of a stream, in SI units")
    parser.add_argument("--tool", metavar="NAME", help="tool of a bag of this package (default: its only round one)")
    parser.add_argument("--pose-topic", metavar="TOPIC", help="topic of PoseStamped of the tool's middle in a bag")
    parser.add_argument("--wrench-topic", metavar="TOPIC", help="topic of WrenchStamped of the force on the tool")
    parser.add_argument(
        "--wrench-axes",
        choices=("poses", "tool"),
        default="poses",
        help="axes of the forces: those of the poses, or of the tool, which the poses turn",
    )
    parser.add_argument("--negate", action="store_true", help="forces are the tool's on the tissue")
    parser.add_argument(
        "--organ-pose",
        type=float,
        nargs=7,
        metavar="N",
        help="pose of the organ in the axes of the poses: x y z in m and a quaternion x y z w (default: none)",
    )
    parser.add_argument("--out", required=True, metavar="FITTED", help="organ file (.npz) to write")
    parser.add_argument("--radius", type=float, metavar="METRES", help="radius of the round tool")
    parser.add_argument(
        "--unplaced",
        action="store_true",
        help="places are not in the organ's axes: press the model where it is flat, and use places only to"
        " distinguish presses",
    )
    parser.add_argument(
        "--offset-deviation",
        type=float,
        default=Priors().offset,
        metavar="METRES",
        help="standard deviation of where presses begin to touch",
    )
    parser.add_argument(
        "--bias-deviation",
        type=float,
        default=Priors().bias,
        metavar="NEWTON",
        help="standard deviation of the sensor's bias",
    )
    parser.add_argument(
        "--friction", type=float, default=Settings().friction, help="coefficient of friction of tool and tissue"
    )
    parser.add_argument(
        "--law",
        choices=LAWS,
        help="law of the tissue: exponential fits Demiray's b, by which tissue stiffens with strain, and uses it where"
        " it lowers the held-out error (default: the organ's, with its b)",
    )
    parser.add_argument("--one-modulus", action="store_true", help="fit no map of stiffness")
    parser.add_argument("--report", metavar="FILE", help="HTML file for a report with curves, residuals and the map")
    parser.add_argument("--json", metavar="FILE", help="write the result to a file as JSON")


def run(args: argparse.Namespace) -> int:
    """Identify, write the organ and print; return 0. Raises UserError for input that can't be used."""
    _check(args)
    out = Path(args.out)
    organ = organ_of(args.organ)
    measurement = _measurement(args, organ)
    settings = Settings(
        Priors(args.offset_deviation, args.bias_deviation),
        args.friction,
        with_map=not args.one_modulus,
        law=args.law,
    )
    folder = out.with_name(f".{out.name}.identification")
    checkpoint = Checkpoint(folder, {"organ": organ.digest(), "version": __version__})
    with leaving(f"the same command continues from {folder}"):
        found = identify(organ, measurement, settings, checkpoint.remember)
    found.organ.save(out)
    if args.report:
        write_report(found, Path(args.report))
    checkpoint.remove()
    print("\n".join([*lines_of(found), f"written: {out}"]))
    if args.json:
        write_json(Path(args.json), provenance_of(found))
    return 0


def organ_of(word: str) -> Organ:
    """Return the organ of a file, or the slab that a word names. Raises UserError as these do."""
    return cached_slab(slab_size(word)) if word.startswith(PREFIX) else Organ.load(word)


def _check(args: argparse.Namespace) -> None:
    out = Path(args.out)
    check_file("--out", out, ".npz", "the organ file")
    if args.report:
        check_file("--report", Path(args.report), ".html", "the report")
    if args.json:
        check_file("--json", Path(args.json), ".json", "the result")
    if args.report and not (importlib.util.find_spec("matplotlib") and importlib.util.find_spec("jinja2")):
        raise UserError("--report needs matplotlib and jinja2: pip install 'tissue_sim[image]'")
    if args.radius is not None and not 0.0 < args.radius <= LARGEST:
        raise UserError(f"--radius {args.radius:g} is outside 0..{LARGEST:g} m")
    for name, most in (("offset_deviation", 0.01), ("bias_deviation", 10.0)):
        if not 0.0 < getattr(args, name) <= most:
            raise UserError(f"--{name.replace('_', '-')} {getattr(args, name):g} is outside 0..{most:g}")
    if not 0.0 <= args.friction <= 10.0:
        raise UserError(f"--friction {args.friction:g} is outside 0..10")


def _measurement(args: argparse.Namespace, organ: Organ) -> Measurement:
    """Return what the options name."""
    if args.bag is not None:
        return _from_bag(args, organ)
    if args.csv is None:
        raise UserError("name what was measured with --bag BAG or --csv FILE")
    if args.radius is None:
        raise UserError("--csv needs --radius METRES, the tool's")
    columns = read_columns(Path(args.csv))
    if is_stream(columns):
        if args.unplaced:
            raise UserError(f"{args.csv} is a stream, in which presses are found by their places: leave out --unplaced")
        places, forces = (np.stack([columns[name] for name in names], axis=1) for names in (STREAM[1:4], STREAM[4:]))
        sign = -1.0 if args.negate else 1.0
        return found_in(Stream(str(args.csv), columns["time"], places, sign * forces), organ, args.radius)
    presses = presses_of(columns, args.radius, args.csv)
    placed = not args.unplaced and all(press.is_placed for press in presses)
    return Measurement(str(args.csv), args.radius, presses, [], [], placed)


def _from_bag(args: argparse.Namespace, organ: Organ) -> Measurement:
    """Return what is found in a bag."""
    from tissue_sim.ros.bags.tool_streams import in_organ_axes, in_pose_axes, recorded_tool, topics_of

    if args.unplaced:
        raise UserError("--unplaced is for --csv: presses of a bag are found by their places")
    path = Path(args.bag)
    if (args.pose_topic is None) != (args.wrench_topic is None):
        raise UserError("--pose-topic and --wrench-topic go together")
    stream = (
        recorded_tool(path, args.tool)
        if args.pose_topic is None
        else topics_of(path, args.pose_topic, args.wrench_topic)
    )
    radius = args.radius or stream.radius
    if radius is None:
        raise UserError("a bag with topics of your own needs --radius METRES, the tool's")
    if args.wrench_axes == "tool":
        stream = in_pose_axes(stream)
    if args.organ_pose is not None:
        stream = in_organ_axes(stream, args.organ_pose)
    sign = -1.0 if args.negate else 1.0
    return found_in(Stream(str(path), stream.time, stream.positions, sign * stream.forces), organ, radius)
