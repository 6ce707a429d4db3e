"""Haptic output: minus the force on the tissue, within clamp and slew limit, faded when stale."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import kernel
from tissue_sim.model.contact.tool_motion import freshness
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.shapes import Shapes
from tissue_sim.model.data.state import State
from tissue_sim.model.data.world import World


@kernel
def compute_haptic_output(state: State, shapes: Shapes, settings: Settings, scratch: Scratch) -> None:
    """Compute the wrench of every body; clamp and slew limit apply to the sum over a tool's bodies.

    Each organ of a scene has a part of the slew limit, see `divide_slew_limit`.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    shapes : Shapes
        Shapes of the bodies.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory.
    """
    cut = held_back = False
    for tool in range(len(state.wrench)):
        clamped = clamp_fraction(scratch.impulse, shapes.tool, tool, settings.force_clamp * settings.tick_time)
        cut = cut or clamped < 1.0
        wanted = -clamped / settings.tick_time
        for body in range(len(state.wrench)):
            # If poses resume while the force fades, it rises from the faded force, not from the force without fading.
            if shapes.tool[body] == tool and freshness(state.bodies[body].age, settings) == 1.0:
                for c in range(6):
                    state.unfaded_wrench[body, c] = state.wrench[body, c]
        most = scratch.slew_part[tool] * settings.force_slew * settings.tick_time
        change = slew_fraction(state.unfaded_wrench, scratch.impulse, wanted, shapes.tool, tool, most)
        held_back = held_back or change < 1.0
        for body in range(len(state.wrench)):
            if shapes.tool[body] == tool:
                unfaded, impulse = state.unfaded_wrench[body], scratch.impulse[body]
                for c in range(6):
                    unfaded[c] = (
                        wanted * impulse[c]
                        if change == 1.0
                        else unfaded[c] + change * (wanted * impulse[c] - unfaded[c])
                    )
        # The clamp itself may have been lowered meanwhile.
        clamped = clamp_fraction(state.unfaded_wrench, shapes.tool, tool, settings.force_clamp)
        for body in range(len(state.wrench)):
            if shapes.tool[body] == tool:
                fresh = freshness(state.bodies[body].age, settings)
                # A released tool starts from zero when it returns, regardless of the slew limit.
                kept = clamped if fresh > 0.0 else 0.0
                for c in range(6):
                    state.unfaded_wrench[body, c] *= kept
                    state.wrench[body, c] = fresh * state.unfaded_wrench[body, c]
    state.count.clamped_ticks += cut
    state.count.slewed_ticks += held_back


@kernel
def divide_slew_limit(worlds: Sequence[World], awake: Longs) -> None:
    """Divide the slew limit of a tool among the organs that act on it, since it applies to their sum.

    Parameters
    ----------
    worlds : Sequence[World]
        Worlds of the organs after their substeps; updated.
    awake : Longs, shape (k,)
        1 for organs that this tick advances.
    """
    tools = worlds[0].shapes.tool
    for tool in range(len(tools)):
        count = 0
        for organ in range(len(worlds)):
            if awake[organ] == 1 and acts_on(worlds[organ], tool):
                count += 1
        for organ in range(len(worlds)):
            worlds[organ].scratch.slew_part[tool] = 1.0 / max(1, count)


@kernel
def acts_on(world: World, tool: int) -> bool:
    """Return whether an organ acts on a tool in this tick, or did in the last one."""
    state, impulse = world.state, world.scratch.impulse
    for body in range(len(impulse)):
        if world.shapes.tool[body] == tool:
            for c in range(3):
                if impulse[body, c] != 0.0 or state.unfaded_wrench[body, c] != 0.0:
                    return True
    return False


@kernel
def has_output(state: State) -> bool:
    """Return whether the force on any tool has not yet decreased to zero."""
    for body in range(len(state.wrench)):
        for c in range(3):
            if state.wrench[body, c] != 0.0:
                return True
    return False


@kernel
def sum_haptic_output(worlds: Sequence[World], wrench: Floats) -> None:
    """Sum the wrenches of every body over all organs; the clamp applies to the sum over a tool's bodies.

    Parameters
    ----------
    worlds : Sequence[World]
        Worlds of the organs.
    wrench : Floats, shape (b, 6), N and N m
        Receives the sums.
    """
    first = worlds[0]
    for body in range(len(wrench)):
        for axis in range(6):
            total = 0.0
            for organ in range(len(worlds)):
                total += worlds[organ].state.wrench[body, axis]
            wrench[body, axis] = total
    for tool in range(len(wrench)):
        fraction = clamp_fraction(wrench, first.shapes.tool, tool, first.settings.force_clamp)
        for body in range(len(wrench)):
            if first.shapes.tool[body] == tool and fraction < 1.0:
                for axis in range(6):
                    wrench[body, axis] *= fraction


@kernel
def clamp_fraction(values: Floats, tools: Longs, tool: int, most: float) -> float:
    """Return the factor that limits the sum of a tool's forces, the first three of values (T, 6), to `most`."""
    x = y = z = 0.0
    for body in range(len(values)):
        if tools[body] == tool:
            x += values[body, 0]
            y += values[body, 1]
            z += values[body, 2]
    size = math.sqrt(x * x + y * y + z * z)
    return most / size if size > most else 1.0


@kernel
def slew_fraction(unfaded: Floats, impulse: Floats, wanted: float, tools: Longs, tool: int, most: float) -> float:
    """Return the fraction by which to change from unfaded (T, 6) to wanted * impulse (T, 6), so by at most `most` N."""
    x = y = z = 0.0
    for body in range(len(unfaded)):
        if tools[body] == tool:
            x += wanted * impulse[body, 0] - unfaded[body, 0]
            y += wanted * impulse[body, 1] - unfaded[body, 1]
            z += wanted * impulse[body, 2] - unfaded[body, 2]
    size = math.sqrt(x * x + y * y + z * z)
    return most / size if size > most else 1.0
