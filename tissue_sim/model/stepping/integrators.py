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


@kernel
def predict(position: Any, velocity: Any, nodes: Any, step: float, predicted: Any) -> None:
    """Compute where nodes would be after a step without forces.

    Parameters
    ----------
    position : Any, shape (n, 3), m
        Positions.
    velocity : Any, shape (n, 3), m/s
        Velocities.
    nodes : Any, shape (a,)
        Nodes to move.
    step : float, s
        The step.
    predicted : Any, shape (n, 3), m
        Receives the positions.
    """
    for index in range(len(nodes)):
        i = nodes[index]
        for axis in range(3):
            predicted[i, axis] = position[i, axis] + step * velocity[i, axis]


@kernel
def implicit_euler(
    position: Any,
    velocity: Any,
    force: Any,
    factor: Any,
    slot: int,
    damping: Any,
    damping_scale: float,
    step: float,
    change: Any,
) -> None:
    """Do one quasi-Newton step of implicit Euler from the predicted positions, with a prefactored matrix.

    (M + h D + h^2 S) dv = h (f - D v), v+ = v + dv, x+ = x + h v+, with the forces f at x + h v. S bounds the stiffness
    of every spring from above, whatever its direction, so that it never changes and is the same for x, y and z: the
    global step of projective dynamics. Where forces balance nothing moves, so equilibria are exact.

    Parameters
    ----------
    position : Any, shape (n, 3), m
        Positions, updated.
    velocity : Any, shape (n, 3), m/s
        Velocities, updated.
    force : Any, shape (n, 3), N
        Forces at the predicted positions.
    factor : Any
        Factor L D L' of the matrix.
    slot : int
        Which of its two slots is used.
    damping : Any, shape (n,), kg/s
        Nodal damping.
    damping_scale : float
        Factor of the damping.
    step : float, s
        Step h.
    change : Any, shape (a, 3), m/s
        Buffer.

    References
    ----------
    Bouaziz et al. 2014: Projective dynamics; Liu et al. 2013: Fast simulation of mass-spring systems.
    """
    order, start, row = factor.order, factor.start, factor.row
    value, pivot = factor.value[slot], factor.pivot[slot]
    count = len(order)
    for k in range(count):
        i = order[k]
        drag = damping_scale * damping[i]
        for axis in range(3):
            change[k, axis] = step * (force[i, axis] - drag * velocity[i, axis])
    for k in range(count):
        x, y, z = change[k, 0], change[k, 1], change[k, 2]
        for entry in range(start[k], start[k + 1]):
            r = row[entry]
            change[r, 0] -= value[entry] * x
            change[r, 1] -= value[entry] * y
            change[r, 2] -= value[entry] * z
    for k in range(count - 1, -1, -1):
        x, y, z = pivot[k] * change[k, 0], pivot[k] * change[k, 1], pivot[k] * change[k, 2]
        for entry in range(start[k], start[k + 1]):
            r = row[entry]
            x -= value[entry] * change[r, 0]
            y -= value[entry] * change[r, 1]
            z -= value[entry] * change[r, 2]
        change[k, 0], change[k, 1], change[k, 2] = x, y, z
    for k in range(count):
        i = order[k]
        for axis in range(3):
            velocity[i, axis] += change[k, axis]
            position[i, axis] += step * velocity[i, axis]
