"""The force with which finite elements resist where tools hold the surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.calibration.cholesky import NotPositive
from tissue_sim.calibration.fe_mesh import Grading
from tissue_sim.calibration.fem import Body
from tissue_sim.calibration.solid import Solid
from tissue_sim.organ.organ import Organ

STEPS = 6  # in which the surface is brought where it is held, at the least
SHORTEST = 1.0 / 192.0  # of the way, that a step is halved to
MOST_ITERATIONS = 25  # of Newton's method
TOLERANCE = 1e-4  # of the force


class Pinched(NamedTuple):
    """Where two tools hold the surface."""

    one: Longs  # surface nodes
    other: Longs
    displacement: Floats  # (n_surface, 3) m of all surface nodes


def held_force(organ: Organ, pinched: Pinched) -> float:
    """Force, N, on the first tool; not a number where the finite elements don't settle.

    Quadratic, neo-Hookean, and held at those nodes where the tools hold them: the same contact. The mesh is that of the
    calibration, without the finest elements at the clamp.
    """
    touched = np.concatenate([pinched.one, pinched.other])
    if not len(pinched.one) or not len(pinched.other):
        return float("nan")
    body = Body(organ, near=touched, grading=Grading(clamp=0))
    clamped = body.solid.held
    held = clamped.copy()
    held[touched] = True  # the surface's own nodes come first
    tissue = organ.youngs_modulus, organ.poisson_ratio, organ.density
    solid = Solid(body.solid.nodes, body.solid.elements, held, *tissue)
    goal = np.zeros_like(solid.nodes)
    goal[touched] = pinched.displacement[touched]
    goal[clamped] = 0.0
    forces = _pressed(solid, goal)
    return float("nan") if forces is None else float(np.linalg.norm(forces[pinched.one].sum(axis=0)))


def _pressed(solid: Solid, goal: Floats) -> Floats | None:
    """Forces (n, 3) N with which a solid resists when its held nodes are brought to displacements (n, 3) m."""
    displacement, done, share = np.zeros_like(goal), 0.0, 1.0 / STEPS
    factor = solid.factor(displacement)
    while done < 1.0:
        wanted = min(1.0, done + share)
        change = np.where(solid.held, (wanted - done) * goal, 0.0)
        pull = np.where(solid.held, 0.0, (solid.tangent(displacement) @ change.ravel()).reshape(goal.shape))
        start = displacement + change - factor.solve(pull.reshape(-1, 1)).reshape(goal.shape)
        found = _settled(solid, start)
        if found is None:
            share *= 0.5
            if share < SHORTEST:
                return None
            continue
        displacement, done = found, wanted
        try:
            factor = solid.factor(displacement)
        except NotPositive:
            return None
    return solid.energy(displacement)[1]


def _settled(solid: Solid, start: Floats) -> Floats | None:
    """Where a solid comes to rest with its held nodes where they are; by Newton's method, None where that fails."""
    displacement = start
    energy, inner, _ = solid.energy(displacement)
    for _ in range(MOST_ITERATIONS):
        if not np.isfinite(energy):
            return None
        residual = np.where(solid.held, 0.0, -inner)
        if np.linalg.norm(residual) <= TOLERANCE * np.linalg.norm(inner):
            return displacement
        try:
            way = solid.factor(displacement).solve(residual.reshape(-1, 1)).reshape(start.shape)
        except NotPositive:
            return None
        length = 1.0
        while length > SHORTEST:
            trial = displacement + length * way
            ahead, inner, _ = solid.energy(trial)
            if ahead < energy + 1e-12 * abs(energy):
                break
            length *= 0.5
        else:
            return None
        displacement, energy = trial, ahead
    return None
