"""Rigid tools: their shapes for FCL, for the kernels and for the broad phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import fcl
import numpy as np

from tissue_sim.arguments import number_of
from tissue_sim.array_types import Floats
from tissue_sim.contact.edges import Edge, check_edge, edges_of
from tissue_sim.contact.gripper import Jaws, jaw_poses
from tissue_sim.contact.quaternions import multiply, rotate
from tissue_sim.contact.urdf import Instrument, Part, read_instrument
from tissue_sim.errors import UserError
from tissue_sim.model.cutting.sheet import Coagulation
from tissue_sim.model.data.shapes import CAPSULE, CONVEX, GRID, SPHERE, Grid, make_shapes
from tissue_sim.organ.shipped import shipped_file

if TYPE_CHECKING:
    import trimesh

SHAPE_NAMES = ("sphere", "capsule", "gripper", "mesh", "urdf", "blade", "scissors")
MAX_PLANES = 256
MAX_FACES = 2000  # of a part of an instrument; a mesh with more is decimated
MAX_DECIMATION_ERROR = 2e-4  # m by which decimation may move its surface
MARGIN = 0.003  # m around a tool: distance that it may cover before the next contact set
SLACK = 0.003  # m, largest displacement of the surface from rest with which FCL is used


@dataclass(frozen=True)
class Tool:
    """Rigid tool; its frame's origin is the tip, and an instrument's shaft lies along -z.

    Attributes
    ----------
    name : str
        Its name.
    shape : str
        sphere, capsule, gripper (two capsules, or two jaws of a mesh; see contact.gripper), mesh, urdf, blade (an edge
        along -z that cuts towards x, see contact.edges), or scissors (two of them, as the jaws of a gripper).
    radius : float
        Radius of a sphere or of capsules, m; of a blade half the thickness of its edge.
    length : float
        Length, m, of capsules between the centres of their caps, from the origin along -z; or from a gripper's tips to
        its hinge, or of an edge.
    mesh : str
        Mesh file in m, convex or a closed surface; config/jaws/flat.obj comes with the package. For an instrument, its
        URDF.
    smoothing : float
        Fraction of the time between two poses in which the tool moves to the newer one. 1: it moves at constant speed,
        and arrives when the next pose is due; 0: it arrives within a tick.
    links : Sequence[str]
        Links of a URDF whose collision elements are the tool's bodies; none for all.
    tip_link : str
        Link of a URDF whose frame is the tool's; empty for its root.
    jaw_joint : str
        Joint of a URDF that moves the jaws; empty for none.
    height : float
        Height, m, of a blade behind its edge.
    cautery_speed : float
        Speed, m/s, at which a blade cuts tissue without force, as a cautery hook does; 0: it cuts by force.
    cautery_stiffening : float
        Factor by which its heat stiffens the tissue at the walls of its cut; 1: not at all.
    cautery_spread : float
        Distance, m, from its cut up to which the tissue is stiffened.
    """

    name: str
    shape: str = "sphere"
    radius: float = 0.005
    length: float = 0.05
    mesh: str = ""
    smoothing: float = 1.0
    links: Sequence[str] = ()
    tip_link: str = ""
    jaw_joint: str = ""
    height: float = 0.01
    cautery_speed: float = 0.0
    cautery_stiffening: float = 1.0
    cautery_spread: float = 0.001

    @property
    def n_bodies(self) -> int:
        """Number of its rigid bodies: the two jaws of a gripper, the parts of an instrument, or one."""
        return len(self.instrument.parts) if self.shape == "urdf" else 2 if self.shape in ("gripper", "scissors") else 1

    @property
    def has_jaws(self) -> bool:
        """Whether an angle, or another position of a joint, moves its bodies."""
        return self.shape in ("gripper", "scissors") or (self.shape == "urdf" and bool(self.jaw_joint))

    @property
    def instrument(self) -> Instrument:
        """Instrument that its URDF describes.

        Raises
        ------
        UserError
            If the URDF can't be used; the message names the tool.
        """
        links = tuple(link for link in self.links if link)
        try:
            return read_instrument(self.mesh, links, self.tip_link, self.jaw_joint)
        except UserError as error:
            raise UserError(f"tool '{self.name}': {error}") from None

    @property
    def is_round(self) -> bool:
        """Whether its bodies have the radius `radius`: spheres, capsules, and jaws that are capsules."""
        return self.shape in ("sphere", "capsule", "blade", "scissors") or (self.shape == "gripper" and not self.mesh)

    @property
    def edge(self) -> Edge | None:
        """The edge of a blade, or of each blade of scissors, which cut towards each other; None for other tools."""
        if self.shape not in ("blade", "scissors"):
            return None
        ahead = 1.0 if self.shape == "blade" else -1.0
        return Edge(ahead, self.radius, self.length, self.height, self.cautery_speed, self.coagulation)

    @property
    def coagulation(self) -> Coagulation:
        """Effect of its heat on the walls of its cut."""
        return Coagulation(self.cautery_stiffening, self.cautery_spread)

    @property
    def jaws(self) -> Jaws:
        """Dimensions of a gripper."""
        return Jaws(0.0 if self.mesh else self.radius, self.length)


class ToolSet:
    """Tools of a scene, with all representations of their bodies: a gripper has two bodies, most other tools one.

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
        self.grown = [_grown(body) for body in bodies]  # FCL geometry of each body, enlarged by MARGIN and SLACK
        # Centre of FCL's geometry in the body's frame, m: FCL's capsules have theirs in the middle.
        self.grown_centre = [np.array([0.0, 0.0, -0.5 * body.size[1]]) for body in bodies]
        self.corners = [body.corners for body in bodies]  # points whose hull, enlarged by `padding`, contains the body
        self.padding = [body.size[0] for body in bodies]
        centres = [0.5 * (body.corners.min(axis=0) + body.corners.max(axis=0)) for body in bodies]  # m
        # Points that are never inside tissue that resists: the centres of a capsule and its caps, or the innermost
        # point.
        self.middle = [
            np.vstack([body.corners, centre])
            if body.kind in (SPHERE, CAPSULE)
            else (centre if body.grid is None else _deepest(body.grid))[None]
            for body, centre in zip(bodies, centres, strict=True)
        ]
        self.clearance = [  # m, from these to the farthest point of the body's surface
            body.size[0] or float(np.linalg.norm(body.corners - middle[0], axis=1).max())
            for body, middle in zip(bodies, self.middle, strict=True)
        ]
        self.smallest = [body.smallest for body in bodies]  # m, radius of the finest feature of the body
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
        self.shapes = self.shapes._replace(blades=edges_of([tool.edge for tool in self.tools], self.bodies))
        self.shapes.smoothing[:] = [tool.smoothing for tool, own in members for _ in own]

    @property
    def coagulations(self) -> list[Coagulation]:
        """Effect of the heat of each tool on the walls of its cut."""
        return [tool.coagulation for tool in self.tools]

    def index(self, tool: int | str) -> int:
        """Return the number of a tool that is given by its name or number; negative numbers count from the last.

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
            Angle between the jaws of a gripper, or position of an instrument's joint.

        Returns
        -------
        Floats
            shape (b, 7), m and unit quaternion xyzw
        """
        chosen = self.tools[tool]
        if chosen.shape == "urdf":
            turn, places = tuple(pose[3:].tolist()), chosen.instrument.places(angle)
            return np.array([[*(pose[:3] + rotate(turn, one.at)), *multiply(turn, one.turn)] for one in places])
        if chosen.n_bodies == 1:
            return pose[None]
        return jaw_poses(pose, angle, *chosen.jaws)


@dataclass(frozen=True)
class _Body:
    """Rigid body: its kind and size as in Shapes, and the data of a mesh."""

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
    if tool.shape == "urdf":
        return [_part_body(tool, part) for part in tool.instrument.parts]
    if tool.shape == "gripper" and tool.mesh:
        _check_length(tool)
        return [_mesh_body(tool)] * tool.n_bodies
    if not 5e-4 <= tool.radius <= 0.5:
        raise UserError(f"tool '{tool.name}': radius {tool.radius:g} m is outside 0.0005..0.5")
    if tool.shape == "sphere":
        return [_Body(SPHERE, (tool.radius, 0.0), np.zeros((2, 3)), tool.radius)]
    _check_length(tool)
    if tool.edge is not None:
        check_edge(tool.name, tool.edge)
    ends = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -tool.length]])
    capsule = _Body(CAPSULE, (tool.radius, tool.length), ends, tool.radius)
    return [capsule] * tool.n_bodies


def _check_length(tool: Tool) -> None:
    if not 0.0 <= tool.length <= 2.0:
        raise UserError(f"tool '{tool.name}': length {tool.length:g} m is outside 0..2")


def _part_body(tool: Tool, part: Part) -> _Body:
    """Return the body of a part of an instrument, about the origin of its collision element."""
    import trimesh

    if min(part.size) <= 0.0:
        raise UserError(f"tool '{tool.name}': link '{part.link}' has a {part.kind} of size {part.size}; make it larger")
    if part.kind == "sphere":
        return _Body(SPHERE, (part.size[0], 0.0), np.zeros((2, 3)), part.size[0])
    if part.kind == "box":
        return _body_of(tool, part.link, trimesh.creation.box(part.size))
    if part.kind == "cylinder":
        return _body_of(tool, part.link, trimesh.creation.cylinder(part.size[0], part.size[1], sections=32))
    mesh = _loaded(tool, part.file)
    mesh.apply_scale(part.size)
    mesh.merge_vertices()
    return _body_of(tool, part.file, simplified(mesh, f"tool '{tool.name}': mesh '{part.file}'"), may_be_round=True)


def simplified(mesh: trimesh.Trimesh, name: str) -> trimesh.Trimesh:
    """Return a mesh, decimated towards MAX_FACES faces if it has more.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        The mesh, m.
    name : str
        Its name for messages.

    Returns
    -------
    trimesh.Trimesh
        The mesh itself, or one whose surface deviates by at most MAX_DECIMATION_ERROR.

    Raises
    ------
    UserError
        If that is impossible.
    """
    if len(mesh.faces) <= MAX_FACES:
        return mesh
    try:
        made = mesh.simplify_quadric_decimation(face_count=MAX_FACES, aggression=1)
    except ImportError:
        raise UserError(
            f"{name} has {len(mesh.faces)} faces, and decimating them to {MAX_FACES} needs fast-simplification:"
            " pip install fast-simplification"
        ) from None
    from tissue_sim.contact.grid import distances_to

    moved = float(distances_to(made, mesh.vertices).max())
    if moved > MAX_DECIMATION_ERROR or (mesh.is_watertight and not made.is_watertight):
        raise UserError(
            f"{name} has {len(mesh.faces)} faces; {len(made.faces)} would move its surface by {1e3 * moved:.2g} mm:"
            " simplify it by hand"
        )
    return made


def _mesh_body(tool: Tool) -> _Body:
    return _body_of(tool, tool.mesh, _loaded(tool, tool.mesh))


def _loaded(tool: Tool, file: str) -> trimesh.Trimesh:
    import trimesh  # takes a fifth of a node's start, and few nodes have tools with a mesh

    path = Path(file) if Path(file).is_file() else shipped_file(file)
    if path is None:
        raise UserError(f"tool '{tool.name}': mesh file '{file}' does not exist; name one in metres")
    if path.suffix[1:].lower() not in trimesh.available_formats():  # a bag may name any file, which must not be opened
        raise UserError(f"tool '{tool.name}': '{file}' is not a mesh file; name one such as jaw.obj or jaw.stl")
    try:
        return trimesh.load_mesh(path)
    except Exception as error:  # a mesh library's own errors are of many kinds
        raise UserError(f"tool '{tool.name}': cannot read mesh file '{file}': {error}") from None


def _body_of(tool: Tool, file: str, mesh: trimesh.Trimesh, may_be_round: bool = False) -> _Body:
    """Return the body of a mesh; one that may be round has distances instead of planes if it would have too many."""
    try:
        with np.errstate(invalid="ignore"):  # a flat mesh has no centre of mass; it is refused below
            hull = mesh.convex_hull
    except Exception as error:  # a mesh library's own errors are of many kinds
        raise UserError(f"tool '{tool.name}': cannot read mesh file '{file}': {error}") from None
    if hull.extents.max() > 2.0:
        raise UserError(f"tool '{tool.name}': mesh '{file}' is {hull.extents.max():.3g} m long; meshes are in metres")
    if hull.extents.min() < 1e-5:
        raise UserError(f"tool '{tool.name}': mesh '{file}' is flat; give it a thickness")
    corners, smallest = np.array(hull.vertices), 0.5 * float(hull.extents.min())
    if mesh.is_convex and not (may_be_round and len(hull.faces) > MAX_PLANES):
        return _Body(CONVEX, (0.0, 0.0), corners, smallest, planes=_planes(tool, file, hull), mesh=hull)
    if not mesh.is_watertight:
        raise UserError(
            f"tool '{tool.name}': mesh '{file}' is neither convex nor closed; close its holes, or save its convex hull"
        )
    from tissue_sim.contact.grid import distance_grid

    mesh.fix_normals()
    thin = min(smallest, float(mesh.volume / mesh.area) * 2.0)  # half the thickness of a plate
    return _Body(GRID, (0.0, 0.0), corners, thin, grid=distance_grid(mesh, MARGIN), mesh=mesh)


def _deepest(grid: Grid) -> Floats:
    """Return the innermost point (3,) m of a mesh: for a ring it lies in the ring, not in its hole."""
    at = np.unravel_index(np.argmin(grid.distance), grid.distance.shape)
    return np.asarray(grid.origin + grid.spacing * np.array(at))


def _planes(tool: Tool, file: str, hull: trimesh.Trimesh) -> Floats:
    normals = np.asarray(hull.face_normals)
    offsets = np.einsum("ij,ij->i", normals, hull.triangles[:, 0])
    planes = np.unique(np.round(np.column_stack([normals, offsets]), 9), axis=0)
    if len(planes) > MAX_PLANES:
        raise UserError(
            f"tool '{tool.name}': the convex hull of '{file}' has {len(planes)} faces; simplify it to {MAX_PLANES}"
        )
    return planes


def _grown(body: _Body) -> fcl.CollisionGeometry:
    grow = MARGIN + SLACK
    if body.kind == SPHERE:
        return fcl.Sphere(body.size[0] + grow)
    if body.kind == CAPSULE:
        return fcl.Capsule(body.size[0] + grow, body.size[1])
    import trimesh
    from scipy.spatial import HalfspaceIntersection

    assert body.mesh is not None
    if body.kind == GRID:
        # A box around it: for points in its concavities, the distances decide.
        low, high = body.mesh.bounds[0] - grow, body.mesh.bounds[1] + grow
        grown = trimesh.creation.box(bounds=[low, high])
    else:
        # The planes are moved outward, so that every point within the margin of a face is inside.
        halfspaces = np.column_stack([body.planes[:, :3], -(body.planes[:, 3] + grow)])
        corners = HalfspaceIntersection(halfspaces, body.mesh.vertices.mean(axis=0)).intersections
        grown = trimesh.convex.convex_hull(corners)
    faces = np.column_stack([np.full(len(grown.faces), 3), grown.faces]).ravel()
    return fcl.Convex(np.asarray(grown.vertices), len(grown.faces), faces)
