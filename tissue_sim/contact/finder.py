"""From tool poses and a surface to a contact set: broad phase, FCL narrow phase, points under tips."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import fcl
import numpy as np
import trimesh
from numpy.typing import NDArray

from tissue_sim.contact.broad_phase import add_normals, holds_node, nearest_node, surface_box, triangles_in_box
from tissue_sim.contact.tools import MARGIN, ToolSet
from tissue_sim.model.inputs import take_contacts
from tissue_sim.model.shapes import CAPSULE, rotation_matrix
from tissue_sim.model.state import MAX_ENTRIES, Floats, Longs, State
from tissue_sim.organ.organ import Ints
from tissue_sim.organ.winding import inside

TIP_REACH = 0.02  # m from the tip within which an external force finds the tissue
MOST_FCL_CONTACTS = 256
SPACING = 0.75  # of a tool's smallest radius: farthest that contact points lie apart
MOST_DIVISIONS = 8


@dataclass(frozen=True)
class ContactSet:
    """Surface points that tools may touch, and those under the tools' tips. T tools, C entries."""

    tool: Longs  # (C,)
    node: Longs  # (C, 3)
    weight: Floats  # (C, 3)
    normal: Floats  # (C, 3) outward unit normals of the tissue
    tip_node: Longs  # (T, 3), -1 where no surface is within reach
    tip_weight: Floats  # (T, 3)
    engaged: Longs  # (T,)
    dropped: int = 0  # entries beyond the capacity, farthest first


def hand_over(state: State, found: ContactSet, sequence: int) -> None:
    """Let a simulation's state take up a contact set; sequence: its number."""
    take_contacts(
        state,
        len(found.tool),
        found.tool,
        found.node,
        found.weight,
        found.normal,
        found.tip_node,
        found.tip_weight,
        found.engaged,
        sequence,
    )


@dataclass
class FinderCounters:
    """What the finder did and what it could leave out."""

    sets: int = 0
    far_skips: int = 0  # tools whose box missed the organ's: nothing computed
    narrow_phases: int = 0


class ContactFinder:
    """Finds contact sets. A pure function of poses and surface, but for preallocated arrays.

    rest (n, 3) m, surface first, at rest; triangles (t, 3) of the surface; tools the scene's tools.
    """

    def __init__(self, rest: Floats, triangles: Ints, n_surface: int, tools: ToolSet) -> None:
        self.triangles = np.ascontiguousarray(triangles)
        self.n_surface = n_surface
        self.tools = tools
        self.counters = FinderCounters()
        self._found = np.zeros(len(triangles), dtype=np.int64)
        self._low, self._high = np.zeros(3), np.zeros(3)
        self._matrix = np.zeros(9)
        corner = rest[self.triangles]
        longest = float(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max())
        self._is_fine = [longest > MOST_DIVISIONS * SPACING * size for size in tools.smallest]
        self._lattices = [edge_and_face_points(longest / (SPACING * size)) for size in tools.smallest]
        order = np.argsort(self.triangles.ravel(), kind="stable")
        self._node_triangle = order // 3
        self._node_start = np.searchsorted(self.triangles.ravel()[order], np.arange(n_surface + 1))

    def find(self, position: Floats, poses: Floats, margins: Floats, engaged: Longs, pushing: Longs) -> ContactSet:
        """Contact set of the engaged tools on a surface.

        position (n, 3) m, surface first; poses (T, 7) m and unit quaternions xyzw; margins (T,) m beyond
        MARGIN that fast tools need; engaged (T,) 1 for tools that may touch; pushing (T,) 1 for tools
        whose external force needs the surface point under the tip.
        """
        n_tools = len(self.tools.tools)
        nodes: list[NDArray[Any]] = []
        weights: list[NDArray[Any]] = []
        normals: list[NDArray[Any]] = []
        owners: list[NDArray[Any]] = []
        tip_node, tip_weight = np.full((n_tools, 3), -1, dtype=np.int64), np.zeros((n_tools, 3))
        self.counters.sets += 1
        surface_box(position, self.n_surface, self._low, self._high)
        for tool in range(n_tools):
            if pushing[tool]:
                tip_node[tool], tip_weight[tool] = self._under_tip(position, poses[tool, :3])
            if not engaged[tool]:
                continue
            rotation, origin = self._rotation(poses[tool]), poses[tool, :3]
            low, high = self.tools.box(tool, rotation, origin, MARGIN + margins[tool])
            if np.any(low > self._high) or np.any(high < self._low):
                self.counters.far_skips += 1
                continue
            count = triangles_in_box(position, self.triangles, low, high, self._found)
            if not count:
                self.counters.far_skips += 1
                continue
            near = self.triangles[self._found[:count]]
            corners = np.unique(near)
            keep = np.all((position[corners] >= low) & (position[corners] <= high), axis=1)
            corners = corners[keep]
            nodes.append(np.repeat(corners[:, None], 3, axis=1))
            weights.append(np.tile([1.0, 0.0, 0.0], (len(corners), 1)))
            face_nodes, face_weights = self._narrow(tool, position, near, rotation, origin)
            nodes.append(face_nodes)
            weights.append(face_weights)
            normal = np.zeros((self.n_surface, 3))
            add_normals(position, near, normal)
            normals += [normal[corners], np.einsum("kc,kcx->kx", face_weights, normal[face_nodes])]
            owners.append(np.full(len(corners) + len(face_nodes), tool, dtype=np.int64))
        node = np.concatenate([*nodes, np.zeros((0, 3), dtype=np.int64)]).astype(np.int64)
        weight = np.concatenate([*weights, np.zeros((0, 3))])
        normal = np.concatenate([*normals, np.zeros((0, 3))])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        owner = np.concatenate([*owners, np.zeros(0, dtype=np.int64)])
        dropped = max(0, len(node) - MAX_ENTRIES)
        if dropped:
            points = np.einsum("ij,ijk->ik", weight, position[node])
            distance = np.linalg.norm(points - poses[owner, :3], axis=1)
            kept = np.sort(np.argsort(distance, kind="stable")[:MAX_ENTRIES])
            node, weight, normal, owner = node[kept], weight[kept], normal[kept], owner[kept]
        return ContactSet(owner, node, weight, normal, tip_node, tip_weight, np.array(engaged, dtype=np.int64), dropped)

    def warm_up(self, position: Floats) -> None:
        """Compile what a contact needs, so that the first one doesn't wait for it."""
        n_tools = len(self.tools.tools)
        poses = np.tile(np.append(position[0], [0.0, 0.0, 0.0, 1.0]), (n_tools, 1))
        everything = np.ones(n_tools, dtype=np.int64)
        self.find(position, poses, np.zeros(n_tools), everything, everything)
        for tool in range(n_tools):
            self.is_inside(tool, position, poses[tool])
        self.counters = FinderCounters()

    def is_inside(self, tool: int, position: Floats, pose: Floats) -> bool:
        """True when the centre of a tool's shape lies inside the organ, or a surface node inside the tool."""
        rotation = self._rotation(pose)
        low, high = self.tools.box(tool, rotation, pose[:3], 0.0)
        if holds_node(position, self.n_surface, self.tools.shapes, tool, pose[:3], rotation.ravel(), low, high):
            return True
        centre = rotation @ self.tools.centre[tool] + pose[:3]
        surface_box(position, self.n_surface, self._low, self._high)
        if np.any(centre < self._low) or np.any(centre > self._high):
            return False
        return bool(inside(centre[None], position, self.triangles)[0])

    def _rotation(self, pose: Floats) -> Floats:
        rotation_matrix(pose[3:], self._matrix)
        return self._matrix.reshape(3, 3).copy()

    def _narrow(
        self, tool: int, position: Floats, near: Ints, rotation: Floats, origin: Floats
    ) -> tuple[Longs, Floats]:
        """Points spread over each triangle that FCL finds within MARGIN of the tool.

        Nodes alone would let a small tool through between them. The points stay where they are on
        the tissue; the point nearest to the tool wanders, and each step of it would be felt. Only
        tools too fine for a lattice get that.
        """
        self.counters.narrow_phases += 1
        local, inverse = np.unique(near, return_inverse=True)
        vertices = np.ascontiguousarray(position[local])
        model = fcl.BVHModel()
        model.beginModel(len(near), len(vertices))
        model.addSubModel(vertices, np.ascontiguousarray(inverse.reshape(-1, 3)))
        model.endModel()
        shift = np.zeros(3)
        if self.tools.shapes.kind[tool] == CAPSULE:
            shift = rotation @ np.array([0.0, 0.0, -0.5 * self.tools.shapes.size[tool, 1]])
        body = fcl.CollisionObject(self.tools.grown[tool], fcl.Transform(rotation, origin + shift))
        request = fcl.CollisionRequest(num_max_contacts=MOST_FCL_CONTACTS, enable_contact=True)
        result = fcl.CollisionResult()
        fcl.collide(fcl.CollisionObject(model), body, request, result)
        touched = sorted({contact.b1 for contact in result.contacts if 0 <= contact.b1 < len(near)})
        if self._is_fine[tool]:
            where = {contact.b1: np.asarray(contact.pos) for contact in result.contacts}
            corners = near[touched].astype(np.int64).reshape(-1, 3)
            points = np.array([where[triangle] for triangle in touched]).reshape(-1, 3)
            return corners, nearest_weights(position[corners], points)[0]
        lattice = self._lattices[tool]
        corners = near[touched].astype(np.int64)
        nodes, weights = np.repeat(corners, len(lattice), axis=0), np.tile(lattice, (len(corners), 1))
        # A point on an edge belongs to two triangles; it is taken from the one that runs along it.
        on_edge = np.any(weights == 0.0, axis=1)
        following = np.argmin(weights, axis=1)
        rows = np.arange(len(nodes))
        first, second = nodes[rows, (following + 1) % 3], nodes[rows, (following + 2) % 3]
        kept = ~on_edge | (first < second)
        return nodes[kept], weights[kept]

    def _under_tip(self, position: Floats, tip: Floats) -> tuple[Longs, Floats]:
        node, _ = nearest_node(position, self.n_surface, tip[0], tip[1], tip[2])
        around = self.triangles[self._node_triangle[self._node_start[node] : self._node_start[node + 1]]]
        weight, distance = nearest_weights(position[around], np.repeat(tip[None], len(around), axis=0))
        chosen = int(np.argmin(distance))
        if distance[chosen] > TIP_REACH:
            return np.full(3, -1, dtype=np.int64), np.zeros(3)
        return around[chosen].astype(np.int64), weight[chosen]


def edge_and_face_points(divisions: float) -> Floats:
    """Barycentric weights (k, 3) of a triangle divided along its edges, without the corners.

    Divisions are rounded up, to 8 at the most.
    """
    m = min(max(1, math.ceil(divisions)), MOST_DIVISIONS)
    lattice = [(i / m, j / m, (m - i - j) / m) for i in range(m + 1) for j in range(m + 1 - i)]
    return np.array([weights for weights in lattice if max(weights) < 1.0]).reshape(-1, 3)


def nearest_weights(corners: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Nearest point of each triangle, corners (k, 3, 3) m, to its point, (k, 3) m.

    Returns the barycentric weights (k, 3) and the distances (k,) m.
    """
    nearest = trimesh.triangles.closest_point(corners, points)
    weights = trimesh.triangles.points_to_barycentric(corners, nearest)
    # A triangle without area has no such weights: its nearest corner stands for it.
    flat = ~np.all(np.isfinite(weights), axis=1)
    if np.any(flat):
        corner = np.argmin(np.linalg.norm(corners[flat] - points[flat, None], axis=2), axis=1)
        weights[flat] = np.eye(3)[corner]
        nearest[flat] = corners[flat, corner]
    return weights, np.linalg.norm(nearest - points, axis=1)
