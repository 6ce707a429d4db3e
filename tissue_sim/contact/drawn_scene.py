"""Parts of a scene that are drawn: surfaces of its organs, with the walls of cuts, and the bodies of its tools."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Ints, Longs
from tissue_sim.contact.tools import ToolSet
from tissue_sim.model.simulation import Simulation
from tissue_sim.rendering.primitives import ball, capsule


class DrawnSurface(NamedTuple):
    """Surface of an organ."""

    name: str
    points: Floats  # (p, 3) m, present positions
    rest: Floats  # (p, 3) m
    triangles: Ints  # (t, 3); the same array until the organ is cut or healed


def surfaces_of(simulations: Sequence[Simulation], names: Sequence[str]) -> list[DrawnSurface]:
    """Return the surfaces of organs, with the displacement by the breath.

    Parameters
    ----------
    simulations : Sequence[Simulation]
        The organs.
    names : Sequence[str]
        Their names.
    """
    found = []
    for one, name in zip(simulations, names, strict=True):
        carried, cut = one.state.carried, one.cut_organ
        if cut is None:
            rest, triangles, points = one.organ.surface_positions, one.organ.surface_triangles, one.surface_positions
        else:
            rest, triangles = cut.surface.at(one.organ.rest_positions), cut.surface.triangles
            points = cut.surface.at(one.positions)
        found.append(DrawnSurface(name, points + carried, rest, triangles))
    return found


def body_shapes(tools: ToolSet) -> list[tuple[Floats, Longs]]:
    """Return vertices (k, 3) m and triangles (t, 3) of each body of tools, about its origin.

    Parameters
    ----------
    tools : ToolSet
        The tools.
    """
    found = []
    for body, mesh in enumerate(tools.meshes):
        radius, length = map(float, tools.shapes.size[body])
        if mesh is not None:
            found.append((np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)))
        else:
            found.append(ball(radius) if length == 0.0 else capsule(radius, length))
    return found


def body_poses(simulation: Simulation) -> list[Floats | None]:
    """Return the pose (7,) of each body, m and quaternion xyzw; None for one that has not been moved.

    Parameters
    ----------
    simulation : Simulation
        Simulation of the first organ, with whose clamp the frame of the poses moves.
    """
    state, found = simulation.state, list[Floats | None]()
    for body in range(len(state.bodies)):
        pose = state.body_pose[body].copy()
        pose[:3] += state.carried
        found.append(pose if state.bodies[body].age >= 0 else None)
    return found
