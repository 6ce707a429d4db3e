"""How stiff a virtual coupling may be for the device that renders it."""

from __future__ import annotations

import math


def passive_stiffness(device_damping: float, period: float, delay: float) -> float:
    """Stiffest coupling, N/m, that a device of a damping in N s/m renders passively.

    period s between two poses of the device; delay s from a pose to the force that answers it. A sampled spring acts
    as if it had a damping of -K (period / 2 + delay), which the device's own must make up for (Colgate and Schenkel
    1997, with a delay); the coupling's own damping acts on the tool, not on the device. A damping of 0 is unknown:
    infinity.
    """
    return device_damping / (0.5 * period + delay) if device_damping > 0.0 else math.inf
