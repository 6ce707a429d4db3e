"""Rows of `tissue_sim bench tick`: what each one times."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Unpack

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats
from tissue_sim.bench.c_loop import NATIVE, PLAIN, CLoop, CLoopError
from tissue_sim.bench.compliance import Product, surface_compliance
from tissue_sim.bench.flex import Flex
from tissue_sim.bench.organs import PATCH_NODES, patch_load
from tissue_sim.bench.printing import built_or_skipped
from tissue_sim.bench.simulation_options import SimulationOptions
from tissue_sim.bench.timing import Burst, Ticks
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.data.settings import INTEGRATORS
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_organ

FORCE = 0.1  # N on the patch
SUBSTEPS = 16  # of the tick in which a substep is timed, so that what is done once per tick counts little
TOOL_RADIUS = 0.02  # m
STIFFENS = 8.0  # b of tissue that stiffens
RELAXES = 0.3, 1.0  # fraction of its force that tissue loses, and s in which it does
TOOL_STEP = 1e-4  # m, by which it is pressed deeper every 4 ticks

# Names of rows that bounds refer to.
WHOLE = "hybrid, symplectic"
CELLS = "cells of the calibrated kidney"
GUARD = "guard of the hybrid tick"
SUBSTEP = "substep of the hybrid tick"
C_PLAIN, C_NATIVE = "the same substep in C, -O3", "the same substep in C, for this processor"
STIFFENING, RELAXING = "these cells, of tissue that stiffens", "these cells, of tissue that relaxes"
STIFFENING_SUBSTEP, RELAXING_SUBSTEP = "substep of cells that stiffen", "substep of cells that relax"
CELL_SUBSTEP, CELL_C = "substep of these cells", "the same cells in C, for this processor"
MODAL, MODAL_TOOL = "modal, 19-node patch", "modal, sphere tool"
MODAL_CELLS = "modal region of these cells"
FROZEN, ASLEEP = "frozen, 19-node patch", "asleep"
FLEX = "MuJoCo flex, 1 ms step"
PRODUCT, ALL_PRODUCT = "compliance, one patch", "compliance, all points"

Maker = Callable[[], tuple[Burst, str]]  # makes the burst of a row, and a remark on it


def make_bursts(makers: Mapping[str, Maker]) -> tuple[dict[str, Burst], dict[str, str]]:
    """Return bursts of the rows that can be measured here, and for every row a remark.

    Returns bursts and remarks by name; a remark says what the row is, or why it is skipped.
    """
    bursts: dict[str, Burst] = {}
    remarks: dict[str, str] = {}
    for name, make in progress.steps(makers.items(), "preparing"):
        burst, remarks[name] = built_or_skipped(make, CLoopError)
        if burst is not None:
            bursts[name] = burst
    return bursts, remarks


def makers_of(organ: Organ) -> dict[str, Maker]:
    """Return for each row, by name, a function that makes its burst and a remark."""
    still = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    makers: dict[str, Maker] = {
        f"hybrid, {name}": partial(_ticks, organ, model="hybrid", integrator=name) for name in INTEGRATORS
    }
    cells = Organ.load(shipped_organ())
    stiffening = replace(cells, stiffening=STIFFENS)
    relaxing = replace(cells, relaxation_fraction=RELAXES[0], relaxation_time=RELAXES[1])
    makers |= {
        CELLS: partial(_ticks, cells),
        CELL_SUBSTEP: partial(_substep, cells),
        STIFFENING: partial(_ticks, stiffening),
        STIFFENING_SUBSTEP: partial(_substep, stiffening),
        RELAXING: partial(_ticks, relaxing),
        RELAXING_SUBSTEP: partial(_substep, relaxing),
        CELL_C: partial(_c_substep, cells, NATIVE),
        MODAL_CELLS: partial(_ticks, cells, local_region="modal"),
    }
    makers |= {f"{name}, symplectic": partial(_ticks, organ, model=name) for name in ("surface", "volume")}
    return makers | {
        GUARD: partial(_guard, organ),
        SUBSTEP: partial(_substep, organ, "hybrid"),
        C_PLAIN: partial(_c_substep, organ, PLAIN, "hybrid"),
        C_NATIVE: partial(_c_substep, organ, NATIVE, "hybrid"),
        MODAL: partial(_ticks, organ, model="hybrid", local_region="modal"),
        MODAL_TOOL: partial(_pressed_tool, organ),
        FROZEN: partial(_ticks, organ, model="hybrid", local_region="frozen"),
        ASLEEP: lambda: (Ticks(Simulation(organ), *still), "untouched"),
        FLEX: partial(_flex, organ),
        PRODUCT: partial(_product, organ, all_points=False),
        ALL_PRODUCT: partial(_product, organ, all_points=True),
    }


def _ticks(organ: Organ, **options: Unpack[SimulationOptions]) -> tuple[Burst, str]:
    """Return whole ticks of a simulation with these options."""
    simulation = Simulation(organ, **options)
    burst = Ticks(simulation, *patch_load(organ, FORCE))
    burst(1)
    status = simulation.state.status
    return burst, f"{status.substeps} substeps, {status.active} nodes"


def _guard(organ: Organ) -> tuple[Burst, str]:
    """Return the check for values that are not finite, runaway and inversion, at the end of a tick."""
    simulation = Simulation(organ, model="hybrid")
    return Ticks(simulation, *patch_load(organ, FORCE), guard=True), "part of the whole tick"


def _substep(organ: Organ, model: str = "auto") -> tuple[Burst, str]:
    simulation = Simulation(organ, model=model, substeps=SUBSTEPS)
    ticks = Ticks(simulation, *patch_load(organ, FORCE))

    def burst(count: int) -> Floats:
        return ticks(count) / SUBSTEPS

    return burst, f"a {SUBSTEPS}th of a tick of {SUBSTEPS} substeps"


def _c_substep(organ: Organ, flags: tuple[str, ...], model: str = "auto") -> tuple[Burst, str]:
    loop = CLoop(Simulation(organ, model=model, substeps=SUBSTEPS), flags, *patch_load(organ, FORCE))
    return loop, f"cc {' '.join(flags)}; differs from the kernel's by {loop.compare():.0e}"


def _pressed_tool(organ: Organ) -> tuple[Burst, str]:
    """Return ticks with a ball held in the broad side, where it touches as many nodes as the patch has."""
    scene = Scene(organ, [Tool("ball", radius=TOOL_RADIUS)], model="hybrid", local_region="modal")
    nodes, forces = patch_load(organ, 1.0, 1)
    inward, at = forces[0], organ.surface_positions[nodes[0]]
    state = scene.simulation.state

    def press(depth: float, ticks: int) -> None:
        for _ in range(ticks):
            scene.move(0, at + (depth - TOOL_RADIUS) * inward)
            scene.step()

    depth = -0.001
    while state.status.touching < PATCH_NODES and depth < 0.5 * TOOL_RADIUS:
        depth += TOOL_STEP
        press(depth, 4)
    press(depth, 200)
    burst = Ticks(scene.simulation, np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    burst(1)
    force = np.linalg.norm(scene.wrenches[0, :3])
    remark = f"{state.status.touching} of {state.contacts.header.points} contact points touch with {force:.2g} N"
    return burst, f"{remark}, {state.status.substeps} substeps, {state.status.active} nodes"


def _flex(organ: Organ) -> tuple[Burst, str]:
    flex = Flex(organ, *patch_load(organ, FORCE))
    return flex, f"{organ.n_nodes} nodes, {flex.n_tetrahedra} tetrahedra, implicit, CG"


def _product(organ: Organ, *, all_points: bool) -> tuple[Burst, str]:
    simulation = Simulation(organ, model="hybrid")
    nodes, forces = patch_load(organ, FORCE)
    if all_points:
        every = np.zeros((organ.n_surface, 3))
        every[nodes] = forces
        nodes, forces = np.arange(organ.n_surface), every
    product = Product(surface_compliance(simulation.model, nodes), forces)
    rows, columns = product.compliance.shape
    return product, f"float32, {rows} x {columns}"
