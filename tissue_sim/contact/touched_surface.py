"""The surface that tools touch: of an organ, with its nodes as points, or of a cut organ, with its walls."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tissue_sim.array_types import Floats, Ints, Longs, Mask
from tissue_sim.contact.local_compliance import local_compliance
from tissue_sim.jit import kernel
from tissue_sim.model.cutting.cut import CutOrgan
from tissue_sim.model.cutting.cut_surface import CutSurface
from tissue_sim.model.data.contact_set import POINT_NODES
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.inclusions import inclusions_of, stiffness_at
from tissue_sim.organ.normals import triangle_area
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.topology import node_area

NEIGHBOURS = 3  # nearest nodes of the uncut surface, from which the compliance of a new point is computed
MIN_FACTOR, MAX_FACTOR = 0.25, 25.0  # limits of the factor on a new point's compliance for its area


class TouchedSurface:
    """Points that tools touch, and the nodes between which they lie.

    Contact points lie in triangles, and forces act on nodes. In an uncut organ these are the triangles' corners. At a
    cut, corners lie on edges of cells, those of a triangle on edges of one cell, between whose nodes a point lies.

    Parameters
    ----------
    organ : Organ
        The organ; its surface is that of the uncut one.
    cut : CutSurface | None, optional
        Its surface after cuts; None before.
    """

    def __init__(self, organ: Organ, cut: CutSurface | None = None) -> None:
        self.organ, self.n_surface = organ, organ.n_surface
        self.is_cut = cut is not None
        cut = _of_nodes(organ) if cut is None else cut
        self.triangles = np.ascontiguousarray(cut.triangles)
        self.n_points = len(cut.nodes)
        self.is_outer: Mask = cut.wall == 0  # (t,)
        # (t,) whether a triangle is one of the uncut surface; new ones at a cut have other edges and areas.
        self.is_old: Mask = self.is_outer & (self.triangles < organ.n_surface).all(axis=1)
        self._nodes, self._weights = cut.nodes, cut.weights
        self.partner: Longs = cut.partner  # (p,) the point on the other side of a cut, or itself
        self._cell, self._fraction = np.zeros((0, POINT_NODES), dtype=np.int64), np.zeros((0, 3, POINT_NODES))
        # (t,) triangles over more than one cell, where the mesh lacks flat cells: only their corners are touched.
        self.is_loose: Mask = np.zeros(len(self.triangles), dtype=bool)
        if self.is_cut:
            self._cell, self._fraction, self.is_loose = _cells_under(self.triangles, cut)
        self._points = np.zeros((self.n_points, 3))
        self.rest: Floats = self.at(organ.rest_positions).copy()  # (p, 3) m; (n, 3) if all nodes are the points

    @classmethod
    def of(cls, touched: Organ | CutOrgan | Simulation | TouchedSurface) -> TouchedSurface:
        """Return the present surface of an organ.

        Parameters
        ----------
        touched : Organ | CutOrgan | Simulation | TouchedSurface
            An organ, one after cuts, or a simulation of either.
        """
        if isinstance(touched, TouchedSurface):
            return touched
        if isinstance(touched, Simulation):
            touched = touched.cut_organ or touched.organ
        return cls(touched.organ, touched.surface) if isinstance(touched, CutOrgan) else cls(touched)

    @property
    def old_triangles(self) -> Longs:
        """Triangles (k, 3) of nodes that no cut has split."""
        return np.ascontiguousarray(self.triangles[self.is_old], dtype=np.int64)

    def at(self, position: Floats) -> Floats:
        """Return the positions of the points; the next call overwrites them.

        Parameters
        ----------
        position : Floats, shape (n, 3), m
            Positions of all nodes.

        Returns
        -------
        Floats, shape (p, 3), m
            The points; for an uncut organ the nodes themselves.
        """
        if not self.is_cut:
            return position
        _place(position, self._nodes, self._weights, self.n_surface, self._points)
        return self._points

    def nodes_of(self, points: Longs) -> tuple[Longs, Floats]:
        """Return the nodes between which points of a cut surface lie, and their weights, shape (k, POINT_NODES) each.

        Parameters
        ----------
        points : Longs, shape (k,)
            Indices of the points.
        """
        return self._nodes[points], self._weights[points]

    def between(self, triangle: Longs, corners: Longs, weight: Floats) -> tuple[Longs, Floats]:
        """Return the nodes between which places in triangles lie.

        Parameters
        ----------
        triangle : Longs, shape (k,)
            Indices of the triangles; -1 for a corner itself, the first one given.
        corners : Longs, shape (k, 3)
            Points that are the triangles' corners.
        weight : Floats, shape (k, 3)
            Barycentric weights.

        Returns
        -------
        tuple[Longs, Floats]
            Nodes and their weights, shape (k, POINT_NODES) each.
        """
        nodes, weights = np.empty((len(corners), POINT_NODES), dtype=np.int64), np.zeros((len(corners), POINT_NODES))
        nodes[:, :3], nodes[:, 3], weights[:, :3] = corners, corners[:, 0], weight
        if not self.is_cut:
            return nodes, weights
        point = corners[:, 0].copy()
        loose = (triangle >= 0) & self.is_loose[triangle]
        nearest = np.argmax(weight[loose], axis=1)
        point[loose] = corners[loose, nearest]
        single = (triangle < 0) | loose
        made = single & (point >= self.n_surface)
        nodes[made], weights[made] = self._nodes[point[made]], self._weights[point[made]]
        plain = single & ~made
        nodes[plain], weights[plain] = point[plain, None], (1.0, 0.0, 0.0, 0.0)
        inner = ~single & ~self.is_old[triangle]
        nodes[inner] = self._cell[triangle[inner]]
        weights[inner] = np.einsum("kc,kcn->kn", weight[inner], self._fraction[triangle[inner]])
        return nodes, weights

    def compliance(self, smallest: float) -> Floats:
        """Return the compliance of the area of each point, along the normal and across it; see local_compliance.

        A new point has the compliance of the nearest nodes of the uncut surface, due to the stiffness of the tissue
        there; the ratio of its area to theirs is a separate factor, see area_factors.

        Parameters
        ----------
        smallest : float, m
            Smallest radius of the tool.

        Returns
        -------
        Floats, shape (p, 2), m/N
            Compliance.
        """
        found = local_compliance(self.organ, smallest)
        if not self.is_cut:
            return found
        parts = inclusions_of(self.organ)
        own = found * stiffness_at(parts, self.organ.surface_positions)[:, None]
        more = self._from_nodes(own) / stiffness_at(parts, self.rest[self.n_surface :])[:, None]
        return np.concatenate([found, more])

    def area_factors(self) -> tuple[Floats, Floats]:
        """Return the factors on the compliance in triangles, (t,), and at points, (p,), relative to the uncut surface.

        Triangles at a cut are smaller than those of the uncut surface, so that the same number of contact points bears
        the force on a smaller area. Elsewhere the factors are 1.
        """
        triangle, point = np.ones(len(self.triangles)), np.ones(self.n_points)
        if not self.is_cut:
            return triangle, point
        usual = node_area(self.organ.surface_positions, self.organ.surface_triangles)
        usual = np.concatenate([usual, self._from_nodes(usual[:, None])[:, 0]])
        least = 1e-9 * float(usual.mean())
        new = ~self.is_old
        own = node_area(self.rest, self.triangles)
        area = triangle_area(self.rest, self.triangles[new])
        # The area of an equilateral triangle is half of a node's.
        triangle[new] = usual[self.triangles[new]].mean(axis=1) / np.maximum(2.0 * area, least)
        touched = np.unique(self.triangles[new])
        point[touched] = usual[touched] / np.maximum(own[touched], least)
        return triangle.clip(MIN_FACTOR, MAX_FACTOR), point.clip(MIN_FACTOR, MAX_FACTOR)

    def _from_nodes(self, values: Floats) -> Floats:
        """Return values (n_surface, m) at the uncut surface's nodes, interpolated at the new points."""
        apart, node = cKDTree(self.organ.surface_positions).query(self.rest[self.n_surface :], k=NEIGHBOURS)
        fraction = 1.0 / np.maximum(apart, 1e-6)
        fraction /= fraction.sum(axis=1, keepdims=True)
        found: Floats = np.einsum("pk,pkm->pm", fraction, values[node])
        return found


def _of_nodes(organ: Organ) -> CutSurface:
    """Return the surface of an organ without cuts."""
    wall = np.zeros(len(organ.surface_triangles), dtype=np.int64)
    nodes = np.zeros((organ.n_surface, 0), dtype=np.int64)
    own = np.arange(organ.n_surface)
    return CutSurface(nodes, np.zeros(nodes.shape), organ.surface_triangles, wall, own, np.zeros_like(own))


def _cells_under(triangles: Ints, cut: CutSurface) -> tuple[Longs, Floats, Mask]:
    """Return the nodes (t, POINT_NODES) under triangles (t, 3), their corners' weights, and which need more nodes."""
    count = len(triangles)
    nodes, weights = np.zeros((count, POINT_NODES), dtype=np.int64), np.zeros((count, 3, POINT_NODES))
    loose = np.zeros(count, dtype=bool)
    for number, corners in enumerate(triangles):
        used = cut.weights[corners] != 0.0
        found = np.unique(cut.nodes[corners][used])
        loose[number] = len(found) > POINT_NODES
        if loose[number]:
            continue
        nodes[number] = np.concatenate([found, np.repeat(found[:1], POINT_NODES - len(found))])
        row, column = np.nonzero(used)
        place = np.searchsorted(found, cut.nodes[corners][row, column])
        np.add.at(weights[number], (row, place), cut.weights[corners][row, column])
    return nodes, weights, loose


@kernel
def _place(position: Floats, nodes: Longs, weights: Floats, own: int, points: Floats) -> None:
    """Write the positions of points (p, 3) m, of which the first `own` are nodes."""
    for point in range(own):
        for axis in range(3):
            points[point, axis] = position[point, axis]
    for point in range(own, len(points)):
        for axis in range(3):
            at = 0.0
            for k in range(nodes.shape[1]):
                at += weights[point, k] * position[nodes[point, k], axis]
            points[point, axis] = at
