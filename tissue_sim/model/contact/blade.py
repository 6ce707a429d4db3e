"""Blades in tissue: they stick until the load on their edge reaches the toughness, and then cut.

Places on the edge and on the flanks of a blade have places in the organ at rest. As long as they stick, a constraint
holds both together. In the plane of the blade its impulse is bounded: forward by the toughness times the width of the
edge, and in all directions by the friction on the flanks. At the bound a place moves on through the tissue, and that
creates the area of the cut. Behind the front of a cut only friction is left. Across the flank the tissue follows; where
the lips have opened, the flank pushes the one that it touches.

The force is that of a constraint, as the contact of tools, and solved in the same passes. What has been cut is opened
beside the loop (cutting.blade_path).
"""

from __future__ import annotations

import math

from tissue_sim.array_types import Floats
from tissue_sim.jit import kernel
from tissue_sim.model.contact.active_contact import ActiveContact
from tissue_sim.model.data.blades import CORNERS, LIP_NODES, BladeRow, BladeSample, CutCells
from tissue_sim.model.data.contact_set import nodes_of
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.state import State
from tissue_sim.model.data.world import World

MOST_STEPS = 64  # from cell to cell, in a search
OUTSIDE = 0.05  # barycentric weight below 0 from which a place has left the tissue
AJAR = 1e-4  # m, opening of the lips from which the flank touches one of them
AT_FRONT = 1e-9  # m at rest, within which a place is at the front of its cut
# m/N, by which tissue yields right at a place: cells are coarser than places are apart, so that what holds these may
# not fit together.
GIVE = 1e-3
EASES = 0.02  # s, in which tissue gives way to forces across a flank that only balance each other
MOST_OFFSET = 1e-3  # m, of a place from the tissue around it, where it enters beside others
MOST_SPEED = 2.0  # m/s, of a place through tissue
MOST_BACK = 4.0  # Frobenius norm of displacements at rest to those now; that of the unit matrix is 1.7
SMOOTH = 5e-3  # s over which the load on an edge counts before it enters
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
        if not sample.embedded and not _enters(world, number):
            continue
        row = scratch.blade_rows[found]
        row.sample, row.body = number, body
        if not _locate(cells, sample, row.weight):
            _leave(sample)
            continue
        _place_row(world, row, sample, step)
        _resist(world, row, sample, step)
        found += 1
    for number in range(len(state.bodies)):
        state.bodies[number].cutting = False
    for index in range(found):
        row = scratch.blade_rows[index]
        state.bodies[row.body].cutting = True
        _give(world, row, (row.pushed[0], row.pushed[1], row.pushed[2]), step)
    return found


@kernel
def _leave(sample: BladeSample) -> None:
    sample.embedded = sample.free = False
    sample.depth = sample.deepest = sample.area = 0.0
    for axis in range(3):
        sample.rest[axis] = sample.force[axis] = sample.offset[axis] = 0.0


@kernel
def _locate(cells: CutCells, sample: BladeSample, weight: Floats) -> bool:
    """Find the cell that holds a place, from that where it was; write its weights (4,); False: it is outside."""
    cell, rest = sample.cell, sample.rest
    for _ in range(MOST_STEPS):
        least, across = 0.0, -1
        for corner in range(CORNERS):
            slope = cells.slope[cell, corner]
            value = cells.base[cell, corner] + slope[0] * rest[0] + slope[1] * rest[1] + slope[2] * rest[2]
            weight[corner] = value
            if value < least:
                least, across = value, corner
        if across < 0:
            sample.cell = cell
            return True
        if cells.neighbour[cell, across] < 0:
            sample.cell = cell
            return least > -OUTSIDE
        cell = cells.neighbour[cell, across]
    return False


@kernel
def _turned(rotation: Floats, vector: Floats, result: Floats) -> None:
    for row in range(3):
        result[row] = (
            rotation[3 * row] * vector[0] + rotation[3 * row + 1] * vector[1] + rotation[3 * row + 2] * vector[2]
        )


@kernel
def _write_sum(first: Floats, second: Floats, result: Floats) -> None:
    for axis in range(3):
        result[axis] = first[axis] + second[axis]


@kernel
def _write_offset(world: World, number: int, weight: Floats) -> None:
    """Note where tissue with barycentric weights (4,) holds a place of a blade, so that it enters without a jump."""
    state, scratch, cells, blades = world.state, world.scratch, world.model.cut_cells, world.shapes.blades
    sample, body, away = state.blades[number], blades.body[number], scratch.blade_way
    rotation, origin = scratch.rotation[body], scratch.origin[body]
    for axis in range(3):
        place = 0.0
        for corner in range(CORNERS):
            first, second = cells.nodes[sample.cell, corner], cells.others[sample.cell, corner]
            place += 0.5 * weight[corner] * (state.position[first, axis] + state.position[second, axis])
        away[axis] = place - origin[axis]
    for axis in range(3):
        back = rotation[axis] * away[0] + rotation[3 + axis] * away[1] + rotation[6 + axis] * away[2]
        sample.offset[axis] = back - blades.at[number, axis]


@kernel
def _place_row(world: World, row: BladeRow, sample: BladeSample, step: float) -> None:
    """Write where a place is, what holds it there, and how both yield."""
    state, shapes, scratch, cells = world.state, world.shapes, world.scratch, world.model.cut_cells
    blades, rotation, cell = shapes.blades, scratch.rotation[row.body], sample.cell
    _write_sum(blades.at[row.sample], sample.offset, scratch.blade_at)
    _turned(rotation, scratch.blade_at, row.arm)
    _turned(rotation, blades.forward[row.sample], row.forward)
    _turned(rotation, blades.normal[row.sample], row.normal)
    f, n, e = row.forward, row.normal, row.along
    e[0], e[1], e[2] = n[1] * f[2] - n[2] * f[1], n[2] * f[0] - n[0] * f[2], n[0] * f[1] - n[1] * f[0]
    stretch, position = scratch.blade_stretch, state.position
    stretch[:] = 0.0
    own = other = middle = 0.0
    origin = scratch.origin[row.body]
    for corner in range(CORNERS):
        first, second, weight = cells.nodes[cell, corner], cells.others[cell, corner], row.weight[corner]
        row.node[corner], row.node[CORNERS + corner] = first, second
        for axis in range(3):
            at = 0.5 * (position[first, axis] + position[second, axis])
            for c in range(3):
                stretch[3 * axis + c] += at * cells.slope[cell, corner, c]
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
        row.weight[corner] = weight if is_one else 0.5 * weight
        row.weight[CORNERS + corner] = 0.0 if is_one else 0.5 * weight
        for half in range(2):
            place = corner + half * CORNERS
            row.across_weight[place] = row.weight[place]
            if row.side != 0.0 and not is_one:
                row.across_weight[place] = weight if (half == 1) == takes_other else 0.0
    _write_inverse(stretch, row.back)
    give = across = 0.0
    for place in range(LIP_NODES):
        mobility = scratch.mobility[row.node[place]]
        give += row.weight[place] ** 2 * mobility
        across += row.across_weight[place] ** 2 * mobility
    give, across = give * step + scratch.give[row.body], across * step + scratch.give[row.body]
    row.stiffness, row.across_stiffness = 1.0 / (give + GIVE / step), 1.0 / (across + GIVE / step)


@kernel
def _write_inverse(a: Floats, inverse: Floats) -> None:
    """Write the inverse (9,) of a deformation gradient (9,), row by row, at most MOST_BACK large.

    It is 0 where that is nearly singular: inverted cells tell nothing about directions.
    """
    c0, c1, c2 = a[4] * a[8] - a[5] * a[7], a[5] * a[6] - a[3] * a[8], a[3] * a[7] - a[4] * a[6]
    determinant = a[0] * c0 + a[1] * c1 + a[2] * c2
    if determinant < 0.05:
        inverse[:] = 0.0
        return
    inverse[0], inverse[3], inverse[6] = c0, c1, c2
    inverse[1], inverse[4], inverse[7] = a[2] * a[7] - a[1] * a[8], a[0] * a[8] - a[2] * a[6], a[1] * a[6] - a[0] * a[7]
    inverse[2], inverse[5], inverse[8] = a[1] * a[5] - a[2] * a[4], a[2] * a[3] - a[0] * a[5], a[0] * a[4] - a[1] * a[3]
    square = 0.0
    for c in range(9):
        inverse[c] /= determinant
        square += inverse[c] * inverse[c]
    if square > MOST_BACK * MOST_BACK:
        for c in range(9):
            inverse[c] *= MOST_BACK / math.sqrt(square)


@kernel
def _resist(world: World, row: BladeRow, sample: BladeSample, step: float) -> None:
    """Write the limits of a row, and the impulses with which it begins."""
    blades, settings = world.shapes.blades, world.settings
    b, f, e = row.back, row.forward, row.along
    fx, fy, fz = _times(b, f[0], f[1], f[2])
    ex, ey, ez = _times(b, e[0], e[1], e[2])
    row.area_ratio = math.sqrt((fy * ez - fz * ey) ** 2 + (fz * ex - fx * ez) ** 2 + (fx * ey - fy * ex) ** 2)
    if row.area_ratio == 0.0:
        row.area_ratio = 1.0
    row.most = settings.force_clamp * step
    row.drag = settings.flank_friction * blades.flank[row.sample] * step
    width, speed = blades.width[row.sample], blades.speed[row.sample]
    row.resistance = 0.0
    sample.free = sample.free and world.model.cut_cells.is_cut[sample.cell] == 1
    if width > 0.0 and speed > 0.0:
        _melt(world, row, sample, speed * step)
        row.resistance = row.most
    elif width > 0.0 and not sample.free and sample.depth >= sample.deepest - AT_FRONT:
        row.resistance = settings.toughness * width * row.area_ratio * step
    row.slips = row.cuts = False
    for axis in range(3):
        row.pushed[axis] = sample.force[axis] * step
    if row.side * row.pushed[2] < 0.0:
        row.pushed[2] = 0.0


@kernel
def _times(matrix: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    return (
        matrix[0] * x + matrix[1] * y + matrix[2] * z,
        matrix[3] * x + matrix[4] * y + matrix[5] * z,
        matrix[6] * x + matrix[7] * y + matrix[8] * z,
    )


@kernel
def _melt(world: World, row: BladeRow, sample: BladeSample, most: float) -> None:
    """Move a place that parts tissue without force forward, by as far as it presses and at most `most`, m."""
    x, y, z = _offset(world, row, row.weight)
    f = row.forward
    ahead = min(most, f[0] * x + f[1] * y + f[2] * z)
    if ahead > 0.0:
        _advance(world, row, sample, (ahead, 0.0, 0.0))


@kernel
def _offset(world: World, row: BladeRow, weights: Floats) -> tuple[float, float, float]:
    """Return how far a place of a blade is from what holds it, m."""
    state, origin, arm = world.state, world.scratch.origin[row.body], row.arm
    x, y, z = origin[0] + arm[0], origin[1] + arm[1], origin[2] + arm[2]
    for place in range(LIP_NODES):
        weight = weights[place]
        if weight != 0.0:
            position = state.position[row.node[place]]
            x, y, z = x - weight * position[0], y - weight * position[1], z - weight * position[2]
    return x, y, z


@kernel
def press_blades(world: World, found: int, step: float) -> bool:
    """Make one pass over the listed places; return whether the impulses changed little.

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
        x, y, z = _offset(world, row, row.across_weight)
        across = pushed[2] + (n[0] * x + n[1] * y + n[2] * z - soft * pushed[2]) * row.across_stiffness
        if row.side * across < 0.0:
            across = 0.0
        across = min(max(across, -row.most), row.most)
        x, y, z = _offset(world, row, row.weight)
        ahead = pushed[0] + (f[0] * x + f[1] * y + f[2] * z - soft * pushed[0]) * row.stiffness
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


@kernel
def _give(world: World, row: BladeRow, more: tuple[float, float, float], step: float) -> None:
    """Apply an impulse, N s forward, along and across, to the tissue at a place, and its opposite to the tool."""
    state, scratch, f, e, n = world.state, world.scratch, row.forward, row.along, row.normal
    for axis in range(3):
        within, across = more[0] * f[axis] + more[1] * e[axis], more[2] * n[axis]
        for place in range(LIP_NODES):
            node = row.node[place]
            move = scratch.mobility[node] * (row.weight[place] * within + row.across_weight[place] * across)
            state.velocity[node, axis] += move
            state.position[node, axis] += step * move
    give, tools = scratch.give[row.body], world.shapes.tool
    if give > 0.0:
        for other in range(len(tools)):
            if tools[other] == tools[row.body]:
                for axis in range(3):
                    scratch.origin[other, axis] -= give * (more[0] * f[axis] + more[1] * e[axis] + more[2] * n[axis])


@kernel
def end_blades(world: World, found: int, step: float) -> None:
    """Move the places that have slipped on through the tissue, and count what acts on the tools.

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
        x, y, z = _offset(world, row, row.weight)
        ahead = aside = across = 0.0
        if row.slips:
            aside = e[0] * x + e[1] * y + e[2] * z - soft * pushed[1]
        if row.cuts:
            ahead = f[0] * x + f[1] * y + f[2] * z - soft * pushed[0]
        if abs(pushed[2]) >= row.most and row.side == 0.0:  # torn aside
            across = n[0] * x + n[1] * y + n[2] * z - soft * pushed[2]
        elif row.side == 0.0:
            across = step / EASES * soft * (pushed[2] - _mean_across(scratch, row.body, found))
        if row.resistance == 0.0 and not sample.free and world.shapes.blades.width[row.sample] > 0.0:
            # Up to where it has been before; from there on it is resisted.
            ahead = min(ahead, max(0.0, sample.deepest - sample.depth) / max(_shrinking(row), 1e-9))
        most = MOST_SPEED * step
        ahead, aside = min(max(ahead, -most), most), min(max(aside, -most), most)
        _advance(world, row, sample, (ahead, aside, min(max(across, -most), most)))
        impulse, arm = scratch.impulse[row.body], row.arm
        px = pushed[0] * f[0] + pushed[1] * e[0] + pushed[2] * n[0]
        py = pushed[0] * f[1] + pushed[1] * e[1] + pushed[2] * n[1]
        pz = pushed[0] * f[2] + pushed[1] * e[2] + pushed[2] * n[2]
        impulse[0] += px
        impulse[1] += py
        impulse[2] += pz
        impulse[3] += arm[1] * pz - arm[2] * py
        impulse[4] += arm[2] * px - arm[0] * pz
        impulse[5] += arm[0] * py - arm[1] * px
        for axis in range(3):
            sample.force[axis] = pushed[axis] / step


@kernel
def _mean_across(scratch: Scratch, body: int, found: int) -> float:
    """Return the mean impulse across the flanks of a body, N s: the hand's part, as all others balance each other."""
    total, count = 0.0, 0
    for index in range(found):
        row = scratch.blade_rows[index]
        if row.body == body:
            total += row.pushed[2]
            count += 1
    return total / count


@kernel
def _shrinking(row: BladeRow) -> float:
    """Return how long a way forward is at rest, relative to now."""
    f = row.forward
    x, y, z = _times(row.back, f[0], f[1], f[2])
    return math.sqrt(x * x + y * y + z * z)


@kernel
def _advance(world: World, row: BladeRow, sample: BladeSample, way: tuple[float, float, float]) -> None:
    """Move a place through the tissue by a way, m forward, along and across, and count the area that it cuts."""
    ahead, aside, across = way
    if ahead == 0.0 and aside == 0.0 and across == 0.0:
        return
    f, e, n = row.forward, row.along, row.normal
    x, y, z = _times(
        row.back,
        ahead * f[0] + aside * e[0] + across * n[0],
        ahead * f[1] + aside * e[1] + across * n[1],
        ahead * f[2] + aside * e[2] + across * n[2],
    )
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


@kernel
def _enters(world: World, number: int) -> bool:
    """Return whether a place of a blade is in tissue now, by the nearest place of its body that is already there."""
    state, scratch, cells, blades = world.state, world.scratch, world.model.cut_cells, world.shapes.blades
    best, chosen, body = math.inf, -1, blades.body[number]
    for other in range(len(state.blades)):
        if blades.body[other] == body and state.blades[other].embedded:
            square = 0.0
            for axis in range(3):
                square += (blades.at[other, axis] - blades.at[number, axis]) ** 2
            if square < best:
                best, chosen = square, other
    if chosen < 0:
        return False
    beside, sample, cell = state.blades[chosen], state.blades[number], state.blades[chosen].cell
    stretch, at, weight = scratch.blade_stretch, scratch.blade_at, scratch.blade_weight
    if not _locate(cells, beside, weight):
        return False
    stretch[:] = 0.0
    _turned(scratch.rotation[body], blades.at[number], at)
    for axis in range(3):
        at[axis] += scratch.origin[body, axis]
    for corner in range(CORNERS):
        first, second = cells.nodes[cell, corner], cells.others[cell, corner]
        for axis in range(3):
            place = 0.5 * (state.position[first, axis] + state.position[second, axis])
            at[axis] -= weight[corner] * place
            for c in range(3):
                stretch[3 * axis + c] += place * cells.slope[cell, corner, c]
    _write_inverse(stretch, scratch.blade_back)
    x, y, z = _times(scratch.blade_back, at[0], at[1], at[2])
    _leave(sample)
    sample.rest[0], sample.rest[1], sample.rest[2] = beside.rest[0] + x, beside.rest[1] + y, beside.rest[2] + z
    sample.cell = cell
    if not _locate(cells, sample, weight):
        return False
    for corner in range(CORNERS):
        if weight[corner] < 0.0:
            return False
    _write_offset(world, number, weight)
    square = 0.0
    for axis in range(3):
        square += sample.offset[axis] ** 2
    if square > MOST_OFFSET * MOST_OFFSET:
        return False
    sample.embedded = True
    sample.free = cells.is_cut[sample.cell] == 1
    return True


@kernel
def begin_cuts(world: World, touching: int, step: float) -> None:
    """Let blades into the tissue that they press with their edges as hard as it resists.

    Parameters
    ----------
    world : World
        Model, state, shapes, settings and working memory; updated.
    touching : int
        Number of the contact points in scratch.active.
    step : float, s
        The substep.
    """
    state, blades, cells = world.state, world.shapes.blades, world.model.cut_cells
    if len(state.blades) == 0 or len(cells.nodes) == 0 or touching == 0:
        return
    for body in range(len(state.bodies)):
        if state.bodies[body].cutting or not state.bodies[body].engaged:
            continue
        load, touched, width = _edge_load(world, body, touching)
        if touched == 0.0 or load <= 0.0 or not _is_heavy(world, body, load / step, width, step):
            continue
        began = False
        for number in range(len(state.blades)):
            if blades.body[number] == body and blades.width[number] > 0.0:
                began = _begin(world, number, touching, load / (touched * step)) or began
        if began:
            state.bodies[body].cutting = True
            for entry in range(state.contacts.header.points):
                if state.contacts.body[entry] == body:
                    state.contact_pressed[0, entry] = 0.0
                    state.contact_held[0, entry] = 0.0


@kernel
def _is_heavy(world: World, body: int, load: float, width: float, step: float) -> bool:
    """Return whether a load, N, on a width, m, of an edge is as large as the tissue resists, for some time."""
    state, blades = world.state, world.shapes.blades
    for number in range(len(state.blades)):
        if blades.body[number] == body:
            sample = state.blades[number]
            sample.load += min(1.0, step / SMOOTH) * (load - sample.load)
            return sample.load >= world.settings.toughness * width
    return False


@kernel
def _edge_load(world: World, body: int, touching: int) -> tuple[float, float, float]:
    """Return the impulse forward, N s, by which a body presses, and the widths, m, of its edge that does.

    The first width is of what presses anything, the second of what presses tissue that has to be cut, or 0 for a blade
    that parts it without force.
    """
    state, blades, scratch = world.state, world.shapes.blades, world.scratch
    load = touched = width = 0.0
    is_first = True
    for number in range(len(state.blades)):
        if blades.body[number] != body or blades.width[number] == 0.0:
            continue
        if is_first:
            _turned(scratch.rotation[body], blades.forward[number], scratch.blade_way)
            is_first = False
        chosen = _pressed_beside(world, number, touching)
        if chosen >= 0:
            touched += blades.width[number]
            if blades.speed[number] == 0.0 and not _is_in_cut(world, scratch.active[chosen]):
                width += blades.width[number]
    forward = scratch.blade_way
    for index in range(touching):
        contact = scratch.active[index]
        if contact.body == body and contact.pressed > 0.0:
            for axis in range(3):
                load += forward[axis] * (contact.pressed * contact.normal[axis] + contact.held[axis])
    return load, touched, width


@kernel
def _is_in_cut(world: World, contact: ActiveContact) -> bool:
    """Return whether a contact point lies on the lips of a cut, or on its walls."""
    cells, count = world.model.cut_cells, len(world.model.cut_cells.first)
    for corner in range(contact.nodes):
        if contact.node[corner] >= count:
            return True
    return cells.is_cut[cells.first[contact.node[0]]] == 1


@kernel
def _pressed_beside(world: World, number: int, touching: int) -> int:
    """Return which active contact presses nearest to a place of an edge.

    It is -1 where the edge presses on one side of that place only, or nowhere: contact points may be farther apart than
    the places are.
    """
    blades, scratch = world.shapes.blades, world.scratch
    body, at = blades.body[number], scratch.blade_at
    _turned(scratch.rotation[body], blades.at[number], at)
    f, n, local, along = blades.forward[number], blades.normal[number], scratch.blade_back, scratch.blade_weight
    local[0], local[1], local[2] = n[1] * f[2] - n[2] * f[1], n[2] * f[0] - n[0] * f[2], n[0] * f[1] - n[1] * f[0]
    _turned(scratch.rotation[body], local, along)
    best, chosen, half = math.inf, -1, 0.5 * blades.width[number]
    before = behind = False
    for index in range(touching):
        contact = scratch.active[index]
        if contact.body != body or contact.pressed <= 0.0:
            continue
        square = beside = 0.0
        for axis in range(3):
            square += (contact.arm[axis] - at[axis]) ** 2
            beside += along[axis] * (contact.arm[axis] - at[axis])
        before, behind = before or beside < half, behind or beside > -half
        if square < best:
            best, chosen = square, index
    return chosen if before and behind else -1


@kernel
def _begin(world: World, number: int, touching: int, load: float) -> bool:
    """Put a place of an edge into the tissue that it presses, with a load in N/m; return whether it presses any."""
    state, scratch, cells = world.state, world.scratch, world.model.cut_cells
    chosen = _pressed_beside(world, number, touching)
    if chosen < 0:
        return False
    contact, sample, at = scratch.active[chosen], state.blades[number], scratch.blade_at
    node = contact.node[0]
    for corner in range(contact.nodes):
        if contact.node[corner] < len(cells.first):
            node = contact.node[corner]
    if node >= len(cells.first):
        return False  # between virtual nodes alone, which tell no cell
    _leave(sample)
    rest = world.model.rest
    for axis in range(3):
        place = 0.0
        for corner in range(nodes_of(state.contacts, contact.entry)):
            place += contact.weight[corner] * rest[contact.node[corner], axis]
        sample.rest[axis] = place + at[axis] - contact.arm[axis]
    sample.cell = cells.first[node]
    if not _locate(cells, sample, scratch.blade_weight):
        _put_into(cells, sample, scratch.blade_weight, rest)
        _locate(cells, sample, scratch.blade_weight)
    sample.embedded = True
    sample.free = cells.is_cut[sample.cell] == 1
    sample.force[0] = load * world.shapes.blades.width[number]
    _write_offset(world, number, scratch.blade_weight)
    return True


@kernel
def _put_into(cells: CutCells, sample: BladeSample, weight: Floats, rest: Floats) -> None:
    """Move a place that is outside into the cell that is nearest to it on the way there."""
    cell, total = sample.cell, 0.0
    for corner in range(CORNERS):
        weight[corner] = max(weight[corner], 1e-3)
        total += weight[corner]
    for axis in range(3):
        place = 0.0
        for corner in range(CORNERS):
            place += weight[corner] / total * rest[cells.nodes[cell, corner], axis]
        sample.rest[axis] = place


@kernel
def forget_blades(state: State) -> None:
    """Take all blades out of the tissue.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    """
    for number in range(len(state.blades)):
        _leave(state.blades[number])
        state.blades[number].load = 0.0
    for body in range(len(state.bodies)):
        state.bodies[body].cutting = False
