"""What a fit asks of springs (static.Springs) and of cells (cells.Cells)."""

from __future__ import annotations

from typing import Protocol

from scipy.sparse import csc_array

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.factor import Factor


class Elastic(Protocol):
    """The parts of a model as functions of position (n, 3) m and stiffness (p,)."""

    rest: Floats  # (n, 3) m
    n_surface: int
    free: Longs  # coordinates that may move

    @property
    def counts(self) -> tuple[int, ...]:
        """How many stiffnesses there are of each kind."""
        ...

    def trace(self) -> Floats:
        """What a unit of each stiffness (p,) adds to the trace of the tangent at rest."""
        ...

    def energy_and_gradient(self, position: Floats, stiffness: Floats) -> tuple[float, Floats]:
        """Elastic energy, J, and its gradient (n, 3) N."""
        ...

    def sensitivity(self, position: Floats, direction: Floats) -> Floats:
        """What each stiffness adds to the energy gradient along a direction (n, 3): (p,)."""
        ...

    def tangent(self, position: Floats, stiffness: Floats, convex: bool = False) -> csc_array:
        """Second derivative of the energy over the free axes; convex: a positive definite one nearby."""
        ...

    def factor(self, tangent: csc_array) -> Factor:
        """A factored tangent."""
        ...

    def rest_tangent(self, stiffness: Floats) -> csc_array:
        """The tangent at rest."""
        ...

    def rest_sensitivity(self, answer: Floats, adjoint: Floats) -> Floats:
        """What each stiffness (p,) adds to the work that rest_tangent answer does along adjoint; both (a, r)."""
        ...
