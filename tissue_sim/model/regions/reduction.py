"""Data of a modal region about the rest of the organ: its lowest modes, and its compliance where a table fits."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.model.data.blocks import BLOCK, pack
from tissue_sim.model.data.model import Model, Reduction
from tissue_sim.model.elasticity.assembly import NO_REDUCTION
from tissue_sim.model.elasticity.cells import cell_slopes
from tissue_sim.model.elasticity.modes import angular_slope, free_axes, lowest_modes, stiffness_matrix
from tissue_sim.result_cache import remembered

LARGEST_TABLE = 2048  # nodes: 144 MiB of compliance; for more nodes, modes represent the whole response
MODES_BESIDE_TABLE = 48  # only for the motion; three times as many change it by less than 1 %
VERSION = "2"  # version of the cached data


def reduce_model(model: Model, largest: int = LARGEST_TABLE) -> Reduction:
    """Return the reduction of a model about its rest shape, from the user's cache if it was computed before.

    Parameters
    ----------
    model : Model
        Constants of the model.
    largest : int, optional
        Number of nodes beyond which there is no table.

    Raises
    ------
    UserError
        Where the organ can move as a whole without any force.
    """
    tabled = len(model.rest) <= largest
    made = remembered("reduction", _key(model, tabled), lambda: _make(model, tabled))
    return Reduction(
        frequency=made["frequency"],
        shape=made["shape"],
        peak=np.abs(made["shape"]).max(axis=(0, 1), initial=0.0),
        compliance=made["compliance"],
        edge_slopes=_edge_slopes(model),
        link_slopes=_link_slopes(model),
        cell_slopes=NO_REDUCTION.cell_slopes if model.tissue is None else cell_slopes(model.tissue, model.rest),
    )


def _make(model: Model, tabled: bool) -> dict[str, NDArray]:
    modes = lowest_modes(model, MODES_BESIDE_TABLE) if tabled else lowest_modes(model)
    table = compliance(model) if tabled and len(modes.frequency) else np.zeros((0, 0), dtype=np.float32)
    return {"frequency": modes.frequency, "shape": modes.shape, "compliance": table}


def _key(model: Model, tabled: bool) -> str:
    digest = hashlib.sha256(f"{VERSION} {tabled}".encode())
    for array in (
        model.rest,
        model.inverse_mass,
        model.spring_first,
        model.spring_second,
        model.spring_stiffness,
        model.angular_nodes,
        model.angular_weight,
        model.angular_stiffness,
        model.return_nodes,
        model.return_stiffness,
        *(() if model.tissue is None else (model.tissue.nodes, model.tissue.constants)),
    ):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def compliance(model: Model) -> NDArray[np.float32]:
    """Return the displacement (3n, 3n) m/N of every node under a force on any, linear about rest; zero where held.

    Raises UserError when nothing holds the organ.
    """
    n, free = len(model.rest), free_axes(model)
    factor, failed = lapack.dpotrf(stiffness_matrix(model)[free][:, free].toarray(), lower=1, overwrite_a=1)
    if failed:
        raise UserError("nothing holds the organ: give it fixed nodes or return springs, or use local_region off")
    inverse, _ = lapack.dpotri(factor, lower=1, overwrite_c=1)
    inverse = np.tril(inverse) + np.tril(inverse, -1).T
    table = np.zeros((3 * n, 3 * n), dtype=np.float32)
    table[np.ix_(free, free)] = inverse
    return table


def _edge_slopes(model: Model) -> Floats:
    """Return the rows for forces.subtract_linear_edges, as blocks of their own."""
    ends = model.angular_nodes
    i = model.rest[ends[:, 0]]
    arms = np.concatenate([model.rest[ends[:, c]] - i for c in (1, 2, 3)], axis=1)
    bending = np.sqrt(model.angular_stiffness)[:, None] * angular_slope(model)[:, 1:].reshape(len(ends), 9)
    axial = model.edges.constants[:, 7 * BLOCK :].ravel()[: len(ends)]
    along = np.sqrt(axial)[:, None] * _unit(arms[:, :3])
    return pack(ends, np.concatenate([arms, bending, along], axis=1), np.zeros(21)).constants


def _link_slopes(model: Model) -> Floats:
    """Return the rows for forces.subtract_linear_springs."""
    stiffness = model.links.constants[:, BLOCK:].ravel()
    ends = model.links.nodes.reshape(-1, 2)
    arm = model.rest[ends[:, 1]] - model.rest[ends[:, 0]]
    return pack(ends, np.concatenate([arm, np.sqrt(stiffness)[:, None] * _unit(arm)], axis=1), np.zeros(6)).constants


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
