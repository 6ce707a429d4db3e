"""Cell groups that stiffen with strain: Demiray's exponential law, one exponential for the cells of a group.

To the neo-Hookean energy of cell_law, a group of cells adds M/2 ((exp(b z) - 1)/b - z), M the sum of its cells' shear
modulus times volume, and z the mean, weighted by these, of F:F - 3 J^(2/3): the distortion, which is 0 under any change
of volume alone. At constant volume this is the energy M/(2b) (exp(b (I1 - 3)) - 1) of Demiray, the isotropic form of
Fung's. Its second derivative is 0 at rest, so that frequencies, modes and the compliance about rest are those of
neo-Hookean cells. In the kernel 3 J^(2/3) is a parabola, within 0.0014 from J = 0.8 to 1.2.

The exponent is limited to MOST: a group that is distorted further continues as a neo-Hookean one that is exp(MOST)
times as stiff. Otherwise no substep would be short enough. The exponent from which a group needs shorter substeps
depends on its nodes: if masses are large or cells soft, they vibrate so slowly at rest that they may stiffen before
they become the fastest ones.

References
----------
Fung 1967: Elasticity of soft tissues in simple elongation. Demiray 1972: A note on the elasticity of soft biological
tissues.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel
from tissue_sim.model.data.blocks import BLOCK, aligned
from tissue_sim.model.data.model import CellGroups, Model
from tissue_sim.model.elasticity.cell_law import STIFF, minor, pressure_of
from tissue_sim.model.elasticity.vectors import fused

# Constants of a group: b / M, 1/J, a third of b times each of its three cells' fraction of M, and the exponents from
# which on substeps must be half and a quarter as long.
ROWS = 6
MOST = 3.0  # largest exponent b z
# The squared frequency of a group grows by the factor 1 + GROWTH (4 y exp(y) + exp(y) - 1); the bracket is the growth
# of its stiffness in shear, in the direction of the strain. GROWTH was measured on bars and balls under uniform strain.
GROWTH = 0.03
ALLOWED = (1.15, 3.6)  # times the largest squared frequency at rest: in steps as at rest, and in steps half as long
# Rows of a group's constants in cell_groups: 1 / (6 V) and mu / 6 of each cell.
_INVERSE, _SHEAR = (12, 16, 20), (14, 18, 22)
# Rows of the buffer besides the arms: volume ratios, the exponent, forces of the quadratic form, and the factor.
_VOLUMES, _EXPONENT, _FORM, _GROWN = 15 * BLOCK, 18 * BLOCK, 19 * BLOCK, 34 * BLOCK


def stiffening_rows(constants: Floats, stiffening: float) -> Floats:
    """Return the constants that groups need in addition to their neo-Hookean ones.

    Parameters
    ----------
    constants : Floats, shape (f, CONSTANTS BLOCK)
        Their constants.
    stiffening : float
        Demiray's b; 0 for neo-Hookean cells.

    Returns
    -------
    Floats, shape (f, ROWS BLOCK)
        Constants in blocks; shape (0, ROWS BLOCK) for neo-Hookean cells. Those of padding are 0.
    """
    if stiffening == 0.0:
        return np.zeros((0, ROWS * BLOCK))
    rows = constants.reshape(len(constants), -1, BLOCK)
    weight = rows[:, _SHEAR] / rows[:, _INVERSE]  # mu V, J
    whole = weight.sum(axis=1, keepdims=True)
    inverse = np.divide(stiffening, whole, out=np.zeros_like(whole), where=whole > 0.0)
    limits = np.broadcast_to(exponents_for(np.array(ALLOWED))[:, None], (len(rows), 2, BLOCK))
    found = np.concatenate([inverse, inverse * weight / 3.0, limits], axis=1)
    return aligned(found.reshape(len(constants), -1))


def growth_of(exponent: Floats) -> Floats:
    """Return the factor by which an exponent increases a group's squared frequency.

    Parameters
    ----------
    exponent : Floats
        The exponents, b z.
    """
    grown = np.exp(exponent)
    found: Floats = 1.0 + GROWTH * (4.0 * exponent * grown + grown - 1.0)
    return found


def exponents_for(growth: Floats) -> Floats:
    """Return the exponents at which the squared frequency has grown by given factors, at most MOST.

    Parameters
    ----------
    growth : Floats
        The factors.
    """
    exponent = np.linspace(0.0, MOST, 1001)
    found: Floats = np.interp(growth, growth_of(exponent), exponent)
    return found


def set_step_limits(groups: CellGroups, quickness: Floats) -> None:
    """Set the exponents from which each group needs shorter substeps.

    Parameters
    ----------
    groups : CellGroups
        The groups; updated.
    quickness : Floats, shape (n,)
        Ratio of stiffness to mass at each node, relative to the largest ratio: about the squared frequency of its
        vibration relative to that of the fastest mode.
    """
    if len(groups.stiffening):
        own = np.maximum(quickness[groups.nodes].max(axis=2), 1e-9)  # (f, BLOCK)
        rows = groups.stiffening.reshape(len(groups.stiffening), ROWS, BLOCK)
        for row, allowed in zip((4, 5), ALLOWED, strict=True):
            rows[:, row] = exponents_for(allowed / own)


@kernel
def undistorted(short: float) -> float:
    """Return 9 J^(2/3) to the second order: three times F:F of a cell that has changed its volume without distortion.

    Its derivative by J is 2 short.

    Parameters
    ----------
    short : float
        4 - J, where J is the volume over that at rest.
    """
    return fused(-short, short, 18.0)


@kernel
def exponential(exponent: float) -> float:
    """Return exp(exponent) for 0 to MOST, to nine digits, and 1 below: the 16th power of a polynomial.

    Its degree is odd, so that it grows over all numbers, and its coefficients make the largest relative error smallest.

    Parameters
    ----------
    exponent : float
        The exponent, at most MOST.
    """
    x = 0.0625 * exponent
    square = x * x
    tail = fused(square, fused(x, 0.009068950526853, 0.041532193387529), fused(x, 0.166676808631838, 0.49999973884028))
    part = fused(square, tail, 1.0 + x)
    part = part if part > 1.0 else 1.0
    part *= part
    part *= part
    part *= part
    return part * part


@kernel
def _sum(f: float, x: float, g: float, y: float, h: float, z: float, k: float, w: float) -> float:
    """Return f x + g y + h z + k w."""
    return fused(f, x, fused(g, y, fused(h, z, k * w)))


@kernel
def resist_stiffening(work: Floats, constant: Floats, law: Floats) -> int:
    """Turn the arms of a block of groups into the forces of their last five nodes on the first.

    As `cell_groups._resist`, with the factor exp(b z) on the forces of the quadratic form. One loop finds the factor, a
    second one the forces: a single loop has more values at a time than a processor has registers, and has to wait for
    the exponential.

    Parameters
    ----------
    work : Floats
        Arms, then forces; the cells' volume ratios and the groups' exponents stay in later rows.
    constant : Floats, shape (CONSTANTS BLOCK,)
        Constants of the block.
    law : Floats, shape (ROWS BLOCK,)
        Constants of `stiffening_rows`.

    Returns
    -------
    int
        Number of groups with a stiff cell, or that need substeps half as long.
    """
    noted = _find_growth(work, constant, law)
    _resist_grown(work, constant)
    return noted


@kernel
def _find_growth(work: Floats, constant: Floats, law: Floats) -> int:
    """Write the cells' volume ratios, the forces of the quadratic form, mu V F:F over two, exponents and factors.

    The groups with a stiff cell or a large exponent are counted.
    """
    noted = 0
    for c in range(BLOCK):
        ex, ey, ez = work[c], work[BLOCK + c], work[2 * BLOCK + c]
        ax, ay, az = work[3 * BLOCK + c], work[4 * BLOCK + c], work[5 * BLOCK + c]
        bx, by, bz = work[6 * BLOCK + c], work[7 * BLOCK + c], work[8 * BLOCK + c]
        cx, cy, cz = work[9 * BLOCK + c], work[10 * BLOCK + c], work[11 * BLOCK + c]
        dx, dy, dz = work[12 * BLOCK + c], work[13 * BLOCK + c], work[14 * BLOCK + c]
        ee, aa, bb = constant[c], constant[BLOCK + c], constant[2 * BLOCK + c]
        cc, dd = constant[3 * BLOCK + c], constant[4 * BLOCK + c]
        ea, eb = constant[5 * BLOCK + c], constant[6 * BLOCK + c]
        ec, ed = constant[7 * BLOCK + c], constant[8 * BLOCK + c]
        s, t, u = constant[9 * BLOCK + c], constant[10 * BLOCK + c], constant[11 * BLOCK + c]
        fex = fused(ed, dx, _sum(ee, ex, ea, ax, eb, bx, ec, cx))
        fey = fused(ed, dy, _sum(ee, ey, ea, ay, eb, by, ec, cy))
        fez = fused(ed, dz, _sum(ee, ez, ea, az, eb, bz, ec, cz))
        fax, fay = fused(ea, ex, fused(aa, ax, s * bx)), fused(ea, ey, fused(aa, ay, s * by))
        faz = fused(ea, ez, fused(aa, az, s * bz))
        fbx, fby = _sum(eb, ex, s, ax, bb, bx, t, cx), _sum(eb, ey, s, ay, bb, by, t, cy)
        fbz = _sum(eb, ez, s, az, bb, bz, t, cz)
        fcx, fcy = _sum(ec, ex, t, bx, cc, cx, u, dx), _sum(ec, ey, t, by, cc, cy, u, dy)
        fcz = _sum(ec, ez, t, bz, cc, cz, u, dz)
        fdx, fdy = fused(ed, ex, fused(u, cx, dd * dx)), fused(ed, ey, fused(u, cy, dd * dy))
        fdz = fused(ed, ez, fused(u, cz, dd * dz))
        # Three sums side by side, so that none waits for the one before.
        form = fused(ex, fex, _sum(ax, fax, bx, fbx, cx, fcx, dx, fdx))
        form += fused(ey, fey, _sum(ay, fay, by, fby, cy, fcy, dy, fdy))
        form += fused(ez, fez, _sum(az, faz, bz, fbz, cz, fcz, dz, fdz))
        ab = fused(bx, minor(ey, az, ez, ay), fused(by, minor(ez, ax, ex, az), bz * minor(ex, ay, ey, ax)))
        bc = fused(cx, minor(ey, bz, ez, by), fused(cy, minor(ez, bx, ex, bz), cz * minor(ex, by, ey, bx)))
        cd = fused(dx, minor(ey, cz, ez, cy), fused(dy, minor(ez, cx, ex, cz), dz * minor(ex, cy, ey, cx)))
        ab, bc, cd = ab * constant[12 * BLOCK + c], bc * constant[16 * BLOCK + c], cd * constant[20 * BLOCK + c]
        same = fused(law[2 * BLOCK + c], undistorted(4.0 - bc), law[3 * BLOCK + c] * undistorted(4.0 - cd))
        y = fused(law[c], form, -fused(law[BLOCK + c], undistorted(4.0 - ab), same))
        y = y if y < MOST else MOST
        noted += (ab < STIFF) | (bc < STIFF) | (cd < STIFF) | (y > law[4 * BLOCK + c])
        work[_VOLUMES + c], work[_VOLUMES + BLOCK + c], work[_VOLUMES + 2 * BLOCK + c] = ab, bc, cd
        work[_EXPONENT + c], work[_GROWN + c] = y, exponential(y)
        work[_FORM + c], work[_FORM + BLOCK + c], work[_FORM + 2 * BLOCK + c] = fex, fey, fez
        work[_FORM + 3 * BLOCK + c], work[_FORM + 4 * BLOCK + c], work[_FORM + 5 * BLOCK + c] = fax, fay, faz
        work[_FORM + 6 * BLOCK + c], work[_FORM + 7 * BLOCK + c], work[_FORM + 8 * BLOCK + c] = fbx, fby, fbz
        work[_FORM + 9 * BLOCK + c], work[_FORM + 10 * BLOCK + c], work[_FORM + 11 * BLOCK + c] = fcx, fcy, fcz
        work[_FORM + 12 * BLOCK + c], work[_FORM + 13 * BLOCK + c], work[_FORM + 14 * BLOCK + c] = fdx, fdy, fdz
    return noted


@kernel
def _resist_grown(work: Floats, constant: Floats) -> None:
    """Turn the arms of a block into forces, with what `_find_growth` has written."""
    for c in range(BLOCK):
        ex, ey, ez = work[c], work[BLOCK + c], work[2 * BLOCK + c]
        ax, ay, az = work[3 * BLOCK + c], work[4 * BLOCK + c], work[5 * BLOCK + c]
        bx, by, bz = work[6 * BLOCK + c], work[7 * BLOCK + c], work[8 * BLOCK + c]
        cx, cy, cz = work[9 * BLOCK + c], work[10 * BLOCK + c], work[11 * BLOCK + c]
        dx, dy, dz = work[12 * BLOCK + c], work[13 * BLOCK + c], work[14 * BLOCK + c]
        ab, bc, cd = work[_VOLUMES + c], work[_VOLUMES + BLOCK + c], work[_VOLUMES + 2 * BLOCK + c]
        grown = work[_GROWN + c]
        third = fused(-1.0 / 3.0, grown, 1.0 / 3.0)
        p = pressure_of(ab, constant[13 * BLOCK + c], constant[14 * BLOCK + c], constant[15 * BLOCK + c])
        q = pressure_of(bc, constant[17 * BLOCK + c], constant[18 * BLOCK + c], constant[19 * BLOCK + c])
        r = pressure_of(cd, constant[21 * BLOCK + c], constant[22 * BLOCK + c], constant[23 * BLOCK + c])
        p = fused(third * constant[14 * BLOCK + c], 4.0 - ab, p)
        q = fused(third * constant[18 * BLOCK + c], 4.0 - bc, q)
        r = fused(third * constant[22 * BLOCK + c], 4.0 - cd, r)
        # Forces of the pressures are cross products: of e with these, from a to d, and of these with the arms, on e.
        kx, ky, kz = p * bx, p * by, p * bz
        lx, ly, lz = minor(p, ax, q, cx), minor(p, ay, q, cy), minor(p, az, q, cz)
        mx, my, mz = minor(q, bx, r, dx), minor(q, by, r, dy), minor(q, bz, r, dz)
        nx, ny, nz = r * cx, r * cy, r * cz
        around = fused(ly, bz, -fused(lz, by, minor(nz, dy, ny, dz)))
        work[c] = fused(grown, work[_FORM + c], around)
        around = fused(lz, bx, -fused(lx, bz, minor(nx, dz, nz, dx)))
        work[BLOCK + c] = fused(grown, work[_FORM + BLOCK + c], around)
        around = fused(lx, by, -fused(ly, bx, minor(ny, dx, nx, dy)))
        work[2 * BLOCK + c] = fused(grown, work[_FORM + 2 * BLOCK + c], around)
        work[3 * BLOCK + c] = fused(grown, work[_FORM + 3 * BLOCK + c], minor(ez, ky, ey, kz))
        work[4 * BLOCK + c] = fused(grown, work[_FORM + 4 * BLOCK + c], minor(ex, kz, ez, kx))
        work[5 * BLOCK + c] = fused(grown, work[_FORM + 5 * BLOCK + c], minor(ey, kx, ex, ky))
        work[6 * BLOCK + c] = fused(grown, work[_FORM + 6 * BLOCK + c], minor(ey, lz, ez, ly))
        work[7 * BLOCK + c] = fused(grown, work[_FORM + 7 * BLOCK + c], minor(ez, lx, ex, lz))
        work[8 * BLOCK + c] = fused(grown, work[_FORM + 8 * BLOCK + c], minor(ex, ly, ey, lx))
        work[9 * BLOCK + c] = fused(grown, work[_FORM + 9 * BLOCK + c], minor(ey, mz, ez, my))
        work[10 * BLOCK + c] = fused(grown, work[_FORM + 10 * BLOCK + c], minor(ez, mx, ex, mz))
        work[11 * BLOCK + c] = fused(grown, work[_FORM + 11 * BLOCK + c], minor(ex, my, ey, mx))
        work[12 * BLOCK + c] = fused(grown, work[_FORM + 12 * BLOCK + c], minor(ey, nz, ez, ny))
        work[13 * BLOCK + c] = fused(grown, work[_FORM + 13 * BLOCK + c], minor(ez, nx, ex, nz))
        work[14 * BLOCK + c] = fused(grown, work[_FORM + 14 * BLOCK + c], minor(ex, ny, ey, nx))


@kernel
def needed_shortening(work: Floats, law: Floats) -> int:
    """Return the factor on the substeps that a block needs: 1, 2 or 4.

    Parameters
    ----------
    work : Floats
        Buffer after `resist_stiffening`.
    law : Floats, shape (ROWS BLOCK,)
        Constants of `stiffening_rows`.
    """
    factor = 1
    for c in range(BLOCK):
        if work[_EXPONENT + c] > law[5 * BLOCK + c]:
            return 4
        if work[_EXPONENT + c] > law[4 * BLOCK + c]:
            factor = 2
    return factor


@kernel
def _of_cells(model: Model) -> int:
    tissue: Any = model.tissue
    return int(tissue.shortening[0])


@kernel
def _of_springs(model: Model) -> int:
    return 1


@chosen(lambda model: _of_cells if has(model, "tissue") else _of_springs)
def shortening_of(model: Model) -> Any:
    """Return the factor on the substeps that is necessary by the last forces of the whole organ: 1, 2 or 4.

    Parameters
    ----------
    model : Model
        Constants of the model.
    """


def stiffening_energy(groups: CellGroups, square: Floats, swollen: Floats, weight: Floats) -> float:
    """Return the energy that stiffening adds to the neo-Hookean energy of cells.

    Parameters
    ----------
    groups : CellGroups
        The groups.
    square : Floats, shape (c,)
        F:F of every cell.
    swollen : Floats, shape (c,)
        J of every cell.
    weight : Floats, shape (c,), J
        Shear modulus times volume of every cell.

    Returns
    -------
    float, J
        The energy.
    """
    if not len(groups.stiffening):
        return 0.0
    rows = groups.stiffening.reshape(-1, ROWS, BLOCK).transpose(0, 2, 1).reshape(-1, ROWS)
    there, own = groups.cells >= 0, groups.cells.clip(0)
    real = there.any(axis=1)
    away = swollen - 1.0
    distortion = weight * (square - (3.0 + away * (2.0 - away / 3.0)))
    exponent = np.maximum(rows[:, 0] * np.where(there, distortion[own], 0.0).sum(axis=1), 0.0)[real]
    bounded = np.minimum(exponent, MOST)
    grown = np.exp(bounded)
    return float(np.sum((grown - 1.0 - bounded + (grown - 1.0) * (exponent - bounded)) / (2.0 * rows[real, 0])))
