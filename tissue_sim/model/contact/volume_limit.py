"""Volume limit of cells: a constraint besides those of contact, so that a tool inverts no cell.

The resistance of a cell's material law is limited by the step; the pressure of a tool is not. At MIN_VOLUME_RATIO of
its rest volume a cell can't be compressed further: an impulse along the gradient of its volume acts on its four nodes,
solved together with the contact's impulses by projected Gauss-Seidel. The gradients are those at the beginning of the
substep: in equilibrium that is also its end, and the impulse then balances the load exactly, however far the load would
have moved the nodes. Impulses start from zero in every substep, and are bounded: for cells between two tools there may
be no solution, and impulses that accumulate there throw their nodes.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.records import Record
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.state import Region, State
from tissue_sim.model.elasticity.cell_groups import listed_cell

MIN_VOLUME_RATIO = 0.1  # of the rest volume; with 0.2 nodes are thrown under the deepest pinch
NEARLY = 0.2  # volume ratio above the limit up to which cells are listed, as they may fall below it meanwhile
RECOVERY_RATE = 200.0  # 1/s, largest rate at which a cell that was below the limit returns
MAX_PRESSURE = 8.0  # largest pressure by the limit, relative to that of the penalty for the whole volume
MAX_COMPRESSED = 256  # cells resolved in a substep
# Passes over cells and contact points while cells are compressed; the remaining error is resolved in later substeps.
COMPRESSED_PASSES = 4
SETTLED = 0.2  # fraction of the impulses on cells that a pass may still change


class CompressedCell(Record):
    """Cell compressed to MIN_VOLUME_RATIO of its rest volume in a substep, or nearly so."""

    node: Annotated[Longs, (4,)]
    inverse: float  # 1 / (6 V), 1/m^3
    least: float  # the least volume ratio allowed
    stiffness: float  # N m s, the impulse that corrects a ratio that is short by 1
    impulse: float  # N m s, impulse so far
    most: float  # N m s, largest impulse allowed
    size: float  # 1/m, norm of all gradients together
    gradient: Annotated[Floats, (4, 3)]  # 1/m, of the volume ratio by each node


@kernel
def _has_stiff_cells(model: Model) -> bool:
    tissue: Any = model.tissue
    return tissue.stiff[0] > 0


@kernel
def _has_no_stiff_cells(model: Model) -> bool:
    return False


@chosen(lambda model: _has_stiff_cells if has(model, "tissue") else _has_no_stiff_cells)
def has_compressed_cells(model: Model) -> Any:
    """Return whether the last forces found cells so compressed that they require shorter substeps.

    Parameters
    ----------
    model : Model
        Constants of the model.
    """


@kernel
def volume_of(position: Floats, nodes: Longs | tuple[int, int, int, int], inverse: float) -> float:
    """Return the volume of a cell over that at rest; inverse: 1 / (6 V), 1/m^3."""
    i, j, k, m = nodes[0], nodes[1], nodes[2], nodes[3]
    x, y, z = position[i, 0], position[i, 1], position[i, 2]
    jx, jy, jz = position[j, 0] - x, position[j, 1] - y, position[j, 2] - z
    kx, ky, kz = position[k, 0] - x, position[k, 1] - y, position[k, 2] - z
    mx, my, mz = position[m, 0] - x, position[m, 1] - y, position[m, 2] - z
    return inverse * (jx * (ky * mz - kz * my) + jy * (kz * mx - kx * mz) + jz * (kx * my - ky * mx))


@kernel
def slopes_of(position: Floats, velocity: Floats, back: float, nodes: Longs, inverse: float, slope: Floats) -> float:
    """Return a cell's volume ratio `back` seconds ago; write its gradient by each node to slope (4, 3) 1/m."""
    for corner in range(4):
        node = nodes[corner]
        for axis in range(3):
            slope[corner, axis] = position[node, axis] - back * velocity[node, axis]
    x, y, z = slope[0, 0], slope[0, 1], slope[0, 2]
    jx, jy, jz = slope[1, 0] - x, slope[1, 1] - y, slope[1, 2] - z
    kx, ky, kz = slope[2, 0] - x, slope[2, 1] - y, slope[2, 2] - z
    mx, my, mz = slope[3, 0] - x, slope[3, 1] - y, slope[3, 2] - z
    ax, ay, az = inverse * (ky * mz - kz * my), inverse * (kz * mx - kx * mz), inverse * (kx * my - ky * mx)
    bx, by, bz = inverse * (my * jz - mz * jy), inverse * (mz * jx - mx * jz), inverse * (mx * jy - my * jx)
    dx, dy, dz = inverse * (jy * kz - jz * ky), inverse * (jz * kx - jx * kz), inverse * (jx * ky - jy * kx)
    slope[0, 0], slope[0, 1], slope[0, 2] = -ax - bx - dx, -ay - by - dy, -az - bz - dz
    slope[1, 0], slope[1, 1], slope[1, 2] = ax, ay, az
    slope[2, 0], slope[2, 1], slope[2, 2] = bx, by, bz
    slope[3, 0], slope[3, 1], slope[3, 2] = dx, dy, dz
    return jx * ax + jy * ay + jz * az


@kernel
def _find(model: Model, state: State, scratch: Scratch, step: float) -> int:
    tissue: Any = model.tissue
    found = 0
    if state.status.region != Region.WHOLE:
        return 0
    for index in range(tissue.stiff[0]):
        if found < len(scratch.compressed):
            nodes, inverse, penalty = listed_cell(tissue, index)
            cell = scratch.compressed[found]
            cell.node[0], cell.node[1], cell.node[2], cell.node[3] = nodes
            if _take(state, scratch.mobility, cell, inverse, penalty, step):
                found += 1
    return found


@kernel
def _none(model: Model, state: State, scratch: Scratch, step: float) -> int:
    return 0


@chosen(lambda model, *_: _find if has(model, "tissue") else _none)
def find_compressed_cells(model: Model, state: State, scratch: Scratch, step: float) -> Any:
    """List cells compressed to MIN_VOLUME_RATIO, or nearly so, in scratch.compressed; return their number.

    Only the whole organ's cells are listed, not those of a local region.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation.
    scratch : Scratch
        Working memory; updated.
    step : float, s
        The substep.
    """


@kernel
def _take(state: State, mobility: Floats, cell: CompressedCell, inverse: float, penalty: float, step: float) -> bool:
    """Return whether a cell is to be resolved, and fill its record; its penalty J / 6 V."""
    if volume_of(state.position, cell.node, inverse) > MIN_VOLUME_RATIO + NEARLY:
        return False
    gradient = cell.gradient
    before = slopes_of(state.position, state.velocity, step, cell.node, inverse, gradient)
    give = square = 0.0
    for corner in range(4):
        node = cell.node[corner]
        for axis in range(3):
            along = gradient[corner, axis]
            square += along * along
            give += along * along * mobility[node]
    if give == 0.0:
        return False
    cell.inverse, cell.least = inverse, min(MIN_VOLUME_RATIO, before + step * RECOVERY_RATE)
    cell.stiffness, cell.impulse, cell.most = 1.0 / (step * give), 0.0, step * MAX_PRESSURE * penalty / inverse
    cell.size = math.sqrt(square)
    return True


@kernel
def enforce_volume_limit(state: State, scratch: Scratch, found: int, step: float) -> bool:
    """Make one pass over the listed cells.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    scratch : Scratch
        Working memory; updated.
    found : int
        Number of the listed cells.
    step : float, s
        The substep.
    """
    change = total = 0.0
    for index in range(found):
        cell = scratch.compressed[index]
        ratio = volume_of(state.position, cell.node, cell.inverse)
        pushed = min(cell.most, max(0.0, cell.impulse + (cell.least - ratio) * cell.stiffness))
        more = pushed - cell.impulse
        total += cell.size * pushed
        if more == 0.0:
            continue
        cell.impulse = pushed
        change += cell.size * abs(more)
        for corner in range(4):
            node = cell.node[corner]
            move = more * scratch.mobility[node]
            for axis in range(3):
                state.velocity[node, axis] += move * cell.gradient[corner, axis]
                state.position[node, axis] += step * move * cell.gradient[corner, axis]
    return change <= SETTLED * total


def add_volume_limit_impulses(scratch: Scratch, step: float, force: Floats) -> None:
    """Add the forces of the volume limit in the last substep.

    Parameters
    ----------
    scratch : Scratch
        Working memory.
    step : float, s
        The substep.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.
    """
    cells, count = scratch.compressed, scratch.n_compressed[0]
    np.add.at(force, cells.node[:count], cells.impulse[:count, None, None] / step * cells.gradient[:count])
