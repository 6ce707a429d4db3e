"""Placement of an organ in a scene of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ


def placed(
    organ: Organ, position: Sequence[float] = (0.0, 0.0, 0.0), quaternion: Sequence[float] = (0.0, 0.0, 0.0, 1.0)
) -> Organ:
    """Return the organ turned about its origin and then moved.

    Parameters
    ----------
    organ : Organ
        The organ.
    position : Sequence[float], shape (3,), m, optional
        Where its origin is moved.
    quaternion : Sequence[float], x, y, z, w, optional
        Unit quaternion of the rotation.

    Raises
    ------
    UserError
        Where the pose is invalid.
    """
    at, turn = np.array(position, dtype=np.float64), np.array(quaternion, dtype=np.float64)
    if at.shape != (3,) or turn.shape != (4,) or not np.all(np.isfinite(np.concatenate([at, turn]))):
        raise UserError("an organ's pose is three numbers, m, and a quaternion of four, x, y, z, w")
    if abs(np.sqrt(np.sum(turn**2)) - 1.0) > 1e-6:
        raise UserError(f"an organ's quaternion {turn.tolist()} does not have length 1")

    def there(points: Floats) -> Floats:
        once = np.cross(turn[:3], points) + turn[3] * points
        return np.asarray(points + 2.0 * np.cross(turn[:3], once) + at)

    return replace(
        organ,
        surface_positions=there(organ.surface_positions),
        atom_positions=there(organ.atom_positions),
        interior_positions=there(organ.interior_positions),
        inclusion_positions=there(organ.inclusion_positions),
    )
