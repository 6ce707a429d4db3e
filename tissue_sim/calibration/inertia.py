"""Masses and damping with which the model moves as the finite-element body does, not only settles as it.

The model's stiffness is taken as it is. Every node gets the mass of the tissue around it, at the least so much that
two substeps a millisecond are stable, and then as much more or less as brings the lowest modes to their frequencies.
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
from tissue_sim.model.diagonal import diagonal
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.winding import inside

MODES = 8  # lowest ones, whose frequencies are fitted
STEP = 6e-4  # s, critical step that masses make room for: two substeps a millisecond need 0.56 ms
# Of the mass may go there, and where even all of it would not do: a finer or stiffer organ gets a shorter step. At 0.9
# the lowest eight modes of a kidney of 4000 points were off by 7 %, at 0.7 by 0.4 %.
USUAL_SHARE, MOST_SHARE = 0.6, 0.75
SPREAD = 1e-3  # weight of the mean square of the masses' logarithms, over those of the tissue around
EVALUATIONS = 15
_POINTS = 40_000  # at which the organ's volume is looked at


def tissue_mass(organ: Organ) -> Floats:
    """Mass (n,) kg of the tissue that is nearer to each node than to any other; in all the organ's volume's.

    Held nodes and nodes without any such tissue have a share, too.
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
    """Mass (n,) kg under which no node may fall for a critical step of s; of `total` kg no more than a share.

    The largest squared frequency is at most the largest sum of a row of |K| over the row's mass (Gershgorin).
    """
    rows = np.zeros(3 * elastic.n_nodes)
    rows[elastic.free] = np.asarray(abs(tangent).sum(axis=1)).ravel()
    needed = 0.25 * step**2 * rows.reshape(-1, 3).max(axis=1)
    share = max(float(needed.sum()) / total, 1e-300)
    return needed * min(1.0, min(USUAL_SHARE * max(1.0, share), MOST_SHARE) / share)


def fit_mass(organ: Organ, elastic: Elastic, stiffness: Floats, frequencies: Floats) -> Floats:
    """Masses (n,) kg, in all as much as the organ's volume weighs, with which the lowest modes have these Hz.

    Raises UserError when the tissue leaves something free to move without any force.
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
    share = np.maximum(around[moving] - least, 0.05 * around[moving])
    wanted = (2.0 * np.pi * np.asarray(frequencies)) ** 2
    start = np.random.default_rng(0).standard_normal(len(elastic.free))

    def spread(logarithm: Floats) -> tuple[Floats, Floats]:
        """Masses of the moving nodes, and how the part above the least is shared out."""
        part = share * np.exp(logarithm)
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
        np.zeros(len(share)),
        jac=True,
        method="L-BFGS-B",
        bounds=[(-3.0, 3.0)] * len(share),
        options={"maxfun": EVALUATIONS, "maxiter": EVALUATIONS, "ftol": 1e-9, "gtol": 0.0},
    )
    mass = around.copy()
    mass[moving] = spread(best.x)[0]
    return mass


def frequencies_of(elastic: Elastic, stiffness: Floats, mass: Floats, count: int = MODES) -> Floats:
    """The lowest frequencies (count,) Hz of a model of stiffness (p,) and masses (n,) kg."""
    tangent = elastic.tangent(stiffness)
    start = np.random.default_rng(0).standard_normal(len(elastic.free))
    square, _ = modes_of(tangent, elastic.factor(tangent), np.repeat(mass, 3)[elastic.free], count, start)
    return np.sqrt(np.maximum(square, 0.0)) / (2.0 * np.pi)


def damping_rate(frequencies: Floats) -> float:
    """Nodal damping over mass, 1/s, that damps the lowest mode critically: none settles sooner without overshoot."""
    return 4.0 * np.pi * float(frequencies[0])


def modes_of(tangent: csc_array, factor: Factor, mass: Floats, count: int, start: Floats) -> tuple[Floats, Floats]:
    """Squared frequencies (count,), ascending, 1/s^2, and shapes (a, count) 1/sqrt(kg) of masses (a,) kg."""
    size = len(mass)
    inverse = LinearOperator((size, size), matvec=factor.solve, dtype=np.float64)
    matrix = diagonal(mass).tocsc()
    square, shape = eigsh(tangent, k=count, M=matrix, sigma=0.0, OPinv=inverse, v0=start, tol=1e-8)
    order = np.argsort(square)
    return square[order], shape[:, order]
