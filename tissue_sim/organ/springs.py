"""Springs of an organ: of its shell, of the tissue columns under its surface, and of its skeleton."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints
from tissue_sim.errors import UserError
from tissue_sim.organ.edges import directed_edges
from tissue_sim.organ.medial import nearest_atoms
from tissue_sim.organ.normals import triangle_area
from tissue_sim.organ.organ import SpringKind

NEAREST_ATOMS = 4  # section 3.3: each boundary point is joined with the four nearest medial atoms
SHELL_THICKNESS = 0.8  # of the mean edge: the tissue that edge and angular springs stand for


class Springs(NamedTuple):
    """Springs, and the volume m^3 of the tissue that they represent, where it is known."""

    nodes: Ints
    length: Floats
    stiffness: Floats
    kind: Ints
    volume: float = 0.0

    def node_stiffness(self, n: int) -> Floats:
        """Return the sum of the stiffnesses at each of n nodes, (n,) N/m."""
        return np.bincount(self.nodes.ravel(), weights=np.repeat(self.stiffness, 2), minlength=n)

    def after(self, count: int) -> Springs:
        """Return them with `count` nodes before their own."""
        return self._replace(nodes=self.nodes + count)


def joined(groups: Sequence[Springs]) -> Springs:
    """Return the springs of all groups, in their order."""
    nodes, length, stiffness, kind = (np.concatenate([group[field] for group in groups]) for field in range(4))
    return Springs(nodes, length, stiffness, kind)


class Shell(NamedTuple):
    """Tissue under the surface: of each edge the nodes, the corners opposite to it, area and length; the thickness."""

    edges: Ints
    corners: Ints
    area: Floats
    length: Floats
    thickness: float

    def springs(self, youngs_modulus: float) -> Springs:
        """Return a spring for each edge."""
        stiffness = youngs_modulus * self.thickness * self.area / self.length**2
        return Springs(self.edges, self.length, stiffness, np.full(len(self.edges), SpringKind.EDGE))

    def rigidity(self, youngs_modulus: float, poisson_ratio: float) -> float:
        """Return the bending stiffness of a plate of this thickness, N m."""
        return youngs_modulus * self.thickness**3 / (12.0 * (1.0 - poisson_ratio**2))


def shell_of(name: str, surface: Floats, triangles: Ints) -> Shell:
    """Return the tissue under a surface. Raises UserError where a triangle has no area."""
    area = triangle_area(surface, triangles)
    edges, corners, edge_area = surface_edges(triangles, area)
    length = np.linalg.norm(surface[edges[:, 0]] - surface[edges[:, 1]], axis=1)
    if np.any(length <= 0.0) or np.any(area <= 0.0):
        raise UserError(f"organ '{name}': the surface has triangles without area; remove them")
    return Shell(edges, corners, edge_area, length, SHELL_THICKNESS * float(length.mean()))


class Bones(NamedTuple):
    """Links of the skeleton between medial atoms: their ends, lengths and sections."""

    ends: Ints
    length: Floats
    section: Floats

    def springs(self, youngs_modulus: float, fraction: float) -> Springs:
        """Return a spring for each, of a fraction of its section."""
        stiffness = youngs_modulus * (self.section * fraction) / self.length
        return Springs(self.ends, self.length, stiffness, np.full(len(self.ends), SpringKind.SKELETON))


def bones_of(name: str, atoms: Floats, radius: Floats, parent: Ints) -> Bones:
    """Return the links of a skeleton. Raises UserError where two neighbours coincide."""
    child = np.flatnonzero(parent >= 0)
    length = np.linalg.norm(atoms[child] - atoms[parent[child]], axis=1)
    if np.any(length <= 0.0):
        raise UserError(f"organ '{name}': two neighbouring medial atoms coincide; use fewer --atoms")
    section = np.pi * (0.5 * (radius[child] + radius[parent[child]])) ** 2
    return Bones(np.stack([child, parent[child]], axis=1), length, section)


def columns_of(surface: Floats, atoms: Floats, node_area: Floats, youngs_modulus: float) -> Springs:
    """Return the tissue columns between the surface and the inner nodes."""
    atom, length = nearest_atoms(surface, atoms, NEAREST_ATOMS)
    k = atom.shape[1]
    if np.any(length <= 0.0):
        raise UserError("a medial atom lies on the surface; use fewer --atoms or more --points")
    fraction = 1.0 / (length * np.sum(1.0 / length, axis=1, keepdims=True))
    stiffness = youngs_modulus * node_area[:, None] / length * fraction
    kind = np.full((len(surface), k), SpringKind.VIRTUAL, dtype=np.int32)
    kind[:, 0] = SpringKind.SPOKE
    node = np.repeat(np.arange(len(surface)), k)
    nodes = np.stack([node, atom.ravel() + len(surface)], axis=1).astype(np.int32)
    return Springs(nodes, length.ravel(), stiffness.ravel(), kind.ravel())


def surface_edges(triangles: Ints, area: Floats) -> tuple[Ints, Ints, Floats]:
    """Return the edges of a closed surface, their opposite corners, and the area beside them.

    The edges have shape (n_edges, 2). The corners opposite to each, (n_edges, 2): the first belongs to the triangle
    that runs along the edge i -> j, the second to the one that runs j -> i. The summed area of the two triangles has
    shape (n_edges,).
    """
    directed = directed_edges(triangles)
    opposite = np.concatenate([triangles[:, 2], triangles[:, 0], triangles[:, 1]])
    owner = np.tile(np.arange(len(triangles)), 3)
    low, high = directed.min(axis=1).astype(np.int64), directed.max(axis=1).astype(np.int64)
    backward = (directed[:, 0] > directed[:, 1]).astype(np.int64)
    order = np.lexsort((backward, high, low))
    along, against = order[0::2], order[1::2]
    corners = np.stack([opposite[along], opposite[against]], axis=1)
    return directed[along].astype(np.int32), corners.astype(np.int32), area[owner[along]] + area[owner[against]]
