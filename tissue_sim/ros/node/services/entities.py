"""The organs and tools of a node as a simulation's entities: their names, their places, and how they are placed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from rclpy.node import Node
from rclpy.parameter import Parameter

from tissue_sim.array_types import Floats
from tissue_sim.errors import UserError
from tissue_sim.ros.node.shared.served_organ import ServedOrgan
from tissue_sim.ros.node.tools.tool_port import ToolPort
from tissue_sim.ros.shared.frames import IDENTITY, Transform
from tissue_sim.ros.shared.parameters import Parameters


class Placed(NamedTuple):
    """A pose (7,), m and quaternion xyzw, in a frame; an empty frame is the world: base_frame, or the organ's."""

    frame_id: str
    pose: tuple[float, ...]


class Sphere(NamedTuple):
    """A sphere in the world's frame, m."""

    centre: tuple[float, float, float]
    radius: float


class Entities:
    """Entities of the node, queried and placed by the executor's thread.

    A single organ is named as in its file, those of a scene as in the scene; an organ that shares its name with a tool
    has `_organ` behind it.
    """

    def __init__(
        self, node: Node, values: Parameters, organs: Sequence[ServedOrgan], ports: Sequence[ToolPort]
    ) -> None:
        self._node, self._values = node, values
        self._tools = {port.name: port for port in ports}
        named = {one.name or one.organ.name or "organ": one for one in organs}
        self._organs = {f"{name}_organ" if name in self._tools else name: one for name, one in named.items()}

    @property
    def names(self) -> list[str]:
        """Names of the entities: organs first, then tools."""
        return [*self._organs, *self._tools]

    def where(self, name: str) -> Placed:
        """Return where an entity is: an organ's frame in the world, a tool's newest pose in the organ's frame.

        Raises KeyError when it is unknown; UserError when a tool has had no pose.
        """
        if name in self._organs:
            base_id = self._values["base_frame"]
            return Placed(base_id or self._values["frame_id"], self._organ_pose())
        port = self._tools[name]
        if port.input.poses == 0:
            raise UserError(f"tool '{name}' has not received a pose")
        return Placed(self._values["frame_id"], tuple(port.newest.pose.tolist()))

    def place(self, name: str, placed: Placed) -> None:
        """Place an entity: a tool like a pose from its bridge, a single organ by the parameter organ_pose.

        placed: its place. Raises KeyError when it is unknown; UnknownFrame when the frame is; ValueError when the pose
        is none; UserError when it can't be placed, such as a tool whose bridge publishes.
        """
        frame_id = placed.frame_id or self._world
        if name in self._organs:
            self._place_organ(name, Placed(frame_id, placed.pose))
        else:
            self._tools[name].place(frame_id, placed.pose)

    def meets(self, name: str, sphere: Sphere) -> bool:
        """Return whether an entity overlaps a sphere: the box around an organ, or the ball around a tool's body.

        Raises KeyError when the entity is unknown.
        """
        x, y, z = sphere.centre
        centre = np.array(Transform.of_pose(self._organ_pose()).inverse().of((x, y, z, *IDENTITY[3:]))[:3])
        if name in self._organs:
            low, high = self._box(self._organs[name])
            return bool(np.linalg.norm(centre - np.clip(centre, low, high)) <= sphere.radius)
        port = self._tools[name]
        if port.input.poses == 0:
            return False
        apart = np.linalg.norm(port.newest.placed[:, :3] - centre, axis=1)
        return bool((apart <= sphere.radius + port.extents).any())

    @property
    def _world(self) -> str:
        return str(self._values["base_frame"] or self._values["frame_id"])

    def _organ_pose(self) -> tuple[float, ...]:
        """Return the pose of the organ's frame in the world, (7,)."""
        return tuple(self._values["organ_pose"]) if self._values["base_frame"] else IDENTITY

    def _place_organ(self, name: str, placed: Placed) -> None:
        if len(self._organs) > 1:
            raise UserError("the organs of a scene are placed together, with the parameter organ_pose")
        if not self._values["base_frame"]:
            raise UserError(f"the frame of organ '{name}' is the world, since the parameter base_frame is not set")
        if placed.frame_id != self._world:
            raise UserError(f"organ '{name}' can be placed in '{self._world}' only, not in '{placed.frame_id}'")
        Transform.of_pose(placed.pose)
        result = self._node.set_parameters([Parameter("organ_pose", value=list(placed.pose))])[0]
        if not result.successful:
            raise UserError(result.reason)

    @staticmethod
    def _box(served: ServedOrgan) -> tuple[Floats, Floats]:
        """Return the corners (3,) m, lower and upper, in the organ's frame, of the box around the newest shape."""
        positions = np.zeros((served.organ.n_uncut, 3))
        _, carried = served.physics.positions(positions)
        return positions.min(axis=0) + carried, positions.max(axis=0) + carried
