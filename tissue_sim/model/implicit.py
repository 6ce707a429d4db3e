"""The matrix of the implicit step, factored ahead of time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.linalg import splu

from tissue_sim.model.assembly import Factor, Model
from tissue_sim.organ.organ import Floats, Ints


class _Decomposition(NamedTuple):
    order: Ints
    start: Ints
    row: Ints
    value: Floats
    pivot: Floats
    mobility: Floats


def bounding_stiffness(model: Model) -> csc_array:
    """S (n, n) N/m: at least the stiffness of every spring in any direction, the same for x, y and z.

    An axial spring is no stiffer in any direction than k along it, an angular spring no stiffer than k w w', w its
    weights; return springs are on the diagonal.
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
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return coo_array(entries, shape=(n, n)).tocsc()


def make_factor(model: Model, step: float, stiffness_scale: float, damping_scale: float) -> Factor:
    """Both slots of the factor, for a step of s; L D L' of M + h D + h^2 S over the moving nodes."""
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
    """Write the factor for other settings into a slot that is not in use."""
    made = _decompose(model, step, stiffness_scale, damping_scale)
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
    matrix = (diags_array(heavy) + step * step * stiffness_scale * stiff).tocsc()
    # Symmetric and positive definite: no pivoting, so U = D L' and the rows stay with their columns.
    solver = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    lower = solver.L.tocsc()
    lower.sort_indices()
    diagonal = solver.U.diagonal()
    place = np.empty(len(moving), dtype=np.int64)
    place[solver.perm_c] = np.arange(len(moving))
    below = lower.indices > np.repeat(np.arange(len(moving)), np.diff(lower.indptr))
    counts = np.bincount(np.repeat(np.arange(len(moving)), np.diff(lower.indptr))[below], minlength=len(moving))
    mobility = np.zeros(n)
    mobility[moving] = _inverse_diagonal(solver, len(moving))
    return _Decomposition(
        order=moving[place].astype(np.int32),
        start=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        row=lower.indices[below].astype(np.int32),
        value=lower.data[below],
        pivot=1.0 / diagonal,
        mobility=mobility,
    )


def _inverse_diagonal(solver, size: int, columns: int = 256) -> Floats:  # type: ignore[no-untyped-def]
    """Diagonal of the inverse, a few columns at a time."""
    diagonal = np.empty(size)
    for first in range(0, size, columns):
        some = np.arange(first, min(first + columns, size))
        unit = np.zeros((size, len(some)))
        unit[some, np.arange(len(some))] = 1.0
        diagonal[some] = solver.solve(unit)[some, np.arange(len(some))]
    return diagonal
