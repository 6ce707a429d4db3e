"""A bag's messages on their way to the disk: a bounded buffer, and the thread that empties it."""

from __future__ import annotations

import mmap
import struct
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping

from rosbags.interfaces import Connection

from tissue_sim.ros.bags.writer import BagWriter

FLUSH_EVERY = 0.5  # s; with the journal's 0.25 s a broken-off bag lacks less than the last second
PAUSE = 0.05  # s between checks of the queue: a thread that wakes for each message takes time from those that put them
MOST_WAITING = 256e6  # bytes; a disk that is so far behind ends the bag
CLOSING_TIME = 2.0  # s for a bag that is closed before all is written, on a busy machine
BLOCK = 1 << 16  # bytes; a larger message has a block of its own
_HEADER = struct.Struct("<qqq")  # stamp, topic, length


class _Block:
    """Consecutive messages; its pages are the system's own, and none are kept when it is gone."""

    def __init__(self, size: int) -> None:
        self._memory = mmap.mmap(-1, size)
        self._size, self.used = size, 0

    def has_room(self, size: int) -> bool:
        """Return whether a message of so many bytes fits behind the others."""
        return self.used + _HEADER.size + size <= self._size

    def append(self, topic: int, stamp: int, raw: bytes) -> None:
        """Put a message behind the others."""
        _HEADER.pack_into(self._memory, self.used, stamp, topic, len(raw))
        begin = self.used + _HEADER.size
        self.used = begin + len(raw)
        self._memory[begin : self.used] = raw

    def messages(self) -> Iterator[tuple[int, int, memoryview]]:
        """Yield topic, stamp and bytes of each."""
        at, memory = 0, memoryview(self._memory)
        while at < self.used:
            stamp, topic, length = _HEADER.unpack_from(memory, at)
            at += _HEADER.size + length
            yield topic, stamp, memory[at - length : at]


class Spool:
    """Buffer that takes messages from any thread and writes them in the same order.

    All topics without an entry in patience are kept: when their messages don't fit, the bag ends with those before, and
    that is an error.

    patience: topics that a bag can do without, each with the fraction of MOST_WAITING that may wait before its messages
    are left out.
    """

    def __init__(self, writer: BagWriter, topics: Mapping[str, Connection], patience: Mapping[str, float]) -> None:
        self._writer, self._topics = writer, list(topics.values())
        self._index = {name: index for index, name in enumerate(topics)}
        self._most = {name: fraction * MOST_WAITING for name, fraction in patience.items()}
        self._lock = threading.Lock()
        self._blocks: deque[_Block] = deque()
        self._count = self._waiting = 0  # messages, and bytes, that are not written yet
        self._newest = 0  # ns
        self._epoch = time.time_ns() - time.monotonic_ns()
        self._soon = self._hurry = False
        self._due = time.monotonic() + FLUSH_EVERY
        self._wake = threading.Event()
        self.is_open = True
        self.lost = 0  # messages
        self.error = ""
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def put(self, name: str, raw: bytes) -> bool:
        """Keep a message of a topic until it is written.

        name: the topic. Returns whether there was room for it.
        """
        size = len(raw) + _HEADER.size
        with self._lock:
            if not self.is_open:
                return False
            if self._waiting + size > self._most.get(name, MOST_WAITING):
                self.lost += 1
                if name not in self._most:
                    self._fail(f"the disk is too slow, {1e-6 * self._waiting:.0f} MB are waiting")
                return False
            if not self._blocks or not self._blocks[-1].has_room(len(raw)):
                self._blocks.append(_Block(max(BLOCK, size)))
            # Wall time, but never running backwards within a bag.
            self._newest = max(self._newest, self._epoch + time.monotonic_ns())
            self._blocks[-1].append(self._index[name], self._newest, raw)
            self._count += 1
            self._waiting += size
            return True

    def flush(self) -> None:
        """Request that everything that waits is soon on the disk."""
        with self._lock:
            self._soon = True
        self._wake.set()

    def close(self, patience: float) -> None:
        """End the bag; what is not written in time is left out and counted as lost.

        patience: time for writing it, s.
        """
        with self._lock:
            self.is_open = False
        self._wake.set()
        self._thread.join(timeout=patience)
        self._hurry = True
        self._thread.join(timeout=CLOSING_TIME)
        if self._thread.is_alive():
            self._fail("the disk doesn't answer")

    def _fail(self, reason: str) -> None:
        self.is_open = False
        self.error = self.error or f"recording to {self._writer.path} failed: {reason}"

    def _run(self) -> None:
        """Write until the bag ends; a disk that fails ends it and is reported, the node goes on."""
        writer = self._writer
        try:
            self._write_all()
            writer.close()
        except Exception as error:  # any failure on the way to the disk
            with self._lock:
                self._fail((isinstance(error, OSError) and error.strerror) or str(error))
            writer.abort()
        with self._lock:
            self.lost += self._count
            self._blocks.clear()  # messages that won't be written need no memory

    def _write_all(self) -> None:
        while not self._hurry:
            self._wake.wait(PAUSE)
            self._wake.clear()
            with self._lock:
                blocks, self._blocks = self._blocks, deque()
                ends, soon, self._soon = not self.is_open, self._soon, False
            while blocks and not self._hurry:
                self._write(blocks.popleft())
                if blocks:
                    self._writer.end_chunk()
                    self._flush_if(False)
            if ends:
                return
            self._flush_if(soon)

    def _flush_if(self, soon: bool) -> None:
        """Flush what is written to the disk, soon or when it is due."""
        if soon or time.monotonic() >= self._due:
            self._writer.flush()
            self._due = time.monotonic() + FLUSH_EVERY

    def _write(self, block: _Block) -> None:
        for topic, stamp, raw in block.messages():
            if self._hurry:
                return
            self._writer.write(self._topics[topic], stamp, raw)
            with self._lock:
                self._count -= 1
                self._waiting -= len(raw) + _HEADER.size
