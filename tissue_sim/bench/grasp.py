"""Benchmark `tissue_sim bench grasp`: the force at which jaws slip from an organ, against Coulomb's, and creep below it.

The gripper of `config/gripper.yaml` takes hold of the lower pole and is drawn off it. While its flat jaws slide, the
force along each of them is the coefficient of friction times the force across it, whatever the shape of the tissue.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.array_types import Floats, Ints
from tissue_sim.bench import rows
from tissue_sim.bench.arguments import add_shared, check_shared
from tissue_sim.bench.printing import Bound, aligned, bound_lines, emit, exit_code
from tissue_sim.bench.timing import in_one_thread
from tissue_sim.contact.grasp import at_lower_pole
from tissue_sim.contact.quaternions import rotate
from tissue_sim.contact.scene import Scene
from tissue_sim.contact.tools import Tool
from tissue_sim.errors import UserError
from tissue_sim.organ.organ import Organ
from tissue_sim.organ.shipped import shipped_file

ORGANS = ("kidney", "kidney_tumour", "kidney_as_built")  # that ship
FRICTION = 0.2  # of jaws that slip before they have left the pole
HINGE = 0.06  # m from the tips, as in config/gripper.yaml
SPEED = 0.005  # m/s of the pull
FIRST, SLIDING = 0.004, 0.004  # m of pull until all points slide, and in which forces are measured
HELD = 0.5  # of the slip force, at which it is held
ON = 0.005  # m before the pull, from where jaws close
MOST_OFF, MOST_CREEP = 5.0, 10.0  # %, um


class Touched(NamedTuple):
    """Points of the tissue that tools touch."""

    nodes: Ints  # (k, 3) between which they lie
    weights: Floats  # (k, 3)


class Touching:
    """A scene with tools that touch its organ; `scene` is the scene."""

    scene: Scene

    def touched(self) -> Touched:
        """Return the points that are pressed."""
        state = self.scene.simulation.state
        pressed = np.flatnonzero(state.contact_pressed[0, : state.contacts.header.points] > 0.0)
        return Touched(state.contacts.node[pressed].copy(), state.contacts.weight[pressed].copy())

    def points(self, touched: Touched) -> Floats:
        """Return where those points are now, (k, 3) m."""
        return np.asarray(np.einsum("ij,ijk->ik", touched[1], self.scene.simulation.positions[touched[0]]))


class Nip(Touching):
    """A gripper at an organ's lower pole, its jaws closed on either side.

    Parameters
    ----------
    gripper : Tool
        A gripper.
    friction : float
        Its coefficient.
    organ : Organ
        The organ.

    Raises
    ------
    ValueError
        Where the jaws can't take hold of the organ.
    """

    def __init__(self, gripper: Tool, friction: float, organ: Organ) -> None:
        self.grasp = at_lower_pole(organ.surface_positions, organ.surface_triangles, gripper.jaws)
        self.up = self.grasp.out
        # A contact set for every four ticks, as beside the node's loop at 1 kHz.
        self.scene = Scene(organ, [gripper], ticks_a_set=4)
        self.scene.simulation.settings.friction = friction
        self.at, self.angle = self.grasp.place + 0.06 * self.up, self.grasp.opened
        self.lead(self.grasp.place, self.grasp.opened, 300)
        self.lead(self.grasp.place, self.grasp.closed, 500)

    def lead(self, place: Floats, angle: float, ticks: int) -> None:
        """Move the gripper to a place and open or close it to an angle.

        Parameters
        ----------
        place : Floats, shape (3,), m
            The place.
        angle : float, rad
            The angle.
        ticks : int
            Within so many.
        """
        start, began = self.at, self.angle
        for fraction in np.linspace(0.0, 1.0, ticks):
            self.at = (1.0 - fraction) * start + fraction * place
            self.angle = float((1.0 - fraction) * began + fraction * angle)
            self.scene.move(0, self.at, self.grasp.turn, self.angle)
            self.scene.step()

    def draw(self) -> tuple[float, float]:
        """Draw the gripper off for one tick; return the forces along its jaws and across them, N."""
        self.lead(self.at + SPEED / self.scene.simulation.rate * self.up, self.angle, 1)
        return self.forces()

    def forces(self) -> tuple[float, float]:
        """Return the sums over the jaws of the forces along their pads and across them, N."""
        state, along, across = self.scene.simulation.state, 0.0, 0.0
        for wrench, pose in zip(state.wrench[:2, :3], state.body_pose[:2], strict=True):
            out = np.array(rotate(tuple(pose[3:].tolist()), (1.0, 0.0, 0.0)))  # away from the other jaw
            normal = float(wrench @ out)
            across += normal
            along += float(np.linalg.norm(wrench - normal * out))
        return along, across
