"""Law of a cell: a compressible neo-Hookean solid, whose pressure is bounded if a cell is nearly flat.

Energy of a cell of volume V at rest, F its deformation gradient, J = det F (Simo & Pister 1984's volumetric part): V
(mu/2 (F:F - 3 - 2 ln J) + lambda/4 (J^2 - 1 - 2 ln J)), whose pressure needs no logarithm. A cell that is nearly flat
would move too far in a step of any length: below STEEPEST of its volume the pressure continues linearly, and below
COMPRESSED a penalty is added, as stiff as the masses of its nodes allow.
"""

from __future__ import annotations

from tissue_sim.jit import kernel
from tissue_sim.model.elasticity.vectors import fused

STEEPEST = 0.4  # of the volume at rest; the pressure's slope grows as 1 / J^2
COMPRESSED = 0.5  # of the volume at rest, below which the penalty acts
STIFF = 0.6  # of the volume at rest, below which a cell needs shorter substeps than at rest


@kernel
def pressure_of(volume: float, bulk: float, shear: float, penalty: float) -> float:
    """Return a sixth of the derivative of a cell's energy by its volume, without mu/2 F:F.

    Parameters
    ----------
    volume : float
        Volume over that at rest.
    bulk : float, Pa
        lambda / 12.
    shear : float, Pa
        mu / 6.
    penalty : float, Pa
        A sixth of the penalty.

    Returns
    -------
    float, Pa
        The derivative.
    """
    bounded = volume if volume > STEEPEST else STEEPEST
    inverse = 1.0 / bounded
    under = volume - COMPRESSED
    under = under if under < 0.0 else 0.0
    pressure = bulk * (bounded - inverse) - shear * inverse
    pressure = fused(volume - bounded, fused(bulk + shear, 1.0 / STEEPEST**2, bulk), pressure)
    return fused(under, penalty, pressure)


@kernel
def minor(a: float, d: float, b: float, c: float) -> float:
    """Return a d - b c.

    Parameters
    ----------
    a, d, b, c : float
        The factors.
    """
    return fused(a, d, -(b * c))
