"""Contact search: finds a contact set for tool poses and a surface, by broad phase, FCL, and points under tips."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import fcl
import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.contact.broad_phase import (
    NearTriangles,
    PlacedBody,
    body_box,
    boxes_apart,
    boxes_meet,
    holds_node,
    nearest_node,
    surface_box,
    triangles_in_box,
)
from tissue_sim.contact.contact_lattice import (
    MAX_DIVISIONS,
    MAX_SPACING,
    MIN_DIVISIONS,
    divisions_of,
    fineness_of,
    lattices,
)
from tissue_sim.contact.contact_points import Fineness, FoundPoints, Search, points_near, set_compliance
from tissue_sim.contact.crossings import crossings_above
from tissue_sim.contact.local_compliance import OF_BALLS, OF_OTHERS, extra_compliance_between_nodes, max_yielding
from tissue_sim.contact.tools import MARGIN, SLACK, ToolSet
from tissue_sim.contact.touched_surface import TouchedSurface
from tissue_sim.contact.triangles import nearest_among, nearest_weights
from tissue_sim.model.contact.shapes import rotation_matrix
from tissue_sim.model.cutting.cut import CutOrgan
from tissue_sim.model.data.contact_set import MAX_CONTACT_POINTS, POINT_NODES, ContactSet, Engaged, contact_set
from tissue_sim.model.data.shapes import CONVEX, GRID, SPHERE
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.winding import inside

TISSUE_MOTION = 0.001  # m by which tissue may approach a tool before the next set; subtracted from the reach
OPEN_WIDTH = 1e-4  # m, least width of a cut into which a tool that has slipped is put back
TIP_REACH = 0.02  # m, largest distance from the tip at which an external force acts on the tissue
MAX_FOUND = 8 * MAX_CONTACT_POINTS  # points, per body
_ANY = fcl.CollisionRequest(num_max_contacts=1, enable_contact=False)
_ALL = fcl.CollisionRequest(num_max_contacts=256, enable_contact=True)


class ContactQuery(NamedTuple):
    """Query for a contact set of T bodies."""

    poses: Floats  # (T, 7) m and unit quaternions xyzw, present poses
    margins: Floats  # (T,) m in addition to MARGIN that moving bodies need
    engaged: Longs  # (T,) Engaged: points are searched for bodies that may touch
    pushing: Longs  # (T,) 1 for those whose external force needs the surface point under the tip
    releases: Longs  # (T,) number of releases so far


@dataclass
class FinderCounters:
    """Counts of searches, and of those that the finder could skip."""

    sets: int = 0
    far_skips: int = 0  # tools whose box didn't overlap the organ's, so that nothing was computed
    narrow_phases: int = 0  # number of queries to FCL


def _fcl_model(position: Floats, near: Ints | Longs) -> fcl.BVHModel:
    local, inverse = np.unique(near, return_inverse=True)
    model = fcl.BVHModel()
    model.beginModel(len(near), len(local))
    model.addSubModel(np.ascontiguousarray(position[local]), np.ascontiguousarray(inverse.reshape(-1, 3)))
    model.endModel()
    return model


class ContactFinder:
    """Finder of contact sets: a pure function of poses and surface, except for its buffers.

    Parameters
    ----------
    touched : Organ | TouchedSurface
        Organ without cuts, or the surface of any organ.
    tools : ToolSet
        Tools of the scene.
    """

    def __init__(self, touched: Organ | TouchedSurface, tools: ToolSet) -> None:
        self.surface = surface = TouchedSurface.of(touched)
        organ, self.triangles = surface.organ, surface.triangles
        self.n_points = surface.n_points
        self.tools = tools
        self.counters = FinderCounters()
        # Buffers for what a search finds.
        self._found = np.zeros((len(self.triangles), 3), dtype=np.int64)
        self._number = np.zeros(len(self.triangles), dtype=np.int64)
        self._low, self._high = np.zeros(3), np.zeros(3)  # of the surface
        self._matrix, self._box_low, self._box_high = np.zeros(9), np.zeros(3), np.zeros(3)  # of a body
        self._normal, self._seen = np.zeros((self.n_points, 3)), np.zeros(self.n_points, dtype=np.int64)
        most = MAX_FOUND * len(tools.grown)
        body, triangle = np.zeros((2, most), dtype=np.int64)
        corners, weight, normal = np.zeros((most, 3), dtype=np.int64), np.zeros((most, 3)), np.zeros((most, 3))
        self._points = FoundPoints(body, triangle, corners, weight, normal, np.zeros((most, 2)))
        self.rest = surface.rest
        self._model = fcl.CollisionObject(_fcl_model(self.rest, self.triangles))
        # Made once, as python-fcl leaks 32 bytes of every object that is deleted.
        self._grown = [fcl.CollisionObject(shape, fcl.Transform()) for shape in tools.grown]
        corner = self.rest[self.triangles]
        edges = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)  # the longest of each triangle
        longest = float(edges.max())
        usual = float(edges[surface.is_old].max())
        self.is_fine = [longest > MAX_DIVISIONS * MAX_SPACING * size for size in tools.smallest]
        limits_of_bodies = [OF_BALLS if kind == SPHERE else OF_OTHERS for kind in tools.shapes.kind.tolist()]
        self.lattices = lattices()
        order = np.argsort(self.triangles.ravel(), kind="stable")
        self._node_triangle = order // 3
        self._node_start = np.searchsorted(self.triangles.ravel()[order], np.arange(self.n_points + 1))
        self.finenesses: list[Fineness] = []
        compliance = []
        for limits, size, kind, is_fine in zip(
            limits_of_bodies, tools.smallest, tools.shapes.kind.tolist(), self.is_fine, strict=True
        ):
            # The face of a jaw touches many triangles at once: with as many points on each as the longest needs, they
            # would take most of a tick.
            each = edges if kind in (CONVEX, GRID) and not is_fine else np.where(surface.is_old, usual, edges)
            parts = np.array([divisions_of(edge / (limits.spacing * size)) for edge in each])
            # Smaller triangles at a cut need fewer points for the same number per area.
            parts[~surface.is_old & (edges <= usual / MIN_DIVISIONS) & (parts == MIN_DIVISIONS)] = 1
            parts[surface.is_loose] = 1
            # A nearest point is a new one each time, without a force to which it could have yielded.
            room = np.zeros(len(each)) if is_fine else max_yielding(limits, organ, size, each / parts)
            # The area of a point is that of a node over the square of its number of parts.
            whole = parts[0] ** 2
            fraction = np.square(parts.astype(np.float64)) / whole
            self.finenesses.append(fineness_of(surface, parts, np.stack([fraction, room], axis=1)))
            compliance.append(whole * surface.compliance(size))
        self.compliance = np.reshape(compliance, (len(compliance), self.n_points, 2))
        self.between = np.array(
            [
                extra_compliance_between_nodes(limits, organ, size)
                for limits, size in zip(limits_of_bodies, tools.smallest, strict=True)
            ]
        )

    @classmethod
    def of(cls, touched: Organ | CutOrgan | Simulation, tools: ToolSet) -> ContactFinder:
        """Return a finder for the present surface of an organ, which changes after a cut.

        Parameters
        ----------
        touched : Organ | CutOrgan | Simulation
            The organ, one after cuts, or a simulation of either.
        tools : ToolSet
            Tools of the scene.
        """
        return cls(TouchedSurface.of(touched), tools)

    def find(self, position: Floats, query: ContactQuery) -> ContactSet:
        """Return the contact set of bodies on a surface: the surface's points near them.

        Parameters
        ----------
        position : Floats, shape (n, 3), m
            Positions of the nodes, surface first.
        query : ContactQuery
            The query.
        """
        n_bodies, poses, engaged = len(self.tools.grown), query.poses.copy(), query.engaged.copy()
        self.counters.sets += 1
        position = self.surface.at(position)
        surface_box(position, self.n_points, self._low, self._high)
        count, counts = 0, np.zeros(n_bodies, dtype=np.int64)
        reach = MARGIN + query.margins - TISSUE_MOTION
        for body in np.flatnonzero(engaged == Engaged.YES).tolist():
            way_out = self._way_out(body, position, poses[body])
            if way_out is not None:
                poses[body, :3] += way_out
                engaged[body] = Engaged.SLIPPED
            before = count
            count, apart = self._add(body, position, poses[body], query.margins[body], count)
            counts[body], reach[body] = count - before, max(reach[body], apart)
        points = self._points
        kept = slice(0, min(count, len(points.body)))
        chosen: slice | Longs = kept
        if count > MAX_CONTACT_POINTS:
            places = np.einsum("ij,ijk->ik", points.weight[kept], position[points.node[kept]])
            distance = np.linalg.norm(places - poses[points.body[kept], :3], axis=1)
            chosen = np.sort(np.argsort(distance, kind="stable")[:MAX_CONTACT_POINTS])
            reach = np.minimum(reach, MARGIN - TISSUE_MOTION)  # the farthest points are the ones that are dropped
        found = contact_set(n_bodies, min(count, MAX_CONTACT_POINTS))
        found.header.points, found.header.dropped = len(found.body), max(0, count - MAX_CONTACT_POINTS)
        corners, weight = points.node[chosen], points.weight[chosen]
        found.body[:], found.normal[:] = points.body[chosen], points.normal[chosen]
        found.node[:], found.weight[:] = self.surface.between(points.triangle[chosen], corners, weight)
        set_compliance(found, corners, weight, points.yielding[chosen], self.compliance, self.between)
        found.engaged[:], found.place[:], found.reach[:] = engaged, poses, reach
        found.n_points[:], found.releases[:] = counts, query.releases
        found.tip_node[:] = -1
        for pushed in np.flatnonzero(query.pushing):
            found.tip_node[pushed], found.tip_weight[pushed] = self._under_tip(position, poses[pushed, :3])
        return found

    def _add(self, body: int, position: Floats, pose: Floats, margin: float, count: int) -> tuple[int, float]:
        """Add points near a body after the first `count`; return the new count and a distance.

        The distance is a lower bound on that of the body from the organ, m, from their boxes.
        """
        origin, reach = pose[:3], MARGIN + margin
        self._place(body, pose, reach)
        low, high, some, moved = self._box_low, self._box_high, 0, 0.0
        if boxes_meet(low, high, self._low, self._high):
            room = NearTriangles(self._found, self._number)
            some, moved = triangles_in_box(position, self.rest, self.triangles, low, high, room)
        # FCL uses the surface at rest, as building its model takes longer than everything else here. It isn't used if
        # the triangles near the body have moved by SLACK.
        is_asked = margin == 0.0 and moved < SLACK / math.sqrt(3.0)
        if some == 0 or (is_asked and not self._comes_near(body, origin)):
            self.counters.far_skips += 1
            return count, reach + boxes_apart(low, high, self._low, self._high) - TISSUE_MOTION
        near = self._found[:some]
        fineness = self.finenesses[body]
        search = Search(
            position, self.tools.shapes, body, self.lattices, fineness, origin, self._matrix, reach, self._normal
        )
        count = points_near(near, self._number[:some], search, self._seen, self._points, count)
        return self._add_nearest(body, position, some, origin, count) if self.is_fine[body] else count, 0.0

    def warm_up(self, position: Floats) -> None:
        """Compile the kernels of a contact, so that the first one doesn't wait for them.

        Parameters
        ----------
        position : Floats, shape (n, 3), m
            Positions of the nodes.
        """
        n_bodies = len(self.tools.grown)
        poses = np.tile(np.append(position[0], [0.0, 0.0, 0.0, 1.0]), (n_bodies, 1))
        everything, none = np.ones(n_bodies, dtype=np.int64), np.zeros(n_bodies, dtype=np.int64)
        self.find(position, ContactQuery(poses, np.zeros(n_bodies), everything, everything, none))
        for body in range(n_bodies):
            self.is_inside(body, position, poses[body])
        self.counters = FinderCounters()

    def is_inside(self, body: int, position: Floats, pose: Floats) -> bool:
        """Return whether the centre of a body lies inside the organ, or a surface node inside the body.

        The centres of a capsule's caps count, too: a tip may lie in tissue, between nodes, with everything else
        outside.

        Parameters
        ----------
        body : int
            Index of the body.
        position : Floats, shape (n, 3), m
            Positions of the nodes.
        pose : Floats, shape (7,), m and unit quaternion xyzw
            Pose of the body.
        """
        position = self.surface.at(position)
        self._place(body, pose, 0.0)
        origin, low, high = pose[:3], self._box_low, self._box_high
        if holds_node(position, self.n_points, PlacedBody(self.tools.shapes, body, origin, self._matrix, low, high)):
            return True
        surface_box(position, self.n_points, self._low, self._high)
        return self._swallowed(body, position, origin) is not None

    def _way_out(self, body: int, position: Floats, pose: Floats) -> Floats | None:
        """Return the displacement (3,) m that moves a body that has slipped inside out of the organ; None for others.

        Tissue yields to a tool by less than its radius, so that its centre, or the centres of a capsule's caps, are
        never inside while it is resisted. The displacement leads to the nearest point of the surface, and beyond it
        until the body is outside.
        """
        self._place(body, pose, 0.0)
        point = self._swallowed(body, position, pose[:3])
        if point is None:
            return None
        beyond = self.tools.clearance[body] + TISSUE_MOTION
        triangle, weight, _ = self._nearest(position, point)
        way = weight @ position[self.triangles[triangle]] - point
        if not self.surface.is_cut:
            return _longer(way, beyond)
        # Beside a wall there may be room for the body's middle only, and in a closed cut there is the other lip.
        for more in (beyond, OPEN_WIDTH):
            if not inside((point + _longer(way, more))[None], position, self.triangles)[0]:
                return _longer(way, more)
        outer = position[self.triangles[self.surface.is_outer]]
        number, weights, _ = nearest_among(outer, point[None])
        return _longer(weights[0] @ outer[number[0]] - point, beyond)

    def _swallowed(self, body: int, position: Floats, origin: Floats) -> Floats | None:
        """Return the first of a body's centre points (3,) m that lies inside the organ, None if none does.

        Call it after the body has been placed, and the surface's box computed.
        """
        points = self.tools.middle[body] @ self._matrix.reshape(3, 3).T + origin
        near = points[~np.any((points < self._low) | (points > self._high), axis=1)]
        if self.surface.is_cut:
            near = near[inside(near, position, self.triangles)] if len(near) else near
            return near[0] if len(near) else None
        triangles = self.triangles
        return next((point for point in near if crossings_above(position, triangles, *point.tolist()) > 0), None)

    def _place(self, body: int, pose: Floats, margin: float) -> None:
        """Write the rotation matrix of a body, and its box enlarged by a margin."""
        rotation_matrix(pose[3:], self._matrix)
        padding = self.tools.padding[body] + margin
        body_box(self.tools.corners[body], padding, self._matrix, pose[:3], self._box_low, self._box_high)

    def _comes_near(self, body: int, origin: Floats) -> bool:
        """Return whether a body may be within MARGIN of the surface, by FCL; True for some larger distances, too."""
        self.counters.narrow_phases += 1
        return bool(fcl.collide(self._model, self._placed(body, origin), _ANY, fcl.CollisionResult()))

    def _placed(self, body: int, origin: Floats) -> fcl.CollisionObject:
        rotation, placed = self._matrix.reshape(3, 3), self._grown[body]
        placed.setTransform(fcl.Transform(rotation, origin + rotation @ self.tools.grown_centre[body]))
        return placed

    def _add_nearest(self, body: int, position: Floats, some: int, origin: Floats, count: int) -> int:
        """Add the point nearest to a body, by FCL, of each triangle that is too coarse for its lattice.

        The points of a lattice are fixed on the tissue, while the nearest one moves, and the force may change suddenly
        with it. But a needle would slip between the points of a lattice.
        """
        result, near = fcl.CollisionResult(), self._found[:some]
        fcl.collide(fcl.CollisionObject(_fcl_model(position, near)), self._placed(body, origin), _ALL, result)
        where = {contact.b1: np.asarray(contact.pos) for contact in result.contacts if 0 <= contact.b1 < len(near)}
        touched = sorted(where)
        corners = near[touched].reshape(-1, 3)
        points = np.array([where[triangle] for triangle in touched]).reshape(-1, 3)
        weights = nearest_weights(position[corners], points)[0]
        normal = np.einsum("kc,kcx->kx", weights, self._normal[corners])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        most = len(self._points.body)
        room = slice(min(count, most), min(count + len(touched), most))
        taken = room.stop - room.start
        self._points.body[room], self._points.node[room] = body, corners[:taken]
        self._points.triangle[room] = self._number[touched][:taken]
        self._points.weight[room], self._points.normal[room] = weights[:taken], normal[:taken]
        self._points.yielding[room] = 1.0, 0.0
        return count + len(touched)

    def _under_tip(self, position: Floats, tip: Floats) -> tuple[Longs, Floats]:
        triangle, weight, distance = self._nearest(position, tip)
        if distance > TIP_REACH:
            return np.full(POINT_NODES, -1, dtype=np.int64), np.zeros(POINT_NODES)
        corners = self.triangles[triangle].astype(np.int64)
        nodes, weights = self.surface.between(np.array([triangle]), corners[None], weight[None])
        return nodes[0], weights[0]

    def _nearest(self, position: Floats, point: Floats) -> tuple[int, Floats, float]:
        """Return triangle, weights (3,) and distance, m, of the surface's place nearest to a point (3,) m.

        The triangles around the nearest corner are searched.
        """
        node, _ = nearest_node(position, self.n_points, point[0], point[1], point[2])
        around = self._node_triangle[self._node_start[node] : self._node_start[node + 1]]
        corners = position[self.triangles[around]]
        weight, distance = nearest_weights(corners, np.repeat(point[None], len(around), axis=0))
        chosen = int(np.argmin(distance))
        return int(around[chosen]), weight[chosen], float(distance[chosen])


def _longer(way: Floats, beyond: float) -> Floats:
    """Return a displacement (3,) m that is longer by `beyond` m."""
    longer: Floats = way + way / max(float(np.linalg.norm(way)), 1e-9) * beyond
    return longer
