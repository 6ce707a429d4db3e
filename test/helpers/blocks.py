"""Boxes of quadratic tetrahedra that the tests of the finite elements share."""

from __future__ import annotations

import numpy as np
import skfem

from tissue_sim.calibration.fe_mesh import quadratic
from tissue_sim.calibration.solid import Material, Solid


def box(
    x,
    y,
    z,
    youngs_modulus: float = 10e3,
    poisson_ratio: float = 0.3,
    density: float = 1000.0,
    bend: float = 0.0,
    stiffness=None,
    stiffening: float = 0.0,
) -> Solid:
    """A box between coordinates x, y, z (each (k,), m), nothing held; `bend` moves inner corners by so much of 1 m."""
    mesh = skfem.MeshTet.init_tensor(*(np.asarray(axis, dtype=np.float64) for axis in (x, y, z)))
    points = mesh.p.copy()
    inner = np.setdiff1d(np.arange(points.shape[1]), mesh.boundary_nodes())
    points[:, inner] += bend * np.random.default_rng(3).uniform(-1.0, 1.0, (3, len(inner)))
    nodes, elements = quadratic(skfem.MeshTet(points, mesh.t))
    material = Material(youngs_modulus, poisson_ratio, density, stiffening)
    return Solid(nodes, elements, np.zeros(nodes.shape, dtype=bool), material, stiffness)


def faces(solid: Solid, axis: int, value: float) -> np.ndarray:
    """Quadratic facets (f, 6) of a solid in the plane where a coordinate has a value."""
    local = np.array([[0, 1, 2, 4, 5, 6], [0, 1, 3, 4, 8, 7], [0, 2, 3, 6, 9, 7], [1, 2, 3, 5, 9, 8]])
    found = solid.elements[:, local].reshape(-1, 6)
    return found[np.all(np.abs(solid.nodes[found, axis] - value) < 1e-12, axis=1)]


def pressed(solid: Solid, facets: np.ndarray, traction) -> np.ndarray:
    """Nodal loads (n, 3) of a uniform traction (3,) Pa: a third of each flat facet's share at every middle node."""
    a, b, c = (solid.nodes[facets[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    load = np.zeros_like(solid.nodes)
    for middle in range(3, 6):
        np.add.at(load, facets[:, middle], area[:, None] / 3.0 * np.asarray(traction))
    return load
