"""Result of a bag that was replayed and compared with what it shows itself, or another one shows."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.progress import task
from tissue_sim.ros.bags.bag_alignment import align
from tissue_sim.ros.bags.comparison import Comparison, compare
from tissue_sim.ros.bags.differences import Described, differences
from tissue_sim.ros.bags.player import Replayed, replay
from tissue_sim.ros.bags.recording import Recording

NOTHING = "the bag has nothing to compare"


@dataclass(frozen=True)
class Asked:
    """How bags are to be compared.

    Attributes
    ----------
    force_tolerance : float, N and N m
        Largest deviation of a wrench.
    position_tolerance : float, m
        Largest deviation of a position.
    organ : Organ | None
        Organ to replay with, instead of the recorded one.
    against : Path | None
        Another bag to compare with.
    """

    force_tolerance: float
    position_tolerance: float
    organ: Organ | None = None
    against: Path | None = None


@dataclass(frozen=True)
class Outcome:
    """Result of one bag.

    Attributes
    ----------
    name : str
        Name of the bag.
    rate : float, Hz
        Ticks per second.
    seconds : float, s
        Duration of the comparison.
    notes : tuple[str, ...]
        What differed before anything was compared.
    replayed : Replayed
        What the replay showed.
    comparison : Comparison
        The deviations.
    """

    name: str
    rate: float
    seconds: float
    notes: tuple[str, ...]
    replayed: Replayed
    comparison: Comparison


def replay_bag(path: Path, asked: Asked, prefix: str = "") -> Outcome:
    """Replay a bag and compare; print what differs before that begins.

    path: folder of the bag; asked: how it is to be compared; prefix: begins each printed line. Raises UserError when
    the bag can't be read or replayed.
    """
    started = time.monotonic()
    with task("reading"):
        recording = Recording.read(path)
        recorded = Described.recorded(recording.config)
        notes = differences(recorded, recorded.replayed(asked.organ))
    for tick, pose in recording.registrations[1:]:
        notes.append(f"organ_pose: [{', '.join(f'{value:g}' for value in pose.tolist())}] after tick {tick}")
    wanted = recording.shown()
    if asked.against is not None:
        with task(f"reading {asked.against.name}"):
            other = Recording.read(asked.against)
        notes += differences(
            Described.recorded(recording.config, f"in {path}"), Described.recorded(other.config, f"in {asked.against}")
        )
        with task("aligning"):
            alignment = align(recording, other)
        notes.append(alignment.line())
        wanted = other.shown().later(-alignment.later)
    for note in notes:
        print(f"{prefix}{note}", flush=True)
    replayed = replay(recording, asked.organ, wanted)
    with task("comparing"):
        found = compare(replayed.wanted, replayed.shown, asked.force_tolerance, asked.position_tolerance)
    rate = float(recording.config["parameters"]["rate"])
    return Outcome(str(path), rate, time.monotonic() - started, tuple(notes), replayed, found)


def replay_live(path: Path, asked: Asked, node: str) -> Outcome:
    """Send a bag's inputs to a running node, and compare what it shows with a replay at the same ticks.

    path: folder of the bag; asked: how it is to be compared. Raises UserError when this can't be done with the bag or
    the node.
    """
    try:
        from tissue_sim.ros.bags.live import play_live
    except ModuleNotFoundError as error:
        raise UserError(f"--live needs ROS, and {error.name} is missing: pip install 'tissue_sim[ros]'") from None

    started = time.monotonic()
    with task("reading"):
        recording = Recording.read(path)
    with task("sending its inputs"):
        notes, shown = play_live(recording, node)
    for note in notes:
        print(note, flush=True)
    replayed = replay(recording, asked.organ, shown)
    found = compare(replayed.wanted, replayed.shown, asked.force_tolerance, asked.position_tolerance)
    rate = float(recording.config["parameters"]["rate"])
    return Outcome(f"{path} on /{node}", rate, time.monotonic() - started, tuple(notes), replayed, found)
