"""Finite-element body of an organ: surface displacements at equilibrium, linear and neo-Hookean."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array, csr_array

from tissue_sim.array_types import Array, Floats, Mask
from tissue_sim.calibration.fe_mesh import FeMesh, Grading, coordinates, fill, libraries
from tissue_sim.calibration.solid import Material, Solid
from tissue_sim.errors import UserError
from tissue_sim.organ.inclusions import inclusions_of, stiffness_at
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surface_checks import signed_volume
from tissue_sim.organ.topology import node_area

FACET_QUADRATURE = 6  # order: a linear traction, quadratic shape functions, and quarter points


class Settled(NamedTuple):
    """Equilibrium of the organ's surface under a load."""

    displacement: Floats  # (n_surface, 3) m
    volume_change: float  # of the volume inside the surface triangles, relative
    steps: int  # of Newton's method
    iterations: int  # of conjugate gradients, in all
    converged: bool
    load_steps: int
    least_det: float  # det F where the body is compressed most


class Body:
    """Organ as a solid of quadratic tetrahedra, held at the triangles whose nodes are all fixed.

    Parameters
    ----------
    near : Array | None, shape (k,), optional
        Surface nodes under which the mesh is refined; None for none.
    grading : Grading | None, optional
        Sizes of the elements; None for the usual ones.
    organ : Organ
        The organ.

    Raises
    ------
    UserError
        Where the organ has no clamp, an invalid material, or a surface that can't be filled.
    """

    def __init__(self, organ: Organ, near: Array | None = None, grading: Grading | None = None) -> None:
        _check_material(organ)
        self.organ = organ
        self.filling = fill(organ, near, grading)
        held = np.zeros((len(self.filling.nodes), 3), dtype=bool)
        held[self.filling.facets[self.filling.clamped].ravel()] = True
        material = Material(organ.youngs_modulus, organ.poisson_ratio, organ.density, organ.stiffening)
        inclusions = inclusions_of(organ)
        stiffness = partial(stiffness_at, inclusions) if inclusions else None
        self.solid = Solid(self.filling.nodes, self.filling.elements, held, material, stiffness)
        self.load_matrix = load_matrix(organ, self.filling)  # (n, n_surface) nodal loads per surface force

    @property
    def n_nodes(self) -> int:
        """Number of nodes, mid-edge nodes included."""
        return len(self.solid.nodes)

    def loads(self, force: ArrayLike, acceleration: ArrayLike | None = None) -> Floats:
        """Return the nodal loads of surface forces and a uniform acceleration.

        Parameters
        ----------
        force : ArrayLike, shape (n_surface, 3), N
            Forces on the surface nodes.
        acceleration : ArrayLike | None, shape (3,), m/s^2, optional
            Acceleration; None for none.

        Returns
        -------
        Floats, shape (n, 3), N
            Nodal loads.
        """
        found: Floats = self.load_matrix @ np.asarray(force, dtype=np.float64)
        if acceleration is not None:
            weight = np.asarray(self.solid.mass.sum(axis=1)).ravel()
            found = found + weight[:, None] * np.asarray(acceleration, dtype=np.float64)
        return found

    def settle_linear(self, forces: ArrayLike, acceleration: ArrayLike | None = None) -> Floats:
        """Return the surface displacements of linear elasticity.

        Parameters
        ----------
        forces : ArrayLike, shape (c, n_surface, 3), N
            Forces on the surface nodes, for each case.
        acceleration : ArrayLike | None, shape (3,), m/s^2, optional
            Acceleration of the body's mass in every case, such as gravity; None for none.

        Returns
        -------
        Floats, shape (c, n_surface, 3), m
            Displacements.
        """
        forces = np.asarray(forces, dtype=np.float64)
        answer = np.empty(forces.shape)
        for first in range(0, len(forces), 64):
            part = slice(first, first + 64)
            loads = np.stack([self.loads(force, acceleration) for force in forces[part]])
            answer[part] = self.solid.solve(loads)[:, : self.organ.n_surface]
        return answer

    def settle(self, force: ArrayLike, acceleration: ArrayLike | None = None) -> Settled:
        """Return the equilibrium of the neo-Hookean body under dead surface forces.

        Parameters
        ----------
        force : ArrayLike, shape (n_surface, 3), N
            The forces.
        acceleration : ArrayLike | None, shape (3,), m/s^2, optional
            Acceleration of its mass.
        """
        return next(self.settle_many([force], acceleration))

    def settle_many(self, forces: Iterable[ArrayLike], acceleration: ArrayLike | None = None) -> Iterator[Settled]:
        """Yield the equilibria under several forces, in their order: in a third of the time of one by one.

        Parameters
        ----------
        forces : Iterable[ArrayLike], shape (n_surface, 3), N
            The forces.
        acceleration : ArrayLike | None, shape (3,), m/s^2, optional
            Acceleration of its mass.
        """
        for found in self.solid.settle_many(self.loads(force, acceleration) for force in forces):
            surface = found.displacement[: self.organ.n_surface].copy()
            yield Settled(
                surface,
                volume_change(self.organ, surface),
                found.steps,
                found.iterations,
                found.converged,
                found.load_steps,
                found.least_det,
            )


def _check_material(organ: Organ) -> None:
    """Raise UserError unless the tissue is that of an elastic solid that can be compressed."""
    if not (0.0 < organ.youngs_modulus < np.inf and 0.0 < organ.density < np.inf and -1.0 < organ.poisson_ratio < 0.5):
        raise UserError(
            f"organ '{organ.name}': a solid of Young's modulus {organ.youngs_modulus:g} Pa, Poisson's ratio"
            f" {organ.poisson_ratio:g} and {organ.density:g} kg/m^3 is not possible; build it with other values,"
            " Poisson's ratio below 0.5"
        )


def volume_change(organ: Organ, displacement: Floats) -> float:
    """Return the relative change of the volume inside the surface triangles.

    Parameters
    ----------
    organ : Organ
        The organ.
    displacement : Floats, shape (n_surface, 3), m
        Displacements of the surface nodes.

    Returns
    -------
    float
        The change of volume over the volume at rest.
    """
    now = signed_volume(organ.surface_positions + displacement, organ.surface_triangles)
    return now / organ.volume - 1.0


def load_matrix(organ: Organ, filling: FeMesh, shut: Mask | None = None) -> csr_array:
    """Return the nodal loads per surface force, (n, n_surface).

    The force F_i at a surface node is the traction F_i phi_i(x) / A_i, where phi_i is 1 at the node and falls to 0
    across the triangles around it, and A_i its integral. Its work on the shape functions is integrated exactly where
    edges have their nodes in the middle. Where `shut` (f, 3) is set for a facet and a corner of its triangle, phi_i is
    0 on that facet: it lies beyond a cut.
    """
    skfem, _ = libraries()
    triangles = organ.surface_triangles
    points, weights = skfem.quadrature.get_quadrature(skfem.refdom.RefTri, FACET_QUADRATURE)
    found = [skfem.ElementTriP2().lbasis(points, node) for node in range(6)]
    values = np.stack([value for value, _ in found], axis=1)  # (q, 6)
    slopes = np.stack([slope for _, slope in found])  # (6, 2, q)
    corners = filling.nodes[filling.facets]  # (f, 6, 3)
    where = np.einsum("fax,qa->fqx", corners, values)
    along = np.einsum("fax,arq->rfqx", corners, slopes)
    weight = np.linalg.norm(np.cross(along[0], along[1]), axis=2) * weights
    parents = np.repeat(organ.surface_positions[triangles[filling.triangle]], len(weights), axis=0)
    hats = coordinates(where.reshape(-1, 3), parents).reshape(*where.shape)
    nodes = triangles[filling.triangle]
    total = node_area(organ.surface_positions, triangles)
    if shut is not None:
        hats = np.where(shut[:, None, :], 0.0, hats)
        total = np.bincount(nodes.ravel(), np.einsum("fq,fqc->fc", weight, hats).ravel(), organ.n_surface)
    parts = np.einsum("fq,qa,fqc->fac", weight, values, hats, optimize=True)  # (f, 6, 3)
    rows = np.broadcast_to(filling.facets[:, :, None], parts.shape)
    columns = np.broadcast_to(nodes[:, None, :], parts.shape)
    shape = len(filling.nodes), organ.n_surface
    matrix = coo_array(((parts / total[columns]).ravel(), (rows.ravel(), columns.ravel())), shape=shape)
    return matrix.tocsr()
