"""Clamped silicone beam that bends under its weight, and under a weight on its end, at rest and in motion.

It was measured by Zhang, Michelis, Spielberg and Katzschmann 2021 (diffPD_sim2real). Young's moduli and the damping are
fitted to the runs without a weight; those with one are predicted.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench.measured.body import Rate, built, calibrated, timed
from tissue_sim.bench.measured.lattice import places, rigid_motion, shell
from tissue_sim.bench.rows import report, until_stopped
from tissue_sim.calibration.dynamics import SMOOTHED, Forces, Start, Steps, swing
from tissue_sim.calibration.elastic import Elastic
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.inertia import frequencies_of
from tissue_sim.calibration.progress import Progress
from tissue_sim.calibration.solid import Material
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ

FILE = "beam_markers.csv"
FRAMES = 100.0  # per second
WEIGHTS = {"gravity": 0.0, "load52": 0.51012, "load101": 1.00062}  # N on the upper edge of the free end
REPEATS = ("a", "b")
GRAVITY = (0.0, 0.0, -9.81)  # m/s^2
SIZE = (0.1, 0.03, 0.03)  # m, from the clamp at x = -0.1 to the free end at x = 0
CELLS = (27, 8, 8)  # of the surface's lattice: 994 points
# Markers on sticks at the free end, then those on the holder, m.
MARKERS = np.array(
    [
        *([0.0, 0.015, 0.036], [0.0, -0.006, 0.024], [0.0, 0.036, 0.006]),
        *([-0.094, -0.01, -0.001], [-0.094, 0.04, 0.0275], [-0.094, 0.04, 0.0]),
    ]
)
TIP = 3  # markers at the free end
# As in the source, except for Poisson's ratio, 0.499 there; the modulus is the start of its fit.
MATERIAL = Material(youngs_modulus=263.8e3, poisson_ratio=0.45, density=1070.0)
HELD = "x<0.001"
STILL = 20  # frames before a run begins
LAST = 100  # frames at the end of a run, which count as rest
BEGUN = 0.02  # fraction of the travel at which a run has begun
SECOND = 100  # frames of motion that are compared
FITS = 4  # of the modulus at rest
TOLERANCE, LONGEST = 1e-4, 20.0  # of settling, and s
ELEMENT_STEP = 0.005  # s, of the finite elements' motion
MOST_OFF, MOST_OFF_MOVING = 5.0, 15.0  # %


class Fitted(NamedTuple):
    """Parameters of the silicone from the runs without a weight."""

    at_rest: float  # Pa, Young's modulus
    moving: float  # Pa, within a second
    damping_ratio: float  # of the lowest mode


class Bent(NamedTuple):
    """Results of one run: motion of the free end's markers, measured and predicted."""

    run: str
    weight: float  # N
    rest: Floats  # (3,) m, mean travel of the markers at rest: measured, finite elements, model
    time: Floats  # (t,) s
    measured: Floats  # (t, 3, 3) m of the markers from where they were at first
    elements: Floats  # likewise; nan while the end is prescribed
    model: Floats
    rate: Rate

    @property
    def off(self) -> dict[str, float]:
        """Error of the predicted travel at rest, %; negative where it is less."""
        return {name: 100.0 * float(self.rest[k] / self.rest[0] - 1.0) for k, name in ((1, "elements"), (2, "model"))}

    @property
    def off_moving(self) -> dict[str, float]:
        """Relative L2 error of the markers' motion from the release of the end until the second is over, %."""
        free = ~np.isnan(self.elements[:, 0, 0])
        size = np.linalg.norm(self.measured[free])
        found = {"elements": self.elements, "model": self.model}
        return {
            name: 100.0 * float(np.linalg.norm((some - self.measured)[free]) / size) for name, some in found.items()
        }


def read(path: Path) -> dict[str, Floats]:
    """Return markers (t, 6, 3) m of every run in the beam's frame.

    Raises UserError for a file that is missing, or not the expected one.
    """
    rows: dict[str, list[list[float]]] = {}
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            for row in list(csv.reader(stream))[1:]:
                rows.setdefault(row[0], []).append([float(cell) for cell in row[2:]])
        runs = {run: np.array(values).reshape(-1, len(MARKERS), 3) for run, values in rows.items()}
        chosen = {run: runs[run] for run in (f"{load}_{repeat}" for load in WEIGHTS for repeat in REPEATS)}
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}; name its folder with --data") from None
    except (ValueError, KeyError, IndexError):
        raise UserError(f"{path} is not the table of the beam's markers") from None
    found = {}
    for run, markers in chosen.items():
        rotation, shift = rigid_motion(markers[0], MARKERS)
        found[run] = markers @ rotation.T + shift
    return found


class Run(NamedTuple):
    """Data of a run before it is predicted."""

    name: str
    weight: float  # N
    moved: Floats  # (t, 3, 3) m, displacements of the free end's markers, from the beginning of the motion
    rest: float  # m, mean travel of the markers at rest
    led: int  # frames until the end first passes its equilibrium: the releasing hand touches it until then


def run_of(name: str, markers: Floats) -> Run:
    """Return a run from its markers (t, 6, 3) m."""
    moved = markers[:, :TIP] - markers[:STILL, :TIP].mean(axis=0)
    rest = float(np.linalg.norm(moved[-LAST:].mean(axis=(0, 1))))
    travel = np.linalg.norm(moved.mean(axis=1), axis=1)
    begun = max(0, int(np.argmax(travel > BEGUN * rest)) - 3)
    passed = int(np.argmax(travel > rest)) - begun
    return Run(name, WEIGHTS[name.split("_")[0]], moved[begun : begun + SECOND + 1], rest, passed)


class Beam:
    """Calibrated beam, with a weight on its end or without."""

    def __init__(self, organ: Organ) -> None:
        self.organ = organ
        surface = organ.surface_positions
        self.end = np.flatnonzero(surface[:, 0] > -1e-6)
        self.edge = self.end[surface[self.end, 2] > SIZE[2] - 1e-6]
        self._stiffness = np.concatenate([organ.cell_mu, organ.cell_lambda])

    def simulation(self, weight: float, stiffness: float = 1.0, damping_ratio: float | None = None) -> Simulation:
        """Return the beam under gravity, straight, at rest, with a stiffness factor and a damping ratio."""
        mass, damping = self.mass(weight), self.organ.damping
        if damping_ratio is not None:
            damping = 2.0 * damping_ratio * 2.0 * math.pi * self.lowest(mass, stiffness) * mass
        loaded = replace(self.organ, mass=mass, damping=damping)
        simulation = Simulation(loaded, gravity=GRAVITY, shape_gravity=(0.0, 0.0, 0.0))
        simulation.settings.stiffness_scale = stiffness
        simulation.set_substeps()
        return simulation

    def mass(self, weight: float) -> Floats:
        """Return masses (n,) kg with a weight, N, on the edge of the free end."""
        mass = self.organ.mass.copy()
        mass[self.edge] += weight / -GRAVITY[2] / len(self.edge)
        return mass

    def lowest(self, mass: Floats, stiffness: float) -> float:
        """Return the lowest frequency, Hz."""
        elastic = Elastic(assemble(replace(self.organ, mass=mass)))
        return float(frequencies_of(elastic, stiffness * self._stiffness, mass, 2)[0])

    def markers(self, positions: Floats) -> Floats:
        """Return the displacements (3, 3) m of the free end's markers."""
        return tip_markers(self.organ.surface_positions[self.end], positions[self.end])

    def rest(self, weight: float) -> float:
        """Return the mean travel of the markers at rest, m. Raises UserError when the beam doesn't come to rest."""
        simulation = self.simulation(weight)
        _, settled = simulation.settle(np.zeros((self.organ.n_surface, 3)), TOLERANCE, LONGEST)
        if not settled:
            raise UserError("the beam does not come to rest")
        return float(np.linalg.norm(self.markers(simulation.positions).mean(axis=0)))

    def follow(self, run: Run, stiffness: float, damping_ratio: float) -> tuple[Floats, Floats, Floats, Rate]:
        """Return a run's markers (t, 3, 3) m, positions and velocities (n, 3) at the release, and its rate."""
        simulation = self.simulation(run.weight, stiffness, damping_ratio)
        rest = self.organ.surface_positions[self.end]
        ticks = round(simulation.rate / FRAMES)
        found, rates = [self.markers(simulation.positions)], []
        start, speed = simulation.positions.copy(), simulation.velocities.copy()
        for frame in range(1, len(run.moved)):
            if frame <= run.led:
                rotation, shift = rigid_motion(MARKERS[:TIP], MARKERS[:TIP] + run.moved[frame])
                simulation.prescribe(self.end, rest @ rotation.T + shift, ticks)
            elif frame == run.led + 1:
                simulation.free()
            rates.append(timed(simulation, ticks))
            if frame == run.led:
                start, speed = simulation.positions.copy(), simulation.velocities.copy()
            found.append(self.markers(simulation.positions))
        rate = Rate(
            float(np.median([one.median for one in rates])),
            float(max(one.p99 for one in rates)),
            sum(one.faults for one in rates),
        )
        return np.array(found), start, speed, rate


def tip_markers(rest: Floats, positions: Floats) -> Floats:
    """Return displacements (3, 3) m of markers on sticks for positions (k, 3) m of the nearly rigid end face."""
    rotation, shift = rigid_motion(rest, positions)
    moved: Floats = MARKERS[:TIP] @ rotation.T + shift - MARKERS[:TIP]
    return moved


class Elements:
    """Finite elements of the beam, with a weight on its end."""

    def __init__(self, organ: Organ, weight: float) -> None:
        self.body = Body(organ)
        surface = organ.surface_positions
        self.end = np.flatnonzero(surface[:, 0] > -1e-6)
        self._rest = surface[self.end]
        edge: Longs = self.end[surface[self.end, 2] > SIZE[2] - 1e-6]
        force = np.zeros((organ.n_surface, 3))
        force[edge, 2] = -weight / len(edge)
        # The mass is on the nodes: distributed like its force by quadratic shapes, some of it would be negative.
        inertia = np.zeros(self.body.n_nodes)
        inertia[edge] = weight / -GRAVITY[2] / len(edge)
        self.load = self.body.loads(force, GRAVITY)
        self.body.solid.add_masses(inertia)

    def rest(self) -> float:
        """Return the mean travel of the markers at rest, m. Raises UserError when it doesn't settle."""
        found = self.body.solid.settle(self.load)
        if not found.converged:
            raise UserError("the beam's finite elements do not converge")
        moved = tip_markers(self._rest, self._rest + found.displacement[self.end])
        return float(np.linalg.norm(moved.mean(axis=0)))

    def follow(self, frames: int, damping_rate: float, start: Floats, speed: Floats) -> Floats:
        """Return markers (frames + 1, 3, 3) m from initial displacements and velocities (n, 3)."""
        forces = Forces(damping_rate, load=self.load)
        steps = Steps(frames / FRAMES, ELEMENT_STEP)
        motion = swing(self.body.solid, Start(start, speed, SMOOTHED), forces, steps, self.end)
        every = round(1.0 / (FRAMES * ELEMENT_STEP))
        return np.array([tip_markers(self._rest, self._rest + moved) for moved in motion.displacement[::every]])


def plain(youngs_modulus: float) -> Organ:
    """Return the beam as built, of a modulus, Pa."""
    counts = tuple(cells + 1 for cells in CELLS)
    index, triangles = shell((counts[0], counts[1], counts[2]))
    positions = index / np.array(CELLS) * SIZE - [SIZE[0], 0.0, 0.0]
    return built("beam", positions, triangles, HELD, MATERIAL._replace(youngs_modulus=youngs_modulus))


def modulus_at_rest(travel: float, watch: Callable[[], object]) -> float:
    """Return Young's modulus with which finite elements sag as far, m, as the beam without a weight."""
    modulus = MATERIAL.youngs_modulus
    for _ in range(FITS):
        modulus *= Elements(plain(modulus), 0.0).rest() / travel  # nearly inverse to the sag
        watch()
    return modulus


def fitted(beam: Beam, runs: list[Run], at_rest: float, watch: Callable[[], object]) -> Fitted:
    """Return modulus and damping of the motion in the runs without a weight, by the model."""

    def off(unknown: Floats) -> Floats:
        parts = []
        for run in runs:
            found = beam.follow(run, float(unknown[0]), float(unknown[1]))[0]
            free = slice(run.led + 1, None)
            parts.append((found - run.moved)[free] / np.linalg.norm(run.moved[free]))
        watch()
        return np.concatenate([part.ravel() for part in parts])

    best = least_squares(off, [1.0, 0.05], diff_step=0.01, x_scale=[0.1, 0.02], xtol=1e-3, ftol=1e-3, max_nfev=8)
    return Fitted(at_rest, at_rest * float(best.x[0]), float(best.x[1]))


def measure(data: Path, folder: Path, progress: Progress) -> tuple[Fitted, list[Bent]]:
    """Build and calibrate the beam, fit its parameters without a weight, and predict every run.

    data: folder of the measured tables; folder: for the calibrated beam and intermediate results. Returns the fit, and
    the results of every run.
    """
    runs = [run_of(name, markers) for name, markers in read(data / FILE).items()]
    without = [run for run in runs if run.weight == 0.0]
    with progress.stage("beam's modulus", FITS) as done:
        at_rest = modulus_at_rest(float(np.mean([run.rest for run in without])), done)
    organ = calibrated(plain(at_rest), folder, progress)
    beam = Beam(organ)
    with progress.stage("beam's damping", 24) as done:
        found = fitted(beam, without, at_rest, done)
    rests = {}
    with progress.stage("beam at rest", len(WEIGHTS)) as done:
        for weight in WEIGHTS.values():
            rests[weight] = Elements(plain(at_rest), weight).rest(), beam.rest(weight)
            done()
    bent = []
    with until_stopped(), progress.stage("beam in motion", len(runs)) as done:
        for run in runs:
            bent.append(predicted(beam, run, found, rests[run.weight]))
            report(f"beam, {run.name}", f"error {bent[-1].off['model']:+.1f} % at rest")
            done()
    return found, bent


def predicted(beam: Beam, run: Run, fit: Fitted, rests: tuple[float, float]) -> Bent:
    """Return one run by both; the finite elements start from the model's state at the release."""
    stiffness = fit.moving / fit.at_rest
    model, start, speed, rate = beam.follow(run, stiffness, fit.damping_ratio)
    elements = Elements(plain(fit.moving), run.weight)
    organ = beam.organ
    at = places(elements.body.solid.nodes, organ.rest_positions, organ.cell_nodes)
    damping_rate = 4.0 * math.pi * fit.damping_ratio * beam.lowest(beam.mass(run.weight), stiffness)
    frames = len(run.moved) - 1 - run.led
    free = elements.follow(frames, damping_rate, at @ (start - organ.rest_positions), at @ speed)
    by_elements = np.full_like(run.moved, np.nan)
    by_elements[run.led + 1 :] = free[1:]
    time = np.arange(len(run.moved)) / FRAMES
    travels = np.array([run.rest, *rests])
    return Bent(run.name, run.weight, travels, time, run.moved, by_elements, model, rate)


def as_json(fit: Fitted, found: list[Bent]) -> JsonObject:
    """Return the fit, and the figures of every run."""
    return {
        "modulus_at_rest_pa": fit.at_rest,
        "modulus_moving_pa": fit.moving,
        "damping_ratio": fit.damping_ratio,
        "runs": [
            {
                "run": one.run,
                "weight_n": one.weight,
                "rest_mm": dict(zip(("measured", "elements", "model"), (1e3 * one.rest).tolist(), strict=True)),
                "rest_off_percent": one.off,
                "motion_off_percent": one.off_moving,
                "tick_us": 1e6 * one.rate.median,
                "faults": one.rate.faults,
            }
            for one in found
        ],
    }
