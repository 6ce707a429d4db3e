"""Where tools touch an organ, and organs each other: found anew when something has moved."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from tissue_sim.array_types import Floats, Longs
from tissue_sim.contact.finder import ContactFinder, reach_margins
from tissue_sim.contact.pair_finder import PairFinder
from tissue_sim.ros.bags.joined_recorder import JoinedRecorder
from tissue_sim.ros.bags.organ_recorder import OrganRecorder
from tissue_sim.ros.node.served_organ import ServedOrgan
from tissue_sim.ros.node.tool_port import ToolPort
from tissue_sim.ros.shared.organs import Organs


class ToolsNow(NamedTuple):
    """The newest of all B bodies of tools."""

    sequences: list[int]  # of the poses
    poses: Floats  # (B, 7)
    fresh: list[bool]
    pushing: Longs  # (B,) 1 for those with an external force; the first of a tool's bodies pushes

    @classmethod
    def of(cls, ports: Sequence[ToolPort]) -> ToolsNow:
        """As the ports have them."""
        newest = [port.newest for port in ports]
        fresh = [counts for port in ports for counts in [port.pose_freshness.counts] * len(port.bodies)]
        pushing = np.zeros(len(fresh), dtype=np.int64)
        pushing[[port.bodies[0] for port in ports if port.force_freshness.counts]] = 1
        sequences = [one.sequence for one in newest for _ in one.placed]
        return cls(sequences, np.concatenate([one.placed for one in newest]), fresh, pushing)


class ContactSearch:
    """Contact sets of one organ.

    Nothing is found when no pose and no position changed; a tool that appears inside the organ is held off until it has
    been outside.
    """

    def __init__(
        self,
        finder: ContactFinder,
        served: ServedOrgan,
        ports: Sequence[ToolPort],
        recorder: OrganRecorder,
        warn: Callable[[str], None],
    ) -> None:
        self.unchanged_skips = self.dropped = 0
        self.finder, self._physics, self._recorder, self._warn = finder, served.physics, recorder, warn
        self._organ = f"organ '{served.name}'" if served.name else "the organ"
        self._port_of = [port for port in ports for _ in port.bodies]  # of each body
        n_bodies = len(self._port_of)
        self._positions = np.zeros((len(served.physics.simulation.model.rest), 3))
        self._engaged = np.zeros(n_bodies, dtype=np.int64)
        self._held_off = [False] * n_bodies
        self._last_pose = np.zeros((n_bodies, 7))
        self._last_time = time.monotonic()
        self._last_key: tuple[int, ...] = ()
        self._last_empty = False
        self._last_resets = self._physics.loop.resets

    def is_idle(self, now: ToolsNow) -> bool:
        """Whether no tool comes, and none is left in touch."""
        if self._physics.loop.resets != self._last_resets:  # the organ has jumped back under the tools
            self._last_resets = self._physics.loop.resets
            self._engaged[:] = 0
        return not any(now.fresh) and not now.pushing.any() and self._last_empty and not self._engaged.any()

    def refresh(self, now: ToolsNow, begun: float, rate: float) -> bool:
        """Find a contact set, where anything has moved; returns whether it did.

        begun: monotonic s; rate: Hz, of contact sets.
        """
        key = (*now.sequences, self._physics.surface_sequence, *map(int, now.fresh), *now.pushing.tolist())
        if key == self._last_key:
            self.unchanged_skips += 1
            return False
        self._last_key = key
        tick, carried = self._physics.positions(self._positions)
        poses = now.poses.copy()
        poses[:, :3] -= carried
        elapsed = max(begun - self._last_time, 1e-4)
        bodies = self._physics.results().bodies
        behind = bodies.speed * bodies.remaining  # m that the loop has yet to lead them
        reach = reach_margins(poses[:, :3], self._last_pose[:, :3], 2.0 / (rate * elapsed), behind)
        margins = np.zeros(len(poses))
        for body, is_fresh in enumerate(now.fresh):
            # A thread that had no time may never see poses stop: the loop does.
            if not is_fresh or bodies[body].lapsed:
                self._engaged[body] = 0
                continue
            if self._engaged[body]:
                margins[body] = reach[body]
            elif self.finder.is_inside(body, self._positions, poses[body]):
                self._hold_off(body)
            else:
                self._engaged[body] = 1
                self._held_off[body] = False
        self._last_pose, self._last_time = poses, begun
        found = self.finder.find(self._positions, poses, margins, self._engaged, now.pushing)
        self._last_empty = found.header.points == 0 and bool(np.all(found.tip_node < 0))
        self.dropped += int(found.header.dropped)
        engaged, pushing = self._engaged.astype(bool).tolist(), now.pushing.astype(bool).tolist()
        rows = list(zip(now.sequences, margins.tolist(), engaged, pushing, strict=True))
        with self._recorder.together:
            sequence = self._physics.post_contacts(found)
            self._recorder.contacts(sequence, tick, found, rows)
        return True

    def _hold_off(self, body: int) -> None:
        if not self._held_off[body]:
            name, stale_time = self._port_of[body].name, self._physics.settings().stale_time
            self._warn(
                f"tool '{name}' appeared inside {self._organ} and feels nothing until it has been outside:"
                f" send a pose outside first, and the next within stale_time ({stale_time:g} s)"
            )
        self._held_off[body] = True


class PairSearch:
    """Where organs of a scene touch each other."""

    def __init__(self, organs: Organs, recorder: JoinedRecorder) -> None:
        self._organs, self._recorder = organs, recorder
        self.finder = PairFinder([one.simulation.organ for one in organs.each])
        self.unchanged_skips = 0
        self._positions = [np.zeros_like(one.simulation.organ.rest_positions) for one in organs.each]
        self._last_key: tuple[int, ...] = (0,)
        self._last_empty = True

    def refresh(self) -> bool:
        """Find pairs, where any organ has moved; returns whether one has."""
        key = (self._organs.loop.resets, *self._organs.surface_sequences)
        if key == self._last_key:
            self.unchanged_skips += 1
            return False
        if key[0] != self._last_key[0]:  # the organs have jumped
            self.finder.forget()
        self._last_key = key
        ticks = []
        for one, positions in zip(self._organs.each, self._positions, strict=True):
            tick, carried = one.positions(positions)
            positions += carried
            ticks.append(tick)
        found = self.finder.find(self._positions, [not one.results().status.asleep for one in self._organs.each])
        is_empty = bool(found.found[0] == 0)
        if not (is_empty and self._last_empty):
            with self._recorder.together:
                self._recorder.pairs(self._organs.loop.post_pairs(found), ticks, found)
        self._last_empty = is_empty
        return True
