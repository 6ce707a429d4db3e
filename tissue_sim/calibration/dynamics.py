"""Motion of the finite-element body: released from an equilibrium, and its lowest frequencies."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import kron
from scipy.sparse.linalg import LinearOperator, eigsh

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.cholesky import Cholesky, NotPositive
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.solid import Solid
from tissue_sim.errors import UserError

TOLERANCE = 1e-3  # of the forces and inertia of a step, in the norm of its matrix
MOST_ITERATIONS = 60  # in a time step
WORN = 20  # iterations in a time step, after which the matrix is factored again
UPHILL = 1e-9  # relative increase of a step's energy that may be rounding
KEPT = 8  # steps that L-BFGS remembers
SMOOTHED = 2  # steps after a release


class Unsteady(UserError):
    """Error raised for a time step that doesn't converge."""


class Start(NamedTuple):
    """State from which a solid moves.

    Frequencies far above the inverse of a time step keep neither their period nor their damping: where a start excites
    them, as a load that vanishes suddenly does, the first `smoothed` steps damp them.
    """

    displacement: Floats  # (n, 3) m
    velocity: Floats | None = None  # (n, 3) m/s; None for rest
    smoothed: int = 0


class Forces(NamedTuple):
    """Forces on a solid that moves."""

    damping_rate: float  # 1/s, damping over mass
    linear: bool = False  # whether elasticity is
    load: Floats | Callable[[float], Floats] | None = None  # (n, 3) N, or a function of the time, s, that returns them


class Steps(NamedTuple):
    """Time steps of a motion."""

    seconds: float  # of all of them
    length: float  # s, of one


class Motion(NamedTuple):
    """Motion at t instants; the first is the start."""

    time: Floats  # (t,) s
    displacement: Floats  # (t, k, 3) m of the requested nodes
    energy: Floats  # (t,) J, kinetic and elastic


def release(
    body: Body,
    force: ArrayLike,
    steps: Steps,
    damping_rate: float,
    nodes: ArrayLike | None = None,
    linear: bool = False,
) -> Motion:
    """Settle the body under surface forces, release it, and follow surface nodes.

    Neo-Hookean, or linear elasticity about rest. The mass is consistent; the damping is proportional to it, so that
    every mode decays with damping_rate / 2.

    Parameters
    ----------
    body : Body
        The finite-element body.
    force : ArrayLike, shape (n_surface, 3), N
        Forces on the surface nodes.
    steps : Steps
        The time steps.
    damping_rate : float, 1/s
        Damping over mass.
    nodes : ArrayLike | None, shape (k,), optional
        Surface nodes that are followed; None for all.
    linear : bool, optional
        Whether elasticity is linear.

    Raises
    ------
    UserError
        Where the body doesn't settle, or a time step doesn't converge.
    """
    solid, load = body.solid, body.loads(force)
    if linear:
        start = solid.solve(load[None])[0]
    else:
        rest = solid.settle(load)
        if not rest.converged:
            raise UserError("the finite-element body does not converge under this load; reduce it")
        start = rest.displacement
    chosen = np.arange(body.organ.n_surface) if nodes is None else np.asarray(nodes)
    return swing(solid, Start(start, smoothed=SMOOTHED), Forces(damping_rate, linear), steps, chosen)


def swing(
    solid: Solid,
    start: Start,
    forces: Forces,
    steps: Steps,
    nodes: Longs,
    watch: Callable[[], None] | None = None,
) -> Motion:
    """Return the motion of a solid.

    Implicit midpoint rule: second order, symplectic, and for the linear solid it keeps the energy exactly. With d the
    displacement over half a step, (4/h^2 + 2c/h) M d + f(u + d) = (2/h) M v + p, where p is the load and c the damping
    rate.

    The smoothed steps are two half steps of implicit Euler each, which have the same matrix and damp high frequencies;
    the order is unchanged. The energy doesn't include that of the load.

    Parameters
    ----------
    solid : Solid
        The solid.
    start : Start
        State at the start.
    forces : Forces
        What acts on it.
    steps : Steps
        The time steps.
    nodes : Longs, shape (k,)
        Nodes that are followed.
    watch : Callable[[], None] | None, optional
        Called after every step.

    Raises
    ------
    UserError
        For an invalid step or duration, and where a step doesn't converge.

    References
    ----------
    Rannacher 1984: Finite element solution of diffusion problems with irregular data.
    """
    damping_rate, linear, load = forces
    seconds, step = steps
    if not (math.isfinite(step) and step > 0.0 and math.isfinite(seconds) and seconds >= step):
        raise UserError(f"a motion of {seconds:g} s can't have steps of {step:g} s; give a shorter step")
    count = round(seconds / step)
    shift = 4.0 / step**2 + 2.0 * damping_rate / step
    factor = solid.factor(np.zeros_like(solid.nodes), shift)
    moved = np.where(solid.held, 0.0, start.displacement)
    velocity = np.zeros_like(moved) if start.velocity is None else np.where(solid.held, 0.0, start.velocity)
    pull = np.zeros_like(moved) if load is None or callable(load) else load
    half = np.zeros_like(moved)
    history, energies = [moved[nodes]], [_energy(solid, moved, velocity, linear)]
    for number in range(count):
        for part in range(2 if number < start.smoothed else 1):
            if callable(load):  # at the end of a half step of Euler's, which is the middle of a whole one
                pull = load(step * (number + 0.5 * (part + 1)))
            push = (2.0 / step) * (solid.mass @ velocity) + pull
            if linear:
                right = np.where(solid.held, 0.0, push - (solid.stiffness @ moved.ravel()).reshape(moved.shape))
                half = factor.solve(right.reshape(-1, 1)).reshape(moved.shape)
            else:
                try:
                    half, used = _half_step(solid, moved, push, shift, factor, half)
                except Unsteady:
                    factor = _about(solid, moved, shift, factor)
                    half, used = _half_step(solid, moved, push, shift, factor, np.zeros_like(half))
                if used > WORN:
                    factor = _about(solid, moved, shift, factor)
            if number < start.smoothed:
                moved, velocity = moved + half, (2.0 / step) * half
            else:
                moved, velocity = moved + 2.0 * half, (4.0 / step) * half - velocity
        history.append(moved[nodes])
        energies.append(_energy(solid, moved, velocity, linear))
        if watch is not None:
            watch()
    return Motion(np.linspace(0.0, step * count, count + 1), np.array(history), np.array(energies))


def _about(solid: Solid, moved: Floats, shift: float, other: Cholesky) -> Cholesky:
    """Return the factor of a step about a state far from rest; the other one where that state is unstable."""
    try:
        return solid.factor(moved, shift)
    except NotPositive:
        return other


def _half_step(
    solid: Solid, moved: Floats, push: Floats, shift: float, factor: Cholesky, guess: Floats
) -> tuple[Floats, int]:
    """Return the displacement (n, 3) m over half a step, from a guess, and the number of iterations.

    L-BFGS (Nocedal 1980) about the matrix of the solid at rest, or not far from here, whose mass part is exact: a few
    iterations, where Newton's method would assemble a matrix for each. Raises Unsteady when it doesn't converge.
    """
    half, enough, level = guess.copy(), 0.0, math.inf
    steps: list[Floats] = []
    changes: list[Floats] = []
    before, taken = np.zeros_like(half), np.zeros_like(half)
    for used in range(1, MOST_ITERATIONS + 1):
        energy, inner, least = solid.energy(moved + half)
        reached = energy + float(np.vdot(half, 0.5 * shift * (solid.mass @ half) - push))
        # An element is inverted, or the energy rises, as where a solid is nearly incompressible: the step is halved.
        if least <= 0.0 or (taken.any() and reached > level + UPHILL * abs(level)):
            half, taken = half - 0.5 * taken if taken.any() else 0.5 * half, 0.5 * taken
            if least <= 0.0:
                steps, changes = [], []
            continue
        level = reached
        slope = np.where(solid.held, 0.0, shift * (solid.mass @ half) + inner - push)
        if taken.any() and float(np.vdot(taken, slope - before)) > 0.0:
            steps, changes = [*steps[1 - KEPT :], taken], [*changes[1 - KEPT :], slope - before]
        q, fractions = slope.copy(), []
        for step, change in zip(reversed(steps), reversed(changes), strict=True):
            fractions.append(float(np.vdot(step, q)) / float(np.vdot(step, change)))
            q -= fractions[-1] * change
        descent = factor.precondition(q.reshape(-1, 1)).reshape(q.shape)
        for step, change, fraction in zip(steps, changes, reversed(fractions), strict=True):
            descent += step * (fraction - float(np.vdot(change, descent)) / float(np.vdot(step, change)))
        size = math.sqrt(max(float(np.vdot(slope, descent)), 0.0))
        enough = enough or TOLERANCE * _size(solid, push - np.where(solid.held, 0.0, inner), factor)
        before, taken = slope, -descent
        half = half + taken
        if size <= enough:
            return half, used
    raise Unsteady("a time step of the finite-element body does not converge; take a shorter step")


def _size(solid: Solid, forces: Floats, factor: Cholesky) -> float:
    """Return the norm of forces (n, 3) N by the work that they do on the solid."""
    free = np.where(solid.held, 0.0, forces)
    return math.sqrt(max(float(np.vdot(free, factor.precondition(free.reshape(-1, 1)))), 0.0))


def _energy(solid: Solid, moved: Floats, velocity: Floats, linear: bool) -> float:
    kinetic = 0.5 * float(np.vdot(velocity, solid.mass @ velocity))
    if linear:
        return kinetic + 0.5 * float(moved.ravel() @ (solid.stiffness @ moved.ravel()))
    return kinetic + solid.energy(moved)[0]


def lowest_frequencies(body: Body, count: int) -> Floats:
    """Return the lowest frequencies of the body about rest, undamped.

    Parameters
    ----------
    body : Body
        The finite-element body.
    count : int
        Number of frequencies.

    Returns
    -------
    Floats, shape (count,), Hz
        Frequencies, ascending.
    """
    return frequencies(body.solid, count)


def frequencies(solid: Solid, count: int) -> Floats:
    """Return the lowest frequencies (count,) Hz of a held solid about rest: K p = w^2 M p, by inverse iteration."""
    free = np.flatnonzero(~solid.held.ravel())
    if not 0 < count < len(free):
        raise UserError(f"{count} frequencies were requested; the body has 1..{len(free) - 1}")
    stiffness = solid.stiffness.tocsr()[free][:, free]
    mass = kron(solid.mass, np.eye(3), format="csr")[free][:, free]
    whole = np.zeros((solid.nodes.size, 1))

    def invert(right: Floats) -> Floats:
        whole[free, 0] = right.ravel()
        return solid.solve(whole.reshape(1, -1, 3)).ravel()[free]

    inverse = LinearOperator(stiffness.shape, matvec=invert, dtype=np.float64)
    start = np.random.default_rng(0).normal(size=len(free))
    squares = eigsh(stiffness, count, mass, sigma=0.0, OPinv=inverse, v0=start, return_eigenvectors=False)
    return np.sqrt(np.sort(squares)) / (2.0 * math.pi)
