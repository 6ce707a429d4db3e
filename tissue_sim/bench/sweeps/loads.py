"""Loads of the sweep: forces on a point, a patch or ten points, and a sphere moved through the organ."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import trimesh

from tissue_sim.array_types import Floats, Longs
from tissue_sim.bench.organs import press_node
from tissue_sim.contact.finder import ContactFinder, ContactQuery
from tissue_sim.contact.tools import Tool, ToolSet
from tissue_sim.model.simulation import Simulation
from tissue_sim.organ.organ import Organ

# On a point at the far end from what holds the organ; on a patch on a broad side, at the far end, or pulled outward
# on the broad side; on ten points; the probe into the broad side, or lengthwise from the far end.
LOADS = ("point", "patch", "far", "pull", "ten", "tool", "tool_far")
PATCH_NODES = 19  # a node and two rings around it
TEN = 10
PROBE = Tool("probe", radius=0.006)
CLEARANCE = 0.003  # m between the probe and the surface before it comes
AWAY = 0.03  # m from the surface where it goes afterwards
FOUND_EVERY = 0.004  # s between two contact sets, as in the node


class Loading(Protocol):
    """Load that acts on the organ for a number of ticks."""

    ticks: int

    def act(self, simulation: Simulation, tick: int) -> None:
        """Apply what acts in the coming tick."""

    def over(self, tick: int) -> bool:
        """Return whether it is being removed, or is gone."""


class NodalLoad:
    """Forces (k, 3) N on nodes (k,): a ramp, then a hold."""

    def __init__(self, nodes: Longs, forces: Floats, ramp: int, hold: int) -> None:
        self.nodes, self.forces, self.ramp = nodes, forces, ramp
        self.ticks = ramp + hold

    def act(self, simulation: Simulation, tick: int) -> None:
        """Apply the forces of the coming tick."""
        simulation.apply_force(self.nodes, min(1.0, (tick + 1) / self.ramp) * self.forces)

    def over(self, tick: int) -> bool:
        """Return whether this is the last tick: nothing acts after it."""
        return tick == self.ticks - 1


class Line(NamedTuple):
    """Line along which a probe goes in."""

    start: Floats  # (3,) m on the surface
    inward: Floats  # (3,) unit vector
    depth: float  # m of the probe's front below the surface where it ends


class Poke:
    """Probe that is moved along a line into the organ, held for some ticks, drawn back and away, one pose per tick.

    tick_time s; speed m/s.
    """

    def __init__(self, organ: Organ, line: Line, tick_time: float, hold: int, speed: float) -> None:
        reach = np.arange(-CLEARANCE, line.depth, speed * tick_time)
        back = np.arange(line.depth, -AWAY, -speed * tick_time)
        reach = np.concatenate([reach, np.full(hold, line.depth), back])
        self.path = line.start + (reach - PROBE.radius)[:, None] * line.inward
        self.ticks = len(self.path)
        self._withdrawn = len(reach) - len(back)
        self._every = max(1, round(FOUND_EVERY / tick_time))
        self._finder = ContactFinder(organ, ToolSet([PROBE]))
        self._margins = np.full(1, self._every * speed * tick_time)

    def act(self, simulation: Simulation, tick: int) -> None:
        """Apply the pose, and now and then the contacts found with it."""
        state = simulation.state
        simulation.take_pose(0, np.concatenate([self.path[tick], [0.0, 0.0, 0.0, 1.0]]), tick + 1)
        if tick % self._every == 0 or tick == self.ticks - 1:
            touching, pushing = np.ones(1, dtype=np.int64), np.zeros(1, dtype=np.int64)
            query = ContactQuery(state.body_pose, self._margins, touching, pushing, state.bodies.releases)
            found = self._finder.find(state.position, query)
            simulation.take_contacts(found, tick + 1)

    def over(self, tick: int) -> bool:
        """Return whether the probe is drawn back; its wrench shows whether it still touches."""
        return tick >= self._withdrawn


def far_node(organ: Organ) -> int:
    """Return the surface node farthest from the held ones along the line from them through the organ's centre."""
    surface = organ.surface_positions
    below = _held(organ).mean(axis=0)
    return int(np.argmax((surface - below) @ (surface.mean(axis=0) - below)))


def _held(organ: Organ) -> Floats:
    """Return positions of the held nodes (k, 3) m, or of the lowest node where none is held."""
    surface = organ.surface_positions
    return surface[organ.fixed] if len(organ.fixed) else surface[[np.argmin(surface[:, 2])]]


def inward_at(organ: Organ, nodes: Longs) -> Floats:
    """Return inward unit normals of surface nodes at rest, (k, 3)."""
    return -np.asarray(mesh_of(organ).vertex_normals)[nodes]


def mesh_of(organ: Organ) -> trimesh.Trimesh:
    """Return the surface at rest."""
    return trimesh.Trimesh(organ.surface_positions, organ.surface_triangles, process=False)


def patch_around(organ: Organ, node: int) -> Longs:
    """Return the node and the nearest others by hops, then by distance: PATCH_NODES in total."""
    neighbours = mesh_of(organ).vertex_neighbors
    patch, ring = [node], [node]
    while len(patch) < PATCH_NODES and ring:
        ring = sorted({int(other) for inner in ring for other in neighbours[inner]} - set(patch))
        ring.sort(
            key=lambda other: float(np.linalg.norm(organ.surface_positions[other] - organ.surface_positions[node]))
        )
        patch += ring
    return np.array(patch[:PATCH_NODES], dtype=np.int64)


def ten_points(organ: Organ) -> Longs:
    """Return ten surface nodes spread over the organ, far from the held ones (farthest point sampling)."""
    surface = organ.surface_positions
    room = np.linalg.norm(surface[:, None] - _held(organ), axis=2).min(axis=1)
    chosen: list[int] = []
    for _ in range(TEN):
        chosen.append(int(room.argmax()))
        room = np.minimum(room, np.linalg.norm(surface - surface[chosen[-1]], axis=1))
    return np.array(chosen, dtype=np.int64)


def thickness(organ: Organ, start: Floats, inward: Floats) -> float:
    """Return the length of the line through the organ from a surface point, m, with the probe's radius around it."""
    offset = organ.surface_positions - start
    along = offset @ inward
    near = np.linalg.norm(offset - along[:, None] * inward, axis=1) < 2.0 * PROBE.radius
    return float(along[near].max())


class Pace(NamedTuple):
    """Durations of a load; 0.15 m/s is a quick hand."""

    ramp: float  # s
    hold: float  # s
    speed: float  # m/s of the probe


FULL, QUICK, BRIEF = Pace(0.05, 0.15, 0.15), Pace(0.03, 0.05, 0.4), Pace(0.01, 0.01, 1.0)


def load_on(organ: Organ, where: str, newtons: float, depth: float, tick_time: float, pace: Pace) -> Loading:
    """Return the load of a cell.

    where: one of LOADS; newtons: sum of the forces, N; depth: depth of a poke in thicknesses; tick_time: duration of a
    tick, s; pace: durations.
    """
    ramp_ticks, hold_ticks = max(1, round(pace.ramp / tick_time)), max(1, round(pace.hold / tick_time))
    far = where in ("point", "far", "tool_far")
    node = far_node(organ) if far else press_node(organ)
    inward = inward_at(organ, np.array([node]))
    if where in ("tool", "tool_far"):
        start = organ.surface_positions[node]
        line = Line(start, inward[0], depth * thickness(organ, start, inward[0]))
        return Poke(organ, line, tick_time, hold_ticks, pace.speed)
    if where == "point":
        nodes = np.array([node], dtype=np.int64)
    elif where == "ten":
        nodes = ten_points(organ)
        inward = inward_at(organ, nodes)
    else:
        nodes = patch_around(organ, node)
    direction = -inward if where == "pull" else inward
    forces = np.tile(newtons / len(nodes) * direction, (len(nodes) // len(direction), 1))
    return NodalLoad(nodes, forces, ramp_ticks, hold_ticks)
