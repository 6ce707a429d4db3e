"""Springs and masses from geometry: the hybrid topology of Zhang, Gu et al. (2006), section 3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonMapping
from tissue_sim.organ.cell_mesh import tetrahedra
from tissue_sim.organ.edges import cell_edges, directed_edges
from tissue_sim.organ.inclusions import Inclusion, inclusions_of, spring_factors, with_inclusions
from tissue_sim.organ.interior import distribute_interior_atoms
from tissue_sim.organ.medial import nearest_atoms
from tissue_sim.organ.normals import triangle_area
from tissue_sim.organ.organ import Organ, SpringKind
from tissue_sim.organ.surface_checks import check_surface, signed_volume

NEAREST_ATOMS = 4  # section 3.3: each boundary point is joined with the four nearest medial atoms
# Fraction of the organ's mass. The skeleton's springs are the stiffest: with less mass on its atoms the skeleton alone
# would determine the time step.
SURFACE_MASS_FRACTION = 0.45
DAMPING_RATE = 45.0  # 1/s: settles a poke of a 10 kPa kidney in 0.2 s with under 5 % overshoot
SHELL_THICKNESS = 0.8  # of the mean edge: the tissue that edge and angular springs stand for
RETURN_FRACTION = 0.02  # return spring as a fraction of the tissue column's stiffness


def assemble_organ(
    *,
    name: str,
    surface_positions: ArrayLike,
    surface_triangles: ArrayLike,
    atom_positions: ArrayLike,
    atom_radius: ArrayLike,
    atom_parent: ArrayLike,
    fixed: ArrayLike = (),
    interior_atoms: int = 0,
    interior_layer: float = 0.0,
    youngs_modulus: float = 10_000.0,
    poisson_ratio: float = 0.45,
    density: float = 1060.0,
    inclusions: Sequence[Inclusion] = (),
    provenance: JsonMapping | None = None,
) -> Organ:
    """Return a node-ready organ from a closed surface and its medial atoms.

    Springs: one for each triangle edge, k = E h sum(A)/l^2 [1]_ with the shell thickness h, 0.8 of the mean edge
    length; from each surface node to its nearest inner node (spoke) and the next three of its four nearest (virtual),
    which share the stiffness A sqrt(E M)/L of the tissue column under the node, M the oedometric modulus; between
    neighbouring medial atoms (skeleton) with E pi r^2/l. Angular springs sit on every edge with the bending stiffness
    of a plate, E h^3/(12 (1 - nu^2)), discretised as in [2]_. With interior atoms, the tetrahedra between the inner
    nodes carry the tissue there, k = E sum(V)/l^2 on their edges [1]_, and the skeleton the rest of its section.
    Masses: density times volume, 80 % on the surface by area, the rest on the inner nodes by stiffness, so that they
    don't determine the critical step.

    Parameters
    ----------
    name : str
        Name of the organ.
    surface_positions : ArrayLike, shape (n_surface, 3), m
        Points of the surface.
    surface_triangles : ArrayLike, shape (n_triangles, 3)
        Corner indices, counter-clockwise seen from outside.
    atom_positions : ArrayLike, shape (n_atoms, 3), m
        Medial atoms.
    atom_radius : ArrayLike, shape (n_atoms,), m
        Their radii.
    atom_parent : ArrayLike, shape (n_atoms,)
        Parent of each atom, -1 at the root.
    fixed : ArrayLike, shape (n_fixed,), optional
        Fixed surface nodes.
    interior_atoms : int, optional
        Number of further atoms along the spokes.
    interior_layer : float, optional
        Fraction of them that lies a mean edge under the surface.
    youngs_modulus : float, Pa, optional
        Young's modulus.
    poisson_ratio : float, optional
        Poisson's ratio.
    density : float, kg/m^3, optional
        Density.
    inclusions : Sequence[Inclusion], optional
        Tissue of another stiffness, which applies to all springs that run through it.
    provenance : JsonMapping | None, optional
        Origin of the organ, kept in its file.

    Raises
    ------
    UserError
        For an open or inverted surface, no atoms, or tissue out of range.

    References
    ----------
    .. [1] A. Van Gelder, "Approximate simulation of elastic membranes by triangulated spring meshes", Journal of
       Graphics Tools 3, 1998.
    .. [2] M. Bergou, M. Wardetzky, D. Harmon, D. Zorin and E. Grinspun, "A quadratic bending model for inextensible
       surfaces", Eurographics Symposium on Geometry Processing, 2006.
    """
    surface = np.asarray(surface_positions, dtype=np.float64)
    triangles = np.asarray(surface_triangles, dtype=np.int32)
    atoms = np.asarray(atom_positions, dtype=np.float64)
    radius = np.asarray(atom_radius, dtype=np.float64)
    parent = np.asarray(atom_parent, dtype=np.int32)
    check_tissue(youngs_modulus, poisson_ratio, density)
    if len(atoms) == 0:
        raise UserError(f"organ '{name}' has no medial atoms; build it with --atoms 1 or more")
    check_surface(surface, triangles, f"organ '{name}'")

    area = triangle_area(surface, triangles)
    edges, corners, edge_area = surface_edges(triangles, area)
    edge_length = np.linalg.norm(surface[edges[:, 0]] - surface[edges[:, 1]], axis=1)
    if np.any(edge_length <= 0.0) or np.any(area <= 0.0):
        raise UserError(f"organ '{name}': the surface has triangles without area; remove them")
    thickness = SHELL_THICKNESS * float(edge_length.mean())
    of_nodes = node_area(surface, triangles)

    interior = distribute_interior_atoms(surface, triangles, atoms, interior_atoms, interior_layer)
    inner = np.concatenate([atoms, interior.positions])
    # A column of tissue is neither free to bulge (E) nor confined (oedometric modulus): between them.
    confined = (1.0 - poisson_ratio) / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    columns = _columns(surface, inner, of_nodes, youngs_modulus * np.sqrt(confined))
    bones = np.flatnonzero(parent >= 0)
    bone_length = np.linalg.norm(atoms[bones] - atoms[parent[bones]], axis=1)
    if np.any(bone_length <= 0.0):
        raise UserError(f"organ '{name}': two neighbouring medial atoms coincide; use fewer --atoms")
    total_volume = signed_volume(surface, triangles)
    core = _inner_springs(inner, interior.spoke[:, 0], surface, triangles, youngs_modulus)
    bone_section = np.pi * (0.5 * (radius[bones] + radius[parent[bones]])) ** 2
    bone_section *= max(1.0 - core.volume / total_volume, 0.0)

    n_surface = len(surface)
    nodes = [edges, columns.nodes, core.nodes + n_surface, np.stack([bones, parent[bones]], axis=1) + n_surface]
    lengths = [edge_length, columns.length, core.length, bone_length]
    stiffness = [
        youngs_modulus * thickness * edge_area / edge_length**2,
        columns.stiffness,
        core.stiffness,
        youngs_modulus * bone_section / bone_length,
    ]
    kinds = [np.full(len(edges), SpringKind.EDGE), columns.kind, core.kind, np.full(len(bones), SpringKind.SKELETON)]
    spring_nodes = np.concatenate(nodes)
    spring_stiffness = np.concatenate(stiffness)
    if inclusions:
        spring_stiffness *= spring_factors(inclusions, np.concatenate([surface, inner])[spring_nodes])
    spring_kind = np.concatenate(kinds)
    order = np.argsort(spring_kind, kind="stable")

    n = n_surface + len(inner)
    stiffness_sum = np.bincount(spring_nodes.ravel(), weights=np.repeat(spring_stiffness, 2), minlength=n)
    total_mass = density * total_volume
    mass = np.empty(n)
    mass[:n_surface] = SURFACE_MASS_FRACTION * total_mass * of_nodes / of_nodes.sum()
    mass[n_surface:] = (1.0 - SURFACE_MASS_FRACTION) * total_mass * _normalised(stiffness_sum[n_surface:])

    rigidity = youngs_modulus * thickness**3 / (12.0 * (1.0 - poisson_ratio**2))
    organ = Organ(
        name=name,
        surface_positions=surface,
        surface_triangles=triangles,
        atom_positions=atoms,
        atom_radius=radius,
        atom_parent=parent,
        interior_positions=interior.positions,
        interior_spoke=interior.spoke,
        fixed=np.unique(np.asarray(fixed, dtype=np.int32)),
        mass=mass,
        damping=DAMPING_RATE * mass,
        return_stiffness=RETURN_FRACTION * columns.node_stiffness(n),
        spring_nodes=spring_nodes[order],
        spring_rest_length=np.concatenate(lengths)[order],
        spring_stiffness=spring_stiffness[order],
        spring_kind=spring_kind[order],
        angular_nodes=np.concatenate([edges, corners], axis=1),
        angular_stiffness=3.0 * rigidity / edge_area,
        youngs_modulus=youngs_modulus,
        poisson_ratio=poisson_ratio,
        density=density,
        provenance=dict(provenance or {}),
    )
    return with_inclusions(organ, inclusions)


class Changes(TypedDict, total=False):
    """Arguments of assemble_organ in which a reassembled organ may differ."""

    name: str
    surface_positions: ArrayLike
    surface_triangles: ArrayLike
    fixed: ArrayLike
    interior_atoms: int
    interior_layer: float
    inclusions: Sequence[Inclusion]
    provenance: JsonMapping | None


def assemble_like(organ: Organ, **changes: Unpack[Changes]) -> Organ:
    """Return the organ reassembled, with new springs and some arguments of assemble_organ changed.

    Parameters
    ----------
    organ : Organ
        The organ.
    changes : Unpack[Changes]
        Arguments of assemble_organ.

    Raises
    ------
    UserError
        When the organ was cut, as its cuts would heal.
    """
    if organ.n_virtual:
        raise UserError(f"organ '{organ.name}' was cut, and would heal if it were reassembled; use the uncut organ")
    same: Changes = {
        "name": organ.name,
        "surface_positions": organ.surface_positions,
        "surface_triangles": organ.surface_triangles,
        "fixed": organ.fixed,
        "interior_atoms": organ.n_interior,
        "interior_layer": 0.0,
        "inclusions": inclusions_of(organ),
        "provenance": organ.provenance,
    }
    same.update(changes)
    made = assemble_organ(
        atom_positions=organ.atom_positions,
        atom_radius=organ.atom_radius,
        atom_parent=organ.atom_parent,
        youngs_modulus=organ.youngs_modulus,
        poisson_ratio=organ.poisson_ratio,
        density=organ.density,
        **same,
    )
    law = {name: getattr(organ, name) for name in ("stiffening", "relaxation_fraction", "relaxation_time")}
    return replace(made, **law)


class _Springs(NamedTuple):
    """Spokes and virtual springs, and the volume m^3 of the tissue that they represent, where it is known."""

    nodes: Ints
    length: Floats
    stiffness: Floats
    kind: Ints
    volume: float = 0.0

    def node_stiffness(self, n: int) -> Floats:
        """Return the sum of the column stiffnesses at each of n nodes, (n,) N/m."""
        return np.bincount(self.nodes.ravel(), weights=np.repeat(self.stiffness, 2), minlength=n)


def _columns(surface: Floats, atoms: Floats, node_area: Floats, youngs_modulus: float) -> _Springs:
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
    return _Springs(nodes, length.ravel(), stiffness.ravel(), kind.ravel())


def _inner_springs(inner: Floats, owner: Ints, surface: Floats, triangles: Ints, youngs_modulus: float) -> _Springs:
    """Return springs among the inner nodes, of which the last have their medial atom in owner (m,).

    They lie on the edges of the Delaunay tetrahedra whose centroid lies inside the organ, and between each interior
    atom and its medial atom, which in a thin place may not be such an edge. Without interior atoms there are none.
    """
    n_atoms = len(inner) - len(owner)
    spokes = np.stack([owner, np.arange(n_atoms, len(inner))], axis=1).astype(np.int64)
    solid = tetrahedral_edges(inner, surface, triangles) if len(owner) else NO_TETRAHEDRA
    pairs = np.sort(solid.pairs, axis=1)
    bones = np.all(pairs < n_atoms, axis=1)  # these are the skeleton springs
    unique, inverse = np.unique(np.concatenate([spokes, pairs[~bones]]), axis=0, return_inverse=True)
    volume = np.bincount(inverse.ravel()[len(spokes) :], weights=solid.own_volume[~bones], minlength=len(unique))
    kind = np.full(len(unique), SpringKind.VIRTUAL)
    kind[inverse.ravel()[: len(spokes)]] = SpringKind.SPOKE
    length = np.linalg.norm(inner[unique[:, 0]] - inner[unique[:, 1]], axis=1)
    least = 0.05 * np.median(volume[volume > 0.0]) if np.any(volume > 0.0) else 0.0
    stiffness = youngs_modulus * np.maximum(volume, least) / length**2
    return _Springs(unique.astype(np.int32), length, stiffness, kind.astype(np.int32), solid.volume)


class TetrahedralEdges(NamedTuple):
    """Edges of c tetrahedra.

    Attributes
    ----------
    pairs : NDArray[np.int64], shape (6c, 2)
        Point indices.
    own_volume : Floats, shape (6c,), m^3
        Volume of the edge's tetrahedron.
    volume : float, m^3
        Volume of all tetrahedra.
    """

    pairs: NDArray[np.int64]
    own_volume: Floats
    volume: float


NO_TETRAHEDRA = TetrahedralEdges(np.empty((0, 2), dtype=np.int64), np.empty(0), 0.0)


def tetrahedral_edges(points: Floats, surface: Floats, triangles: Ints) -> TetrahedralEdges:
    """Return the edges of the Delaunay tetrahedra whose centroid lies inside a closed surface.

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
    TetrahedralEdges
        The edges; none where all points lie in a plane.
    """
    cells = tetrahedra(points, surface, triangles)
    corner = points[cells]
    volume = np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1])) / 6.0
    return TetrahedralEdges(cell_edges(cells), np.tile(volume, 6), float(volume.sum()))


def _normalised(values: Floats) -> Floats:
    return values / values.sum()


def check_tissue(youngs_modulus: float, poisson_ratio: float, density: float) -> None:
    """Raise UserError unless the parameters are those of a tissue.

    Parameters
    ----------
    youngs_modulus : float, Pa
        Young's modulus.
    poisson_ratio : float
        Poisson's ratio.
    density : float, kg/m^3
        Density.

    Raises
    ------
    UserError
        Where a parameter is out of range.
    """
    if not 1.0 <= youngs_modulus <= 1e9:
        raise UserError(f"Young's modulus {youngs_modulus:g} Pa is outside 1..1e9")
    if not 0.0 <= poisson_ratio < 0.5:
        raise UserError(f"Poisson's ratio {poisson_ratio:g} is outside 0..0.5")
    if not 1.0 <= density <= 1e5:
        raise UserError(f"density {density:g} kg/m^3 is outside 1..1e5")


def cell_pieces(cells: Ints | Longs, n: int) -> Longs:
    """Return the piece (n,) that each node is in, where cells that share a node are of one piece.

    Parameters
    ----------
    cells : Ints | Longs, shape (c, 4)
        Node indices of the cells.
    n : int
        Number of nodes; one that no cell has is a piece of its own.
    """
    ends = cells[:, [0, 0, 0]].ravel(), cells[:, 1:].ravel()
    links = coo_array((np.ones(len(ends[0])), ends), shape=(n, n))
    pieces: Longs = connected_components(links, directed=False)[1]
    return pieces


def node_area(positions: Floats, triangles: Ints) -> Floats:
    """Return the surface area of each node: a third of the triangles around it.

    Parameters
    ----------
    positions : Floats, shape (n, 3)
        Points of the surface.
    triangles : Ints, shape (t, 3)
        Corner indices, counter-clockwise seen from outside.

    Returns
    -------
    Floats, shape (n,), m^2
        Areas.
    """
    third = np.repeat(triangle_area(positions, triangles) / 3.0, 3)
    return np.bincount(triangles.ravel(), weights=third, minlength=len(positions))


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
