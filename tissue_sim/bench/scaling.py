"""Growth of a tick's time with the organ: whole model and modal region, 1k to 64k points."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.linalg import eigh

from tissue_sim.array_types import Array, Floats
from tissue_sim.bench import rows
from tissue_sim.bench.organs import bean, patch_load
from tissue_sim.bench.timing import Phase, Ticks, Timing, interleave
from tissue_sim.json_types import JsonObject
from tissue_sim.model.data.model import Model
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.modes import Modes, lowest_modes, stiffness_matrix
from tissue_sim.model.regions import reduction
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ

SIZES = (1000, 4000, 16000, 64000)
QUICK_SIZES = SIZES[:2]
FORCE = 0.1  # N on the patch of the smallest organ; the others, whose patches are smaller, get the same pressure
_NEIGHBOURS = 40  # coarse nodes that a fine one takes its displacement from


class Grown(NamedTuple):
    """Results of one size: whole and modal ticks, their substeps and moving nodes, seconds to compute the modes."""

    points: int
    whole: Timing
    whole_substeps: int
    modal: Timing
    modal_substeps: int
    modal_nodes: int
    modes: int
    modes_seconds: float
    modes_carried: bool  # carried over from the smallest organ instead of computed by eigsh


def measure(sizes: tuple[int, ...], seconds: float) -> list[Grown]:
    """Measure every size in turns with the others.

    sizes: numbers of surface points; seconds: duration for each of the two ticks of a size, s. Returns the results;
    empty once it was stopped.
    """
    bursts: dict[str, Ticks] = {}
    made: dict[int, tuple[Simulation, Simulation, Modes, float]] = {}
    coarse: tuple[Organ, Modes] | None = None
    with rows.until_stopped():
        for points in rows.each(sizes, "growth, organ"):
            organ = bean(points)
            start = time.perf_counter()
            if coarse is None:
                modes = lowest_modes(assemble(organ))
                coarse = organ, modes
            else:
                modes = carried_modes(*coarse, organ, assemble(organ))
            took = time.perf_counter() - start
            whole = Simulation(organ)
            modal = Simulation(organ, local_region="modal") if points == sizes[0] else with_modes(organ, modes)
            made[points] = whole, modal, modes, took
            nodes, forces = patch_load(organ, FORCE * sizes[0] / points)
            bursts[f"whole {points}"] = Ticks(whole, nodes, forces)
            bursts[f"modal {points}"] = Ticks(modal, nodes, forces)
    timings = interleave(Phase(bursts, seconds, "growth"))
    return [
        Grown(
            points,
            timings[f"whole {points}"],
            int(whole.state.status.substeps),
            timings[f"modal {points}"],
            int(modal.state.status.substeps),
            int(modal.state.status.active),
            len(modal.state.mode_position),
            took,
            points != sizes[0],
        )
        for points, (whole, modal, modes, took) in made.items()
        if f"modal {points}" in timings
    ]


def exponent(points: list[int], times: list[float]) -> float | None:
    """Return the p of the best fit time = c n^p; None without two sizes."""
    if len(points) < 2:
        return None
    return float(np.polyfit(np.log(points), np.log(times), 1)[0])


def with_modes(organ: Organ, modes: Modes) -> Simulation:
    """Return a simulation with a modal region that uses these modes instead of computing and keeping its own."""
    own = reduction.remembered
    nothing = np.zeros((0, 0), dtype=np.float32)
    made: dict[str, Array] = {"frequency": modes.frequency, "shape": modes.shape, "compliance": nothing}
    try:
        reduction.remembered = lambda kind, key, make: made
        return Simulation(organ, local_region="modal")
    finally:
        reduction.remembered = own


def carried_modes(coarse: Organ, coarse_modes: Modes, fine: Organ, model: Model) -> Modes:
    """Return modes of a fine organ from a coarse one's: interpolated smoothly, then by Rayleigh-Ritz.

    For organs of the same shape and atoms, where eigsh on the fine one would take minutes.
    """
    n, m = len(model.rest), len(coarse_modes.frequency)
    shape = np.zeros((n, 3 * m))
    flat = coarse_modes.shape.reshape(-1, 3 * m)
    smooth = RBFInterpolator(coarse.surface_positions, flat[: coarse.n_surface], neighbors=_NEIGHBOURS)
    shape[: fine.n_surface] = smooth(fine.surface_positions)
    shape[fine.n_surface :] = flat[coarse.n_surface :]
    shape[model.inverse_mass == 0.0] = 0.0
    basis: Floats = shape.reshape(3 * n, m)
    mass = np.zeros(n)
    mass[model.moving] = 1.0 / model.inverse_mass[model.moving]
    square, mix = eigh(basis.T @ (stiffness_matrix(model) @ basis), basis.T @ (np.repeat(mass, 3)[:, None] * basis))
    return Modes(np.sqrt(np.maximum(square, 0.0)), (basis @ mix).reshape(n, 3, m))


def as_json(grown: list[Grown]) -> JsonObject:
    """Return the growth for machines; units stand in the names."""
    points = [size.points for size in grown]
    return {
        "sizes": [
            {
                "points": size.points,
                "whole_us": 1e6 * size.whole.median,
                "whole_p99_us": 1e6 * size.whole.p99,
                "substeps": size.whole_substeps,
                "substep_us": 1e6 * size.whole.median / size.whole_substeps,
                "modal_us": 1e6 * size.modal.median,
                "modal_p99_us": 1e6 * size.modal.p99,
                "modal_substeps": size.modal_substeps,
                "modal_nodes": size.modal_nodes,
                "modes": size.modes,
                "modes_s": size.modes_seconds,
                "modes_by": "Rayleigh-Ritz" if size.modes_carried else "eigsh",
                "samples": [size.whole.samples, size.modal.samples],
            }
            for size in grown
        ],
        "substep_exponent": exponent(points, [size.whole.median / size.whole_substeps for size in grown]),
        "tick_exponent": exponent(points, [size.whole.median for size in grown]),
        "modal_ratio": grown[-1].modal.median / grown[0].modal.median if grown else None,
    }
