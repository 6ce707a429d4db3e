"""`tissue_sim bench presses`: whether fast, late and jumping tools are resisted to the end.

Each press ends at the place of one that was made slowly, and the force that the hand feels there is held against that
one's. The node runs in real time, and poses come over DDS: beside a busy program the benchmark asks what a busy machine
does to a hand. A press whose force is missing is held until the node has counted HELD_TICKS more ticks: what is missing
only because the loop got no time is not lost.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_file, shipped_organ

if TYPE_CHECKING:
    from tissue_sim.ros.probes.press_probe import PressProbe

ORGANS = "kidney", "kidney_tumour", "scenes/abdomen/liver"
OUT = 0.004  # m outside, where presses begin
DEEPEST, RADII = 0.012, 2.4  # m, and multiple of a tool's radius: depth of a press
SLOW = 0.02  # m/s, of the press with which others are compared
MOTIONS = (  # m/s and Hz
    *product((0.05, 0.2, 0.8), (100.0, 500.0)),
    *product((2.0, 5.0), (30.0, 500.0, 1000.0)),
)
JUMPS = 0.001, 0.002, 0.005, 0.010, 0.020, 0.050  # m, in a single message
JUMP_RATE = 500.0  # Hz
BEFORE, HELD = 0.05, 0.3  # s at the start of a press, and at its end until the force is read
CLEAR_OF_CLAMP = 0.01  # m
LEAST_FORCE = 0.02  # N, of the slow press: a place that hardly resists says nothing
AGREEING, SLOW_TRIES = 0.02, 5  # fraction by which two slow presses may differ, and presses until two agree
LOST = 0.3  # fraction of the slow press's force, below which a press is lost
HELD_TICKS = 300  # of the node, after which a press that seems lost is looked at again
MOST_OFF = 5.0  # %


class Form(NamedTuple):
    """Tool: the node's parameters for it, its radius m, and the distance of its foremost point from its origin, m."""

    name: str
    parameters: tuple[str, ...]
    radius: float
    ahead: float

    @property
    def depth(self) -> float:
        """Depth of a press, m."""
        return min(DEEPEST, RADII * self.radius)


def forms() -> list[Form]:
    """Return the tools that press: spheres, a capsule, a gripper with closed jaws, and a mesh."""
    spheres = [
        Form(f"sphere, {1e3 * radius:g} mm", (f"left.radius:={radius}",), radius, radius)
        for radius in (0.001, 0.002, 0.005, 0.010)
    ]
    mesh = f"left.mesh:={shipped_file('config/jaws/flat.obj')}"
    return [
        *spheres,
        Form("capsule, 3 mm", ("left.shape:=capsule", "left.radius:=0.003", "left.length:=0.05"), 0.003, 0.003),
        Form("gripper, 3 mm", ("left.shape:=gripper", "left.radius:=0.003", "left.length:=0.02"), 0.003, 0.003),
        Form("mesh, 16 mm wide", ("left.shape:=mesh", mesh), 0.003, 0.0),
    ]


class Place(NamedTuple):
    """Contact point (3,) m anywhere on an organ's surface, and the inward unit normal (3,) there."""

    point: Floats
    direction: Floats

    def pose(self, form: Form, depth: float) -> Floats:
        """Return the pose (7,) of a tool whose foremost point is `depth` m deep; its shaft points outwards."""
        turn, _ = Rotation.align_vectors([self.direction], [[0.0, 0.0, 1.0]])
        return np.concatenate([self.point + (depth - form.ahead) * self.direction, turn.as_quat()])


def locations_on(organ: Organ, count: int) -> list[Place]:
    """Draw places evenly from the area of a surface, clear of its clamp."""
    corners, rng = organ.surface_positions[organ.surface_triangles], np.random.default_rng(5)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1)
    held = organ.surface_positions[organ.fixed]
    found: list[Place] = []
    while len(found) < count:
        triangle = int(rng.choice(len(size), p=size / size.sum()))
        point = rng.dirichlet(np.ones(3)) @ corners[triangle]
        if not len(held) or np.linalg.norm(held - point, axis=1).min() > CLEAR_OF_CLAMP:
            found.append(Place(point, -cross[triangle] / size[triangle]))
    return found


class Motion(NamedTuple):
    """Motion of a press: speed in m/s, pose rate in Hz, and the jump in m of a single message, 0 for none.

    Where there is a jump, the speed does not count.
    """

    speed: float
    rate: float
    jump: float = 0.0

    @property
    def name(self) -> str:
        """Name in tables."""
        return f"jump of {1e3 * self.jump:g} mm" if self.jump else f"{self.speed:g} m/s, {self.rate:g} Hz"

    def depths(self, depth: float) -> Iterator[float]:
        """Yield the depths, m, of poses 1 / rate s apart: a pause outside, the descent to `depth`, and the hold."""
        before, held = round(BEFORE * self.rate), round(HELD * self.rate)
        if self.jump:
            start = depth - self.jump
            # Where the jump begins inside, the tool comes there slowly.
            steps = max(0, round((start + OUT) / SLOW * self.rate))
            yield from np.linspace(min(start, -OUT), start, steps + before)
        else:
            steps = int(np.ceil((depth + OUT) / self.speed * self.rate))
            yield from [-OUT] * before
            yield from np.linspace(-OUT, depth, steps + 1)[1:-1]
        yield from [depth] * (held + 1)


SLOWLY = Motion(SLOW, 500.0)


def motions() -> list[Motion]:
    """Return all motions that are tried."""
    return [*(Motion(*one) for one in MOTIONS), *(Motion(0.0, JUMP_RATE, jump) for jump in JUMPS)]


class Pressed(NamedTuple):
    """Results of one press: its motion, final forces of the slow one and this one, (3,) N, and the longest gap, s.

    Of one that failed also the tool's state then.
    """

    organ: str
    form: str
    motion: str
    slow: Floats
    force: Floats
    gap: float = 0.0
    state: str = ""

    @property
    def is_lost(self) -> bool:
        """Whether the press failed: its force is nearly zero, unlike that of the slow press."""
        return bool(np.linalg.norm(self.force) < LOST * np.linalg.norm(self.slow))

    @property
    def off(self) -> float:
        """Difference from the slow press, % of that."""
        return float(100.0 * np.linalg.norm(self.force - self.slow) / np.linalg.norm(self.slow))


# measuring -----------------------------------------------------------------------------------------


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, organ="three organs of this package", check=True)
    parser.add_argument(
        "--places", type=int, default=3, help="number of points on each organ, for each tool (default: 3)"
    )
    parser.add_argument("--friction", type=float, metavar="MU", help="friction of the tools (default: the node's)")


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    if not 1 <= args.places <= 1000:
        raise UserError(f"--places {args.places} is outside 1..1000")
    files = [args.organ] if args.organ else [str(organ_file(name)) for name in ORGANS]
    found = as_json(measure(files, args.places, args.friction))
    return Result(found, text(found))


def organ_file(name: str) -> Path | None:
    """Return the path of one of ORGANS."""
    return shipped_file(f"config/{name}.npz") if "/" in name else shipped_organ(name)


def measure(files: Sequence[str], n_places: int, friction: float | None = None) -> list[Pressed]:
    """Press with every tool at some places of every organ. Raises UserError when rclpy or the node is missing."""
    from tissue_sim.ros.probes.press_probe import pressing

    found: list[Pressed] = []
    each = list(product(files, forms()))
    with rows.until_stopped(), progress.task("presses", len(each) * n_places * (len(motions()) + 2)) as under_way:
        for file, form in each:
            organ = Organ.load(file)
            settings = (*form.parameters, *([] if friction is None else [f"friction:={friction}"]))
            with pressing(file, organ, settings) as presser, progress.still():
                for number, place in enumerate(locations_on(organ, n_places)):
                    pressed = at_place(presser, form, place, motions(), under_way, organ.name)
                    found += pressed
                    if pressed:
                        lost = sum(one.is_lost for one in pressed)
                        name = f"{organ.name}, {form.name}, place {number + 1}"
                        rows.report(name, f"{len(pressed)} presses", f"{lost} failed")
    return found


def at_place(
    presser: PressProbe, form: Form, place: Place, tried: Sequence[Motion], under_way: progress.Task, organ: str = ""
) -> list[Pressed]:
    """Press slowly, and by each motion; nothing where a slow press meets hardly any force.

    under_way: counts presses.
    """

    def force_of(motion: Motion) -> Floats:
        under_way.advance()
        poses = (place.pose(form, depth) for depth in motion.depths(form.depth))
        return np.asarray(presser.press(poses, motion.rate))

    slow = reference(lambda: force_of(SLOWLY))
    if np.linalg.norm(slow) < LEAST_FORCE:
        slow = np.asarray(presser.hold_on(HELD_TICKS))
    if np.linalg.norm(slow) < LEAST_FORCE:
        under_way.advance(len(tried))
        return []

    found = []
    for motion in tried:
        one = Pressed(organ, form.name, motion.name, slow, force_of(motion), presser.gap)
        if one.is_lost:
            one = one._replace(force=np.asarray(presser.hold_on(HELD_TICKS)), state=presser.state)
        found.append(one)
    return found


def reference(slow_press: Callable[[], Floats]) -> Floats:
    """Return the force (3,) N of a slow press that a second one repeats.

    Where poses reach the node late by more than its stale time, as on a busy machine, the tool is released in the
    middle of a press, and presses on with half of the force: such a press is no reference.
    """
    found = [slow_press()]
    while len(found) < SLOW_TRIES:
        found.append(slow_press())
        for one in found[:-1]:
            if np.linalg.norm(found[-1] - one) <= AGREEING * np.linalg.norm(one):
                return one
    return found[-1]


# reporting -----------------------------------------------------------------------------------------


def as_json(pressed: Sequence[Pressed]) -> JsonObject:
    """Return the figures of all presses, and by organ, tool and motion. Raises UserError when there are none."""
    if not pressed:
        raise UserError(f"no point of the organs resists a slow press with {LEAST_FORCE:g} N; try other ORGANs")
    total = figures(pressed)
    bounds = [
        Bound("failed presses", float(total["lost"]), 0.0, ""),
        Bound("force 0.3 s later, difference from the slow press, median", total["median_off_percent"], MOST_OFF, "%"),
    ]
    return {
        "all": total,
        "organs": _by(pressed, "organ"),
        "tools": _by(pressed, "form"),
        "motions": _by(pressed, "motion"),
        "lost": [
            one._asdict() | {"slow": one.slow.tolist(), "force": one.force.tolist()} for one in pressed if one.is_lost
        ],
        "bounds": [bound.as_json() for bound in bounds],
    }


def _by(pressed: Sequence[Pressed], field: str) -> dict[str, dict[str, float]]:
    names = dict.fromkeys(getattr(one, field) for one in pressed)
    return {name: figures([one for one in pressed if getattr(one, field) == name]) for name in names}


def figures(pressed: Sequence[Pressed]) -> dict[str, float]:
    """Return the number of presses, how many were lost, and the deviations of the others from slow presses, %."""
    off = [one.off for one in pressed if not one.is_lost] or [float("nan")]
    median, most, worst = np.percentile(off, [50.0, 95.0, 100.0])
    return {
        "presses": len(pressed),
        "lost": sum(one.is_lost for one in pressed),
        "within_percent": 100.0 * float(np.mean(np.array(off) <= MOST_OFF)),
        "median_off_percent": float(median),
        "p95_off_percent": float(most),
        "worst_off_percent": float(worst),
    }


def text(found: JsonObject) -> str:
    """Return the figures as tables."""
    table = [["", "presses", "failed", f"within {MOST_OFF:g} %", "median difference", "p95", "worst"]]
    for name, one in (("all", found["all"]), *found["organs"].items(), *found["tools"].items()):
        table.append(_row(name, one))
    table += [_row(name, one) for name, one in found["motions"].items()]
    lines = [
        f"force {HELD:g} s after a press, compared with a press at {SLOW:g} m/s to the same position",
        "",
        *aligned(table),
        "",
        *(
            f"failed: {one['organ']}, {one['form']}, {one['motion']}: {np.linalg.norm(one['force']):.3f} N instead"
            f" of {np.linalg.norm(one['slow']):.3f} N; longest between two poses {1e3 * one['gap']:.0f} ms,"
            f" the tool's state is {one['state'] or 'unknown'}"
            for one in found["lost"]
        ),
        *bound_lines(found["bounds"]),
    ]
    return "\n".join(lines)


def _row(name: str, one: dict[str, float]) -> list[str]:
    percents = [f"{one[key]:.1f} %" for key in ("median_off_percent", "p95_off_percent", "worst_off_percent")]
    return [name, f"{one['presses']:.0f}", f"{one['lost']:.0f}", f"{one['within_percent']:.0f} %", *percents]
