"""Gravity: the weight of every node, and the part of it that is in equilibrium in the organ's rest shape.

An organ is scanned, or measured, under gravity, so its shape is in equilibrium with it: `Model.borne` is the force on
every node that balances the forces of the tissue of the unloaded shape (`unloaded`). The shape changes by the
difference between gravity and that of the shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.arguments import floats_of
from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.jit import kernel
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.settings import Settings

MOST_GRAVITY = 100.0  # m/s^2


@kernel
def excess(model: Model, settings: Settings) -> tuple[float, float, float]:
    """Return gravity minus that under which the organ has its rest shape, m/s^2."""
    borne = model.shape_gravity
    return settings.gravity_x - borne[0], settings.gravity_y - borne[1], settings.gravity_z - borne[2]


@kernel
def is_heavy(model: Model, settings: Settings) -> bool:
    """Return whether nodes have weight, or the organ's equilibrium differs from its unloaded shape.

    Parameters
    ----------
    model : Model
        Constants of the model.
    settings : Settings
        Settings of the simulation.
    """
    return len(model.borne) > 0 or is_out_of_balance(model, settings)


@kernel
def is_out_of_balance(model: Model, settings: Settings) -> bool:
    """Return whether gravity, or the tissue's stiffness, differs from that of the rest shape's equilibrium.

    Parameters
    ----------
    model : Model
        Constants of the model.
    settings : Settings
        Settings of the simulation.
    """
    gx, gy, gz = excess(model, settings)
    return gx != 0.0 or gy != 0.0 or gz != 0.0 or (len(model.borne) > 0 and settings.stiffness_scale != 1.0)


@kernel
def write_masses(model: Model, mass: Floats) -> None:
    """Write the masses of nodes that move, and 0 for others.

    Parameters
    ----------
    model : Model
        Constants of the model.
    mass : Floats, shape (n,), kg
        The masses; updated.
    """
    mass[:] = 0.0
    for index in range(len(model.moving)):
        node = model.moving[index]
        mass[node] = 1.0 / model.inverse_mass[node]


@kernel
def add_weight(model: Model, settings: Settings, mass: Floats, force: Floats) -> None:
    """Add the nodes' weight; in equilibrium at rest the sum of forces is exactly zero.

    Parameters
    ----------
    model : Model
        Constants of the model.
    settings : Settings
        Settings of the simulation.
    mass : Floats, shape (n,), kg
        Masses, see write_masses: a division for each node would take longer than the rest of the function.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.
    """
    if not is_heavy(model, settings):
        return
    gx, gy, gz = excess(model, settings)
    for node in range(len(mass)):
        force[node, 0] += mass[node] * gx
        force[node, 1] += mass[node] * gy
        force[node, 2] += mass[node] * gz
    for node in range(len(model.borne)):
        for axis in range(3):
            force[node, axis] += model.borne[node, axis]


def acceleration_of(given: ArrayLike, name: str) -> Floats:
    """Return an acceleration as an array (3,), m/s^2.

    Parameters
    ----------
    given : ArrayLike, m/s^2
        Three numbers.
    name : str
        Name for the message.

    Raises
    ------
    UserError
        If it is not three finite numbers with a norm of at most MOST_GRAVITY.
    """
    values = floats_of(given)
    if values.shape != (3,) or not np.all(np.isfinite(values)) or np.linalg.norm(values) > MOST_GRAVITY:
        raise UserError(f"{name} {given!r} is not three numbers, m/s^2, with a norm of at most {MOST_GRAVITY:g}")
    return values
