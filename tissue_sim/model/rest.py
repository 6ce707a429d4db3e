"""How an organ that nobody touches comes to rest: asleep, or led back from a false rest shape."""

from __future__ import annotations

from typing import Any

from tissue_sim.jit import kernel
from tissue_sim.model.arrays import copy
from tissue_sim.model.guard import lead_back
from tissue_sim.model.regions import leave_region
from tissue_sim.model.state import Region

QUIET_SPEED = 2e-5  # m/s
QUIET_DISPLACEMENT = 5e-6  # m
QUIET_TICKS = 20
TREMBLING = 1.0  # 1/s, speed over displacement; a sound organ goes back at 20 or so
SNAPPED_DISPLACEMENT = 2e-4  # m; a sound organ that far from rest is moving
TURNED_TIME = 0.15  # s that the inside may stay turned inside out with nothing acting


@kernel
def largest_motion(model: Any, state: Any, nodes: Any) -> tuple[float, float]:
    """Largest components of velocity, m/s, and of displacement from rest, m, of the nodes."""
    speed_x = speed_y = speed_z = away_x = away_y = away_z = 0.0
    position, velocity, rest = state.position, state.velocity, model.rest
    for index in range(len(nodes)):
        node = nodes[index]
        speed_x = max(speed_x, abs(velocity[node, 0]))
        speed_y = max(speed_y, abs(velocity[node, 1]))
        speed_z = max(speed_z, abs(velocity[node, 2]))
        away_x = max(away_x, abs(position[node, 0] - rest[node, 0]))
        away_y = max(away_y, abs(position[node, 1] - rest[node, 1]))
        away_z = max(away_z, abs(position[node, 2] - rest[node, 2]))
    return max(speed_x, speed_y, speed_z), max(away_x, away_y, away_z)


@kernel
def rest_if_quiet(model: Any, state: Any, settings: Any, scratch: Any) -> None:
    """Fall asleep after a number of ticks without touch, load, speed and displacement.

    Springs pushed through each other can come to rest in a false shape, finite and still. An organ that
    nobody touches and that stands still away from its rest shape, or whose inside stays turned inside out, is led
    back to it.
    """
    status = state.status
    if status.turned > 0 and status.alone * settings.tick_time > TURNED_TIME:
        snap(model, state, settings, scratch)
        return
    if status.region == Region.MODAL:
        speed, away = largest_motion(model, state, scratch.region_node[: status.region_nodes])
        swing, swing_speed = 0.0, 0.0
        for k in range(len(model.reduction.peak)):
            swing += abs(state.mode_position[k]) * model.reduction.peak[k]
            swing_speed += abs(state.mode_velocity[k]) * model.reduction.peak[k]
        speed, away = max(speed, swing_speed), max(away, swing)
    else:
        speed, away = largest_motion(model, state, model.moving)
    # Far from rest, a false shape may tremble for good; slow is what wouldn't get back within seconds.
    if speed > max(QUIET_SPEED, TREMBLING * away):
        status.quiet = 0
        return
    status.quiet += 1
    if status.quiet < QUIET_TICKS:
        return
    if away <= QUIET_DISPLACEMENT:
        if speed <= QUIET_SPEED:
            fall_asleep(model, state)
    elif away > SNAPPED_DISPLACEMENT:
        snap(model, state, settings, scratch)


@kernel
def fall_asleep(model: Any, state: Any) -> None:
    """At rest, to the last bit."""
    status = state.status
    status.asleep = True
    status.backoff = 1
    status.turned = status.collapsing = False
    state.is_turned[:] = 0
    copy(model.rest, state.position)
    copy(model.rest, state.good_position)
    state.velocity[:] = 0.0


@kernel
def snap(model: Any, state: Any, settings: Any, scratch: Any) -> None:
    """Start the way back from a false rest shape."""
    leave_region(model, state, settings, scratch)
    state.status.snapped = True
    state.count.snaps += 1


@kernel
def find_back(model: Any, state: Any, settings: Any) -> None:
    """A step of the way back from a false rest shape."""
    displacement = lead_back(model, state, settings)
    # A fault on the way must not restore the false shape.
    copy(state.position, state.good_position)
    if displacement <= QUIET_DISPLACEMENT:
        state.status.snapped = False
        state.status.quiet = 0
