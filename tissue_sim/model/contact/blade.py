"""Blades in tissue: they stick until the load on their edge reaches the toughness, and then cut.

Points on the edge and on the flanks of a blade have corresponding places in the organ at rest. As long as they stick, a
constraint holds both together. In the plane of the blade its impulse is bounded: forward by the toughness times the
width of the edge, and in all directions by the friction on the flanks. At the bound a place moves on through the
tissue, which creates the area of the cut. Behind the front of a cut there is only friction. Across the flank the tissue
follows; where the lips have opened, the flank pushes the one that it touches.

The force is that of a constraint, like the contact of tools, and solved in the same passes. Cuts are opened in parallel
to the loop (cutting.blade_path).
"""

from __future__ import annotations

import math

import numpy as np

from tissue_sim.jit import inner, kernel
from tissue_sim.model.contact.blade_entry import enters
from tissue_sim.model.contact.blade_lag import GIVE, lag_across, lag_forward, offset_of, way_past, write_arm
from tissue_sim.model.contact.blade_places import is_known, leave_tissue, locate, times, turned_by, write_back
from tissue_sim.model.contact.impulses import count_on_body, push_bodies
from tissue_sim.model.data.blades import CORNERS, LIP_NODES, BladeRow, BladeSample
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.world import World

AJAR = 1e-4  # m, opening of the lips from which the flank touches one of them
AT_FRONT = 1e-9  # m at rest, within which a place is at the front of its cut
CATCHES_UP = 1e-3  # m by which a place lags behind its blade when it cuts twice as far, or leads when it doesn't cut
MOST_PACE, LEAST_PACE = 2.0, 0.5
EASES = 0.02  # s, time constant with which forces across a flank relax that only balance each other
MOST_SPEED = 2.0  # m/s, of a place through tissue
SETTLED = 1e-3  # fraction of the impulses that a pass may still change


@kernel
def find_blades(world: World, step: float) -> int:
    """List the places of blades in tissue in scratch.blade_rows, with the last forces on them; return their number.

    Parameters
    ----------
    world : World
        Model, state, shapes, settings and working memory; updated.
    step : float, s
        The substep.
    """
    state, shapes, scratch, cells = world.state, world.shapes, world.scratch, world.model.cut_cells
    if len(state.blades) == 0 or len(cells.nodes) == 0:
        return 0
    found = 0
    for number in range(len(state.blades)):
        sample, body = state.blades[number], shapes.blades.body[number]
        if not state.bodies[body].cutting:
            sample.embedded = False
            continue
        if not sample.embedded and not enters(world, number):
            continue
        row = scratch.blade_rows[found]
        row.sample, row.body = number, body
        if not locate(cells, sample, row.weight):
            leave_tissue(sample)
            continue
        _place_row(world, row, sample, step)
        found += 1
    for number in range(len(state.bodies)):
        state.bodies[number].cutting = False
    for index in range(found):
        row = scratch.blade_rows[index]
        if not is_known(row.back):
            _borrow_back(world, row, found)
        _resist(world, row, state.blades[row.sample], step)
        state.bodies[row.body].cutting = True
        _give(world, row, (row.pushed[0], row.pushed[1], row.pushed[2]), step)
    return found


@inner
def _place_row(world: World, row: BladeRow, sample: BladeSample, step: float) -> None:
    """Write the position of a place, the nodes that hold it, and the stiffness of both."""
    state, shapes, scratch, cells = world.state, world.shapes, world.scratch, world.model.cut_cells
    blades, rotation, cell = shapes.blades, scratch.rotation[row.body], sample.cell
    write_arm(world, row, rotation, row.arm)
    turned_by(rotation, blades.forward[row.sample], row.forward)
    turned_by(rotation, blades.normal[row.sample], row.normal)
    f, n, e = row.forward, row.normal, row.along
    e[0], e[1], e[2] = n[1] * f[2] - n[2] * f[1], n[2] * f[0] - n[0] * f[2], n[0] * f[1] - n[1] * f[0]
    position = state.position
    write_back(cells, cell, position, scratch, row.back)
    row.borrowed = False
    own = other = middle = 0.0
    origin = scratch.origin[row.body]
    for corner in range(CORNERS):
        first, second, weight = cells.nodes[cell, corner], cells.others[cell, corner], row.weight[corner]
        row.node[corner], row.node[CORNERS + corner] = first, second
        for axis in range(3):
            own += n[axis] * weight * position[first, axis]
            other += n[axis] * weight * position[second, axis]
    for axis in range(3):
        middle += n[axis] * (origin[axis] + row.arm[axis])
    row.side = 0.0
    if abs(own - other) > AJAR:
        row.side = 1.0 if middle > 0.5 * (own + other) else -1.0
    takes_other = row.side * (other - own) > 0.0
    for corner in range(CORNERS):
        weight, is_one = row.weight[corner], row.node[corner] == row.node[CORNERS + corner]
        row.weight[CORNERS + corner] = cells.part[cell, corner] * weight
        row.weight[corner] = weight - row.weight[CORNERS + corner]
        for half in range(2):
            place = corner + half * CORNERS
            row.across_weight[place] = row.weight[place]
            if row.side != 0.0 and not is_one:
                row.across_weight[place] = weight if (half == 1) == takes_other else 0.0
    give = across = 0.0
    for place in range(LIP_NODES):
        mobility = scratch.mobility[row.node[place]]
        give += row.weight[place] ** 2 * mobility
        across += row.across_weight[place] ** 2 * mobility
    give, across = give * step + scratch.give[row.body], across * step + scratch.give[row.body]
    row.stiffness, row.across_stiffness = 1.0 / (give + GIVE / step), 1.0 / (across + GIVE / step)


@kernel
def _borrow_back(world: World, row: BladeRow, found: int) -> None:
    """Use the deformation at the nearest place of the same blade for a place in an inverted cell.

    Otherwise the place would remain where it is, resisted and without cutting, while the blade moves on.
    """
    blades, scratch = world.shapes.blades, world.scratch
    best = math.inf
    for index in range(found):
        other = scratch.blade_rows[index]
        if other.body == row.body and is_known(other.back) and not other.borrowed:
            square = 0.0
            for axis in range(3):
                square += (blades.at[other.sample, axis] - blades.at[row.sample, axis]) ** 2
            if square < best:
                best, row.borrowed = square, True
                for c in range(9):
                    row.back[c] = other.back[c]


@inner
def _resist(world: World, row: BladeRow, sample: BladeSample, step: float) -> None:
    """Write the limits of a row, and its initial impulses."""
    blades, settings = world.shapes.blades, world.settings
    b, f, e = row.back, row.forward, row.along
    fx, fy, fz = times(b, f[0], f[1], f[2])
    ex, ey, ez = times(b, e[0], e[1], e[2])
    row.area_ratio = math.sqrt((fy * ez - fz * ey) ** 2 + (fz * ex - fx * ez) ** 2 + (fx * ey - fy * ex) ** 2)
    if row.area_ratio == 0.0:
        row.area_ratio = 1.0
    row.most = settings.force_clamp * step
    row.drag = settings.flank_friction * blades.flank[row.sample] * step
    width, speed = blades.width[row.sample], blades.speed[row.sample]
    row.resistance, row.lag, row.pace = 0.0, 0.0, 1.0
    row.lag_across = lag_across(world, row, sample, step)
    sample.free = sample.free and world.model.cut_cells.is_cut[sample.cell] == 1
    row.at_front = width > 0.0 and not sample.free and sample.depth >= sample.deepest - AT_FRONT
    if row.at_front and speed > 0.0:
        _melt(world, row, sample, speed * step)
        row.resistance = row.most
    elif row.at_front:
        row.lag = lag_forward(world, row, sample, step)
        if not row.borrowed:
            row.pace = min(max(1.0 + row.lag / CATCHES_UP, LEAST_PACE), MOST_PACE)
        row.resistance = row.pace * settings.toughness * width * row.area_ratio * step
    row.slips = row.cuts = False
    for axis in range(3):
        row.pushed[axis] = sample.force[axis] * step
    if row.side * row.pushed[2] < 0.0:
        row.pushed[2] = 0.0


@kernel
def _melt(world: World, row: BladeRow, sample: BladeSample, most: float) -> None:
    """Move a place that cuts tissue without force forward, as far as it presses, but at most by `most`, m."""
    x, y, z = offset_of(world, row, row.weight)
    f = row.forward
    ahead = min(most, f[0] * x + f[1] * y + f[2] * z)
    if ahead > 0.0:
        _advance(world, row, sample, (ahead, 0.0, 0.0))


@kernel
def press_blades(world: World, found: int, step: float) -> bool:
    """Make one pass over the listed places; return whether the impulses have converged.

    Parameters
    ----------
    world : World
        Model, state, shapes, settings and working memory; updated.
    found : int
        Number of the places.
    step : float, s
        The substep.
    """
    friction, soft, change, total = world.settings.friction, GIVE / step, 0.0, 0.0
    for index in range(found):
        row = world.scratch.blade_rows[index]
        f, e, n, pushed = row.forward, row.along, row.normal, row.pushed
        x, y, z = offset_of(world, row, row.across_weight)
        beside = n[0] * x + n[1] * y + n[2] * z - row.lag_across
        across = pushed[2] + (beside - soft * pushed[2]) * row.across_stiffness
        if row.side * across < 0.0:
            across = 0.0
        across = min(max(across, -row.most), row.most)
        x, y, z = offset_of(world, row, row.weight)
        ahead = pushed[0] + (f[0] * x + f[1] * y + f[2] * z - row.lag - soft * pushed[0]) * row.stiffness
        aside = pushed[1] + (e[0] * x + e[1] * y + e[2] * z - soft * pushed[1]) * row.stiffness
        cutting = min(max(ahead, 0.0), row.resistance)
        held = ahead - cutting
        size, limit = math.sqrt(held * held + aside * aside), row.drag + friction * abs(across)
        row.slips = size > limit
        row.cuts = row.slips and held != 0.0
        if row.slips:
            held, aside = held * limit / size, aside * limit / size
        ahead = cutting + held
        more = (ahead - pushed[0], aside - pushed[1], across - pushed[2])
        pushed[0], pushed[1], pushed[2] = ahead, aside, across
        _give(world, row, more, step)
        change += abs(more[0]) + abs(more[1]) + abs(more[2])
        total += abs(ahead) + abs(aside) + abs(across)
    return change <= SETTLED * total


@inner
def _give(world: World, row: BladeRow, more: tuple[float, float, float], step: float) -> None:
    """Apply an impulse, N s forward, along and across, to the tissue at a place, and its opposite to the tool."""
    state, scratch, f, e, n = world.state, world.scratch, row.forward, row.along, row.normal
    x, y, z = more[0] * f[0] + more[1] * e[0], more[0] * f[1] + more[1] * e[1], more[0] * f[2] + more[1] * e[2]
    u, v, w = more[2] * n[0], more[2] * n[1], more[2] * n[2]
    for place in range(LIP_NODES):
        within, across = row.weight[place], row.across_weight[place]
        if within == 0.0 and across == 0.0:
            continue
        node = np.uint64(row.node[place])
        mobility, velocity, position = scratch.mobility[node], state.velocity[node], state.position[node]
        dx, dy, dz = within * x + across * u, within * y + across * v, within * z + across * w
        dx, dy, dz = mobility * dx, mobility * dy, mobility * dz
        velocity[0] += dx
        velocity[1] += dy
        velocity[2] += dz
        position[0] += step * dx
        position[1] += step * dy
        position[2] += step * dz
    if scratch.give[row.body] > 0.0:
        push_bodies(world.shapes.tool, row.body, scratch, _in_space(row, more))


@inner
def _in_space(row: BladeRow, values: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the vector that has some values forward, along and across."""
    f, e, n = row.forward, row.along, row.normal
    return (
        values[0] * f[0] + values[1] * e[0] + values[2] * n[0],
        values[0] * f[1] + values[1] * e[1] + values[2] * n[1],
        values[0] * f[2] + values[1] * e[2] + values[2] * n[2],
    )


@kernel
def end_blades(world: World, found: int, step: float) -> None:
    """Move the places that have slipped forward through the tissue, and add the impulses on the tools.

    Parameters
    ----------
    world : World
        Model, state, shapes, settings and working memory; updated.
    found : int
        Number of the places.
    step : float, s
        The substep.
    """
    state, scratch = world.state, world.scratch
    for index in range(found):
        row = scratch.blade_rows[index]
        sample, f, e, n, pushed = state.blades[row.sample], row.forward, row.along, row.normal, row.pushed
        soft = GIVE / step
        x, y, z = offset_of(world, row, row.weight)
        ahead = aside = across = 0.0
        if row.slips:
            aside = e[0] * x + e[1] * y + e[2] * z - soft * pushed[1]
        if row.cuts:
            ahead = f[0] * x + f[1] * y + f[2] * z - row.lag - soft * pushed[0]
            if row.at_front and world.shapes.blades.speed[row.sample] == 0.0:
                ahead = row.pace * (ahead + _released(sample, pushed[0], step)) if ahead > 0.0 else ahead
            elif row.borrowed:  # its offset doesn't shrink by its motion at rest
                ahead = min(ahead, way_past(world, row, f, row.weight, step))
        if abs(pushed[2]) >= row.most and row.side == 0.0:  # torn sideways
            across = n[0] * x + n[1] * y + n[2] * z - row.lag_across - soft * pushed[2]
        elif row.side == 0.0:
            eased = soft * (pushed[2] - _mean_across(scratch, row.body, found)) + row.lag_across
            across = step / EASES * eased
        if not row.at_front and not sample.free and world.shapes.blades.width[row.sample] > 0.0:
            # Up to the place where it has been before; beyond that it is resisted.
            ahead = min(ahead, max(0.0, sample.deepest - sample.depth) / max(_shrinking(row), 1e-9))
        most = MOST_SPEED * step
        ahead, aside = min(max(ahead, -most), most), min(max(aside, -most), most)
        _advance(world, row, sample, (ahead, aside, min(max(across, -most), most)))
        count_on_body(scratch, row.body, row.arm, _in_space(row, (pushed[0], pushed[1], pushed[2])))
        for axis in range(3):
            sample.force[axis] = pushed[axis] / step


@inner
def _released(sample: BladeSample, pushed: float, step: float) -> float:
    """Return the additional distance that a place cuts, m, by the energy that is released when its force decreases.

    If the tissue ahead resists less, the force falls suddenly, and the tissue that had yielded at the place springs
    back.
    """
    change = pushed - sample.force[0] * step
    return 0.5 * GIVE / step * change * change / pushed if pushed > 0.0 else 0.0


@kernel
def _mean_across(scratch: Scratch, body: int, found: int) -> float:
    """Return the mean impulse across the flanks of a body, N s: that of the hand, as the others balance each other."""
    total, count = 0.0, 0
    for index in range(found):
        row = scratch.blade_rows[index]
        if row.body == body:
            total += row.pushed[2]
            count += 1
    return total / count


@inner
def _shrinking(row: BladeRow) -> float:
    """Return the ratio of a forward displacement at rest to the present one."""
    f = row.forward
    x, y, z = times(row.back, f[0], f[1], f[2])
    return math.sqrt(x * x + y * y + z * z)


@kernel
def _advance(world: World, row: BladeRow, sample: BladeSample, way: tuple[float, float, float]) -> None:
    """Move a place through the tissue by a displacement, m forward, along and across, and add the area that it cuts."""
    ahead, aside, across = way
    if ahead == 0.0 and aside == 0.0 and across == 0.0:
        return
    x, y, z = times(row.back, *_in_space(row, way))
    sample.rest[0] += x
    sample.rest[1] += y
    sample.rest[2] += z
    forward = ahead * _shrinking(row)
    sample.depth += forward
    if sample.free:
        sample.deepest = sample.depth
    elif sample.depth > sample.deepest:
        new = (sample.depth - sample.deepest) / forward if forward > 0.0 else 0.0
        sample.area += min(1.0, new) * ahead * world.shapes.blades.width[row.sample] * row.area_ratio
        sample.deepest = sample.depth
