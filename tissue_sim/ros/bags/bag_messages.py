"""What the parts of a recorder write to: the open bag, if there is one."""

from __future__ import annotations

import threading
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from tissue_sim.array_types import Array
from tissue_sim.ros.bags import bag
from tissue_sim.ros.bags.spool import Spool


class BagMessages:
    """Messages on their way to the spool of the newest bag; any thread may write them."""

    def __init__(self) -> None:
        self.spool: Spool | None = None
        self.recording = False
        # Held while something is posted to the loop and noted here: a journal that says that it was applied then also
        # holds the note, or follows it, so that a bag may break off anywhere.
        self.lock = threading.RLock()
        self._store = get_typestore(Stores.ROS2_JAZZY)

    @property
    def active(self) -> bool:
        """Whether messages are recorded."""
        return self.recording and self.spool is not None and self.spool.is_open

    def put(self, name: str, raw: bytes) -> bool:
        """Record a message as it is.

        name: its topic. Returns whether there is a bag with room for it.
        """
        return self.spool is not None and self.spool.put(name, raw)

    def packed(self, name: str, arrays: Mapping[str, Array]) -> None:
        """Record arrays, by name, as the octets of an npz of a topic."""
        self.octets(name, bag.pack(**arrays))

    def octets(self, name: str, data: NDArray[np.uint8]) -> None:
        """Record a UInt8MultiArray of a topic."""
        layout = self._store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        self._serialised(name, bag.OCTETS, self._store.types[bag.OCTETS](layout=layout, data=data))

    def text(self, name: str, text: str) -> None:
        """Record a String of a topic."""
        kind = bag.NODE_TOPICS["config"]
        self._serialised(name, kind, self._store.types[kind](data=text))

    def _serialised(self, name: str, kind: str, message: object) -> None:
        self.put(name, bytes(self._store.serialize_cdr(message, kind)))
