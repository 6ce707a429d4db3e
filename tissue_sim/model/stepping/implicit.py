"""Matrix of the implicit step, factored ahead of time."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from tissue_sim.array_types import Floats, Ints
from tissue_sim.jit import kernel
from tissue_sim.model.data.model import Factor, Model
from tissue_sim.model.elasticity.cells import cells_of, shapes_of
from tissue_sim.model.elasticity.diagonal import diagonal


class _Decomposition(NamedTuple):
    order: Ints
    start: Ints
    row: Ints
    value: Floats
    pivot: Floats
    mobility: Floats


def bounding_stiffness(model: Model) -> csc_array:
    """Return a matrix that bounds the stiffness at rest in any direction, the same for x, y and z.

    An axial spring is not stiffer in any direction than k along it, an angular spring not stiffer than k w w', w its
    weights; return springs are on the diagonal. For a cell at rest no displacement gradient exceeds its trace, (2 mu +
    3 lambda) V: in one direction alone, 2 mu + lambda, this holds until it is squeezed to less than half.

    Parameters
    ----------
    model : Model
        Constants of the model.

    Returns
    -------
    csc_array, shape (n, n), N/m
        The matrix S.
    """
    n = len(model.rest)
    rows: list[NDArray] = [np.arange(n)]
    columns: list[NDArray] = [np.arange(n)]
    values = [np.zeros(n)]
    values[0][model.return_nodes] = model.return_stiffness[model.return_nodes]

    def add(nodes: Ints, slope: Floats, stiffness: Floats) -> None:
        block = stiffness[:, None, None] * slope[:, :, None] * slope[:, None, :]
        rows.append(np.broadcast_to(nodes[:, :, None], block.shape).ravel())
        columns.append(np.broadcast_to(nodes[:, None, :], block.shape).ravel())
        values.append(block.ravel())

    pairs = np.stack([model.spring_first, model.spring_second], axis=1)
    add(pairs, np.broadcast_to(np.array([-1.0, 1.0]), pairs.shape), model.spring_stiffness)
    add(model.angular_nodes, model.angular_weight, model.angular_stiffness)
    if model.tissue is not None:
        cells, (mu, lam), _ = cells_of(model.tissue)
        slope, volume = shapes_of(model.rest, cells)
        for axis in range(3):
            add(cells, slope[:, :, axis], (2.0 * mu + 3.0 * lam) * volume)
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return coo_array(entries, shape=(n, n)).tocsc()


def make_factor(model: Model, step: float, stiffness_scale: float, damping_scale: float) -> Factor:
    """Return both slots of the factor: L D L' of M + h D + h^2 S over the moving nodes.

    Parameters
    ----------
    model : Model
        Constants of the model.
    step : float, s
        Step h.
    stiffness_scale : float
        Factor of the stiffness.
    damping_scale : float
        Factor of the damping.

    Returns
    -------
    Factor
        The factor.
    """
    made = _decompose(model, step, stiffness_scale, damping_scale)
    return Factor(
        order=made.order,
        start=made.start,
        row=made.row,
        value=np.stack([made.value, made.value]),
        pivot=np.stack([made.pivot, made.pivot]),
        mobility=np.stack([made.mobility, made.mobility]),
    )


def write_factor(model: Model, slot: int, step: float, stiffness_scale: float, damping_scale: float) -> None:
    """Write the factor for other settings into a slot that is not in use.

    Parameters
    ----------
    model : Model
        Constants of the model.
    slot : int
        The slot.
    step : float, s
        Step h.
    stiffness_scale : float
        Factor of the stiffness.
    damping_scale : float
        Factor of the damping.
    """
    made = _decompose(model, step, stiffness_scale, damping_scale)
    if model.factor is not None:
        model.factor.value[slot] = made.value
        model.factor.pivot[slot] = made.pivot
        model.factor.mobility[slot] = made.mobility


def _decompose(model: Model, step: float, stiffness_scale: float, damping_scale: float) -> _Decomposition:
    moving = model.moving
    n = len(model.rest)
    if not len(moving):
        none = np.zeros(0, dtype=np.int32)
        return _Decomposition(none, np.zeros(1, dtype=np.int32), none, np.zeros(0), np.zeros(0), np.zeros(n))
    heavy = 1.0 / model.inverse_mass[moving] + step * damping_scale * model.damping[moving]
    stiff = bounding_stiffness(model)[moving][:, moving]
    matrix = (diagonal(heavy) + step * step * stiffness_scale * stiff).tocsc()
    # Symmetric and positive definite: no pivoting, so U = D L' and the rows stay with their columns.
    solver = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    lower = solver.L.tocsc()
    lower.sort_indices()
    place = np.empty(len(moving), dtype=np.int64)
    place[solver.perm_c] = np.arange(len(moving))
    below = lower.indices > np.repeat(np.arange(len(moving)), np.diff(lower.indptr))
    counts = np.bincount(np.repeat(np.arange(len(moving)), np.diff(lower.indptr))[below], minlength=len(moving))
    order = moving[place].astype(np.int32)
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    row, value, pivot = lower.indices[below].astype(np.int32), lower.data[below], 1.0 / solver.U.diagonal()
    inverse = np.zeros(len(moving))
    work = np.full(len(moving), -1, dtype=np.int32), np.zeros(len(moving)), np.zeros(len(moving))
    inverse_diagonal(start, row, value, pivot, inverse, np.zeros(len(row)), *work)
    mobility = np.zeros(n)
    mobility[order] = inverse
    return _Decomposition(order, start, row, value, pivot, mobility)


@kernel
def inverse_diagonal(
    start: Any, row: Any, value: Any, pivot: Any, diagonal: Any, below: Any, column: Any, share: Any, total: Any
) -> None:
    """Compute the diagonal of the inverse of L D L' into diagonal (a,) (Takahashi, Fagan and Chin 1973).

    Z = D^-1 L^-1 + (I - L') Z gives the inverse's entries where L has some from those right of them: below (l,)
    receives them. column (a,) filled with -1, share (a,) and total (a,) are buffers.
    """
    for j in range(len(pivot) - 1, -1, -1):
        for entry in range(start[j], start[j + 1]):
            i = row[entry]
            column[i], share[i], total[i] = j, value[entry], 0.0
        for entry in range(start[j], start[j + 1]):
            k = row[entry]
            weight = value[entry]
            total[k] -= weight * diagonal[k]
            for other in range(start[k], start[k + 1]):
                i = row[other]
                if column[i] == j:
                    total[i] -= weight * below[other]
                    total[k] -= share[i] * below[other]
        away = 0.0
        for entry in range(start[j], start[j + 1]):
            below[entry] = total[row[entry]]
            away += value[entry] * below[entry]
        diagonal[j] = pivot[j] - away
