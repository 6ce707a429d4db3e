"""Contact points of each tool as point clouds: collected only while there are subscribers."""

from __future__ import annotations

import math
import time

import numpy as np
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2, PointField

from tissue_sim.array_types import Floats, Longs
from tissue_sim.contact.pressed_points import pressed_points
from tissue_sim.contact.tools import ToolSet
from tissue_sim.model.data.state import state_like
from tissue_sim.ros.node.output.organ_publisher import REPEAT_AFTER
from tissue_sim.ros.shared.organs import Organs
from tissue_sim.ros.shared.qos import RELIABLE
from tissue_sim.ros.shared.report import Report

COLUMNS = ("x", "y", "z", "normal_x", "normal_y", "normal_z", "force_x", "force_y", "force_z", "organ")
PATIENCE = 0.02  # s for a tick to post its state


class ContactPoints:
    """Publisher of the contact points of each tool as ~/<tool>/contacts, at the marker rate.

    Each point has its place, m; the normal out of the tissue there; the force on the tool, N; and the number of its
    organ. Forces are those of the tick's last substep, and add up to the tool's wrench where that is steady.
    """

    def __init__(self, node: Node, frame_id: str, organs: Organs, tools: ToolSet) -> None:
        self._frame_id, self._organs, self._tools, self._clock = frame_id, organs, tools, node.get_clock()
        names = [tool.name for tool in tools.tools]
        self._publishers = [node.create_publisher(PointCloud2, f"~/{name}/contacts", RELIABLE) for name in names]
        self._states = [state_like(one.simulation.state) for one in organs.each]
        self._seen: tuple[object, ...] = ()
        self._sent = -math.inf
        self.published = [0] * len(names)
        self.gathered = 0  # times that the loop was asked for its state

    def present(self) -> None:
        """Publish the points of tools that have subscribers, if anything has moved."""
        wanted = [one.get_subscription_count() for one in self._publishers]
        if not any(wanted):
            return
        now, seen = time.monotonic(), (*wanted, *self._organs.surface_sequences)
        if seen == self._seen and now - self._sent < REPEAT_AFTER:
            return
        try:
            with self._organs.loop.snapshots(PATIENCE):
                for number, one in enumerate(self._organs.each):
                    if len(self._states[number].words) != len(one.box.snapshot):  # a cut has given it more nodes
                        self._states[number] = state_like(one.simulation.state)
                    self._states[number].words[:] = one.box.snapshot
        except TimeoutError:  # the next turn tries again; a loop that hangs is reported elsewhere
            return
        self._seen, self._sent, self.gathered = seen, now, self.gathered + 1
        found = [self._points(number) for number in range(len(self._states))]
        bodies, rows = (np.concatenate(parts) for parts in zip(*found, strict=True))
        for tool, publisher in enumerate(self._publishers):
            if wanted[tool]:
                publisher.publish(self._message(rows[np.isin(bodies, self._tools.bodies[tool])]))
                self.published[tool] += 1

    def report(self, report: Report) -> None:
        """Add how many clouds of each tool were published, and how often the loop was asked for its state."""
        report.values["contacts_gathered"] = self.gathered
        for tool, count in zip(self._tools.tools, self.published, strict=True):
            report.part(f"tool {tool.name}", f"{tool.name}.").values["contact_clouds"] = count

    def _points(self, number: int) -> tuple[Longs, Floats]:
        """Return the bodies (k,) that touch an organ, and a row of COLUMNS for each point, (k, 10)."""
        state, physics = self._states[number], self._organs.each[number]
        entries, bodies, places, normals = pressed_points(state, self._tools.shapes)
        held = state.contact_held[0, entries]
        along = np.einsum("kx,kx->k", held, normals)
        push = (state.contact_pressed[0, entries] - along)[:, None] * normals + held  # N s, on the tissue
        forces = push * (-max(int(state.status.substeps), 1) / physics.tick_time)
        organ = np.full((len(entries), 1), number, dtype=np.float64)
        return bodies, np.hstack([places + state.carried, -normals, forces, organ])

    def _message(self, rows: Floats) -> PointCloud2:
        message = PointCloud2(height=1, width=len(rows), is_dense=True)
        message.header.frame_id = self._frame_id
        message.header.stamp = Time(nanoseconds=self._clock.now().nanoseconds).to_msg()
        message.fields = [
            PointField(name=name, offset=4 * column, datatype=PointField.FLOAT32, count=1)
            for column, name in enumerate(COLUMNS)
        ]
        message.point_step = 4 * len(COLUMNS)
        message.row_step = message.point_step * len(rows)
        message.data = rows.astype("<f4").tobytes()
        return message
