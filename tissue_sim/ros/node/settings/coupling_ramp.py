"""Gradual change of the coupling's stiffness: changed in one step, the force would overshoot."""

RIGID = 2e5  # N/m from which a coupling is as rigid as one of 0
EASE_EVERY = 0.002  # s between two steps
FACTOR = 1.047  # of a step: 0.3 s from 200 N/m to rigid, in which the force doesn't overshoot


def nearer(now: float, wanted: float) -> float:
    """Return a stiffness one step nearer to the wanted one, N/m; 0 is rigid, and so above all others.

    now: the present stiffness, N/m.
    """
    most = max(RIGID, now, wanted)
    here, there = now or most, wanted or most
    if max(here, there) <= FACTOR * min(here, there):
        return wanted
    return here * FACTOR if there > here else here / FACTOR
