"""What a model consists of: the arrays that the kernels read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.model.data.blades import CutCells
from tissue_sim.model.data.blocks import Blocks
from tissue_sim.model.data.lips import Lips


class CellGroups(NamedTuple):
    """Cell groups in blocks; filling, groups and cells in them, has no stiffness."""

    nodes: Ints  # (f, BLOCK, 6)
    constants: Floats  # (f, cell_groups.CONSTANTS BLOCK)
    stiffening: Floats  # (f, stiffening.ROWS BLOCK) of groups that stiffen; (0, stiffening.ROWS BLOCK): neo-Hookean
    cells: Longs  # (f BLOCK, CELLS) which cell each is, -1 where one only fills up


class Tissue(NamedTuple):
    """Cells as the kernels read them, in blocks, and working memory."""

    nodes: Ints  # (b, BLOCK, 4)
    constants: Floats  # (b, cells.CONSTANTS BLOCK)
    groups: CellGroups  # the same cells as the whole organ takes them
    rows: Floats  # (n, ROW) of each node its position, m, and what cells push it with, N
    work: Floats  # (ROOM BLOCK,)
    # (f BLOCK CELLS,) places among the groups' cells of those under COMPRESSED in blocks with one under STIFF, as the
    # last forces of the whole organ found them; and (1,) how many. Of some cells: not 0 where these found stiff ones.
    compressed_cells: Longs
    stiff: Longs
    shortening: Longs  # (1,) factor on the substeps that groups which have stiffened require, by these forces


class Adjacency(NamedTuple):
    """Springs or cells of each node, as compressed rows."""

    edge_start: Ints  # (n + 1,)
    edges: Ints  # slots in Model.edges, block after block
    link_start: Ints  # (n + 1,)
    links: Ints  # slots in Model.links
    cell_start: Ints  # (n + 1,)
    cells: Ints  # slots in Model.tissue


class Reduction(NamedTuple):
    """Data of a modal region about the rest of the organ; empty without one."""

    frequency: Floats  # (m,) rad/s of the lowest modes
    shape: Floats  # (n, 3, m) 1/sqrt(kg)
    peak: Floats  # (m,) the shapes' largest components
    compliance: NDArray[np.float32]  # (3n, 3n) m/N of the model about rest; (0, 0) when it would be too large
    edge_slopes: Floats  # (b, 21 BLOCK) what forces.subtract_linear_edges takes
    link_slopes: Floats  # (b, 6 BLOCK) what forces.subtract_linear_springs takes
    cell_slopes: Floats  # (b, SLOPES BLOCK) what cells.subtract_linear_cells takes


class Model(NamedTuple):
    """Constants of one model variant, as the kernels read them. Shapes: n nodes, s springs, h angular springs."""

    n_surface: int
    rest: Floats  # (n, 3) m
    inverse_mass: Floats  # (n,) 1/kg, 0 where held or not part of the variant
    damping: Floats  # (n,) kg/s
    moving: Ints  # (a,) nodes with mass
    free: Longs  # (n,) 1 for nodes of pieces that were cut off and that nothing holds; (0,): no piece is free
    spring_first: Ints  # (s,)
    spring_second: Ints  # (s,)
    spring_rest_length: Floats  # (s,) m
    spring_stiffness: Floats  # (s,) N/m
    angular_nodes: Ints  # (h, 4)
    angular_weight: Floats  # (h, 4) of the mean curvature normal
    angular_rest: Floats  # (h,) m
    angular_stiffness: Floats  # (h,) N/m
    angular_least_area: Floats  # (h,) m^4
    edges: Blocks  # axial and angular springs of the edges between two triangles, as the kernels take them
    links: Blocks  # all other springs
    return_nodes: Ints  # (r,) nodes with a return spring
    return_stiffness: Floats  # (n,) N/m, of springs to the rest positions
    damping_rate: float  # 1/s, nodal damping over mass, the mean
    cells: Ints  # (c, 4) what is inside: the tissue's cells, or tetrahedra of a triangle and its nearest medial atom
    cell_volume: Floats  # (c,) m^3 at rest
    neighbour_start: Ints  # (n + 1,) compressed rows of the surface edges' graph, for hop distances
    neighbours: Ints
    hops: NDArray[np.uint8]  # (n_surface, n_surface) hop distances, or (0, 0): searched on demand
    adjacency: Adjacency | None  # None: without a local region
    reduction: Reduction
    borne: Floats  # (n, 3) N that holds the rest shape of cells against what they push there; (0, 3): nothing does
    shape_gravity: Floats  # (3,) m/s^2, that the rest shape is the shape under
    unloaded: Floats  # (n, 3) m, shape of the cells without it
    tissue: Tissue | None  # of cells; None: springs
    work: Floats  # (9 BLOCK,) buffer of the force kernels
    lips: Lips  # of cuts
    cut_cells: CutCells  # in which blades find their places; none where no blade can be
    relaxation: Floats  # (2,) rate 1/T, 1/s, and g / (1 - g) of tissue that relaxes; (0,): elastic
