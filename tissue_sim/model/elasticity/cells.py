"""Cells: linear tetrahedra of a compressible neo-Hookean solid (cell_law), each with its own stiffness.

Cells of the whole organ are evaluated in cell groups, those of a local region one by one.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csc_array

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.data.blocks import BLOCK, aligned, pack
from tissue_sim.model.data.model import Model, Tissue
from tissue_sim.model.elasticity.cell_groups import ROOM, cell_groups_of, set_penalty
from tissue_sim.model.elasticity.cell_law import COMPRESSED, STEEPEST, STIFF, minor, pressure_of
from tissue_sim.model.elasticity.stiffening import stiffening_energy
from tissue_sim.model.elasticity.vectors import ROW, WIDTH, fused, gather_arms, put_node, scatter_arms
from tissue_sim.model.elasticity.volumes import triple_product

# Ratio of the squared frequency of one cell's penalty to the largest at rest. With 1 the step is too long for several
# compressed cells together, with 0.1 cells are inverted (measured under a pinch).
PENALTY = 0.3
CONSTANTS = 10
SLOPES = 20  # constants of a cell that is linear about rest


def tissue_of(rest: Floats, cells: Ints, mu: Floats, lam: Floats, stiffening: float = 0.0) -> Tissue:
    """Return cells in blocks for the kernels, without the penalty; see `with_penalty`.

    Parameters
    ----------
    rest : Floats, shape (n, 3), m
        Positions of the nodes at rest.
    cells : Ints, shape (c, 4)
        Node indices of the cells, of positive volume.
    mu : Floats, shape (c,), Pa
        Shear modulus of each cell.
    lam : Floats, shape (c,), Pa
        Lame's first constant of each cell.
    stiffening : float, optional
        Demiray's b; 0 for neo-Hookean cells.
    """
    slope, volume = shapes_of(rest, cells)
    metric = np.einsum("cax,cbx->cab", slope[:, 1:], slope[:, 1:]) * (mu * volume)[:, None, None]
    constants = np.zeros((len(cells), CONSTANTS))
    for row, (a, b) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
        constants[:, row] = metric[:, a, b]
    constants[:, 6] = 1.0 / (6.0 * volume)
    constants[:, 7], constants[:, 8] = lam / 12.0, mu / 6.0
    # The padding is the first cell without stiffness: it has a volume, so that it doesn't count as compressed.
    spare = -len(cells) % BLOCK
    filling = np.zeros((spare, CONSTANTS))
    filling[:, 6] = constants[0, 6]
    packed = pack(
        np.concatenate([cells, cells[:1].repeat(spare, axis=0)]), np.concatenate([constants, filling]), constants[0]
    )
    groups = cell_groups_of(rest, cells, slope, mu, lam, stiffening)
    return Tissue(
        packed.nodes,
        packed.constants,
        groups,
        aligned(np.zeros((len(rest), ROW))),
        aligned(np.zeros(ROOM * BLOCK)),
        np.zeros(groups.cells.size, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
        np.ones(1, dtype=np.int64),
    )


def shapes_of(rest: Floats, cells: Ints | Longs) -> tuple[Floats, Floats]:
    """Return the gradients of the nodes' shape functions and the volumes of cells.

    Parameters
    ----------
    rest : Floats, shape (n, 3), m
        Positions of the nodes at rest.
    cells : Ints | Longs, shape (c, 4)
        Node indices of the cells.

    Returns
    -------
    tuple[Floats, Floats]
        Gradients, shape (c, 4, 3), 1/m, and volumes, shape (c,), m^3.
    """
    corner = rest[cells]
    a, b, c = (corner[:, k] - corner[:, 0] for k in (1, 2, 3))
    six = triple_product(a, b, c)
    first, second, third = (np.cross(*pair) / six[:, None] for pair in ((b, c), (c, a), (a, b)))
    return np.stack([-(first + second + third), first, second, third], axis=1), six / 6.0


def penalty_of(rest: Floats, cells: Ints, inverse_mass: Floats, frequency: float) -> Floats:
    """Return the penalty on compressed cells.

    Parameters
    ----------
    rest : Floats, shape (n, 3), m
        Positions of the nodes at rest.
    cells : Ints, shape (c, 4)
        Node indices of the cells.
    inverse_mass : Floats, shape (n,), 1/kg
        Inverse masses of the nodes.
    frequency : float, rad/s
        Largest frequency about rest.

    Returns
    -------
    Floats, shape (c,), J/m^3
        Penalty.
    """
    slope, volume = shapes_of(rest, cells)  # these are also the gradients of J by each node
    give = np.einsum("cnx,cnx,cn->c", slope, slope, inverse_mass[cells])  # of J to an impulse, 1/(m^2 kg)
    penalty = np.zeros(len(cells))
    free = give > 0.0
    penalty[free] = PENALTY * frequency**2 / give[free] / volume[free]
    return penalty


def with_penalty(tissue: Tissue, penalty: Floats) -> Tissue:
    """Return the same cells with a penalty on compressed ones.

    Parameters
    ----------
    tissue : Tissue
        Cells of the model.
    penalty : Floats, shape (c,), J/m^3
        Penalty.
    """
    constants = aligned(tissue.constants)
    rows = np.zeros(len(tissue.nodes) * BLOCK)
    rows[: len(penalty)] = penalty / 6.0
    constants[:, 9 * BLOCK :] = rows.reshape(-1, BLOCK)
    set_penalty(tissue.groups, penalty)
    return tissue._replace(constants=constants)


@kernel
def _pull(s: float, j: float, t: float, k: float, u: float, m: float, pressure: float, normal: float) -> float:
    """Return s j + t k + u m + pressure normal."""
    return fused(s, j, fused(t, k, fused(u, m, pressure * normal)))


@kernel
def _resist(work: Floats, constant: Floats) -> int:
    """Replace the arms of a block by the forces of the last three nodes on the first; return how many are stiff."""
    stiff = 0
    for c in range(BLOCK):
        jx, jy, jz = work[c], work[BLOCK + c], work[2 * BLOCK + c]
        kx, ky, kz = work[3 * BLOCK + c], work[4 * BLOCK + c], work[5 * BLOCK + c]
        mx, my, mz = work[6 * BLOCK + c], work[7 * BLOCK + c], work[8 * BLOCK + c]
        ax, ay, az = minor(ky, mz, kz, my), minor(kz, mx, kx, mz), minor(kx, my, ky, mx)
        bx, by, bz = minor(my, jz, mz, jy), minor(mz, jx, mx, jz), minor(mx, jy, my, jx)
        dx, dy, dz = minor(jy, kz, jz, ky), minor(jz, kx, jx, kz), minor(jx, ky, jy, kx)
        volume = fused(jx, ax, fused(jy, ay, jz * az)) * constant[6 * BLOCK + c]
        stiff += volume < STIFF
        pressure = pressure_of(volume, constant[7 * BLOCK + c], constant[8 * BLOCK + c], constant[9 * BLOCK + c])
        s11, s12, s13 = constant[c], constant[BLOCK + c], constant[2 * BLOCK + c]
        s22, s23, s33 = constant[3 * BLOCK + c], constant[4 * BLOCK + c], constant[5 * BLOCK + c]
        work[c] = _pull(s11, jx, s12, kx, s13, mx, pressure, ax)
        work[BLOCK + c] = _pull(s11, jy, s12, ky, s13, my, pressure, ay)
        work[2 * BLOCK + c] = _pull(s11, jz, s12, kz, s13, mz, pressure, az)
        work[3 * BLOCK + c] = _pull(s12, jx, s22, kx, s23, mx, pressure, bx)
        work[4 * BLOCK + c] = _pull(s12, jy, s22, ky, s23, my, pressure, by)
        work[5 * BLOCK + c] = _pull(s12, jz, s22, kz, s23, mz, pressure, bz)
        work[6 * BLOCK + c] = _pull(s13, jx, s23, kx, s33, mx, pressure, dx)
        work[7 * BLOCK + c] = _pull(s13, jy, s23, ky, s33, my, pressure, dy)
        work[8 * BLOCK + c] = _pull(s13, jz, s23, kz, s33, mz, pressure, dz)
    return stiff


@kernel
def _spread(position: Floats, among: Ints, tissue: Tissue) -> None:
    """Write the positions of nodes among (k,) to the rows from which blocks are gathered, and clear their forces."""
    for index in range(len(among)):
        put_node(position, among[index], tissue.rows)


@kernel
def _add_scattered(tissue: Tissue, among: Ints, fraction: float, force: Floats) -> None:
    """Add a fraction of the forces scattered to nodes among (k,) to force (n, 3) N."""
    for index in range(len(among)):
        node = among[index]
        for axis in range(3):
            force[node, axis] += fraction * tissue.rows[node, WIDTH + axis]


@kernel
def cell_forces_among(
    position: Floats, among: Ints, nodes: Ints, constants: Floats, tissue: Tissue, work: Floats, force: Floats
) -> None:
    """Add the forces of some of the cells, in blocks of their own.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    among : Ints, shape (k,)
        All nodes of these cells.
    nodes : Ints, shape (b, BLOCK, 4)
        Node indices of the cells.
    constants : Floats, shape (b, CONSTANTS BLOCK)
        Their constants.
    tissue : Tissue
        Cells of the model.
    work : Floats
        Buffer of the block.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.
    """
    stiff = 0
    _spread(position, among, tissue)
    for block in range(len(nodes)):
        gather_arms(tissue.rows, nodes[block], work)
        stiff += _resist(work, constants[block])
        scatter_arms(tissue.rows, nodes[block], work)
    _add_scattered(tissue, among, 1.0, force)
    tissue.stiff[0] = stiff


@kernel
def subtract_linear_cells(
    position: Floats, among: Ints, nodes: Ints, slopes: Floats, tissue: Tissue, work: Floats, force: Floats
) -> None:
    """Subtract the forces that some of the cells would have if they were linear about rest.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    among : Ints, shape (k,)
        All nodes of these cells.
    nodes : Ints, shape (b, BLOCK, 4)
        Node indices of the cells.
    slopes : Floats, shape (b, SLOPES BLOCK)
        Constants of cell_slopes.
    tissue : Tissue
        Cells of the model.
    work : Floats
        Buffer of the block.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.
    """
    _spread(position, among, tissue)
    for block in range(len(nodes)):
        gather_arms(tissue.rows, nodes[block], work)
        _resist_linearly(work, slopes[block])
        scatter_arms(tissue.rows, nodes[block], work)
    _add_scattered(tissue, among, -1.0, force)


@kernel
def _resist_linearly(work: Floats, slope: Floats) -> None:
    """Replace the arms of a block by the forces of the last three nodes on the first, by Hooke's law."""
    for c in range(BLOCK):
        jx, jy, jz = work[c] - slope[c], work[BLOCK + c] - slope[BLOCK + c], work[2 * BLOCK + c] - slope[2 * BLOCK + c]
        kx, ky = work[3 * BLOCK + c] - slope[3 * BLOCK + c], work[4 * BLOCK + c] - slope[4 * BLOCK + c]
        kz, mx = work[5 * BLOCK + c] - slope[5 * BLOCK + c], work[6 * BLOCK + c] - slope[6 * BLOCK + c]
        my, mz = work[7 * BLOCK + c] - slope[7 * BLOCK + c], work[8 * BLOCK + c] - slope[8 * BLOCK + c]
        ax, ay, az = slope[9 * BLOCK + c], slope[10 * BLOCK + c], slope[11 * BLOCK + c]
        bx, by, bz = slope[12 * BLOCK + c], slope[13 * BLOCK + c], slope[14 * BLOCK + c]
        dx, dy, dz = slope[15 * BLOCK + c], slope[16 * BLOCK + c], slope[17 * BLOCK + c]
        shear = slope[18 * BLOCK + c]
        hxx, hyy, hzz = jx * ax + kx * bx + mx * dx, jy * ay + ky * by + my * dy, jz * az + kz * bz + mz * dz
        hxy = jx * ay + kx * by + mx * dy + jy * ax + ky * bx + my * dx
        hyz = jy * az + ky * bz + my * dz + jz * ay + kz * by + mz * dy
        hzx = jz * ax + kz * bx + mz * dx + jx * az + kx * bz + mx * dz
        swell = slope[19 * BLOCK + c] * (hxx + hyy + hzz)
        sxx, syy, szz = 2.0 * shear * hxx + swell, 2.0 * shear * hyy + swell, 2.0 * shear * hzz + swell
        sxy, syz, szx = shear * hxy, shear * hyz, shear * hzx
        work[c] = sxx * ax + sxy * ay + szx * az
        work[BLOCK + c] = sxy * ax + syy * ay + syz * az
        work[2 * BLOCK + c] = szx * ax + syz * ay + szz * az
        work[3 * BLOCK + c] = sxx * bx + sxy * by + szx * bz
        work[4 * BLOCK + c] = sxy * bx + syy * by + syz * bz
        work[5 * BLOCK + c] = szx * bx + syz * by + szz * bz
        work[6 * BLOCK + c] = sxx * dx + sxy * dy + szx * dz
        work[7 * BLOCK + c] = sxy * dx + syy * dy + syz * dz
        work[8 * BLOCK + c] = szx * dx + syz * dy + szz * dz


def cell_slopes(tissue: Tissue, rest: Floats) -> Floats:
    """Return the constants of the cells for subtract_linear_cells.

    These are the arms from the first node to the others, m; the gradients of these nodes' shape functions, 1/m; mu and
    lambda times the volume, J.

    Parameters
    ----------
    tissue : Tissue
        Cells of the model.
    rest : Floats, shape (n, 3), m
        Positions of the nodes at rest.

    Returns
    -------
    Floats, shape (b, SLOPES BLOCK)
        Constants, in the blocks of the tissue.
    """
    nodes, constants = tissue.nodes.reshape(-1, 4), _rows_of(tissue)
    slope, volume = shapes_of(rest, nodes)
    arms = (rest[nodes[:, 1:]] - rest[nodes[:, :1]]).reshape(-1, 9)
    moduli = np.stack([6.0 * constants[:, 8], 12.0 * constants[:, 7]], axis=1) * volume[:, None]
    return pack(nodes, np.concatenate([arms, slope[:, 1:].reshape(-1, 9), moduli], axis=1), np.zeros(SLOPES)).constants


def _rows_of(tissue: Tissue) -> Floats:
    """Return the constants (b BLOCK, CONSTANTS) of every slot."""
    return tissue.constants.reshape(-1, CONSTANTS, BLOCK).transpose(0, 2, 1).reshape(-1, CONSTANTS)


def slots_of(tissue: Tissue) -> Longs:
    """Return the slots in the blocks that contain a cell, in ascending order; the others are padding.

    Parameters
    ----------
    tissue : Tissue
        Cells of the model.

    Returns
    -------
    Longs, shape (c,)
        Slots.
    """
    return np.flatnonzero(_rows_of(tissue)[:, 8] > 0.0)


def cells_of(tissue: Tissue) -> tuple[Ints, Floats, Floats]:
    """Return the cells, their moduli and penalties.

    Parameters
    ----------
    tissue : Tissue
        Cells of the model.

    Returns
    -------
    tuple[Ints, Floats, Floats]
        Node indices, shape (c, 4), mu and lambda, shape (2, c), Pa, and penalties, shape (c,), J/m^3.
    """
    rows = _rows_of(tissue)
    real = slots_of(tissue)
    rows = rows[real]
    return tissue.nodes.reshape(-1, 4)[real], np.stack([6.0 * rows[:, 8], 12.0 * rows[:, 7]]), 6.0 * rows[:, 9]


def swelling(model: Model, position: Floats) -> Floats:
    """Return the volume ratio of every cell that the guard checks; it is negative for inverted cells.

    Parameters
    ----------
    model : Model
        Constants of the model.
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.

    Returns
    -------
    Floats, shape (c,)
        Volume ratios.
    """
    a, b, c, d = (position[model.cells[:, k]] for k in range(4))
    found: Floats = np.einsum("ck,ck->c", a - d, np.cross(b - d, c - d)) / 6.0 / model.cell_volume
    return found


def strain_rows(rest: Floats, cells: Ints | Longs) -> tuple[csc_array, Longs]:
    """Return the strains of cells about rest as a matrix; the energy is the sum of their squares times the moduli.

    Rows are in the root of m^3: for mu the strains times the root of two and the shear angles, for lambda the change of
    volume.

    Parameters
    ----------
    rest : Floats, shape (n, 3), m
        Positions of the nodes at rest.
    cells : Ints | Longs, shape (c, 4)
        Node indices of the cells.

    Returns
    -------
    tuple[csc_array, Longs]
        Matrix, shape (7c, 3n), and the modulus of each row: mu of every cell, then lambda.
    """
    slope, volume = shapes_of(rest, cells)
    count, root = len(cells), np.sqrt(volume)[:, None]
    terms = [[(axis, axis, np.sqrt(2.0))] for axis in range(3)]
    terms += [[(a, b, 1.0), (b, a, 1.0)] for a, b in ((0, 1), (0, 2), (1, 2))]
    terms += [[(axis, axis, 1.0) for axis in range(3)]]
    rows, columns, values = [], [], []
    for kind, parts in enumerate(terms):
        for axis, by, factor in parts:
            rows.append(np.repeat(kind * count + np.arange(count), 4))
            columns.append((3 * cells.astype(np.int64) + axis).ravel())
            values.append((factor * root * slope[:, :, by]).ravel())
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    owner = np.concatenate([np.tile(np.arange(count), 6), count + np.arange(count)])
    return coo_array(entries, shape=(7 * count, 3 * len(rest))).tocsc(), owner


def cell_energy(position: Floats, rest: Floats, tissue: Tissue) -> float:
    """Return the elastic energy of cells; 0 at rest.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    rest : Floats, shape (n, 3), m
        Positions of the nodes at rest.
    tissue : Tissue
        Cells of the model.

    Returns
    -------
    float, J
        The energy.
    """
    cells, (mu, lam), penalty = cells_of(tissue)
    slope, volume = shapes_of(rest, cells)
    gradient = np.einsum("cai,caj->cij", position[cells], slope)
    swollen = np.linalg.det(gradient)
    square = np.einsum("cij,cij->c", gradient, gradient)
    bounded = np.maximum(swollen, STEEPEST)
    under = swollen - bounded
    pressure = 0.5 * lam * (bounded - 1.0 / bounded) - mu / bounded
    steep = 0.5 * lam + (0.5 * lam + mu) / STEEPEST**2
    density = 0.5 * mu * (square - 3.0 - 2.0 * np.log(bounded))
    density += 0.25 * lam * (bounded**2 - 1.0 - 2.0 * np.log(bounded)) + pressure * under + 0.5 * steep * under**2
    pushed = np.minimum(swollen - COMPRESSED, 0.0)
    stored = float(volume @ (density + 0.5 * penalty * pushed**2))
    return stored + stiffening_energy(tissue.groups, square, swollen, mu * volume)
