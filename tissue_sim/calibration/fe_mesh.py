"""Tetrahedra that fill exactly the polyhedron of an organ's surface, small where the solution is steep."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator, Sequence
from functools import lru_cache
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tissue_sim.array_types import Array, Floats, Ints
from tissue_sim.errors import UserError
from tissue_sim.organ.edges import directed_edges
from tissue_sim.organ.organ import Organ

if TYPE_CHECKING:
    from skfem import MeshTet

MESHER_UNIT = 1e-3  # m; Netgen's tolerances are made for lengths around 1 to 1000
LONGEST = 1.5  # an element's longest edge over its size, which stands for the mean
MOST_PASSES = 60  # of refinement; every pass bisects
ON_PLANE = 1e-6  # of a triangle's size, within which a point lies on it


class Grading(NamedTuple):
    """Number of times that the surface's mean edge is halved, and growth of elements away from there.

    At an inclusion's surface it is halved as often as at the clamp's edge: stiffness jumps within elements there. The
    defaults are those of the figures of `reference`.
    """

    clamp: int = 1  # halvings at the clamp's edge, where the stress is singular
    near: int = 0  # halvings under the loads
    growth: float = 1.2  # an element's size over its distance from the clamp's edge or the loads
    whole: int = 0  # halvings of everything, after the others

    def finer(self) -> Grading:
        """Return a grading twice as fine at the clamp's edge and under the loads, growing more slowly from there."""
        return self._replace(clamp=self.clamp + 1, near=self.near + 1, growth=self.growth / 1.5)


class Source(NamedTuple):
    """Places around which elements are small."""

    places: Floats  # (p, 3) m
    size: float  # m, of elements there


class FeMesh(NamedTuple):
    """Quadratic tetrahedra inside an organ; the first nodes are the organ's surface nodes, in their order."""

    nodes: Floats  # (n, 3) m: corners, then the middles of edges
    elements: Ints  # (e, 10) four corners and the middles of edges 01, 12, 02, 03, 13, 23
    facets: Ints  # (f, 6) of the surface: three corners and the middles of edges 01, 12, 02
    triangle: Ints  # (f,) organ triangle in which each lies
    clamped: NDArray[np.bool_]  # (f,) whether that triangle is held


def fill(organ: Organ, near: Array | None = None, grading: Grading | None = None) -> FeMesh:
    """Fill the organ's surface with tetrahedra, graded at the clamp's edge, under loads, and at inclusions.

    Netgen keeps surface nodes and triangles as they are; refinement then bisects longest edges (skfem). At the clamp's
    edge the mid-edge nodes are moved to quarter points. The same organ gives the same mesh.

    Parameters
    ----------
    organ : Organ
        The organ.
    near : Array | None, shape (k,), optional
        Surface nodes under loads; None for none.
    grading : Grading | None, optional
        Sizes of the elements; None for the usual ones.

    Raises
    ------
    UserError
        Where nothing is clamped, or Netgen can't fill the surface.
    """
    grading = Grading() if grading is None else grading
    positions, triangles = organ.surface_positions, organ.surface_triangles
    held = clamped_triangles(organ)
    mesh = graded(organ, sources_of(organ, near, grading), grading)
    nodes, elements = quadratic(mesh)
    corners = mesh.facets[:, mesh.boundary_facets()].T.astype(np.int32)
    triangle = parents(mesh.p.T[corners], positions[triangles])
    clamped = held[triangle]
    pairs = mesh.edges.T
    front = np.zeros(mesh.p.shape[1], dtype=bool)
    front[np.intersect1d(corners[clamped], corners[~clamped])] = True
    to_quarter_points(nodes, pairs, front)
    return FeMesh(nodes, elements, with_middles(corners, pairs, len(front)), triangle, clamped)


def with_middles(corners: Ints, pairs: Ints, n: int) -> Ints:
    """Return quadratic facets (f, 6) of linear ones (f, 3), given the edges (k, 2) whose middles follow n corners."""
    middles = n + _rows(pairs, corners[:, [[0, 1], [1, 2], [0, 2]]], n)
    return np.concatenate([corners, middles], axis=1).astype(np.int32)


def quadratic(mesh: MeshTet) -> tuple[Floats, Ints]:
    """Return the nodes (n, 3) m and quadratic elements (e, 10) of a skfem.MeshTet, its own points first."""
    skfem, _ = libraries()
    basis = skfem.CellBasis(mesh, skfem.ElementTetP2(), intorder=1)
    nodes = np.ascontiguousarray(basis.doflocs.T)
    nodes[: mesh.p.shape[1]] = mesh.p.T  # without the mapping's rounding
    return nodes, np.ascontiguousarray(basis.element_dofs.T.astype(np.int32))


def to_quarter_points(nodes: Floats, pairs: Ints, front: NDArray[np.bool_]) -> None:
    """Move the midpoints of edges (k, 2) that leave the front to a quarter of their length.

    There a quadratic element represents the square root of the distance, as displacements behave where a clamp ends
    (Barsoum 1976; tetrahedra: Nejati, Paluszny & Zimmerman 2015). It replaces two to three halvings.
    """
    first, second = front[pairs[:, 0]], front[pairs[:, 1]]
    for leaving, near_end in ((first & ~second, 0), (second & ~first, 1)):
        edges = np.flatnonzero(leaving)
        here, there = nodes[pairs[edges, near_end]], nodes[pairs[edges, 1 - near_end]]
        nodes[len(front) + edges] = 0.75 * here + 0.25 * there


def _rows(pairs: Ints, wanted: Ints, n: int) -> Ints:
    """Return which row of `pairs` (k, 2) each of `wanted` (..., 2) is; either end first."""

    def keys(ends: Ints) -> NDArray[np.int64]:
        ends = np.sort(ends.astype(np.int64), axis=-1)
        found: NDArray[np.int64] = ends[..., 0] * n + ends[..., 1]
        return found

    known = keys(pairs)
    order = np.argsort(known)
    return order[np.searchsorted(known, keys(wanted), sorter=order)].astype(np.int32)


def sources_of(organ: Organ, near: Array | None, grading: Grading) -> list[Source]:
    """Return where elements are small: along the clamp's edge, under loads on some nodes (k,), and at inclusions."""
    positions, triangles = organ.surface_positions, organ.surface_triangles
    edge = float(np.linalg.norm(positions[triangles[:, 0]] - positions[triangles[:, 1]], axis=1).mean())
    least = edge / 2.0**grading.clamp
    sources = [Source(_along(positions, clamp_edges(triangles, clamped_triangles(organ)), 0.5 * least), least)]
    if near is not None and len(near):
        loaded = np.isin(triangles, near).any(axis=1)
        inside = np.concatenate([positions[triangles[loaded]].mean(axis=1), positions[np.asarray(near)]])
        sources.append(Source(inside, edge / 2.0**grading.near))
    if len(organ.inclusion_positions):
        sources.append(Source(organ.inclusion_positions, least))
    return sources


def graded(organ: Organ, sources: Sequence[Source], grading: Grading) -> MeshTet:
    """Return Netgen's mesh with its longest edges bisected until no element is too large, a skfem.MeshTet.

    Parameters
    ----------
    organ : Organ
        The organ.
    sources : Sequence[Source]
        Where elements are small.
    grading : Grading
        Their growth from there, and halvings of all.

    Raises
    ------
    UserError
        Where Netgen can't fill the surface.
    """
    skfem, _ = libraries()
    points, cells = _tetrahedra(organ)
    mesh = skfem.MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(cells.T))
    trees = [(cKDTree(source.places), source.size) for source in sources if len(source.places)]
    for _ in range(MOST_PASSES):
        corners = mesh.p.T[mesh.t.T]
        longest = np.zeros(len(corners))
        for a, b in ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)):
            longest = np.maximum(longest, np.linalg.norm(corners[:, a] - corners[:, b], axis=1))
        wanted = np.full(len(corners), np.inf)
        for tree, size in trees:
            distance = tree.query(corners.mean(axis=1))[0]
            wanted = np.minimum(wanted, LONGEST * np.maximum(size, grading.growth * distance))
        marked = np.flatnonzero(longest > wanted)
        if not len(marked):
            break
        with quiet():
            mesh = mesh.refined(marked)
    with quiet():
        return mesh.refined(grading.whole)


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Silence skfem's remarks on the layout of arrays while entered."""
    logger = logging.getLogger("skfem")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


def libraries() -> tuple[ModuleType, ModuleType]:
    """Return the modules skfem and netgen.meshing.

    Raises
    ------
    UserError
        Where one is missing.
    """
    try:
        import skfem
    except ImportError:
        raise UserError("the finite-element reference needs skfem: pip install 'tissue_sim[calibration]'") from None
    try:
        from netgen import meshing
    except ImportError:
        raise UserError("the finite-element reference needs netgen: pip install 'tissue_sim[calibration]'") from None
    return skfem, meshing


def clamped_triangles(organ: Organ) -> NDArray[np.bool_]:
    """Return which triangles (t,) are held: those all of whose nodes are fixed.

    Raises UserError where there is none.
    """
    fixed = np.zeros(organ.n_surface, dtype=bool)
    fixed[organ.fixed] = True
    held: NDArray[np.bool_] = fixed[organ.surface_triangles].all(axis=1)
    if not held.any():
        raise UserError(
            f"organ '{organ.name}': no triangle has all its nodes fixed, so nothing holds the solid; build it with"
            " --fixed, such as --fixed 'z<0.1'"
        )
    return held


def clamp_edges(triangles: Ints, held: NDArray[np.bool_]) -> Ints:
    """Return the edges (k, 2) between a held triangle and a free one."""
    mine = np.sort(directed_edges(triangles[held]), axis=1)
    others = np.sort(directed_edges(triangles[~held]), axis=1)
    n = int(triangles.max()) + 1
    ours, theirs = (pairs[:, 0].astype(np.int64) * n + pairs[:, 1] for pairs in (mine, others))
    found = np.intersect1d(ours, theirs)
    return np.stack([found // n, found % n], axis=1).astype(np.int32)


def _along(positions: Floats, edges: Ints, apart: float) -> Floats:
    """Return points (p, 3) along edges (k, 2), no farther than `apart` from one another."""
    if not len(edges):
        return np.zeros((0, 3))
    a, b = positions[edges[:, 0]], positions[edges[:, 1]]
    count = int(np.ceil(np.linalg.norm(b - a, axis=1).max() / apart)) + 1
    fraction = np.linspace(0.0, 1.0, count)[None, :, None]
    return (a[:, None] * (1.0 - fraction) + b[:, None] * fraction).reshape(-1, 3)


def _tetrahedra(organ: Organ) -> tuple[Floats, Ints]:
    """Return points (p, 3) m, the surface nodes first, and tetrahedra (c, 4) of Netgen's mesh inside the surface."""
    try:
        points, cells = _meshed(organ.surface_positions.tobytes(), organ.surface_triangles.tobytes())
    except _Unfilled as error:
        raise UserError(f"organ '{organ.name}': Netgen can't fill the surface ({error}); remesh it") from None
    return points.copy(), cells.copy()


class _Unfilled(Exception):
    """Error with Netgen's reason."""


@lru_cache(maxsize=8)
def _meshed(positions: bytes, triangles: bytes) -> tuple[Floats, Ints]:
    """Return Netgen's mesh of a surface, given as bytes: bodies of several gradings and materials share one."""
    _, meshing = libraries()
    meshing.SetMessageImportance(0)
    surface = np.frombuffer(positions).reshape(-1, 3)
    mesh = meshing.Mesh(3)
    points = [mesh.Add(meshing.MeshPoint(meshing.Pnt(*(x / MESHER_UNIT)))) for x in surface]
    mesh.Add(meshing.FaceDescriptor(surfnr=1, domin=1, domout=0, bc=1))
    for triangle in np.frombuffer(triangles, dtype=np.int32).reshape(-1, 3):
        mesh.Add(meshing.Element2D(1, [points[node] for node in triangle]))
    try:
        mesh.GenerateVolumeMesh()
    except Exception as error:  # Netgen's own exception type
        raise _Unfilled(str(error).strip().splitlines()[0] if str(error).strip() else "no reason given") from None
    found = mesh.Coordinates() * MESHER_UNIT
    cells = np.array([[vertex.nr - 1 for vertex in cell.vertices] for cell in mesh.Elements3D()], dtype=np.int32)
    if not len(cells):
        raise _Unfilled("it may intersect itself")
    found[: len(surface)] = surface  # as they were, without the rounding of the unit
    return found, cells


def parents(small: Floats, large: Floats) -> Ints:
    """Return for each small triangle (f, 3, 3) m the large one (t, 3, 3) of which it is a part.

    Raises UserError where one lies in none.
    """
    middle = small.mean(axis=1)
    reach = min(24, len(large))
    candidates = cKDTree(large.mean(axis=1)).query(middle, k=reach)[1].reshape(len(middle), reach)
    a, b, c = (large[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    double = np.linalg.norm(normal, axis=1)
    parent = np.full(len(middle), -1, dtype=np.int32)
    for column in candidates.T:
        open_ = np.flatnonzero(parent < 0)
        if not len(open_):
            break
        t = column[open_]
        fraction = coordinates(middle[open_], large[t])
        height = np.abs(np.einsum("fx,fx->f", middle[open_] - a[t], normal[t])) / double[t] ** 1.5
        inside = (fraction.min(axis=1) > -ON_PLANE) & (height < ON_PLANE)
        parent[open_[inside]] = t[inside]
    if np.any(parent < 0):
        raise UserError("the tetrahedra do not follow the organ's surface; remesh it")
    return parent


def coordinates(points: Floats, triangles: Floats) -> Floats:
    """Return the barycentric coordinates of points in the planes of triangles.

    Parameters
    ----------
    points : Floats, shape (f, 3), m
        Points.
    triangles : Floats, shape (f, 3, 3), m
        Corners of a triangle for each point.

    Returns
    -------
    Floats, shape (f, 3)
        Coordinates.
    """
    a, b, c = (triangles[:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    square = np.einsum("fx,fx->f", normal, normal)
    at_b = np.einsum("fx,fx->f", np.cross(points - a, c - a), normal) / square
    at_c = np.einsum("fx,fx->f", np.cross(b - a, points - a), normal) / square
    return np.stack([1.0 - at_b - at_c, at_b, at_c], axis=1)
