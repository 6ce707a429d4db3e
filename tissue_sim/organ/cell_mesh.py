"""Tetrahedra between the nodes of an organ: the cells of its tissue."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import Delaunay, QhullError, cKDTree

from tissue_sim.array_types import Floats, Ints, Longs, Mask
from tissue_sim.errors import UserError
from tissue_sim.organ.edges import CELL_EDGES, CELL_FACES, cell_edges, directed_edges
from tissue_sim.organ.inclusions import cell_factors, inclusions_of
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surface_checks import signed_volume
from tissue_sim.organ.winding import inside

# Relative to a regular tetrahedron of the same root mean square edge length. Flatter cells are left out: they carry
# nothing, and would set the critical step.
LEAST_QUALITY = 0.1
LEAST_FRACTION = 0.9  # of the volume
# Degrees between two faces of a cell on the surface, beyond which it is left out: a dent would turn such a cell inside
# out. Narrower angles are the edges of a body, as of a cube, which would hang by a thread without their cells.
WIDEST = 120.0
LEAST_CELLS = 4  # of a node, before one of its cells is left out for its angle
DETOUR = 2.0  # the path along the surface over an edge outside it, above which that edge joins two walls across a gap


def tetrahedra(points: Floats, surface: Floats, triangles: Ints) -> Longs:
    """Return the Delaunay tetrahedra whose centroid lies inside a closed surface.

    Parameters
    ----------
    points : Floats, shape (n, 3), m
        Points between which the tetrahedra are made.
    surface : Floats, shape (k, 3), m
        Nodes of the closed surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    Longs, shape (c, 4)
        Corner indices into `points`; empty where all points lie in a plane.
    """
    try:
        cells = Delaunay(points).simplices.astype(np.int64)
    except QhullError:
        return np.zeros((0, 4), dtype=np.int64)
    return cells[inside(points[cells].mean(axis=1), surface, triangles)]


def tissue_cells(points: Floats, surface: Floats, triangles: Ints, name: str) -> Ints:
    """Return tetrahedra of positive volume that fill a closed surface.

    Cells that would join two walls across a gap, as loops of a bowel that touch, are left out, and so are slivers and
    cells with two faces on the surface at a wide angle. A cell is kept where leaving it out would leave a node with too
    few cells, as in a fin, or with none.

    Parameters
    ----------
    points : Floats, shape (n, 3), m
        Nodes, beginning with those of the surface.
    surface : Floats, shape (k, 3), m
        Nodes of the closed surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.
    name : str
        The organ's name, for messages.

    Returns
    -------
    Ints, shape (c, 4)
        Corner indices into `points`.

    Raises
    ------
    UserError
        Where a node belongs to no cell, or the cells fill less than LEAST_FILLED of the volume.
    """
    cells = tetrahedra(points, surface, triangles)
    volume, quality = quality_of(points, cells)
    cells[volume < 0.0] = cells[volume < 0.0][:, [1, 0, 2, 3]]
    across = bridging(points, cells, surface, triangles)
    order = np.lexsort((-np.abs(quality), across))
    fat = np.abs(quality) > LEAST_QUALITY
    sound = fat.copy()
    sound[fat] = _widest_angle(points, cells[fat], triangles) <= WIDEST
    sound &= ~across
    count = np.bincount(cells[sound].ravel(), minlength=len(points))
    for cell in order[~sound[order]]:  # the best ones first
        least = LEAST_CELLS if fat[cell] and not across[cell] else 1
        if abs(quality[cell]) > 1e-3 and (count[cells[cell]] < least).any():
            sound[cell] = True
            count[cells[cell]] += 1
    if not count.all():
        raise UserError(
            f"organ '{name}': no cell joins {np.sum(count == 0)} nodes; build it with another number of --atoms"
        )
    fraction = float(np.abs(volume[sound]).sum()) / signed_volume(surface, triangles)
    if fraction < LEAST_FRACTION:
        raise UserError(f"cells fill {100.0 * fraction:.0f} % of organ '{name}'; build it with more --interior atoms")
    return cells[sound].astype(np.int32)


def with_cells(organ: Organ, fractions: tuple[float, float] = (1.0, 1.0)) -> Organ:
    """Return the organ with cells between all its nodes; inclusions are taken into account.

    Parameters
    ----------
    organ : Organ
        The organ.
    fractions : tuple[float, float], optional
        Fractions of the tissue's mu and lambda that the cells carry.

    Returns
    -------
    Organ
        The organ with cells in place of its own.

    Raises
    ------
    UserError
        Where a node belongs to no cell, the cells fill too little of the volume, or the organ was cut.
    """
    if organ.n_virtual:
        raise UserError(f"organ '{organ.name}' was cut: its cells can't be made again; use the organ before the cut")
    cells = tissue_cells(organ.rest_positions, organ.surface_positions, organ.surface_triangles, organ.name)
    factors = cell_factors(inclusions_of(organ), organ.rest_positions, cells)
    mu, lam = np.outer(np.multiply(fractions, organ.lame_moduli), factors)
    return replace(organ, cell_nodes=cells, cell_mu=mu, cell_lambda=lam)


def bridging(points: Floats, cells: Longs, surface: Floats, triangles: Ints) -> Mask:
    """Return which cells join two walls across a gap: an edge is outside, and much shorter than the path around.

    The centroid of such a cell may well be inside, and its stiffness would hold two loops together that merely touch.

    Parameters
    ----------
    points : Floats, shape (n, 3), m
        Nodes, beginning with those of the surface.
    cells : Longs, shape (c, 4)
        Corner indices into `points`.
    surface : Floats, shape (k, 3), m
        Nodes of the closed surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    Mask, shape (c,)
        True for those.
    """
    n = len(points)
    ends = np.sort(cell_edges(cells), axis=1)
    keys, where = np.unique(ends @ [n, 1], return_inverse=True)
    along = directed_edges(triangles.astype(np.int64))
    some = np.flatnonzero(~np.isin(keys, np.sort(along, axis=1) @ [n, 1]))
    pairs = np.stack(np.divmod(keys[some], n), axis=1)
    out = ~inside(points[pairs].mean(axis=1), surface, triangles)
    some, pairs = some[out], pairs[out]
    steps = np.linalg.norm(surface[along[:, 0]] - surface[along[:, 1]], axis=1)
    graph = coo_array((steps, (along[:, 0], along[:, 1])), shape=(len(surface), len(surface))).tocsr()
    length = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    below = cKDTree(surface).query(points[pairs])[1]  # interior atoms by the surface node that is nearest
    bad = np.zeros(len(keys), dtype=bool)
    for edge, (here, there), straight in zip(some, below, length, strict=True):
        bad[edge] = dijkstra(graph, indices=here, limit=DETOUR * straight)[there] == np.inf
    found: Mask = bad[where.reshape(6, -1)].any(axis=0)
    return found


def quality_of(points: Floats, cells: Longs | Ints) -> tuple[Floats, Floats]:
    """Return the signed volume and the quality of cells.

    Parameters
    ----------
    points : Floats, shape (n, 3), m
        Positions of the nodes.
    cells : Longs | Ints, shape (c, 4)
        Corner indices into `points`.

    Returns
    -------
    tuple[Floats, Floats]
        Volumes, shape (c,), m^3, and these relative to a regular tetrahedron of the same root mean square edge length.
    """
    corner = points[cells]
    volume = np.linalg.det(corner[:, 1:] - corner[:, :1]) / 6.0
    square = sum(np.sum((corner[:, a] - corner[:, b]) ** 2, axis=1) for a, b in CELL_EDGES) / len(CELL_EDGES)
    return volume, 6.0 * np.sqrt(2.0) * volume / square**1.5


def _widest_angle(points: Floats, cells: Longs, triangles: Ints) -> Floats:
    """Return the widest angle inside each cell between two of its faces on the surface, degrees (c,); 0 without two."""
    size = int(cells.max(initial=0)) + 1

    def keys(faces: Longs | Ints) -> Longs:
        corner = np.sort(faces.astype(np.int64), axis=-1)
        return (corner[..., 0] * size + corner[..., 1]) * size + corner[..., 2]

    on = np.isin(keys(cells[:, CELL_FACES]), keys(triangles))
    corner = points[cells]
    slopes = np.linalg.inv(np.where(on.sum(axis=1)[:, None, None] > 1, corner[:, 1:] - corner[:, :1], np.eye(3)))
    # Gradients of the barycentric coordinates: each points to its corner, across the face opposite to it.
    inward = np.concatenate([-slopes.sum(axis=2)[:, None], slopes.transpose(0, 2, 1)], axis=1)
    inward /= np.linalg.norm(inward, axis=2, keepdims=True)
    widest = np.zeros(len(cells))
    for a, b in CELL_EDGES:
        between = np.degrees(np.arccos(np.clip(-np.einsum("ci,ci->c", inward[:, a], inward[:, b]), -1.0, 1.0)))
        widest = np.maximum(widest, np.where(on[:, a] & on[:, b], between, 0.0))
    return widest
