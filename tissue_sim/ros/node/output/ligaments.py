"""Ligaments of organs as a marker of lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import Point
from visualization_msgs.msg import Marker

from tissue_sim.array_types import Floats
from tissue_sim.model.data.links import POINT
from tissue_sim.model.joined import Joined
from tissue_sim.rendering.appearance import LIGAMENT
from tissue_sim.ros.node.output.markers import MarkerBytes, empty_marker

WIDTH = 0.0006  # m


class Ligaments:
    """The links of a scene as a LINE_LIST: two points for each link."""

    def __init__(self, frame_id: str, joined: Joined, first: Sequence[int]) -> None:
        """Make the marker.

        frame_id: frame of the organs' positions; joined: the scene's links and its breath; first (organs,): row of each
        organ's first node in the stacked nodes of all.
        """
        links = joined.links
        of_organ = (links.organ != POINT).ravel()
        self._fixed = np.flatnonzero(~of_organ)  # ends at a point
        self._points, self._moves = links.point.reshape(-1, 3)[self._fixed], links.moves.ravel()[self._fixed]
        self._ends = np.flatnonzero(of_organ)
        self._nodes = links.node.ravel()[self._ends] + np.asarray(first)[links.organ.ravel()[self._ends]]
        self._breath = joined.carried.breath
        colour = (*(channel / 255.0 for channel in LIGAMENT), 1.0)
        marker = empty_marker(frame_id, "ligaments", 0, Marker.LINE_LIST, colour, (WIDTH, 0.0, 0.0))
        marker.points = [Point()] * len(of_organ)
        self._bytes = MarkerBytes([marker])

    def message(self, stamp: int, positions: Floats) -> bytes:
        """Return the MarkerArray for a time and positions.

        stamp: the time, ns; positions (n, 3) m: positions of all organs' nodes.
        """
        breath, points = self._breath, self._bytes.points[0]
        points[self._ends] = positions[self._nodes]
        displacement = breath.fraction * np.array([breath.x, breath.y, breath.z])
        points[self._fixed] = self._points + self._moves[:, None] * displacement
        self._bytes.stamp(stamp)
        self._bytes.show(0, True)
        return self._bytes.message()

    def deletion(self) -> bytes:
        """Return the same marker, deleted: for the shutdown."""
        return self._bytes.deletion()
