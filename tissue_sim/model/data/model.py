"""Arrays of a model, which the kernels read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.model.data.blades import CutCells
from tissue_sim.model.data.blocks import Blocks
from tissue_sim.model.data.lips import Lips


class CellGroups(NamedTuple):
    """Cell groups in blocks; groups and cells that pad the blocks have no stiffness."""

    nodes: Ints  # (f, BLOCK, 6)
    constants: Floats  # (f, cell_groups.CONSTANTS BLOCK)
    stiffening: Floats  # (f, stiffening.ROWS BLOCK) of groups that stiffen; (0, stiffening.ROWS BLOCK): neo-Hookean
    cells: Longs  # (f BLOCK, CELLS) index of each cell, -1 for padding


class Tissue(NamedTuple):
    """Cells as the kernels read them, in blocks, and working memory."""

    nodes: Ints  # (b, BLOCK, 4)
    constants: Floats  # (b, cells.CONSTANTS BLOCK)
    groups: CellGroups  # the same cells in groups, for the whole organ
    rows: Floats  # (n, ROW) position of each node, m, and the force of the cells on it, N
    work: Floats  # (ROOM BLOCK,)
    # (f BLOCK CELLS,) indices among the groups' cells of those below COMPRESSED in blocks with one below STIFF, as
    # found by the last forces of the whole organ; and (1,) their number. For a region: not 0 if its forces found stiff
    # cells.
    compressed_cells: Longs
    stiff: Longs
    shortening: Longs  # (1,) factor on the substeps that groups require which have stiffened, as found by these forces


class Adjacency(NamedTuple):
    """Springs or cells of each node, as compressed rows."""

    edge_start: Ints  # (n + 1,)
    edges: Ints  # slots in Model.edges, block after block
    link_start: Ints  # (n + 1,)
    links: Ints  # slots in Model.links
    cell_start: Ints  # (n + 1,)
    cells: Ints  # slots in Model.tissue


class Reduction(NamedTuple):
    """Data of a modal region that represent the rest of the organ; empty without such a region."""

    frequency: Floats  # (m,) rad/s of the lowest modes
    shape: Floats  # (n, 3, m) 1/sqrt(kg)
    peak: Floats  # (m,) the shapes' largest components
    compliance: NDArray[np.float32]  # (3n, 3n) m/N of the model about rest; (0, 0) when it would be too large
    edge_slopes: Floats  # (b, 21 BLOCK) for forces.subtract_linear_edges
    link_slopes: Floats  # (b, 6 BLOCK) for forces.subtract_linear_springs
    cell_slopes: Floats  # (b, SLOPES BLOCK) for cells.subtract_linear_cells


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
    cells: Ints  # (c, 4) tetrahedra inside: the tissue's cells, or those of a triangle and its nearest medial atom
    cell_volume: Floats  # (c,) m^3 at rest
    neighbour_start: Ints  # (n + 1,) compressed rows of the surface edges' graph, for hop distances
    neighbours: Ints
    hops: NDArray[np.uint8]  # (n_surface, n_surface) hop distances, or (0, 0) if they are searched on demand
    adjacency: Adjacency | None  # None: without a local region
    reduction: Reduction
    borne: Floats  # (n, 3) N, load that balances the forces of cells in the rest shape; (0, 3): none
    shape_gravity: Floats  # (3,) m/s^2, gravity under which the organ has its rest shape
    unloaded: Floats  # (n, 3) m, shape of the cells without it
    tissue: Tissue | None  # of cells; None: springs
    work: Floats  # (9 BLOCK,) buffer of the force kernels
    lips: Lips  # of cuts
    cut_cells: CutCells  # in which blades find their places; none if no blade can be there
    relaxation: Floats  # (2,) rate 1/T, 1/s, and g / (1 - g) of tissue that relaxes; (0,): elastic
