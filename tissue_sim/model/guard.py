"""Keeps the last good state, and goes back to it when a tick went wrong."""

from __future__ import annotations

from typing import Any

from tissue_sim.jit import kernel
from tissue_sim.model.state import BACKOFF, FAULTS, LAST_GOOD_SPAN, TICK_TIME

MAX_BACKOFF = 8


@kernel
def guard(model: Any, state: Any, settings: Any, scratch: Any) -> None:
    """Keep this state if it is finite and bounded, else go back to the last good one, at rest.

    After a fault the substeps double (up to 8 times), until the organ has slept.
    """
    span = settings[LAST_GOOD_SPAN] * settings[LAST_GOOD_SPAN]
    speed = span / (settings[TICK_TIME] * settings[TICK_TIME])
    good = True
    for index in range(len(model.moving)):
        node = model.moving[index]
        moved = sped = 0.0
        for c in range(3):
            offset = state.position[node, c] - model.rest[node, c]
            moved += offset * offset
            sped += state.velocity[node, c] * state.velocity[node, c]
        # Comparisons with NaN are false, so this catches it too.
        good = good and moved < span and sped < speed
    if good:
        state.good_position[:] = state.position
        state.good_velocity[:] = state.velocity
        return
    state.position[:] = state.good_position
    state.velocity[:] = 0.0
    state.good_velocity[:] = 0.0
    state.contact_impulse[:] = 0.0
    state.mode_position[:] = 0.0
    state.mode_velocity[:] = 0.0
    scratch.impulse[:] = 0.0
    state.count[FAULTS] += 1
    state.count[BACKOFF] = min(MAX_BACKOFF, 2 * state.count[BACKOFF])
