"""Positions of organs, one after the other, and as markers; where one is cut, with the walls of its cuts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Protocol

import numpy as np

from tissue_sim.array_types import Floats
from tissue_sim.rendering.appearance import FULL_DISPLACEMENT, FULL_FORCE, MOVING
from tissue_sim.ros.node.output.markers import OrganMarkers, all_finite, write_displacement
from tissue_sim.ros.node.tools.tool_port import ToolPort
from tissue_sim.ros.shared.physics import Physics
from tissue_sim.ros.shared.shown_organ import ShownOrgan


class ContactForces(Protocol):
    """An organ, or all of them."""

    def wrenches(self) -> tuple[int, Floats]:
        """Return the newest tick, and what tools feel, (T, 6) N, N m."""


class Touches:
    """Where tools are, and what they feel of one organ or of all."""

    def __init__(self, ports: Sequence[ToolPort], forces: ContactForces) -> None:
        self._ports, self._forces = list(ports), forces
        self._tips, self._wrenches = np.zeros((len(ports), 3)), np.zeros((len(ports), 6))

    def now(self) -> tuple[Floats, Floats]:
        """Return each tool's origin, (T, 3) m, and its wrench, (T, 6) N, N m; the next call overwrites them."""
        _, wrenches = self._forces.wrenches()
        for index, port in enumerate(self._ports):
            self._tips[index] = port.newest.pose[:3]
            self._wrenches[index] = port.wrench(wrenches)
        return self._tips, self._wrenches


class PublishedShapes:
    """Positions of organs' rows (see ShownOrgan), one after the other, and their MarkerArray as bytes.

    frame_id: frame of the positions; physics: the organs' simulations by the prefix of their markers' namespaces;
    touches: where tools are; n_tools: number of tools.
    """

    def __init__(self, frame_id: str, physics: Mapping[str, Physics], touches: Touches, n_tools: int) -> None:
        self._names, self._physics, self._touches = list(physics), list(physics.values()), touches
        self._frame_id, self._n_tools = frame_id, n_tools
        self._make()

    def _make(self) -> None:
        """Make room for the organs as they are now."""
        self.versions = [one.version for one in self._physics]
        self.organs = [ShownOrgan.of(one.simulation) for one in self._physics]
        self._rest = np.concatenate([organ.rest for organ in self.organs])
        ends = np.cumsum([organ.n_rows for organ in self.organs]).tolist()
        self._parts = [slice(first, last) for first, last in zip([0, *ends[:-1]], ends, strict=True)]
        self.positions = self._rest.copy()  # where breathing has moved them
        self._own, self._fraction = self._rest.copy(), np.zeros(len(self._rest))
        self._nodes = [organ.organ.rest_positions for organ in self.organs]
        named = dict(zip(self._names, self.organs, strict=True))
        self._new_markers = partial(OrganMarkers, self._frame_id, named, self._n_tools)
        self._plain = self._new_markers()
        self._coloured: OrganMarkers | None = None  # made when it is wanted: it takes a while

    def renew(self) -> bool:
        """Make room for organs that were cut, or reset after cuts, since the last call; return whether any was."""
        if self.versions == [one.version for one in self._physics]:
            return False
        self._make()
        return True

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
        each = zip(self._physics, self._parts, self.organs, self._nodes, strict=True)
        for one, part, organ, nodes in reversed(list(each)):
            first, carried = one.positions(nodes)
            organ.fill(self._own[part], nodes)
            np.add(self._own[part], carried, out=self.positions[part])
        return first if all_finite(self.positions) else -1  # RViz would drop the marker

    def markers(self, stamp: int, colour: str) -> bytes:
        """Return the MarkerArray. stamp: its time, ns; colour: what surfaces are coloured by, one of MARKER_COLOURS."""
        tips, wrenches = self._touches.now()
        if colour == "none":
            return self._plain.message(stamp, self.positions, tips, wrenches)
        if self._coloured is None:
            self._coloured = self._new_markers(coloured=True)
        return self._coloured.message(stamp, self.positions, tips, wrenches, self._fractions(colour))

    def deletion(self) -> bytes:
        """Return the same markers, all deleted: for the shutdown."""
        return self._plain.deletion()

    def _fractions(self, colour: str) -> Floats:
        """Return each row's place on the colour scale, 0 to 1."""
        if colour == "displacement":  # without the motion of the breath
            write_displacement(self._fraction, self._own, self._rest, FULL_DISPLACEMENT)
            return self._fraction
        for one, part, organ in zip(self._physics, self._parts, self.organs, strict=True):
            if colour == "force":
                fraction = one.contact_forces() / FULL_FORCE
            else:
                fraction = np.where(one.moving(), MOVING, 0.0)
            if len(fraction) == organ.organ.n_nodes:  # another one where the organ has just been cut
                organ.fill(self._fraction[part], fraction)
        return self._fraction
