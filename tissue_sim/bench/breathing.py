"""Benchmark `tissue_sim bench breathing`: an organ whose clamp breathes, against implicit finite elements.

Both are in the frame of the clamp, where the organ feels the frame's acceleration: linear elements step it implicitly
and always; the real-time organ by its tick, and asleep where the acceleration would hardly bend it.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.bench.timing import in_one_thread
from tissue_sim.calibration.dynamics import Forces, Start, Steps, swing
from tissue_sim.calibration.fem import Body
from tissue_sim.contact.attachments import Breathing
from tissue_sim.contact.scene import Scene
from tissue_sim.json_types import JsonObject
from tissue_sim.model.stepping.breathing import inhaled_fraction
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

RATES = (15.0, 30.0, 60.0)  # breaths per minute
DISPLACEMENT = 0.015  # m
DIRECTIONS = {"along z": (0.0, 0.0, 1.0), "along x": (1.0, 0.0, 0.0)}
LOOKS, STEPS = 50, 4  # comparisons per breath; steps of the finite elements between two of them
MOST_OFF = 5.0  # % of the clamp's motion


class Breathed(NamedTuple):
    """Results of one breath; lengths in m, of all surface nodes at all comparisons."""

    rate: float
    way: str
    bent: float  # largest motion of the finite elements relative to their clamp
    off: float  # difference of the real-time organ, root mean square over nodes, at the worst comparison
    most_off: float  # of any node
    asleep: float  # fraction of the ticks


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, check=True)


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    organ = Organ.load(args.organ or shipped_organ())
    found = as_json(in_one_thread(measure, organ))
    return Result(found, text(organ, found))


def measure(
    organ: Organ, rates: Sequence[float] = RATES, directions: Mapping[str, tuple[float, ...]] = DIRECTIONS
) -> list[Breathed]:
    """Return a breath at each rate, in each direction. Raises UserError for an organ that can't be filled."""
    body = Body(organ)
    found = []
    with rows.until_stopped():
        for rate, name in rows.each([(rate, name) for rate in rates for name in directions], "breaths"):
            found.append(_breathed(organ, body, rate, name, np.array(directions[name])))
            rows.report(f"{rate:g} a minute, {name}", f"error at most {1e3 * found[-1].most_off:.3f} mm")
    return found


def _breathed(organ: Organ, body: Body, rate: float, name: str, direction: Floats) -> Breathed:
    period, surface = 60.0 / rate, np.arange(organ.n_surface)
    breathing = Breathing(rate, DISPLACEMENT * direction)
    scene = Scene(organ, [], breathing=breathing, breathes=[1.0])
    simulation = scene.simulation

    def weight(time: float) -> Floats:
        return body.loads(np.zeros((organ.n_surface, 3)), -DISPLACEMENT * inhaled_fraction(time, period)[2] * direction)

    rest = Start(np.zeros_like(body.solid.nodes))
    forces = Forces(float(simulation.model.damping_rate), linear=True, load=weight)
    ticks = round(period * simulation.rate / LOOKS)
    step = ticks / simulation.rate / STEPS
    with progress.task(f"{rate:g} a minute, {name}", STEPS * LOOKS) as under_way:
        elements = swing(body.solid, rest, forces, Steps(LOOKS * STEPS * step, step), surface, under_way.advance)
    bent = off = most_off = 0.0
    for look in range(STEPS, len(elements.time), STEPS):
        for _ in range(ticks):
            scene.step()
        carried = DISPLACEMENT * inhaled_fraction(float(elements.time[look]), period)[0] * direction
        there = simulation.positions[surface] - organ.surface_positions + scene.offsets[0]
        apart = np.linalg.norm(there - (carried + elements.displacement[look]), axis=1)
        bent = max(bent, float(np.linalg.norm(elements.displacement[look], axis=1).max()))
        off, most_off = max(off, float(np.sqrt(np.mean(apart**2)))), max(most_off, float(apart.max()))
    count = simulation.state.count
    return Breathed(rate, name, bent, off, most_off, float(count.asleep_ticks) / float(simulation.state.status.tick))


def as_json(found: Sequence[Breathed]) -> JsonObject:
    """Return all figures, and the bound on the slowest breath."""
    slow = [one for one in found if one.rate == min(row.rate for row in found)]
    worst = 100.0 * max(one.most_off for one in slow) / DISPLACEMENT
    bounds = [
        Bound(f"largest node error at {slow[0].rate:g} a minute, relative to the displacement", worst, MOST_OFF, "%")
    ]
    return {
        "way_m": DISPLACEMENT,
        "breaths": [one._asdict() for one in found],
        "bounds": [one.as_json() for one in bounds],
    }


def text(organ: Organ, found: JsonObject) -> str:
    """Return the figures as a table, a row for each breath."""
    table = [
        ["breaths a minute", "way", "bends mm", "error mm rms", "error mm worst", "of the displacement %", "asleep %"]
    ]
    for one in found["breaths"]:
        lengths = [f"{1e3 * one[key]:.3f}" for key in ("bent", "off", "most_off")]
        fraction = 100.0 * one["most_off"] / found["way_m"]
        table.append([f"{one['rate']:g}", one["way"], *lengths, f"{fraction:.2f}", f"{100.0 * one['asleep']:.0f}"])
    line = (
        f"organ '{organ.name}': its clamp breathes by {1e3 * found['way_m']:g} mm, compared with implicit finite"
        " elements"
    )
    return "\n".join([line, *aligned(table), "", *bound_lines(found["bounds"])])
