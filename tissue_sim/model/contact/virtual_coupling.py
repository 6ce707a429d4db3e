"""Stiffness of a virtual coupling that a device can render."""

from __future__ import annotations

import math


def passive_stiffness(device_damping: float, period: float, delay: float) -> float:
    """Return the stiffest coupling that a device renders passively.

    A sampled spring acts as if it had a damping of -K (period / 2 + delay), which the device's own must compensate; the
    coupling's own damping acts on the tool, not on the device.

    Parameters
    ----------
    device_damping : float, N s/m
        Damping of the device; 0 for unknown.
    period : float, s
        Time between two poses of the device.
    delay : float, s
        Time from a pose to the force that answers it.

    Returns
    -------
    float, N/m
        The stiffness; infinity for an unknown damping.

    References
    ----------
    Colgate & Schenkel 1997: Passivity of a class of sampled-data systems, with a delay.
    """
    return device_damping / (0.5 * period + delay) if device_damping > 0.0 else math.inf
