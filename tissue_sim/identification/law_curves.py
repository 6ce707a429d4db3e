"""Force curves of tissue whose law has a number to be fitted: Demiray's b, by which it stiffens with strain.

The statics are linear in a factor on the moduli, but not in b. So the model is pressed with a few values of b, and
logarithms of forces between these are interpolated: at every depth they are smooth in log(1 + b / 4).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from tissue_sim import progress
from tissue_sim.array_types import Array, Floats, Longs, Mask
from tissue_sim.identification.force_curves import ForceCurves
from tissue_sim.organ.organ import Organ

PRESSED = np.array([0.0, 2.0, 5.0, 10.0, 20.0, 40.0])  # values of b with which the model is pressed
SOFT = 4.0  # b below which forces are about linear in it


def place_of(stiffening: Array | float) -> Floats:
    """Return where values of b lie between the least one, at 0, and the largest, at 1.

    Parameters
    ----------
    stiffening : Array | float
        The values.
    """
    return np.asarray(np.log1p(np.asarray(stiffening) / SOFT) / np.log1p(PRESSED[-1] / SOFT))


def stiffening_at(place: Array | float) -> Floats:
    """Return the values of b at places between 0 and 1, as of `place_of`.

    Parameters
    ----------
    place : Array | float
        The places.
    """
    return np.asarray(SOFT * np.expm1(np.asarray(place) * np.log1p(PRESSED[-1] / SOFT)))


_PARTS = CubicSpline(place_of(PRESSED), np.eye(len(PRESSED)))
_CHANGES = _PARTS.derivative()


class LawCurves(NamedTuple):
    """Force curves with one number of the law, between 0 and 1.

    Attributes
    ----------
    plain : ForceCurves
        Those of neo-Hookean tissue.
    growth : Floats, shape (b, c, m)
        Logarithm of the factor on the forces of all tables for each value of b.
    """

    plain: ForceCurves
    growth: Floats

    @property
    def laws(self) -> int:
        """Number of the law's unknowns, 1."""
        return 1

    def under(self, law: Floats) -> ForceCurves:
        """Return the curves for a law, (1,)."""
        return self.plain._replace(force=self.plain.force * np.exp(np.tensordot(_PARTS(law[0]), self.growth, 1)))

    def changes(self, law: Floats) -> list[ForceCurves]:
        """Return the derivative of the curves with respect to the law's number, at a law, (1,)."""
        force = self.under(law).force
        return [self.plain._replace(force=force * np.tensordot(_CHANGES(law[0]), self.growth, 1))]

    def some(self, chosen: Longs | Mask) -> LawCurves:
        """Return the curves of some presses, by index or by a mask."""
        return self._replace(plain=self.plain.some(chosen))


def law_curves_of(organ: Organ, plain: ForceCurves, pressed: Callable[[Organ], ForceCurves]) -> LawCurves:
    """Return the curves of an organ's tissue with every b.

    Parameters
    ----------
    organ : Organ
        The organ, of cells.
    plain : ForceCurves
        Its curves with neo-Hookean tissue.
    pressed : Callable[[Organ], ForceCurves]
        Returns the curves of an organ, at the same depths.
    """
    depths = plain.start[:, None] + plain.step[:, None] * np.arange(plain.force.shape[1])
    every = np.arange(len(depths))
    growth = [np.zeros_like(plain.force)]
    for stiffening in progress.steps(PRESSED[1:], "values of b"):
        curves = pressed(replace(organ, stiffening=float(stiffening)))
        force = curves._replace(which=every).at(depths)[0]
        both = (force > 0.0) & (plain.force > 0.0)
        growth.append(np.log(np.divide(force, plain.force, out=np.ones_like(force), where=both)))
    return LawCurves(plain, np.array(growth))
