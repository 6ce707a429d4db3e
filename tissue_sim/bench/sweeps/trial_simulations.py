"""Simulations of a sweep's cells: organ, settings, and the time for which they are observed."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import trimesh

from tissue_sim.array_types import Longs
from tissue_sim.bench.sweeps.cells import AXES, DEFAULT_RATE, SMALL_ORGAN, Cell
from tissue_sim.bench.sweeps.inversion_check import InversionCheck
from tissue_sim.bench.sweeps.loads import PROBE
from tissue_sim.model.data.records import copy_of
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.shapes import NO_TOOLS, sphere_tools
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.frequency import largest_frequency
from tissue_sim.model.elasticity.modes import lowest_modes
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.critical_step import model_step
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.topology import assemble_organ

# Time constants of the slowest mode in which the organ has to come to rest: more where it oscillates.
SWINGING, SLOWEST_RETURN = 9.0, 6.0
LEAST_OBSERVED, MOST_OBSERVED = 3.0, 150.0  # s
QUICK_OBSERVED = 1.5  # s, the most with --quick
BRIEFLY_OBSERVED = 0.03  # s
# Substeps in a millisecond of the explicit integrator, at most; what would need more fails, and is shown as failed.
MOST_SUBSTEPS, QUICK_SUBSTEPS = 400, 100


@lru_cache(maxsize=2)
def organ_of(organ: str) -> Organ:
    """Return the organ of a cell, read once in a worker; SMALL_ORGAN is synthetic.

    organ: organ file, or SMALL_ORGAN.
    """
    return small_organ() if organ == SMALL_ORGAN else Organ.load(organ)


def small_organ() -> Organ:
    """Return an ellipsoid of 100 x 60 x 50 mm with 162 surface nodes and nine medial atoms, held below."""
    mesh = trimesh.creation.icosphere(2)
    # Slightly rotated, so that nothing lies along an axis by accident.
    mesh.apply_transform(trimesh.transformations.euler_matrix(0.3, 0.2, 0.1))
    half = np.array([0.05, 0.03, 0.025])
    surface = np.asarray(mesh.vertices) * half
    atoms = np.zeros((9, 3))
    atoms[:, 0] = np.linspace(-0.6, 0.6, 9) * half[0]
    return assemble_organ(
        name=SMALL_ORGAN,
        surface_positions=surface,
        surface_triangles=mesh.faces,
        atom_positions=atoms,
        atom_radius=half[2] * np.sqrt(1.0 - (atoms[:, 0] / half[0]) ** 2),
        atom_parent=np.arange(-1, 8),
        fixed=np.flatnonzero(surface[:, 2] < -0.7 * half[2]),
        provenance={"source": "tissue_sim bench stability"},
    )


def with_mass_ratio(organ: Organ, ratio: float) -> Organ:
    """Return the organ with its mass divided between surface and atoms as ratio to 1; damping over mass stays."""
    surface, total = organ.mass[: organ.n_surface].sum(), organ.mass.sum()
    factor = np.full(organ.n_nodes, total / (1.0 + ratio) / (total - surface))
    factor[: organ.n_surface] = ratio * total / (1.0 + ratio) / surface
    return replace(organ, mass=factor * organ.mass, damping=factor * organ.damping)


@lru_cache(maxsize=2)
def inversion_check_of(organ: str) -> InversionCheck:
    """Return the witness of an organ, made once in a worker."""
    return InversionCheck(organ_of(organ))


@lru_cache(maxsize=2)
def slowest_of(organ: str) -> tuple[float, float]:
    """Return the lowest frequency, rad/s, and damping over mass, 1/s, of an organ."""
    model = assemble(organ_of(organ))
    return float(lowest_modes(model, 1).frequency[0]), model.damping_rate


@lru_cache(maxsize=3)  # a model with a modal region may be large
def _simulation(
    organ: str, integrator: str, local_region: str, mass_ratio: float, tool: bool
) -> tuple[Simulation, Settings, Longs]:
    """Return a reusable simulation, with its settings and the words of its state as they were when new."""
    made = organ_of(organ)
    if mass_ratio > 0.0:
        made = with_mass_ratio(made, mass_ratio)
    shapes = sphere_tools(PROBE.radius) if tool else NO_TOOLS
    model = "hybrid" if local_region == "frozen" else "auto"  # cells have no frozen region
    simulation = Simulation(
        made, model=model, rate=DEFAULT_RATE, local_region=local_region, shapes=shapes, integrator=integrator
    )
    return simulation, copy_of(simulation.settings), simulation.state.words.copy()


def made_for(cell: Cell) -> tuple[str, str, str, float, bool]:
    """Return what a cell's simulation depends on; cells that agree in it can use one after another."""
    tool = AXES[cell.axis].load.startswith("tool")
    return cell.organ, cell.integrator, cell.local_region, cell.at("mass_ratio", 0.0), tool


def simulation_of(cell: Cell) -> Simulation:
    """Return the cell's simulation, as if it were new."""
    simulation, settings, words = _simulation(*made_for(cell))
    settings = copy_of(settings)
    rate, substeps = cell.at("rate", DEFAULT_RATE), 0
    most = math.ceil((QUICK_SUBSTEPS if cell.quick else MOST_SUBSTEPS) * DEFAULT_RATE / rate)
    if cell.axis == "step":
        step = cell.value * critical_step_of(cell.organ, "explicit" if cell.brief else "symplectic")
        substeps = min(most, max(1, round(1.0 / (DEFAULT_RATE * step))))
        rate = 1.0 / (substeps * step)
        settings.substeps = settings.region_substeps = substeps
    settings.tick_time = 1.0 / rate
    settings.stiffness_scale, settings.damping_scale = cell.at("stiffness", 1.0), cell.at("damping", 1.0)
    simulation.rate = rate
    simulation.take_settings(settings)
    if not substeps:
        simulation.set_substeps()
        if cell.brief:
            used = simulation.settings
            used.substeps, used.region_substeps = min(used.substeps, most), min(used.region_substeps, most)
    simulation.state.words[:] = words
    simulation.scratch.stale[0] = 1
    return simulation


@lru_cache(maxsize=4)
def critical_step_of(organ: str, integrator: str) -> float:
    """Return the critical step of an integrator with an organ as it is, s."""
    model = assemble(organ_of(organ))
    return model_step(model, largest_frequency(model), integrator=integrator)


def observed_time(cell: Cell) -> tuple[float, bool]:
    """Return seconds to watch after the release, and whether the organ's slowest mode decays within them."""
    frequency, damping = slowest_of(cell.organ)
    half, square = 0.5 * cell.at("damping", 1.0) * damping, cell.at("stiffness", 1.0) * frequency**2
    if half**2 > square:
        needed = SLOWEST_RETURN / (half - math.sqrt(half**2 - square))
    else:
        needed = SWINGING / half if half > 0.0 else math.inf
    most = BRIEFLY_OBSERVED if cell.brief else QUICK_OBSERVED if cell.quick else MOST_OBSERVED
    enough = needed <= most
    return min(most, max(LEAST_OBSERVED, needed if enough else 0.0)), enough
