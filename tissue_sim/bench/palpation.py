"""Benchmark `tissue_sim bench palpation`: a finger over a tumour; force against depth beside finite elements.

A rigid sphere is pressed in over each inclusion, and doesn't slip; so are neo-Hookean finite elements of the same
shape, with the inclusion and without. Then it is pressed in at every node around: the map of stiffness that a finger
would feel.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim import progress
from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared, check_shared
from tissue_sim.bench.printing import Bound, aligned, bound_lines, emit, exit_code, told
from tissue_sim.calibration.cases import CLEARANCE, Surface, surface_of
from tissue_sim.calibration.squeeze import squeezed, touchable
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError
from tissue_sim.organ.inclusions import Inclusion, inclusions_of, with_inclusions
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

DEFAULT = "kidney_tumour"
FINGER = 0.007  # m, radius
DEPTHS = np.array([0.001, 0.002, 0.003, 0.004])  # m
MAP_DEPTH = 0.003  # m
AROUND = 0.025  # m from the place over the inclusion, to which the map extends
UNDER = 0.009  # m from there, where the finger may touch
CLEAR = 0.002  # m between finger and organ at the start
SPEED = 0.002  # m/s: so slow that an organ with a mode at 1 Hz doesn't oscillate, and sticks where one at rest would
HOLDING, LONGEST = 0.2, 5.0  # s between two checks of the force at a depth, and at most
STILL = 1e-3  # relative change of the force since the last check
STEPS = 2  # of the finite elements for each depth
FRICTION = 10.0  # so high that nothing slips
MOST_OFF = 5.0  # %


class Press(NamedTuple):
    """Press of a finger.

    Attributes
    ----------
    node : int
        Surface node.
    place : Floats, shape (3,), m
        Centre of the finger where it touches.
    way : Floats, shape (3,)
        Inward unit direction.
    """

    node: int
    place: Floats  # (3,) m, of the finger's middle where it touches
    way: Floats  # (3,) inwards

    def at(self, deep: float) -> Floats:
        """Return the finger's centre at a depth, m."""
        return self.place + deep * self.way


class Felt(NamedTuple):
    """Force against depth over an inclusion."""

    inclusion: Inclusion
    press: Press
    ours: Floats  # (d,) N, along the way
    reference: Floats  # (d,) N, of finite elements; nan where they did not settle
    plain: Floats  # (d,) N, of these without the inclusion

    @property
    def off(self) -> Floats:
        """Difference from the finite elements at each depth, %."""
        return np.asarray(100.0 * np.abs(self.ours / self.reference - 1.0))

    @property
    def told_apart(self) -> Floats:
        """Relative increase of the finite elements' force by the inclusion at each depth, %."""
        return np.asarray(100.0 * (self.reference / self.plain - 1.0))


class Map(NamedTuple):
    """Stiffness that a finger feels around an inclusion."""

    nodes: Longs  # (k,)
    stiffness: Floats  # (k,) N/m


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(
        parser, organ="the kidney with a tumour that ships", out="folder for a plot of curves and map", check=True
    )
    places = parser.add_argument_group(
        "balls at nodes, on edges and inside triangles, and sliding, in place of a finger"
    )
    places.add_argument(
        "--places",
        type=int,
        metavar="N",
        help="press balls at so many flat places of ORGAN, which needs no inclusion (default: the kidney that ships)",
    )
    places.add_argument(
        "--radii", metavar="R,...", help="of the balls, in mean edges of the surface (default: 0.5,0.8,1,1.5,2,3)"
    )
    places.add_argument(
        "--slab",
        action="store_true",
        help="press a slab of 60 x 60 x 25 mm, which is built and calibrated, once, in four minutes",
    )


def run(args: argparse.Namespace) -> int:
    """Press, compare and print; return 0, or with --check 1 when a bound is missed."""
    check_shared(args)
    if args.places is not None:
        from tissue_sim.bench import palpation_places

        return palpation_places.run(args)
    if args.radii is not None or args.slab:
        raise UserError("--radii and --slab belong to --places N")
    organ = Organ.load(args.organ or shipped_organ(DEFAULT))
    felt = measure(organ)
    maps = measure_maps(organ, felt)
    found = as_json(felt, maps)
    emit(found, text(organ, found), args.json)
    if args.out and not rows.stopped():
        from tissue_sim.bench.palpation_plot import write_plots

        told(write_plots(organ, felt, maps, args.out))
    return exit_code(found, check=args.check)


# measuring -----------------------------------------------------------------------------------------


def measure(organ: Organ) -> list[Felt]:
    """Return a curve for each inclusion. Raises UserError for an organ without any, and as Body does."""
    inclusions = inclusions_of(organ)
    if not inclusions:
        raise UserError(f"organ '{organ.name}' has no inclusion; build it with --mask and --inclusion")
    found = []
    with rows.until_stopped():
        for inclusion in rows.each(inclusions, "inclusions"):
            press = over(organ, inclusion)
            scene = finger(organ)
            reference, plain = (by_elements(one, press) for one in (organ, with_inclusions(organ, [])))
            found.append(Felt(inclusion, press, forces(scene, press, DEPTHS), reference, plain))
            rows.tell(f"node {press.node}", f"off {found[-1].off.max():.2f} % at worst")
    return found


def measure_maps(organ: Organ, felt: Sequence[Felt]) -> list[Map]:
    """Return a map around each place; an empty one for those that Ctrl-C left out."""
    found: list[Map] = []
    with rows.until_stopped():
        for one in rows.each(felt, "maps"):
            found.append(mapped(organ, one.press))
            rows.tell(f"map around node {one.press.node}", f"{len(found[-1].nodes)} places")
    return found + [Map(np.zeros(0, dtype=np.int64), np.zeros(0))] * (len(felt) - len(found))


def press_at(surface: Surface, node: int) -> Press:
    """Return the press at a surface node, along the normal there."""
    normal = surface.normal[node]
    return Press(node, surface.positions[node] + FINGER * normal, -normal)


def over(organ: Organ, inclusion: Inclusion) -> Press:
    """Return the press at the free surface node nearest to an inclusion's centre."""
    apart = np.linalg.norm(organ.surface_positions - inclusion.positions.mean(axis=0), axis=1)
    apart[organ.fixed] = np.inf
    return press_at(surface_of(organ), int(apart.argmin()))


def finger(organ: Organ) -> Scene:
    """Return the organ and a finger that doesn't slip."""
    scene = Scene(organ, [Tool("finger", radius=FINGER)], ticks_a_set=4)
    scene.simulation.settings.friction = FRICTION
    return scene


def forces(scene: Scene, press: Press, depths: Floats) -> Floats:
    """Return the force on the finger that is held at each of several depths.

    Parameters
    ----------
    scene : Scene
        Organ and finger.
    press : Press
        Where it presses.
    depths : Floats, shape (d,), m
        Depths.

    Returns
    -------
    Floats, shape (d,), N
        Force against the direction of the press.
    """
    scene.reset()
    tick, deep, found = scene.simulation.settings.tick_time, -CLEAR, []
    for depth in depths:
        ticks = max(1, round((depth - deep) / (SPEED * tick)))
        for place in np.linspace(deep, depth, ticks + 1)[1:]:
            scene.move(0, press.at(float(place)))
            scene.step()
        deep = float(depth)
        found.append(held(scene, press, deep))
    return np.array(found)


def held(scene: Scene, press: Press, deep: float) -> float:
    """Return the force, N, on a finger that stays at a depth, m, until it is constant, which may take seconds."""
    tick, force = scene.simulation.settings.tick_time, np.inf
    for _ in range(round(LONGEST / HOLDING)):
        for _ in range(round(HOLDING / tick)):
            scene.move(0, press.at(deep))
            scene.step()
        before, force = force, -float(scene.wrenches[0, :3] @ press.way)
        if abs(force - before) <= STILL * abs(force):
            break
    return force


def by_elements(organ: Organ, press: Press) -> Floats:
    """Return the same force (d,) N of finite elements, touched at all of their nodes; nan where they don't settle."""
    touched = np.linalg.norm(organ.surface_positions - organ.surface_positions[press.node], axis=1) < UNDER
    solid, nodes = touchable(organ, touched)
    starts = np.concatenate([[0.0], DEPTHS[:-1]])
    shares = (np.arange(STEPS) + 1.0) / STEPS
    deep = (starts[:, None] + np.outer(DEPTHS - starts, shares)).ravel()
    steps = squeezed(solid, nodes, np.array([[press.at(depth)] for depth in deep]), FINGER)
    found = np.full(len(deep), np.nan)
    for number, step in enumerate(steps):
        if step.settled:
            found[number] = step.forces[0] @ press.way
    return found[STEPS - 1 :: STEPS]


def mapped(organ: Organ, press: Press) -> Map:
    """Return the stiffness at every node around a place that the finger can press and that isn't near the clamp."""
    surface, scene = surface_of(organ), finger(organ)
    near = np.linalg.norm(surface.positions - surface.positions[press.node], axis=1) < AROUND
    near &= surface.normal @ surface.normal[press.node] > 0.5
    if len(organ.fixed):
        near &= cKDTree(surface.positions[organ.fixed]).query(surface.positions)[0] > CLEARANCE
    nodes = np.flatnonzero(near)
    depth = np.array([MAP_DEPTH])
    felt = [
        forces(scene, press_at(surface, int(node)), depth)[0] / MAP_DEPTH for node in progress.steps(nodes, "places")
    ]
    return Map(nodes, np.array(felt))


# telling -------------------------------------------------------------------------------------------


def as_json(felt: Sequence[Felt], maps: Sequence[Map]) -> dict[str, Any]:
    """Return all figures and bounds: of each curve the error, and how clearly the inclusion is discernible."""
    table, bounds = [], []
    for number, (one, around) in enumerate(zip(felt, maps, strict=True)):
        settled = bool(np.isfinite(one.reference).all() and np.isfinite(one.plain).all())
        off = float(one.off.max()) if settled else None
        apart = float(one.told_apart[-1]) if settled else None
        name = f"inclusion {number}: " if len(felt) > 1 else ""
        bounds += [
            Bound(f"{name}force against finite elements, worst depth", off, MOST_OFF, "%"),
            Bound(f"{name}stiffer for its inclusion, over that error", apart and off and apart / off, 1.0, "", True),
        ]
        table.append(
            {
                "times_as_stiff": one.inclusion.stiffness,
                "node": one.press.node,
                "depth_m": DEPTHS.tolist(),
                "force_n": one.ours.tolist(),
                "reference_n": one.reference.tolist(),
                "plain_reference_n": one.plain.tolist(),
                "off_percent": one.off.tolist(),
                "told_apart_percent": one.told_apart.tolist(),
                "map": {
                    "nodes": around.nodes.tolist(),
                    "stiffness_n_per_m": around.stiffness.tolist(),
                },
            }
        )
    return {"finger_m": FINGER, "inclusions": table, "bounds": [one.as_json() for one in bounds]}


def text(organ: Organ, found: dict[str, Any]) -> str:
    """Return the figures as tables."""
    lines = [f"organ '{organ.name}': a finger of {1e3 * found['finger_m']:g} mm, held, that doesn't slip"]
    for row in found["inclusions"]:
        table = [["deep mm", "force N", "finite elements N", "off %", "without the inclusion N", "it tells by %"]]
        keys = ("depth_m", "force_n", "reference_n", "off_percent", "plain_reference_n", "told_apart_percent")
        for depth, force, reference, off, plain, apart in zip(*(row[key] for key in keys), strict=True):
            numbers = [f"{force:.3f}", f"{reference:.3f}", f"{off:.2f}", f"{plain:.3f}", f"{apart:.1f}"]
            table.append([f"{1e3 * depth:g}", *numbers])
        stiffness = np.array(row["map"]["stiffness_n_per_m"])
        here = stiffness[row["map"]["nodes"].index(row["node"])] if row["node"] in row["map"]["nodes"] else np.nan
        lines += [
            "",
            f"over the inclusion that is {row['times_as_stiff']:g} times as stiff, node {row['node']}:",
            *aligned(table),
        ]
        if len(stiffness):
            lines.append(
                f"map of {len(stiffness)} places around, {1e3 * MAP_DEPTH:g} mm deep: {stiffness.min():.0f} to"
                f" {stiffness.max():.0f} N/m, median {np.median(stiffness):.0f}, over the inclusion {here:.0f}"
            )
    return "\n".join([*lines, "", *bound_lines(found["bounds"])])
