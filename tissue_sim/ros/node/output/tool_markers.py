"""The tools as markers: the shape of each body where it is, and an arrow for the force on each tool."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import Point
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import Marker

from tissue_sim.array_types import Floats
from tissue_sim.contact.quaternions import Vector
from tissue_sim.contact.tools import ToolSet
from tissue_sim.ros.node.output.markers import MarkerBytes, empty_marker, force_arrow

TOOL_COLOUR = (0.60, 0.63, 0.70, 0.8)


class ToolMarkers:
    """The MarkerArray of a scene's tools; the markers of each have its name for a namespace, the arrow comes last.

    A sphere is one marker; a capsule a cylinder between two spheres; a mesh its triangles; a gripper two of those.

    frame_id: frame of the poses.
    """

    def __init__(self, frame_id: str, tools: ToolSet) -> None:
        self._parts: list[list[tuple[int, int, Floats]]] = []  # of a tool: marker, index of its body, its place on it
        self._arrows: list[int] = []
        markers: list[Marker] = []
        for tool, bodies in zip(tools.tools, tools.bodies, strict=True):
            parts: list[tuple[int, int, Floats]] = []
            for member, body in enumerate(bodies):
                for part in _parts(tools, body):
                    marker = empty_marker(frame_id, tool.name, len(parts), part.kind, TOOL_COLOUR, part.scale)
                    marker.points = [Point(x=x, y=y, z=z) for x, y, z in part.corners.tolist()]
                    parts.append((len(markers), member, np.array(part.place)))
                    markers.append(marker)
            self._parts.append(parts)
            self._arrows.append(len(markers))
            markers.append(force_arrow(frame_id, tool.name, len(parts)))
        self._bytes = MarkerBytes(markers)

    def message(self, stamp: int, placed: Sequence[Floats | None], tips: Floats, forces: Floats) -> bytes:
        """Return the message.

        stamp: its time, ns; placed (b, 7) m and quaternion xyzw: poses of each tool's bodies, or None where it isn't
        moved; tips (T, 3) m: starts of the arrows; forces (T, 3) N: forces on the tools.
        """
        self._bytes.stamp(stamp)
        for tool, poses in enumerate(placed):
            for index, member, place in self._parts[tool]:
                self._bytes.show(index, poses is not None)
                if poses is not None:
                    pose, shown = poses[member], self._bytes.poses[index]
                    shown[:3] = pose[:3] + Rotation.from_quat(pose[3:]).apply(place)
                    shown[3:] = pose[3:]
            force = forces[tool] if poses is not None else np.zeros(3)
            self._bytes.draw_force(self._arrows[tool], tips[tool], force)
        return self._bytes.message()

    def deletion(self) -> bytes:
        """Return the same markers, all deleted: for the shutdown."""
        return self._bytes.deletion()


class _Part(NamedTuple):
    """One marker of a body: its kind, its place on the body, m, its scale, and points (k, 3) m if it has any."""

    kind: int
    scale: tuple[float, float, float]
    place: Vector = (0.0, 0.0, 0.0)
    corners: Floats = np.zeros((0, 3))


def _parts(tools: ToolSet, body: int) -> list[_Part]:
    radius, length = map(float, tools.shapes.size[body])
    mesh, wide = tools.meshes[body], 2.0 * radius
    if mesh is not None:
        return [_Part(Marker.TRIANGLE_LIST, (1.0, 1.0, 1.0), corners=np.array(mesh.triangles).reshape(-1, 3))]
    ball = _Part(Marker.SPHERE, (wide, wide, wide))
    if length == 0.0:  # a sphere: RViz shows a cylinder without height as an error
        return [ball]
    shaft = _Part(Marker.CYLINDER, (wide, wide, length), (0.0, 0.0, -0.5 * length))
    return [ball, shaft, ball._replace(place=(0.0, 0.0, -length))]
