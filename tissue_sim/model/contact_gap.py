"""Where contact points lie: in the organ's frame, in their tool's, and how far from it."""

from __future__ import annotations

import math
from typing import Any

from tissue_sim.jit import kernel
from tissue_sim.model.shapes import signed_distance

INNER_SIDE = 0.3  # cosine between the tool's and the tissue's normal; -1 for a face-on touch from outside


@kernel
def point_in_body(
    state: Any, entry: int, origin: Any, rotation: Any
) -> tuple[float, float, float, float, float, float]:
    """Contact point of an entry, in the organ's frame and in its tool's frame (m).

    origin (T, 3), rotation (T, 9) of the tools.
    """
    body = state.contacts.body[entry]
    x = y = z = 0.0
    for c in range(3):
        node, weight = state.contacts.node[entry, c], state.contacts.weight[entry, c]
        x += weight * state.position[node, 0]
        y += weight * state.position[node, 1]
        z += weight * state.position[node, 2]
    r = rotation[body]
    dx, dy, dz = x - origin[body, 0], y - origin[body, 1], z - origin[body, 2]
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
    body = state.contacts.body[entry]
    _, _, _, lx, ly, lz = point_in_body(state, entry, origin, rotation)
    gap, nx, ny, nz = gap_and_normal(shapes, body, rotation[body], lx, ly, lz)
    normal = state.contacts.normal[entry]
    facing = normal[0] * nx
    facing += normal[1] * ny
    facing += normal[2] * nz
    return gap if facing < INNER_SIDE else math.inf


@kernel
def is_touched(state: Any, shapes: Any, origin: Any, rotation: Any) -> bool:
    """True when any contact point lies inside its tool."""
    for entry in range(state.contacts.header.points):
        body = state.contacts.body[entry]
        if state.bodies[body].engaged:
            if gap_from_outside(state, shapes, entry, origin, rotation) < 0.0:
                return True
    return False


@kernel
def gap_and_normal(
    shapes: Any, body: int, r: Any, lx: float, ly: float, lz: float
) -> tuple[float, float, float, float]:
    """Signed distance, m, of a point in a tool's frame to it, and the tool's outward normal in the organ's frame.

    r (9,): the tool's rotation.
    """
    gap, mx, my, mz = signed_distance(shapes, body, lx, ly, lz)
    return (
        gap,
        r[0] * mx + r[1] * my + r[2] * mz,
        r[3] * mx + r[4] * my + r[5] * mz,
        r[6] * mx + r[7] * my + r[8] * mz,
    )
