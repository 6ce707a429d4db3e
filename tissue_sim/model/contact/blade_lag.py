"""Offsets of places of blades from the tissue that holds them, and the part of these that their forces don't explain.

If a place moves by some distance at rest, it moves by another distance in space where cells are crushed, in the next
cell, or where it is no longer between two lips. To hold it at its blade at once would throw the tissue, and to move it
there at once would cut without a load. So it lags behind, or beside, and returns while a force does the work of the cut
that it makes meanwhile.
"""

from __future__ import annotations

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.jit import inner
from tissue_sim.model.contact.blade_places import turned_by
from tissue_sim.model.data.blades import LIP_NODES, BladeRow, BladeSample
from tissue_sim.model.data.world import World

# m/N, local yielding of the tissue at a place: cells are coarser than the spacing of places, so that the constraints of
# several places may contradict each other.
GIVE = 1e-3
RECOVERY_SPEED = 0.2  # m/s, largest speed at which a lip is moved out of a flank


@inner
def write_arm(world: World, row: BladeRow, rotation: Floats, arm: Floats) -> None:
    """Write the vector from a tool's origin to a place.

    Parameters
    ----------
    world : World
        Model, state, shapes and working memory; updated.
    row : BladeRow
        The place.
    rotation : Floats, shape (9,)
        Rotation of the tool, row by row.
    arm : Floats, shape (3,), m
        Receives the result.
    """
    at = world.scratch.blade_at
    for axis in range(3):
        at[axis] = world.shapes.blades.at[row.sample, axis] + world.state.blades[row.sample].offset[axis]
    turned_by(rotation, at, arm)


@inner
def offset_of(world: World, row: BladeRow, weights: Floats) -> tuple[float, float, float]:
    """Return the offset of a place of a blade from the tissue that holds it, m.

    Parameters
    ----------
    world : World
        Model, state, shapes and working memory.
    row : BladeRow
        The place.
    weights : Floats, shape (8,)
        Of the nodes that hold it.
    """
    state, origin, arm = world.state, world.scratch.origin[row.body], row.arm
    x, y, z = origin[0] + arm[0], origin[1] + arm[1], origin[2] + arm[2]
    for place in range(LIP_NODES):
        weight = weights[place]
        if weight != 0.0:
            position = state.position[np.uint64(row.node[place])]
            x, y, z = x - weight * position[0], y - weight * position[1], z - weight * position[2]
    return x, y, z


@inner
def way_past(world: World, row: BladeRow, direction: Floats, weights: Floats, step: float) -> float:
    """Return the motion of a place along a direction relative to the tissue in this substep, m.

    Parameters
    ----------
    world : World
        Model, state, shapes and working memory; updated.
    row : BladeRow
        The place.
    direction : Floats, shape (3,)
        Unit vector.
    weights : Floats, shape (8,)
        Of the nodes that hold it.
    step : float, s
        The substep.
    """
    state, scratch, way, arm = world.state, world.scratch, world.scratch.blade_way, row.arm
    write_arm(world, row, scratch.last_rotation[row.body], way)
    now, last = scratch.origin[row.body], scratch.last_origin[row.body]
    x, y, z = now[0] + arm[0], now[1] + arm[1], now[2] + arm[2]
    x, y, z = x - (last[0] + way[0]), y - (last[1] + way[1]), z - (last[2] + way[2])
    for place in range(LIP_NODES):
        weight = weights[place]
        if weight != 0.0:
            speed, part = state.velocity[np.uint64(row.node[place])], step * weight
            x, y, z = x - part * speed[0], y - part * speed[1], z - part * speed[2]
    return direction[0] * x + direction[1] * y + direction[2] * z


@inner
def _offset_before(world: World, row: BladeRow, direction: Floats, weights: Floats, step: float) -> float:
    """Return the offset of a place along a direction from the tissue that holds it before this substep, m."""
    x, y, z = offset_of(world, row, weights)
    offset = direction[0] * x + direction[1] * y + direction[2] * z
    return offset - way_past(world, row, direction, weights, step)


@inner
def lag_forward(world: World, row: BladeRow, sample: BladeSample, step: float) -> float:
    """Return the lag of a place behind its blade before this substep, m, without the yielding to its force.

    Parameters
    ----------
    world : World
        Model, state, shapes and working memory; updated.
    row : BladeRow
        The place.
    sample : BladeSample
        What is known of it from the last substep.
    step : float, s
        The substep.
    """
    return _offset_before(world, row, row.forward, row.weight, step) - GIVE * sample.force[0]


@inner
def lag_across(world: World, row: BladeRow, sample: BladeSample, step: float) -> float:
    """Return the lateral offset of a place from its flank before this substep, m, without the yielding to its force.

    A lip inside the flank is moved out at RECOVERY_SPEED.

    Parameters
    ----------
    world : World
        Model, state, shapes and working memory; updated.
    row : BladeRow
        The place.
    sample : BladeSample
        What is known of it from the last substep.
    step : float, s
        The substep.
    """
    force = sample.force[2]
    if row.side * force < 0.0:
        force = 0.0
    lag = _offset_before(world, row, row.normal, row.across_weight, step) - GIVE * force
    if row.side == 0.0:
        return lag
    return row.side * max(0.0, row.side * lag - RECOVERY_SPEED * step)
