"""Quadratic neo-Hookean finite elements of an organ that hold a cut, with and without contact of its lips."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tissue_sim.array_types import Floats, Ints, Longs, Mask
from tissue_sim.bench.cutting.lip_contact import Lips, TouchingSolid
from tissue_sim.bench.cutting.split_mesh import Opened, opened, split
from tissue_sim.calibration.fe_mesh import (
    FeMesh,
    Grading,
    Source,
    clamped_triangles,
    graded,
    libraries,
    parents,
    quadratic,
    sources_of,
    to_quarter_points,
    with_middles,
)
from tissue_sim.calibration.fem import load_matrix
from tissue_sim.calibration.solid import Equilibrium, Material
from tissue_sim.model.cutting.sheet import Sheet
from tissue_sim.organ.inclusions import inclusions_of, stiffness_at
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.surfaces.sizing import mean_edge

SAMPLES = 41  # places along the lips at which the opening is compared


class Sizes(NamedTuple):
    """Sizes of the elements at a cut, in mean edges of the surface, and elsewhere."""

    sheet: float
    front: float
    grading: Grading


COARSE = Sizes(0.8, 0.6, Grading(clamp=0, growth=2.0))
FINE = Sizes(0.55, 0.4, Grading())


class Answer(NamedTuple):
    """Response of finite elements or of the real-time model to a load."""

    displacement: Floats  # (n_surface, 3) m
    opening: Floats  # (SAMPLES, 3) m, of the positive lip relative to the negative one, along the cut
    settled: bool
    closed: float = 0.0  # m by which the lips would pass through each other, where that is most


class CutBody:
    """Organ with a cut as a solid of quadratic tetrahedra, held at the triangles whose nodes are all fixed.

    At the front of the cut, as at the clamp's edge, the middles of edges are moved to quarter points (Barsoum 1976).

    parted: whether the cut is open (the same mesh without it is that of the uncut organ). Raises UserError as fill
    does.
    """

    def __init__(self, organ: Organ, sheet: Sheet, sizes: Sizes = COARSE, *, parted: bool = True) -> None:
        self.organ, self.sheet = organ, sheet
        made = _mesh(organ, sheet, sizes, parted)
        skfem, _ = libraries()
        mesh = skfem.MeshTet(np.ascontiguousarray(made.points.T), np.ascontiguousarray(made.cells.T))
        nodes, elements = quadratic(mesh)
        n, pairs = len(made.points), mesh.edges.T
        corners = mesh.facets[:, mesh.boundary_facets()].T.astype(np.int32)
        corners = corners[~_are_walls(np.sort(made.original[corners], axis=1), made.walls, n)]
        triangle = parents(made.points[corners], organ.surface_positions[organ.surface_triangles])
        clamped = clamped_triangles(organ)[triangle]
        front = np.zeros(n, dtype=bool)
        front[np.intersect1d(corners[clamped], corners[~clamped])] = True
        front[np.setdiff1d(np.unique(made.walls), np.concatenate([made.below, made.above]))] = True
        if not parted:
            front[np.unique(made.walls)] = False
        to_quarter_points(nodes, pairs, front)
        self.filling = FeMesh(nodes, elements, with_middles(corners, pairs, n), triangle, clamped)
        held = np.zeros((len(nodes), 3), dtype=bool)
        held[self.filling.facets[clamped].ravel()] = True
        inclusions = inclusions_of(organ)
        stiffness = partial(stiffness_at, inclusions) if inclusions else None
        material = Material(organ.youngs_modulus, organ.poisson_ratio, organ.density, organ.stiffening)
        self.solid = TouchingSolid(nodes, elements, held, material, stiffness)
        self.load_matrix = load_matrix(organ, self.filling, self._shut() if parted else None)
        self.lips = _lips(made, pairs, n) if parted else None
        self._at = self._lip_places(made) if parted else (np.zeros(0), np.zeros((0, 2), dtype=np.int64))

    @property
    def n_nodes(self) -> int:
        """Number of nodes, mid-edge nodes included."""
        return len(self.solid.nodes)

    def _shut(self) -> Mask:
        """Return for which facets (f, 3) corners of their triangle lie beyond the cut, so that no load passes."""
        corners = self.filling.nodes[self.filling.facets[:, :3]].mean(axis=1)
        place = self.sheet.place(corners)
        side = self.sheet.place(self.organ.surface_positions).across[
            self.organ.surface_triangles[self.filling.triangle]
        ]
        beyond = (side < 0.0) != (place.across < 0.0)[:, None]
        shut: Mask = beyond & self.sheet.covers(place)[:, None]
        return shut

    def _lip_places(self, made: Opened) -> tuple[Floats, Longs]:
        """Return where along the cut its lips have nodes (k,) m, and these (k, 2): below and above."""
        outer = np.zeros(len(made.points), dtype=bool)
        outer[np.unique(self.filling.facets[:, :3])] = True
        lip = outer[made.below] & outer[made.above]
        along = self.sheet.place(made.points[made.below[lip]]).along
        order = np.argsort(along)
        return along[order], np.stack([made.below[lip], made.above[lip]], axis=1)[order]

    def opening(self, displacement: Floats) -> Floats:
        """Return the opening (SAMPLES, 3) m along the lips for displacements (n, 3) m of all nodes."""
        along, nodes = self._at
        jump = displacement[nodes[:, 1]] - displacement[nodes[:, 0]]
        return sampled(self.sheet, along, jump)

    def loads(self, force: ArrayLike) -> Floats:
        """Return the nodal loads (n, 3) N of forces (n_surface, 3) N, of which each acts on its own side of the cut."""
        found: Floats = self.load_matrix @ np.asarray(force, dtype=np.float64)
        return found

    def linear(self, forces: Floats) -> list[Answer]:
        """Return the answers of linear elasticity to forces (c, n_surface, 3) N."""
        return [self._answer(one, True) for one in self.solid.solve(np.stack([self.loads(one) for one in forces]))]

    def settle_many(self, forces: Floats) -> Iterator[tuple[Answer, Floats]]:
        """Yield the neo-Hookean equilibria under forces (c, n_surface, 3) N, lips free, and all displacements."""
        for found in self.solid.settle_many([self.loads(one) for one in forces]):
            yield self._of(found), found.displacement

    def touching(self, force: Floats, start: Floats) -> Answer:
        """Return the equilibrium under forces (n_surface, 3) N with contact of the lips, from that without (n, 3) m."""
        assert self.lips is not None
        moved, settled = self.lips.settle(self.solid, self.loads(force), start)
        return self._answer(moved, settled)

    def _of(self, found: Equilibrium) -> Answer:
        return self._answer(found.displacement, found.converged)

    def _answer(self, moved: Floats, settled: bool) -> Answer:
        if self.lips is None:
            return Answer(moved[: self.organ.n_surface].copy(), np.zeros((SAMPLES, 3)), settled)
        closed = self.lips.penetration(self.solid.nodes, moved)
        return Answer(moved[: self.organ.n_surface].copy(), self.opening(moved), settled, closed)


def sampled(sheet: Sheet, along: Floats, jump: Floats) -> Floats:
    """Return the opening (SAMPLES, 3) m evenly along a cut, from that at some places (k,) m; 0 beyond its ends."""
    length = float(np.linalg.norm(np.diff(sheet.flat, axis=0), axis=1).sum())
    places = np.linspace(0.0, length, SAMPLES)
    ends = np.concatenate([[0.0], along, [length]])
    values = np.concatenate([np.zeros((1, 3)), jump, np.zeros((1, 3))])
    return np.stack([np.interp(places, ends, values[:, axis]) for axis in range(3)], axis=1)


def _mesh(organ: Organ, sheet: Sheet, sizes: Sizes, parted: bool) -> Opened:
    """Return the linear mesh that holds the cut."""
    edge = mean_edge(organ.surface_positions, organ.surface_triangles)
    within, front = _places(sheet, 0.5 * edge * min(sizes.sheet, sizes.front))
    sources = [
        *sources_of(organ, None, sizes.grading),
        Source(within, sizes.sheet * edge),
        Source(front, sizes.front * edge),
    ]
    mesh = graded(organ, sources, sizes.grading)
    still = np.zeros(mesh.p.shape[1], dtype=bool)
    still[: organ.n_surface] = True
    whole = split(np.ascontiguousarray(mesh.p.T), mesh.t.T, sheet, still)
    if parted:
        return opened(whole, sheet)
    none = np.zeros(0, dtype=np.int64)
    return Opened(whole.points, whole.cells, np.arange(len(whole.points)), whole.walls, none, none)


def _places(sheet: Sheet, spacing: float) -> tuple[Floats, Floats]:
    """Return points within a sheet, and along its front, about so far apart, m."""
    length = sheet.begins[-1]
    edge = sheet.top(np.linspace(0.0, length, int(np.ceil(length / spacing)) + 1))
    deep = np.linspace(0.0, sheet.depth, int(np.ceil(sheet.depth / spacing)) + 1)
    grid = edge[:, None] + deep[:, None] * sheet.direction
    front = np.concatenate([grid[:, -1], grid[0], grid[-1]])
    return grid.reshape(-1, 3), front


def _are_walls(faces: Longs, walls: Longs, n: int) -> Mask:
    """Return which faces (f,) of ascending corners are walls."""

    def keys(corners: Longs) -> Longs:
        corners = corners.astype(np.int64)
        found: Longs = (corners[:, 0] * n + corners[:, 1]) * n + corners[:, 2]
        return found

    return np.isin(keys(faces), keys(walls))


def _lips(made: Opened, pairs: Ints, n: int) -> Lips:
    """Return the two walls of a cut, each a list of quadratic facets whose nodes lie on those of the other."""
    below, above = np.arange(n, dtype=np.int32), np.arange(n, dtype=np.int32)
    below[made.original[made.below]] = made.below
    above[made.original[made.above]] = made.above
    lower, upper = (with_middles(node[made.walls], pairs, n).astype(np.int64) for node in (below, above))
    return Lips(lower, upper, made.points, made.cells)
