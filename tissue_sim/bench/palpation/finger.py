"""A finger that feels for a tumour: force against depth beside finite elements, and a map of stiffness around."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim import progress
from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench import rows
from tissue_sim.bench.printing import Bound, aligned, bound_lines
from tissue_sim.calibration.cases import CLEARANCE, Surface, surface_of
from tissue_sim.calibration.sphere_compression import compressed, touchable
from tissue_sim.contact.scene import Scene
from tissue_sim.identification.pressing import FRICTION, Press, ball, forces
from tissue_sim.json_types import JsonObject
from tissue_sim.organ.inclusions import Inclusion, existing_inclusions, with_inclusions
from tissue_sim.organ.organ import Organ

FINGER = 0.007  # m, radius
DEPTHS = np.array([0.001, 0.002, 0.003, 0.004])  # m
MAP_DEPTH = 0.003  # m
AROUND = 0.025  # m from the place over the inclusion, that the map reaches
UNDER = 0.009  # m from there, where the finger may touch
STEPS = 2  # of the finite elements for each depth
MOST_OFF = 5.0  # %


class PressForces(NamedTuple):
    """Force against depth over an inclusion."""

    inclusion: Inclusion
    press: Press
    ours: Floats  # (d,) N, along its direction
    reference: Floats  # (d,) N, of finite elements; nan where they did not settle
    plain: Floats  # (d,) N, of these without the inclusion

    @property
    def off(self) -> Floats:
        """Difference from the finite elements at each depth, %."""
        return np.asarray(100.0 * np.abs(self.ours / self.reference - 1.0))

    @property
    def inclusion_effect(self) -> Floats:
        """Relative increase of the finite elements' force by the inclusion at each depth, %."""
        return np.asarray(100.0 * (self.reference / self.plain - 1.0))


class Map(NamedTuple):
    """Stiffness that a finger feels around an inclusion."""

    nodes: Longs  # (k,)
    stiffness: Floats  # (k,) N/m


def measure(organ: Organ) -> list[PressForces]:
    """Return a curve for each inclusion. Raises UserError for an organ without any, and as Body does."""
    inclusions = existing_inclusions(organ)
    found = []
    with rows.until_stopped():
        for inclusion in rows.each(inclusions, "inclusions"):
            press = over(organ, inclusion)
            scene = finger(organ)
            reference, plain = (by_elements(one, press) for one in (organ, with_inclusions(organ, [])))
            found.append(PressForces(inclusion, press, forces(scene, press, DEPTHS), reference, plain))
            rows.report(f"node {press.node}", f"error at most {found[-1].off.max():.2f} %")
    return found


def measure_maps(organ: Organ, pressed: Sequence[PressForces]) -> list[Map]:
    """Return a map around each place; an empty one for those that Ctrl-C left out."""
    found: list[Map] = []
    with rows.until_stopped():
        for one in rows.each(pressed, "maps"):
            found.append(mapped(organ, one.press))
            rows.report(f"map around node {one.press.node}", f"{len(found[-1].nodes)} points")
    return found + [Map(np.zeros(0, dtype=np.int64), np.zeros(0))] * (len(pressed) - len(found))


def press_at(surface: Surface, node: int) -> Press:
    """Return the press at a surface node, along the normal there."""
    normal = surface.normal[node]
    return Press(surface.positions[node] + FINGER * normal, -normal, node)


def over(organ: Organ, inclusion: Inclusion) -> Press:
    """Return the press at the free surface node nearest to an inclusion's centre."""
    apart = np.linalg.norm(organ.surface_positions - inclusion.positions.mean(axis=0), axis=1)
    apart[organ.fixed] = np.inf
    return press_at(surface_of(organ), int(apart.argmin()))


def finger(organ: Organ) -> Scene:
    """Return the organ and a finger that doesn't slip."""
    return ball(organ, FINGER, FRICTION)


def by_elements(organ: Organ, press: Press) -> Floats:
    """Return the same force (d,) N of finite elements, touched at all of their nodes; nan where they don't settle."""
    touched = np.linalg.norm(organ.surface_positions - organ.surface_positions[press.node], axis=1) < UNDER
    solid, nodes = touchable(organ, touched)
    starts = np.concatenate([[0.0], DEPTHS[:-1]])
    fractions = (np.arange(STEPS) + 1.0) / STEPS
    deep = (starts[:, None] + np.outer(DEPTHS - starts, fractions)).ravel()
    steps = compressed(solid, nodes, np.array([[press.at(depth)] for depth in deep]), FINGER)
    found = np.full(len(deep), np.nan)
    for number, step in enumerate(steps):
        if step.settled:
            found[number] = step.forces[0] @ press.direction
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
    pressed = [
        forces(scene, press_at(surface, int(node)), depth)[0] / MAP_DEPTH for node in progress.steps(nodes, "places")
    ]
    return Map(nodes, np.array(pressed))


def as_json(pressed: Sequence[PressForces], maps: Sequence[Map]) -> JsonObject:
    """Return all figures and bounds: of each curve the error, and how clearly the inclusion is discernible."""
    table, bounds = [], []
    for number, (one, around) in enumerate(zip(pressed, maps, strict=True)):
        settled = bool(np.isfinite(one.reference).all() and np.isfinite(one.plain).all())
        off = float(one.off.max()) if settled else None
        apart = float(one.inclusion_effect[-1]) if settled else None
        name = f"inclusion {number}: " if len(pressed) > 1 else ""
        bounds += [
            Bound(f"{name}force against finite elements, worst depth", off, MOST_OFF, "%"),
            Bound(
                f"{name}effect of the inclusion, relative to that error", apart and off and apart / off, 1.0, "", True
            ),
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
                "inclusion_effect_percent": one.inclusion_effect.tolist(),
                "map": {
                    "nodes": around.nodes.tolist(),
                    "stiffness_n_per_m": around.stiffness.tolist(),
                },
            }
        )
    return {"finger_m": FINGER, "inclusions": table, "bounds": [one.as_json() for one in bounds]}


def text(organ: Organ, found: JsonObject) -> str:
    """Return the figures as tables."""
    lines = [f"organ '{organ.name}': a finger of {1e3 * found['finger_m']:g} mm, held, without slip"]
    for row in found["inclusions"]:
        table = [["deep mm", "force N", "finite elements N", "error %", "without the inclusion N", "effect %"]]
        keys = ("depth_m", "force_n", "reference_n", "off_percent", "plain_reference_n", "inclusion_effect_percent")
        for depth, force, reference, off, plain, apart in zip(*(row[key] for key in keys), strict=True):
            numbers = [f"{force:.3f}", f"{reference:.3f}", f"{off:.2f}", f"{plain:.3f}", f"{apart:.1f}"]
            table.append([f"{1e3 * depth:g}", *numbers])
        stiffness = np.array(row["map"]["stiffness_n_per_m"])
        here = stiffness[row["map"]["nodes"].index(row["node"])] if row["node"] in row["map"]["nodes"] else np.nan
        lines += [
            "",
            f"above the inclusion with {row['times_as_stiff']:g} times the stiffness, node {row['node']}:",
            *aligned(table),
        ]
        if len(stiffness):
            lines.append(
                f"map of {len(stiffness)} points around it, {1e3 * MAP_DEPTH:g} mm deep: {stiffness.min():.0f} to"
                f" {stiffness.max():.0f} N/m, median {np.median(stiffness):.0f}, above the inclusion {here:.0f}"
            )
    return "\n".join([*lines, "", *bound_lines(found["bounds"])])
