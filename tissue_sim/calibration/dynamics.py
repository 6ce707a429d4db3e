"""Motion of the finite-element body: let go from a settled shape, and its lowest frequencies."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import eye_array, kron
from scipy.sparse.linalg import LinearOperator, eigsh
from tqdm import tqdm

from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.solid import Solid, conjugate_gradients
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Floats

TOLERANCE = 1e-4  # of what the step's first guess misses, in the preconditioner's norm
MOST_STEPS = 15  # of Newton's method in a time step
FORCING = 0.1  # accuracy of a Newton step
SMOOTHED = 2  # steps after a release


class Motion(NamedTuple):
    """A motion, at t instants; the first is the start."""

    time: Floats  # (t,) s
    displacement: Floats  # (t, k, 3) m of the nodes asked for
    energy: Floats  # (t,) J, kinetic and elastic


def release(
    body: Body,
    force: ArrayLike,
    seconds: float,
    step: float,
    damping_rate: float,
    nodes: ArrayLike | None = None,
    linear: bool = False,
) -> Motion:
    """Settle the body under surface forces (n_surface, 3) N, let go, and follow surface nodes (k,), all if None.

    Neo-Hookean, or linear elasticity about rest. Consistent mass; the damping is proportional to it,
    damping_rate 1/s times the mass, so that every mode decays with damping_rate / 2.

    Raises UserError when the body doesn't settle, or when a time step doesn't converge.
    """
    solid, load = body.solid, body.loads(force)
    if linear:
        start = solid.solve(load[None])[0]
    else:
        rest = solid.settle(load)
        if not rest.converged:
            raise UserError("the finite-element body does not settle under this load; make it smaller")
        start = rest.displacement
    chosen = np.arange(body.organ.n_surface) if nodes is None else np.asarray(nodes)
    return swing(solid, start, seconds, step, damping_rate, chosen, linear, SMOOTHED)


def swing(
    solid: Solid,
    start: Floats,
    seconds: float,
    step: float,
    damping_rate: float,
    nodes: NDArray[Any],
    linear: bool = False,
    smoothed: int = 0,
) -> Motion:
    """Free motion of a solid from displacements (n, 3) m at rest, of which nodes (k,) are followed.

    Implicit midpoint rule: second order, symplectic, and for the linear solid it keeps the energy exactly. With
    d the displacement over half a step, (4/h^2 + 2c/h) M d + f(u + d) = (2/h) M v, where c is the damping rate.
    Frequencies far above 1/h keep neither their period nor their damping: where the start excites them, as a load
    does that is suddenly gone, the first `smoothed` steps are two half steps of implicit Euler each, which have the
    same matrix and quench them (Rannacher 1984); the order stays.

    Raises UserError for a step or duration that is none, or when a step doesn't converge.
    """
    if not (math.isfinite(step) and step > 0.0 and math.isfinite(seconds) and seconds >= step):
        raise UserError(f"a motion of {seconds:g} s in steps of {step:g} s is none; give a step within the duration")
    count = round(seconds / step)
    shift = 4.0 / step**2 + 2.0 * damping_rate / step
    factor = solid.factor(np.zeros_like(solid.nodes), shift)
    moved, velocity = np.where(solid.held, 0.0, start), np.zeros_like(start)
    half = np.zeros_like(start)
    history, energies = [moved[nodes]], [_energy(solid, moved, velocity, linear)]
    for number in tqdm(range(count), desc="implicit dynamics", unit="step", leave=False, mininterval=1.0, disable=None):
        for _ in range(2 if number < smoothed else 1):
            push = (2.0 / step) * (solid.mass @ velocity)
            if linear:
                right = np.where(solid.held, 0.0, push - (solid.stiffness @ moved.ravel()).reshape(moved.shape))
                half = factor.solve(right.reshape(-1, 1)).reshape(moved.shape)
            else:
                half = _half_step(solid, moved, push, shift, factor, half)
            if number < smoothed:
                moved, velocity = moved + half, (2.0 / step) * half
            else:
                moved, velocity = moved + 2.0 * half, (4.0 / step) * half - velocity
        history.append(moved[nodes])
        energies.append(_energy(solid, moved, velocity, linear))
    return Motion(np.linspace(0.0, step * count, count + 1), np.array(history), np.array(energies))


def _half_step(solid: Solid, moved: Floats, push: Floats, shift: float, factor: Any, guess: Floats) -> Floats:
    """Displacement (n, 3) m over half a step, by Newton's method from a guess."""
    half, first = guess.copy(), 0.0
    for _ in range(MOST_STEPS):
        _, inner, least = solid.energy(moved + half)
        if least <= 0.0:
            half *= 0.5  # the guess turns an element over
            continue
        residual = np.where(solid.held, 0.0, push - shift * (solid.mass @ half) - inner)
        error = math.sqrt(float(np.vdot(residual, factor.precondition(residual.reshape(-1, 1)))))
        first = first or math.sqrt(float(np.vdot(push, factor.precondition(push.reshape(-1, 1))))) or error
        if error <= TOLERANCE * first:
            return half
        matrix, here = solid.tangent(moved + half), half

        def apply(way: Floats, matrix: Any = matrix) -> Floats:
            found: Floats = (matrix @ way.ravel()).reshape(way.shape) + shift * (solid.mass @ way)
            found[solid.held] = 0.0
            return found

        run = conjugate_gradients(apply, residual, FORCING, factor)
        try:
            next(run)
        except StopIteration as end:
            half = here + end.value[0]
    raise UserError("a time step of the finite-element body does not converge; take a shorter step")


def _energy(solid: Solid, moved: Floats, velocity: Floats, linear: bool) -> float:
    kinetic = 0.5 * float(np.vdot(velocity, solid.mass @ velocity))
    if linear:
        return kinetic + 0.5 * float(moved.ravel() @ (solid.stiffness @ moved.ravel()))
    return kinetic + solid.energy(moved)[0]


def lowest_frequencies(body: Body, count: int) -> Floats:
    """The lowest frequencies (count,) Hz of the body about rest, undamped."""
    return frequencies(body.solid, count)


def frequencies(solid: Solid, count: int) -> Floats:
    """The lowest frequencies (count,) Hz of a held solid about rest: K p = w^2 M p, by inverse iteration."""
    free = np.flatnonzero(~solid.held.ravel())
    if not 0 < count < len(free):
        raise UserError(f"{count} frequencies were asked for; the body has 1..{len(free) - 1}")
    stiffness = solid.stiffness.tocsr()[free][:, free]
    mass = kron(solid.mass, eye_array(3), format="csr")[free][:, free]
    whole = np.zeros((solid.nodes.size, 1))

    def invert(right: Floats) -> Floats:
        whole[free, 0] = right.ravel()
        return solid.solve(whole.reshape(1, -1, 3)).ravel()[free]

    inverse = LinearOperator(stiffness.shape, matvec=invert, dtype=np.float64)
    start = np.random.default_rng(0).normal(size=len(free))
    squares = eigsh(stiffness, count, mass, sigma=0.0, OPinv=inverse, v0=start, return_eigenvectors=False)
    return np.sqrt(np.sort(squares)) / (2.0 * math.pi)
