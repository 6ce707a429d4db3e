"""Positions of organs, one after the other, and as markers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Protocol

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.organ.organ import Organ
from tissue_sim.ros.node.output.markers import OrganMarkers, all_finite, write_displacement
from tissue_sim.ros.node.tools.tool_port import ToolPort
from tissue_sim.ros.shared.appearance import FULL_DISPLACEMENT, FULL_FORCE, MOVING
from tissue_sim.ros.shared.physics import Physics


class ContactForces(Protocol):
    """An organ, or all of them."""

    def wrenches(self) -> tuple[int, Floats]:
        """Return the newest tick, and what tools feel, (T, 6) N, N m."""


class Touches:
    """Where tools are, and what they feel of one organ or of all."""

    def __init__(self, ports: Sequence[ToolPort], felt_of: ContactForces) -> None:
        self._ports, self._felt_of = list(ports), felt_of
        self._tips, self._felt = np.zeros((len(ports), 3)), np.zeros((len(ports), 6))

    def now(self) -> tuple[Floats, Floats]:
        """Return each tool's origin, (T, 3) m, and its wrench, (T, 6) N, N m; the next call overwrites them."""
        _, wrenches = self._felt_of.wrenches()
        for index, port in enumerate(self._ports):
            self._tips[index] = port.newest.pose[:3]
            self._felt[index] = port.wrench(wrenches)
        return self._tips, self._felt


class PublishedShapes:
    """Positions of organs, (n, 3) m, one after the other, and their MarkerArray as bytes.

    Parameters
    ----------
    frame_id : str
        Frame of the positions.
    organs : Mapping[str, Organ]
        The organs by the prefix of their markers' namespaces.
    physics : Sequence[Physics]
        Simulation of each.
    touches : Touches
        Where tools are.
    n_tools : int
        Number of tools.
    """

    def __init__(
        self, frame_id: str, organs: Mapping[str, Organ], physics: Sequence[Physics], touches: Touches, n_tools: int
    ) -> None:
        self._physics, self._touches = list(physics), touches
        self._rest = np.concatenate([organ.rest_positions for organ in organs.values()])
        ends = np.cumsum([organ.n_nodes for organ in organs.values()]).tolist()
        self._parts = [slice(first, last) for first, last in zip([0, *ends[:-1]], ends, strict=True)]
        self.positions = self._rest.copy()  # where breathing has moved them
        self._own, self._share = self._rest.copy(), np.zeros(len(self._rest))
        self._new_markers = partial(OrganMarkers, frame_id, organs, n_tools)
        self._plain = self._new_markers()
        self._coloured: OrganMarkers | None = None  # made when it is wanted: it takes a while

    @property
    def first_rows(self) -> list[int]:
        """Row of each organ's first node in `positions`."""
        return [part.start for part in self._parts]

    @property
    def sequence(self) -> tuple[int, ...]:
        """Value that changes whenever any organ moved."""
        return tuple(one.surface_sequence for one in self._physics)

    def refresh(self) -> int:
        """Take the newest positions; return the tick of the first organ's, or -1 if they must not be shown."""
        first = -1
        for one, part in zip(reversed(self._physics), reversed(self._parts), strict=True):
            first, carried = one.positions(self._own[part])
            np.add(self._own[part], carried, out=self.positions[part])
        return first if all_finite(self.positions) else -1  # RViz would drop the marker

    def markers(self, stamp: int, colour: str) -> bytes:
        """Return the MarkerArray.

        Parameters
        ----------
        stamp : int, ns
            Its time.
        colour : str
            What surfaces are coloured by, one of MARKER_COLOURS.
        """
        tips, wrenches = self._touches.now()
        if colour == "none":
            return self._plain.message(stamp, self.positions, tips, wrenches)
        if self._coloured is None:
            self._coloured = self._new_markers(coloured=True)
        return self._coloured.message(stamp, self.positions, tips, wrenches, self._shares(colour))

    def deletion(self) -> bytes:
        """Return the same markers, all deleted: for the shutdown."""
        return self._plain.deletion()

    def _shares(self, colour: str) -> Floats:
        """Return each node's place on the colour scale, (n,), 0 to 1."""
        if colour == "displacement":  # without the motion of the breath
            write_displacement(self._share, self._own, self._rest, FULL_DISPLACEMENT)
            return self._share
        for one, part in zip(self._physics, self._parts, strict=True):
            if colour == "force":
                self._share[part] = one.contact_forces() / FULL_FORCE
            else:
                self._share[part] = np.where(one.moving(), MOVING, 0.0)
        return self._share
