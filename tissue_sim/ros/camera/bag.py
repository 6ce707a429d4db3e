"""A bag of what a camera publishes."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

from rosbags.interfaces import Connection

from tissue_sim.errors import UserError
from tissue_sim.ros.bags.offered_qos import offered
from tissue_sim.ros.bags.writer import BagWriter, Topic
from tissue_sim.ros.shared.qos import RELIABLE

FLUSH_EVERY = 1.0  # s: what a power failure may cost


class CameraBag:
    """A bag, MCAP, whose messages are timed by their arrival here.

    Parameters
    ----------
    folder : Path
        Folder of the bag, which is made.
    topics : Mapping[str, type]
        The topics, and the classes of their messages.

    Raises
    ------
    UserError
        Where it can't be made.

    Attributes
    ----------
    problem : str
        Why it has ended before its time; empty while it goes on.
    """

    def __init__(self, folder: Path, topics: Mapping[str, type]) -> None:
        self.problem = ""
        self._writer = BagWriter(folder)
        try:
            self._writer.open()
        except OSError as error:
            raise UserError(f"cannot make the bag {folder}: {error.strerror}; choose another with --record") from None
        kinds = {name: f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}" for name, kind in topics.items()}
        self._topics: dict[str, Connection] = self._writer.add_topics(
            {name: Topic(kind, [offered(RELIABLE)]) for name, kind in kinds.items()}
        )
        self._flushed = time.monotonic()

    def keep(self, topic: str, stamp: int, message: bytes) -> None:
        """Write a message of one of the topics, until the disk is full.

        stamp: the message's own time, which may go back, ns; message: its bytes.
        """
        if self.problem:
            return
        try:
            self._writer.write(self._topics[topic], time.time_ns(), message)
            if time.monotonic() - self._flushed > FLUSH_EVERY:
                self._writer.flush()
                self._flushed = time.monotonic()
        except OSError as error:
            self._end(error)

    def close(self) -> None:
        """Write its end."""
        try:
            if not self.problem:
                self._writer.close()
        except OSError as error:
            self._end(error)

    def _end(self, error: OSError) -> None:
        self.problem = f"the bag {self._writer.path} ended before its time: {error.strerror}"
        self._writer.abort()
