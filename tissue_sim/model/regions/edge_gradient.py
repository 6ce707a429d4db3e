"""Displacement gradient at the edge of a modal region, which determines when the whole model moves instead."""

from __future__ import annotations

import math

from tissue_sim.jit import kernel
from tissue_sim.model.data.model import Model
from tissue_sim.model.data.scratch import Scratch
from tissue_sim.model.data.state import State

FLAT = 1e-3  # least squared extent in each direction, relative to the largest: across a plane edge it is undetermined


@kernel
def edge_gradient(model: Model, state: State, scratch: Scratch) -> float:
    """Return the Frobenius norm of the displacement gradient at a modal region's edge.

    It is that of the linear fit to the displacements that move_edge found. Linear displacements follow a straight line
    instead of an arc, with a relative error of about this gradient.

    Parameters
    ----------
    model : Model
        Constants of the model.
    state : State
        State of the simulation.
    scratch : Scratch
        Working memory.
    """
    count, nodes, moved, rest = state.status.region_boundary, scratch.boundary_node, scratch.edge_move, model.rest
    mean_x = mean_y = mean_z = 0.0
    for b in range(count):
        node = nodes[b]
        mean_x += rest[node, 0] / count
        mean_y += rest[node, 1] / count
        mean_z += rest[node, 2] / count
    xx = yy = zz = xy = yz = zx = 0.0
    ux = uy = uz = vx = vy = vz = wx = wy = wz = 0.0
    for b in range(count):
        node = nodes[b]
        x, y, z = rest[node, 0] - mean_x, rest[node, 1] - mean_y, rest[node, 2] - mean_z
        u, v, w = moved[3 * b], moved[3 * b + 1], moved[3 * b + 2]
        xx, yy, zz, xy, yz, zx = xx + x * x, yy + y * y, zz + z * z, xy + x * y, yz + y * z, zx + z * x
        ux, uy, uz = ux + u * x, uy + u * y, uz + u * z
        vx, vy, vz = vx + v * x, vy + v * y, vz + v * z
        wx, wy, wz = wx + w * x, wy + w * y, wz + w * z
    flat = FLAT * (xx + yy + zz)
    xx, yy, zz = xx + flat, yy + flat, zz + flat
    ax, ay, az = yy * zz - yz * yz, zx * yz - xy * zz, xy * yz - zx * yy
    by, bz, cz = xx * zz - zx * zx, zx * xy - xx * yz, xx * yy - xy * xy
    determinant = xx * ax + xy * ay + zx * az
    if not determinant > 0.0:  # no edge
        return 0.0
    square = 0.0
    for x, y, z in ((ux, uy, uz), (vx, vy, vz), (wx, wy, wz)):
        p, q, r = ax * x + ay * y + az * z, ay * x + by * y + bz * z, az * x + bz * y + cz * z
        square += p * p + q * q + r * r
    return math.sqrt(square) / determinant
