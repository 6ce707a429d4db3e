"""Assembly of the arrays for the kernels from an organ and a variant of the model."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.errors import UserError
from tissue_sim.model.data.blades import no_cut_cells
from tissue_sim.model.data.blocks import BLOCK, aligned, empty_blocks, pack
from tissue_sim.model.data.lips import make_lips
from tissue_sim.model.data.model import Model, Reduction, Tissue
from tissue_sim.model.elasticity.cells import SLOPES, penalty_of, shapes_of, tissue_of, with_penalty
from tissue_sim.model.elasticity.forces import elastic_forces
from tissue_sim.model.elasticity.frequency import largest_frequency
from tissue_sim.model.elasticity.stiffening import set_step_limits
from tissue_sim.model.elasticity.unloaded_shape import Law, unloaded_shape
from tissue_sim.organ.medial import nearest_atoms
from tissue_sim.organ.organ import Organ, SpringKind
from tissue_sim.organ.topology import cell_pieces, tetrahedral_edges

ModelName = Literal["auto", "surface", "volume", "hybrid", "cells"]
LEAST_CELL = 0.05  # of the mean cell's volume, below which the sign of a cell's volume is unreliable
# Fraction of the rest area below which a pair of triangles counts as collapsed. Its normal rotates in proportion to
# 1 / area: with 0.1 the largest frequency of a pressed organ was up to three times that at rest, with 0.6 it is equal.
LEAST_AREA = 0.6
MODEL_NAMES: tuple[str, ...] = get_args(ModelName)


NO_HOPS = np.zeros((0, 0), dtype=np.uint8)
NO_REDUCTION = Reduction(
    frequency=np.zeros(0),
    shape=np.zeros((0, 3, 0)),
    peak=np.zeros(0),
    compliance=np.zeros((0, 0), dtype=np.float32),
    edge_slopes=np.zeros((0, 21 * BLOCK)),
    link_slopes=np.zeros((0, 6 * BLOCK)),
    cell_slopes=np.zeros((0, SLOPES * BLOCK)),
)


def free_nodes(organ: Organ) -> Longs:
    """Return 1 for each node (n,) of a piece that was cut off and has no fixed node; (0,) if no piece is free.

    Parameters
    ----------
    organ : Organ
        The organ.
    """
    none = np.zeros(0, dtype=np.int64)
    if not organ.n_virtual or not len(organ.fixed):
        return none
    cells, n = organ.cell_nodes, organ.n_nodes
    label = cell_pieces(cells, n)
    used = np.zeros(n, dtype=bool)
    used[cells.ravel()] = True
    free: Longs = (used & ~np.isin(label, label[organ.fixed])).astype(np.int64)
    return free if free.any() else none


def assemble(organ: Organ, model: str = "auto", shape_gravity: ArrayLike = (0.0, 0.0, 0.0)) -> Model:
    """Return the arrays of one of the paper's three variants, or of cells.

    `surface` has edge, angular and return springs of the surface alone (equation 1); `volume` a spring on every edge of
    a tetrahedral mesh of the surface nodes and interior points; `hybrid` the surface with spokes, virtual springs and
    skeleton (section 3.3). `cells` has linear tetrahedra between the nodes instead of springs. Nodes that a variant
    doesn't use remain at rest.

    Parameters
    ----------
    organ : Organ
        The organ.
    model : str, optional
        One of MODEL_NAMES; `auto` for the variant for which the organ was made.
    shape_gravity : ArrayLike, shape (3,), m/s^2, optional
        Gravity under which the organ has its shape. The unloaded shape of cells is computed from it; springs keep their
        shape.

    Raises
    ------
    UserError
        For an unknown variant, `volume` for an organ without interior points, `cells` for one without cells, springs
        for one that was cut, and tissue that is too soft for shape_gravity.

    References
    ----------
    Zhang, Gu et al. 2006, section 3.
    """
    if model not in MODEL_NAMES:
        raise UserError(f"unknown model '{model}'; choose one of {', '.join(MODEL_NAMES)}")
    model = model_of(organ) if model == "auto" else model
    by_cells = model == "cells"
    if by_cells and not len(organ.cell_nodes):
        raise UserError(f"organ '{organ.name}' has no cells; add them with tissue_sim calibrate")
    if organ.stiffening > 0.0 and not by_cells:
        raise UserError(
            f"organ '{organ.name}' stiffens (stiffening {organ.stiffening:g}), and springs have no such law; use model"
            " cells, which tissue_sim calibrate gives an organ"
        )
    if organ.stiffening > 0.0 and np.any(shape_gravity):
        raise UserError(
            f"organ '{organ.name}' stiffens (stiffening {organ.stiffening:g}), and its unloaded shape is not computed;"
            " use gravity 0, or shape_is_unloaded (shape_gravity [0, 0, 0])"
        )
    if organ.n_virtual and not by_cells:
        raise UserError(f"organ '{organ.name}' was cut, and springs would join what is apart; use model cells")
    n, n_surface = organ.n_nodes, organ.n_surface
    rest = np.ascontiguousarray(organ.rest_positions)
    mass, damping = organ.mass.copy(), organ.damping.copy()
    if model == "volume":
        nodes, length, stiffness = _volume_springs(organ, rest)
    else:
        kept = np.full(len(organ.spring_nodes), not by_cells)
        if model == "surface":
            kept = organ.spring_kind == SpringKind.EDGE
        nodes = organ.spring_nodes[kept]
        length, stiffness = organ.spring_rest_length[kept], organ.spring_stiffness[kept]
    used = np.zeros(n, dtype=bool)
    used[(organ.cell_nodes if by_cells else nodes).ravel()] = True
    # The mass of nodes that a variant leaves out is added to those that it keeps.
    scale = mass.sum() / mass[used].sum()
    moving = used.copy()
    moving[organ.fixed] = False
    inverse_mass = np.where(moving, 1.0 / (mass * scale), 0.0)

    # A component without stiffness is left out, and costs nothing.
    on = stiffness > 0.0
    nodes, length, stiffness = nodes[on], length[on], stiffness[on]
    bending = (organ.angular_stiffness > 0.0) & (model in ("surface", "hybrid"))
    hinges = organ.angular_nodes[bending]
    weight, bent, normal = curvature_at_edges(rest, hinges)
    edges = organ.spring_nodes[organ.spring_kind == SpringKind.EDGE]
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    graph = (graph + graph.T).tocsr()
    graph.sort_indices()
    returning = np.flatnonzero(moving & (organ.return_stiffness > 0.0) & (not by_cells))
    cells, cell_volume = _real_cells(organ) if by_cells else _cells(organ)
    made = packed(
        Model(
            n_surface=n_surface,
            rest=rest,
            inverse_mass=inverse_mass,
            damping=damping * scale,
            moving=_ints(np.flatnonzero(moving)),
            free=free_nodes(organ),
            spring_first=_ints(nodes[:, 0]),
            spring_second=_ints(nodes[:, 1]),
            spring_rest_length=_floats(length),
            spring_stiffness=_floats(stiffness),
            angular_nodes=_ints(hinges),
            angular_weight=weight,
            angular_rest=bent,
            angular_stiffness=_floats(organ.angular_stiffness[bending]),
            angular_least_area=(LEAST_AREA * normal) ** 2,
            edges=empty_blocks(0, 4, 8),
            links=empty_blocks(0, 2, 2),
            return_nodes=_ints(returning),
            return_stiffness=organ.return_stiffness.copy(),
            damping_rate=float(damping[used].sum() / mass[used].sum()),
            cells=cells,
            cell_volume=cell_volume,
            neighbour_start=_ints(graph.indptr),
            neighbours=_ints(graph.indices),
            hops=NO_HOPS,
            adjacency=None,
            reduction=NO_REDUCTION,
            borne=np.zeros((0, 3)),
            shape_gravity=np.array(shape_gravity, dtype=np.float64),
            unloaded=rest,
            tissue=_tissue_of(organ, rest) if by_cells else None,
            work=aligned(np.zeros(9 * BLOCK)),
            lips=make_lips(),
            cut_cells=no_cut_cells(),
            relaxation=_relaxation_of(organ),
        )
    )
    if made.tissue is None:
        return made
    penalty = penalty_of(rest, organ.cell_nodes, inverse_mass, largest_frequency(made))
    tissue = with_penalty(made.tissue, penalty)
    set_step_limits(tissue.groups, _quickness(organ, inverse_mass))
    made = made._replace(tissue=tissue)
    if not made.shape_gravity.any():
        return made
    return _bearing(made, organ.cell_nodes, Law(organ.cell_mu, organ.cell_lambda, penalty))


def _tissue_of(organ: Organ, rest: Floats) -> Tissue:
    """Return the organ's cells with their own law."""
    stiffening = organ.stiffening * organ.cell_stiffening
    return tissue_of(rest, organ.cell_nodes, organ.cell_mu, organ.cell_lambda, stiffening)


def _quickness(organ: Organ, inverse_mass: Floats) -> Floats:
    """Return the ratio of the cells' stiffness to the mass at each node (n,), relative to the largest ratio."""
    slope, volume = shapes_of(organ.rest_positions, organ.cell_nodes)
    stiff = np.einsum("cax,cax->ca", slope, slope) * (volume * (4.0 * organ.cell_mu + organ.cell_lambda))[:, None]
    rate: Floats = np.bincount(organ.cell_nodes.ravel(), stiff.ravel(), organ.n_nodes) * inverse_mass
    return rate / max(float(rate.max()), 1e-300)


def _relaxation_of(organ: Organ) -> Floats:
    """Return the rate 1/T, 1/s, and g / (1 - g) of tissue that relaxes, (2,); (0,) of elastic tissue."""
    fraction = organ.relaxation_fraction
    return np.array([1.0 / organ.relaxation_time, fraction / (1.0 - fraction)]) if fraction > 0.0 else np.zeros(0)


def _bearing(model: Model, cells: Ints, law: Law) -> Model:
    """Return the model with cells of the unloaded shape, whose nodes bear their weight in the rest shape."""
    free = model.inverse_mass > 0.0
    weight = np.zeros_like(model.rest)
    weight[free] = model.shape_gravity / model.inverse_mass[free, None]
    unloaded = unloaded_shape(model.rest, cells, law, weight, free)
    bearing = model._replace(
        unloaded=unloaded, tissue=with_penalty(tissue_of(unloaded, cells, law.mu, law.lam), law.penalty)
    )
    pushed = np.zeros_like(weight)
    elastic_forces(bearing, model.rest, 1.0, pushed)
    return bearing._replace(borne=-pushed)


def model_of(organ: Organ) -> ModelName:
    """Return the variant for which an organ was made: cells if it has them, otherwise hybrid.

    Parameters
    ----------
    organ : Organ
        The organ.
    """
    return "cells" if len(organ.cell_nodes) else "hybrid"


def packed(model: Model) -> Model:
    """Return the model with its springs packed again for the kernels, after spring_* or angular_* were replaced."""
    n = len(model.rest)
    springs = np.sort(np.stack([model.spring_first, model.spring_second], axis=1).astype(np.int64), axis=1)
    keys, order = np.unique(springs[:, 0] * n + springs[:, 1], return_index=True)
    ends = np.sort(model.angular_nodes[:, :2].astype(np.int64), axis=1)
    wanted = ends[:, 0] * n + ends[:, 1]
    place = np.minimum(np.searchsorted(keys, wanted), max(len(keys) - 1, 0))
    found = keys[place] == wanted if len(keys) else np.zeros(len(wanted), dtype=bool)
    axial = np.full(len(wanted), -1)
    axial[found] = order[place[found]]
    values = np.zeros((len(wanted), 8))
    values[:, 6] = 1.0  # 1/m, of edges without an axial spring
    values[:, 0:3] = model.angular_weight[:, 1:]
    values[:, 3], values[:, 4] = model.angular_rest, model.angular_stiffness
    values[:, 5] = model.angular_least_area
    values[found, 6] = 1.0 / model.spring_rest_length[axial[found]]
    values[found, 7] = model.spring_stiffness[axial[found]]
    others = np.setdiff1d(np.arange(len(springs)), axial)
    pair = np.stack([model.spring_first, model.spring_second], axis=1)
    law = np.stack([1.0 / model.spring_rest_length, model.spring_stiffness], axis=1)
    filling = np.zeros(8)
    filling[[5, 6]] = 1.0  # lengths and areas that keep divisions finite
    return model._replace(
        edges=pack(model.angular_nodes, values, filling),
        links=pack(pair[others], law[others], np.array([1.0, 0.0])),
    )


def _real_cells(organ: Organ) -> tuple[Ints, Floats]:
    """Return the cells (c, 4) of the tissue, oriented as for the guard, and their volumes (c,) m^3 at rest."""
    return _ints(organ.cell_nodes[:, [1, 0, 2, 3]]), _floats(shapes_of(organ.rest_positions, organ.cell_nodes)[1])


def _cells(organ: Organ) -> tuple[Ints, Floats]:
    """Return tetrahedra (c, 4) of every triangle and its nearest medial atom, of positive volume (c,) m^3 at rest.

    Cells over which the surface folds at rest are left out.
    """
    x, triangles = organ.rest_positions, organ.surface_triangles
    if organ.n_atoms == 0:
        return _ints(np.zeros((0, 4))), np.zeros(0)
    atom = organ.n_surface + nearest_atoms(x[triangles].mean(axis=1), organ.atom_positions, 1)[0]
    cells = np.concatenate([triangles, atom], axis=1)
    a, b, c, d = (x[cells[:, k]] for k in range(4))
    volume = np.einsum("ck,ck->c", a - d, np.cross(b - d, c - d)) / 6.0
    sound = volume > LEAST_CELL * volume.mean()
    return _ints(cells[sound]), _floats(volume[sound])


def _ints(values: ArrayLike) -> Ints:
    return np.array(values, dtype=np.int32, order="C")


def _floats(values: ArrayLike) -> Floats:
    return np.array(values, dtype=np.float64, order="C")


def curvature_at_edges(rest: Floats, hinges: Ints) -> tuple[Floats, Floats, Floats]:
    """Return mean curvature normals at edges (Bergou et al. 2006, the operator of their section 3).

    hinges (h, 4): edge i, j and opposite corners k, l. The result is the weights (h, 4) of the four nodes, the
    curvature s0 (h,) m of the rest shape along the pair's normal, and the length of the unnormalised normal e x (x_k -
    x_l), (h,) m^2.
    """
    i, j, k, m = (rest[hinges[:, c]] for c in range(4))
    at_i, at_j = [_cotangent(j - i, corner - i) for corner in (k, m)], [_cotangent(i - j, c - j) for c in (k, m)]
    weight = np.stack([at_j[0] + at_j[1], at_i[0] + at_i[1], -at_i[0] - at_j[0], -at_i[1] - at_j[1]], axis=1)
    normal = np.cross(j - i, k - m)
    length = np.linalg.norm(normal, axis=1)
    bent = np.einsum("hc,hcx->hx", weight, rest[hinges])
    return weight, np.einsum("hx,hx->h", bent, normal) / length, length


def _cotangent(a: Floats, b: Floats) -> Floats:
    return np.einsum("hx,hx->h", a, b) / np.linalg.norm(np.cross(a, b), axis=1)


def _volume_springs(organ: Organ, rest: Floats) -> tuple[Ints, Floats, Floats]:
    """Return springs on the edges of a tetrahedral mesh, k = E sum(V)/l^2 (Van Gelder 1998).

    These are Delaunay tetrahedra with their centroid inside the surface; surface edges that they lack are added with
    the stiffness of the hybrid model's edge springs.
    """
    if organ.n_nodes == organ.n_surface:
        raise UserError(f"organ '{organ.name}' has no interior points, which the volume model needs; use --atoms")
    pairs, parts, _ = tetrahedral_edges(rest, organ.surface_positions, organ.surface_triangles)
    edge_springs = organ.spring_kind == SpringKind.EDGE
    surface_pairs = organ.spring_nodes[edge_springs].astype(np.int64)
    both = np.sort(np.concatenate([pairs, surface_pairs]), axis=1)
    unique, inverse = np.unique(both, axis=0, return_inverse=True)
    part = np.bincount(inverse.ravel()[: len(pairs)], weights=parts, minlength=len(unique))
    length = np.linalg.norm(rest[unique[:, 0]] - rest[unique[:, 1]], axis=1)
    stiffness = organ.youngs_modulus * part / length**2
    missed = part == 0.0
    shell = np.zeros(len(unique))
    shell[inverse.ravel()[len(pairs) :]] = organ.spring_stiffness[edge_springs]
    return _ints(unique), length, np.where(missed, shell, stiffness)
