"""Organ that relaxes under a tool as the measured one did.

A tool's force relaxes as the tissue does, but for friction and for what relaxes while it goes in. So the model is held
as the recording was, and the organ's numbers are corrected until its force relaxes alike. Then it is pressed at the
recorded speeds, which gives the modulus of tissue that has relaxed.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.identification.fitted_organ import KEY, with_stiffness
from tissue_sim.identification.force_curves import ForceCurves
from tissue_sim.identification.measured import Hold, Measurement
from tissue_sim.identification.places import flat_locations
from tissue_sim.identification.press_curves import Arrays, Remember
from tissue_sim.identification.pressing import Press, ball, lead, moving_forces
from tissue_sim.identification.relaxation import LONG_ENOUGH, Relaxation, term_of
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.organ_file import LAW

CORRECTIONS = 1  # of fraction and time constant
DECAYS = 5.0  # time constants for which the model is held at most
MOST_PRESSES = 4  # that the modulus is corrected by
EVERY = 10  # ticks between two readings of the force
START = -0.002  # m, depth from which the model's tool comes


class Presses(NamedTuple):
    """What an organ was fitted to: presses, the model's elastic forces, and depths (n,) m by which presses shift."""

    measurement: Measurement
    curves: ForceCurves
    offsets: Floats
    factor: float  # on the elastic forces
    friction: float


def relaxing(organ: Organ, relaxation: Relaxation | None, presses: Presses, remember: Remember) -> tuple[Organ, str]:
    """Return an organ whose force in holds relaxes as measured, and a line about it.

    Parameters
    ----------
    organ : Organ
        The fitted organ, elastic.
    relaxation : Relaxation | None
        Relaxation by the holds; None where they show none, which leaves the organ as it is.
    presses : Presses
        What it was fitted to.
    remember : Remember
        Keeps runs of the model by name.
    """
    if relaxation is None:
        return organ, ""
    if not len(organ.cell_nodes):
        return organ, f"relaxation isn't in the organ file: organ '{organ.name}' has no cells; calibrate it first"
    (_, _, most), (_, shortest, longest) = LAW["relaxation_fraction"], LAW["relaxation_time"]
    fraction, time = relaxation.fraction, relaxation.time
    if fraction > most or not shortest <= time <= longest:
        return organ, (
            f"relaxation isn't in the organ file: an organ relaxes by {100.0 * most:g} % at most, with a time constant"
            f" of {shortest:g} to {longest:g} s"
        )
    paths = _paths(organ, presses.measurement)
    hold = max(presses.measurement.holds, key=lambda one: one.length)
    for _ in progress.steps(range(CORRECTIONS), "holds of the model"):
        found = replace(organ, relaxation_fraction=fraction, relaxation_time=time)
        shown = _held(found, hold, presses, paths, remember)
        fraction = float(np.clip(fraction * relaxation.fraction / max(shown.fraction, 1e-3), 1e-3, most))
        time = float(np.clip(time * relaxation.time / shown.time, shortest, longest))
    found = replace(organ, relaxation_fraction=fraction, relaxation_time=time)
    part = _part_of_the_modulus(found, presses, paths, remember)
    soft = with_stiffness(organ, part, organ.provenance.get(KEY, {}))
    found = replace(soft, relaxation_fraction=fraction, relaxation_time=time)
    return found, (
        f"relaxation is in the organ file: {100.0 * fraction:.1f} % of the tissue's first force with a time constant of"
        f" {time:.2f} s; its Young's modulus, {found.youngs_modulus:.0f} Pa, is that"
        f" of tissue that has relaxed, {100.0 * part:.0f} % of what the presses felt"
    )


def _held(organ: Organ, hold: Hold, presses: Presses, paths: list[Press], remember: Remember) -> Relaxation:
    """Return how the model's force relaxes, held as deep as a recording was and reached as fast."""
    row = _row_of(presses.measurement, hold.press)
    press, depth = presses.measurement.presses[row], float(hold.depths[-1] + presses.offsets[row])
    path = paths[row]

    def make() -> Arrays:
        scene = ball(organ, presses.measurement.radius, presses.friction)
        tick = scene.simulation.settings.tick_time
        time, depths, forces = [], [], []
        marks = np.linspace(START, depth, 60)
        for before, after in itertools.pairwise(marks):
            lead(scene, path, (float(before), float(after)), press.speed)
            time.append((float(after) - depth) / press.speed)
            depths.append(float(after))
            forces.append(-float(scene.wrenches[0, :3] @ path.direction))
        length = min(hold.length, max(DECAYS * organ.relaxation_time, LONG_ENOUGH))
        for count in range(1, round(length / tick) + 1):
            scene.move(0, path.at(depth))
            scene.step()
            if count % EVERY == 0:
                time.append(count * tick)
                depths.append(depth)
                forces.append(-float(scene.wrenches[0, :3] @ path.direction))
        return {"time": np.array(time), "depths": np.array(depths), "forces": np.array(forces)}

    found = remember(f"hold {hold.press} {depth:.9g} {press.speed:.6g} {organ.digest()[:16]}", make)
    elastic = presses.curves.some(np.array([row])).at(found["depths"][None])[0][0]
    return term_of(Hold(hold.press, found["time"], found["depths"], found["forces"]), elastic)


def _part_of_the_modulus(organ: Organ, presses: Presses, paths: list[Press], remember: Remember) -> float:
    """Return the factor on the modulus of an organ that relaxes with which it feels in presses as the elastic fit."""
    measurement = presses.measurement
    fast = [row for row, press in enumerate(measurement.presses) if press.speed > 0.0]
    parts = []
    for row in progress.steps(_spread(fast), "presses of the model"):
        press = measurement.presses[row]
        depths = np.sort(press.depths) + presses.offsets[row]
        path = paths[row]

        def make() -> Arrays:
            scene = ball(organ, measurement.radius, presses.friction)
            return {"force": moving_forces(scene, path, depths, press.speed)}  # noqa: B023 - called at once

        name = f"relaxing {press.name} {presses.offsets[row]:.9g} {press.speed:.6g} {organ.digest()[:16]}"
        felt = remember(name, make)["force"]
        wanted = presses.factor * presses.curves.some(np.array([row])).at(depths[None])[0][0]
        parts.append(float(wanted @ felt) / max(float(felt @ felt), 1e-300))
    return float(np.median(parts))


def _spread(rows: Sequence[int]) -> list[int]:
    """Return MOST_PRESSES of some rows at most, evenly spread."""
    chosen = np.linspace(0, len(rows) - 1, min(len(rows), MOST_PRESSES)).round().astype(int)
    return [rows[index] for index in chosen]


def _row_of(measurement: Measurement, name: str) -> int:
    return next(row for row, press in enumerate(measurement.presses) if press.name == name)


def _paths(organ: Organ, measurement: Measurement) -> list[Press]:
    """Return the paths of all presses, at a flat place of the organ where the recording doesn't know theirs."""
    if measurement.is_registered:
        return [Press(press.place, press.direction) for press in measurement.presses]
    spot = flat_locations(organ, 1)[0][0]
    return [Press(spot.point - measurement.radius * spot.direction, spot.direction)] * len(measurement.presses)
