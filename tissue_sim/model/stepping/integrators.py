"""Time stepping of the nodes."""

from __future__ import annotations

from typing import Any

from tissue_sim.jit import kernel


@kernel
def symplectic_euler(
    position: Any,
    velocity: Any,
    force: Any,
    nodes: Any,
    inverse_mass: Any,
    damping: Any,
    damping_scale: float,
    step: float,
    inertia: float = 1.0,
) -> None:
    """Step by symplectic Euler with implicit nodal damping: v+ = (v + h f/m) / (1 + h d/m), x+ = x + h v+.

    Stable for h < (2/w)(sqrt(1 + z^2) + z), z the damping ratio.

    Parameters
    ----------
    position : Any, shape (n, 3), m
        Positions, updated.
    velocity : Any, shape (n, 3), m/s
        Velocities, updated.
    force : Any, shape (n, 3), N
        Forces.
    nodes : Any, shape (a,)
        Nodes to move.
    inverse_mass : Any, shape (n,), 1/kg
        Inverse masses, 0 where held.
    damping : Any, shape (n,), kg/s
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
def symplectic_euler_whole(position: Any, velocity: Any, force: Any, push: Any, shrink: Any, step: float) -> None:
    """Step all coordinates by symplectic Euler, with the same result to the last bit; flat arrays.

    push: h / m, s/kg; shrink: 1 / (1 + h d/m), worked out before since they seldom change.

    Parameters
    ----------
    position : Any, shape (3n,), m
        Positions, updated.
    velocity : Any, shape (3n,), m/s
        Velocities, updated.
    force : Any, shape (3n,), N
        Forces.
    push : Any, shape (3n,), s/kg
        h / m.
    shrink : Any, shape (3n,)
        1 / (1 + h d/m); computed beforehand, since it rarely changes.
    step : float, s
        Step h.
    """
    for index in range(len(position)):
        speed = (velocity[index] + push[index] * force[index]) * shrink[index]
        velocity[index] = speed
        position[index] += step * speed


@kernel
def explicit_euler(
    position: Any,
    velocity: Any,
    force: Any,
    nodes: Any,
    inverse_mass: Any,
    damping: Any,
    damping_scale: float,
    step: float,
) -> None:
    """Step by forward Euler as in the paper (section 3.1): x+ = x + h v, v+ = v + h (f - d v)/m.

    Stable for h < 2 z/w only: without damping at no step at all.

    Parameters
    ----------
    position : Any, shape (n, 3), m
        Positions, updated.
    velocity : Any, shape (n, 3), m/s
        Velocities, updated.
    force : Any, shape (n, 3), N
        Forces.
    nodes : Any, shape (a,)
        Nodes to move.
    inverse_mass : Any, shape (n,), 1/kg
        Inverse masses, 0 where held.
    damping : Any, shape (n,), kg/s
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
