"""Contact of the tissue with rigid tools: non-penetration and Coulomb friction as constraints.

A contact point is a weighted sum of up to four nodes. After each substep every point that ended inside a tool is moved
onto it, and held against sliding within the friction cone. The force is that of the constraint, so it is equal and
opposite by construction and stable at any stiffness.

The compliance of tissue between nodes (contact.local_compliance) is part of the constraint, as in compliant constraints
(Macklin et al. 2016): a point lies that much inside its tool.
"""

from __future__ import annotations

import math

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.jit import inner, kernel
from tissue_sim.model.contact.active_contact import ActiveContact, gather_contacts, place_again, whole_impulse
from tissue_sim.model.contact.blade import end_blades, find_blades, press_blades
from tissue_sim.model.contact.blade_entry import begin_cuts
from tissue_sim.model.contact.gap import gap_and_normal, point_in_body
from tissue_sim.model.contact.impulses import count_on_body, push_bodies
from tissue_sim.model.contact.lips import find_lips, press_lips
from tissue_sim.model.contact.volume_limit import (
    COMPRESSED_PASSES,
    enforce_volume_limit,
    find_compressed_cells,
    has_compressed_cells,
)
from tissue_sim.model.data.contact_set import POINT_NODES, nodes_of
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.shapes import Shapes
from tissue_sim.model.data.state import Region, State
from tissue_sim.model.data.world import World

MAX_PASSES = 20  # over the contact points in a substep, and
PASSES_A_TICK = 40  # in a tick: short substeps start from the last one's result, but at least
MIN_PASSES = 6
TOLERANCE = 1e-3  # of the sum of the normal impulses: change in a pass at which it has converged


@kernel
def carry_force(state: State, substeps: int, now: int) -> None:
    """Rescale the last contact impulses to the same forces if the number of substeps has changed.

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    substeps : int
        Previous number of substeps.
    now : int
        Present number of substeps.
    """
    if substeps == now or substeps == 0:
        return
    scale = substeps / now
    for entry in range(state.contacts.header.points):
        state.contact_pressed[0, entry] *= scale
        for c in range(3):
            state.contact_held[0, entry, c] *= scale


@inner
def redirected_impulse(state: State, shapes: Shapes, entry: int, scratch: Scratch) -> tuple[float, float, float]:
    """Return the last substep's impulse on a contact point, N s, rotated to the present normal."""
    body = state.contacts.body[entry]
    _, _, _, lx, ly, lz = point_in_body(state, entry, scratch.origin, scratch.rotation)
    _, nx, ny, nz = gap_and_normal(shapes, body, scratch.rotation[body], lx, ly, lz)
    pressed, held = state.contact_pressed[0, entry], state.contact_held[0, entry]
    pressed -= held[0] * nx + held[1] * ny + held[2] * nz
    return pressed * nx + held[0], pressed * ny + held[1], pressed * nz + held[2]


@kernel
def add_contact_impulses(state: State, shapes: Shapes, scratch: Scratch, scale: float, target: Floats) -> None:
    """Add the last substep's contact impulses to the nodes, and keep them in held[1].

    Parameters
    ----------
    state : State
        State of the simulation; updated.
    shapes : Shapes
        Shapes of the bodies.
    scratch : Scratch
        Working memory; updated.
    scale : float
        Factor of the impulses.
    target : Floats, shape (n, 3)
        Sums at the nodes, updated.
    """
    for index in range(scratch.n_candidates[0]):
        entry = scratch.candidates[index]
        if state.contact_pressed[0, entry] > 0.0 and state.bodies[state.contacts.body[entry]].engaged:
            push = redirected_impulse(state, shapes, entry, scratch)
            held = state.contact_held[1, entry]  # row 0 remains that of a whole substep, for concurrent readers
            held[0], held[1], held[2] = push
            for corner in range(3):
                _add_part(state, entry, corner, scale, push, target)
            if nodes_of(state.contacts, entry) > 3:
                _add_part(state, entry, 3, scale, push, target)


@inner
def _add_part(
    state: State, entry: int, corner: int, scale: float, push: tuple[float, float, float], target: Floats
) -> None:
    """Add a node's part of the impulse on a contact point, N s, times a scale to its sum in target (n, 3)."""
    node, part = np.uint64(state.contacts.node[entry, corner]), scale * state.contacts.weight[entry, corner]
    target[node, 0] += part * push[0]
    target[node, 1] += part * push[1]
    target[node, 2] += part * push[2]


@kernel
def resolve_contacts(world: World, step: float, spread: bool) -> int:
    """Keep every contact point out of its tool; return how many touched.

    Projected Gauss-Seidel on accumulated impulses: a point pushed too far by its neighbours moves back, so that points
    sharing nodes converge to one distribution of force instead of alternating. It starts from the impulses of the last
    substep, and ends when a pass changes them by less than TOLERANCE of their sum. Compressed cells of the model are
    resolved along with the points, and so are the lips of cuts and the blades in them.

    scratch.origin (T, 3) and scratch.rotation (T, 9) are the tools' frames at the substep's end, last_* those at its
    beginning. The impulses on the tissue, N s, and their moments about the tool's origin, N m s, are added to
    scratch.impulse (T, 6).

    Parameters
    ----------
    world : World
        Model, state, shapes, settings and working memory; updated.
    step : float, s
        The substep.
    spread : bool
        True if the integrator has already moved the organ by the last impulses: points are then nearly at their final
        places, where the tool's normal is evaluated.
    """
    model, state, shapes, scratch = world.model, world.state, world.shapes, world.scratch
    compressed = find_compressed_cells(model, state, scratch, step)
    scratch.n_compressed[0] = compressed
    lips = find_lips(model.lips, state, scratch.mobility, step)
    found = gather_contacts(world, step, spread)
    cutting = find_blades(world, step)
    if found == 0 and compressed == 0 and lips == 0 and cutting == 0:
        begin_cuts(world, 0, step)  # no edge is in contact
        return 0
    for index in range(found):
        contact = scratch.active[index]
        if contact.pressed > 0.0:
            apply_impulse(world, contact, whole_impulse(contact), 0.0 if spread else step)
    most = min(MAX_PASSES, max(MIN_PASSES, PASSES_A_TICK // max(1, state.status.substeps)))
    for turn in range(COMPRESSED_PASSES if compressed > 0 or has_compressed_cells(model) else most):
        held = enforce_volume_limit(state, scratch, compressed, step)
        if lips > 0:
            held = press_lips(model.lips, state, scratch.mobility, lips, step) and held
        if cutting > 0:
            held = press_blades(world, cutting, step) and held
        change = total = 0.0
        for index in range(found):
            contact = scratch.active[index]
            if turn == 0 and not spread:
                place_again(state, shapes, scratch, contact, step)
            change += resolve_contact(world, contact, step)
            total += contact.pressed
        if held and change <= TOLERANCE * total:
            break
    touching = 0
    for index in range(found):
        contact = scratch.active[index]
        state.contact_pressed[0, contact.entry] = contact.pressed
        last, kept = contact.held, state.contact_held[0, contact.entry]
        kept[0], kept[1], kept[2] = last[0], last[1], last[2]
        if contact.pressed > 0.0:
            touching += 1
            count_impulse(state, scratch, contact)
    if cutting > 0:
        end_blades(world, cutting, step)
    begin_cuts(world, found, step)
    return touching + cutting


@kernel
def resolve_contact(world: World, contact: ActiveContact, step: float) -> float:
    """Resolve one contact point: no penetration, no sliding within the friction cone; return the added impulse, N s."""
    state, scratch, friction = world.state, world.scratch, world.settings.friction
    pressed, held, normal = contact.pressed, contact.held, contact.normal
    soft, stiffness, response = contact.compliance, contact.stiffness, contact.response
    soft_across, stiffness_across = contact.compliance_across, contact.stiffness_across
    if stiffness == 0.0:
        contact.pressed = 0.0
        held[0] = held[1] = held[2] = 0.0
        return 0.0
    most, origin = state.contacts.most_give[contact.entry], scratch.origin[contact.body]
    position, velocity, node, weight = state.position, state.velocity, contact.node, contact.weight
    # The values of the three nodes are kept for the end, since the compiler would read them again. With unsigned
    # indices it needn't check for negative ones.
    a, b, c = np.uint64(node[0]), np.uint64(node[1]), np.uint64(node[2])
    wa, wb, wc = weight[0], weight[1], weight[2]
    ax, ay, az = position[a, 0], position[a, 1], position[a, 2]
    bx, by, bz = position[b, 0], position[b, 1], position[b, 2]
    cx, cy, cz = position[c, 0], position[c, 1], position[c, 2]
    ox, oy, oz = origin[0], origin[1], origin[2]
    x, y, z = -ox + wa * ax + wb * bx + wc * cx, -oy + wa * ay + wb * by + wc * cy, -oz + wa * az + wb * bz + wc * cz
    if contact.nodes > 3:  # a separate branch, as three nodes are faster
        x, y, z = plus_last(position, contact, x, y, z)
    nx, ny, nz = normal[0], normal[1], normal[2]
    gap = nx * x + ny * y + nz * z - contact.offset
    push = max(0.0, pressed - (gap + soft * pressed) * stiffness)
    if response > 0.0:  # tissue that has yielded as far as it can is as stiff as its nodes
        push = max(push, pressed - (gap + most) / response)
    if push == 0.0 and pressed == 0.0:
        return 0.0
    # Sliding of the tissue along the tool in this substep: its own motion less the tool's.
    motion, ha, hb, hc = contact.tool_motion, wa * step, wb * step, wc * step
    au, av, aw = velocity[a, 0], velocity[a, 1], velocity[a, 2]
    bu, bv, bw = velocity[b, 0], velocity[b, 1], velocity[b, 2]
    cu, cv, cw = velocity[c, 0], velocity[c, 1], velocity[c, 2]
    sx = -motion[0] - ox + ha * au + hb * bu + hc * cu
    sy = -motion[1] - oy + ha * av + hb * bv + hc * cv
    sz = -motion[2] - oz + ha * aw + hb * bw + hc * cw
    if contact.nodes > 3:
        vx, vy, vz = plus_last(velocity, contact, 0.0, 0.0, 0.0)
        sx, sy, sz = sx + step * vx, sy + step * vy, sz + step * vz
    contact.pressed = push
    along = sx * nx + sy * ny + sz * nz
    sx, sy, sz = sx - along * nx, sy - along * ny, sz - along * nz
    # The yielding of tissue between nodes at the beginning of the substep is subtracted.
    yielded = contact.yielded
    sx, sy, sz = sx - yielded[0], sy - yielded[1], sz - yielded[2]
    tx = held[0] - (sx + soft_across * held[0]) * stiffness_across
    ty = held[1] - (sy + soft_across * held[1]) * stiffness_across
    tz = held[2] - (sz + soft_across * held[2]) * stiffness_across
    size = math.sqrt(tx * tx + ty * ty + tz * tz)
    given = soft_across * size
    if given > most and response > 0.0:
        forth = soft_across * most / given
        tx = held[0] - (sx + forth * tx) / response
        ty = held[1] - (sy + forth * ty) / response
        tz = held[2] - (sz + forth * tz) / response
        size = math.sqrt(tx * tx + ty * ty + tz * tz)
    fraction = 1.0 if size <= friction * push else friction * push / size
    px = (push - pressed) * nx + fraction * tx - held[0]
    py = (push - pressed) * ny + fraction * ty - held[1]
    pz = (push - pressed) * nz + fraction * tz - held[2]
    held[0], held[1], held[2] = fraction * tx, fraction * ty, fraction * tz
    # The first node comes last: a point at a node has that node three times, and the first one has all of the weight.
    ma, mb, mc = contact.mobility[0], contact.mobility[1], contact.mobility[2]
    velocity[c, 0], velocity[c, 1], velocity[c, 2] = cu + mc * px, cv + mc * py, cw + mc * pz
    velocity[b, 0], velocity[b, 1], velocity[b, 2] = bu + mb * px, bv + mb * py, bw + mb * pz
    velocity[a, 0], velocity[a, 1], velocity[a, 2] = au + ma * px, av + ma * py, aw + ma * pz
    ma, mb, mc = step * ma, step * mb, step * mc
    position[c, 0], position[c, 1], position[c, 2] = cx + mc * px, cy + mc * py, cz + mc * pz
    position[b, 0], position[b, 1], position[b, 2] = bx + mb * px, by + mb * py, bz + mb * pz
    position[a, 0], position[a, 1], position[a, 2] = ax + ma * px, ay + ma * py, az + ma * pz
    if contact.nodes > 3:
        move_node(state, contact, 3, (px, py, pz), step)
    apply_impulse(world, contact, (px, py, pz), 0.0)
    return math.sqrt(px * px + py * py + pz * pz)


@kernel
def apply_impulse(world: World, contact: ActiveContact, impulse: tuple[float, float, float], step: float) -> None:
    """Apply an impulse, N s, to a contact point, and its opposite to the tool; with a step of 0 to the tool alone."""
    state, scratch = world.state, world.scratch
    for c in range(3 if step > 0.0 else 0):
        move_node(state, contact, c, impulse, step)
    if contact.nodes > 3 and step > 0.0:
        move_node(state, contact, 3, impulse, step)
    if scratch.give[contact.body] > 0.0:
        push_bodies(world.shapes.tool, contact.body, scratch, impulse)


@kernel
def move_node(state: State, contact: ActiveContact, c: int, impulse: tuple[float, float, float], step: float) -> None:
    """Apply a node's part of an impulse on its contact point, N s, as if it had acted for a whole substep."""
    px, py, pz = impulse
    node, move = contact.node[c], contact.mobility[c]
    state.velocity[node, 0] += move * px
    state.velocity[node, 1] += move * py
    state.velocity[node, 2] += move * pz
    state.position[node, 0] += step * move * px
    state.position[node, 1] += step * move * py
    state.position[node, 2] += step * move * pz


@kernel
def plus_last(values: Floats, contact: ActiveContact, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a vector plus that of the last of a contact point's nodes, times its weight."""
    weight, value = contact.weight[POINT_NODES - 1], values[contact.node[POINT_NODES - 1]]
    return x + weight * value[0], y + weight * value[1], z + weight * value[2]


@inner
def count_impulse(state: State, scratch: Scratch, contact: ActiveContact) -> None:
    """Add the impulse on a contact point in this substep to scratch.impulse, and to the loads of a modal region."""
    px, py, pz = whole_impulse(contact)
    if state.status.region == Region.MODAL:
        for c in range(contact.nodes):
            node, weight = contact.node[c], contact.weight[c]
            state.contact_impulse[node, 0] += weight * px
            state.contact_impulse[node, 1] += weight * py
            state.contact_impulse[node, 2] += weight * pz
    # The lever arm leads to the place of the normal, so that there is no moment about the centre of a ball without
    # friction.
    count_on_body(scratch, contact.body, contact.arm, (px, py, pz))
