"""Linear finite elements, factored beforehand: one solve per answer, and the same as a table of compliances."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from tissue_sim.array_types import Floats
from tissue_sim.bench.compliance import Product
from tissue_sim.bench.peers.engine import Answer, Load, timed
from tissue_sim.bench.peers.tetrahedra import UNGRADED, Tetrahedra
from tissue_sim.bench.timing import Burst, time_calls
from tissue_sim.calibration.fe_mesh import libraries
from tissue_sim.calibration.fem import Body
from tissue_sim.organ.organ import Organ

UPDATE = 0.001  # s of an update, which is solved once per tick
AT_ONCE = 64  # columns of a compliance solved together


class LinearTetrahedra:
    """Linear elasticity on linear tetrahedra, which lock. Raises UserError without skfem."""

    def __init__(self, organ: Organ, mesh: Tetrahedra) -> None:
        skfem, _ = libraries()
        from skfem.models.elasticity import lame_parameters, linear_elasticity

        self.organ, self.update = organ, UPDATE
        grid = skfem.MeshTet(np.ascontiguousarray(mesh.nodes.T), np.ascontiguousarray(mesh.cells.T))
        basis = skfem.CellBasis(grid, skfem.ElementVector(skfem.ElementTetP1()))
        matrix = linear_elasticity(*lame_parameters(organ.youngs_modulus, organ.poisson_ratio)).assemble(basis)
        free = np.ones((len(mesh.nodes), 3), dtype=bool)
        free[organ.fixed] = False
        axes = np.asarray(basis.nodal_dofs.T).ravel()  # skfem's number of each axis
        self.free = free  # (p, 3) axes that move
        self.stiffness = matrix.tocsr()[axes][:, axes]  # (3p, 3p) N/m
        inside = self.stiffness[free.ravel()][:, free.ravel()].tocsc()
        options = {"SymmetricMode": True}
        self._factors = splu(inside, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)

    def settle(self, load: Load) -> Answer:
        """Solve once."""
        found = np.zeros(self.free.shape)
        right = self._right(load)

        def solve() -> None:
            found[self.free] = self._factors.solve(right)

        seconds = timed(solve)
        return Answer(found[: self.organ.n_surface], seconds, True)

    def burst(self, load: Load) -> Burst:
        """Return a function that times solves."""
        right = self._right(load)
        return lambda count: time_calls(lambda: self._factors.solve(right), count)

    def _right(self, load: Load) -> Floats:
        forces = np.zeros(self.free.shape)
        forces[: self.organ.n_surface] = load.force
        return forces[self.free]


class QuadraticTetrahedra:
    """Linear elasticity on quadratic tetrahedra. Raises UserError without skfem."""

    def __init__(self, organ: Organ) -> None:
        self.organ, self.update = organ, UPDATE
        self.body = Body(organ, grading=UNGRADED)
        self.body.settle_linear(np.zeros((1, organ.n_surface, 3)))  # factors, before anything is timed

    def settle(self, load: Load) -> Answer:
        """Solve once."""
        found: list[Floats] = []
        seconds = timed(lambda: found.append(self.body.settle_linear(load.force[None])[0]))
        return Answer(found[0], seconds, True)

    def burst(self, load: Load) -> Burst:
        """Return a function that times solves."""
        return lambda count: time_calls(lambda: self.body.settle_linear(load.force[None]), count)


class Compliance:
    """Table of surface displacements under unit forces, of the quadratic body, in single precision.

    table (3 n, 3 n) m/N; one_patch: use only the columns of the loaded nodes, as for a tool that can't be anywhere
    else.
    """

    def __init__(self, organ: Organ, table: NDArray[np.float32], *, one_patch: bool = False) -> None:
        self.organ, self.update = organ, UPDATE
        self._table, self._one_patch = table, one_patch

    def settle(self, load: Load) -> Answer:
        """Compute one product."""
        product = self._product(load)
        seconds = float(np.median(product(3)))
        return Answer(product.displacement.reshape(-1, 3).astype(np.float64), seconds, True)

    def burst(self, load: Load) -> Burst:
        """Return a function that times products."""
        return self._product(load)

    def _product(self, load: Load) -> Product:
        if not self._one_patch:
            return Product(self._table, load.force)
        nodes = load.nodes
        columns = (3 * nodes[:, None] + np.arange(3)).ravel()
        return Product(np.ascontiguousarray(self._table[:, columns]), load.force[nodes])


def compliance_table(body: Body) -> NDArray[np.float32]:
    """Return the displacements of the surface nodes under a unit force on any of them, (3 n, 3 n) m/N."""
    n = body.organ.n_surface
    table = np.empty((3 * n, 3 * n), dtype=np.float32)
    for first in range(0, 3 * n, AT_ONCE):
        columns = np.arange(first, min(first + AT_ONCE, 3 * n))
        unit = np.zeros((len(columns), 3 * n))
        unit[np.arange(len(columns)), columns] = 1.0
        found = body.settle_linear(unit.reshape(-1, n, 3))
        table[:, columns] = found.reshape(len(columns), 3 * n).T
    return table
