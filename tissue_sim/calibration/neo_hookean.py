"""Compressible neo-Hookean material on quadratic tetrahedra: energy, nodal forces and tangent, compiled.

W = mu/2 (I1 - 3 - 2 ln J) + lambda/2 (ln J)^2 (Bonet & Wood, Nonlinear Continuum Mechanics for Finite Element
Analysis, 2nd ed. 2008, equation 6.27), whose tangent at rest is linear elasticity with Lame's constants mu, lambda.

Tissue that stiffens has mu/2 ((exp(b z) - 1)/b - z) in addition, z = I1 - 3 J^(2/3), as the cells of an organ do
(model/elasticity/stiffening.py): Demiray's law. Its tangent at rest is the same. The exponent stops at MOST.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.jit import kernel, part

NODES = 10  # of a quadratic tetrahedron
MOST = 15.0  # largest exponent b z; beyond, the slope of the energy by z is constant


class Elements(NamedTuple):
    """Quadratic tetrahedra at the points of a quadrature."""

    nodes: Ints  # (e, 10) indices
    slopes: Floats  # (q, 10, 3) gradients of the shape functions on the reference element
    inverse: Floats  # (e, q, 3, 3) 1/m, of the Jacobian
    weight: Floats  # (e, q) m^3


class Moduli(NamedTuple):
    """Shear modulus, Lame's first constant, and Demiray's b."""

    mu: float  # Pa
    lam: float  # Pa
    stiffening: float = 0.0  # 0: neo-Hookean


@part
def _gradients(slopes: Floats, inverse: Floats, found: Floats) -> None:
    """Compute the gradients (10, 3) 1/m of the shape functions, from those (10, 3) on the reference element."""
    for a in range(NODES):
        for j in range(3):
            found[a, j] = slopes[a, 0] * inverse[0, j] + slopes[a, 1] * inverse[1, j] + slopes[a, 2] * inverse[2, j]


@part
def _deformation(gradients: Floats, moved: Floats, nodes: Ints, f: Floats, back: Floats) -> float:
    """Compute the deformation gradient f (3, 3) and its inverse transposed `back`; return det f."""
    for i in range(3):
        for j in range(3):
            total = 1.0 if i == j else 0.0
            for a in range(NODES):
                total += moved[nodes[a], i] * gradients[a, j]
            f[i, j] = total
    for i in range(3):
        k, m = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            p, q = (j + 1) % 3, (j + 2) % 3
            back[i, j] = f[k, p] * f[m, q] - f[k, q] * f[m, p]
    return f[0, 0] * back[0, 0] + f[0, 1] * back[0, 1] + f[0, 2] * back[0, 2]


@part
def _stiffened(first: float, det: float, stiffening: float) -> tuple[float, float, float]:
    """Return twice the added energy over mu, its slope by z, and the slope of that."""
    wanted = stiffening * (first - 3.0 * det ** (2.0 / 3.0))
    exponent = min(wanted, MOST)
    grown = math.exp(exponent)
    energy = (grown - 1.0 - exponent + (grown - 1.0) * (wanted - exponent)) / stiffening
    return energy, grown - 1.0, stiffening * grown if wanted < MOST else 0.0


@kernel
def energy_and_forces(moved: Floats, elements: Elements, moduli: Moduli, forces: Floats) -> tuple[float, float]:
    """Compute the elastic energy and its gradient.

    Where an element is inverted (det F <= 0) the energy is infinite and `forces` is not complete.

    Parameters
    ----------
    moved : Floats, shape (n, 3), m
        Displacements.
    elements : Elements
        The elements.
    moduli : Moduli
        The material.
    forces : Floats, shape (n, 3), N
        Receives the gradient.

    Returns
    -------
    tuple[float, float]
        Energy, J, and the least det F.
    """
    all_nodes, slopes, inverse, weight = elements
    mu, lam, stiffening = moduli
    f, back, gradients = np.empty((3, 3)), np.empty((3, 3)), np.empty((NODES, 3))
    stress = np.empty((3, 3))
    forces[:] = 0.0
    energy, least = 0.0, math.inf
    for e in range(len(all_nodes)):
        nodes = all_nodes[e]
        for q in range(len(slopes)):
            _gradients(slopes[q], inverse[e, q], gradients)
            det = _deformation(gradients, moved, nodes, f, back)
            least = min(least, det)
            if det <= 0.0:
                return math.inf, det
            logarithm = math.log(det)
            first = 0.0
            for i in range(3):
                for j in range(3):
                    first += f[i, j] * f[i, j]
                    stress[i, j] = weight[e, q] * (mu * f[i, j] + (lam * logarithm - mu) / det * back[i, j])
            energy += weight[e, q] * (0.5 * mu * (first - 3.0 - 2.0 * logarithm) + 0.5 * lam * logarithm * logarithm)
            if stiffening > 0.0:
                added, slope, _ = _stiffened(first, det, stiffening)
                energy += 0.5 * weight[e, q] * mu * added
                root = det ** (-1.0 / 3.0)
                for i in range(3):
                    for j in range(3):
                        stress[i, j] += weight[e, q] * mu * slope * (f[i, j] - root * back[i, j])
            for a in range(NODES):
                for i in range(3):
                    forces[nodes[a], i] += (
                        stress[i, 0] * gradients[a, 0] + stress[i, 1] * gradients[a, 1] + stress[i, 2] * gradients[a, 2]
                    )
    return energy, least


@kernel
def tangent(moved: Floats, elements: Elements, moduli: Moduli, slots: Ints, blocks: Floats) -> None:
    """Compute the second derivative of the energy.

    Parameters
    ----------
    moved : Floats, shape (n, 3), m
        Displacements.
    elements : Elements
        The elements.
    moduli : Moduli
        The material.
    slots : Ints, shape (e, 10, 10)
        Block of each pair of nodes.
    blocks : Floats, shape (b, 3, 3), N/m
        Receives the sum.
    """
    all_nodes, slopes, inverse, weight = elements
    mu, lam, stiffening = moduli
    f, back, gradients = np.empty((3, 3)), np.empty((3, 3)), np.empty((NODES, 3))
    pushed, distorted = np.empty((NODES, 3)), np.empty((NODES, 3))
    local = np.empty((NODES, NODES, 3, 3))
    blocks[:] = 0.0
    for e in range(len(all_nodes)):
        nodes = all_nodes[e]
        local[:] = 0.0
        for q in range(len(slopes)):
            _gradients(slopes[q], inverse[e, q], gradients)
            det = _deformation(gradients, moved, nodes, f, back)
            for a in range(NODES):
                for i in range(3):
                    pushed[a, i] = (
                        back[i, 0] * gradients[a, 0] + back[i, 1] * gradients[a, 1] + back[i, 2] * gradients[a, 2]
                    ) / det
            w = weight[e, q]
            crossed = w * (mu - lam * math.log(det))
            along, straight = w * lam, w * mu
            steep = 0.0
            if stiffening > 0.0:
                root = det ** (2.0 / 3.0)
                _, slope, steeper = _stiffened((f * f).sum(), det, stiffening)
                grown = w * mu * slope
                straight, crossed = straight + grown, crossed + grown * root
                along, steep = along - grown * root * (2.0 / 3.0), 2.0 * w * mu * steeper
                for a in range(NODES):
                    for i in range(3):
                        distorted[a, i] = f[i, 0] * gradients[a, 0] + f[i, 1] * gradients[a, 1]
                        distorted[a, i] += f[i, 2] * gradients[a, 2] - root * pushed[a, i]
            for a in range(NODES):
                for b in range(a + 1):
                    same = straight * (
                        gradients[a, 0] * gradients[b, 0]
                        + gradients[a, 1] * gradients[b, 1]
                        + gradients[a, 2] * gradients[b, 2]
                    )
                    for i in range(3):
                        for k in range(3):
                            local[a, b, i, k] += (
                                crossed * pushed[b, i] * pushed[a, k] + along * pushed[a, i] * pushed[b, k]
                            )
                        local[a, b, i, i] += same
                    if steep > 0.0:
                        for i in range(3):
                            for k in range(3):
                                local[a, b, i, k] += steep * distorted[a, i] * distorted[b, k]
        for a in range(NODES):
            for b in range(a + 1):
                one, other = slots[e, a, b], slots[e, b, a]
                for i in range(3):
                    for k in range(3):
                        blocks[one, i, k] += local[a, b, i, k]
                        if a != b:
                            blocks[other, k, i] += local[a, b, i, k]
