"""Motion of the modes that represent the organ around a modal region: exact in every tick, under the static load."""

from __future__ import annotations

import math

from tissue_sim.array_types import Singles
from tissue_sim.jit import kernel
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.settings import Settings
from tissue_sim.model.data.state import Region, State
from tissue_sim.model.regions.local_region import driving

OFFSET_TIME = 0.25  # s in which an offset fades
FASTEST = 1.0  # rad per tick; faster modes would excite the region's edge, so they follow the load without inertia


@kernel
def combine(rows: Singles, factors: Singles, count: int, total: Singles) -> None:
    """Compute total (r,) as the sum of the first `count` rows (.., r), each times its factor; in single precision."""
    total[:] = 0.0
    for i in range(0, count - 3, 4):
        w, x, y, z = factors[i], factors[i + 1], factors[i + 2], factors[i + 3]
        a, b, c, d = rows[i], rows[i + 1], rows[i + 2], rows[i + 3]
        for r in range(len(total)):
            total[r] += (w * a[r] + x * b[r]) + (y * c[r] + z * d[r])
    for i in range(count - count % 4, count):
        w, a = factors[i], rows[i]
        for r in range(len(total)):
            total[r] += w * a[r]


@kernel
def set_propagator(model: Model, settings: Settings, scratch: Scratch) -> None:
    """Compute the exact motion of every mode in a tick when settings have changed: q'' + c q' + w^2 q = p.

    Parameters
    ----------
    model : Model
        Constants of the model.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    """
    key = scratch.propagator_key
    tick_time, scale, damping = settings.tick_time, settings.stiffness_scale, settings.damping_scale
    if key[0] == tick_time and key[1] == scale and key[2] == damping:
        return
    key[0], key[1], key[2] = tick_time, scale, damping
    half = 0.5 * damping * model.damping_rate
    for k in range(len(model.reduction.frequency)):
        square = scale * model.reduction.frequency[k] ** 2
        decay = math.exp(-half * tick_time)
        bend = square - half * half
        if bend > 1e-9 * square:
            turn = math.sqrt(bend)
            cosine, sine = math.cos(turn * tick_time), math.sin(turn * tick_time) / turn
        elif bend < -1e-9 * square:
            turn = math.sqrt(-bend)
            cosine, sine = math.cosh(turn * tick_time), math.sinh(turn * tick_time) / turn
        else:
            cosine, sine = 1.0, tick_time
        scratch.propagator[0, k] = 1.0 / square
        if square * tick_time * tick_time > FASTEST * FASTEST:
            for row in range(1, 5):
                scratch.propagator[row, k] = 0.0
            continue
        scratch.propagator[1, k] = decay * (cosine + half * sine)
        scratch.propagator[2, k] = decay * sine
        scratch.propagator[3, k] = decay * (cosine - half * sine)
        scratch.propagator[4, k] = -decay * square * sine


@kernel
def project_load(state: State, scratch: Scratch) -> None:
    """Compute the static displacement of the modes into scratch.mode_rest, and the loads into edge_load.

    Parameters
    ----------
    state : State
        State of the simulation.
    scratch : Scratch
        Working memory; updated.
    """
    nodes = driving(state, scratch)
    load, driving_load, rest = state.static_load, scratch.edge_load, scratch.mode_rest
    for index in range(len(nodes)):
        for c in range(3):
            driving_load[3 * index + c] = load[nodes[index], c]
    combine(scratch.drive_rows, driving_load, 3 * len(nodes), scratch.mode_sum)
    total, inverse = scratch.mode_sum, scratch.propagator[0]
    for k in range(len(rest)):
        rest[k] = inverse[k] * total[k]


@kernel
def advance_modes(model: Model, state: State, settings: Settings, scratch: Scratch) -> None:
    """Step every mode exactly through a tick under the static load, and set scratch.mode_move.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation; updated.
    settings : Settings
        Settings of the simulation.
    scratch : Scratch
        Working memory; updated.
    """
    set_propagator(model, settings, scratch)
    project_load(state, scratch)
    table = scratch.propagator
    for k in range(len(model.reduction.frequency)):
        rest = scratch.mode_rest[k]
        offset, speed = state.mode_position[k] - rest, state.mode_velocity[k]
        state.mode_position[k] = rest + table[1, k] * offset + table[2, k] * speed
        state.mode_velocity[k] = table[3, k] * speed + table[4, k] * offset
    set_mode_move(model, state, scratch)
    state.blend[0] *= math.exp(-settings.tick_time / OFFSET_TIME)


@kernel
def set_mode_move(model: Model, state: State, scratch: Scratch) -> None:
    """Compute the displacement by modes in addition to the static one; without a compliance table it is the total.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation.
    scratch : Scratch
        Working memory; updated.
    """
    held = 1.0 if len(model.reduction.compliance) > 0 else 0.0  # by the compliance table
    position, rest, move = state.mode_position, scratch.mode_rest, scratch.mode_move
    for k in range(len(move)):
        move[k] = position[k] - held * rest[k]


@kernel
def modes_are_finite(state: State) -> bool:
    """Return whether all modes of a modal region are finite.

    Parameters
    ----------
    state : State
        State of the simulation.
    """
    finite = True
    for k in range(len(state.mode_position)):
        finite = finite and abs(state.mode_position[k]) < math.inf and abs(state.mode_velocity[k]) < math.inf
    return finite


@kernel
def largest_modal_motion(model: Model, state: State) -> tuple[float, float]:
    """Return the largest speed, m/s, and displacement, m, that the modes may have anywhere."""
    speed = away = 0.0
    if state.status.region == Region.MODAL:
        for k in range(len(model.reduction.peak)):
            away += abs(state.mode_position[k]) * model.reduction.peak[k]
            speed += abs(state.mode_velocity[k]) * model.reduction.peak[k]
    return speed, away
