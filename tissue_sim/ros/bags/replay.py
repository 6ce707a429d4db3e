"""`tissue_sim replay`: run a recorded bag again, tick by tick and without DDS, and compare."""

from __future__ import annotations

import argparse
from pathlib import Path

from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags.player import replay
from tissue_sim.ros.bags.recording import Recording


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("bag", metavar="BAG", help="folder of a recorded bag")
    parser.add_argument("--organ", metavar="ORGAN", help="replay with this organ instead of the recorded one")
    parser.add_argument("--force-tolerance", type=float, default=1e-6, help="largest deviation of a wrench, N and N m")
    parser.add_argument("--position-tolerance", type=float, default=1e-6, help="largest deviation of a position, m")


def run(args: argparse.Namespace) -> int:
    """Replay a bag; returns 0 when it repeats within the tolerances, else 1."""
    recording = Recording.read(Path(args.bag))
    result = replay(recording, Organ.load(args.organ) if args.organ else None)
    print(
        f"{args.bag}: {result.ticks} ticks, {result.inputs} inputs, {result.contact_sets} contact sets;"
        f" compared {result.wrenches} wrenches and {result.surfaces} surfaces"
    )
    found = (
        ("force", result.force, "N", result.force_tick),
        ("torque", result.torque, "N m", result.torque_tick),
        ("position", result.position, "m", result.position_tick),
    )
    told = (f"{what} {most:.3g} {unit}{f' (tick {tick})' if most else ''}" for what, most, unit, tick in found)
    print(f"largest deviation: {', '.join(told)}")
    if result.wrenches == 0 and result.surfaces == 0:
        print("FAILED: the bag holds nothing to compare; record for longer than a second, with tools moving")
        return 1
    within = max(result.force, result.torque) <= args.force_tolerance and result.position <= args.position_tolerance
    print("repeats" if within else f"FAILED: beyond {args.force_tolerance:g} N or {args.position_tolerance:g} m")
    return 0 if within else 1
