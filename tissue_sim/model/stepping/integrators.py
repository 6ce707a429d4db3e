"""Time stepping of the nodes."""

from __future__ import annotations

from tissue_sim.array_types import Floats, Ints
from tissue_sim.jit import kernel


@kernel
def symplectic_euler(
    position: Floats,
    velocity: Floats,
    force: Floats,
    nodes: Ints,
    inverse_mass: Floats,
    damping: Floats,
    damping_scale: float,
    step: float,
    inertia: float = 1.0,
) -> None:
    """Step by symplectic Euler with implicit nodal damping: v+ = (v + h f/m) / (1 + h d/m), x+ = x + h v+.

    Stable for h < (2/w)(sqrt(1 + z^2) + z), z the damping ratio.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions, updated.
    velocity : Floats, shape (n, 3), m/s
        Velocities, updated.
    force : Floats, shape (n, 3), N
        Forces.
    nodes : Ints, shape (a,)
        Nodes to move.
    inverse_mass : Floats, shape (n,), 1/kg
        Inverse masses, 0 where held.
    damping : Floats, shape (n,), kg/s
        Nodal damping.
    damping_scale : float
        Factor of the damping.
    step : float, s
        Step h.
    inertia : float, optional
        Factor of all masses.
    """
    for index in range(len(nodes)):
        i = nodes[index]
        push = step / inertia * inverse_mass[i]
        shrink = 1.0 / (1.0 + push * damping_scale * damping[i])
        for axis in range(3):
            speed = (velocity[i, axis] + push * force[i, axis]) * shrink
            velocity[i, axis] = speed
            position[i, axis] += step * speed


@kernel
def symplectic_euler_whole(
    position: Floats, velocity: Floats, force: Floats, push: Floats, shrink: Floats, step: float
) -> None:
    """Step all coordinates by symplectic Euler, with the same result to the last bit; flat arrays.

    Parameters
    ----------
    position : Floats, shape (3n,), m
        Positions, updated.
    velocity : Floats, shape (3n,), m/s
        Velocities, updated.
    force : Floats, shape (3n,), N
        Forces.
    push : Floats, shape (3n,), s/kg
        h / m.
    shrink : Floats, shape (3n,)
        1 / (1 + h d/m); computed beforehand, as `push` is, since both rarely change.
    step : float, s
        Step h.
    """
    for index in range(len(position)):
        speed = (velocity[index] + push[index] * force[index]) * shrink[index]
        velocity[index] = speed
        position[index] += step * speed


@kernel
def explicit_euler(
    position: Floats,
    velocity: Floats,
    force: Floats,
    nodes: Ints,
    inverse_mass: Floats,
    damping: Floats,
    damping_scale: float,
    step: float,
) -> None:
    """Step by forward Euler as in the paper (section 3.1): x+ = x + h v, v+ = v + h (f - d v)/m.

    Stable for h < 2 z/w only: without damping at no step at all.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions, updated.
    velocity : Floats, shape (n, 3), m/s
        Velocities, updated.
    force : Floats, shape (n, 3), N
        Forces.
    nodes : Ints, shape (a,)
        Nodes to move.
    inverse_mass : Floats, shape (n,), 1/kg
        Inverse masses, 0 where held.
    damping : Floats, shape (n,), kg/s
        Nodal damping.
    damping_scale : float
        Factor of the damping.
    step : float, s
        Step h.

    References
    ----------
    Zhang, Gu et al. 2006, section 3.1.
    """
    for index in range(len(nodes)):
        i = nodes[index]
        push = step * inverse_mass[i]
        drag = damping_scale * damping[i]
        for axis in range(3):
            speed = velocity[i, axis]
            position[i, axis] += step * speed
            velocity[i, axis] = speed + push * (force[i, axis] - drag * speed)
