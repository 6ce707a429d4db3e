"""`tissue_sim replay`: run a recorded bag again, tick by tick and without DDS, and compare."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags.against import align
from tissue_sim.ros.bags.comparing import Comparison, compare
from tissue_sim.ros.bags.differing import Described, differences
from tissue_sim.ros.bags.junit import NOTHING, write_junit
from tissue_sim.ros.bags.player import Replayed, replay
from tissue_sim.ros.bags.plotting import picture_path, write_picture
from tissue_sim.ros.bags.recording import Recording


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("bag", metavar="BAG", help="folder of a recorded bag")
    parser.add_argument("--organ", metavar="ORGAN", help="replay with this organ instead of the recorded one")
    parser.add_argument(
        "--against",
        metavar="BAG2",
        help="compare with what another recording of the same inputs shows, at the same ticks after the same pose",
    )
    parser.add_argument("--force-tolerance", type=float, default=1e-6, help="largest deviation of a wrench, N and N m")
    parser.add_argument("--position-tolerance", type=float, default=1e-6, help="largest deviation of a position, m")
    parser.add_argument("--junit", metavar="FILE", help="write the result as JUnit XML, a test case for each quantity")
    parser.add_argument(
        "--plot",
        metavar="FILE|FOLDER",
        help="write a picture (.png): each tool's force, and how far force and position are off, over time",
    )


def run(args: argparse.Namespace) -> int:
    """Replay a bag; returns 0 when it repeats within the tolerances, else 1."""
    started, path = time.monotonic(), Path(args.bag)
    picture = picture_path(args.plot, path) if args.plot else None
    recording = Recording.read(path)
    organ = Organ.load(args.organ) if args.organ else None
    recorded = Described.recorded(recording.config)
    notes = differences(recorded, recorded.replayed(organ))
    wanted = recording.shown()
    if args.against:
        other = Recording.read(Path(args.against))
        notes += differences(
            Described.recorded(recording.config, f"in {args.bag}"),
            Described.recorded(other.config, f"in {args.against}"),
        )
        alignment = align(recording, other)
        notes.append(alignment.line())
        wanted = other.shown().later(-alignment.later)
    for note in notes:
        print(note, flush=True)
    replayed = replay(recording, organ, wanted)
    found = compare(replayed.wanted, replayed.shown, args.force_tolerance, args.position_tolerance)
    rate = float(recording.config["parameters"]["rate"])
    print("\n".join(told(args.bag, replayed, found, rate)))
    if args.junit:
        write_junit(Path(args.junit), args.bag, found, time.monotonic() - started, notes)
    if picture is not None:
        write_picture(picture, args.bag, rate, replayed.wanted, replayed.shown, found)
        print(f"{picture}: picture")
    return 0 if found.passes else 1


def told(name: str, replayed: Replayed, found: Comparison, rate: float) -> list[str]:
    """The lines that tell what came of it; rate: ticks a second."""
    lines = [
        f"{name}: {replayed.ticks} ticks, {replayed.inputs} inputs, {replayed.contact_sets} contact sets;"
        f" compared {found.wrenches} wrenches and {found.surfaces} surfaces"
    ]
    if found.holds_nothing:
        return [*lines, f"FAILED: {NOTHING}; record for longer than a second, with tools moving"]
    lines.append(f"largest deviation: {', '.join(map(str, found.quantities))}")
    if found.passes:
        return [*lines, "repeats"]
    first = found.first_beyond
    what = ", ".join(f"{one.what} {one.tolerance:g} {one.unit}" for one in found.quantities if one.first_beyond >= 0)
    return [*lines, f"FAILED: beyond {what}, from tick {first} on ({first / rate:.3f} s)"]
