"""Solid of quadratic tetrahedra: stiffness, mass, and its answers to loads, linear and hyperelastic."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, csr_array

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.calibration.cholesky import Cholesky, Front, NotPositive, Pieces, add_elements, dissect
from tissue_sim.calibration.conjugate_gradients import Preconditioner, Renewable, conjugate_gradients
from tissue_sim.calibration.fe_mesh import libraries
from tissue_sim.calibration.neo_hookean import NODES, Elements, Moduli, energy_and_forces, tangent

QUADRATURE = 2  # order: four points, exact for the products of strains of straight quadratic elements
MASS_QUADRATURE = 7  # elements at quarter points included
AT_ONCE = 64  # right-hand sides solved together
TOLERANCE = 1e-6  # of the load, in the energy norm of the solid at rest
MOST_STEPS = 80  # of Newton's method for one load step
QUICK = 6  # steps, after which the next load step is twice as large
MOST_LOAD_STEPS = 64
MOST_STEPS_IN_ALL = 160  # under one load, after which it is given up: near buckling one took a quarter of an hour
MOST_HALVINGS = 40
WORN = 40  # iterations for a step, after which a new preconditioner is cheaper
MOST_TOGETHER = 16  # loads that settle together
MEMORY = 5e8  # bytes of their matrices
FORCING = 0.1  # of a residual, to which a step that follows is solved
ROOM = 1e-4  # least decrease of energy of a step, relative to that of its slope (Armijo)


class Material(NamedTuple):
    """Material of a body."""

    youngs_modulus: float  # Pa
    poisson_ratio: float
    density: float  # kg/m^3
    stiffening: float = 0.0  # Demiray's b; 0: neo-Hookean

    @property
    def moduli(self) -> Moduli:
        """Its shear modulus, Lame's first constant and Demiray's b."""
        modulus, ratio = self.youngs_modulus, self.poisson_ratio
        lam = modulus * ratio / ((1.0 + ratio) * (1.0 - 2.0 * ratio))
        return Moduli(modulus / (2.0 * (1.0 + ratio)), lam, self.stiffening)


class Equilibrium(NamedTuple):
    """Equilibrium of a solid."""

    displacement: Floats  # (n, 3) m of all nodes
    load_steps: int
    steps: int  # of Newton's method
    iterations: int  # of conjugate gradients, in all
    least_det: float  # det F where the solid is compressed most
    converged: bool


class Followed(NamedTuple):
    """Equilibrium of a solid near a given state."""

    displacement: Floats  # (n, 3) m of all nodes
    converged: bool


Settling = Generator[Floats, Floats, Equilibrium]


class Solid:
    """Body of compressible neo-Hookean material, of quadratic tetrahedra.

    Parameters
    ----------
    nodes : Floats, shape (n, 3), m
        Nodes as in FeMesh.
    elements : Ints, shape (e, 10)
        Node indices as in FeMesh.
    held : NDArray[np.bool_], shape (n, 3)
        Axes that don't move.
    material : Material
        The material.
    stiffness : Callable[[Floats], Floats] | None, optional
        Returns the factor of the moduli at quadrature points (e, q, 3) m; None for 1 everywhere.
    """

    def __init__(
        self,
        nodes: Floats,
        elements: Ints,
        held: NDArray[np.bool_],
        material: Material,
        stiffness: Callable[[Floats], Floats] | None = None,
    ) -> None:
        self.nodes, self.elements, self.held, self.density = nodes, elements, held, material.density
        self.ties: Floats | None = None  # (n,) N/m: springs that pull the nodes' displacements to 0
        self.moduli = material.moduli
        values, slopes, weights = shape_functions(QUADRATURE)
        jacobian = np.einsum("eax,qar->eqxr", nodes[elements], slopes)
        weight = np.abs(np.linalg.det(jacobian)) * weights
        if stiffness is not None:  # energy goes with both moduli
            weight *= stiffness(np.einsum("eax,qa->eqx", nodes[elements], values))
        self._at_points = Elements(elements, slopes, np.ascontiguousarray(np.linalg.inv(jacobian)), weight)
        n = len(self.nodes)
        keys = self.elements[:, :, None].astype(np.int64) * n + self.elements[:, None, :]
        pairs, slots = np.unique(keys, return_inverse=True)
        self._slots = np.ascontiguousarray(slots.reshape(keys.shape).astype(np.int32))
        self._row_start = np.searchsorted(pairs // n, np.arange(n + 1)).astype(np.int32)
        self._columns = (pairs % n).astype(np.int32)

    # matrices ----------------------------------------------------------------------------------
    def tangent(self, displacement: Floats) -> bsr_array:
        """Return the stiffness about a displaced state, held axes included, without ties.

        Parameters
        ----------
        displacement : Floats, shape (n, 3), m
            The displacement.

        Returns
        -------
        bsr_array
            shape (3n, 3n), N/m
        """
        blocks = np.empty((len(self._columns), 3, 3))
        tangent(displacement, self._at_points, self.moduli, self._slots, blocks)
        n = len(self.nodes)
        return bsr_array((blocks, self._columns, self._row_start), shape=(3 * n, 3 * n))

    def energy(self, displacement: Floats) -> tuple[float, Floats, float]:
        """Return the elastic energy J, its gradient (n, 3) N, and the least det F; the energy is inf where inverted.

        Parameters
        ----------
        displacement : Floats, shape (n, 3), m
            The displacement.
        """
        forces = np.empty_like(self.nodes)
        energy, least = energy_and_forces(displacement, self._at_points, self.moduli, forces)
        if self.ties is not None:
            pull = self.ties[:, None] * displacement
            return energy + 0.5 * float(np.vdot(pull, displacement)), forces + pull, least
        return energy, forces, least

    @cached_property
    def stiffness(self) -> bsr_array:
        """Stiffness (3n, 3n) N/m at rest: linear elasticity."""
        return self.tangent(np.zeros_like(self.nodes))

    @cached_property
    def _element_masses(self) -> Floats:
        values, slopes, weights = shape_functions(MASS_QUADRATURE)
        jacobian = np.einsum("eax,qar->eqxr", self.nodes[self.elements], slopes)
        weight = self.density * np.abs(np.linalg.det(jacobian)) * weights
        matrices: Floats = np.einsum("eq,qa,qb->eab", weight, values, values, optimize=True)
        return matrices

    @cached_property
    def mass(self) -> csr_array:
        """Consistent mass (n, n) kg, the same for all three axes."""
        found = np.bincount(self._slots.ravel(), self._element_masses.ravel(), len(self._columns))
        n = len(self.nodes)
        return csr_array((found, self._columns, self._row_start), shape=(n, n))

    def add_masses(self, masses: Floats) -> None:
        """Add point masses to nodes, beside the tissue's own mass: weights that hang there.

        Parameters
        ----------
        masses : Floats, shape (n,), kg
            The masses.
        """
        mass = (masses / np.maximum(np.bincount(self.elements.ravel(), minlength=len(masses)), 1))[self.elements]
        corner = np.arange(NODES)
        self._element_masses[:, corner, corner] += mass
        self.__dict__.pop("mass", None)  # the matrix is assembled from them

    @cached_property
    def _factor(self) -> Cholesky:
        return self.factor(np.zeros_like(self.nodes))

    @cached_property
    def _fronts(self) -> list[Front]:
        return dissect(self.elements, self.nodes[self.elements[:, :4]].mean(axis=1), self.held)

    def factor(self, displacement: Floats, shift: float = 0.0) -> Cholesky:
        """Return the Cholesky factor of the stiffness about a displaced state, plus a multiple of the mass.

        Ties are included.

        Parameters
        ----------
        displacement : Floats, shape (n, 3), m
            The displacement.
        shift : float, 1/s^2, optional
            Factor on the mass.

        Raises
        ------
        NotPositive
            When it has none.
        """

        def fill(number: int, place: Longs, pieces: Pieces) -> None:
            cells, inside = self._fronts[number].cells, self._fronts[number].inside
            if self.ties is not None:
                own = np.arange(len(inside))
                pieces[0][own, own] += self.ties[inside // 3]
            count = len(cells)
            if not count:
                return
            blocks = np.empty((count * NODES**2, 3, 3))
            slots = np.arange(len(blocks), dtype=np.int32).reshape(count, NODES, NODES)
            every = self._at_points
            chosen = Elements(every.nodes[cells], every.slopes, every.inverse[cells], every.weight[cells])
            tangent(displacement, chosen, self.moduli, slots, blocks)
            if shift:
                blocks += shift * self._element_masses[cells].reshape(-1, 1, 1) * np.eye(3)
            apart = blocks.reshape(count, NODES, NODES, 3, 3).transpose(0, 1, 3, 2, 4)
            matrices = np.ascontiguousarray(apart).reshape(count, 3 * NODES, 3 * NODES)
            add_elements(matrices, self.elements[cells], place, pieces)

        return Cholesky(self._fronts, len(self.nodes), fill)

    def solve(self, loads: Floats) -> Floats:
        """Return linear displacements (c, n, 3), m, under nodal loads.

        Parameters
        ----------
        loads : Floats, shape (c, n, 3), N
            The loads.
        """
        loads = np.asarray(loads, dtype=np.float64)
        answer = np.empty(loads.shape)
        for first in range(0, len(loads), AT_ONCE):
            part = loads[first : first + AT_ONCE]
            answer[first : first + AT_ONCE] = self._factor.solve(part.reshape(len(part), -1).T).T.reshape(part.shape)
        return answer

    # equilibrium -------------------------------------------------------------------------------
    def settle(self, load: Floats) -> Equilibrium:
        """Return the equilibrium of the neo-Hookean solid under dead nodal loads (n, 3) N.

        Newton's method on the potential energy, every step by conjugate gradients with the linear solid as
        preconditioner, cut where curvature is negative (Steihaug 1983), and shortened until the energy falls. The whole
        load is applied at once; halved where that fails.
        """
        return next(self.settle_many([load]))

    def settle_many(self, loads: Iterable[Floats]) -> Iterator[Equilibrium]:
        """Yield equilibria under several loads, in their order, each as it is ready; see settle.

        Several advance together, so that they share the preconditioner: reading it takes most of the time.

        Parameters
        ----------
        loads : Iterable[Floats], shape (n, 3), N
            The loads.
        """
        room = max(1, min(MOST_TOGETHER, int(MEMORY / (9 * 8 * len(self._columns)))))
        waiting = iter(enumerate(loads))
        running: dict[int, tuple[Settling, Floats]] = {}
        ready: dict[int, Equilibrium] = {}
        following, more = 0, True
        while more or running or ready:
            while more and len(running) < room:
                number, load = next(waiting, (-1, self.nodes))
                more = number >= 0
                if more:
                    run = self._settling(load)
                    _advance(number, run, None, running, ready)
            if running:
                residuals = np.stack([residual.ravel() for _, residual in running.values()], axis=1)
                answers = self._factor.precondition(residuals)
                for column, number in enumerate(list(running)):
                    run, residual = running.pop(number)
                    _advance(number, run, answers[:, column].reshape(residual.shape), running, ready)
            while following in ready:
                yield ready.pop(following)
                following += 1

    def follow(self, start: Floats, load: Floats, factor: Renewable, tolerance: float) -> Followed:
        """Return the equilibrium near a state under nodal loads, with ties, by Newton's method.

        Parameters
        ----------
        start : Floats, shape (n, 3), m
            Displacement of the state.
        load : Floats, shape (n, 3), N
            The loads.
        factor : Renewable
            The preconditioner, which is renewed where it is worn.
        tolerance : float
            Fraction of the tissue's energy that a step may still release.
        """
        moved = start
        energy, inner, _ = self.energy(moved)
        potential = energy - float(np.vdot(load, moved))
        for _ in range(MOST_STEPS):
            residual = np.where(self.held, 0.0, load - inner)
            direction, used = _answer(self._direction(moved, residual, FORCING, factor))
            slope = float(np.vdot(residual, direction))
            tied = 0.0 if self.ties is None else 0.5 * float(self.ties @ np.einsum("nx,nx->n", moved, moved))
            if slope <= tolerance * (energy - tied):
                return Followed(moved, True)
            found = self._shortened(moved, direction, slope, load, potential)
            if found is None:
                return Followed(moved, False)
            moved, energy, inner, change = found
            potential += change
            if used > WORN:
                factor.renew(moved)
        return Followed(moved, False)

    def _shortened(
        self, moved: Floats, direction: Floats, slope: float, load: Floats, potential: float
    ) -> tuple[Floats, float, Floats, float] | None:
        """Return a state down the direction at which the potential energy has fallen enough; None without one.

        Beside it the energy and its gradient there, and the change of the potential energy.
        """
        length = 1.0
        for _ in range(MOST_HALVINGS):
            trial = moved + length * direction
            energy, inner, _ = self.energy(trial)
            change = float(energy - np.vdot(load, trial) - potential)
            # Near the end the energy's rounding hides its change.
            if change <= -ROOM * length * slope + 1e-12 * abs(potential):
                return trial, energy, inner, change
            length *= 0.5
        return None

    def _settling(self, load: Floats) -> Settling:
        """Settle under one load; yield residuals (n, 3) N and receive their displacements by the solid at rest."""
        displacement = np.zeros_like(self.nodes)
        done, fraction, load_steps, steps, iterations = 0.0, 1.0, 0, 0, 0
        factor: Cholesky | None = None
        while done < 1.0 and load_steps < MOST_LOAD_STEPS and steps < MOST_STEPS_IN_ALL:
            load_steps += 1
            wanted = min(1.0, done + fraction)
            start = displacement, wanted * load, factor
            found, used, inner, converged, factor = yield from self._newton(*start)
            steps, iterations = steps + used, iterations + inner
            if converged:
                displacement, done = found, wanted
                fraction *= 2.0 if used <= QUICK else 1.0
            else:
                fraction *= 0.5
                factor = self._factor_or(displacement, None)
        return Equilibrium(displacement, load_steps, steps, iterations, self.energy(displacement)[2], done >= 1.0)

    def _factor_or(self, displacement: Floats, other: Cholesky | None) -> Cholesky | None:
        """Return the factor about a displaced state, or the other where that state is unstable."""
        try:
            return self.factor(displacement)
        except NotPositive:
            return other

    def _newton(
        self, start: Floats, load: Floats, factor: Cholesky | None
    ) -> Generator[Floats, Floats, tuple[Floats, int, int, bool, Cholesky | None]]:
        """Run Newton's method from a state (n, 3) m; a factor replaces that at rest as preconditioner.

        Returns the state, steps, iterations, whether it converged, and the last factor.
        """
        held, moved, iterations = self.held, start.copy(), 0
        pull = np.where(held, 0.0, load)
        size = math.sqrt(max(float(np.vdot(pull, (yield pull))), 0.0))
        if size == 0.0:
            return np.zeros_like(moved), 0, 0, True, factor
        energy, inner, _ = self.energy(moved)
        potential = float(energy - np.vdot(load, moved))
        before: float | None = None
        for step in range(MOST_STEPS):
            residual = np.where(held, 0.0, load - inner)
            # The norm is that of the solid at rest whatever the preconditioner, so that the tolerance means the same.
            error = math.sqrt(max(float(np.vdot(residual, (yield residual))), 0.0)) / size
            if error <= TOLERANCE:
                return moved, step, iterations, True, factor
            # Eisenstat & Walker 1996, choice 2: no more accurate than the step requires.
            forcing = 0.1 if before is None else min(0.1, 0.9 * (error / before) ** 2)
            before = error
            forcing = max(forcing, 0.1 * TOLERANCE / error)
            direction, used = yield from self._direction(moved, residual, forcing, factor)
            iterations += used
            shortened = self._shortened(moved, direction, float(np.vdot(residual, direction)), load, potential)
            if shortened is None:
                return moved, step, iterations, False, factor
            moved, energy, inner, change = shortened
            potential += change
            if used > WORN:
                factor = self._factor_or(moved, factor)
        return moved, MOST_STEPS, iterations, False, factor

    def _direction(
        self, moved: Floats, residual: Floats, forcing: float, factor: Preconditioner | None
    ) -> Generator[Floats, Floats, tuple[Floats, int]]:
        """Return Newton's direction; see conjugate_gradients."""
        matrix = self.tangent(moved)

        def apply(direction: Floats) -> Floats:
            found: Floats = (matrix @ direction.ravel()).reshape(direction.shape)
            if self.ties is not None:
                found += self.ties[:, None] * direction
            found[self.held] = 0.0
            return found

        return (yield from conjugate_gradients(apply, residual, forcing, factor))


def _answer(run: Generator[Floats, Floats, tuple[Floats, int]]) -> tuple[Floats, int]:
    """Return the result of conjugate gradients that have a factor."""
    try:
        next(run)
    except StopIteration as end:
        found: tuple[Floats, int] = end.value
        return found
    raise AssertionError("a factor preconditions")


def _advance(
    number: int,
    run: Settling,
    answer: Floats | None,
    running: dict[int, tuple[Settling, Floats]],
    ready: dict[int, Equilibrium],
) -> None:
    """Continue one load's settling to its next residual, or to its end."""
    try:
        running[number] = run, (next(run) if answer is None else run.send(answer))
    except StopIteration as end:
        ready[number] = end.value


def shape_functions(order: int) -> tuple[Floats, Floats, Floats]:
    """Return quadratic shape functions at a quadrature rule on the reference tetrahedron.

    Values (q, 10), gradients (q, 10, 3), and weights (q,), whose sum is the volume 1/6.
    """
    skfem, _ = libraries()
    points, weights = skfem.quadrature.get_quadrature(skfem.refdom.RefTet, order)
    found = [skfem.ElementTetP2().lbasis(points, node) for node in range(NODES)]
    values = np.stack([value for value, _ in found], axis=1)
    slopes = np.stack([slope for _, slope in found])
    return values, np.ascontiguousarray(slopes.transpose(2, 0, 1)), weights
