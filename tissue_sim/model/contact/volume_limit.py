"""Volume limit of cells: a constraint beside those of contact, so that a tool inverts no cell.

The resistance of a cell's material law is bounded by the step; the pressure of a tool is not. At LEAST of its rest
volume a cell yields no more: its four nodes share an impulse along the gradient of that volume, found together with the
contact's impulses by projected Gauss-Seidel. The gradients are those at the beginning of the substep: at rest that is
where it ends, and the impulse then balances the load exactly, however far that would have moved the nodes. Impulses
start from zero in every substep, and are bounded: cells between two tools may have no way out, and impulses that
accumulate there throw their nodes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel
from tissue_sim.model.data.blocks import BLOCK
from tissue_sim.model.data.state import Region
from tissue_sim.model.elasticity.cell_groups import CELLS, OWN, OWN_ROWS

LEAST = 0.1  # of the rest volume; with 0.2 nodes are thrown under the deepest pinch
NEARLY = 0.2  # above that; such a cell may fall below it while others are resolved
RECOVERY_RATE = 200.0  # 1/s; at most so fast a cell that was below the limit returns
HARDEST = 8.0  # limit of a cell's pressure, times that of its penalty for the whole volume
MOST_SQUEEZED = 256  # cells resolved in a substep
# Passes over cells and contact points while cells are squeezed; the next of the many substeps resolves what is left.
SQUEEZED_PASSES = 4
SETTLED = 0.2  # fraction of the impulses on cells that a pass may still change


@kernel
def _has_stiff_cells(model: Any) -> bool:
    return model.tissue.stiff[0] > 0


@kernel
def _has_no_stiff_cells(model: Any) -> bool:
    return False


@chosen(lambda model: _has_stiff_cells if has(model, "tissue") else _has_no_stiff_cells)
def has_compressed_cells(model: Any) -> Any:
    """Return whether the last forces found cells so squeezed that they require shorter substeps.

    Parameters
    ----------
    model : Any
        Constants of the model.
    """


@kernel
def volume_of(position: Any, nodes: Any, inverse: float) -> float:
    """Return the volume of a cell over that at rest; inverse: 1 / (6 V), 1/m^3."""
    i, j, k, m = nodes[0], nodes[1], nodes[2], nodes[3]
    x, y, z = position[i, 0], position[i, 1], position[i, 2]
    jx, jy, jz = position[j, 0] - x, position[j, 1] - y, position[j, 2] - z
    kx, ky, kz = position[k, 0] - x, position[k, 1] - y, position[k, 2] - z
    mx, my, mz = position[m, 0] - x, position[m, 1] - y, position[m, 2] - z
    return inverse * (jx * (ky * mz - kz * my) + jy * (kz * mx - kx * mz) + jz * (kx * my - ky * mx))


@kernel
def slopes_of(position: Any, velocity: Any, back: float, nodes: Any, inverse: float, slope: Any) -> float:
    """Return that ratio `back` seconds ago; write its gradient by each node to slope (4, 3) 1/m."""
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
def _find(model: Any, state: Any, mobility: Any, scratch: Any, step: float) -> int:
    tissue, found = model.tissue, 0
    if state.status.region != Region.WHOLE:
        return 0
    for index in range(tissue.stiff[0]):
        fan, which = divmod(tissue.squeezed_cells[index], CELLS)
        block, c = divmod(fan, BLOCK)
        constant, node = tissue.fans.constants[block], tissue.fans.nodes[block, c]
        own = OWN + OWN_ROWS * which
        if found < len(scratch.squeezed):
            inverse, penalty = constant[own * BLOCK + c], constant[(own + 3) * BLOCK + c]
            nodes = node[0], node[1], node[2 + which], node[3 + which]
            if _take(state, mobility, scratch, found, nodes, inverse, penalty, step):
                found += 1
    return found


@kernel
def _none(model: Any, state: Any, mobility: Any, scratch: Any, step: float) -> int:
    return 0


@chosen(lambda model, *_: _find if has(model, "tissue") else _none)
def find_compressed_cells(model: Any, state: Any, mobility: Any, scratch: Any, step: float) -> Any:
    """List cells squeezed to LEAST or nearly so in scratch.squeezed; return their number.

    Only the whole organ's cells are listed, not those of a local region. A row of scratch.squeezed (S, 6) holds 1 / (6
    V), 1/m^3; the least volume ratio allowed; the impulse that corrects a ratio that is short by 1, N m s; the impulse
    given so far; the largest one allowed; and the length of the gradients together, 1/m.

    Parameters
    ----------
    model : Any
        Constants of the model.
    state : Any
        State of the simulation.
    mobility : Any, shape (n,), 1/kg
        Velocity that a unit impulse gives each node.
    scratch : Any
        Working memory; updated.
    step : float, s
        The substep.
    """


@kernel
def _take(
    state: Any, mobility: Any, scratch: Any, index: int, nodes: Any, inverse: float, penalty: float, step: float
) -> bool:
    """Return whether a cell is to be resolved, and fill its row of scratch.squeezed; its penalty J / 6 V."""
    if volume_of(state.position, nodes, inverse) > LEAST + NEARLY:
        return False
    slope = scratch.squeezed_slope[index]
    before = slopes_of(state.position, state.velocity, step, nodes, inverse, slope)
    give = square = 0.0
    for corner in range(4):
        node = nodes[corner]
        scratch.squeezed_node[index, corner] = node
        for axis in range(3):
            along = slope[corner, axis]
            square += along * along
            give += along * along * mobility[node]
    if give == 0.0:
        return False
    row = scratch.squeezed[index]
    row[0], row[1] = inverse, min(LEAST, before + step * RECOVERY_RATE)
    row[2], row[3], row[4], row[5] = 1.0 / (step * give), 0.0, step * HARDEST * penalty / inverse, math.sqrt(square)
    return True


@kernel
def enforce_volume_limit(state: Any, mobility: Any, scratch: Any, found: int, step: float) -> bool:
    """Make one pass over the listed cells.

    Parameters
    ----------
    state : Any
        State of the simulation; updated.
    mobility : Any, shape (n,), 1/kg
        Velocity that a unit impulse gives each node.
    scratch : Any
        Working memory; updated.
    found : int
        Number of the listed cells.
    step : float, s
        The substep.

    Returns
    -------
    bool
        True when the impulses changed little.
    """
    change = total = 0.0
    for index in range(found):
        row, nodes, slope = scratch.squeezed[index], scratch.squeezed_node[index], scratch.squeezed_slope[index]
        swollen = volume_of(state.position, nodes, row[0])
        pushed = min(row[4], max(0.0, row[3] + (row[1] - swollen) * row[2]))
        more = pushed - row[3]
        total += row[5] * pushed
        if more == 0.0:
            continue
        row[3] = pushed
        change += row[5] * abs(more)
        for corner in range(4):
            node = nodes[corner]
            move = more * mobility[node]
            for axis in range(3):
                state.velocity[node, axis] += move * slope[corner, axis]
                state.position[node, axis] += step * move * slope[corner, axis]
    return change <= SETTLED * total


def add_volume_limit_impulses(scratch: Any, step: float, force: Any) -> None:
    """Add the forces of the volume limit in the last substep.

    Parameters
    ----------
    scratch : Any
        Working memory.
    step : float, s
        The substep.
    force : Any, shape (n, 3), N
        Forces on the nodes; updated.
    """
    held = slice(scratch.squeezing[0])
    push = scratch.squeezed[held, 3, None, None] / step * scratch.squeezed_slope[held]
    np.add.at(force, scratch.squeezed_node[held], push)
