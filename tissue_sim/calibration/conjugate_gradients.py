"""Preconditioned conjugate gradients for many right-hand sides at once."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Protocol

import numpy as np

from tissue_sim.array_types import Floats

MOST_ITERATIONS = 400  # of conjugate gradients


class Preconditioner(Protocol):
    """Approximate solver for the displacements that forces cause."""

    def precondition(self, right: Floats) -> Floats:
        """Return displacements (3n, c) m for forces (3n, c) N."""
        ...


class Renewable(Preconditioner, Protocol):
    """Preconditioner that can be computed again about another state."""

    def renew(self, moved: Floats) -> None:
        """Compute it about a state (n, 3) m."""
        ...


def conjugate_gradients(
    apply: Callable[[Floats], Floats], right: Floats, forcing: float, factor: Preconditioner | None
) -> Generator[Floats, Floats, tuple[Floats, int]]:
    """Return the solution (n, 3), to `forcing` of the right-hand side in the preconditioner's norm, and iterations.

    Without a factor the caller preconditions what is yielded. The iteration ends at a direction of negative curvature:
    with the solution so far, or with that direction when it is the first.
    """
    solution, r, p = np.zeros_like(right), right, np.zeros_like(right)
    old = enough = 0.0
    for iteration in range(MOST_ITERATIONS + 1):
        z = (yield r) if factor is None else factor.precondition(r.reshape(-1, 1)).reshape(r.shape)
        rz = float(np.vdot(r, z))
        if iteration == 0:
            p, enough = z, forcing**2 * rz
        elif rz <= enough or iteration == MOST_ITERATIONS:
            break
        else:
            p = z + (rz / old) * p
        old = rz
        q = apply(p)
        curvature = float(np.vdot(p, q))
        if curvature <= 0.0:
            return (p if iteration == 0 else solution), iteration + 1
        alpha = rz / curvature
        solution += alpha * p
        r = r - alpha * q
    return solution, iteration
