"""Forces of the hybrid elastic model, added to `force` (n, 3) N at `position` (n, 3) m.

Springs are in blocks of equal length, with constants in rows (see blocks): the data of a block is gathered, processed
and scattered in three short loops, the middle one of which the compiler vectorises to four springs at a time.
"""

from __future__ import annotations

import math

from tissue_sim.array_types import Floats, Ints
from tissue_sim.handles import has
from tissue_sim.jit import chosen, kernel
from tissue_sim.model.data.blocks import BLOCK
from tissue_sim.model.data.model import Model
from tissue_sim.model.elasticity.cell_groups import cell_forces

# Fraction of a spring's rest length below which its force decreases to zero, where its ends meet. With equation (1)
# alone it reverses there by twice its largest value: no step is short enough for that, and energy is created.
SHORTEST = 0.2


@kernel
def stored(stretch: float) -> float:
    """Return the energy of a spring, the integral of its force in spring_forces.

    Parameters
    ----------
    stretch : float
        Length over rest length.

    Returns
    -------
    float
        Energy over k l0^2.
    """
    strain = max(stretch, SHORTEST) - 1.0
    total = 0.5 * strain * strain
    if stretch < SHORTEST:  # there the force is proportional to the length
        total -= 0.5 * (1.0 / SHORTEST - 1.0) * (stretch * stretch - SHORTEST * SHORTEST)
    return total


@kernel
def spring_forces(position: Floats, nodes: Ints, constants: Floats, work: Floats, force: Floats) -> None:
    """Add axial springs, equation (1): f = k (l - l0) along the spring, geometrically nonlinear.

    Shorter lengths count as SHORTEST l0.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    nodes : Ints, shape (b, BLOCK, 2)
        Node indices.
    constants : Floats, shape (b, 2 BLOCK)
        Inverse rest lengths, 1/m, then stiffnesses, N/m.
    work : Floats, shape (9 BLOCK,)
        Buffer.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.
    """
    for block in range(len(nodes)):
        ends, constant = nodes[block], constants[block]
        _gather_ends(position, ends, work)
        for s in range(BLOCK):
            x, y, z = work[s], work[BLOCK + s], work[2 * BLOCK + s]
            stretch = math.sqrt(x * x + y * y + z * z) * constant[s]
            stretch = stretch if stretch > SHORTEST else SHORTEST
            pull = constant[BLOCK + s] * (1.0 - 1.0 / stretch)
            work[s], work[BLOCK + s], work[2 * BLOCK + s] = pull * x, pull * y, pull * z
        _scatter_ends(work, ends, force)


@kernel
def _gather_ends(position: Floats, ends: Ints, work: Floats) -> None:
    """Gather the vectors from the first to the second node of each spring."""
    for s in range(BLOCK):
        i, j = ends[s, 0], ends[s, 1]
        work[s] = position[j, 0] - position[i, 0]
        work[BLOCK + s] = position[j, 1] - position[i, 1]
        work[2 * BLOCK + s] = position[j, 2] - position[i, 2]


@kernel
def _scatter_ends(work: Floats, ends: Ints, force: Floats) -> None:
    """Add the forces of a block to the first nodes, and their opposite to the second."""
    for s in range(BLOCK):
        i, j = ends[s, 0], ends[s, 1]
        x, y, z = work[s], work[BLOCK + s], work[2 * BLOCK + s]
        force[i, 0] += x
        force[i, 1] += y
        force[i, 2] += z
        force[j, 0] -= x
        force[j, 1] -= y
        force[j, 2] -= z


@kernel
def edge_forces(position: Floats, nodes: Ints, constants: Floats, work: Floats, force: Floats) -> None:
    """Add edges between two triangles: the axial spring along the edge, and the angular spring across it.

    Angular springs have the energy k/2 (s - s0)^2. s = n.(w_i x_i + w_j x_j + w_k x_k + w_l x_l), n the unit normal of
    the pair, is the edge's length times the angle between the triangles to first order, signed: positive where convex.
    Its stiffness remains that at rest when triangles are compressed; that of a spring on the angle grows without bound,
    which makes any step too long. A spring on the cosine between two arms (Nedel & Thalmann 1998) has hardly any
    gradient where the surface is flat.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    nodes : Ints, shape (b, BLOCK, 4)
        Edge i, j and the opposite corners k, l.
    constants : Floats, shape (b, 8 BLOCK)
        Weights of j, k, l (that of i makes their sum zero), s0, m, stiffness, N/m, the least squared length of the
        unnormalised normal, m^4, and inverse rest length, 1/m, and stiffness, N/m, of the axial spring.
    work : Floats, shape (9 BLOCK,)
        Buffer.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.

    References
    ----------
    Bergou et al. 2006: A quadratic bending model for inextensible surfaces.
    """
    for block in range(len(nodes)):
        ends = nodes[block]
        _gather_arms(position, ends, work)
        _bend_and_stretch(work, constants[block])
        _scatter_arms(work, ends, force)


@kernel
def _gather_arms(position: Floats, ends: Ints, work: Floats) -> None:
    """Gather the vectors from node i of each edge to its nodes j, k and l."""
    for e in range(BLOCK):
        i, j, k, m = ends[e, 0], ends[e, 1], ends[e, 2], ends[e, 3]
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        work[e] = position[j, 0] - x
        work[BLOCK + e] = position[j, 1] - y
        work[2 * BLOCK + e] = position[j, 2] - z
        work[3 * BLOCK + e] = position[k, 0] - x
        work[4 * BLOCK + e] = position[k, 1] - y
        work[5 * BLOCK + e] = position[k, 2] - z
        work[6 * BLOCK + e] = position[m, 0] - x
        work[7 * BLOCK + e] = position[m, 1] - y
        work[8 * BLOCK + e] = position[m, 2] - z


@kernel
def _bend_and_stretch(work: Floats, constant: Floats) -> None:
    """Replace the arms of a block by the forces on j, k and l."""
    for e in range(BLOCK):
        ex, ey, ez = work[e], work[BLOCK + e], work[2 * BLOCK + e]
        kx, ky, kz = work[3 * BLOCK + e], work[4 * BLOCK + e], work[5 * BLOCK + e]
        mx, my, mz = work[6 * BLOCK + e], work[7 * BLOCK + e], work[8 * BLOCK + e]
        wj, wk, wm = constant[e], constant[BLOCK + e], constant[2 * BLOCK + e]
        bx = wj * ex + wk * kx + wm * mx
        by = wj * ey + wk * ky + wm * my
        bz = wj * ez + wk * kz + wm * mz
        dx, dy, dz = kx - mx, ky - my, kz - mz
        nx, ny, nz = ey * dz - ez * dy, ez * dx - ex * dz, ex * dy - ey * dx
        square = nx * nx + ny * ny + nz * nz
        least = constant[5 * BLOCK + e]
        inverse = 1.0 / math.sqrt(square if square > least else least)
        nx, ny, nz = nx * inverse, ny * inverse, nz * inverse
        bent = bx * nx + by * ny + bz * nz
        push = -constant[4 * BLOCK + e] * (bent - constant[3 * BLOCK + e])
        # Rotation of the normal; it is left out for a collapsed pair, of which only the length of n counts.
        along = bent if square > least else 0.0
        turn = push * inverse
        gx, gy, gz = (bx - along * nx) * turn, (by - along * ny) * turn, (bz - along * nz) * turn
        px, py, pz = push * nx, push * ny, push * nz
        cx, cy, cz = gy * ez - gz * ey, gz * ex - gx * ez, gx * ey - gy * ex
        stretch = math.sqrt(ex * ex + ey * ey + ez * ez) * constant[6 * BLOCK + e]
        stretch = stretch if stretch > SHORTEST else SHORTEST
        pull = constant[7 * BLOCK + e] * (1.0 / stretch - 1.0)
        work[e] = wj * px + dy * gz - dz * gy + pull * ex
        work[BLOCK + e] = wj * py + dz * gx - dx * gz + pull * ey
        work[2 * BLOCK + e] = wj * pz + dx * gy - dy * gx + pull * ez
        work[3 * BLOCK + e] = wk * px + cx
        work[4 * BLOCK + e] = wk * py + cy
        work[5 * BLOCK + e] = wk * pz + cz
        work[6 * BLOCK + e] = wm * px - cx
        work[7 * BLOCK + e] = wm * py - cy
        work[8 * BLOCK + e] = wm * pz - cz


@kernel
def _scatter_arms(work: Floats, ends: Ints, force: Floats) -> None:
    """Add the forces of a block; node i gets the opposite of the others' sum."""
    for e in range(BLOCK):
        i, j, k, m = ends[e, 0], ends[e, 1], ends[e, 2], ends[e, 3]
        jx, jy, jz = work[e], work[BLOCK + e], work[2 * BLOCK + e]
        kx, ky, kz = work[3 * BLOCK + e], work[4 * BLOCK + e], work[5 * BLOCK + e]
        mx, my, mz = work[6 * BLOCK + e], work[7 * BLOCK + e], work[8 * BLOCK + e]
        force[i, 0] -= jx + kx + mx
        force[i, 1] -= jy + ky + my
        force[i, 2] -= jz + kz + mz
        force[j, 0] += jx
        force[j, 1] += jy
        force[j, 2] += jz
        force[k, 0] += kx
        force[k, 1] += ky
        force[k, 2] += kz
        force[m, 0] += mx
        force[m, 1] += my
        force[m, 2] += mz


@kernel
def subtract_linear_springs(position: Floats, nodes: Ints, slopes: Floats, work: Floats, force: Floats) -> None:
    """Subtract the forces that axial springs would have if they were linear about rest.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    nodes : Ints, shape (b, BLOCK, 2)
        Node indices.
    slopes : Floats, shape (b, 6 BLOCK)
        Vector from the first to the second node at rest, m, and its unit vector times the root of the stiffness.
    work : Floats, shape (9 BLOCK,)
        Buffer.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.
    """
    for block in range(len(nodes)):
        ends, slope = nodes[block], slopes[block]
        _gather_ends(position, ends, work)
        for s in range(BLOCK):
            tx, ty, tz = slope[3 * BLOCK + s], slope[4 * BLOCK + s], slope[5 * BLOCK + s]
            x, y = work[s] - slope[s], work[BLOCK + s] - slope[BLOCK + s]
            z = work[2 * BLOCK + s] - slope[2 * BLOCK + s]
            pull = tx * x + ty * y + tz * z
            work[s], work[BLOCK + s], work[2 * BLOCK + s] = -pull * tx, -pull * ty, -pull * tz
        _scatter_ends(work, ends, force)


@kernel
def subtract_linear_edges(position: Floats, nodes: Ints, slopes: Floats, work: Floats, force: Floats) -> None:
    """Subtract the forces that edges between two triangles would have if their springs were linear about rest.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    nodes : Ints, shape (b, BLOCK, 4)
        Edge i, j and the opposite corners k, l.
    slopes : Floats, shape (b, 21 BLOCK)
        Arms from node i to j, k, l at rest, m, the gradient of the curvature for j, k, l and the unit vector from i to
        j; the latter two are multiplied by the root of their stiffness.
    work : Floats, shape (9 BLOCK,)
        Buffer.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.
    """
    for block in range(len(nodes)):
        ends = nodes[block]
        _gather_arms(position, ends, work)
        _bend_and_stretch_linearly(work, slopes[block])
        _scatter_arms(work, ends, force)


@kernel
def _bend_and_stretch_linearly(work: Floats, slope: Floats) -> None:
    """Replace the arms of a block by the opposite of the linear forces on j, k and l."""
    for e in range(BLOCK):
        jx, jy, jz = work[e] - slope[e], work[BLOCK + e] - slope[BLOCK + e], work[2 * BLOCK + e] - slope[2 * BLOCK + e]
        kx, ky = work[3 * BLOCK + e] - slope[3 * BLOCK + e], work[4 * BLOCK + e] - slope[4 * BLOCK + e]
        kz, mx = work[5 * BLOCK + e] - slope[5 * BLOCK + e], work[6 * BLOCK + e] - slope[6 * BLOCK + e]
        my, mz = work[7 * BLOCK + e] - slope[7 * BLOCK + e], work[8 * BLOCK + e] - slope[8 * BLOCK + e]
        bent = slope[9 * BLOCK + e] * jx + slope[10 * BLOCK + e] * jy + slope[11 * BLOCK + e] * jz
        bent += slope[12 * BLOCK + e] * kx + slope[13 * BLOCK + e] * ky + slope[14 * BLOCK + e] * kz
        bent += slope[15 * BLOCK + e] * mx + slope[16 * BLOCK + e] * my + slope[17 * BLOCK + e] * mz
        tx, ty, tz = slope[18 * BLOCK + e], slope[19 * BLOCK + e], slope[20 * BLOCK + e]
        pull = tx * jx + ty * jy + tz * jz
        work[e] = bent * slope[9 * BLOCK + e] + pull * tx
        work[BLOCK + e] = bent * slope[10 * BLOCK + e] + pull * ty
        work[2 * BLOCK + e] = bent * slope[11 * BLOCK + e] + pull * tz
        work[3 * BLOCK + e] = bent * slope[12 * BLOCK + e]
        work[4 * BLOCK + e] = bent * slope[13 * BLOCK + e]
        work[5 * BLOCK + e] = bent * slope[14 * BLOCK + e]
        work[6 * BLOCK + e] = bent * slope[15 * BLOCK + e]
        work[7 * BLOCK + e] = bent * slope[16 * BLOCK + e]
        work[8 * BLOCK + e] = bent * slope[17 * BLOCK + e]


@kernel
def return_forces(position: Floats, rest: Floats, nodes: Ints, stiffness: Floats, force: Floats) -> None:
    """Add return springs of zero rest length towards the rest position: f = k (x0 - x).

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    rest : Floats, shape (n, 3), m
        Positions of the nodes at rest.
    nodes : Ints, shape (r,)
        Nodes that have a return spring.
    stiffness : Floats, shape (n,), N/m
        Stiffness at every node.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.
    """
    for index in range(len(nodes)):
        i = nodes[index]
        force[i, 0] += stiffness[i] * (rest[i, 0] - position[i, 0])
        force[i, 1] += stiffness[i] * (rest[i, 1] - position[i, 1])
        force[i, 2] += stiffness[i] * (rest[i, 2] - position[i, 2])


@kernel
def _of_cells(model: Model, position: Floats, scale: float, force: Floats) -> None:
    cell_forces(position, model.tissue, scale, force)


@kernel
def _of_springs(model: Model, position: Floats, scale: float, force: Floats) -> None:
    force[:] = 0.0
    edge_forces(position, model.edges.nodes, model.edges.constants, model.work, force)
    spring_forces(position, model.links.nodes, model.links.constants, model.work, force)
    return_forces(position, model.rest, model.return_nodes, model.return_stiffness, force)
    if scale != 1.0:
        for node in range(len(force)):
            for axis in range(3):
                force[node, axis] *= scale


@chosen(lambda model, *_: _of_cells if has(model, "tissue") else _of_springs)
def elastic_forces(model: Model, position: Floats, scale: float, force: Floats) -> None:
    """Write the forces of the model's springs, or of its cells, times a factor.

    Parameters
    ----------
    model : Model
        Constants of the model.
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    scale : float
        The factor.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.
    """
