"""Steps of many copies of an organ and its tools without Python: contact search, contact set, tick."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.contact.broad_phase import (
    NearTriangles,
    body_box,
    boxes_apart,
    boxes_meet,
    surface_box,
    triangles_in_box,
)
from tissue_sim.contact.contact_points import Fineness, FoundPoints, Lattices, Search, points_near, set_compliance
from tissue_sim.contact.crossings import crossings_above
from tissue_sim.contact.finder import TISSUE_MOTION, ContactFinder
from tissue_sim.contact.reach_margins import MAX_MARGIN
from tissue_sim.contact.tools import MARGIN
from tissue_sim.handles import handle
from tissue_sim.jit import kernel
from tissue_sim.model.contact.poses import distance_along_path
from tissue_sim.model.contact.shapes import rotation_matrix
from tissue_sim.model.data.contact_set import MAX_CONTACT_POINTS, POINT_NODES, ContactSet, Engaged, contact_set
from tissue_sim.model.data.shapes import Shapes
from tissue_sim.model.data.state import State
from tissue_sim.model.data.world import World
from tissue_sim.model.stepping.inputs import take_contacts, take_pose
from tissue_sim.model.stepping.tick import tick

NO_COPY = -1  # in place of a copy that waits for Python


class Tables(NamedTuple):
    """Tables of an organ and B bodies for the contact search, shared by all copies."""

    triangles: Ints | Longs  # (t, 3)
    n_surface: int
    rest: Floats  # (n, 3) m
    lattices: Lattices
    parts: Longs  # (B, t), with
    yielding: Floats  # (B, t, 2) and
    corner_yielding: Floats  # (B, n, 2) see Fineness
    corners: Floats  # (k, 3) m, see ToolSet, of all bodies one after the other
    corner_start: Longs  # (B + 1,)
    padding: Floats  # (B,) m
    middle: Floats  # (m, 3) m, see ToolSet
    middle_start: Longs  # (B + 1,)
    is_fine: Longs  # (B,) 1 for bodies that need the nearest point of each triangle
    compliance: Floats  # (B, n, 2) m/N
    between: Floats  # (B,)


class SearchMemory(NamedTuple):
    """Working memory of a contact search; each thread has its own."""

    near: NearTriangles
    low: Floats  # (3,) m, box of the surface
    high: Floats
    box_low: Floats  # (3,) m, box of a body
    box_high: Floats
    matrix: Floats  # (9,)
    normal: Floats  # (n, 3)
    seen: Longs  # (n,)
    points: FoundPoints
    found: ContactSet  # the contact set


class CopyProgress(NamedTuple):
    """Progress of n copies, and the remaining ticks."""

    ticks_a_set: int
    left: Longs  # (n,) remaining ticks
    ticks: Longs  # (n,) ticks since its reset
    sequence: Longs  # (n,) number of its newest pose or contact set
    is_found: Longs  # (n,) 1 where the contact set of the coming tick was found by Python
    goal: Floats  # (n, B, 7) poses that the bodies were moving to when contacts were last searched
    has_goal: Longs  # (n,) 1 where they were searched since its reset


def tables_of(finder: ContactFinder) -> Tables:
    """Return a handle of a finder's tables of its organ and tools.

    Parameters
    ----------
    finder : ContactFinder
        The finder.
    """
    tools, finenesses = finder.tools, finder.finenesses
    bodies, n = len(tools.grown), finder.n_points
    triangles = len(finder.triangles)
    return handle(
        Tables(
            triangles=finder.triangles,
            n_surface=n,
            rest=finder.rest,
            lattices=finder.lattices,
            parts=np.array([one.parts for one in finenesses], dtype=np.int64).reshape(bodies, triangles),
            yielding=np.array([one.yielding for one in finenesses]).reshape(bodies, triangles, 2),
            corner_yielding=np.array([one.corner_yielding for one in finenesses]).reshape(bodies, n, 2),
            corners=np.concatenate([np.zeros((0, 3)), *tools.corners]),
            corner_start=_starts(tools.corners),
            padding=np.array(tools.padding, dtype=np.float64),
            middle=np.concatenate([np.zeros((0, 3)), *tools.middle]),
            middle_start=_starts(tools.middle),
            is_fine=np.array(finder.is_fine, dtype=np.int64),
            compliance=finder.compliance,
            between=finder.between,
        )
    )


def _starts(parts: Sequence[Floats]) -> Longs:
    return np.cumsum([0, *map(len, parts)]).astype(np.int64)


def search_memory(finder: ContactFinder) -> SearchMemory:
    """Return a handle of working memory for one thread.

    Parameters
    ----------
    finder : ContactFinder
        The finder.
    """
    bodies, n, triangles = len(finder.tools.grown), finder.n_points, len(finder.triangles)

    def longs(*shape: int) -> Longs:
        return np.zeros(shape, dtype=np.int64)

    # If more points are found than fit into a contact set, Python selects from them.
    body, triangle, corners = longs(MAX_CONTACT_POINTS), longs(MAX_CONTACT_POINTS), longs(MAX_CONTACT_POINTS, 3)
    weight, normal, yielding = (np.zeros((MAX_CONTACT_POINTS, columns)) for columns in (3, 3, 2))
    points = FoundPoints(body, triangle, corners, weight, normal, yielding)
    return handle(
        SearchMemory(
            near=NearTriangles(longs(triangles, 3), longs(triangles)),
            low=np.zeros(3),
            high=np.zeros(3),
            box_low=np.zeros(3),
            box_high=np.zeros(3),
            matrix=np.zeros(9),
            normal=np.zeros((n, 3)),
            seen=longs(n),
            points=points,
            found=contact_set(bodies),
        )
    )


@kernel
def take_poses(worlds: Sequence[World], copies: Longs, poses: Floats, course: CopyProgress) -> None:
    """Give the bodies of some copies new poses.

    Parameters
    ----------
    worlds : Sequence[World]
        Row of the copies' worlds; updated.
    copies : Longs, shape (k,)
        Which copies.
    poses : Floats, shape (k, B, 7), m and unit quaternions xyzw
        The poses.
    course : CopyProgress
        Course of the copies; updated.
    """
    for index in range(len(copies)):
        copy = copies[index]
        world, tools = worlds[copy], 0
        for body in range(poses.shape[1]):
            tools = world.shapes.tool[body] + 1
            take_pose(world, body, poses[index, body], 0, course.sequence[copy] + tools)
        course.sequence[copy] += tools


@kernel
def advance_copies(
    worlds: Sequence[World], course: CopyProgress, tables: Tables, room: SearchMemory, copies: Longs
) -> int:
    """Advance copies one after the other by their remaining ticks.

    Parameters
    ----------
    worlds : Sequence[World]
        Row of the copies' worlds; updated.
    course : CopyProgress
        Course of the copies; updated.
    tables : Tables
        Tables of the organ and the bodies.
    room : SearchMemory
        Working memory of this thread.
    copies : Longs, shape (k,)
        Which copies.

    Returns
    -------
    int
        The copy whose contacts Python must find before it can continue; NO_COPY if all are done.
    """
    for index in range(len(copies)):
        copy = copies[index]
        world = worlds[copy]
        while course.left[copy] > 0:
            if course.ticks[copy] % course.ticks_a_set == 0 and course.is_found[copy] == 0:
                course.sequence[copy] += 1
                if not _search(world, course, copy, tables, room):
                    return copy
                take_contacts(world.state, world.shapes, room.found, course.sequence[copy])
            course.is_found[copy] = 0
            course.ticks[copy] += 1
            course.left[copy] -= 1
            tick(world)
    return NO_COPY


@kernel
def _search(world: World, course: CopyProgress, copy: int, tables: Tables, room: SearchMemory) -> bool:
    """Write the contact set of a copy to room.found; return False if a body needs the finder in Python.

    That is for the way out of a body that has slipped in, the nearest points of triangles that are too coarse for a
    body, the surface under a tip that pushes, and a selection among too many points. FCL isn't used, as it only saves
    time.
    """
    state, shapes, found = world.state, world.shapes, room.found
    surface_box(state.position, tables.n_surface, room.low, room.high)
    count = 0
    for body in range(len(state.bodies)):
        status, pose = state.bodies[body], state.body_pose[body]
        if status.force_age >= 0:
            return False
        margin = _margin(state, shapes, course, copy, body)
        reach, before = MARGIN + margin, count
        found.reach[body] = reach - TISSUE_MOTION
        is_fresh = status.age >= 0 and not status.released
        if is_fresh:
            rotation_matrix(pose[3:], room.matrix)
            if _is_swallowed(state.position, pose, body, tables, room):
                return False
            corners = tables.corners[tables.corner_start[body] : tables.corner_start[body + 1]]
            body_box(corners, tables.padding[body] + reach, room.matrix, pose[:3], room.box_low, room.box_high)
            some = 0
            if boxes_meet(room.box_low, room.box_high, room.low, room.high):
                some, _ = triangles_in_box(
                    state.position, tables.rest, tables.triangles, room.box_low, room.box_high, room.near
                )
            if some == 0:
                apart = boxes_apart(room.box_low, room.box_high, room.low, room.high)
                found.reach[body] = max(found.reach[body], reach + apart - TISSUE_MOTION)
            elif tables.is_fine[body] == 1:
                return False
            else:
                fineness = Fineness(tables.parts[body], tables.yielding[body], tables.corner_yielding[body])
                search = Search(
                    state.position, shapes, body, tables.lattices, fineness, pose[:3], room.matrix, reach, room.normal
                )
                near = room.near.node[:some]
                count = points_near(near, room.near.number[:some], search, room.seen, room.points, count)
        found.engaged[body] = Engaged.YES.value if is_fresh else Engaged.NO.value
        found.n_points[body] = count - before
        found.releases[body] = status.releases
        for c in range(7):
            found.place[body, c] = pose[c]
        for c in range(POINT_NODES):
            found.tip_node[body, c], found.tip_weight[body, c] = -1, 0.0
    if count > MAX_CONTACT_POINTS:
        return False
    for body in range(len(state.bodies)):
        for c in range(7):
            course.goal[copy, body, c] = state.body_goal[body, c]
    course.has_goal[copy] = 1
    _fill(found, room.points, count, tables)
    return True


@kernel
def _margin(state: State, shapes: Shapes, course: CopyProgress, copy: int, body: int) -> float:
    """Return the margin of a body, m, as `reach_margins` does."""
    goal = state.body_goal[body]
    covered = distance_along_path(state.body_pose[body], goal, shapes.extent[body])
    if course.ticks_a_set > 1 and course.has_goal[copy] == 1:
        covered += 2.0 * distance_along_path(course.goal[copy, body], goal, shapes.extent[body])
    return 1e-3 * math.ceil(1e3 * min(max(covered - 0.5 * MARGIN, 0.0), MAX_MARGIN))


@kernel
def _fill(found: ContactSet, points: FoundPoints, count: int, tables: Tables) -> None:
    """Write the first `count` points that were found to a contact set."""
    found.header.points, found.header.dropped = count, 0
    for point in range(count):
        found.body[point] = points.body[point]
        for c in range(3):
            found.node[point, c] = points.node[point, c]
            found.weight[point, c] = points.weight[point, c]
            found.normal[point, c] = points.normal[point, c]
        found.node[point, 3], found.weight[point, 3] = points.node[point, 0], 0.0  # the surface has no cuts
    set_compliance(found, points.node, points.weight, points.yielding, tables.compliance, tables.between)


@kernel
def _is_swallowed(position: Floats, pose: Floats, body: int, tables: Tables, room: SearchMemory) -> bool:
    """Return whether one of a body's centre points lies inside the surface; room holds the body's matrix."""
    m = room.matrix
    for index in range(tables.middle_start[body], tables.middle_start[body + 1]):
        x, y, z = tables.middle[index, 0], tables.middle[index, 1], tables.middle[index, 2]
        px = m[0] * x + m[1] * y + m[2] * z + pose[0]
        py = m[3] * x + m[4] * y + m[5] * z + pose[1]
        pz = m[6] * x + m[7] * y + m[8] * z + pose[2]
        if px < room.low[0] or py < room.low[1] or pz < room.low[2]:
            continue
        if px > room.high[0] or py > room.high[1] or pz > room.high[2]:
            continue
        if crossings_above(position, tables.triangles, px, py, pz) > 0:
            return True
    return False


@kernel
def read_surfaces(worlds: Sequence[World], found: Floats) -> None:
    """Write the surface positions of all copies, with the displacement by the breath.

    Parameters
    ----------
    worlds : Sequence[World]
        Row of the copies' worlds.
    found : Floats, shape (n, n_surface, 3), m
        The positions; updated.
    """
    for copy in range(len(worlds)):
        state = worlds[copy].state
        for node in range(found.shape[1]):
            for axis in range(3):
                found[copy, node, axis] = state.position[node, axis] + state.carried[axis]


@kernel
def read_tools(worlds: Sequence[World], poses: Floats, wrenches: Floats) -> None:
    """Write the poses and wrenches of the bodies of all copies.

    Parameters
    ----------
    worlds : Sequence[World]
        Row of the copies' worlds.
    poses : Floats, shape (n, B, 7), m and quaternion xyzw
        Their poses, with the displacement by the breath; updated.
    wrenches : Floats, shape (n, B, 6), N and N m
        Their wrenches; updated.
    """
    for copy in range(len(worlds)):
        state = worlds[copy].state
        for body in range(poses.shape[1]):
            for c in range(7):
                poses[copy, body, c] = state.body_pose[body, c] + (state.carried[c] if c < 3 else 0.0)
            for c in range(6):
                wrenches[copy, body, c] = state.wrench[body, c]
