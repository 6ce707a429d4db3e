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
from tissue_sim.organ.edges import cell_edges
from tissue_sim.organ.inclusions import Inclusion, inclusions_of, spring_factors, with_inclusions
from tissue_sim.organ.interior import distribute_interior_atoms
from tissue_sim.organ.normals import triangle_area
from tissue_sim.organ.organ import Organ, SpringKind
from tissue_sim.organ.springs import Springs, bones_of, columns_of, joined, shell_of
from tissue_sim.organ.surface_checks import check_surface, signed_volume

# Fraction of the organ's mass. The skeleton's springs are the stiffest: with less mass on its atoms the skeleton alone
# would determine the time step.
SURFACE_MASS_FRACTION = 0.45
DAMPING_RATE = 45.0  # 1/s: settles a poke of a 10 kPa kidney in 0.2 s with under 5 % overshoot
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
    Masses: density times volume, 45 % on the surface by area, the rest on the inner nodes by stiffness, so that they
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

    shell = shell_of(name, surface, triangles)
    of_nodes = node_area(surface, triangles)
    interior = distribute_interior_atoms(surface, triangles, atoms, interior_atoms, interior_layer)
    inner = np.concatenate([atoms, interior.positions])
    # A column of tissue is neither free to bulge (E) nor confined (oedometric modulus): between them.
    confined = (1.0 - poisson_ratio) / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    columns = columns_of(surface, inner, of_nodes, youngs_modulus * np.sqrt(confined))
    bones = bones_of(name, atoms, radius, parent)
    volume = signed_volume(surface, triangles)
    core = _inner_springs(inner, interior.spoke[:, 0], surface, triangles, youngs_modulus)
    springs = joined(
        [
            shell.springs(youngs_modulus),
            columns,
            core.after(len(surface)),
            bones.springs(youngs_modulus, max(1.0 - core.volume / volume, 0.0)).after(len(surface)),
        ]
    )
    if inclusions:
        factors = spring_factors(inclusions, np.concatenate([surface, inner])[springs.nodes])
        springs = springs._replace(stiffness=springs.stiffness * factors)
    order = np.argsort(springs.kind, kind="stable")
    n = len(surface) + len(inner)
    mass = _masses(density * volume, of_nodes, springs.node_stiffness(n))
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
        spring_nodes=springs.nodes[order],
        spring_rest_length=springs.length[order],
        spring_stiffness=springs.stiffness[order],
        spring_kind=springs.kind[order],
        angular_nodes=np.concatenate([shell.edges, shell.corners], axis=1),
        angular_stiffness=3.0 * shell.rigidity(youngs_modulus, poisson_ratio) / shell.area,
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


def _masses(total: float, area: Floats, stiffness: Floats) -> Floats:
    """Return masses (n,) kg: of surface nodes by their area, of inner nodes by the stiffness of their springs."""
    mass, n_surface = np.empty(len(stiffness)), len(area)
    mass[:n_surface] = SURFACE_MASS_FRACTION * total * area / area.sum()
    inner = stiffness[n_surface:]
    mass[n_surface:] = (1.0 - SURFACE_MASS_FRACTION) * total * (inner / inner.sum())
    return mass


def _inner_springs(inner: Floats, owner: Ints, surface: Floats, triangles: Ints, youngs_modulus: float) -> Springs:
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
    return Springs(unique.astype(np.int32), length, stiffness, kind.astype(np.int32), solid.volume)


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
