"""Masses and damping with which the model moves, and not only settles, as the finite-element body does.

The model's stiffness is taken as it is. Every node gets the mass of the tissue around it, at least so much that two
substeps per millisecond are stable, and then more or less, so that the lowest modes have the wanted frequencies.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize
from scipy.sparse import csc_array
from scipy.sparse.linalg import LinearOperator, eigsh
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats
from tissue_sim.calibration.elastic import Elastic
from tissue_sim.calibration.factor import Factor
from tissue_sim.errors import UserError
from tissue_sim.model.elasticity.diagonal import diagonal
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.winding import inside

MODES = 8  # lowest ones, whose frequencies are fitted
STEP = 6e-4  # s, critical step that masses make room for: two substeps a millisecond need 0.56 ms
# Fraction of the mass that may be used for this, usually and at most: a finer or stiffer organ gets a shorter step. At
# 0.9 the lowest eight modes of a kidney of 4000 points were off by 7 %, at 0.7 by 0.4 %.
USUAL_FRACTION, MOST_FRACTION = 0.6, 0.75
SPREAD = 1e-3  # weight of the mean square of the masses' logarithms, over those of the tissue around
EVALUATIONS = 15
_POINTS = 40_000  # at which the organ's volume is sampled


def tissue_mass(organ: Organ) -> Floats:
    """Return the mass of the tissue that is nearer to each node than to any other; the sum is the organ's mass.

    Held nodes and nodes without any such tissue get a small part, too.

    Parameters
    ----------
    organ : Organ
        The organ.

    Returns
    -------
    Floats, shape (n,), kg
        Masses.
    """
    low, high = organ.surface_positions.min(axis=0), organ.surface_positions.max(axis=0)
    step = float(np.prod(high - low) / _POINTS) ** (1.0 / 3.0)
    axes = [np.arange(a + 0.5 * step, b, step) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points = points[inside(points, organ.surface_positions, organ.surface_triangles)]
    nearest = cKDTree(organ.rest_positions).query(points)[1]
    count = np.maximum(np.bincount(nearest, minlength=organ.n_nodes), 0.2)
    return organ.density * organ.volume * count / count.sum()


def least_mass(elastic: Elastic, tangent: csc_array, total: float, step: float = STEP) -> Floats:
    """Return the mass (n,) kg that each node needs for a critical step, at most a fraction of `total` kg.

    The largest squared frequency is at most the largest sum of a row of |K| over the row's mass (Gershgorin).
    """
    rows = np.zeros(3 * elastic.n_nodes)
    rows[elastic.free] = np.asarray(abs(tangent).sum(axis=1)).ravel()
    needed = 0.25 * step**2 * rows.reshape(-1, 3).max(axis=1)
    fraction = max(float(needed.sum()) / total, 1e-300)
    return needed * min(1.0, min(USUAL_FRACTION * max(1.0, fraction), MOST_FRACTION) / fraction)


def fit_mass(organ: Organ, elastic: Elastic, stiffness: Floats, frequencies: Floats) -> Floats:
    """Return the masses with which the lowest modes have the wanted frequencies.

    Parameters
    ----------
    organ : Organ
        The organ.
    elastic : Elastic
        The model about rest.
    stiffness : Floats, shape (p,)
        Its stiffness.
    frequencies : Floats, shape (m,), Hz
        Wanted frequencies, ascending.

    Returns
    -------
    Floats, shape (n,), kg
        Masses, whose sum is that of the organ's volume.

    Raises
    ------
    UserError
        Where a part of the organ is free to move without any force.
    """
    tangent = elastic.tangent(stiffness)
    factor = elastic.factor(tangent)
    if not factor.is_positive:
        raise UserError(
            f"organ '{organ.name}' has parts that are not connected to its clamp; build it with more --atoms or"
            " --interior"
        )
    around, moving = tissue_mass(organ), elastic.moving
    total = float(around[moving].sum())
    least = least_mass(elastic, tangent, total)[moving]
    spare = np.maximum(around[moving] - least, 0.05 * around[moving])
    wanted = (2.0 * np.pi * np.asarray(frequencies)) ** 2
    start = np.random.default_rng(0).standard_normal(len(elastic.free))

    def spread(logarithm: Floats) -> tuple[Floats, Floats]:
        """Return the masses of the moving nodes, and the distribution of the part above the least."""
        part = spare * np.exp(logarithm)
        part /= part.sum()
        return least + (total - least.sum()) * part, part

    def objective(logarithm: Floats) -> tuple[float, Floats]:
        mass, part = spread(logarithm)
        square, shape = modes_of(tangent, factor, np.repeat(mass, 3), len(wanted), start)
        off = square / wanted - 1.0
        size = np.sum(shape.reshape(-1, 3, len(wanted)) ** 2, axis=1)  # of each mode at each node, 1/kg
        by_mass = -size @ (2.0 * off * square / wanted)
        slope = (total - least.sum()) * part * (by_mass - part @ by_mass)
        loss = float(off @ off) + SPREAD * float(np.mean(logarithm**2))
        return loss, slope + 2.0 * SPREAD / len(logarithm) * logarithm

    best = minimize(
        objective,
        np.zeros(len(spare)),
        jac=True,
        method="L-BFGS-B",
        bounds=[(-3.0, 3.0)] * len(spare),
        options={"maxfun": EVALUATIONS, "maxiter": EVALUATIONS, "ftol": 1e-9, "gtol": 0.0},
    )
    mass = around.copy()
    mass[moving] = spread(best.x)[0]
    return mass


def frequencies_of(elastic: Elastic, stiffness: Floats, mass: Floats, count: int = MODES) -> Floats:
    """Return the lowest frequencies of a model.

    Parameters
    ----------
    elastic : Elastic
        The model about rest.
    stiffness : Floats, shape (p,)
        Its stiffness.
    mass : Floats, shape (n,), kg
        Masses.
    count : int, optional
        Number of frequencies.

    Returns
    -------
    Floats, shape (count,), Hz
        Frequencies, ascending.
    """
    tangent = elastic.tangent(stiffness)
    start = np.random.default_rng(0).standard_normal(len(elastic.free))
    square, _ = modes_of(tangent, elastic.factor(tangent), np.repeat(mass, 3)[elastic.free], count, start)
    return np.sqrt(np.maximum(square, 0.0)) / (2.0 * np.pi)


def damping_rate(frequencies: Floats) -> float:
    """Return the damping that damps the lowest mode critically, so that it settles fastest without overshoot.

    Parameters
    ----------
    frequencies : Floats, Hz
        Frequencies, ascending.

    Returns
    -------
    float, 1/s
        Nodal damping over mass.
    """
    return 4.0 * np.pi * float(frequencies[0])


def modes_of(tangent: csc_array, factor: Factor, mass: Floats, count: int, start: Floats) -> tuple[Floats, Floats]:
    """Return the lowest modes of a model.

    Parameters
    ----------
    tangent : csc_array, shape (a, a), N/m
        Stiffness matrix over the free axes.
    factor : Factor
        Its factor.
    mass : Floats, shape (a,), kg
        Masses of the free axes.
    count : int
        Number of modes.
    start : Floats, shape (a,)
        Start of the iteration.

    Returns
    -------
    tuple[Floats, Floats]
        Squared frequencies, shape (count,), 1/s^2, ascending, and shapes, shape (a, count), 1/sqrt(kg).
    """
    size = len(mass)
    inverse = LinearOperator((size, size), matvec=factor.solve, dtype=np.float64)
    matrix = diagonal(mass).tocsc()
    square, shape = eigsh(tangent, k=count, M=matrix, sigma=0.0, OPinv=inverse, v0=start, tol=1e-8)
    order = np.argsort(square)
    return square[order], shape[:, order]
