"""Contact search of tools with an organ, and of organs with each other, whenever something has moved."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs, Mask
from tissue_sim.contact.finder import MARGIN, ContactFinder, ContactQuery
from tissue_sim.contact.organ_contact_finder import OrganContactFinder
from tissue_sim.contact.reach_margins import pose_distances, reach_margins
from tissue_sim.contact.touched_surface import TouchedSurface
from tissue_sim.model.contact.tool_motion import MAX_FAST_SLIPS
from tissue_sim.model.data.contact_set import Engaged
from tissue_sim.model.data.records import Records
from tissue_sim.ros.bags.joined_recorder import JoinedRecorder
from tissue_sim.ros.bags.organ_recorder import OrganRecorder
from tissue_sim.ros.node.shared.served_organ import ServedOrgan
from tissue_sim.ros.node.tools.tool_port import ToolPort
from tissue_sim.ros.shared.organs import Organs


class ToolsNow(NamedTuple):
    """The newest inputs of all B bodies of tools."""

    sequences: list[int]  # of the poses
    poses: Floats  # (B, 7)
    fresh: list[bool]
    pushing: Longs  # (B,) 1 for those with an external force; the first of a tool's bodies pushes

    @classmethod
    def of(cls, ports: Sequence[ToolPort]) -> ToolsNow:
        """Return them as the tools' ports have them."""
        newest = [port.newest for port in ports]
        fresh = [counts for port in ports for counts in [port.pose_freshness.counts] * len(port.bodies)]
        pushing = np.zeros(len(fresh), dtype=np.int64)
        pushing[[port.bodies[0] for port in ports if port.force_freshness.counts]] = 1
        sequences = [one.sequence for one in newest for _ in one.placed]
        return cls(sequences, np.concatenate([one.placed for one in newest]), fresh, pushing)


class ContactSearch:
    """Contact sets of one organ.

    They are found around where the loop has its tools, and reach on towards their newest poses: the loop moves a tool
    no farther than its set reaches. The search is skipped when no pose and no position changed; a tool that appears
    inside the organ is held off until it has been outside.
    """

    def __init__(
        self,
        finder: ContactFinder,
        served: ServedOrgan,
        ports: Sequence[ToolPort],
        recorder: OrganRecorder,
    ) -> None:
        self.unchanged_skips = self.dropped = 0
        self.finder, self._physics, self._recorder = finder, served.physics, recorder
        self._organ = f"organ '{served.name}'" if served.name else "the organ"
        self._port_of = [port for port in ports for _ in port.bodies]  # of each body
        n_bodies = len(self._port_of)
        self._positions = np.zeros((len(served.physics.simulation.model.rest), 3))
        self._extents = finder.tools.shapes.extent
        self._reported = np.full(n_bodies, -1)  # life, by `releases`, in which a held-off body was reported
        self._has_slipped = np.zeros(n_bodies, dtype=bool)
        self._last_goals = np.zeros((n_bodies, 7))
        self._last_time = time.monotonic()
        self._last_key: tuple[object, ...] = ()
        self._last_empty = False
        self.is_behind = False  # a tool on its way to its newest pose needs further sets
        self._next: tuple[ContactFinder, int] | None = None  # on the surface after a cut, with its number of nodes

    def finder_of(self, surface: TouchedSurface) -> ContactFinder:
        """Return a finder on another surface of the organ; this takes a while."""
        return ContactFinder(surface, self.finder.tools)

    def exchange(self, finder: ContactFinder) -> None:
        """Search with another finder from the next search on, after the loop has gone on with its organ."""
        self._next = finder, self._physics.simulation.organ.n_nodes

    def _take_finder(self) -> None:
        """Take the newest finder, if it is another one."""
        taken, self._next = self._next, None
        if taken is None:
            return
        finder, nodes = taken
        finder.counters = self.finder.counters
        self.finder, self._positions = finder, np.zeros((nodes, 3))
        self._last_key = ()
        with self._recorder.lock:
            self._recorder.searched(int(self._physics.box.contacts.sequence[0]) + 1)

    def is_idle(self, now: ToolsNow) -> bool:
        """Return whether no tool comes by the newest inputs, and none is left in touch."""
        if any(now.fresh) or now.pushing.any() or not self._last_empty:
            return False
        self.is_behind = False
        return not self._physics.results().bodies.engaged.any()

    def refresh(self, now: ToolsNow, begun: float, rate: float) -> bool:
        """Find a contact set, where anything has moved.

        now: the newest inputs; begun: when this search began, monotonic, s; rate: rate of contact sets, Hz. Returns
        whether it found one.
        """
        self._take_finder()
        results, surface = self._physics.results(), self._physics.surface_sequence
        bodies, places = results.bodies, results.body_pose
        looked = bodies.engaged.astype(bool) | (np.array(now.fresh) & (bodies.age >= 0) & (bodies.released == 0))
        key = (*now.sequences, surface, places.tobytes(), bodies.releases.tobytes(), looked.tobytes())
        key = (*key, bodies.engaged.tobytes(), bodies.cutting.tobytes(), now.pushing.tobytes())
        if key == self._last_key:
            self.unchanged_skips += 1
            return False
        self._last_key = key
        tick, carried = self._physics.positions(self._positions)
        goals = now.poses.copy()
        goals[:, :3] -= carried
        fraction = 2.0 / (rate * max(begun - self._last_time, 1e-4))
        margins = np.where(looked, reach_margins(places, goals, self._last_goals, fraction, self._extents), 0.0)
        self.is_behind = bool(np.any(pose_distances(places, goals, self._extents)[looked] > 0.5 * MARGIN))
        self._last_goals, self._last_time = goals, begun
        engaged = np.where(looked, Engaged.YES.value, Engaged.NO.value)
        engaged[looked & bodies.cutting.astype(bool)] = Engaged.CUTS
        for body in np.flatnonzero(looked & (bodies.engaged == 0) & (bodies.resisted == 0)).tolist():
            if self.finder.is_inside(body, self._positions, places[body]):
                engaged[body] = Engaged.HELD_OFF
        self._report_inactive(engaged, bodies)
        self._report_slips(bodies)
        releases = bodies.releases.copy()
        found = self.finder.find(self._positions, ContactQuery(places.copy(), margins, engaged, now.pushing, releases))
        self._last_empty = found.header.points == 0 and bool(np.all(found.tip_node < 0))
        self.dropped += int(found.header.dropped)
        rows = list(zip(margins.tolist(), engaged.tolist(), now.pushing.astype(bool).tolist(), strict=True))
        with self._recorder.lock:
            sequence = self._physics.post_contacts(found)
            self._recorder.contacts(sequence, (tick, int(results.status.tick)), found, rows)
        return True

    def _report_inactive(self, engaged: Longs, bodies: Records) -> None:
        """Notify ports of bodies that nothing resists: each time that one was outside before, stopped or was reset."""
        outside = (engaged == Engaged.YES) | (engaged == Engaged.CUTS)
        held_off = ~outside & ((engaged == Engaged.HELD_OFF) | bodies.held_off.astype(bool))
        is_new = held_off & (self._reported != bodies.releases)
        self._reported[is_new] = bodies.releases[is_new]
        self._reported[outside] = -1
        for port in self._ports_of(is_new):
            port.note_inactive(self._organ)

    def _report_slips(self, bodies: Records) -> None:
        """Notify ports of bodies that slipped into the organ since the last search, however soon they are free."""
        before, self._has_slipped = self._has_slipped, bodies.slips > MAX_FAST_SLIPS
        for port, some in self._ports_of(self._has_slipped & ~before).items():
            port.note_slipped(float(bodies.bearable[some].min()))

    def _ports_of(self, chosen: Mask) -> dict[ToolPort, list[int]]:
        """Return the ports of some bodies, with these. chosen (B,): True for the bodies."""
        found: dict[ToolPort, list[int]] = {}
        for body in np.flatnonzero(chosen).tolist():
            found.setdefault(self._port_of[body], []).append(body)
        return found


class OrganContactSearch:
    """Pairs where organs of a scene touch each other."""

    def __init__(self, organs: Organs, recorder: JoinedRecorder) -> None:
        self._organs, self._recorder = organs, recorder
        self.finder = OrganContactFinder([one.simulation.organ for one in organs.each])
        self.unchanged_skips = 0
        self._positions = [np.zeros_like(one.simulation.organ.rest_positions) for one in organs.each]
        self._last_key: tuple[int, ...] = (0,)
        self._last_empty = True
        # By organ, its surface after a cut, and the number of that.
        self._next: dict[int, tuple[TouchedSurface, int]] = {}

    def exchange(self, organ: int, surface: TouchedSurface, number: int) -> None:
        """Search on another surface of an organ from the next search on, after the loop has gone on with it.

        number: number of the cut.
        """
        self._next[organ] = surface, number

    def _take_surfaces(self) -> None:
        """Take the newest surfaces, where there are any."""
        while self._next:
            organ, (surface, number) = self._next.popitem()
            self.finder.exchange(organ, surface, number)
            self._positions[organ] = np.zeros((surface.organ.n_nodes, 3))
            self._last_key = self._last_key[:1]
            with self._recorder.lock:
                self._recorder.surface(organ, number, surface.is_cut)

    def refresh(self) -> bool:
        """Find pairs, where any organ has moved; return whether one has."""
        self._take_surfaces()
        key = (self._organs.loop.resets, *self._organs.surface_sequences)
        if key == self._last_key:
            self.unchanged_skips += 1
            return False
        if key[0] != self._last_key[0]:  # the organs have jumped
            self.finder.forget()
        ticks = self._read_positions()
        if ticks is None:
            return True
        self._last_key = key
        found = self.finder.find(self._positions, [not one.results().status.asleep for one in self._organs.each])
        is_empty = bool(found.found[0] == 0)
        if not (is_empty and self._last_empty):
            with self._recorder.lock:
                self._recorder.pairs(self._organs.loop.post_organ_contacts(found), ticks, found)
        self._last_empty = is_empty
        return True

    def _read_positions(self) -> list[int] | None:
        """Read where the organs are; return the ticks, or None where one was cut since its surface was taken.

        Its positions are those of other nodes then, and a replay would read them as they are.
        """
        ticks = []
        for one, positions, version in zip(self._organs.each, self._positions, self.finder.versions, strict=True):
            tick, carried = one.positions(positions)
            if one.version != version:
                return None
            np.add(positions, carried, out=positions)
            ticks.append(tick)
        return ticks
