"""Cells that are squeezed no further: a constraint beside those of contact, so that a tool turns none inside out.

What the law of a cell pushes back with is bounded by the step; what a tool presses is not. At LEAST of its volume at
rest a cell gives way no more: its four nodes share an impulse along the slopes of that volume, found together with the
contact's by projected Gauss-Seidel. The slopes are those where the substep began: at rest that is where it ends, and
the impulse then balances the load exactly, however far that would have carried the nodes. Impulses start from none in
every substep, and are bounded: cells between two tools may have no way out, and impulses that pile up there throw
their nodes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel
from tissue_sim.model.blocks import BLOCK
from tissue_sim.model.fans import CELLS, OWN, OWN_ROWS
from tissue_sim.model.state import Region

LEAST = 0.1  # of the volume at rest; with 0.2 nodes are thrown under the deepest pinch
NEARLY = 0.2  # more than that, from which a cell may come under it while others are resolved
RECOVERY_RATE = 200.0  # 1/s at which a cell that was under it comes back at the most
HARDEST = 8.0  # times the pressure of its penalty for the whole volume, that holds a cell at the most
MOST_SQUEEZED = 256  # cells resolved in a substep
# Over cells and contact points while cells are squeezed; what is left then, the next of so many substeps begins with.
SQUEEZED_PASSES = 4
SETTLED = 0.2  # of the impulses on cells, which a pass may still change


@kernel
def _has_stiff_cells(model: Any) -> bool:
    return model.tissue.stiff[0] > 0


@kernel
def _has_no_stiff_cells(model: Any) -> bool:
    return False


@chosen(lambda model: _has_stiff_cells if has(model, "tissue") else _has_no_stiff_cells)
def has_stiff_cells(model: Any) -> Any:
    """True when the last forces found cells that are squeezed so much that they ask for shorter substeps."""


@kernel
def volume_of(position: Any, nodes: Any, inverse: float) -> float:
    """Volume of a cell over that at rest; inverse: 1 / (6 V), 1/m^3."""
    i, j, k, m = nodes[0], nodes[1], nodes[2], nodes[3]
    x, y, z = position[i, 0], position[i, 1], position[i, 2]
    jx, jy, jz = position[j, 0] - x, position[j, 1] - y, position[j, 2] - z
    kx, ky, kz = position[k, 0] - x, position[k, 1] - y, position[k, 2] - z
    mx, my, mz = position[m, 0] - x, position[m, 1] - y, position[m, 2] - z
    return inverse * (jx * (ky * mz - kz * my) + jy * (kz * mx - kx * mz) + jz * (kx * my - ky * mx))


@kernel
def slopes_of(position: Any, velocity: Any, back: float, nodes: Any, inverse: float, slope: Any) -> float:
    """The same `back` seconds ago; its slopes by each node into slope (4, 3) 1/m."""
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
def find_squeezed(model: Any, state: Any, mobility: Any, scratch: Any, step: float) -> Any:
    """List cells that are squeezed to LEAST or nearly in scratch.squeezed; of the whole organ only. Returns how many.

    mobility (n,) 1/kg as for contact. For each scratch.squeezed (S, 6): 1 / (6 V), 1/m^3; what is left of its volume at
    the least; the impulse that makes up for a lack of all of it, N m s; that given so far, and at the most; and the
    length of the slopes together, 1/m.
    """


@kernel
def _take(
    state: Any, mobility: Any, scratch: Any, index: int, nodes: Any, inverse: float, penalty: float, step: float
) -> bool:
    """True, and a cell's row in scratch.squeezed, when it is one of those to resolve; its penalty J / 6 V."""
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
def hold_squeezed(state: Any, mobility: Any, scratch: Any, found: int, step: float) -> bool:
    """One pass over the cells that are listed; True when it changed little."""
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


def add_held(scratch: Any, step: float, force: Any) -> None:
    """Add what held the cells in the last substep, s, to force (n, 3) N."""
    held = slice(scratch.squeezing[0])
    push = scratch.squeezed[held, 3, None, None] / step * scratch.squeezed_slope[held]
    np.add.at(force, scratch.squeezed_node[held], push)
