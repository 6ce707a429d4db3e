"""Publishes the organ at the marker rate: markers, surface, skeleton; only what somebody looks at."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from functools import partial

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import MarkerArray

from tissue_sim.array_types import Floats
from tissue_sim.contact.tools import ToolSet
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.bags.recorder import Recorder
from tissue_sim.ros.node.markers import OrganMarkers, all_finite, write_displacement
from tissue_sim.ros.node.tf_broadcast import TfBroadcast
from tissue_sim.ros.node.tool_markers import ToolMarkers
from tissue_sim.ros.node.tool_port import ToolPort
from tissue_sim.ros.shared.appearance import FULL_DISPLACEMENT, FULL_FORCE, MOVING
from tissue_sim.ros.shared.messages import CloudTemplate, rest_mesh
from tissue_sim.ros.shared.physics import Physics
from tissue_sim.ros.shared.qos import LATCHED, RELIABLE, STREAM
from tissue_sim.ros.shared.report import Report

POSE_LASTS = 1.0  # s that a tool is shown without a new pose
REPEAT_AFTER = 0.5  # s after which an organ that stands still is streamed again


class Presenter:
    """Publishers of the deformed organ. `present` is called at the marker rate."""

    def __init__(
        self,
        node: Node,
        organ: Organ,
        frame_id: str,
        physics: Physics,
        ports: Sequence[ToolPort],
        recorder: Recorder,
        tools: ToolSet,
        broadcast: TfBroadcast | None,
    ) -> None:
        self._organ, self._physics, self._ports, self._recorder = organ, physics, list(ports), recorder
        self._clock = node.get_clock()
        self._broadcast, self._tips_sent = broadcast, [0] * len(self._ports)
        self._mesh = node.create_publisher(Mesh, "~/mesh", LATCHED)
        self._markers = node.create_publisher(MarkerArray, "~/markers", LATCHED)
        self._surface = node.create_publisher(PointCloud2, "~/surface", STREAM)
        self._skeleton = node.create_publisher(PointCloud2, "~/skeleton", STREAM)
        self._tools = node.create_publisher(MarkerArray, "~/tools", RELIABLE)
        self._tool_bytes = ToolMarkers(frame_id, tools)
        self._tools_shown: tuple[object, ...] = ()
        self._tools_sent = -math.inf
        self._new_markers = partial(OrganMarkers, frame_id, organ, len(ports))
        self._marker_bytes = self._new_markers()
        self._coloured_bytes: OrganMarkers | None = None  # made when it is wanted: it takes a while
        self._surface_bytes = CloudTemplate(frame_id, organ.n_surface, ("x", "y", "z"))
        self._skeleton_bytes = CloudTemplate(frame_id, organ.n_atoms, ("x", "y", "z", "radius", "parent"))
        self._skeleton_bytes.points[:, 3] = organ.atom_radius
        self._skeleton_bytes.points[:, 4] = organ.atom_parent
        self._rest = organ.rest_positions
        self._positions = self._rest.copy()
        self._displacement = np.zeros(len(self._rest))
        self._tips, self._felt = np.zeros((len(ports), 3)), np.zeros((len(ports), 6))
        self._colour = ""  # of the markers last published
        self._sequence: dict[str, int] = {}
        self._had_markers = 0
        self._surface_sent = -math.inf
        self.mesh_bytes = rest_mesh(organ)
        self.unchanged_skips = self.unseen_skips = self.published = 0
        self._mesh.publish(self.mesh_bytes)

    def present(self, record_markers: bool, colour: str) -> None:
        """Publish what has subscribers (or is recorded) and has moved since it was last published.

        colour: what the markers' surface is coloured by, one of MARKER_COLOURS.
        """
        physics, recorder = self._physics, self._recorder
        n_markers = self._markers.get_subscription_count()
        n_surface = self._surface.get_subscription_count() + self._skeleton.get_subscription_count()
        sequence = physics.surface_sequence
        # A viewer that has just come gets the organ even when nothing moves.
        show_markers = n_markers > 0 and (
            self._moved("markers", sequence) or n_markers > self._had_markers or colour != self._colour
        )
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
        tick, carried = physics.positions(self._positions)
        self._positions += carried
        if not all_finite(self._positions):  # never seen, and RViz would drop the marker
            return
        stamp = self._clock.now().nanoseconds
        markers = None
        if show_markers or (record and record_markers):
            markers = self._marker_message(stamp, colour)
        if show_markers and markers is not None:
            self._markers.publish(markers)
            self._sequence["markers"], self._colour = sequence, colour
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

    def present_tools(self) -> None:
        """Publish where the tools are, if somebody looks and they have moved or feel something else."""
        if self._tools.get_subscription_count() == 0:
            return
        now = time.monotonic()
        newest = [port.newest for port in self._ports]
        fresh = [port.pose_freshness.age < POSE_LASTS for port in self._ports]
        tips, wrenches = self._touches()
        forces = wrenches[:, :3]
        shown = (*(pose.sequence for pose in newest), *fresh, forces.tobytes())
        if shown == self._tools_shown and now - self._tools_sent < REPEAT_AFTER:
            return
        self._tools_shown, self._tools_sent = shown, now
        placed = [pose.placed if is_fresh else None for pose, is_fresh in zip(newest, fresh, strict=True)]
        self._tools.publish(self._tool_bytes.message(self._clock.now().nanoseconds, placed, tips, forces))

    def broadcast_tips(self) -> None:
        """Tell tf where the tools are, of those with a new pose."""
        if self._broadcast is None:
            return
        newest = [port.newest for port in self._ports]
        moved = [pose.sequence != sent for pose, sent in zip(newest, self._tips_sent, strict=True)]
        if any(moved):
            self._tips_sent = [pose.sequence for pose in newest]
            poses = [pose.pose if is_new else None for pose, is_new in zip(newest, moved, strict=True)]
            self._broadcast.tips(self._clock.now().nanoseconds, poses)

    def report(self, report: Report) -> None:
        """Add what was not published."""
        report.values |= {
            "skipped.mesh_unchanged": self.unchanged_skips,
            "skipped.no_subscriber": self.unseen_skips,
        }

    def close(self) -> None:
        """Delete the markers in every viewer."""
        self._markers.publish(self._marker_bytes.deletion())
        self._tools.publish(self._tool_bytes.deletion())

    def _moved(self, name: str, sequence: int) -> bool:
        return self._sequence.get(name) != sequence

    def _marker_message(self, stamp: int, colour: str) -> bytes:
        tips, wrenches = self._touches()
        if colour == "none":
            return self._marker_bytes.message(stamp, self._positions, tips, wrenches)
        if self._coloured_bytes is None:
            self._coloured_bytes = self._new_markers(coloured=True)
        return self._coloured_bytes.message(stamp, self._positions, tips, wrenches, self._share(colour))

    def _touches(self) -> tuple[Floats, Floats]:
        """Where each tool's origin is, (T, 3) m, and its wrench, (T, 6) N, N m."""
        _, wrenches = self._physics.wrenches()
        for index, port in enumerate(self._ports):
            self._tips[index] = port.newest.pose[:3]
            self._felt[index] = port.wrench(wrenches)
        return self._tips, self._felt

    def _share(self, colour: str) -> Floats:
        """Where each node stands on the scale of colours, (n,), 0 to 1."""
        if colour == "force":
            return self._physics.contact_forces() / FULL_FORCE
        if colour == "region":
            return np.where(self._physics.moving(), MOVING, 0.0)
        write_displacement(self._displacement, self._positions, self._rest, FULL_DISPLACEMENT)
        return self._displacement
