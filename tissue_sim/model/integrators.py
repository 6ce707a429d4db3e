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
) -> None:
    """Symplectic Euler with implicit nodal damping: v+ = (v + h f/m) / (1 + h d/m), x+ = x + h v+.

    position, velocity, force (n, 3); nodes (a,) the nodes to move; inverse_mass (n,) 1/kg, 0 where
    held; damping (n,) kg/s, times damping_scale;
    step s. Stable for h < (2/w)(sqrt(1 + z^2) + z), z the damping ratio.
    """
    for index in range(len(nodes)):
        i = nodes[index]
        push = step * inverse_mass[i]
        shrink = 1.0 / (1.0 + push * damping_scale * damping[i])
        for axis in range(3):
            speed = (velocity[i, axis] + push * force[i, axis]) * shrink
            velocity[i, axis] = speed
            position[i, axis] += step * speed
