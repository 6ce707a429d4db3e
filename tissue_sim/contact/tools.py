"""Rigid tools: their shape for FCL, for the kernels and for the broad phase."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import fcl
import numpy as np
from numpy.typing import NDArray

from tissue_sim.arguments import number_of
from tissue_sim.array_types import Floats
from tissue_sim.contact.gripper import Jaws, jaw_poses
from tissue_sim.errors import UserError
from tissue_sim.model.data.shapes import CAPSULE, CONVEX, GRID, SPHERE, Grid, make_shapes
from tissue_sim.organ.shipped import shipped_file

if TYPE_CHECKING:
    import trimesh

SHAPE_NAMES = ("sphere", "capsule", "gripper", "mesh")
MOST_PLANES = 256
MARGIN = 0.003  # m around a tool: distance that it may cover before the next contact set
SLACK = 0.003  # m that the surface may have moved from rest where FCL is used


@dataclass(frozen=True)
class Tool:
    """Rigid tool; its frame's origin is the tip, and an instrument's shaft lies along -z.

    Attributes
    ----------
    name : str
        Its name.
    shape : str
        sphere, capsule, gripper (two capsules, or two jaws of a mesh; see contact.gripper) or mesh.
    radius : float
        Radius of a sphere or of capsules, m.
    length : float
        Length, m, of capsules between the centres of their caps, from the origin along -z; or from a gripper's tips to
        its hinge.
    mesh : str
        Mesh file in m, a closed surface where it is not convex; config/jaws/flat.obj comes with the package.
    smoothing : float
        Fraction of the time between two poses in which the tool moves to the newer one. 1: it moves evenly, and arrives
        as the next pose is due; 0: it arrives within a tick.
    """

    name: str
    shape: str = "sphere"
    radius: float = 0.005
    length: float = 0.05
    mesh: str = ""
    smoothing: float = 1.0

    @property
    def n_bodies(self) -> int:
        """Number of its rigid bodies: the two jaws of a gripper, or one."""
        return 2 if self.shape == "gripper" else 1

    @property
    def is_round(self) -> bool:
        """Whether `radius` is that of its bodies: of spheres, capsules, and jaws that are capsules."""
        return self.shape in ("sphere", "capsule") or (self.shape == "gripper" and not self.mesh)

    @property
    def jaws(self) -> Jaws:
        """Dimensions of a gripper."""
        return Jaws(0.0 if self.mesh else self.radius, self.length)


class ToolSet:
    """Tools of a scene in all the forms that are needed, body by body: a gripper has two, other tools one.

    Parameters
    ----------
    tools : list[Tool]
        The tools.

    Raises
    ------
    UserError
        Where a shape is unknown or out of range, or a mesh file can't be used; the message names the tool.
    """

    def __init__(self, tools: list[Tool]) -> None:
        self.tools = list(tools)
        names = [tool.name for tool in self.tools]
        if twice := [name for name in names if names.count(name) > 1]:
            raise UserError(f"two tools are called '{twice[0]}'; give each a name of its own")
        self.bodies: list[list[int]] = []  # bodies of each tool
        bodies: list[_Body] = []
        for tool in self.tools:
            made = _bodies(tool)
            self.bodies.append(list(range(len(bodies), len(bodies) + len(made))))
            bodies += made
        self.grown = [_grown(body) for body in bodies]  # FCL geometry of each body, MARGIN and SLACK larger
        # Centre of FCL's geometry in the body's frame, m: FCL's capsules have theirs in the middle.
        self.grown_centre = [np.array([0.0, 0.0, -0.5 * body.size[1]]) for body in bodies]
        self.corners = [body.corners for body in bodies]  # points whose hull, grown by `padding`, holds the body
        self.padding = [body.size[0] for body in bodies]
        centres = [0.5 * (body.corners.min(axis=0) + body.corners.max(axis=0)) for body in bodies]  # m
        # Points that lie inside no tissue that resists: the middles of a capsule's caps and length, or what is deepest.
        self.middle = [
            np.vstack([body.corners, centre])
            if body.kind in (SPHERE, CAPSULE)
            else (centre if body.grid is None else _deepest(body.grid))[None]
            for body, centre in zip(bodies, centres, strict=True)
        ]
        self.clearance = [  # m, from there to the farthest point of the body's surface
            body.size[0] or float(np.linalg.norm(body.corners - middle[0], axis=1).max())
            for body, middle in zip(bodies, self.middle, strict=True)
        ]
        self.smallest = [body.smallest for body in bodies]  # m, radius of the finest thing about the body
        self.meshes = [body.mesh for body in bodies]  # None for spheres and capsules
        self.shapes = make_shapes(
            [body.kind for body in bodies],
            [body.size for body in bodies],
            [body.planes for body in bodies],
            [body.grid for body in bodies],
            [tool for tool, members in enumerate(self.bodies) for _ in members],
            [(body.smallest, float(np.linalg.norm(body.corners, axis=1).max())) for body in bodies],
        )
        members = zip(self.tools, self.bodies, strict=True)
        self.shapes.smoothing[:] = [tool.smoothing for tool, own in members for _ in own]

    def index(self, tool: int | str) -> int:
        """Return the number of a tool that is given by its name or its number; negative ones count from the last.

        Raises
        ------
        UserError
            For a tool that the scene doesn't have.
        """
        return number_of(tool, [one.name for one in self.tools], "tool")

    def poses(self, tool: int, pose: Floats, angle: float = 0.0) -> Floats:
        """Return the poses of a tool's bodies.

        Parameters
        ----------
        tool : int
            Index of the tool.
        pose : Floats, shape (7,), m and unit quaternion xyzw
            Pose of the tool.
        angle : float, rad, optional
            Angle between the jaws of a gripper.

        Returns
        -------
        Floats
            shape (b, 7), m and unit quaternion xyzw
        """
        chosen = self.tools[tool]
        if chosen.n_bodies == 1:
            return pose[None]
        return jaw_poses(pose, angle, *chosen.jaws)


@dataclass(frozen=True)
class _Body:
    """Rigid body: its kind and size as in Shapes, and what a mesh has besides."""

    kind: int
    size: tuple[float, float]
    corners: Floats
    smallest: float
    planes: Floats = field(default_factory=lambda: np.zeros((0, 4)))
    grid: Grid | None = None
    mesh: trimesh.Trimesh | None = None


def _bodies(tool: Tool) -> list[_Body]:
    if not 0.0 <= tool.smoothing <= 1.0:
        raise UserError(f"tool '{tool.name}': smoothing {tool.smoothing:g} is outside 0..1")
    if tool.shape not in SHAPE_NAMES:
        raise UserError(f"tool '{tool.name}': unknown shape '{tool.shape}'; choose one of {', '.join(SHAPE_NAMES)}")
    if tool.shape == "mesh":
        return [_mesh_body(tool)]
    if tool.shape == "gripper" and tool.mesh:
        _check_length(tool)
        return [_mesh_body(tool)] * tool.n_bodies
    if not 5e-4 <= tool.radius <= 0.5:
        raise UserError(f"tool '{tool.name}': radius {tool.radius:g} m is outside 0.0005..0.5")
    if tool.shape == "sphere":
        return [_Body(SPHERE, (tool.radius, 0.0), np.zeros((2, 3)), tool.radius)]
    _check_length(tool)
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -tool.length]])
    capsule = _Body(CAPSULE, (tool.radius, tool.length), ends, tool.radius)
    return [capsule] * tool.n_bodies


def _check_length(tool: Tool) -> None:
    if not 0.0 <= tool.length <= 2.0:
        raise UserError(f"tool '{tool.name}': length {tool.length:g} m is outside 0..2")


def _mesh_body(tool: Tool) -> _Body:
    import trimesh  # takes a fifth of a node's start, and few nodes have tools of a mesh

    path = Path(tool.mesh) if Path(tool.mesh).is_file() else shipped_file(tool.mesh)
    if path is None:
        raise UserError(f"tool '{tool.name}': mesh file '{tool.mesh}' does not exist; name one in metres")
    if path.suffix[1:].lower() not in trimesh.available_formats():  # a bag may name any file, which must not be opened
        raise UserError(f"tool '{tool.name}': '{tool.mesh}' is not a mesh file; name one such as jaw.obj or jaw.stl")
    try:
        mesh = trimesh.load_mesh(path)
        with np.errstate(invalid="ignore"):  # a flat one has no centre of mass; it is refused below
            hull = mesh.convex_hull
    except Exception as error:  # a mesh library's own errors are of many kinds
        raise UserError(f"tool '{tool.name}': cannot read mesh file '{tool.mesh}': {error}") from None
    if hull.extents.max() > 2.0:
        raise UserError(
            f"tool '{tool.name}': mesh '{tool.mesh}' is {hull.extents.max():.3g} m long; meshes are in metres"
        )
    if hull.extents.min() < 1e-5:
        raise UserError(f"tool '{tool.name}': mesh '{tool.mesh}' is flat; give it a thickness")
    corners, smallest = np.array(hull.vertices), 0.5 * float(hull.extents.min())
    if mesh.is_convex:
        return _Body(CONVEX, (0.0, 0.0), corners, smallest, planes=_planes(tool, hull), mesh=hull)
    if not mesh.is_watertight:
        raise UserError(
            f"tool '{tool.name}': mesh '{tool.mesh}' is neither convex nor closed; close its holes, or save its"
            " convex hull"
        )
    from tissue_sim.contact.grid import distance_grid

    mesh.fix_normals()
    thin = min(smallest, float(mesh.volume / mesh.area) * 2.0)  # half the thickness of a plate
    return _Body(GRID, (0.0, 0.0), corners, thin, grid=distance_grid(mesh, MARGIN), mesh=mesh)


def _deepest(grid: Grid) -> Floats:
    """Return the point (3,) m farthest inside a mesh: that of a ring lies in the ring, not in its hole."""
    at = np.unravel_index(np.argmin(grid.distance), grid.distance.shape)
    return np.asarray(grid.origin + grid.spacing * np.array(at))


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


def _grown(body: _Body) -> Any:
    grow = MARGIN + SLACK
    if body.kind == SPHERE:
        return fcl.Sphere(body.size[0] + grow)
    if body.kind == CAPSULE:
        return fcl.Capsule(body.size[0] + grow, body.size[1])
    import trimesh
    from scipy.spatial import HalfspaceIntersection

    assert body.mesh is not None
    if body.kind == GRID:
        # A box around it: what lies within its arms is left to the distances.
        low, high = body.mesh.bounds[0] - grow, body.mesh.bounds[1] + grow
        grown = trimesh.creation.box(bounds=[low, high])
    else:
        # The planes moved out, so that every point within the margin of a face is inside.
        halfspaces = np.column_stack([body.planes[:, :3], -(body.planes[:, 3] + grow)])
        corners = HalfspaceIntersection(halfspaces, body.mesh.vertices.mean(axis=0)).intersections
        grown = trimesh.convex.convex_hull(corners)
    faces: NDArray[Any] = np.column_stack([np.full(len(grown.faces), 3), grown.faces]).ravel()
    return fcl.Convex(np.asarray(grown.vertices), len(grown.faces), faces)
