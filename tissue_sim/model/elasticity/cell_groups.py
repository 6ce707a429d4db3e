"""Cell groups of the whole organ: three cells around an edge, each sharing a face with the next.

Three separate cells read and write twelve nodes, a group of them six; the common parts of their energies are one
quadratic form. The nodes of a group are two at the ends of the edge, then four around it.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.jit import inner, kernel
from tissue_sim.model.data.blocks import BLOCK, pack
from tissue_sim.model.data.model import CellGroups, Tissue
from tissue_sim.model.elasticity.cell_law import COMPRESSED, STIFF, minor, pressure_of
from tissue_sim.model.elasticity.stiffening import needed_shortening, resist_stiffening, stiffening_rows
from tissue_sim.model.elasticity.vectors import WIDTH, fused, gather_group, put_node, scatter_group
from tissue_sim.model.elasticity.volumes import triple_product

CELLS = 3  # in a group
ARMS = 5  # vectors from its first node to the others
# Arms of each cell, and pairs of arms in one cell: rows of the quadratic form, as the kernel reads them.
CORNERS = ((0, 1, 2), (0, 2, 3), (0, 3, 4))
PAIRS = ((0, 0), (1, 1), (2, 2), (3, 3), (4, 4), (0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4))
# Rows of the first cell: 1 / (6 V), lambda / 12, mu / 6 and a sixth of the penalty; those of the others follow.
OWN, OWN_ROWS = len(PAIRS), 4
CONSTANTS = OWN + CELLS * OWN_ROWS
# Rows of the buffer: arms and volumes over those at rest; of groups that stiffen the exponent, its factor and 3 ARMS.
ROOM = 6 * ARMS + CELLS + 2
CHUNK = 16  # blocks within which groups that share nodes are separated, without leaving the cache


def cell_groups_of(
    rest: Floats, cells: Ints | Longs, slope: Floats, mu: Floats, lam: Floats, stiffening: float = 0.0
) -> CellGroups:
    """Return the groups of cells.

    Parameters
    ----------
    rest : Floats, shape (n, 3), m
        Positions of the nodes at rest.
    cells : Ints | Longs, shape (c, 4)
        Node indices of the cells.
    slope : Floats, shape (c, 4, 3), 1/m
        Gradients of their shape functions.
    mu : Floats, shape (c,), Pa
        Shear modulus of each cell.
    lam : Floats, shape (c,), Pa
        Lame's first constant of each cell.
    stiffening : float, optional
        Demiray's b; 0 for neo-Hookean cells.
    """
    quads = cells.astype(np.int64)
    members = paths(rest, quads)
    members = members[_order(rest[quads[members[:, 1]]].mean(axis=1))]
    nodes = _nodes_of(rest, quads, members)
    there, member = members >= 0, members.clip(0)
    constants = np.zeros((len(members), CONSTANTS))
    for which, arms in enumerate(CORNERS):
        corner = np.concatenate([nodes[:, :1], nodes[:, [1 + arm for arm in arms]]], axis=1)
        volume = triple_product(*(rest[corner[:, k]] - rest[corner[:, 0]] for k in (1, 2, 3))) / 6.0
        own, some = member[:, which], there[:, which].astype(np.float64)
        place = np.argmax(quads[own][:, None, :] == corner[:, :, None], axis=2)
        slopes = np.take_along_axis(slope[own], place[:, :, None], axis=1)
        form = np.einsum("fax,fbx->fab", slopes, slopes) * (some * mu[own] * volume)[:, None, None]
        for one in range(3):
            for other in range(one, 3):
                constants[:, PAIRS.index((arms[one], arms[other]))] += form[:, one + 1, other + 1]
        first = OWN + OWN_ROWS * which
        constants[:, first] = 1.0 / (6.0 * volume)
        constants[:, first + 1], constants[:, first + 2] = some * lam[own] / 12.0, some * mu[own] / 6.0
    filling = np.zeros(CONSTANTS)
    filling[OWN::OWN_ROWS] = constants[0, OWN::OWN_ROWS]
    spare = -len(members) % BLOCK
    nodes = np.concatenate([nodes, np.repeat(nodes[:1], spare, axis=0)])
    constants = np.concatenate([constants, np.tile(filling, (spare, 1))])
    members = np.concatenate([members, np.full((spare, CELLS), -1)])
    apart = _apart(len(members))
    packed = pack(nodes[apart].astype(np.int32), constants[apart], filling)
    return CellGroups(packed.nodes, packed.constants, stiffening_rows(packed.constants, stiffening), members[apart])


def set_penalty(groups: CellGroups, penalty: Floats) -> None:
    """Set the penalty of every cell.

    Parameters
    ----------
    groups : CellGroups
        The groups; updated.
    penalty : Floats, shape (c,), J/m^3
        Penalty.
    """
    given = np.where(groups.cells >= 0, penalty[groups.cells.clip(0)], 0.0).reshape(-1, BLOCK, CELLS) / 6.0
    rows = groups.constants.reshape(-1, CONSTANTS, BLOCK)
    rows[:, OWN + 3 :: OWN_ROWS] = given.transpose(0, 2, 1)


def paths(rest: Floats, cells: Longs) -> Longs:
    """Return the cells (f, CELLS) of groups: each cell in one, the middle one always present, -1 for a missing one.

    The search is greedy, from cells with the fewest free neighbours, so that hardly any remains single.
    """
    neighbours = _neighbours(rest, cells)
    count = len(cells)
    free = np.count_nonzero(neighbours >= 0, axis=1)
    found = np.full((count, CELLS), -1, dtype=np.int64)
    made = _follow(neighbours, free, np.zeros((5, 5 * count), dtype=np.int64), np.zeros(5, dtype=np.int64), found)
    return found[:made]


def _neighbours(rest: Floats, cells: Longs) -> Longs:
    """Return cells (c, 4) across the face opposite to each node; -1 if there is none, or if both are on one side."""
    faces = np.sort(np.stack([np.delete(cells, corner, axis=1) for corner in range(4)], axis=1), axis=2).reshape(-1, 3)
    key = (faces[:, 0] * len(rest) + faces[:, 1]) * len(rest) + faces[:, 2]
    _, face, shared = np.unique(key, return_inverse=True, return_counts=True)
    slots = np.argsort(face, kind="stable")
    slots = slots[shared[face[slots]] == 2].reshape(-1, 2)
    corner = rest[faces[slots[:, 0]]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    side = np.einsum("fkx,fx->fk", rest[cells.ravel()[slots]] - corner[:, :1], normal)
    slots = slots[side[:, 0] * side[:, 1] < 0.0]
    found = np.full(cells.size, -1, dtype=np.int64)
    found[slots[:, 0]], found[slots[:, 1]] = slots[:, 1] // 4, slots[:, 0] // 4
    return found.reshape(-1, 4)


@kernel
def _follow(neighbours: Longs, free: Longs, waiting: Longs, waits: Longs, found: Longs) -> int:
    """Fill the rows of found (c, CELLS); free (c,): number of free neighbours, -1 in the end.

    waiting and waits are stacks.
    """
    for cell in range(len(free) - 1, -1, -1):
        waiting[free[cell], waits[free[cell]]] = cell
        waits[free[cell]] += 1
    made = least = 0
    while least < 5:
        if waits[least] == 0:
            least += 1
            continue
        waits[least] -= 1
        start = waiting[least, waits[least]]
        if free[start] != least:
            continue
        _take(neighbours, free, waiting, waits, start)
        second = _freest(neighbours, free, start)
        third = -1
        if second >= 0:
            _take(neighbours, free, waiting, waits, second)
            third = _freest(neighbours, free, second)
            if third < 0:
                start, second = second, start
                third = _freest(neighbours, free, second)
        if third >= 0:
            _take(neighbours, free, waiting, waits, third)
        if second >= 0:
            found[made, 0], found[made, 1], found[made, 2] = start, second, third
        else:
            found[made, 1] = start
        made += 1
        least = 0
    return made


@kernel
def _take(neighbours: Longs, free: Longs, waiting: Longs, waits: Longs, cell: int) -> None:
    """Mark a cell as used, and reduce the number of free neighbours of its neighbours."""
    free[cell] = -1
    for side in range(4):
        other = neighbours[cell, side]
        if other >= 0 and free[other] > 0:
            free[other] -= 1
            waiting[free[other], waits[free[other]]] = other
            waits[free[other]] += 1


@kernel
def _freest(neighbours: Longs, free: Longs, cell: int) -> int:
    """Return the free neighbour of a cell that has the fewest free neighbours itself; -1 if none is free."""
    best, least = -1, 5
    for side in range(4):
        other = neighbours[cell, side]
        if other >= 0 and 0 <= free[other] < least:
            best, least = other, free[other]
    return best


def _nodes_of(rest: Floats, cells: Longs, members: Longs) -> Longs:
    """Return nodes (f, 6) of groups (f, CELLS). A missing cell gets the nodes of the middle one, reordered."""
    middle = cells[members[:, 1]]
    apex, opposite = [], []
    for other in (members[:, 0], members[:, 2]):
        quad = cells[other.clip(0)]
        same = quad[:, :, None] == middle[:, None, :]
        apex.append(np.take_along_axis(quad, np.argmin(same.any(axis=2), axis=1)[:, None], axis=1)[:, 0])
        opposite.append(np.where(other >= 0, np.argmin(same.any(axis=1), axis=1), -1))
    before, after = opposite
    # If there is no neighbour there, any remaining face is used.
    before = np.where(before >= 0, before, np.where(after == 0, 1, 0))
    after = np.where(after >= 0, after, np.where(before == 0, 1, 0))
    rest_of = np.ones(middle.shape, dtype=bool)
    row = np.arange(len(middle))
    rest_of[row, before] = rest_of[row, after] = False
    ends = middle[rest_of].reshape(-1, 2)
    third, fourth = middle[row, after], middle[row, before]
    first = np.where(members[:, 0] >= 0, apex[0], fourth)
    last = np.where(members[:, 2] >= 0, apex[1], third)
    edges = rest[np.stack([ends[:, 1], third, fourth], axis=1)] - rest[ends[:, :1]]
    inward = triple_product(edges[:, 0], edges[:, 1], edges[:, 2]) < 0.0
    ends[inward] = ends[inward][:, ::-1]
    return np.concatenate([ends, np.stack([first, third, fourth, last], axis=1)], axis=1)


def _order(points: Floats) -> Longs:
    """Return an order of points (f, 3) in which neighbours are near each other."""
    return cKDTree(points, leafsize=BLOCK).indices.astype(np.int64)


def _apart(count: int) -> Longs:
    """Return an order in which consecutive groups share no nodes, as the processor would wait for the earlier sum."""
    size = CHUNK * BLOCK
    chunks = [np.arange(first, min(first + size, count)) for first in range(0, count, size)]
    return np.concatenate([chunk.reshape(BLOCK, -1).T.ravel() for chunk in chunks])


@kernel
def cell_forces(position: Floats, tissue: Tissue, scale: float, force: Floats) -> None:
    """Write the forces of all cells times a factor, and list those that are compressed.

    Parameters
    ----------
    position : Floats, shape (n, 3), m
        Positions of the nodes, surface first.
    tissue : Tissue
        Cells of the model.
    scale : float
        The factor.
    force : Floats, shape (n, 3), N
        Forces on the nodes; updated.
    """
    push_cells(position, tissue)
    rows = tissue.rows
    for node in range(len(force)):
        for axis in range(3):
            force[node, axis] = scale * (0.0 + rows[node, WIDTH + axis])  # no -0.0


@kernel
def push_cells(position: Floats, tissue: Tissue) -> None:
    """Sum the forces of all cells in the rows of the nodes, and list the cells that are compressed."""
    rows, work, groups = tissue.rows, tissue.work, tissue.groups
    stiff = 0
    for node in range(len(position)):
        put_node(position, node, rows)
    if len(groups.stiffening) > 0:
        stiff = _push_stiffening(tissue)
    else:
        for block in range(len(groups.nodes)):
            gather_group(rows, groups.nodes[block], work)
            if _resist(work, groups.constants[block]) > 0:
                stiff = _list_compressed(work, groups.constants[block], block, tissue.compressed_cells, stiff)
            scatter_group(rows, groups.nodes[block], work)
    tissue.stiff[0] = stiff


@kernel
def _push_stiffening(tissue: Tissue) -> int:
    """Scatter the forces of groups that stiffen; return how many compressed cells are listed."""
    rows, work, groups = tissue.rows, tissue.work, tissue.groups
    listed, shortening = 0, 1
    for block in range(len(groups.nodes)):
        gather_group(rows, groups.nodes[block], work)
        if resist_stiffening(work, groups.constants[block], groups.stiffening[block]) > 0:
            listed = _list_compressed(work, groups.constants[block], block, tissue.compressed_cells, listed)
            shortening = max(shortening, needed_shortening(work, groups.stiffening[block]))
        scatter_group(rows, groups.nodes[block], work)
    tissue.shortening[0] = shortening
    return listed


@kernel
def _resist(work: Floats, constant: Floats) -> int:
    """Replace the arms of a block of groups by the forces of their last five nodes on the first.

    Returns the number of stiff cells. e is along the edge, a to d are around it. The last rows of work contain the
    cells' volume ratios afterwards.
    """
    stiff = 0
    for c in range(BLOCK):
        ex, ey, ez = work[c], work[BLOCK + c], work[2 * BLOCK + c]
        ax, ay, az = work[3 * BLOCK + c], work[4 * BLOCK + c], work[5 * BLOCK + c]
        bx, by, bz = work[6 * BLOCK + c], work[7 * BLOCK + c], work[8 * BLOCK + c]
        cx, cy, cz = work[9 * BLOCK + c], work[10 * BLOCK + c], work[11 * BLOCK + c]
        dx, dy, dz = work[12 * BLOCK + c], work[13 * BLOCK + c], work[14 * BLOCK + c]
        abx, aby, abz = minor(ay, bz, az, by), minor(az, bx, ax, bz), minor(ax, by, ay, bx)
        bcx, bcy, bcz = minor(by, cz, bz, cy), minor(bz, cx, bx, cz), minor(bx, cy, by, cx)
        cdx, cdy, cdz = minor(cy, dz, cz, dy), minor(cz, dx, cx, dz), minor(cx, dy, cy, dx)
        eax, eay, eaz = minor(ey, az, ez, ay), minor(ez, ax, ex, az), minor(ex, ay, ey, ax)
        ebx, eby, ebz = minor(ey, bz, ez, by), minor(ez, bx, ex, bz), minor(ex, by, ey, bx)
        ecx, ecy, ecz = minor(ey, cz, ez, cy), minor(ez, cx, ex, cz), minor(ex, cy, ey, cx)
        edx, edy, edz = minor(ey, dz, ez, dy), minor(ez, dx, ex, dz), minor(ex, dy, ey, dx)
        ab = fused(ex, abx, fused(ey, aby, ez * abz)) * constant[12 * BLOCK + c]
        bc = fused(ex, bcx, fused(ey, bcy, ez * bcz)) * constant[16 * BLOCK + c]
        cd = fused(ex, cdx, fused(ey, cdy, ez * cdz)) * constant[20 * BLOCK + c]
        stiff += (ab < STIFF) | (bc < STIFF) | (cd < STIFF)
        work[15 * BLOCK + c], work[16 * BLOCK + c], work[17 * BLOCK + c] = ab, bc, cd
        p = pressure_of(ab, constant[13 * BLOCK + c], constant[14 * BLOCK + c], constant[15 * BLOCK + c])
        q = pressure_of(bc, constant[17 * BLOCK + c], constant[18 * BLOCK + c], constant[19 * BLOCK + c])
        r = pressure_of(cd, constant[21 * BLOCK + c], constant[22 * BLOCK + c], constant[23 * BLOCK + c])
        ee, aa, bb = constant[c], constant[BLOCK + c], constant[2 * BLOCK + c]
        cc, dd = constant[3 * BLOCK + c], constant[4 * BLOCK + c]
        ea, eb = constant[5 * BLOCK + c], constant[6 * BLOCK + c]
        ec, ed = constant[7 * BLOCK + c], constant[8 * BLOCK + c]
        s, t, u = constant[9 * BLOCK + c], constant[10 * BLOCK + c], constant[11 * BLOCK + c]
        around = fused(ed, dx, fused(p, abx, fused(q, bcx, r * cdx)))
        work[c] = _along(ee, ex, ea, ax, eb, bx, ec, cx, around)
        around = fused(ed, dy, fused(p, aby, fused(q, bcy, r * cdy)))
        work[BLOCK + c] = _along(ee, ey, ea, ay, eb, by, ec, cy, around)
        around = fused(ed, dz, fused(p, abz, fused(q, bcz, r * cdz)))
        work[2 * BLOCK + c] = _along(ee, ez, ea, az, eb, bz, ec, cz, around)
        work[3 * BLOCK + c] = fused(ea, ex, fused(aa, ax, fused(s, bx, -(p * ebx))))
        work[4 * BLOCK + c] = fused(ea, ey, fused(aa, ay, fused(s, by, -(p * eby))))
        work[5 * BLOCK + c] = fused(ea, ez, fused(aa, az, fused(s, bz, -(p * ebz))))
        work[6 * BLOCK + c] = _along(eb, ex, s, ax, bb, bx, t, cx, fused(p, eax, -(q * ecx)))
        work[7 * BLOCK + c] = _along(eb, ey, s, ay, bb, by, t, cy, fused(p, eay, -(q * ecy)))
        work[8 * BLOCK + c] = _along(eb, ez, s, az, bb, bz, t, cz, fused(p, eaz, -(q * ecz)))
        work[9 * BLOCK + c] = _along(ec, ex, t, bx, cc, cx, u, dx, fused(q, ebx, -(r * edx)))
        work[10 * BLOCK + c] = _along(ec, ey, t, by, cc, cy, u, dy, fused(q, eby, -(r * edy)))
        work[11 * BLOCK + c] = _along(ec, ez, t, bz, cc, cz, u, dz, fused(q, ebz, -(r * edz)))
        work[12 * BLOCK + c] = fused(ed, ex, fused(u, cx, fused(dd, dx, r * ecx)))
        work[13 * BLOCK + c] = fused(ed, ey, fused(u, cy, fused(dd, dy, r * ecy)))
        work[14 * BLOCK + c] = fused(ed, ez, fused(u, cz, fused(dd, dz, r * ecz)))
    return stiff


@kernel
def _list_compressed(work: Floats, constant: Floats, block: int, listed: Longs, count: int) -> int:
    """Append the compressed cells of a block with a stiff one to the list; return the new count.

    Padding is left out.
    """
    for c in range(BLOCK):
        for which in range(CELLS):
            shear = constant[(OWN + OWN_ROWS * which + 2) * BLOCK + c]
            if work[(3 * ARMS + which) * BLOCK + c] < COMPRESSED and shear > 0.0:
                listed[count] = (block * BLOCK + c) * CELLS + which
                count += 1
    return count


@inner
def listed_cell(tissue: Tissue, index: int) -> tuple[tuple[int, int, int, int], float, float]:
    """Return the nodes of a listed compressed cell, 1 / (6 V), 1/m^3, and a sixth of its penalty, Pa.

    Parameters
    ----------
    tissue : Tissue
        The cells, with those that the last forces of the whole organ found compressed.
    index : int
        Place in their list.
    """
    group, which = divmod(tissue.compressed_cells[index], CELLS)
    block, c = divmod(group, BLOCK)
    constant, node, own = tissue.groups.constants[block], tissue.groups.nodes[block, c], OWN + OWN_ROWS * which
    nodes = (node[0], node[1], node[2 + which], node[3 + which])
    return nodes, constant[own * BLOCK + c], constant[(own + 3) * BLOCK + c]


@kernel
def _along(f: float, x: float, g: float, y: float, h: float, z: float, k: float, w: float, more: float) -> float:
    """Return f x + g y + h z + k w + more."""
    return fused(f, x, fused(g, y, fused(h, z, fused(k, w, more))))
