"""The largest frequency of the assembled model, on which the critical step depends."""

from __future__ import annotations

import math

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.handles import handle
from tissue_sim.model.data.model import Model
from tissue_sim.model.elasticity.forces import elastic_forces


def largest_frequency(model: Model, iterations: int = 200, tolerance: float = 1e-4) -> float:
    """Return the largest angular frequency of the model about its rest shape.

    Power iteration on M^-1 K; K v is the central difference of the force kernels, so all kinds of springs are included
    without a second assembly.

    Parameters
    ----------
    model : Model
        Constants of the model.
    iterations : int, optional
        Largest number of iterations.
    tolerance : float, optional
        Relative change at which it has converged.

    Returns
    -------
    float, rad/s
        The frequency.
    """
    n, held = len(model.rest), handle(model)
    root = np.sqrt(model.inverse_mass)[:, None]
    vector = root * np.random.default_rng(0).standard_normal((n, 3))
    length = float(np.ptp(model.rest, axis=0).max())
    eigenvalue = 0.0
    for _ in range(iterations):
        norm = math.sqrt(_dot(vector, vector))
        if norm == 0.0:
            return 0.0
        vector /= norm
        push = root * vector
        small = 1e-7 * length / max(float(np.abs(push).max()), 1e-300)
        product = -root * (_force(model, held, push * small) - _force(model, held, -push * small)) / (2.0 * small)
        last, eigenvalue = eigenvalue, _dot(vector, product)
        vector = product
        if abs(eigenvalue - last) <= tolerance * abs(eigenvalue):
            break
    return math.sqrt(max(eigenvalue, 0.0))


def _dot(one: Floats, other: Floats) -> float:
    """Return the sum of products, without BLAS, whose rounding depends on the processor, unlike a replay."""
    return float((one * other).sum())


def _force(model: Model, held: Model, displacement: Floats) -> Floats:
    force = np.zeros_like(model.rest)
    elastic_forces(held, model.rest + displacement, 1.0, force)
    return force
