"""Two tools that squeeze the organ's middle, hold and release it: time of a tick, inverted cells, force."""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from tissue_sim.array_types import Floats
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.model.elasticity.cells import swelling
from tissue_sim.organ.organ import Organ

SPHERE = 0.005  # m, radius
CLEAR = 0.006  # m between tool and organ at the start
NEAR = 0.006  # m from the axis, within which the organ's width is measured
CLOSING, HOLDING, OPENING, FREE = 800, 400, 300, 3000  # ticks of 1 ms; the last is a maximum
LOOK = 10  # ticks between two checks of the cells


class Pinch(NamedTuple):
    """Results of one pair of tools that squeeze along one axis."""

    tools: str
    axis: int
    fraction: float
    width: float  # m
    seconds: Floats  # of processor time of every tick in contact
    substeps: int  # the most
    most_turned: int  # inverted cells, at worst
    held_turned: int  # when the tools have stood still
    least: float  # J of a cell then
    left_turned: int  # long after
    left: float  # m from rest then
    faults: int
    forces: Floats  # (2, 3) N, on the tools, held

    @property
    def force(self) -> float:
        """Mean force on a tool, N."""
        return float(np.linalg.norm(self.forces, axis=1).mean())


class Place(NamedTuple):
    """Places where two tools begin to squeeze the organ's middle along an axis."""

    start: Floats  # (2, 3) m, their origins where they would touch
    directions: Floats  # (2, 3) the directions in which they close
    width: float  # m

    def at(self, deep: float) -> Floats:
        """Return the origins (2, 3) m of tools at a depth, m."""
        return self.start + deep * self.directions


def both(shape: str = "sphere", radius: float = 0.005, length: float = 0.05, mesh: str = "") -> list[Tool]:
    """Return two equal tools, with the defaults of Tool."""
    return [Tool(name, shape, radius, length, mesh) for name in ("left", "right")]


def pairs(folder: Path) -> list[tuple[str, list[Tool]]]:
    """Return the name and the tools of each pair; a mesh file is written into a folder."""
    jaw = trimesh.creation.box((0.012, 0.012, 0.004))
    jaw.apply_translation([0.0, 0.0, -0.002])
    jaw.export(folder / "jaw.stl")

    return [
        ("spheres of 5 mm", both(radius=SPHERE)),
        ("grippers", both(shape="gripper", radius=0.003, length=0.03)),
        ("flat jaws", both(shape="mesh", mesh=str(folder / "jaw.stl"))),
    ]


def place(organ: Organ, axis: int, ahead: float = 0.0) -> Place:
    """Return either side of the organ's middle along an axis.

    ahead: distance of the tools' foremost point from their origin, m.
    """
    surface = organ.surface_positions
    middle = surface.mean(axis=0)
    beside = np.linalg.norm(np.delete(surface - middle, axis, axis=1), axis=1)
    low, high = np.min(surface[beside < NEAR, axis]), np.max(surface[beside < NEAR, axis])
    directions = np.eye(3)[axis] * np.array([[1.0], [-1.0]])
    start = np.tile(middle, (2, 1))
    start[:, axis] = low, high
    return Place(start - ahead * directions, directions, float(high - low))


def pinched(
    organ: Organ, name: str, tools: list[Tool], axis: int, fraction: float, friction: float | None = None
) -> Pinch:
    """Squeeze the organ's middle along an axis, hold, release, and wait.

    fraction: fraction of the organ's width there; friction: Coulomb coefficient, None for the default.
    """
    scene = Scene(organ, tools, ticks_a_set=4)
    scene.finder.warm_up(organ.rest_positions)
    simulation = scene.simulation
    if friction is not None:
        simulation.settings.friction = friction
    step, seconds = simulation.step, []

    def timed(ticks: int = 1) -> None:
        start = time.thread_time()
        step(ticks)
        seconds.append(time.thread_time() - start)

    simulation.step = timed  # type: ignore[method-assign]
    where = place(organ, axis, tools[0].radius if tools[0].shape == "sphere" else 0.0)
    turns = [Rotation.align_vectors([direction], [[0.0, 0.0, 1.0]])[0].as_quat() for direction in where.directions]
    depth, substeps, turned = 0.5 * fraction * where.width, 0, 0

    def go(deep: float) -> None:
        nonlocal substeps, turned
        for tool in range(2):
            scene.move(tool, where.at(deep)[tool], turns[tool])
        scene.step()
        substeps = max(substeps, int(simulation.state.status.substeps))
        if simulation.state.status.tick % LOOK == 0:
            turned = max(turned, int(np.count_nonzero(swelling(simulation.model, simulation.positions) <= 0.0)))

    for tick in range(CLOSING):
        go(-CLEAR + (depth + CLEAR) * (tick + 1) / CLOSING)
    for _ in range(HOLDING):
        go(depth)
    held = swelling(simulation.model, simulation.positions)
    forces = scene.wrenches[:, :3].copy()
    for tick in range(OPENING):
        go(depth - (depth + CLEAR) * (tick + 1) / OPENING)
    touching = np.array(seconds)
    for _ in range(FREE):
        scene.step()
        if simulation.asleep:
            break
    return Pinch(
        tools=name,
        axis=axis,
        fraction=fraction,
        width=where.width,
        seconds=touching,
        substeps=substeps,
        most_turned=turned,
        held_turned=int(np.count_nonzero(held <= 0.0)),
        least=float(held.min()),
        left_turned=int(np.count_nonzero(swelling(simulation.model, simulation.positions) <= 0.0)),
        left=float(np.linalg.norm(simulation.positions - organ.rest_positions, axis=1).max()),
        faults=int(simulation.state.count.faults),
        forces=forces,
    )
