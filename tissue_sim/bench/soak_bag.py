"""Check whether a long bag is complete, and of the wrenches in it, message by message, as it may exceed memory."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tissue_sim import progress
from tissue_sim.errors import UserError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection


class BagFound(NamedTuple):
    """Content of a bag."""

    bytes: int
    messages: int
    missing: int  # messages that the bag's counts or its journal promise and that are missing
    not_finite: int  # wrenches and surfaces with a NaN or infinity
    highest_force: float  # N, of a tool, of all wrenches that went out
    wrenches: int
    surfaces: int


def read_bag(path: Path) -> BagFound:
    """Read all of a closed bag. Raises UserError where it can't be read, or was broken off."""
    from rosbags.rosbag2 import Reader

    from tissue_sim.ros.bags import recovery

    if recovery.is_interrupted(path):
        raise UserError(f"bag {path} was not closed")
    try:
        with Reader(path) as reader:
            reading = _Reading(reader.connections)
            total = reader.message_count
            for connection, _, raw in progress.steps(reader.messages(), "reading the bag, message", total):
                reading.take(connection, bytes(raw))
    except recovery.OF_RUBBISH as error:
        raise UserError(f"bag {path} can't be read: {error}") from None
    missing = abs(total - reading.messages) + reading.unwritten()
    size = sum(file.stat().st_size for file in path.iterdir())
    return BagFound(
        size, reading.messages, missing, reading.not_finite, reading.highest, reading.wrenches, reading.surfaces
    )


class _Reading:
    """Counters while a bag is read."""

    def __init__(self, connections: list[Connection]) -> None:
        self.messages = self.not_finite = self.wrenches = self.surfaces = 0
        self.highest = 0.0
        self._promised = {"wrenches": 0, "surfaces": 0}
        kinds = {"servo_cf": self._wrench, "surface": self._surface, "journal": self._journal}
        self._takers = {c.topic: kinds[last] for c in connections if (last := c.topic.rpartition("/")[2]) in kinds}

    def take(self, connection: Connection, raw: bytes) -> None:
        """Count a message."""
        self.messages += 1
        taker = self._takers.get(connection.topic)
        if taker is not None:
            taker(raw)

    def unwritten(self) -> int:
        """Return how many messages of the journal are missing, and how many aren't in it."""
        found = {"wrenches": self.wrenches, "surfaces": self.surfaces}
        return sum(abs(found[kind] - count) for kind, count in self._promised.items())

    def _wrench(self, raw: bytes) -> None:
        from tissue_sim.ros.shared.cdr import parse_stamped

        self.wrenches += 1
        values = parse_stamped(raw, 6).values
        if not all(map(math.isfinite, values)):
            self.not_finite += 1
            return
        self.highest = max(self.highest, math.hypot(*values[:3]))

    def _surface(self, raw: bytes) -> None:
        from tissue_sim.ros.shared.cdr import parse_cloud

        self.surfaces += 1
        self.not_finite += not np.all(np.isfinite(parse_cloud(raw)))

    def _journal(self, raw: bytes) -> None:
        from tissue_sim.ros.bags import bag
        from tissue_sim.ros.shared.cdr import parse_octets

        rows = bag.unpack(parse_octets(raw))
        for kind in self._promised:
            self._promised[kind] += len(rows[kind])
