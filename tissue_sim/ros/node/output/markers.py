"""Markers as bytes: serialised once, then written in place by kernels and published as they are.

A message lies cold in memory when its turn comes, every 16 ms, and so does the code that fills it: one call of one
kernel takes a third of the time of a dozen of NumPy's.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose
from rclpy.serialization import serialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from tissue_sim.array_types import Floats, Ints, Longs, Pixels, Singles
from tissue_sim.jit import kernel
from tissue_sim.organ.organ import Organ
from tissue_sim.rendering.appearance import SHADES, TISSUE
from tissue_sim.ros.shared.cdr import CDR_HEADER
from tissue_sim.ros.shared.shown_organ import ShownOrgan

SENTINEL = 1.2345678901234567e89
COLOUR_SENTINEL = 1.2345e30
FORCE_COLOUR = (0.20, 0.55, 0.95, 1.0)
SURFACE_COLOUR = (*(part / 255.0 for part in TISSUE), 1.0)
SKELETON_COLOUR = (0.95, 0.90, 0.55, 1.0)
ARROW_LENGTH = 0.03  # m for 1 N
LEAST_FORCE = 1e-4  # N, least force with an arrow
ADD, DELETE = int(Marker.ADD), int(Marker.DELETE)


class Template(NamedTuple):
    """Message as numbers, and where the stamp, the action and the points of each of its markers are."""

    words: Ints
    numbers: Floats
    stamps: Longs  # index in words
    actions: Longs  # index in words
    starts: Longs  # index of the first point in numbers


class Drawn(NamedTuple):
    """Nodes whose positions are the points of markers, one marker after the other."""

    nodes: Longs  # (k,)
    ends: Longs  # (m,) of each marker's nodes


class MarkerBytes:
    """A MarkerArray as bytes whose stamps, actions, poses, points and colours are written in place.

    Parameters
    ----------
    markers : Sequence[Marker]
        The markers, which keep their kinds and numbers of points and colours.

    Attributes
    ----------
    poses : shape (7,) each, m and quaternion xyzw
        Pose of each marker.
    points : shape (k, 3) each, m
        Points of each marker.
    colours : shape (c, 4) each
        Red, green, blue, alpha of each marker.
    template
        The message, for kernels.
    """

    def __init__(self, markers: Sequence[Marker]) -> None:
        given = [np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 3) for marker in markers]
        for index, marker in enumerate(markers):
            marker.header.stamp = Time(sec=0x5EED, nanosec=0x5EED0000 + index)
            marker.action = 0x5EED000
            marker.pose.position.x, marker.pose.orientation.w = SENTINEL, 1.0
            if marker.points:
                marker.points = [Point(x=SENTINEL), *marker.points[1:]]
            if marker.colors:
                marker.colors = [ColorRGBA(r=COLOUR_SENTINEL), *marker.colors[1:]]
        raw = serialize_message(MarkerArray(markers=list(markers)))
        self._bytes = _aligned(raw)
        body = self._bytes[CDR_HEADER:]
        words, numbers = body[: len(body) // 4 * 4].view("<i4"), body[: len(body) // 8 * 8].view("<f8")
        places = (np.zeros(len(markers), dtype=np.int64) for _ in range(3))
        self.template = template = Template(words, numbers, *places)
        self.poses, self.points, self.colours = [], [], []
        at = 0
        for index, marker in enumerate(markers):
            n_points, n_colours = len(marker.points), len(marker.colors)
            at = raw.find(struct.pack("<iI", 0x5EED, 0x5EED0000 + index), at)
            template.stamps[index] = (at - CDR_HEADER) // 4
            at = raw.find(struct.pack("<i", 0x5EED000), at)
            template.actions[index] = (at - CDR_HEADER) // 4
            at = raw.find(struct.pack("<d", SENTINEL), at)
            self.poses.append(self._bytes[at : at + 56].view("<f8"))
            self.poses[-1][0] = 0.0
            at += 56
            if n_points:
                at = raw.find(struct.pack("<d", SENTINEL), at)
            template.starts[index] = (at - CDR_HEADER) // 8
            self.points.append(self._bytes[at : at + 24 * n_points].view("<f8").reshape(n_points, 3))
            self.points[-1][:] = given[index]
            at += 24 * n_points
            if n_colours:
                at = raw.find(struct.pack("<f", COLOUR_SENTINEL), at)
            self.colours.append(self._bytes[at : at + 16 * n_colours].view("<f4").reshape(n_colours, 4))
            at += 16 * n_colours
        words[template.actions] = ADD

    def stamp(self, stamp: int) -> None:
        """Set the stamp of every marker, ns."""
        write_stamp(self.template, stamp)

    def show(self, index: int, is_shown: bool) -> None:
        """Add a marker of an index, or delete it."""
        self.template.words[self.template.actions[index]] = ADD if is_shown else DELETE

    def draw_force(self, index: int, start: Floats, force: Floats) -> None:
        """Show a force as an arrow; without a force the arrow is deleted.

        index: index of its marker; start (3,) m: start of the arrow; force (3,) N.
        """
        write_force(self.template, index, start, force)

    def message(self) -> bytes:
        """Return the message as it stands."""
        return self._bytes.tobytes()

    def deletion(self) -> bytes:
        """Return the same markers, all deleted: for the shutdown."""
        self.template.words[self.template.actions] = DELETE
        return self.message()


class OrganMarkers:
    """The MarkerArray of organs: the surface and the skeleton of each, and an arrow for each tool's contact force.

    frame_id: frame of the positions; organs: the organs by the prefix of their markers' namespaces, empty for a single
    one; n_tools: number of tools; coloured: whether a surface has a colour for each corner of a triangle, which makes
    the message two thirds longer.
    """

    def __init__(self, frame_id: str, organs: Mapping[str, ShownOrgan], n_tools: int, coloured: bool = False) -> None:
        markers: list[Marker] = []
        drawn: list[Longs] = []
        self._surfaces: list[tuple[int, Longs]] = []  # marker of each, and its corners
        first = 0  # row of an organ
        for name, shown in organs.items():
            organ = shown.organ
            before = f"{name}/" if name else ""
            corners = first + shown.triangle_rows.ravel()
            bones = first + organ.n_surface + skeleton_lines(organ)
            surface = empty_marker(frame_id, f"{before}surface", 0, Marker.TRIANGLE_LIST, SURFACE_COLOUR, (1.0,) * 3)
            skeleton = empty_marker(
                frame_id, f"{before}skeleton", 0, Marker.LINE_LIST, SKELETON_COLOUR, (1e-3, 0.0, 0.0)
            )
            surface.points, skeleton.points = [Point()] * len(corners), [Point()] * len(bones)
            if coloured:
                surface.colors = [ColorRGBA()] * len(corners)
            self._surfaces.append((len(markers), corners))
            for marker, nodes in ((surface, corners), (skeleton, bones)):
                if len(nodes):  # a marker with an empty list is refused by RViz: an organ may have no bones
                    markers.append(marker)
                    drawn.append(nodes)
            first += shown.n_rows
        ends = np.cumsum([len(nodes) for nodes in drawn])
        self._drawn = Drawn(np.concatenate(drawn).astype(np.int64), ends)
        markers += [force_arrow(frame_id, "contacts", tool) for tool in range(n_tools)]
        self._bytes = MarkerBytes(markers)
        # Compiled here, or else while a subscriber waits for the first message.
        rest = np.concatenate([shown.rest for shown in organs.values()])
        all_finite(rest)
        fraction = np.zeros(len(rest)) if coloured else None
        if fraction is not None:
            write_displacement(fraction, rest, rest, 1.0)
        self.message(0, rest, np.zeros((n_tools, 3)), np.zeros((n_tools, 6)), fraction)

    def message(
        self, stamp: int, positions: Floats, centre: Floats, wrench: Floats, fraction: Floats | None = None
    ) -> bytes:
        """Return the message.

        stamp: its time, ns; positions (n, 3) m: positions of all rows, one organ after the other; centre (T, 3) m:
        where each tool touches; wrench (T, 6) N and N m: what each tool feels (a tool without force has its arrow
        deleted); fraction (n,): each row's place on the colour scale, 0 to 1, if they are coloured.
        """
        made = self._bytes
        write_organs(made.template, stamp, positions, self._drawn, centre, wrench)
        if fraction is not None:
            for marker, corners in self._surfaces:
                write_colours(made.colours[marker], corners, fraction, SHADES)
        return made.message()

    def deletion(self) -> bytes:
        """Return the same markers, all deleted: for the shutdown."""
        return self._bytes.deletion()


# kernels ---------------------------------------------------------------------------------------
@kernel
def write_organs(
    template: Template, stamp: int, positions: Floats, drawn: Drawn, centre: Floats, wrench: Floats
) -> None:
    """Write markers by their nodes, and behind these an arrow for each tool."""
    write_stamp(template, stamp)
    first = 0
    for marker in range(len(drawn.ends)):
        end = drawn.ends[marker]
        write_points(template.numbers, template.starts[marker], positions, drawn.nodes[first:end])
        first = end
    for tool in range(len(centre)):
        write_force(template, len(drawn.ends) + tool, centre[tool], wrench[tool])


@kernel
def write_stamp(template: Template, stamp: int) -> None:
    """Write the time of every marker, ns."""
    for index in range(len(template.stamps)):
        at = template.stamps[index]
        template.words[at] = stamp // 1_000_000_000
        template.words[at + 1] = stamp % 1_000_000_000


@kernel
def write_points(numbers: Floats, start: int, positions: Floats, nodes: Longs) -> None:
    """Write the positions (n, 3) m of nodes (k,), one after the other."""
    for index in range(len(nodes)):
        node, at = nodes[index], start + 3 * index
        numbers[at] = positions[node, 0]
        numbers[at + 1] = positions[node, 1]
        numbers[at + 2] = positions[node, 2]


@kernel
def write_force(template: Template, index: int, start: Floats, force: Floats) -> None:
    """Write both ends of the arrow that a marker is, and whether there is one."""
    size, at = 0.0, template.starts[index]
    for axis in range(3):
        size += force[axis] * force[axis]
        template.numbers[at + axis] = start[axis]
        template.numbers[at + 3 + axis] = start[axis] + ARROW_LENGTH * force[axis]
    template.words[template.actions[index]] = ADD if size > LEAST_FORCE * LEAST_FORCE else DELETE


@kernel
def write_colours(colours: Singles, corners: Longs, fraction: Floats, scale: Singles) -> None:
    """Write the colour (4,) of each corner from a scale (m, 4) and each node's place on it, fraction (n,)."""
    for index in range(len(corners)):
        place = int(min(fraction[corners[index]], 1.0) * (len(scale) - 1))
        for channel in range(4):
            colours[index, channel] = scale[place, channel]


@kernel
def write_displacement(fraction: Floats, positions: Floats, rest: Floats, full: float) -> None:
    """Write how far each position is from rest, as a fraction.

    fraction (n,): the fractions (updated); positions (n, 3) m; rest (n, 3) m: the same at rest; full: displacement
    whose fraction is 1, m.
    """
    for node in range(len(positions)):
        square = 0.0
        for axis in range(3):
            square += (positions[node, axis] - rest[node, axis]) ** 2
        fraction[node] = math.sqrt(square) / full


@kernel
def all_finite(positions: Floats) -> bool:
    """Return whether positions (n, 3) hold neither NaN nor infinity."""
    for node in range(len(positions)):
        for axis in range(3):
            if not math.isfinite(positions[node, axis]):
                return False
    return True


# parts -----------------------------------------------------------------------------------------
def empty_marker(
    frame_id: str, namespace: str, number: int, kind: int, colour: tuple[float, ...], scale: tuple[float, ...]
) -> Marker:
    """Return a marker without points.

    number: its id; kind: its type; colour: red, green, blue, alpha; scale (3,): its scale, whose meaning depends on the
    type.
    """
    marker = Marker()
    marker.header.frame_id = frame_id
    marker.ns, marker.id, marker.type = namespace, number, kind
    marker.pose = Pose()
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = scale
    red, green, blue, alpha = colour
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    return marker


def force_arrow(frame_id: str, namespace: str, number: int) -> Marker:
    """Return the arrow of a force, whose points draw_force writes. number: its id."""
    marker = empty_marker(frame_id, namespace, number, Marker.ARROW, FORCE_COLOUR, (0.002, 0.004, 0.006))
    marker.points = [Point(), Point()]
    return marker


def skeleton_lines(organ: Organ) -> Longs:
    """Return the atom indices (2 b,) of the skeleton's line list: each atom and its parent."""
    child = np.flatnonzero(organ.atom_parent >= 0)
    return np.stack([child, organ.atom_parent[child]], axis=1).ravel()


def _aligned(raw: bytes) -> Pixels:
    """Return a message's bytes with its float64 aligned in memory: CDR aligns relative to the end of its header."""
    room = np.empty(len(raw) + 8, dtype=np.uint8)
    start = (-CDR_HEADER - room.ctypes.data) % 8
    aligned = room[start : start + len(raw)]
    aligned[:] = np.frombuffer(raw, dtype=np.uint8)
    return aligned
