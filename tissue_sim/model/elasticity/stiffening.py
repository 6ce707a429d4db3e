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

# Constants of a group: b / M, 1/J, b times each of its three cells' fraction of M, and the exponents from which
# substeps must be half and a quarter as long.
ROWS = 6
MOST = 3.0  # largest exponent b z
# The squared frequency of a group grows by the factor 1 + GROWTH (4 y exp(y) + exp(y) - 1); the bracket is the growth
# of its stiffness in shear, in the direction of the strain. GROWTH was measured on bars and balls under uniform strain.
GROWTH = 0.03
ALLOWED = (1.15, 3.6)  # times the largest squared frequency at rest: in steps as at rest, and in steps half as long
# Rows of a group's constants in cell_groups: 1 / (6 V) and mu / 6 of each cell.
_INVERSE, _SHEAR = (12, 16, 20), (14, 18, 22)


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
    found: Floats = aligned(np.concatenate([inverse, inverse * weight, limits], axis=1).reshape(len(constants), -1))
    return found


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
def undistorted(volume: float) -> float:
    """Return 3 J^(2/3) to the second order: F:F of a cell that has changed its volume without distortion.

    Parameters
    ----------
    volume : float
        Volume over that at rest, J.
    """
    return fused(volume, fused(volume, -1.0 / 3.0, 8.0 / 3.0), 2.0 / 3.0)


@kernel
def undistorted_slope(volume: float) -> float:
    """Return the derivative of `undistorted`.

    Parameters
    ----------
    volume : float
        Volume over that at rest, J.
    """
    return fused(volume, -2.0 / 3.0, 8.0 / 3.0)


@kernel
def exponential(exponent: float) -> float:
    """Return exp(exponent), for 0 to MOST to seven digits: the 16th power of a polynomial, which can be vectorised.

    Parameters
    ----------
    exponent : float
        The exponent.
    """
    x = 0.0625 * exponent
    tail = fused(x, fused(x, 1.0 / 720.0, 1.0 / 120.0), 1.0 / 24.0)
    part = fused(x, fused(x, fused(x, tail, 1.0 / 6.0), 0.5), 1.0)
    part = fused(x, part, 1.0)
    part *= part
    part *= part
    part *= part
    return part * part


@kernel
def _dot(ax: float, bx: float, ay: float, by: float, az: float, bz: float, more: float) -> float:
    """Return a.b + more."""
    return fused(ax, bx, fused(ay, by, fused(az, bz, more)))


@kernel
def _sum(f: float, x: float, g: float, y: float, h: float, z: float, k: float, w: float) -> float:
    """Return f x + g y + h z + k w."""
    return fused(f, x, fused(g, y, fused(h, z, k * w)))


@kernel
def resist_stiffening(work: Floats, constant: Floats, law: Floats) -> tuple[int, int]:
    """Replace the arms of a block of groups by the forces of their last five nodes on the first.

    As `cell_groups._resist`, with the factor exp(b z) on the forces of the quadratic form. Returns the numbers of stiff
    cells, and of groups that need substeps half as long.

    Parameters
    ----------
    work : Floats
        Arms, then forces; the last rows contain the cells' volume ratios and the groups' exponents afterwards.
    constant : Floats, shape (CONSTANTS BLOCK,)
        Constants of the block.
    law : Floats, shape (ROWS BLOCK,)
        Constants of `stiffening_rows`.

    Returns
    -------
    tuple[int, int]
        Numbers of cells and groups.
    """
    stiff = steep = 0
    for c in range(BLOCK):
        ex, ey, ez = work[c], work[BLOCK + c], work[2 * BLOCK + c]
        ax, ay, az = work[3 * BLOCK + c], work[4 * BLOCK + c], work[5 * BLOCK + c]
        bx, by, bz = work[6 * BLOCK + c], work[7 * BLOCK + c], work[8 * BLOCK + c]
        cx, cy, cz = work[9 * BLOCK + c], work[10 * BLOCK + c], work[11 * BLOCK + c]
        dx, dy, dz = work[12 * BLOCK + c], work[13 * BLOCK + c], work[14 * BLOCK + c]
        abx, aby, abz = minor(ay, bz, az, by), minor(az, bx, ax, bz), minor(ax, by, ay, bx)
        bcx, bcy, bcz = minor(by, cz, bz, cy), minor(bz, cx, bx, cz), minor(bx, cy, by, cx)
        cdx, cdy, cdz = minor(cy, dz, cz, dy), minor(cz, dx, cx, dz), minor(cx, dy, cy, dx)
        eax, eay, eaz = minor(ey, az, ez, ay), minor(ez, ax, ex, az), minor(ex, ay, ey, ax)
        ebx, eby, ebz = minor(ey, bz, ez, by), minor(ez, bx, ex, bz), minor(ex, by, ey, bx)
        ecx, ecy, ecz = minor(ey, cz, ez, cy), minor(ez, cx, ex, cz), minor(ex, cy, ey, cx)
        edx, edy, edz = minor(ey, dz, ez, dy), minor(ez, dx, ex, dz), minor(ex, dy, ey, dx)
        ab = fused(ex, abx, fused(ey, aby, ez * abz)) * constant[12 * BLOCK + c]
        bc = fused(ex, bcx, fused(ey, bcy, ez * bcz)) * constant[16 * BLOCK + c]
        cd = fused(ex, cdx, fused(ey, cdy, ez * cdz)) * constant[20 * BLOCK + c]
        stiff += (ab < STIFF) | (bc < STIFF) | (cd < STIFF)
        work[15 * BLOCK + c], work[16 * BLOCK + c], work[17 * BLOCK + c] = ab, bc, cd
        ee, aa, bb = constant[c], constant[BLOCK + c], constant[2 * BLOCK + c]
        cc, dd = constant[3 * BLOCK + c], constant[4 * BLOCK + c]
        ea, eb = constant[5 * BLOCK + c], constant[6 * BLOCK + c]
        ec, ed = constant[7 * BLOCK + c], constant[8 * BLOCK + c]
        s, t, u = constant[9 * BLOCK + c], constant[10 * BLOCK + c], constant[11 * BLOCK + c]
        # Forces of the quadratic form mu V F:F / 2, and its value.
        fex, fey, fez = (
            fused(ed, dx, _sum(ee, ex, ea, ax, eb, bx, ec, cx)),
            fused(ed, dy, _sum(ee, ey, ea, ay, eb, by, ec, cy)),
            fused(ed, dz, _sum(ee, ez, ea, az, eb, bz, ec, cz)),
        )
        fax, fay, faz = (
            fused(ea, ex, fused(aa, ax, s * bx)),
            fused(ea, ey, fused(aa, ay, s * by)),
            fused(ea, ez, fused(aa, az, s * bz)),
        )
        fbx, fby, fbz = (
            _sum(eb, ex, s, ax, bb, bx, t, cx),
            _sum(eb, ey, s, ay, bb, by, t, cy),
            _sum(eb, ez, s, az, bb, bz, t, cz),
        )
        fcx, fcy, fcz = (
            _sum(ec, ex, t, bx, cc, cx, u, dx),
            _sum(ec, ey, t, by, cc, cy, u, dy),
            _sum(ec, ez, t, bz, cc, cz, u, dz),
        )
        fdx, fdy, fdz = (
            fused(ed, ex, fused(u, cx, dd * dx)),
            fused(ed, ey, fused(u, cy, dd * dy)),
            fused(ed, ez, fused(u, cz, dd * dz)),
        )
        form = _dot(ex, fex, ey, fey, ez, fez, _dot(ax, fax, ay, fay, az, faz, _dot(bx, fbx, by, fby, bz, fbz, 0.0)))
        form = _dot(cx, fcx, cy, fcy, cz, fcz, _dot(dx, fdx, dy, fdy, dz, fdz, form))
        same = fused(law[BLOCK + c], undistorted(ab), law[2 * BLOCK + c] * undistorted(bc))
        y = fused(law[c], form, -fused(law[3 * BLOCK + c], undistorted(cd), same))
        y = y if y > 0.0 else 0.0
        y = y if y < MOST else MOST
        steep += y > law[4 * BLOCK + c]
        work[18 * BLOCK + c] = y
        grown = exponential(y)
        half = 0.5 - 0.5 * grown
        p = pressure_of(ab, constant[13 * BLOCK + c], constant[14 * BLOCK + c], constant[15 * BLOCK + c])
        q = pressure_of(bc, constant[17 * BLOCK + c], constant[18 * BLOCK + c], constant[19 * BLOCK + c])
        r = pressure_of(cd, constant[21 * BLOCK + c], constant[22 * BLOCK + c], constant[23 * BLOCK + c])
        p = fused(half * constant[14 * BLOCK + c], undistorted_slope(ab), p)
        q = fused(half * constant[18 * BLOCK + c], undistorted_slope(bc), q)
        r = fused(half * constant[22 * BLOCK + c], undistorted_slope(cd), r)
        work[c] = _dot(p, abx, q, bcx, r, cdx, grown * fex)
        work[BLOCK + c] = _dot(p, aby, q, bcy, r, cdy, grown * fey)
        work[2 * BLOCK + c] = _dot(p, abz, q, bcz, r, cdz, grown * fez)
        work[3 * BLOCK + c] = fused(grown, fax, -(p * ebx))
        work[4 * BLOCK + c] = fused(grown, fay, -(p * eby))
        work[5 * BLOCK + c] = fused(grown, faz, -(p * ebz))
        work[6 * BLOCK + c] = fused(grown, fbx, fused(p, eax, -(q * ecx)))
        work[7 * BLOCK + c] = fused(grown, fby, fused(p, eay, -(q * ecy)))
        work[8 * BLOCK + c] = fused(grown, fbz, fused(p, eaz, -(q * ecz)))
        work[9 * BLOCK + c] = fused(grown, fcx, fused(q, ebx, -(r * edx)))
        work[10 * BLOCK + c] = fused(grown, fcy, fused(q, eby, -(r * edy)))
        work[11 * BLOCK + c] = fused(grown, fcz, fused(q, ebz, -(r * edz)))
        work[12 * BLOCK + c] = fused(grown, fdx, r * ecx)
        work[13 * BLOCK + c] = fused(grown, fdy, r * ecy)
        work[14 * BLOCK + c] = fused(grown, fdz, r * ecz)
    return stiff, steep


@kernel
def needed_shortening(work: Floats, law: Floats) -> int:
    """Return the factor on the substeps, 2 or 4, for a block with a group that needs shorter ones.

    Parameters
    ----------
    work : Floats
        Buffer after `resist_stiffening`.
    law : Floats, shape (ROWS BLOCK,)
        Constants of `stiffening_rows`.
    """
    for c in range(BLOCK):
        if work[18 * BLOCK + c] > law[5 * BLOCK + c]:
            return 4
    return 2


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
