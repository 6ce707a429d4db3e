"""Gravity: the weight of every node, and what the organ's own shape bears already.

An organ is scanned, or measured, under gravity. The shape that it has then is in equilibrium: `Model.borne` is the
force on every node that balances what tissue of the unloaded shape (`unloaded`) pushes there. What changes it is the
difference between gravity and that of the shape alone.
"""

from __future__ import annotations

from typing import Any

from tissue_sim.jit import kernel


@kernel
def excess(model: Any, settings: Any) -> tuple[float, float, float]:
    """Gravity less that which the organ's shape bears, m/s^2."""
    borne = model.shape_gravity
    return settings.gravity_x - borne[0], settings.gravity_y - borne[1], settings.gravity_z - borne[2]


@kernel
def is_heavy(model: Any, settings: Any) -> bool:
    """True when nodes have a weight to add, or an organ in equilibrium with it is not about its unloaded shape."""
    return len(model.borne) > 0 or is_out_of_balance(model, settings)


@kernel
def is_out_of_balance(model: Any, settings: Any) -> bool:
    """True when gravity, or the tissue's stiffness, is another than that which holds the organ in its rest shape."""
    gx, gy, gz = excess(model, settings)
    return gx != 0.0 or gy != 0.0 or gz != 0.0 or (len(model.borne) > 0 and settings.stiffness_scale != 1.0)


@kernel
def add_weight(model: Any, settings: Any, force: Any) -> None:
    """Add the nodes' weight to force (n, 3) N; what holds still at rest sums to nothing there, to the last bit."""
    if not is_heavy(model, settings):
        return
    gx, gy, gz = excess(model, settings)
    for index in range(len(model.moving)):
        node = model.moving[index]
        mass = 1.0 / model.inverse_mass[node]
        force[node, 0] += mass * gx
        force[node, 1] += mass * gy
        force[node, 2] += mass * gz
    for node in range(len(model.borne)):
        for axis in range(3):
            force[node, axis] += model.borne[node, axis]
