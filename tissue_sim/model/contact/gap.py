"""Places of contact points in the frames of organ and tool, and their distance from the tool."""

from __future__ import annotations

import math

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.jit import inner, kernel
from tissue_sim.model.contact.shapes import signed_distance
from tissue_sim.model.data.shapes import Shapes
from tissue_sim.model.data.state import State

INNER_SIDE = 0.3  # cosine between the tool's and the tissue's normal, which is -1 for a frontal touch from outside


@inner
def point_in_body(
    state: State, entry: int, origin: Floats, rotation: Floats
) -> tuple[float, float, float, float, float, float]:
    """Return a contact point in the organ's frame and in its tool's frame.

    Parameters
    ----------
    state : State
        State of the simulation.
    entry : int
        Index of the contact point in the contact set.
    origin : Floats, shape (T, 3), m
        Origins of the tools.
    rotation : Floats, shape (T, 9)
        Rotations of the tools.

    Returns
    -------
    tuple[float, float, float, float, float, float], m
        Three coordinates in the organ's frame, then three in the tool's.
    """
    at = np.uint64(entry)  # unsigned indices need no check for negative ones
    body = np.uint64(state.contacts.body[at])
    x = y = z = 0.0
    for c in range(3):
        node, weight = np.uint64(state.contacts.node[at, c]), state.contacts.weight[at, c]
        x += weight * state.position[node, 0]
        y += weight * state.position[node, 1]
        z += weight * state.position[node, 2]
    last = state.contacts.weight[at, 3]
    if last != 0.0:  # a separate branch, as three nodes are faster
        node = np.uint64(state.contacts.node[at, 3])
        x += last * state.position[node, 0]
        y += last * state.position[node, 1]
        z += last * state.position[node, 2]
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
def gap_from_outside(state: State, shapes: Shapes, entry: int, origin: Floats, rotation: Floats) -> float:
    """Return the signed distance, m, of a contact point to its tool; infinite where the tool is on its inner side.

    Tissue is pushed from outside only: a tool that is inside leaves without dragging it along.
    """
    body = state.contacts.body[entry]
    _, _, _, lx, ly, lz = point_in_body(state, entry, origin, rotation)
    gap, nx, ny, nz = gap_and_normal(shapes, body, rotation[body], lx, ly, lz)
    return gap if is_on_outer_side(state, entry, (nx, ny, nz)) else math.inf


@inner
def is_on_outer_side(state: State, entry: int, normal: tuple[float, float, float]) -> bool:
    """Return whether the tool, by its outward normal at a contact point, is on the tissue's outer side."""
    outward = state.contacts.normal[entry]
    facing = outward[0] * normal[0]
    facing += outward[1] * normal[1]
    facing += outward[2] * normal[2]
    return facing < INNER_SIDE


@kernel
def is_touched(state: State, shapes: Shapes, origin: Floats, rotation: Floats) -> bool:
    """Return whether any contact point lies inside its tool.

    Parameters
    ----------
    state : State
        State of the simulation.
    shapes : Shapes
        Shapes of the bodies.
    origin : Floats, shape (T, 3), m
        Origins of the tools.
    rotation : Floats, shape (T, 9)
        Rotations of the tools.
    """
    for entry in range(state.contacts.header.points):
        body = state.contacts.body[entry]
        if state.bodies[body].engaged:
            if gap_from_outside(state, shapes, entry, origin, rotation) < 0.0:
                return True
    return False


@inner
def gap_and_normal(
    shapes: Shapes, body: int, r: Floats, lx: float, ly: float, lz: float
) -> tuple[float, float, float, float]:
    """Return the signed distance of a point from a tool, and the tool's outward normal there.

    Parameters
    ----------
    shapes : Shapes
        Shapes of the bodies.
    body : int
        Index of the body.
    r : Floats, shape (9,)
        Rotation of the tool.
    lx, ly, lz : float, m
        The point in the tool's frame.

    Returns
    -------
    tuple[float, float, float, float]
        Distance, m, and normal in the organ's frame.
    """
    gap, mx, my, mz = signed_distance(shapes, body, lx, ly, lz)
    return (
        gap,
        r[0] * mx + r[1] * my + r[2] * mz,
        r[3] * mx + r[4] * my + r[5] * mz,
        r[6] * mx + r[7] * my + r[8] * mz,
    )
