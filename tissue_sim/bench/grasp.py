"""Benchmark `tissue_sim bench grasp`: the force at which jaws slip from organs, against Coulomb's; creep below it.

The gripper of `config/gripper.yaml` takes hold of the lower pole, lightly, as tissue is squeezed out from between jaws
that close further, and is drawn sideways, along its pads. What the normal forces of the contact points add up to is
subtracted from the force on each jaw, as tissue bulges around the edges of the pads and resists them. What remains is
friction: while the jaws slide, it is the coefficient times the sum of the normal forces, whatever the tissue's shape.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.bench.timing import in_one_thread
from tissue_sim.contact.grasp import COMPRESSED, at_lower_pole
from tissue_sim.contact.pressed_points import pressed_points
from tissue_sim.contact.quaternions import rotate
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_file

ORGANS = {  # that ship, and their files
    "kidney": "config/organs/kidney.npz",
    "kidney_tumour": "config/organs/kidney_tumour.npz",
    "spleen": "config/scenes/abdomen/spleen.npz",
    "kidney_right": "config/scenes/abdomen/kidney_right.npz",
}
FRICTION, LEFT = 0.2, 0.8  # of the jaws; fraction of the pole's width that they leave
HINGE, FLAT = 0.06, "config/jaws/flat.obj"  # m from the tips, and a jaw, as in config/gripper.yaml
SPEED = 0.005  # m/s of the pull
FIRST, SLIDING = 0.008, 0.004  # m of pull until all points slide, and in which forces are measured
HELD, SETTLED = 0.5, 0.5  # of the slip force, at which it is held at least; s until the hold begins
LOOK = 0.1  # s between two looks at what is held
MOST_FORCE = 100.0  # N, beyond all forces here: the clamp of the haptic output must not hide one
MOST_OFF, MOST_CREEP = 5.0, 10.0  # %, um


class Grasped(NamedTuple):
    """Results of one organ; forces in N, summed over both jaws."""

    organ: str
    points: int  # of the tissue that are held
    held: float  # of the slip force, at the end of the hold
    seconds: float  # of the hold
    crept: float  # m by which a point moved in the hold, at most
    friction: float  # while the jaws slide, on average
    normal: float
    off: float  # of Coulomb's force


class Touched(NamedTuple):
    """Points of the tissue that tools touch."""

    entries: Longs  # (k,) of the contact set
    nodes: Longs  # (k, 3) between which they lie
    weights: Floats  # (k, 3)


class Touching:
    """A scene with tools that touch its organ; `scene` is the scene."""

    scene: Scene

    def touched(self) -> Touched:
        """Return the points that are pressed."""
        state = self.scene.simulation.state
        pressed = np.flatnonzero(state.contact_pressed[0, : state.contacts.header.points] > 0.0)
        return Touched(pressed, state.contacts.node[pressed].copy(), state.contacts.weight[pressed].copy())

    def points(self, touched: Touched) -> Floats:
        """Return where those points are now, (k, 3) m."""
        return np.asarray(np.einsum("ij,ijk->ik", touched.weights, self.scene.simulation.positions[touched.nodes]))


class Nip(Touching):
    """A gripper at an organ's lower pole, its jaws closed on either side.

    left: fraction of the width that the closed jaws leave. Raises ValueError where the jaws can't take hold of the
    organ.
    """

    def __init__(self, gripper: Tool, friction: float, organ: Organ, left: float = COMPRESSED) -> None:
        self.grasp = at_lower_pole(organ.surface_positions, organ.surface_triangles, gripper.jaws)
        self.up, self.beside = self.grasp.out, np.array(rotate(tuple(self.grasp.turn.tolist()), (0.0, 1.0, 0.0)))
        # A contact set for every four ticks, as beside the node's loop at 1 kHz.
        self.scene = Scene(organ, [gripper], ticks_a_set=4)
        self.scene.simulation.settings.friction = friction
        self.scene.simulation.settings.force_clamp = MOST_FORCE
        self.at, self.angle = self.grasp.place + 0.06 * self.up, self.grasp.opened
        self.lead(self.grasp.place, self.grasp.opened, 300)
        self.lead(self.grasp.place, gripper.jaws.angle(left * self.grasp.width), 500)

    def lead(self, place: Floats, angle: float, ticks: int) -> None:
        """Move the gripper to a place and open or close it to an angle.

        place (3,) m; angle: rad; ticks: within so many.
        """
        start, began = self.at, self.angle
        for fraction in np.arange(1, ticks + 1) / ticks:
            self.at = (1.0 - fraction) * start + fraction * place
            self.angle = float((1.0 - fraction) * began + fraction * angle)
            self.scene.move(0, self.at, self.grasp.turn, self.angle)
            self.scene.step()

    def draw(self) -> None:
        """Draw the gripper sideways for one tick."""
        self.lead(self.at + SPEED / self.scene.simulation.rate * self.beside, self.angle, 1)

    def forces(self) -> tuple[float, float]:
        """Return the sums over the jaws of friction, and of the normal forces of their contact points, N."""
        simulation = self.scene.simulation
        state = simulation.state
        entries, bodies, _, normals = pressed_points(state, simulation.shapes)
        pressed = state.contact_pressed[0, entries] * simulation.rate * max(int(state.status.substeps), 1)
        friction = 0.0
        for jaw in range(2):
            of_jaw = bodies == jaw
            friction += float(np.linalg.norm(state.wrench[jaw, :3] + pressed[of_jaw] @ normals[of_jaw]))
        return friction, float(pressed.sum())

    def hold(self, seconds: float) -> float:
        """Stand still; return how far a point that is held moves meanwhile, at most, m. seconds: so long, s."""
        rate = self.scene.simulation.rate
        held, crept = self.touched(), 0.0
        before = self.points(held)
        for _ in progress.steps(range(round(seconds / LOOK)), f"holding for {seconds:g} s"):
            self.lead(self.at, self.angle, round(LOOK * rate))
            crept = max(crept, float(np.linalg.norm(self.points(held) - before, axis=1).max()))
        return crept


def gripper() -> Tool:
    """Return the gripper of `config/gripper.yaml`. Raises UserError where its jaws are missing."""
    jaws = shipped_file(FLAT)
    if jaws is None:
        raise UserError(f"the jaws {FLAT} are missing; install tissue_sim again")
    return Tool("left", "gripper", length=HINGE, mesh=str(jaws))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, organ=f"{', '.join(ORGANS)}", check=True)
    parser.add_argument("--hold", type=float, default=60.0, metavar="SECONDS", help="simulated time of each hold, s")


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    if not 0.1 <= args.hold <= 3600.0:
        raise UserError(f"--hold {args.hold:g} is outside 0.1..3600 s")
    organs = [Organ.load(args.organ)] if args.organ else [Organ.load(_file(name)) for name in ORGANS]
    found = as_json(in_one_thread(measure, organs, args.hold))
    return Result(found, text(found))


def measure(organs: Sequence[Organ], seconds: float) -> list[Grasped]:
    """Return the results of organs, held for so many s. Raises UserError for one that can't be grasped."""
    found = []
    with rows.until_stopped():
        for organ in rows.each(organs, "grasps"):
            found.append(grasped(organ, seconds))
            off, crept = f"{100.0 * found[-1].off:+.2f} % of Coulomb's force", f"crept {1e6 * found[-1].crept:.3f} um"
            rows.report(organ.name, f"slips {off}", crept)
    return found


def grasped(organ: Organ, seconds: float, friction: float = FRICTION) -> Grasped:
    """Return the results of one organ.

    seconds: simulated time of the hold, s; friction: coefficient of the jaws (Coulomb's force is always that of
    FRICTION, so that another one is to be seen). Raises UserError where the jaws can't take hold of it.
    """
    with progress.task(f"grasping {organ.name}"):
        try:
            nip = Nip(gripper(), friction, organ, LEFT)
        except ValueError as error:
            raise UserError(f"organ '{organ.name}' can't be grasped: {error}") from None
        rate = nip.scene.simulation.rate
        found, normal = nip.forces()
        for _ in range(round(rate * FIRST / SPEED)):
            if found >= HELD * FRICTION * normal:
                break
            nip.draw()
            found, normal = nip.forces()
        nip.lead(nip.at, nip.angle, round(SETTLED * rate))
    points = len(nip.touched().nodes)
    if points == 0:
        raise UserError(f"organ '{organ.name}' can't be grasped: it evades the jaws")
    crept = nip.hold(seconds)
    found, normal = nip.forces()
    held = found / (FRICTION * normal)
    with progress.task(f"drawing the jaws along {organ.name}"):
        for _ in range(round(rate * FIRST / SPEED)):
            nip.draw()
        forces = []
        for _ in range(round(rate * SLIDING / SPEED)):
            nip.draw()
            forces.append(nip.forces())
        found, normal = np.mean(forces, axis=0).tolist()
    return Grasped(organ.name, points, held, seconds, crept, found, normal, found / (FRICTION * normal) - 1.0)


def as_json(found: Sequence[Grasped]) -> JsonObject:
    """Return all figures, and the bounds on the worst organ."""
    bounds = [
        Bound("slip force against Coulomb's, worst organ", max(100.0 * abs(one.off) for one in found), MOST_OFF, "%"),
        Bound("creep in the hold, worst organ", max(1e6 * one.crept for one in found), MOST_CREEP, "um"),
    ]
    return {
        "friction": FRICTION,
        "organs": [one._asdict() for one in found],
        "bounds": [one.as_json() for one in bounds],
    }


def text(found: JsonObject) -> str:
    """Return the figures as a table, a row for each organ."""
    table = [["organ", "points", "held at", "for s", "crept um", "friction N", "normal N", "slips at"]]
    for one in found["organs"]:
        forces = [f"{one[key]:.3f}" for key in ("friction", "normal")]
        hold = [f"{100.0 * one['held']:.0f} %", f"{one['seconds']:g}", f"{1e6 * one['crept']:.3f}"]
        table.append([one["organ"], str(one["points"]), *hold, *forces, f"{100.0 * one['off']:+.2f} %"])
    line = (
        f"flat jaws at the lower pole, friction {found['friction']:g}: force held, as a part of the force at which they"
        " slip; and the force at which they slip, against Coulomb's"
    )
    return "\n".join([line, *aligned(table), "", *bound_lines(found["bounds"])])


def _file(name: str) -> Path:
    """Return the file of an organ that ships. Raises UserError where it is missing."""
    found = shipped_file(ORGANS[name])
    if found is None:
        raise UserError(f"organ '{name}' is not part of this installation")
    return found
