"""Publishes the organ at the marker rate: markers, surface, skeleton; only what somebody looks at."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import MarkerArray

from tissue_sim.organ.organ import Organ
from tissue_sim.ros.messages import CloudTemplate, MarkersTemplate, rest_mesh
from tissue_sim.ros.physics import Physics
from tissue_sim.ros.recorder import Recorder
from tissue_sim.ros.tool_port import ToolPort

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
REPEAT_AFTER = 0.5  # s after which an organ that stands still is streamed again
STREAM = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)


class Presenter:
    """Publishers of the deformed organ. `present` is called at the marker rate."""

    def __init__(
        self,
        node: Node,
        organ: Organ,
        frame_id: str,
        physics: Physics,
        ports: Sequence[ToolPort],
        recorder: Callable[[], Recorder],
    ) -> None:
        self._organ, self._physics, self._ports, self._recorder = organ, physics, list(ports), recorder
        self._clock = node.get_clock()
        self._mesh = node.create_publisher(Mesh, "~/mesh", LATCHED)
        self._markers = node.create_publisher(MarkerArray, "~/markers", LATCHED)
        self._surface = node.create_publisher(PointCloud2, "~/surface", STREAM)
        self._skeleton = node.create_publisher(PointCloud2, "~/skeleton", STREAM)
        self._marker_bytes = MarkersTemplate(frame_id, organ, len(ports))
        self._surface_bytes = CloudTemplate(frame_id, organ.n_surface, ("x", "y", "z"))
        self._skeleton_bytes = CloudTemplate(frame_id, organ.n_atoms, ("x", "y", "z", "radius", "parent"))
        self._skeleton_bytes.points[:, 3] = organ.atom_radius
        self._skeleton_bytes.points[:, 4] = organ.atom_parent
        self._positions = organ.rest_positions
        self._sequence: dict[str, int] = {}
        self._had_markers = 0
        self._surface_sent = -math.inf
        self.mesh_bytes = rest_mesh(organ)
        self.unchanged_skips = self.unseen_skips = self.published = 0
        self._mesh.publish(self.mesh_bytes)

    def present(self, record_markers: bool) -> None:
        """Publish what has subscribers (or is recorded) and has moved since it was last published."""
        physics, recorder = self._physics, self._recorder()
        n_markers = self._markers.get_subscription_count()
        n_surface = self._surface.get_subscription_count() + self._skeleton.get_subscription_count()
        sequence = physics.surface_sequence
        # A viewer that has just come gets the organ even when nothing moves.
        show_markers = n_markers > 0 and (self._moved("markers", sequence) or n_markers > self._had_markers)
        # Best effort may lose the shape in which the organ comes to rest, or the first one of a viewer: say it again.
        show_surface = n_surface > 0 and (
            self._moved("surface", sequence) or time.monotonic() - self._surface_sent >= REPEAT_AFTER
        )
        record = recorder.active and self._moved("bag", sequence)
        self._had_markers = n_markers
        if not (show_markers or show_surface or record):
            if n_markers or n_surface:
                self.unchanged_skips += 1
            else:
                self.unseen_skips += 1
            return
        tick = physics.positions(self._positions)
        stamp = self._clock.now().nanoseconds
        markers = None
        if show_markers or (record and record_markers):
            markers = self._marker_message(stamp)
        if show_markers and markers is not None:
            self._markers.publish(markers)
            self._sequence["markers"] = sequence
        if show_surface or record:
            n = self._organ.n_surface
            self._surface_bytes.points[:] = self._positions[:n]
            self._skeleton_bytes.points[:, :3] = self._positions[n : n + self._organ.n_atoms]
            surface, skeleton = self._surface_bytes.message(stamp), self._skeleton_bytes.message(stamp)
            if show_surface:
                self._surface.publish(surface)
                self._skeleton.publish(skeleton)
                self._sequence["surface"], self._surface_sent = sequence, time.monotonic()
            if record:
                recorder.surface(tick, surface, skeleton, markers if record_markers else None)
                self._sequence["bag"] = sequence
        self.published += 1

    def close(self) -> None:
        """Delete the markers in every viewer."""
        self._markers.publish(self._marker_bytes.deletion())

    def _moved(self, name: str, sequence: int) -> bool:
        return self._sequence.get(name) != sequence

    def _marker_message(self, stamp: int) -> bytes:
        _, wrenches = self._physics.wrenches()
        tips = np.array([port.newest[1][:3] for port in self._ports]).reshape(-1, 3)
        return self._marker_bytes.message(stamp, self._positions, self._organ.n_surface, tips, wrenches)
