"""The finite-element body of an organ: settled surface displacements, linear and neo-Hookean."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array, csr_array

from tissue_sim.array_types import Floats
from tissue_sim.calibration.fe_mesh import FeMesh, Grading, coordinates, fill, libraries
from tissue_sim.calibration.solid import Solid
from tissue_sim.errors import UserError
from tissue_sim.organ.inclusions import inclusions_of, stiffness_at
from tissue_sim.organ.organ import Organ, signed_volume
from tissue_sim.organ.topology import node_area

FACET_QUADRATURE = 6  # order: a linear traction, quadratic shape functions, and quarter points


class Settled(NamedTuple):
    """The organ's surface at rest under a load."""

    displacement: Floats  # (n_surface, 3) m
    volume_change: float  # of the volume inside the surface triangles, relative
    steps: int  # of Newton's method
    iterations: int  # of conjugate gradients, in all
    converged: bool
    load_steps: int
    least_det: float  # det F where the body is compressed most


class Body:
    """An organ as a solid of quadratic tetrahedra, held at the triangles whose nodes are all fixed.

    near (k,): surface nodes under which the mesh is refined; grading: how far, the default if None.
    Raises UserError when the organ has no clamp, a material that is none, or a surface that can't be filled.
    """

    def __init__(self, organ: Organ, near: NDArray[Any] | None = None, grading: Grading | None = None) -> None:
        _check_material(organ)
        self.organ = organ
        self.filling = fill(organ, near, grading)
        held = np.zeros((len(self.filling.nodes), 3), dtype=bool)
        held[self.filling.facets[self.filling.clamped].ravel()] = True
        tissue = organ.youngs_modulus, organ.poisson_ratio, organ.density
        inclusions = inclusions_of(organ)
        stiffness = partial(stiffness_at, inclusions) if inclusions else None
        self.solid = Solid(self.filling.nodes, self.filling.elements, held, *tissue, stiffness)
        self.load_matrix = load_matrix(organ, self.filling)  # (n, n_surface) nodal loads per surface force

    @property
    def n_nodes(self) -> int:
        """Number of nodes, middles of edges included."""
        return len(self.solid.nodes)

    def loads(self, force: ArrayLike, acceleration: ArrayLike | None = None) -> Floats:
        """Nodal loads (n, 3) N of surface forces (n_surface, 3) N and a uniform acceleration (3,) m/s^2."""
        found: Floats = self.load_matrix @ np.asarray(force, dtype=np.float64)
        if acceleration is not None:
            weight = np.asarray(self.solid.mass.sum(axis=1)).ravel()
            found = found + weight[:, None] * np.asarray(acceleration, dtype=np.float64)
        return found

    def settle_linear(self, forces: ArrayLike, acceleration: ArrayLike | None = None) -> Floats:
        """Surface displacements (c, n_surface, 3) m of linear elasticity under forces (c, n_surface, 3) N.

        acceleration (3,) m/s^2 acts on the body's mass in every case, such as gravity.
        """
        forces = np.asarray(forces, dtype=np.float64)
        answer = np.empty(forces.shape)
        for first in range(0, len(forces), 64):
            part = slice(first, first + 64)
            loads = np.stack([self.loads(force, acceleration) for force in forces[part]])
            answer[part] = self.solid.solve(loads)[:, : self.organ.n_surface]
        return answer

    def settle(self, force: ArrayLike, acceleration: ArrayLike | None = None) -> Settled:
        """Rest of the neo-Hookean body under dead surface forces (n_surface, 3) N; see Solid.settle."""
        return next(self.settle_many([force], acceleration))

    def settle_many(self, forces: Iterable[ArrayLike], acceleration: ArrayLike | None = None) -> Iterator[Settled]:
        """Rest under each of several forces, in their order, as they are ready: a third of the time of one by one."""
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
    """Relative change of the volume inside the surface triangles under displacements (n_surface, 3) m."""
    now = signed_volume(organ.surface_positions + displacement, organ.surface_triangles)
    return now / organ.volume - 1.0


def load_matrix(organ: Organ, filling: FeMesh) -> csr_array:
    """Nodal loads per surface force, (n, n_surface).

    The force F_i at a surface node is the traction F_i phi_i(x) / A_i, where phi_i is 1 at the node and falls to 0
    across the triangles around it, and A_i its integral. The work that it does on the shape functions is integrated
    exactly where edges have their nodes in the middle.
    """
    skfem, _ = libraries()
    triangles = organ.surface_triangles
    total = node_area(organ.surface_positions, triangles)
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
    parts = np.einsum("fq,qa,fqc->fac", weight, values, hats, optimize=True)  # (f, 6, 3)
    nodes = triangles[filling.triangle]
    rows = np.broadcast_to(filling.facets[:, :, None], parts.shape)
    columns = np.broadcast_to(nodes[:, None, :], parts.shape)
    shape = len(filling.nodes), organ.n_surface
    matrix = coo_array(((parts / total[columns]).ravel(), (rows.ravel(), columns.ravel())), shape=shape)
    return matrix.tocsr()
