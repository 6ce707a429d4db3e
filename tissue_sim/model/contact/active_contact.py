"""Active contacts: contact points that touch a tool in a substep, or nearly do, with the tool's surface there."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.jit import inner, kernel
from tissue_sim.model.contact.culling import FAST, largest_tissue_speed
from tissue_sim.model.contact.gap import gap_and_normal, is_on_outer_side, point_in_body
from tissue_sim.model.data.contact_set import POINT_NODES, nodes_of
from tissue_sim.model.data.records import Record, Vector
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.shapes import Shapes
from tissue_sim.model.data.state import State
from tissue_sim.model.data.world import World

NEAR = 5e-5  # m: distance within which points may come to touch while others are resolved
MAX_ACTIVE = 256  # contact points resolved in a substep
RECOVERY_SPEED = 0.2  # m/s, largest speed at which a point that was already inside a tool is moved out


class ActiveContact(Record):
    """Contact point that touches a tool in a substep, or nearly does."""

    entry: int  # its index in the contact set
    body: int
    nodes: int  # number of the following nodes that count, see contact_set.nodes_of
    node: Annotated[Longs, (POINT_NODES,)]
    weight: Annotated[Floats, (POINT_NODES,)]
    mobility: Annotated[Floats, (POINT_NODES,)]  # 1/kg, the velocity that an impulse on the point gives each node
    normal: Vector  # the tool's, outward
    offset: float  # m, distance of the tool's surface along the normal from its origin, less the allowed depth
    arm: Vector  # m, from the tool's origin to the point
    tool_motion: Vector  # m, motion of the tool at the point in the substep, less the tool's origin
    response: float  # m / (N s), of nodes and tool to an impulse
    # Compliance of tissue between nodes for an impulse, m / (N s); the stiffness, which includes it, is the impulse
    # that moves the point a metre, N s/m, or 0 if none does. Both are given along the tool's normal and across it.
    compliance: float
    stiffness: float
    compliance_across: float
    stiffness_across: float
    pressed: float  # N s along the normal
    held: Vector  # N s across it
    yielded: Vector  # m, yielding of tissue between nodes across the normal at the beginning of the substep


@kernel
def gather_contacts(world: World, step: float, spread: bool) -> int:
    """List the points that touch or nearly touch in scratch.active, with the impulses of the last substep.

    The impulses of points that are not listed are set to zero. If more points are close than the list holds, the first
    ones are kept.

    Parameters
    ----------
    world : World
        Model, state, shapes, settings and working memory; updated.
    step : float, s
        The substep.
    spread : bool
        True if add_contact_impulses has already applied these impulses, even if the tool's normal has changed.
    """
    state, shapes, scratch = world.state, world.shapes, world.scratch
    if scratch.n_candidates[0] == 0:
        return 0
    softening = world.settings.stiffness_scale * step
    found, tissue = 0, largest_tissue_speed(state)
    for index in range(scratch.n_candidates[0]):
        entry = scratch.candidates[index]
        body = state.contacts.body[entry]
        pressed = state.contact_pressed[0, entry]
        if pressed == 0.0:
            # The contact moves a compliant tool, too.
            speed = tissue if scratch.give[body] == 0.0 else FAST
            scratch.candidate_gap[index] -= step * (scratch.candidate_speed[index] + speed)
            if scratch.candidate_gap[index] >= NEAR:
                continue
        near = False
        if state.bodies[body].engaged and not state.bodies[body].cutting and found < len(scratch.active):
            contact = scratch.active[found]
            contact.entry, contact.body = entry, body
            gap = place_tool(state, shapes, scratch, contact)
            scratch.candidate_gap[index] = gap
            normal = contact.normal
            outside = gap < NEAR and is_on_outer_side(state, entry, (normal[0], normal[1], normal[2]))
            near = pressed > 0.0 or outside
        if not near:
            state.contact_pressed[0, entry] = 0.0
            state.contact_held[0, entry] = 0.0
            continue
        contact = scratch.active[found]
        contact.response = take_nodes(state, scratch.mobility, contact) * step + scratch.give[body]
        set_local_compliance(state, contact, softening, relaxation_stiffening(world, contact))
        limit_recovery_speed(state, scratch, contact, gap, step)
        given = spread and pressed > 0.0
        normal, last_held = contact.normal, state.contact_held[1 if given else 0, entry]
        along = last_held[0] * normal[0] + last_held[1] * normal[1] + last_held[2] * normal[2]
        for c in range(3):
            contact.held[c] = last_held[c] - along * normal[c]
        contact.pressed = along if given else pressed
        note_yielding(state, contact)
        found += 1
    return found


@inner
def relaxation_stiffening(world: World, contact: ActiveContact) -> float:
    """Return the present stiffness of tissue around an active contact relative to relaxed tissue; 1 for elastic tissue.

    All moduli relax alike. So this is the factor by which its nodes' forces on the tool exceed their elastic ones, and
    the force on a held tool decreases by the tissue's fraction.
    """
    state = world.state
    if len(state.relaxing) == 0:
        return 1.0
    most = 1.0 + world.model.relaxation[1]
    elastic = unrelaxed = 0.0
    for c in range(contact.nodes):
        node = contact.node[c]
        for axis in range(3):
            along = contact.weight[c] * contact.normal[axis]
            elastic -= along * state.last_elastic[node, axis]
            unrelaxed -= along * state.unrelaxed[node, axis]
    if elastic <= 0.0:  # the point has just been touched
        return most
    return min(max(1.0 + unrelaxed / elastic, 1.0), most)


@inner
def set_local_compliance(state: State, contact: ActiveContact, scale: float, stiffer: float) -> None:
    """Set the compliances and stiffnesses of an active contact.

    scale: stiffness scale times the step, s; stiffer: of `relaxation_stiffening`. The compliance across the normal is
    that of relaxed tissue: the yielding there is computed from the impulse alone, and would otherwise grow as the
    tissue relaxes.
    """
    compliance = state.contacts.compliance[contact.entry]
    contact.compliance = compliance[0] / (scale * stiffer) if scale > 0.0 else 0.0
    contact.compliance_across = compliance[1] / scale if scale > 0.0 else 0.0
    whole, across = contact.response + contact.compliance, contact.response + contact.compliance_across
    contact.stiffness = 1.0 / whole if whole > 0.0 else 0.0
    contact.stiffness_across = 1.0 / across if across > 0.0 else 0.0


@inner
def note_yielding(state: State, contact: ActiveContact) -> None:
    """Write the yielding of tissue between nodes across the normal, which follows from the impulse held there."""
    held, soft, most = contact.held, contact.compliance_across, state.contacts.most_give[contact.entry]
    size = soft * math.sqrt(held[0] * held[0] + held[1] * held[1] + held[2] * held[2])
    back = soft if size <= most else soft * most / size
    for c in range(3):
        contact.yielded[c] = back * held[c]


@inner
def take_nodes(state: State, mobility: Floats, contact: ActiveContact) -> float:
    """Copy the nodes, weights and mobilities of a contact point side by side; return its own mobility, 1/kg."""
    contact.nodes = nodes_of(state.contacts, contact.entry)
    mobile = 0.0
    for c in range(3):
        mobile = take_node(state, mobility, contact, c, mobile)
    if contact.nodes > 3:  # a separate branch, as three nodes are faster
        mobile = take_node(state, mobility, contact, 3, mobile)
    return mobile


@inner
def take_node(state: State, mobility: Floats, contact: ActiveContact, c: int, mobile: float) -> float:
    """Copy a node of a contact point with its weight and mobility; return the point's own, 1/kg, with this node's."""
    entry = np.uint64(contact.entry)
    node, weight = np.uint64(state.contacts.node[entry, c]), state.contacts.weight[entry, c]
    moved = weight * mobility[node]
    contact.node[c], contact.weight[c], contact.mobility[c] = node, weight, moved
    return mobile + weight * moved


@inner
def place_tool(state: State, shapes: Shapes, scratch: Scratch, contact: ActiveContact) -> float:
    """Write the tool's normal, offset, arm and motion at an active contact; return the gap, m."""
    body = contact.body
    x, y, z, lx, ly, lz = point_in_body(state, contact.entry, scratch.origin, scratch.rotation)
    gap, nx, ny, nz = gap_and_normal(shapes, body, scratch.rotation[body], lx, ly, lz)
    origin, last, q = scratch.origin[body], scratch.last_origin[body], scratch.last_rotation[body]
    normal, motion, arm = contact.normal, contact.tool_motion, contact.arm
    normal[0], normal[1], normal[2] = nx, ny, nz
    contact.offset = nx * (x - origin[0]) + ny * (y - origin[1]) + nz * (z - origin[2]) - gap
    motion[0] = x - last[0] - (q[0] * lx + q[1] * ly + q[2] * lz) - origin[0]
    motion[1] = y - last[1] - (q[3] * lx + q[4] * ly + q[5] * lz) - origin[1]
    motion[2] = z - last[2] - (q[6] * lx + q[7] * ly + q[8] * lz) - origin[2]
    arm[0], arm[1], arm[2] = x - origin[0], y - origin[1], z - origin[2]
    return gap


@inner
def limit_recovery_speed(state: State, scratch: Scratch, contact: ActiveContact, gap: float, step: float) -> None:
    """Move a contact point out gradually that was inside its tool before this substep, s; gap m at its end.

    Tissue can close around a released tool. If a point were pushed out at once, its speed would be larger the shorter
    the substep is. The yielding of tissue under the last force doesn't count as such a depth.
    """
    entry, normal, origin = contact.entry, contact.normal, scratch.origin[contact.body]
    given = min(contact.compliance * state.contact_pressed[0, entry], state.contacts.most_give[entry])
    approach = 0.0
    for c in range(3):
        approach = without_approach(state, contact, c, step, approach)
    if contact.nodes > 3:
        approach = without_approach(state, contact, 3, step, approach)
    for axis in range(3):
        approach += normal[axis] * (contact.tool_motion[axis] + origin[axis])
    contact.offset -= max(0.0, -gap - approach - given - step * RECOVERY_SPEED)


@inner
def without_approach(state: State, contact: ActiveContact, c: int, step: float, approach: float) -> float:
    """Return an approach of tool and tissue, m, minus the displacement of a contact point's node in a substep, s."""
    node, weight, normal = np.uint64(contact.node[c]), contact.weight[c], contact.normal
    for axis in range(3):
        approach -= normal[axis] * weight * step * state.velocity[node, axis]
    return approach


@inner
def whole_impulse(contact: ActiveContact) -> tuple[float, float, float]:
    """Return the impulse on an active contact in this substep, N s."""
    normal, pressed, held = contact.normal, contact.pressed, contact.held
    return pressed * normal[0] + held[0], pressed * normal[1] + held[1], pressed * normal[2] + held[2]


@kernel
def place_again(state: State, shapes: Shapes, scratch: Scratch, contact: ActiveContact, step: float) -> None:
    """Update the tool's surface at an active contact's present place, and split its impulse along the new normal."""
    px, py, pz = whole_impulse(contact)
    limit_recovery_speed(state, scratch, contact, place_tool(state, shapes, scratch, contact), step)
    normal, held = contact.normal, contact.held
    pressed = max(0.0, px * normal[0] + py * normal[1] + pz * normal[2])
    contact.pressed = pressed
    held[0], held[1], held[2] = px - pressed * normal[0], py - pressed * normal[1], pz - pressed * normal[2]
    note_yielding(state, contact)
