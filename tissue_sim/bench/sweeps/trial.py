"""One cell of the sweep: load the organ, hold, release, watch, assess; a pure function of its cell."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import trimesh

from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench.sweeps.cells import AXES, DEFAULT_RATE, NEWTONS_A_UNIT, SMALL_ORGAN, Cell
from tissue_sim.bench.sweeps.inversion_check import InversionCheck, Turned
from tissue_sim.bench.sweeps.loads import BRIEF, FULL, PROBE, QUICK, load_on
from tissue_sim.model.data.records import copy_of
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.state import Region
from tissue_sim.model.elasticity.assembly import assemble
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.model.elasticity.frequency import largest_frequency
from tissue_sim.model.elasticity.modes import lowest_modes
from tissue_sim.model.simulation import NO_TOOLS, Simulation, sphere_tools
from tissue_sim.model.stepping.critical_step import model_step
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.topology import assemble_organ

LEFT = 0.01  # fraction of the peak displacement that may remain
QUIET_SPEED = 1e-4  # m/s, of the fastest node
MOST_GAIN = 0.05  # fraction of the energy at release
# The far field of a modal region takes up a changed load in some milliseconds, without inertia, and the energy of the
# shape that it shows is no conserved one: it is compared with that at the release, later and more loosely.
MOST_MODAL_GAIN, MODAL_TIME = 0.1, 0.01  # s
# Time constants of the slowest mode in which the organ has to come to rest: more where it oscillates.
SWINGING, SLOWEST_RETURN = 9.0, 6.0
LEAST_OBSERVED, MOST_OBSERVED = 3.0, 150.0  # s
QUICK_OBSERVED = 1.5  # s, the most with --quick
BRIEFLY_OBSERVED = 0.03  # s
# Substeps in a millisecond of the explicit integrator, at most; what would need more fails, and is shown as failed.
MOST_SUBSTEPS, QUICK_SUBSTEPS = 400, 100
ROUNDING = 1e-9  # m: an organ that is nearer to its rest shape holds the energy of rounded coordinates
LATER_EVERY = 20  # ticks between two checks after the least time observed
ENERGY_EVERY = 2  # ticks between two checks of the energy before that
LOOK_EVERY = 20  # ticks between two checks of inverted cells


@dataclass(frozen=True)
class Record:
    """Results of a cell."""

    axis: str
    value: float
    integrator: str
    local_region: str
    outcome: str  # stable, guarded (faults, recovered) or diverged
    problems: tuple[str, ...]  # why diverged
    judged: bool  # a fault here breaks the requirement on the default settings
    settled: bool  # False when the organ was too slow to come to rest in the time that was observed
    faults: int
    snaps: int  # number of recoveries to rest
    peak: float  # m, largest displacement of a node
    left: float  # largest displacement at the end, over the peak
    quiet_after: float | None  # s from the release until asleep
    energy_gain: float  # largest rise after the release over the energy at the release
    energy_caught: float  # the same, of what the guard undid
    turned_most: int  # inverted cells under the load
    turned: Turned  # what is inverted at the end
    substeps: int  # in a tick, at most
    ticks: int
    newtons: float  # in all; 0 for the tool
    seconds: float  # of computing

    def as_json(self) -> dict[str, Any]:
        """Return plain values; None where a number isn't finite."""
        plain = {key: _plain(value) for key, value in asdict(self).items()}
        plain["turned"] = {key: _plain(value) for key, value in self.turned._asdict().items()}
        return plain


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return list(value) if isinstance(value, tuple) else value


@lru_cache(maxsize=2)
def organ_of(organ: str) -> Organ:
    """Return the organ of a cell, read once in a worker; SMALL_ORGAN is synthetic.

    Parameters
    ----------
    organ : str
        Organ file, or SMALL_ORGAN.

    Returns
    -------
    Organ
        The organ.
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
    """Return what a cell's simulation depends on; cells that agree in it can use one after another.

    Parameters
    ----------
    cell : Cell
        The cell.

    Returns
    -------
    tuple[str, str, str, float, bool]
        The key.
    """
    tool = AXES[cell.axis].load.startswith("tool")
    return cell.organ, cell.integrator, cell.local_region, cell.at("mass_ratio", 0.0), tool


def simulation_of(cell: Cell) -> Simulation:
    """Return the cell's simulation, as if it were new.

    Parameters
    ----------
    cell : Cell
        The cell.

    Returns
    -------
    Simulation
        The simulation.
    """
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


class _Watch:
    """Observations of a simulation, tick by tick."""

    def __init__(self, simulation: Simulation, witness: InversionCheck) -> None:
        self.simulation, self.witness = simulation, witness
        self.finite, self.gained = True, False
        self.peak = 0.0
        self.turned_most = self.substeps = 0
        self.energy_gain = self.energy_caught = 0.0
        self._energy_at_release, self._least_energy = 0.0, math.nan
        self._faults = self._released = 0

    def look(self) -> None:
        """Observe the state after a tick: whether it is finite, how far nodes went, what is inverted."""
        state = self.simulation.state
        positions = self.simulation.positions
        reach = self.reach()
        if not math.isfinite(reach + float(state.velocity.sum()) + float(state.wrench.sum())):
            self.finite = False
            return
        self.peak = max(self.peak, reach)
        self.substeps = max(self.substeps, int(state.status.substeps))
        if state.status.tick % LOOK_EVERY == 0:
            self.turned_most = max(self.turned_most, self.witness.look(positions).cells)

    def reach(self) -> float:
        """Return the largest displacement of a node, m."""
        offset = self.simulation.positions - self.simulation.model.rest
        return math.sqrt(float(np.einsum("ij,ij->i", offset, offset).max()))

    def look_at_energy(self) -> None:
        """Note the largest rise over the least energy so far without loads, relative to that at the release.

        What the guard undid is counted separately.
        """
        state = self.simulation.state
        status, count = state.status, state.count
        if np.any(state.wrench) or status.snapped or status.collapsing:
            self._least_energy = math.nan  # a tool does work, and a recovery may pass through higher energy
            return
        energy = self.simulation.energy.total + self._held_besides()
        modal = status.region == Region.MODAL
        if math.isnan(self._least_energy):
            self._least_energy, self._released = energy, int(status.tick)
            self._energy_at_release = max(self._energy_at_release, energy)
        if count.faults != self._faults:
            self._faults = int(count.faults)
            self.energy_caught = max(self.energy_caught, self.energy_gain)
            self.energy_gain, self.gained = 0.0, False
        if modal and (status.tick - self._released) < MODAL_TIME * self.simulation.rate:
            return
        if not modal:
            self._least_energy = min(self._least_energy, energy)
        if self._energy_at_release > 0.0 and self.reach() > ROUNDING:
            gain = (energy - self._least_energy) / self._energy_at_release
            self.energy_gain = max(self.energy_gain, float(gain))
            self.gained = self.gained or gain > (MOST_MODAL_GAIN if modal else MOST_GAIN)

    def _held_besides(self) -> float:
        """Return what the integrator keeps besides kinetic and elastic energy where nothing is damped, J.

        Symplectic Euler keeps E + h/2 v.f (of a linear model exactly); E alone ripples by as much as the fastest modes
        hold, which near the critical step is not growth.
        """
        simulation, state = self.simulation, self.simulation.state
        nodes, velocity = simulation.model.moving, state.velocity
        if state.status.region != Region.WHOLE:
            nodes = simulation.scratch.region_node[: state.status.region_nodes]
        elif simulation.integrator == "explicit":
            return 0.0
        step = 1.0 / (simulation.rate * max(1, state.status.substeps))
        push = self._push(state.position)
        scale = float(simulation.settings.stiffness_scale)
        return 0.5 * step * scale * float(np.vdot(velocity[nodes], push[nodes]))

    def _push(self, position: Floats) -> Floats:
        """Return elastic forces (n, 3) N at a position, with the tissue's stiffness scaled by 1."""
        force = np.zeros_like(position)
        elastic_forces(self.simulation.model, position, force)
        return force


def run_cell(cell: Cell) -> Record:
    """Load, hold, release and watch one cell.

    Parameters
    ----------
    cell : Cell
        The cell.

    Returns
    -------
    Record
        The results.
    """
    start = time.perf_counter()
    simulation = simulation_of(cell)
    axis = AXES[cell.axis]
    newtons = NEWTONS_A_UNIT * axis.units * cell.at("stiffness", 1.0)
    if cell.axis.startswith("force_"):
        newtons *= cell.value
    depth = cell.value if cell.axis.startswith("depth") else 0.0
    tick_time = 1.0 / simulation.rate
    pace = BRIEF if cell.brief else QUICK if cell.quick else FULL
    load = load_on(organ_of(cell.organ), axis.load, newtons, depth, tick_time, pace)
    seconds, enough = observed_time(cell)
    watch = _Watch(simulation, inversion_check_of(cell.organ))
    # A load that overflows must not fill the terminal with warnings: the outcome says it.
    with np.errstate(all="ignore"):
        tick = 0
        while tick < load.ticks and watch.finite:
            load.act(simulation, tick)
            simulation.step()
            watch.look()
            if load.over(tick):
                watch.look_at_energy()
            tick += 1
        after = 0
        while after * tick_time < seconds and watch.finite and not simulation.asleep:
            simulation.step()
            late = after * tick_time > LEAST_OBSERVED
            if not late or after % LATER_EVERY == 0:
                watch.look()
            if after % (LATER_EVERY if late else ENERGY_EVERY) == 0:
                watch.look_at_energy()
            after += 1
        state = simulation.state
        end = End(
            left=watch.reach() / max(watch.peak, 1e-12),
            speed=float(np.abs(state.velocity).max()),
            asleep=simulation.asleep,
            turned=watch.witness.look(simulation.positions),
        )
    gain = watch.energy_gain if watch.gained else 0.0
    problems = tuple(problems_of(watch.finite, gain, end, enough))
    faults = int(state.count.faults)
    return Record(
        axis=cell.axis,
        value=cell.value,
        integrator=cell.integrator,
        local_region=cell.local_region,
        outcome="diverged" if problems else "guarded" if faults else "stable",
        problems=problems,
        judged=cell.judged,
        settled=enough,
        faults=faults,
        snaps=int(state.count.snaps),
        peak=watch.peak,
        left=end.left,
        quiet_after=after * tick_time if end.asleep else None,
        energy_gain=watch.energy_gain,
        energy_caught=watch.energy_caught,
        turned_most=watch.turned_most,
        turned=end.turned,
        substeps=watch.substeps,
        ticks=tick + after,
        newtons=0.0 if depth else newtons,
        seconds=time.perf_counter() - start,
    )


class End(NamedTuple):
    """State of an organ when the watch over it ends."""

    left: float  # largest displacement over its peak
    speed: float  # m/s, of the fastest node
    asleep: bool
    turned: Turned  # what is inverted


def problems_of(finite: bool, energy_gain: float, end: End, enough: bool) -> list[str]:
    """Return why a cell counts as diverged; empty when it doesn't.

    energy_gain: over that at release, 0 when it is negligible; enough: the time observed suffices to come to rest.
    """
    if not finite:
        return ["not finite"]
    problems = []
    if energy_gain > 0.0:
        problems.append(f"energy gained without work ({100.0 * energy_gain:.3g} %)")
    if not enough:
        return problems
    quiet = end.asleep or end.speed <= QUIET_SPEED
    if not end.left <= LEFT:
        where = "asleep away from its rest shape" if end.asleep else "false rest shape" if quiet else "not back at rest"
        problems.append(f"{where} ({100.0 * end.left:.3g} % of the peak remains)")
    elif not quiet:
        problems.append(f"still moving ({1e3 * end.speed:.3g} mm/s)")
    if end.turned.cells or end.turned.folds or end.turned.volume <= 0.0:
        problems.append(f"inverted ({end.turned.cells} cells, {end.turned.folds} folds)")
    return problems
