"""Force against depth of a model, tabulated, so that a fit evaluates all presses at once."""

from __future__ import annotations

from typing import NamedTuple, Protocol, Self

import numpy as np
from scipy.interpolate import PchipInterpolator

from tissue_sim.array_types import Floats, Longs, Mask

POINTS = 600  # of a table
HERTZ = 1.5  # exponent of the force of a ball on a half-space: to 1 over it, forces are nearly straight lines


class Curves(Protocol):
    """Force curves that a fit takes; some have numbers of the tissue's law, from 0 to 1, that are fitted too."""

    @property
    def laws(self) -> int:
        """Number of the law's unknowns."""

    def under(self, law: Floats) -> ForceCurves:
        """Return the curves for a law, (k,)."""

    def changes(self, law: Floats) -> list[ForceCurves]:
        """Return the derivatives of the curves with respect to each number of the law."""

    def some(self, chosen: Longs | Mask) -> Self:
        """Return the curves of some presses, by index or by a mask."""


class ForceCurves(NamedTuple):
    """Forces at equally spaced depths.

    Attributes
    ----------
    start : Floats, shape (c,), m
        Depth of each table's first entry, where there is no force.
    step : Floats, shape (c,), m
        Distance of depths.
    force : Floats, shape (c, m), N
        Forces for the modulus that the tables were computed with.
    which : Longs, shape (n,)
        Table of each press.
    """

    start: Floats
    step: Floats
    force: Floats
    which: Longs

    def at(self, depths: Floats) -> tuple[Floats, Floats]:
        """Return forces, N, and their slopes, N/m, of each press at depths (n, d) m; beyond a table by its last slope.

        Before a table begins the force is 0.
        """
        which = self.which[:, None]
        fraction = (depths - self.start[which]) / self.step[which]
        left = np.clip(fraction.astype(np.int64), 0, self.force.shape[1] - 2)
        low = self.force[which, left]
        slope = self.force[which, left + 1] - low
        inside = fraction > 0.0
        force = np.where(inside, low + (fraction - left) * slope, 0.0)
        return force, np.where(inside, slope / self.step[which], 0.0)

    def some(self, chosen: Longs | Mask) -> ForceCurves:
        """Return the curves of some presses, by index or by a mask."""
        return self._replace(which=self.which[chosen])

    @property
    def laws(self) -> int:
        """Number of the law's unknowns, 0."""
        return 0

    def under(self, law: Floats) -> ForceCurves:
        """Return these curves, whose law is given."""
        return self

    def changes(self, law: Floats) -> list[ForceCurves]:
        """Return no derivative."""
        return []


def tabulated(depths: list[Floats], forces: list[Floats], which: Longs) -> ForceCurves:
    """Return curves through computed forces.

    Parameters
    ----------
    depths : list[Floats], each of shape (k,), m
        Where forces of a curve are known, ascending.
    forces : list[Floats], each of shape (k,), N
        Those forces.
    which : Longs, shape (n,)
        Curve of each press.

    Returns
    -------
    ForceCurves
        Tables of monotone interpolations.
    """
    starts, steps, tables = [], [], []
    for depth, force in zip(depths, forces, strict=True):
        first = max(int(np.argmax(force > 0.0)), 1) if (force > 0.0).any() else len(force) - 1
        touched = _touch(depth[first - 1 :], force[first - 1 :])
        known = np.concatenate([[touched], depth[first:]])
        straight = np.concatenate([[0.0], np.maximum(force[first:], 0.0) ** (1.0 / HERTZ)])
        dense = np.linspace(touched, depth[-1], POINTS)
        tables.append(np.maximum(PchipInterpolator(known, straight)(dense), 0.0) ** HERTZ)
        starts.append(touched)
        steps.append(dense[1] - dense[0])
    return ForceCurves(np.array(starts), np.array(steps), np.array(tables), np.asarray(which, dtype=np.int64))


def _touch(depth: Floats, force: Floats) -> float:
    """Return where a ball first touches, m, from the last depth without force and the first two with it."""
    low, high = float(depth[0]), float(depth[1])
    if len(depth) < 3 or not force[2] > force[1] > 0.0:
        return min(low, high - 1e-6)
    one, two = force[1] ** (1.0 / HERTZ), force[2] ** (1.0 / HERTZ)
    touch = high - one * (depth[2] - high) / (two - one)
    return float(np.clip(touch, low, high - 1e-6))


def hertz(radius: float, modulus: float, poisson_ratio: float, deepest: float) -> tuple[Floats, Floats]:
    """Return depths (k,) m and forces (k,) N of a rigid ball on an elastic half-space (Hertz 1882).

    radius m; modulus Pa; deepest m.
    """
    depth = np.linspace(0.0, deepest, POINTS)
    return depth, 4.0 / 3.0 * modulus / (1.0 - poisson_ratio**2) * np.sqrt(radius) * depth**HERTZ


def bonded_layer(
    radius: float, modulus: float, poisson_ratio: float, deepest: float, thickness: float
) -> tuple[Floats, Floats]:
    """Return depths (k,) m and forces (k,) N of a rigid ball on a linearly elastic layer bonded to a rigid base.

    radius, deepest, thickness m; modulus Pa. Dimitriadis et al., Biophysical Journal 82 (2002), equation 12.
    """
    depth, force = hertz(radius, modulus, poisson_ratio, deepest)
    nu, pi = poisson_ratio, np.pi
    first = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1.0 - nu)
    second = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1.0 - nu)
    fraction = np.sqrt(radius * depth) / thickness
    factor = (
        1.0
        - 2.0 * first / pi * fraction
        + 4.0 * first**2 / pi**2 * fraction**2
        - 8.0 / pi**3 * (first**3 + 4.0 * pi**2 / 15.0 * second) * fraction**3
        + 16.0 * first / pi**4 * (first**3 + 3.0 * pi**2 / 5.0 * second) * fraction**4
    )
    return depth, force * factor
