"""Contact of the tissue with rigid tools: non-penetration and Coulomb friction as constraints.

A contact point is a weighted sum of up to three nodes. After each substep every point that ended
inside a tool is moved onto it, and held against sliding within the friction cone. The force is
what the constraint costs, so it is equal and opposite by construction and stable at any stiffness.
"""

from __future__ import annotations

import math
from typing import Any

from tissue_sim.jit import kernel
from tissue_sim.model.shapes import signed_distance
from tissue_sim.model.state import ENGAGED, ENTRIES, MODAL, REGION

INNER_SIDE = 0.3  # cosine between the tool's and the tissue's normal; -1 for a face-on touch from outside
NEAR = 5e-5  # m: points that close may come to touch while others are resolved
MOST_NEAR = 256  # contact points resolved in a substep


@kernel
def point_in_tool(
    state: Any, entry: int, origin: Any, rotation: Any
) -> tuple[float, float, float, float, float, float]:
    """Contact point of an entry, in the organ's frame and in its tool's frame (m).

    origin (T, 3), rotation (T, 9) of the tools.
    """
    tool = state.contact_tool[entry]
    x = y = z = 0.0
    for c in range(3):
        node, weight = state.contact_node[entry, c], state.contact_weight[entry, c]
        x += weight * state.position[node, 0]
        y += weight * state.position[node, 1]
        z += weight * state.position[node, 2]
    r = rotation[tool]
    dx, dy, dz = x - origin[tool, 0], y - origin[tool, 1], z - origin[tool, 2]
    return (
        x,
        y,
        z,
        r[0] * dx + r[3] * dy + r[6] * dz,
        r[1] * dx + r[4] * dy + r[7] * dz,
        r[2] * dx + r[5] * dy + r[8] * dz,
    )


@kernel
def gap_from_outside(state: Any, shapes: Any, entry: int, origin: Any, rotation: Any) -> float:
    """Signed distance, m, of a contact point to its tool; infinite where the tool is on its inner side.

    Tissue is pushed from outside only: a tool that came to lie inside leaves without hooking it.
    """
    tool = state.contact_tool[entry]
    _, _, _, lx, ly, lz = point_in_tool(state, entry, origin, rotation)
    gap, mx, my, mz = signed_distance(shapes, tool, lx, ly, lz)
    r, normal = rotation[tool], state.contact_normal[entry]
    facing = normal[0] * (r[0] * mx + r[1] * my + r[2] * mz)
    facing += normal[1] * (r[3] * mx + r[4] * my + r[5] * mz)
    facing += normal[2] * (r[6] * mx + r[7] * my + r[8] * mz)
    return gap if facing < INNER_SIDE else math.inf


@kernel
def is_touched(state: Any, shapes: Any, origin: Any, rotation: Any) -> bool:
    """True when any contact point lies inside its tool."""
    for entry in range(state.count[ENTRIES]):
        tool = state.contact_tool[entry]
        if state.tool_count[tool, ENGAGED] == 1:
            if gap_from_outside(state, shapes, entry, origin, rotation) < 0.0:
                return True
    return False


@kernel
def gather_contacts(state: Any, shapes: Any, origin: Any, rotation: Any, scratch: Any) -> int:
    """List the entries that touch or nearly touch in scratch.near_entry, their impulses zeroed.

    Returns how many; when more come close than the list holds, the first ones are kept.
    """
    found = 0
    for entry in range(state.count[ENTRIES]):
        tool = state.contact_tool[entry]
        if state.tool_count[tool, ENGAGED] == 0:
            continue
        if gap_from_outside(state, shapes, entry, origin, rotation) < NEAR and found < len(scratch.near_entry):
            scratch.near_entry[found] = entry
            scratch.near_normal[found] = 0.0
            for c in range(3):
                scratch.near_tangent[found, c] = 0.0
            found += 1
    return found


@kernel
def resolve_contacts(
    state: Any, shapes: Any, mobility: Any, scratch: Any, friction: float, step: float, iterations: int
) -> int:
    """Keep every contact point out of its tool; returns how many touched.

    Projected Gauss-Seidel on accumulated impulses: a point pushed too far by its neighbours is let
    back, so that points sharing nodes settle on one distribution of force instead of taking turns.
    scratch.origin (T, 3), scratch.rotation (T, 9) are the tools at the substep's end, last_* at its
    beginning; mobility (n,) 1/kg is the velocity that an impulse gives a node; step s. Adds to
    scratch.impulse (T, 6) what acts on the tissue, N s, and its moment
    about the tool's origin, N m s.
    """
    found = gather_contacts(state, shapes, scratch.origin, scratch.rotation, scratch)
    for _ in range(iterations if found > 1 else min(found, 1)):
        for near in range(found):
            resolve_contact(state, shapes, mobility, scratch, near, friction, step)
    touching = 0
    for near in range(found):
        if scratch.near_normal[near] > 0.0:
            touching += 1
    return touching


@kernel
def resolve_contact(
    state: Any, shapes: Any, mobility: Any, scratch: Any, near: int, friction: float, step: float
) -> None:
    """One contact point: no penetration, and no sliding within the friction cone."""
    entry = scratch.near_entry[near]
    tool = state.contact_tool[entry]
    compliance = 0.0
    for c in range(3):
        weight = state.contact_weight[entry, c]
        compliance += weight * weight * mobility[state.contact_node[entry, c]]
    if compliance == 0.0:
        return
    origin = scratch.origin
    x, y, z, lx, ly, lz = point_in_tool(state, entry, origin, scratch.rotation)
    gap, mx, my, mz = signed_distance(shapes, tool, lx, ly, lz)
    pressed = scratch.near_normal[near]
    normal = max(0.0, pressed - gap / (compliance * step))
    if normal == 0.0 and pressed == 0.0:
        return
    r = scratch.rotation[tool]
    nx = r[0] * mx + r[1] * my + r[2] * mz
    ny = r[3] * mx + r[4] * my + r[5] * mz
    nz = r[6] * mx + r[7] * my + r[8] * mz
    scratch.near_normal[near] = normal
    # Sliding of the tissue along the tool in this substep: its own motion less the tool's.
    q = scratch.last_rotation[tool]
    sx = scratch.last_origin[tool, 0] + q[0] * lx + q[1] * ly + q[2] * lz - x
    sy = scratch.last_origin[tool, 1] + q[3] * lx + q[4] * ly + q[5] * lz - y
    sz = scratch.last_origin[tool, 2] + q[6] * lx + q[7] * ly + q[8] * lz - z
    for c in range(3):
        node, weight = state.contact_node[entry, c], state.contact_weight[entry, c] * step
        sx += weight * state.velocity[node, 0]
        sy += weight * state.velocity[node, 1]
        sz += weight * state.velocity[node, 2]
    along = sx * nx + sy * ny + sz * nz
    held = scratch.near_tangent[near]
    tx = held[0] - (sx - along * nx) / (compliance * step)
    ty = held[1] - (sy - along * ny) / (compliance * step)
    tz = held[2] - (sz - along * nz) / (compliance * step)
    size = math.sqrt(tx * tx + ty * ty + tz * tz)
    share = 1.0 if size <= friction * normal else friction * normal / size
    px = (normal - pressed) * nx + share * tx - held[0]
    py = (normal - pressed) * ny + share * ty - held[1]
    pz = (normal - pressed) * nz + share * tz - held[2]
    held[0], held[1], held[2] = share * tx, share * ty, share * tz
    for c in range(3):
        node = state.contact_node[entry, c]
        move = state.contact_weight[entry, c] * mobility[node]
        if state.count[REGION] == MODAL:
            state.contact_impulse[node, 0] += state.contact_weight[entry, c] * px
            state.contact_impulse[node, 1] += state.contact_weight[entry, c] * py
            state.contact_impulse[node, 2] += state.contact_weight[entry, c] * pz
        state.velocity[node, 0] += move * px
        state.velocity[node, 1] += move * py
        state.velocity[node, 2] += move * pz
        state.position[node, 0] += step * move * px
        state.position[node, 1] += step * move * py
        state.position[node, 2] += step * move * pz
    ax, ay, az = x - origin[tool, 0], y - origin[tool, 1], z - origin[tool, 2]
    impulse = scratch.impulse[tool]
    impulse[0] += px
    impulse[1] += py
    impulse[2] += pz
    impulse[3] += ay * pz - az * py
    impulse[4] += az * px - ax * pz
    impulse[5] += ax * py - ay * px
