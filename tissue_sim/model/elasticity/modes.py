"""Vibration modes of the assembled model about its rest shape, for the modal local region."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from tissue_sim.array_types import Floats, Longs
from tissue_sim.errors import UserError
from tissue_sim.model.data.model import Model
from tissue_sim.model.elasticity.cells import cells_of, strain_rows
from tissue_sim.model.elasticity.diagonal import diagonal

N_MODES = 144  # with a third of them, the error of the region's surroundings is three times as large
_RIGID = 1e-9  # square of a frequency over the largest diagonal, below which it counts as 0


class Modes(NamedTuple):
    """Lowest modes: K p = w^2 M p with p'Mp = 1."""

    frequency: Floats  # (m,) w, rad/s
    shape: Floats  # (n, 3, m) p, 1/sqrt(kg); 0 where a node is held


def free_axes(model: Model) -> NDArray[np.int64]:
    """Return which of the 3n coordinates of the nodes may move.

    Parameters
    ----------
    model : Model
        Constants of the model.

    Returns
    -------
    NDArray[np.int64], shape (a,)
        Indices, 3 node + axis.
    """
    return (3 * model.moving.astype(np.int64)[:, None] + np.arange(3)).ravel()


def stiffness_matrix(model: Model) -> csc_array:
    """Return the tangent stiffness at rest without forces.

    Parameters
    ----------
    model : Model
        Constants of the model.

    Returns
    -------
    csc_array, shape (3n, 3n), N/m
        The matrix.
    """
    rows, owner, stiffness = strains_of(model)
    return (rows.T @ diagonal(stiffness[owner]) @ rows).tocsc()


class Strains(NamedTuple):
    """Strains of springs or cells about rest: the energy is the sum of stiffness[owner] strain^2 / 2."""

    rows: csc_array  # (s, 3n) of the nodes' coordinates
    owner: Longs  # (s,) index of the stiffness of each
    stiffness: Floats  # (p,) axial, angular, return springs, N/m; or mu of every cell, then lambda, Pa


def strains_of(model: Model) -> Strains:
    """Return lengths and curvatures of springs, and displacements of return springs; or the strains of cells.

    Parameters
    ----------
    model : Model
        Constants of the model.
    """
    if model.tissue is not None:
        cells, moduli, _ = cells_of(model.tissue)
        return Strains(*strain_rows(model.rest, cells), moduli.ravel())
    axes = np.arange(3)
    ends = np.stack([model.spring_first, model.spring_second], axis=1).astype(np.int64)
    along = model.rest[ends[:, 1]] - model.rest[ends[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    hinges, pulled = model.angular_nodes.astype(np.int64), model.return_nodes.astype(np.int64)
    s, h, r = len(ends), len(hinges), len(pulled)
    bending = angular_slope(model) if h else np.zeros((0, 4, 3))
    values = [np.stack([-along, along], axis=1).ravel(), bending.ravel(), np.ones(3 * r)]
    rows = [np.repeat(np.arange(s), 6), s + np.repeat(np.arange(h), 12), s + h + np.arange(3 * r)]
    columns = [(3 * nodes[..., None] + axes).ravel() for nodes in (ends, hinges, pulled)]
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    matrix = coo_array(entries, shape=(s + h + 3 * r, 3 * len(model.rest))).tocsc()
    stiffness = np.concatenate([model.spring_stiffness, model.angular_stiffness, model.return_stiffness[pulled]])
    return Strains(matrix, np.concatenate([np.arange(s + h), s + h + np.repeat(np.arange(r), 3)]), stiffness)


def lowest_modes(model: Model, count: int = N_MODES) -> Modes:
    """Return the lowest modes of the nodes that may move.

    Parameters
    ----------
    model : Model
        Constants of the model.
    count : int, optional
        Number of modes; fewer if the model has fewer.

    Raises
    ------
    UserError
        If the organ can move as a whole without any force.
    """
    n, moving, free = len(model.rest), model.moving, free_axes(model)
    count = min(count, len(free) - 2)
    if count < 1:
        return Modes(np.zeros(0), np.zeros((n, 3, 0)))
    # With coordinates scaled by the root of the mass, this is a standard symmetric eigenvalue problem.
    root = diagonal(np.repeat(np.sqrt(model.inverse_mass[moving]), 3))
    scaled = (root @ stiffness_matrix(model)[free][:, free] @ root).tocsc()
    start = np.random.default_rng(0).standard_normal(len(free))
    try:
        # An ordering that uses the symmetry has half the fill-in of SciPy's own: a third of the time at 16,000 points.
        factor = splu(scaled, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        solve = LinearOperator(scaled.shape, factor.solve, dtype=np.float64)
        square, vectors = eigsh(scaled, k=count, sigma=0.0, v0=start, OPinv=solve)
    except RuntimeError:  # exactly singular
        square, vectors = np.zeros(1), np.zeros((len(free), 1))
    if square.min() <= _RIGID * scaled.diagonal().max():
        raise UserError(
            "the organ has modes without stiffness, since nothing holds it: give it fixed nodes or return springs,"
            " or use local_region off"
        )
    order = np.argsort(square)
    shape = np.zeros((3 * n, count))
    shape[free] = root @ vectors[:, order]
    return Modes(np.sqrt(np.maximum(square[order], 0.0)), shape.reshape(n, 3, count))


def angular_slope(model: Model) -> Floats:
    """Return the gradient of the curvature s of each hinge at rest; see forces.edge_forces.

    Parameters
    ----------
    model : Model
        Constants of the model.

    Returns
    -------
    Floats, shape (h, 4, 3)
        Gradients.
    """
    i, j, k, m = (model.rest[model.angular_nodes[:, c]] for c in range(4))
    edge, across = j - i, k - m
    normal = np.cross(edge, across)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= length
    bent = np.einsum("hc,hcx->hx", model.angular_weight, model.rest[model.angular_nodes])
    turning = (bent - np.einsum("hx,hx->h", bent, normal)[:, None] * normal) / length
    gradient = model.angular_weight[:, :, None] * normal[:, None, :]
    by_edge, by_across = np.cross(across, turning), np.cross(turning, edge)
    gradient[:, 0] -= by_edge
    gradient[:, 1] += by_edge
    gradient[:, 2] += by_across
    gradient[:, 3] -= by_across
    return gradient
