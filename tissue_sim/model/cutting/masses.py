"""Masses and damping of nodes and their virtual nodes: the critical step remains, and light tips come to rest soon."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import eigsh

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.model.elasticity.cells import shapes_of, strain_rows
from tissue_sim.model.elasticity.diagonal import diagonal
from tissue_sim.organ.organ import Organ

MODES = 8  # number of the fastest modes, which are slowed together
MAX_ROUNDS = 30
ENOUGH = 1.006  # times the uncut organ's largest eigenvalue: a critical step shorter by 0.3 %
MAX_MASS_CHANGE = 0.3  # of a mass's logarithm in a round; also at most twice the relative excess of the eigenvalue
MIN_MASS_FRACTION = 0.05  # of a node's mass that each of its copies has: a tool would throw a lighter one
SHARPNESS = 30.0  # exponent by which slower modes count less than the fastest one
MAX_DAMPING_RATIO = 4.0  # of a copy about its neighbours at rest


def distributed_masses(organ: Organ, cut: Organ, frequency: float) -> Floats:
    """Return the masses of a cut organ's nodes. The copies of a node together have its mass; other masses don't change.

    At first mass is distributed in proportion to stiffness, but each copy has at least MIN_MASS_FRACTION: the largest
    frequency of every copy of a cell is then that of the cell, or lower. The fastest modes at the cut may still be
    faster than before, if a light copy has lost neighbours that slowed it. There mass is moved between copies towards
    those that take part in these modes, along the gradient of the eigenvalue.

    Parameters
    ----------
    organ : Organ
        The organ before.
    cut : Organ
        The organ after, whose masses are ignored.
    frequency : float, rad/s
        Largest frequency of the organ before.

    Returns
    -------
    Floats, shape (n,), kg
        The masses.
    """
    own = organ.n_nodes
    source = np.concatenate([np.arange(own), cut.virtual_of])
    several = np.isin(source, cut.virtual_of)
    slope, volume = shapes_of(cut.rest_positions, cut.cell_nodes)
    # The trace of each node's block of the stiffness at rest.
    steep = np.einsum("cax,cax->ca", slope, slope) * (volume * (4.0 * cut.cell_mu + cut.cell_lambda))[:, None]
    stiffness = np.bincount(cut.cell_nodes.ravel(), steep.ravel(), len(source))

    def shared(weight: Floats) -> Floats:
        part = np.maximum(weight / np.bincount(source, weight, own)[source], MIN_MASS_FRACTION)
        part /= np.bincount(source, part, own)[source]
        mass: Floats = organ.mass[source]
        mass[several] *= part[several]
        return mass

    # Modes of the nodes around the cut: with all other nodes held, none is faster than the fastest of the whole organ.
    near = np.zeros(len(source), dtype=bool)
    near[cut.cell_nodes[several[cut.cell_nodes].any(axis=1)]] = True
    near[cut.fixed] = False
    among = np.flatnonzero(near)
    mass = shared(stiffness)
    if not np.any(several[among]):
        return mass
    matrix = _stiffness(cut, among)
    most = ENOUGH * frequency**2
    best, least = mass, np.inf
    for _ in range(MAX_ROUNDS):
        square, part = _fastest(matrix, mass[among], MODES)
        if square[-1] < least:
            best, least = mass, square[-1]
        if least <= most:
            break
        # The fastest modes are slowed together, as slowing a single one makes another faster.
        sought = np.zeros(len(source))
        sought[among] = part @ np.exp(SHARPNESS * (square / square[-1] - 1.0))
        sought /= max(float(sought[several].max()), 1e-300)
        mass = shared(mass * np.exp(sought * min(MAX_MASS_CHANGE, 2.0 * (square[-1] / most - 1.0))))
    return best


def damping_of_copies(organ: Organ, cut: Organ) -> Floats:
    """Return the damping of a cut organ's nodes. Damping of nodes that have no copies doesn't change.

    Each copy has the damping of the whole node: pressed between lips, a light one with less would oscillate. But a tip
    that little tissue holds would then creep to its place for half a minute. So a copy's damping ratio, with its
    neighbours at rest and in the direction in which they hold it least, is at most MAX_DAMPING_RATIO.

    Parameters
    ----------
    organ : Organ
        The organ before.
    cut : Organ
        The organ after, with its masses.

    Returns
    -------
    Floats, shape (n,), kg/s
        The damping.
    """
    source = np.concatenate([np.arange(organ.n_nodes), cut.virtual_of])
    several = np.flatnonzero(np.isin(source, cut.virtual_of))
    slope, volume = shapes_of(cut.rest_positions, cut.cell_nodes)
    shear, bulk = volume * cut.cell_mu, volume * (cut.cell_mu + cut.cell_lambda)
    square = np.einsum("cax,cax->ca", slope, slope) * shear[:, None]
    outer = np.einsum("cax,cay->caxy", slope, slope) * bulk[:, None, None, None]
    block = np.zeros((len(source), 3, 3))
    np.add.at(block, cut.cell_nodes, square[..., None, None] * np.eye(3) + outer)
    least = np.linalg.eigvalsh(block[several])[:, 0]
    damping: Floats = organ.damping[source]
    damping[several] = np.minimum(damping[several], 2.0 * MAX_DAMPING_RATIO * np.sqrt(least * cut.mass[several]))
    return damping


def fastest_mode(organ: Organ) -> float:
    """Return the largest angular frequency of an organ of cells about rest, rad/s, by Lanczos' method.

    If several modes are nearly as fast, as at a cut, the power iteration of `frequency.py` can converge to a slower
    one.

    Parameters
    ----------
    organ : Organ
        The organ.
    """
    moving = np.setdiff1d(np.arange(organ.n_nodes), organ.fixed)
    square = _fastest(_stiffness(organ, moving), organ.mass[moving], 1)[0][-1]
    return float(np.sqrt(max(square, 0.0)))


def _stiffness(organ: Organ, among: Longs | Ints) -> csr_array:
    """Return the stiffness of cells at rest (3k, 3k) N/m, of some nodes (k,) with all others held."""
    cells = organ.cell_nodes
    chosen = np.isin(cells, among).any(axis=1)
    rows, owner = strain_rows(organ.rest_positions, cells[chosen])
    moduli = np.concatenate([organ.cell_mu[chosen], organ.cell_lambda[chosen]])
    axes = (3 * among.astype(np.int64)[:, None] + np.arange(3)).ravel()
    rows = rows[:, axes]
    return csr_array(rows.T @ diagonal(moduli[owner]) @ rows)


def _fastest(stiffness: csr_array, mass: Floats, count: int) -> tuple[Floats, Floats]:
    """Return the largest eigenvalues (m,) 1/s^2, ascending, and the nodes' parts (k, m) of these modes' energy."""
    root = diagonal(np.repeat(1.0 / np.sqrt(mass), 3))
    scaled = (root @ stiffness @ root).tocsr()
    start = np.random.default_rng(0).standard_normal(scaled.shape[0])
    square, shape = eigsh(scaled, k=min(count, scaled.shape[0] - 1), which="LA", tol=1e-4, v0=start)
    order = np.argsort(square)
    return square[order], np.square(shape[:, order]).reshape(len(mass), 3, -1).sum(axis=1)
