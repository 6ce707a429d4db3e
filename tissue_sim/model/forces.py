"""Forces of the hybrid elastic model, added to `force` (n, 3) N at `position` (n, 3) m."""

from __future__ import annotations

import math
from typing import Any

from tissue_sim.jit import kernel


@kernel
def spring_forces(position: Any, first: Any, second: Any, rest_length: Any, stiffness: Any, force: Any) -> None:
    """Axial springs, equation (1): f = k (l - l0) along the spring, geometrically nonlinear.

    first, second (s,) nodes; rest_length (s,) m; stiffness (s,) N/m.
    """
    for s in range(len(first)):
        i, j = first[s], second[s]
        dx = position[j, 0] - position[i, 0]
        dy = position[j, 1] - position[i, 1]
        dz = position[j, 2] - position[i, 2]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        # A spring of no length has no direction; it pushes again as soon as it has one.
        scale = stiffness[s] * (1.0 - rest_length[s] / max(length, 1e-12))
        force[i, 0] += scale * dx
        force[i, 1] += scale * dy
        force[i, 2] += scale * dz
        force[j, 0] -= scale * dx
        force[j, 1] -= scale * dy
        force[j, 2] -= scale * dz


@kernel
def angular_forces(
    position: Any, nodes: Any, weight: Any, rest: Any, stiffness: Any, least_area: Any, force: Any
) -> None:
    """Angular springs between the two triangles at each edge: energy k/2 (s - s0)^2.

    s = n.(w_i x_i + w_j x_j + w_k x_k + w_l x_l), n the unit normal of the pair, is the edge's length
    times the angle between the triangles to first order, signed: positive where convex (the
    mean curvature normal of Bergou et al. 2006). Its stiffness stays what it is at rest when
    triangles are squeezed; an angle's grows without bound and makes any step too long. A spring
    on the cosine between two arms (Nedel & Thalmann 1998) has hardly a slope where the surface is flat.
    nodes (h, 4): edge i, j and the opposite corners k, l; weight (h, 4); rest (h,) m; stiffness (h,) N/m;
    least_area (h,) m^4 bounds the squared length of the unnormalised normal from below.
    """
    for h in range(len(nodes)):
        i, j, k, m = nodes[h, 0], nodes[h, 1], nodes[h, 2], nodes[h, 3]
        wi, wj, wk, wm = weight[h, 0], weight[h, 1], weight[h, 2], weight[h, 3]
        bx = wi * position[i, 0] + wj * position[j, 0] + wk * position[k, 0] + wm * position[m, 0]
        by = wi * position[i, 1] + wj * position[j, 1] + wk * position[k, 1] + wm * position[m, 1]
        bz = wi * position[i, 2] + wj * position[j, 2] + wk * position[k, 2] + wm * position[m, 2]
        ex, ey, ez = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1], position[j, 2] - position[i, 2]
        dx, dy, dz = position[k, 0] - position[m, 0], position[k, 1] - position[m, 1], position[k, 2] - position[m, 2]
        nx, ny, nz = ey * dz - ez * dy, ez * dx - ex * dz, ex * dy - ey * dx
        square = nx * nx + ny * ny + nz * nz
        inverse = 1.0 / math.sqrt(max(square, least_area[h]))
        nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
        bent = bx * nx + by * ny + bz * nz
        push = -stiffness[h] * (bent - rest[h])
        # Turning of the normal; a collapsed pair has none, and only the length of n counts there.
        along = bent if square > least_area[h] else 0.0
        gx, gy, gz = (bx - along * nx) * inverse, (by - along * ny) * inverse, (bz - along * nz) * inverse
        px, py, pz = push * nx, push * ny, push * nz
        ax, ay, az = push * (dy * gz - dz * gy), push * (dz * gx - dx * gz), push * (dx * gy - dy * gx)
        cx, cy, cz = push * (gy * ez - gz * ey), push * (gz * ex - gx * ez), push * (gx * ey - gy * ex)
        force[i, 0] += wi * px - ax
        force[i, 1] += wi * py - ay
        force[i, 2] += wi * pz - az
        force[j, 0] += wj * px + ax
        force[j, 1] += wj * py + ay
        force[j, 2] += wj * pz + az
        force[k, 0] += wk * px + cx
        force[k, 1] += wk * py + cy
        force[k, 2] += wk * pz + cz
        force[m, 0] += wm * px - cx
        force[m, 1] += wm * py - cy
        force[m, 2] += wm * pz - cz


@kernel
def return_forces(position: Any, rest: Any, nodes: Any, stiffness: Any, force: Any) -> None:
    """Return springs of zero rest length towards the rest position: f = k (x0 - x).

    nodes (r,) the nodes that have one; rest (n, 3) m; stiffness (n,) N/m.
    """
    for index in range(len(nodes)):
        i = nodes[index]
        force[i, 0] += stiffness[i] * (rest[i, 0] - position[i, 0])
        force[i, 1] += stiffness[i] * (rest[i, 1] - position[i, 1])
        force[i, 2] += stiffness[i] * (rest[i, 2] - position[i, 2])
