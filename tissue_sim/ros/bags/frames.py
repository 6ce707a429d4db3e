"""A bag as frames for other programs: VTU with times for ParaView, GLB for Blender."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tissue_sim.array_types import Array, Floats, Ints, Longs
from tissue_sim.contact.tools import ToolSet
from tissue_sim.errors import UserError
from tissue_sim.model.data.shapes import CAPSULE, SPHERE
from tissue_sim.organ.meshes.mesh_formats import GLTF_TO_LPS
from tissue_sim.rendering.appearance import shade_of, shades, tissue_colour
from tissue_sim.ros.bags.comparison import Shown
from tissue_sim.ros.bags.organ_player import ShownSurface
from tissue_sim.ros.bags.player import Player
from tissue_sim.ros.bags.reading import Bag

if TYPE_CHECKING:
    from trimesh import Trimesh

STEEL = (190, 195, 200)  # a tool's colour
MOST_FRAMES = 10_000


class Part(NamedTuple):
    """An organ's surface or a tool in a frame.

    positions (n, 3) m; triangles (t, 3); data (n, ...) of the points, by name with unit; colours (n, 3), 0 to 255.
    """

    name: str
    positions: Floats
    triangles: Ints
    data: dict[str, Array]
    colours: NDArray[np.uint8]


class Frame(NamedTuple):
    """What a tick shows; time in s since the bag's first tick."""

    tick: int
    time: float
    parts: list[Part]


def frames_of(bag: Bag, every: int) -> list[Frame]:
    """Replay a bag, and return every so many ticks the organs' surfaces and the tools.

    Tools stand where their poses were when a tick took them up, and carry the force on the hand.

    Raises UserError for a bag that can't be replayed or would give more than MOST_FRAMES frames.
    """
    ticks = np.arange(bag.first_tick + every, bag.last_tick + 1, every)
    if not len(ticks):
        raise UserError(f"bag {bag.path} has {bag.last_tick - bag.first_tick} ticks: too few for one frame in {every}")
    if len(ticks) > MOST_FRAMES:
        raise UserError(f"bag {bag.path} would give {len(ticks)} frames, at most {MOST_FRAMES} are written")
    organs, count = list(bag.organs.items()), len(ticks)
    wanted = Shown(
        [tool.name for tool in bag.tools],
        [ticks] * len(bag.tools),
        [np.zeros((count, 6))] * len(bag.tools),
        [ticks[:0]] * len(organs),
        [np.zeros((0, organ.n_surface, 3), dtype=np.float32) for _, organ in organs],
    )
    player, at, surfaces = Player(bag.recording, [organ for _, organ in organs]), set(ticks.tolist()), {}

    def keep(tick: int) -> None:
        if tick in at:
            surfaces[tick] = [one.shown() for one in player.organs]

    shown = player.run(wanted, keep).shown
    tools = ToolSet(bag.tools)
    of_tools = [
        _ShownTool(bag, tools, number, ticks, wrenches[:, :3]) for number, wrenches in enumerate(shown.wrenches)
    ]
    scales = {name: shades(tissue_colour(name)) for name, _ in organs}
    frames = []
    for index, (tick, time) in enumerate(zip(ticks.tolist(), bag.clock(ticks).tolist(), strict=True)):
        parts = [
            _organ_part(name, surface, scales[name]) for (name, _), surface in zip(organs, surfaces[tick], strict=True)
        ]
        frames.append(Frame(tick, time, parts + [part for tool in of_tools for part in tool.parts(index)]))
    return frames


def _organ_part(name: str, surface: ShownSurface, scale: Floats) -> Part:
    moved = surface.positions - surface.rest
    shades_of = shade_of(moved, scale).astype(np.uint8)
    return Part(name, surface.positions, surface.triangles, {"displacement_m": moved}, shades_of)


class _ShownTool:
    """A tool in the frames of some ticks (k,), body by body, with the force (k, 3) N on the hand."""

    def __init__(self, bag: Bag, tools: ToolSet, number: int, ticks: Longs, forces: Floats) -> None:
        self._tools, self._number, self._forces = tools, number, forces
        self._name, self._bodies = bag.tools[number].name, tools.bodies[number]
        series = [bag.get(f"{self._name}/{part}") for part in ("position", "quaternion", "angle")]
        position, quaternion, angle = (one.at(ticks) if one is not None else None for one in series)
        self._poses = np.full((len(ticks), 7), np.nan)
        if position is not None and quaternion is not None:
            self._poses = np.hstack([position, quaternion])
        self._angles = np.zeros(len(ticks)) if angle is None else angle
        self._meshes = [_mesh(tools, body) for body in self._bodies]

    def parts(self, index: int) -> list[Part]:
        """Return what is seen of it in a frame: nothing before its first pose."""
        if np.isnan(self._poses[index]).any():
            return []
        poses = self._tools.poses(self._number, self._poses[index], float(self._angles[index]))
        made = []
        for jaw, (mesh, pose) in enumerate(zip(self._meshes, poses, strict=True)):
            name = self._name if len(self._meshes) == 1 else f"{self._name}_{jaw}"
            positions = Rotation.from_quat(pose[3:]).apply(mesh.vertices) + pose[:3]
            force = np.tile(self._forces[index], (len(positions), 1))
            colours = np.tile(np.array(STEEL, dtype=np.uint8), (len(positions), 1))
            made.append(Part(name, positions, np.asarray(mesh.faces), {"force_N": force}, colours))
        return made


def _mesh(tools: ToolSet, body: int) -> Trimesh:
    """Return a body as a mesh of trimesh, m, in its own frame."""
    import trimesh

    radius, length = tools.shapes.size[body]
    kind = tools.shapes.kind[body]
    if kind == SPHERE:
        return trimesh.creation.icosphere(3, radius)
    if kind == CAPSULE:  # its tip's cap around the origin, the other one along -z
        made = trimesh.creation.capsule(length, radius)
        made.apply_translation([0.0, 0.0, -made.bounds.mean(axis=0)[2] - 0.5 * length])
        return made
    mesh = tools.meshes[body]
    assert mesh is not None
    return mesh


# files ---------------------------------------------------------------------------------------------


def write_vtu(path: Path, frames: Sequence[Frame], scale: float) -> list[Path]:
    """Write each part of each frame as VTU into a folder beside `path`, a .pvd file that states their times.

    path: the .pvd file, which ParaView opens as one animation; frames: in order; scale: factor on metres. Returns what
    was written, the .pvd file first. Raises UserError without meshio; OSError where a file can't be written.
    """
    try:
        import meshio
    except ModuleNotFoundError:
        raise UserError("frames as VTU need meshio: pip install 'tissue_sim[image]'") from None
    folder = path.with_suffix("")
    folder.mkdir(exist_ok=True)
    root = ElementTree.Element("VTKFile", type="Collection", version="1.0", byte_order="LittleEndian")
    collection = ElementTree.SubElement(root, "Collection")
    written = [path]
    for number, frame in enumerate(frames):
        for place, part in enumerate(frame.parts):
            file = folder / f"{_file_name(part.name)}_{number:04d}.vtu"
            lengths = {name: (scale if name.endswith("_m") else 1.0) * values for name, values in part.data.items()}
            mesh = meshio.Mesh(scale * part.positions, {"triangle": part.triangles}, point_data=lengths)
            mesh.write(file, file_format="vtu")
            found = {"timestep": repr(frame.time), "part": str(place), "name": part.name}
            ElementTree.SubElement(collection, "DataSet", found, file=f"{folder.name}/{file.name}")
            written.append(file)
    ElementTree.indent(root)
    path.write_bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")
    return written


def write_glb(path: Path, frames: Sequence[Frame], scale: float) -> list[Path]:
    """Write each frame as GLB: of `poke.glb`, poke_0000.glb and on; tick and time are the scene's extras.

    path: what the names begin with; frames: in order; scale: factor on metres (glTF is in metres, so 1). Returns what
    was written. Raises UserError where more frames of an earlier export would be left, and taken for some of this one;
    OSError where a file can't be written.
    """
    import trimesh

    earlier = sorted(path.parent.glob(f"{path.stem}_[0-9][0-9][0-9][0-9].glb"))
    if left := [file for file in earlier if int(file.stem[-4:]) >= len(frames)]:
        raise UserError(f"{left[0]} is a frame of an earlier export; remove it and those after it first")
    written = []
    for number, frame in enumerate(frames):
        scene = trimesh.Scene(metadata={"tick": frame.tick, "time_s": frame.time})
        for part in frame.parts:
            positions = scale * part.positions @ GLTF_TO_LPS
            mesh = trimesh.Trimesh(positions, part.triangles, vertex_colors=part.colours, process=False)
            scene.add_geometry(mesh, node_name=part.name, geom_name=part.name)
        file = path.with_name(f"{path.stem}_{number:04d}.glb")
        file.write_bytes(scene.export(file_type="glb"))
        written.append(file)
    return written


def _file_name(name: str) -> str:
    return re.sub(r"[^\w-]+", "_", name)
