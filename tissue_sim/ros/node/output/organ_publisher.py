"""Publishing of organs at the marker rate: markers, surface, skeleton; only what has subscribers."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from functools import partial

from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from std_msgs.msg import UInt32
from visualization_msgs.msg import MarkerArray

from tissue_sim.ros.bags.organ_recorder import OrganRecorder
from tissue_sim.ros.node.output.ligaments import Ligaments
from tissue_sim.ros.node.output.published_shapes import PublishedShapes, Touches
from tissue_sim.ros.node.shared.served_organ import ServedOrgan
from tissue_sim.ros.node.tools.tool_port import ToolPort
from tissue_sim.ros.shared.messages import CloudTemplate, inclusion_mesh, rest_mesh
from tissue_sim.ros.shared.organs import Organs
from tissue_sim.ros.shared.parameter_values import Values
from tissue_sim.ros.shared.qos import LATCHED, STREAM
from tissue_sim.ros.shared.report import Report

REPEAT_AFTER = 0.5  # s after which an organ that stands still is published again


class OrganPublisher:
    """Publishers of one deformed organ. `present` is called at the marker rate."""

    def __init__(
        self,
        node: Node,
        served: ServedOrgan,
        frame_id: str,
        ports: Sequence[ToolPort],
        recorder: OrganRecorder,
        values: Values,
    ) -> None:
        below = served.below
        self._recorder, self._values, self._frame_id = recorder, values, frame_id
        self._clock = node.get_clock()
        self._mesh = node.create_publisher(Mesh, f"{below}/mesh", LATCHED)
        self._mesh_version = node.create_publisher(UInt32, f"{below}/mesh_version", LATCHED)
        self._inclusions = node.create_publisher(Mesh, f"{below}/inclusions", LATCHED)
        self._markers = node.create_publisher(MarkerArray, f"{below}/markers", LATCHED)
        self._surface = node.create_publisher(PointCloud2, f"{below}/surface", STREAM)
        self._skeleton = node.create_publisher(PointCloud2, f"{below}/skeleton", STREAM)
        self._shown = PublishedShapes(frame_id, {"": served.physics}, Touches(ports, served.physics), len(ports))
        organ = served.organ
        self._skeleton_bytes = CloudTemplate(frame_id, organ.n_atoms, ("x", "y", "z", "radius", "parent"))
        self._skeleton_bytes.points[:, 3] = organ.atom_radius
        self._skeleton_bytes.points[:, 4] = organ.atom_parent
        self._colour = ""  # of the markers last published
        self._sequence: dict[str, tuple[int, ...]] = {}
        self._had_markers = 0
        self._surface_sent = -math.inf
        self.unchanged_skips = self.unseen_skips = self.published = 0
        self._publish_mesh()
        if len(organ.inclusion_stiffness):
            self._inclusions.publish(inclusion_mesh(organ))

    def _publish_mesh(self) -> None:
        """Publish the rest surface: at the start, and when a cut or its reset has changed it."""
        shown = self._shown.organs[0]
        self._surface_bytes = CloudTemplate(self._frame_id, shown.n_points, ("x", "y", "z"))
        self._mesh_version.publish(UInt32(data=self._shown.versions[0]))
        mesh = rest_mesh(shown)
        self._mesh.publish(mesh)
        self._recorder.mesh(mesh)

    def present(self) -> None:
        """Publish what has subscribers (or is recorded) and has moved since it was last published."""
        if self._shown.renew():
            self._publish_mesh()
        recorder, colour = self._recorder, self._values["marker_colour"]
        n_markers = self._markers.get_subscription_count()
        n_surface = self._surface.get_subscription_count() + self._skeleton.get_subscription_count()
        sequence = self._shown.sequence
        # A viewer that has just come gets the organ even when nothing moves.
        show_markers = n_markers > 0 and (
            self._moved("markers", sequence) or n_markers > self._had_markers or colour != self._colour
        )
        # Best effort may lose the shape in which the organ comes to rest, or a viewer's first one: publish it again.
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
        tick = self._shown.refresh()
        if tick < 0:
            return
        stamp = self._clock.now().nanoseconds
        record_markers = record and bool(self._values["record_markers"])
        markers = self._shown.markers(stamp, colour) if show_markers or record_markers else None
        if show_markers and markers is not None:
            self._markers.publish(markers)
            self._sequence["markers"], self._colour = sequence, colour
        if show_surface or record:
            shown, positions = self._shown.organs[0], self._shown.positions
            n, atoms = shown.organ.n_surface, shown.organ.n_atoms
            self._surface_bytes.points[:] = shown.points(positions)
            self._skeleton_bytes.points[:, :3] = positions[n : n + atoms]
            surface, skeleton = self._surface_bytes.message(stamp), self._skeleton_bytes.message(stamp)
            if show_surface:
                self._surface.publish(surface)
                self._skeleton.publish(skeleton)
                self._sequence["surface"], self._surface_sent = sequence, time.monotonic()
            if record:
                recorder.surface(tick, surface, skeleton, markers if record_markers else None)
                self._sequence["bag"] = sequence
        self.published += 1

    def report(self, report: Report) -> None:
        """Add what was not published."""
        for name, count in (("mesh_unchanged", self.unchanged_skips), ("no_subscriber", self.unseen_skips)):
            report.values[f"skipped.{name}"] = report.values.get(f"skipped.{name}", 0) + count  # of all organs

    def close(self) -> None:
        """Delete the markers in every viewer."""
        self._markers.publish(self._shown.deletion())

    def _moved(self, name: str, sequence: tuple[int, ...]) -> bool:
        return self._sequence.get(name) != sequence


class ScenePublisher:
    """Publisher of the markers of a scene's organs as one array, and of its ligaments, while there are subscribers."""

    def __init__(
        self,
        node: Node,
        served: Sequence[ServedOrgan],
        frame_id: str,
        ports: Sequence[ToolPort],
        organs: Organs,
        values: Values,
    ) -> None:
        self._values, self._clock = values, node.get_clock()
        self._markers = node.create_publisher(MarkerArray, "~/markers", LATCHED)
        named = {one.name: one.physics for one in served}
        self._shown = PublishedShapes(frame_id, named, Touches(ports, organs), len(ports))
        self._sent: tuple[object, ...] = ()
        self._had = 0
        joined = organs.loop.joined
        self._ligaments: Ligaments | None = None
        if len(joined.links.slack):
            self._ligaments = Ligaments(frame_id, joined, self._shown.first_rows)
            self._new_ligaments = partial(Ligaments, frame_id, joined)
            self._lines = node.create_publisher(MarkerArray, "~/ligaments", LATCHED)
        self._lines_sent: tuple[int, ...] = ()

    def present(self) -> None:
        """Publish all organs when one has moved since, or a viewer has come; ligaments when their organs moved."""
        if self._shown.renew() and self._ligaments is not None:
            self._ligaments = self._new_ligaments(self._shown.first_rows)
        count, colour = self._markers.get_subscription_count(), self._values["marker_colour"]
        came, self._had = count > self._had, count
        sequence = self._shown.sequence
        sent = (colour, sequence)
        shows = count > 0 and (sent != self._sent or came)
        # Latched, so a new viewer gets the last ones.
        draws = (
            self._ligaments is not None and sequence != self._lines_sent and self._lines.get_subscription_count() > 0
        )
        if not (shows or draws) or self._shown.refresh() < 0:
            return
        stamp = self._clock.now().nanoseconds
        if shows:
            self._markers.publish(self._shown.markers(stamp, colour))
            self._sent = sent
        if draws and self._ligaments is not None:
            self._lines.publish(self._ligaments.message(stamp, self._shown.positions))
            self._lines_sent = sequence

    def close(self) -> None:
        """Delete the markers in every viewer."""
        self._markers.publish(self._shown.deletion())
        if self._ligaments is not None:
            self._lines.publish(self._ligaments.deletion())
