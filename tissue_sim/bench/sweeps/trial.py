"""One cell of the sweep: load the organ, hold, release, watch, assess; a pure function of its cell."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.bench.sweeps.cells import AXES, NEWTONS_A_UNIT, Cell
from tissue_sim.bench.sweeps.inversion_check import InversionCheck, Turned
from tissue_sim.bench.sweeps.loads import BRIEF, FULL, QUICK, load_on
from tissue_sim.bench.sweeps.trial_simulations import (
    LEAST_OBSERVED,
    inversion_check_of,
    observed_time,
    organ_of,
    simulation_of,
)
from tissue_sim.json_types import JsonObject
from tissue_sim.model.data.state import Region
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.model.simulation import Simulation

LEFT = 0.01  # fraction of the peak displacement that may remain
QUIET_SPEED = 1e-4  # m/s, of the fastest node
MOST_GAIN = 0.05  # fraction of the energy at release
# The far field of a modal region takes up a changed load in some milliseconds, without inertia, and the energy of the
# shape that it shows is no conserved one: it is compared with that at the release, later and more loosely.
MOST_MODAL_GAIN, MODAL_TIME = 0.1, 0.01  # s
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

    def as_json(self) -> JsonObject:
        """Return plain values; None where a number isn't finite."""
        plain = {key: _plain(value) for key, value in asdict(self).items()}
        plain["turned"] = {key: _plain(value) for key, value in self.turned._asdict().items()}
        return plain


def _plain(value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return list(value) if isinstance(value, tuple) else value


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
        elastic_forces(self.simulation.model, position, 1.0, force)
        return force


def run_cell(cell: Cell) -> Record:
    """Load, hold, release and watch one cell."""
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
