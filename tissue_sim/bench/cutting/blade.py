"""Benchmark `tissue_sim bench blade`: a blade that cuts organs by force: its load, where its work goes, and ticks.

Work of the blade is stored in the tissue, taken by damping, or has made area. Friction is off here. Work and damping
are summed in every substep: the blade may lag behind the hand, and nodes oscillate within a tick when the tissue
springs back behind the edge. What yields right at the places of a blade, a millimetre per newton, stores energy too.

The node makes a cut in another process while its loop ticks on. Here one thread does both, and the caches hold nothing
of a tick afterwards. So the old organ ticks on for a moment, and the new one is handed over as to the node's loop.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared
from tissue_sim.bench.printing import Bound, Result, aligned, bound_lines
from tissue_sim.bench.timing import in_one_thread, now
from tissue_sim.contact.scene import TICKS_A_CUT, Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.json_types import JsonObject
from tissue_sim.memory import provide
from tissue_sim.model.contact.blade_lag import GIVE
from tissue_sim.model.data.world import World
from tissue_sim.model.runtime.exchange import preload
from tissue_sim.model.simulation import Simulation
from tissue_sim.model.stepping.tick import begin_tick, end_tick, plan_tick, take_substep
from tissue_sim.organ.normals import surface_normals
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

TOUGHNESS = (75.0, 120.0, 185.0)  # J/m^2, of liver in the literature and the default
LENGTH, HEIGHT, RADIUS = 0.02, 0.012, 1.5e-3  # m, of the blade
DEPTH = 0.025  # m from the surface that it is moved, and
SPEED = 0.02  # m/s, at which
AWAY = 0.003  # m from which it comes
TICKS_ON = 3  # of the organ before each opening, when the cut is made
PATCH = 19  # nodes around the place where it enters
MOST_REST, MOST_P99, MOST_TICK = 5.0, 250.0, 1000.0  # %, us, us


class BladeRun(NamedTuple):
    """A blade that was pressed into an organ."""

    organ: str
    toughness: float  # J/m^2
    entry: float  # N before it entered
    dent: float  # m by which the surface yielded before
    force: float  # N, mean of the last third of its way
    area: float  # m^2 at rest
    work: float  # J of the blade
    stored: float  # J, elastic and kinetic, and in what yields at the blade
    damped: float  # J
    made: float  # J, toughness times area
    opened: int  # times that the cut was opened
    tick: float  # s, median of processor time while it cuts, of ticks that open nothing
    p99: float
    longest: float
    faults: int

    @property
    def rest(self) -> float:
        """Fraction of the work that is unaccounted for."""
        return 1.0 - (self.stored + self.damped + self.made) / self.work


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, check=True)


def run(args: argparse.Namespace) -> Result:
    """Measure what the arguments ask for."""
    organ = Organ.load(args.organ or shipped_organ())
    found = as_json(in_one_thread(measure, organ))
    return Result(found, text(found))


def measure(organ: Organ, toughness: Sequence[float] = TOUGHNESS, depth: float = DEPTH) -> list[BladeRun]:
    """Return the results of a blade for each toughness, J/m^2, moved by so many metres from the surface."""
    found = []
    with rows.until_stopped():
        for each in rows.each(toughness, "toughness"):
            found.append(cut(organ, each, depth))
            rows.report(f"{each:g} J/m^2", f"unaccounted {100.0 * found[-1].rest:.1f} %")
    return found


def cut(organ: Organ, toughness: float, depth: float, friction: float = 0.0) -> BladeRun:
    """Press a blade into an organ far from its clamp; work against friction on its flanks, Pa, isn't accounted for."""
    scene = Scene(organ, [Tool("knife", shape="blade", radius=RADIUS, length=LENGTH, height=HEIGHT)])
    settings = scene.simulation.settings
    settings.toughness, settings.friction, settings.flank_friction = toughness, 0.0, friction
    start, into, turn = place(organ)
    step = SPEED / scene.simulation.rate
    entry = dent = 0.0
    energy, clock = np.zeros(2), np.zeros(2, dtype=np.int64)
    forces, seconds, opened = [], [], 0
    for tick in range(round((AWAY + depth) / step)):
        simulation = scene.simulation
        scene.move("knife", start + (tick * step - AWAY) * into, turn)
        was_cutting = bool(simulation.state.bodies.cutting[0])
        scene.find()
        before, faults = energy.copy(), int(simulation.state.count.faults)
        taken = _tick(simulation.world, energy, clock)
        if simulation.state.count.faults > faults:
            energy[:] = before  # the guard has taken this tick's motion back
        scene.ticks += 1
        if was_cutting:
            seconds.append(1e-9 * taken)
        force = -float(scene.wrench("knife")[:3] @ into)
        forces.append(force)
        if not simulation.state.bodies.cutting[0] and not opened:
            entry, dent = max(entry, force), tick * step - AWAY
        if scene.ticks % TICKS_A_CUT == 0:
            scene.open_cuts()
            if scene.simulation is not simulation:
                opened += 1
                _hand_over(simulation, scene.simulation, clock)
    state, measured = scene.simulation.state, np.array(seconds or [np.nan])
    area = float(state.blades.area.sum())
    return BladeRun(
        organ=organ.name,
        toughness=toughness,
        entry=entry,
        dent=dent,
        force=float(np.mean(forces[-len(forces) // 3 :])),
        area=area,
        work=float(energy[0]),
        stored=stored_in(scene.simulation),
        damped=float(energy[1]),
        made=toughness * area,
        opened=opened,
        tick=float(np.median(measured)),
        p99=float(np.percentile(measured, 99.0)),
        longest=float(measured.max()),
        faults=int(state.count.faults),
    )


def stored_in(simulation: Simulation) -> float:
    """Return the energy in the tissue and in what yields to the forces at the places of blades, J."""
    places = simulation.state.blades
    return simulation.energy.total + 0.5 * GIVE * float(np.square(places.force[places.embedded]).sum())


def _hand_over(before: Simulation, after: Simulation, clock: Longs) -> None:
    """Tick an organ that isn't needed any more, and preload the one that continues it, as the node's loop does."""
    provide((after.model, after.state.words, after.scratch))
    for _ in range(TICKS_ON):
        _tick(before.world, np.zeros(2), clock)
    preload(after.world)


@numba.njit(nogil=True, error_model="numpy")
def _tick(world: World, energy: Floats, clock: Longs) -> int:
    """Advance an organ alone as `tick` does, and return the time that this takes, ns.

    The work of the first body and what damping takes, J, are added to energy (2,).
    """
    taken, begun, plan = 0, now(clock), world.scratch.plan
    plan.handled = world.state.status.loaded > 0
    if not plan_tick(world):
        return now(clock) - begun
    begin_tick(world)
    step, velocity, damping = world.settings.tick_time / plan.substeps, world.state.velocity, world.model.damping
    pose, impulse = world.state.body_pose[0], world.scratch.impulse[0]
    for substep in range(plan.substeps):
        x, y, z, px, py, pz = pose[0], pose[1], pose[2], impulse[0], impulse[1], impulse[2]
        take_substep(world, substep)
        taken += now(clock) - begun
        along = (
            (impulse[0] - px) * (pose[0] - x) + (impulse[1] - py) * (pose[1] - y) + (impulse[2] - pz) * (pose[2] - z)
        )
        energy[0] += along / step
        for node in range(len(velocity)):
            speed = velocity[node]
            energy[1] += step * damping[node] * (speed[0] ** 2 + speed[1] ** 2 + speed[2] ** 2)
        begun = now(clock)
    end_tick(world)
    return taken + now(clock) - begun


def place(organ: Organ) -> tuple[Floats, Floats, Floats]:
    """Return where a blade's tip begins on the surface (3,), the direction into it, and its quaternion."""
    surface = organ.surface_positions
    away = cKDTree(organ.rest_positions[organ.fixed]).query(surface)[0]
    middle = surface.mean(axis=0)
    node = int(np.argmax(away - 0.5 * np.abs(surface - middle).max(axis=1)))
    near = np.argsort(np.linalg.norm(surface - surface[node], axis=1))[:PATCH]
    into = -surface_normals(surface, organ.surface_triangles)[near].mean(axis=0)
    into /= np.linalg.norm(into)
    axes = np.linalg.svd(surface - middle, full_matrices=False)[2]
    along = axes[0] - (axes[0] @ into) * into
    along /= np.linalg.norm(along)
    # The edge runs from the tip along -z, and cuts towards x.
    turn = Rotation.from_matrix(np.stack([into, np.cross(-along, into), -along], axis=1)).as_quat()
    return surface[node] - 0.5 * LENGTH * along - RADIUS * into, into, turn


def as_json(found: Sequence[BladeRun]) -> JsonObject:
    """Return all figures and their bounds."""
    bounds = [
        Bound("work that is unaccounted for, worst", 100.0 * max(abs(one.rest) for one in found), MOST_REST, "%"),
        Bound("tick while a blade cuts, p99", 1e6 * max(one.p99 for one in found), MOST_P99, "us"),
        Bound("tick while a blade cuts, longest", 1e6 * max(one.longest for one in found), MOST_TICK, "us"),
        Bound("faults", float(sum(one.faults for one in found)), 0.0, ""),
    ]
    return {"blades": [one._asdict() for one in found], "bounds": [bound.as_json() for bound in bounds]}


def text(found: JsonObject) -> str:
    """Return the figures as a table, a row for each toughness."""
    head = ["J/m^2", "entry N", "dent mm", "cutting N", "area mm^2", "work mJ", "stored", "damped", "area's", "rest %"]
    table = [[*head, "opened", "tick us", "p99", "longest"]]
    for each in found["blades"]:
        one = BladeRun(**each)
        energies = [f"{1e3 * energy:.2f}" for energy in (one.work, one.stored, one.damped, one.made)]
        table.append(
            [
                f"{one.toughness:g}",
                f"{one.entry:.2f}",
                f"{1e3 * one.dent:.1f}",
                f"{one.force:.2f}",
                f"{1e6 * one.area:.0f}",
                *energies,
                f"{100.0 * one.rest:.1f}",
                str(one.opened),
                *(f"{1e6 * seconds:.0f}" for seconds in (one.tick, one.p99, one.longest)),
            ]
        )
    organ = found["blades"][0]["organ"] if found["blades"] else ""
    pressed = f"pressed in by {1e3 * DEPTH:.0f} mm at {1e3 * SPEED:.0f} mm/s"
    title = f"organ '{organ}': a blade of {1e3 * LENGTH:.0f} mm, {pressed}"
    return "\n".join([title, *aligned(table), "", *bound_lines(found["bounds"])])
