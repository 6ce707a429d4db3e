"""Contact of the tissue with rigid tools: non-penetration and Coulomb friction as constraints.

A contact point is a weighted sum of up to three nodes. After each substep every point that ended inside a tool is moved
onto it, and held against sliding within the friction cone. The force is that of the constraint, so it is equal and
opposite by construction and stable at any stiffness.

The compliance of tissue between nodes (contact.local_compliance) is part of the constraint, as in compliant constraints
(Macklin et al. 2016): a point lies that much inside its tool.
"""

from __future__ import annotations

import math
from typing import Any

from tissue_sim.jit import kernel
from tissue_sim.model.contact.culling import FAST, largest_tissue_speed
from tissue_sim.model.contact.gap import INNER_SIDE, gap_and_normal, point_in_body
from tissue_sim.model.contact.volume_limit import (
    SQUEEZED_PASSES,
    enforce_volume_limit,
    find_compressed_cells,
    has_compressed_cells,
)
from tissue_sim.model.data.arrays import copy
from tissue_sim.model.data.state import Region

NEAR = 5e-5  # m: distance within which points may come to touch while others are resolved
MOST_NEAR = 256  # contact points resolved in a substep
MOST_PASSES = 20  # over the contact points in a substep, and
PASSES_A_TICK = 40  # in a tick: short substeps start from the last one's result, but at least
LEAST_PASSES = 6
RECOVERY_SPEED = 0.2  # m/s, largest speed at which a point that already lay inside a tool comes out
TOLERANCE = 1e-3  # of the sum of the normal impulses: change in a pass at which it has converged


@kernel
def gather_contacts(
    state: Any, shapes: Any, mobility: Any, settings: Any, step: float, scratch: Any, spread: bool
) -> int:
    """List the points that touch or nearly touch in scratch.near_entry, with the impulses of the last substep.

    spread: whether add_contact_impulses has already applied these impulses, whatever the tool's normal is now. For
    each, scratch.near_plane (N, 11) holds: the tool's outward normal and the distance of its surface along that from
    the tool's origin, m, minus the forgiven depth; the tool's motion there in the substep, minus its origin, m; the
    response of nodes and tool to an impulse, m / (N s); and the place relative to the tool's origin, m.

    The number of points is returned; when more come close than the list holds, the first ones are kept. The others'
    impulses are forgotten.
    """
    if scratch.watching[0] == 0:
        return 0
    found, tissue = 0, largest_tissue_speed(state)
    for index in range(scratch.watching[0]):
        entry = scratch.watched[index]
        body = state.contacts.body[entry]
        pressed = state.contact_pressed[0, entry]
        if pressed == 0.0:
            # The contact moves a compliant tool, too.
            speed = tissue if scratch.give[body] == 0.0 else FAST
            scratch.watched_gap[index] -= step * (scratch.watched_speed[index] + speed)
            if scratch.watched_gap[index] >= NEAR:
                continue
        near = False
        if state.bodies[body].engaged and found < len(scratch.near_entry):
            scratch.near_entry[found] = entry
            gap = set_plane(state, shapes, scratch, found)
            scratch.watched_gap[index] = gap
            near = pressed > 0.0 or (gap < NEAR and is_outside(state, scratch, found))
        if not near:
            state.contact_pressed[0, entry] = 0.0
            state.contact_held[0, entry] = 0.0
            continue
        plane = scratch.near_plane[found]
        plane[7] = set_nodes(state, mobility, scratch, found) * step + scratch.give[body]
        soften(state, scratch, found, settings.stiffness_scale * step)
        forgive_depth(state, scratch, found, gap, step)
        given = spread and pressed > 0.0
        held, last_held = scratch.near_tangent[found], state.contact_held[1 if given else 0, entry]
        along = last_held[0] * plane[0] + last_held[1] * plane[1] + last_held[2] * plane[2]
        for c in range(3):
            held[c] = last_held[c] - along * plane[c]
        scratch.near_normal[found] = along if given else pressed
        begin_across(state, scratch, found)
        found += 1
    return found


@kernel
def soften(state: Any, scratch: Any, near: int, scale: float) -> None:
    """Set the compliance of a contact point, scratch.near_soft (N, 4); scale: stiffness scale times the step, s.

    It holds the yielding of tissue between nodes to an impulse in a substep along the normal, m / (N s); the impulse
    that moves the point a metre out of the tool, N s/m, or 0 where none does; and both across the normal.
    """
    compliance, soft = state.contacts.compliance[scratch.near_entry[near]], scratch.near_soft[near]
    for which in range(2):
        give = compliance[which] / scale if scale > 0.0 else 0.0
        whole = scratch.near_plane[near, 7] + give
        soft[2 * which], soft[2 * which + 1] = give, 1.0 / whole if whole > 0.0 else 0.0


@kernel
def begin_across(state: Any, scratch: Any, near: int) -> None:
    """Note in scratch.near_began (N, 3) the yielding of tissue between nodes across the normal, m, at the start.

    It follows from scratch.near_tangent of the last substep.
    """
    began, held, soft = scratch.near_began[near], scratch.near_tangent[near], scratch.near_soft[near, 2]
    most = state.contacts.most_give[scratch.near_entry[near]]
    size = soft * math.sqrt(held[0] * held[0] + held[1] * held[1] + held[2] * held[2])
    back = soft if size <= most else soft * most / size
    began[0], began[1], began[2] = back * held[0], back * held[1], back * held[2]


@kernel
def carry_force(state: Any, substeps: int, now: int) -> None:
    """Rescale the last contact impulses to the same forces where a tick has another number of substeps now.

    Parameters
    ----------
    state : Any
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


@kernel
def set_nodes(state: Any, mobility: Any, scratch: Any, near: int) -> float:
    """Copy the nodes, weights and mobilities of a contact point side by side; return its own mobility, 1/kg."""
    entry, mobile = scratch.near_entry[near], 0.0
    for c in range(3):
        node, weight = state.contacts.node[entry, c], state.contacts.weight[entry, c]
        scratch.near_node[near, c], scratch.near_weight[near, c] = node, weight
        scratch.near_move[near, c] = weight * mobility[node]
        mobile += weight * scratch.near_move[near, c]
    return mobile


@kernel
def set_plane(state: Any, shapes: Any, scratch: Any, near: int) -> float:
    """Write the tool's state at a contact point to scratch.near_plane, see gather_contacts; return the gap, m."""
    entry, plane = scratch.near_entry[near], scratch.near_plane[near]
    body = state.contacts.body[entry]
    x, y, z, lx, ly, lz = point_in_body(state, entry, scratch.origin, scratch.rotation)
    gap, nx, ny, nz = gap_and_normal(shapes, body, scratch.rotation[body], lx, ly, lz)
    origin, last, q = scratch.origin[body], scratch.last_origin[body], scratch.last_rotation[body]
    plane[0], plane[1], plane[2] = nx, ny, nz
    plane[3] = nx * (x - origin[0]) + ny * (y - origin[1]) + nz * (z - origin[2]) - gap
    plane[4] = x - last[0] - (q[0] * lx + q[1] * ly + q[2] * lz) - origin[0]
    plane[5] = y - last[1] - (q[3] * lx + q[4] * ly + q[5] * lz) - origin[1]
    plane[6] = z - last[2] - (q[6] * lx + q[7] * ly + q[8] * lz) - origin[2]
    plane[8], plane[9], plane[10] = x - origin[0], y - origin[1], z - origin[2]
    return gap


@kernel
def forgive_depth(state: Any, scratch: Any, near: int, gap: float, step: float) -> None:
    """Let a contact point that lay inside its tool before this substep, s, come out gradually; gap m at its end.

    Tissue can close around a released tool. Pushed out at once, a point would be faster the shorter the substep is. The
    yielding of tissue under the last force is no such depth.
    """
    entry, plane = scratch.near_entry[near], scratch.near_plane[near]
    given = min(scratch.near_soft[near, 0] * state.contact_pressed[0, entry], state.contacts.most_give[entry])
    origin = scratch.origin[state.contacts.body[entry]]
    approach = 0.0
    for c in range(3):
        node, weight = state.contacts.node[entry, c], state.contacts.weight[entry, c]
        for axis in range(3):
            approach -= plane[axis] * weight * step * state.velocity[node, axis]
    for axis in range(3):
        approach += plane[axis] * (plane[4 + axis] + origin[axis])
    plane[3] -= max(0.0, -gap - approach - given - step * RECOVERY_SPEED)


@kernel
def is_outside(state: Any, scratch: Any, near: int) -> bool:
    """Return whether the tool is on the tissue's outer side at a contact point, as in gap_from_outside."""
    normal, plane = state.contacts.normal[scratch.near_entry[near]], scratch.near_plane[near]
    facing = normal[0] * plane[0]
    facing += normal[1] * plane[1]
    facing += normal[2] * plane[2]
    return facing < INNER_SIDE


@kernel
def look_again(state: Any, shapes: Any, scratch: Any, near: int, step: float) -> None:
    """Update the tool's plane at a contact point's present place, and split its impulse into pressed and held anew."""
    px, py, pz = whole_impulse(scratch, near)
    forgive_depth(state, scratch, near, set_plane(state, shapes, scratch, near), step)
    plane, held = scratch.near_plane[near], scratch.near_tangent[near]
    pressed = max(0.0, px * plane[0] + py * plane[1] + pz * plane[2])
    scratch.near_normal[near] = pressed
    held[0], held[1], held[2] = px - pressed * plane[0], py - pressed * plane[1], pz - pressed * plane[2]
    begin_across(state, scratch, near)


@kernel
def aim_impulse(state: Any, shapes: Any, entry: int, scratch: Any) -> tuple[float, float, float]:
    """Return the last substep's impulse on a contact point, N s, as it points now."""
    body = state.contacts.body[entry]
    _, _, _, lx, ly, lz = point_in_body(state, entry, scratch.origin, scratch.rotation)
    _, nx, ny, nz = gap_and_normal(shapes, body, scratch.rotation[body], lx, ly, lz)
    pressed, held = state.contact_pressed[0, entry], state.contact_held[0, entry]
    pressed -= held[0] * nx + held[1] * ny + held[2] * nz
    return pressed * nx + held[0], pressed * ny + held[1], pressed * nz + held[2]


@kernel
def add_contact_impulses(state: Any, shapes: Any, scratch: Any, scale: float, target: Any) -> None:
    """Add the last substep's contact impulses to the nodes, and keep them in held[1].

    Parameters
    ----------
    state : Any
        State of the simulation; updated.
    shapes : Any
        Shapes of the bodies.
    scratch : Any
        Working memory; updated.
    scale : float
        Factor of the impulses.
    target : Any, shape (n, 3)
        Sums at the nodes, updated.
    """
    shares = state.contacts.weight
    for index in range(scratch.watching[0]):
        entry = scratch.watched[index]
        if state.contact_pressed[0, entry] > 0.0 and state.bodies[state.contacts.body[entry]].engaged:
            push = aim_impulse(state, shapes, entry, scratch)
            held = state.contact_held[1, entry]  # row 0 stays that of a whole substep for readers beside the loop
            held[0], held[1], held[2] = push
            for corner in range(3):
                node, share = state.contacts.node[entry, corner], scale * shares[entry, corner]
                target[node, 0] += share * push[0]
                target[node, 1] += share * push[1]
                target[node, 2] += share * push[2]


@kernel
def resolve_contacts(
    model: Any,
    state: Any,
    shapes: Any,
    mobility: Any,
    scratch: Any,
    settings: Any,
    step: float,
    spread: bool,
) -> int:
    """Keep every contact point out of its tool; return how many touched.

    Projected Gauss-Seidel on accumulated impulses: a point pushed too far by its neighbours moves back, so that points
    sharing nodes converge to one distribution of force instead of alternating. It starts from the impulses of the last
    substep, and ends when a pass changes them by less than TOLERANCE of their sum. Squeezed cells of the model are
    resolved along with the points.

    scratch.origin (T, 3) and scratch.rotation (T, 9) are the tools at the substep's end, last_* at its beginning. The
    impulses on the tissue, N s, and their moments about the tool's origin, N m s, are added to scratch.impulse (T, 6).

    Parameters
    ----------
    model : Any
        Constants of the model.
    state : Any
        State of the simulation; updated.
    shapes : Any
        Shapes of the bodies.
    mobility : Any, shape (n,), 1/kg
        Velocity that a unit impulse gives each node.
    scratch : Any
        Working memory; updated.
    settings : Any
        Settings of the simulation.
    step : float, s
        The substep.
    spread : bool
        True when the integrator has moved the organ by the last impulses already: points are then nearly at their final
        places, and the tool is as flat as it is there.
    """
    squeezed = find_compressed_cells(model, state, mobility, scratch, step)
    scratch.squeezing[0] = squeezed
    found = gather_contacts(state, shapes, mobility, settings, step, scratch, spread)
    if found == 0 and squeezed == 0:
        return 0
    for near in range(found):
        if scratch.near_normal[near] > 0.0:
            px, py, pz = whole_impulse(scratch, near)
            give_impulse(state, shapes, scratch, near, px, py, pz, 0.0 if spread else step)
    most = min(MOST_PASSES, max(LEAST_PASSES, PASSES_A_TICK // max(1, state.status.substeps)))
    for turn in range(SQUEEZED_PASSES if squeezed > 0 or has_compressed_cells(model) else most):
        held = enforce_volume_limit(state, mobility, scratch, squeezed, step)
        change = total = 0.0
        for near in range(found):
            if turn == 0 and not spread:
                look_again(state, shapes, scratch, near, step)
            change += resolve_contact(state, shapes, scratch, near, settings.friction, step)
            total += scratch.near_normal[near]
        if held and change <= TOLERANCE * total:
            break
    touching = 0
    for near in range(found):
        entry, pressed = scratch.near_entry[near], scratch.near_normal[near]
        state.contact_pressed[0, entry] = pressed
        copy(scratch.near_tangent[near], state.contact_held[0, entry])
        if pressed > 0.0:
            touching += 1
            count_impulse(state, scratch, near)
    return touching


@kernel
def whole_impulse(scratch: Any, near: int) -> tuple[float, float, float]:
    """Return the impulse on a contact point in this substep, N s."""
    plane, pressed, held = scratch.near_plane[near], scratch.near_normal[near], scratch.near_tangent[near]
    return pressed * plane[0] + held[0], pressed * plane[1] + held[1], pressed * plane[2] + held[2]


@kernel
def resolve_contact(state: Any, shapes: Any, scratch: Any, near: int, friction: float, step: float) -> float:
    """Resolve one contact point: no penetration, no sliding within the friction cone; return the added impulse, N s."""
    entry, plane = scratch.near_entry[near], scratch.near_plane[near]
    pressed, held, began = scratch.near_normal[near], scratch.near_tangent[near], scratch.near_began[near]
    soft, stiffness, soft_across, stiffness_across = scratch.near_soft[near]
    most = state.contacts.most_give[entry]
    if stiffness == 0.0:
        scratch.near_normal[near] = 0.0
        held[0] = held[1] = held[2] = 0.0
        return 0.0
    origin = scratch.origin[state.contacts.body[entry]]
    nodes, weights = scratch.near_node[near], scratch.near_weight[near]
    x, y, z = -origin[0], -origin[1], -origin[2]
    for c in range(3):
        weight, position = weights[c], state.position[nodes[c]]
        x += weight * position[0]
        y += weight * position[1]
        z += weight * position[2]
    nx, ny, nz = plane[0], plane[1], plane[2]
    gap = nx * x + ny * y + nz * z - plane[3]
    normal = max(0.0, pressed - (gap + soft * pressed) * stiffness)
    if plane[7] > 0.0:  # tissue that has given way by all that it can is as stiff as its nodes
        normal = max(normal, pressed - (gap + most) / plane[7])
    if normal == 0.0 and pressed == 0.0:
        return 0.0
    # Sliding of the tissue along the tool in this substep: its own motion less the tool's.
    sx, sy, sz = -plane[4] - origin[0], -plane[5] - origin[1], -plane[6] - origin[2]
    for c in range(3):
        weight, velocity = weights[c], state.velocity[nodes[c]]
        sx += weight * step * velocity[0]
        sy += weight * step * velocity[1]
        sz += weight * step * velocity[2]
    scratch.near_normal[near] = normal
    along = sx * nx + sy * ny + sz * nz
    sx, sy, sz = sx - along * nx, sy - along * ny, sz - along * nz
    # What the tissue between nodes had given way by when the substep began comes off it.
    sx, sy, sz = sx - began[0], sy - began[1], sz - began[2]
    tx = held[0] - (sx + soft_across * held[0]) * stiffness_across
    ty = held[1] - (sy + soft_across * held[1]) * stiffness_across
    tz = held[2] - (sz + soft_across * held[2]) * stiffness_across
    size = math.sqrt(tx * tx + ty * ty + tz * tz)
    given = soft_across * size
    if given > most and plane[7] > 0.0:
        forth = soft_across * most / given
        tx = held[0] - (sx + forth * tx) / plane[7]
        ty = held[1] - (sy + forth * ty) / plane[7]
        tz = held[2] - (sz + forth * tz) / plane[7]
        size = math.sqrt(tx * tx + ty * ty + tz * tz)
    share = 1.0 if size <= friction * normal else friction * normal / size
    px = (normal - pressed) * nx + share * tx - held[0]
    py = (normal - pressed) * ny + share * ty - held[1]
    pz = (normal - pressed) * nz + share * tz - held[2]
    held[0], held[1], held[2] = share * tx, share * ty, share * tz
    give_impulse(state, shapes, scratch, near, px, py, pz, step)
    return math.sqrt(px * px + py * py + pz * pz)


@kernel
def give_impulse(
    state: Any, shapes: Any, scratch: Any, near: int, px: float, py: float, pz: float, step: float
) -> None:
    """Apply an impulse, N s, to a contact point, and its opposite to the tool; with a step of 0 to the tool alone."""
    for c in range(3 if step > 0.0 else 0):
        node, move = scratch.near_node[near, c], scratch.near_move[near, c]
        state.velocity[node, 0] += move * px
        state.velocity[node, 1] += move * py
        state.velocity[node, 2] += move * pz
        state.position[node, 0] += step * move * px
        state.position[node, 1] += step * move * py
        state.position[node, 2] += step * move * pz
    body = state.contacts.body[scratch.near_entry[near]]
    if scratch.give[body] > 0.0:
        push_bodies(shapes.tool, body, scratch, px, py, pz)


@kernel
def count_impulse(state: Any, scratch: Any, near: int) -> None:
    """Add what acts on a contact point in this substep to scratch.impulse, and to what drives a modal region."""
    entry, plane = scratch.near_entry[near], scratch.near_plane[near]
    px, py, pz = whole_impulse(scratch, near)
    if state.status.region == Region.MODAL:
        for c in range(3):
            node, weight = state.contacts.node[entry, c], state.contacts.weight[entry, c]
            state.contact_impulse[node, 0] += weight * px
            state.contact_impulse[node, 1] += weight * py
            state.contact_impulse[node, 2] += weight * pz
    # The lever arm is that of the place of the normal, so that a ball without friction feels no moment about its
    # centre.
    ax, ay, az = plane[8], plane[9], plane[10]
    impulse = scratch.impulse[state.contacts.body[entry]]
    impulse[0] += px
    impulse[1] += py
    impulse[2] += pz
    impulse[3] += ay * pz - az * py
    impulse[4] += az * px - ax * pz
    impulse[5] += ax * py - ay * px


@kernel
def push_bodies(tools: Any, body: int, scratch: Any, px: float, py: float, pz: float) -> None:
    """Move every body of a body's tool by an impulse on the tissue, N s."""
    give = scratch.give[body]
    for other in range(len(tools)):
        if tools[other] == tools[body]:
            scratch.origin[other, 0] -= give * px
            scratch.origin[other, 1] -= give * py
            scratch.origin[other, 2] -= give * pz
