"""Measured body as an organ: its surface kept, atoms inside, calibrated to finite elements of its shape."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.calibration.calibrate import calibrate
from tissue_sim.calibration.checkpoint import Checkpoint
from tissue_sim.calibration.progress import Progress
from tissue_sim.calibration.solid import Material, Solid
from tissue_sim.calibration.stiffness import Settings
from tissue_sim.errors import UserError
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.meshes.mesh_input import SurfaceMesh
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.pipeline import organ_from_mesh
from tissue_sim.organ.request import Request
from tissue_sim.version import __version__

MOST_STEPS = 40  # of Newton's method
SHORTEST = 1e-4  # of a step of it
CLOSE = 1e-8  # fraction of the largest force that may remain


class Rate(NamedTuple):
    """Time for a millisecond of the real-time model, and its faults."""

    median: float  # s
    p99: float  # s
    faults: int


def built(name: str, positions: Floats, triangles: Ints, fixed: str, material: Material) -> Organ:
    """Return the organ of a surface, with the pipeline's atoms and springs.

    positions (n, 3) m; triangles (t, 3): corner indices; fixed: choice of the held nodes, as for select_fixed.
    """
    given = {key: getattr(material, key) for key in ("youngs_modulus", "poisson_ratio", "density")}
    request = Request(name=name, fixed=fixed, **given)
    return organ_from_mesh(SurfaceMesh(positions, triangles, ()), request, keep_points=True)


def calibrated(organ: Organ, folder: Path, progress: Progress) -> Organ:
    """Return the organ calibrated with defaults, and write it into a folder.

    folder: for the organ and intermediate results.
    """
    settings = Settings()
    inputs = {"organ": organ.digest(), "version": __version__, **asdict(settings)}
    checkpoint = Checkpoint(folder / f".{organ.name}.calibration", inputs)
    made = calibrate(organ, settings, checkpoint, progress).organ
    made.save(folder / f"{organ.name}.npz")
    return made


def solve_prescribed_surface(solid: Solid, led: Floats) -> Floats:
    """Return the equilibrium of a neo-Hookean solid whose held axes are prescribed, from the linear one.

    Newton's method, each step factored and shortened until the energy falls.

    led (n, 3) m: displacements of the held axes. Returns displacements (n, 3) m. Raises UserError where it doesn't
    converge.
    """
    pull = np.where(solid.held, 0.0, (solid.stiffness @ np.where(solid.held, led, 0.0).ravel()).reshape(led.shape))
    moved = np.where(solid.held, led, solid.solve(-pull[None])[0])
    energy, forces, _ = solid.energy(moved)
    first = np.abs(forces).max()
    for _ in range(MOST_STEPS):
        left = np.where(solid.held, 0.0, -forces)
        if not np.isfinite(energy):
            break
        if np.abs(left).max() <= CLOSE * first:
            return moved
        step, length = solid.factor(moved).solve(left.reshape(-1, 1)).reshape(moved.shape), 1.0
        while solid.energy(moved + length * step)[0] > energy and length > SHORTEST:
            length *= 0.5
        moved = moved + length * step
        energy, forces, _ = solid.energy(moved)
    raise UserError("the finite elements of a measured body don't converge with its surface prescribed")


def timed(simulation: Simulation, ticks: int, watch: Callable[[], None] | None = None) -> Rate:
    """Run a number of ticks and time them.

    watch: called after each, outside the timed part. Returns times and faults.
    """
    took, before = np.empty(ticks), int(simulation.state.count.faults)
    for tick in range(ticks):
        began = time.perf_counter()
        simulation.step()
        took[tick] = time.perf_counter() - began
        if watch is not None:
            watch()
    per_tick = took * simulation.rate * 1e-3
    faults = int(simulation.state.count.faults) - before
    return Rate(float(np.median(per_tick)), float(np.quantile(per_tick, 0.99)), faults)
