"""Rigid tools: their shape for FCL, for the kernels and for the broad phase."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fcl
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import HalfspaceIntersection

from tissue_sim.errors import UserError
from tissue_sim.model.shapes import CAPSULE, CONVEX, SPHERE, Shapes
from tissue_sim.organ.organ import Floats

SHAPE_NAMES = ("sphere", "capsule", "mesh")
MOST_PLANES = 256
MARGIN = 0.003  # m around a tool: what it may cover before the next contact set


@dataclass(frozen=True)
class Tool:
    """A rigid tool. Its frame's origin is the tip; an instrument's shaft lies along -z.

    name; shape: sphere, capsule or mesh; radius m (sphere, capsule); length m (capsule, between the
    centres of its caps, from the origin along -z); mesh: file in m (its convex hull is used).
    """

    name: str
    shape: str = "sphere"
    radius: float = 0.005
    length: float = 0.05
    mesh: str = ""


class ToolSet:
    """The tools of a scene in every form that is needed.

    Raises UserError naming the tool when a shape is unknown, out of range, or its mesh file
    can't be used.
    """

    def __init__(self, tools: list[Tool]) -> None:
        self.tools = list(tools)
        self.warnings: list[str] = []
        kinds, sizes, planes, starts = [], [], [], [0]
        self.grown: list[Any] = []  # FCL geometry of each tool, grown by MARGIN
        self.centre: list[Floats] = []  # centre of the shape in the tool's frame, m
        self.corners: list[Floats] = []  # points whose hull, grown by `padding`, holds the shape
        self.padding: list[float] = []
        self.smallest: list[float] = []  # m, radius of the finest thing about the shape
        for tool in self.tools:
            kind, size, hull = _shape(tool, self.warnings)
            kinds.append(kind)
            sizes.append(size)
            planes.append(_planes(tool, hull) if hull is not None else np.zeros((0, 4)))
            starts.append(starts[-1] + len(planes[-1]))
            self.grown.append(_grown(kind, size, hull, planes[-1]))
            ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -size[1]]])
            corners = np.array(hull.vertices) if hull is not None else ends
            self.corners.append(corners)
            self.centre.append(0.5 * (corners.min(axis=0) + corners.max(axis=0)))
            self.smallest.append(size[0] if hull is None else 0.5 * float(hull.extents.min()))
            self.padding.append(0.0 if hull is not None else size[0])
        self.shapes = Shapes(
            kind=np.array(kinds, dtype=np.int64),
            size=np.array(sizes, dtype=np.float64).reshape(len(kinds), 2),
            plane=np.concatenate([*planes, np.zeros((0, 4))]),
            plane_start=np.array(starts, dtype=np.int64),
        )

    def box(self, tool: int, rotation: Floats, origin: Floats, margin: float) -> tuple[Floats, Floats]:
        """Corners (3,) m of the tool's axis-aligned box, grown by a margin."""
        points = self.corners[tool] @ rotation.T + origin
        grow = self.padding[tool] + margin
        return points.min(axis=0) - grow, points.max(axis=0) + grow


def _shape(tool: Tool, warnings: list[str]) -> tuple[int, tuple[float, float], trimesh.Trimesh | None]:
    if tool.shape not in SHAPE_NAMES:
        raise UserError(f"tool '{tool.name}': unknown shape '{tool.shape}'; choose one of {', '.join(SHAPE_NAMES)}")
    if tool.shape == "mesh":
        return CONVEX, (0.0, 0.0), _hull(tool, warnings)
    if not 5e-4 <= tool.radius <= 0.5:
        raise UserError(f"tool '{tool.name}': radius {tool.radius:g} m is outside 0.0005..0.5")
    if tool.shape == "sphere":
        return SPHERE, (tool.radius, 0.0), None
    if not 0.0 <= tool.length <= 2.0:
        raise UserError(f"tool '{tool.name}': length {tool.length:g} m is outside 0..2")
    return CAPSULE, (tool.radius, tool.length), None


def _hull(tool: Tool, warnings: list[str]) -> trimesh.Trimesh:
    if not Path(tool.mesh).is_file():
        raise UserError(f"tool '{tool.name}': mesh file '{tool.mesh}' does not exist; name one in metres")
    try:
        mesh = trimesh.load_mesh(tool.mesh)
        hull = mesh.convex_hull
    except Exception as error:  # a mesh library's own errors are of many kinds
        raise UserError(f"tool '{tool.name}': cannot read mesh file '{tool.mesh}': {error}") from None
    if hull.extents.max() > 2.0:
        raise UserError(
            f"tool '{tool.name}': mesh '{tool.mesh}' is {hull.extents.max():.3g} m long; meshes are in metres"
        )
    if hull.extents.min() < 1e-5:
        raise UserError(f"tool '{tool.name}': mesh '{tool.mesh}' is flat; give it a thickness")
    if not mesh.is_convex:
        warnings.append(f"tool '{tool.name}': mesh '{tool.mesh}' is not convex; its convex hull is used")
    return hull


def _planes(tool: Tool, hull: trimesh.Trimesh) -> Floats:
    normals = np.asarray(hull.face_normals)
    offsets = np.einsum("ij,ij->i", normals, hull.triangles[:, 0])
    planes = np.unique(np.round(np.column_stack([normals, offsets]), 9), axis=0)
    if len(planes) > MOST_PLANES:
        raise UserError(
            f"tool '{tool.name}': the convex hull of '{tool.mesh}' has {len(planes)} faces;"
            f" simplify it to {MOST_PLANES}"
        )
    return planes


def _grown(kind: int, size: tuple[float, float], hull: trimesh.Trimesh | None, planes: Floats) -> Any:
    if kind == SPHERE:
        return fcl.Sphere(size[0] + MARGIN)
    if kind == CAPSULE:
        return fcl.Capsule(size[0] + MARGIN, size[1])
    assert hull is not None
    # The planes moved out, so that every point within the margin of a face is inside.
    halfspaces = np.column_stack([planes[:, :3], -(planes[:, 3] + MARGIN)])
    corners = HalfspaceIntersection(halfspaces, hull.vertices.mean(axis=0)).intersections
    grown = trimesh.convex.convex_hull(corners)
    faces: NDArray[Any] = np.column_stack([np.full(len(grown.faces), 3), grown.faces]).ravel()
    return fcl.Convex(np.asarray(grown.vertices), len(grown.faces), faces)
