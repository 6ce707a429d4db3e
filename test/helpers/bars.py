"""Bars of cells on a regular grid, of which closed forms are known."""

from dataclasses import replace
from functools import cache
from itertools import permutations

import numpy as np

from tissue_sim.organ.edges import CELL_FACES
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.topology import assemble_organ


@cache
def bar(segments: int = 12, edge: float = 0.01, across: int = 2) -> Organ:
    """A bar along x of cubes of six cells each, two cubes wide and high, held at x = 0.

    Its axis is a chain of medial atoms; all other nodes are on the surface.
    """
    size = np.array([segments, across, across]) + 1
    grid = np.stack(np.meshgrid(*(np.arange(count) for count in size), indexing="ij"), axis=-1).reshape(-1, 3)
    inner = ((grid > 0) & (grid < size - 1)).all(axis=1)
    order = np.concatenate([np.flatnonzero(~inner), np.flatnonzero(inner)])
    number = np.empty(len(grid), dtype=np.int64)
    number[order] = np.arange(len(grid))
    points = edge * grid[order].astype(float)

    def at(place):
        return number[(place[..., 0] * size[1] + place[..., 1]) * size[2] + place[..., 2]]

    corner = grid[(grid < size - 1).all(axis=1)]
    cells = []
    for axes in permutations(range(3)):
        steps = np.cumsum([[0, 0, 0], *(np.eye(3, dtype=int)[axis] for axis in axes)], axis=0)
        cells.append(np.stack([at(corner + step) for step in steps], axis=1))
    cells = np.concatenate(cells)
    turned = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]]) < 0.0
    cells[turned] = cells[turned][:, [1, 0, 2, 3]]
    faces = np.concatenate([cells[:, face] for face in CELL_FACES])
    opposite = np.concatenate([cells[:, k] for k in range(4)])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    outer, opposite = faces[first[count == 1]], opposite[first[count == 1]]
    a, b, c = (points[outer[:, k]] for k in range(3))
    inward = np.einsum("fx,fx->f", np.cross(b - a, c - a), points[opposite] - a) > 0.0
    outer[inward] = outer[inward][:, ::-1]
    surface = int((~inner).sum())
    organ = assemble_organ(
        name="bar",
        surface_positions=points[:surface],
        surface_triangles=outer,
        atom_positions=points[surface:],
        atom_radius=np.full(len(points) - surface, 0.5 * across * edge),
        atom_parent=np.arange(-1, len(points) - surface - 1),
        fixed=np.flatnonzero(points[:surface, 0] == 0.0),
        provenance={"source": "test"},
    )
    mu, lam = np.outer(organ.lame_moduli, np.ones(len(cells)))
    return replace(organ, cell_nodes=cells, cell_mu=mu, cell_lambda=lam)
