"""A bag's messages on their way to the disk: a queue with an end, and the thread that empties it."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Mapping

from rosbags.interfaces import Connection

from tissue_sim.ros.bags.writer import BagWriter

FLUSH_EVERY = 0.5  # s; with the journal's 0.25 s a bag that is broken off lacks less than the last second
MOST_WAITING = 256e6  # bytes; a disk that is so far behind ends the bag
PER_MESSAGE = 256  # bytes in the queue, beside its own
CLOSING_TIME = 0.4  # s that a bag which is closed before all is written may take for that

_FLUSH = ""  # in place of a topic


class Spool:
    """Takes messages from any thread, and writes them in the same order.

    patience maps topics that a bag can do without to the share of MOST_WAITING that may wait before theirs are left
    out. All others are kept: when they don't fit either, the bag ends with those before them, and that is an error.
    """

    def __init__(self, writer: BagWriter, topics: Mapping[str, Connection], patience: Mapping[str, float]) -> None:
        self._writer, self._topics = writer, topics
        self._most = {name: share * MOST_WAITING for name, share in patience.items()}
        self._queue: queue.SimpleQueue[tuple[str, int, bytes] | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._waiting = 0  # bytes
        self._newest = 0  # ns
        self._epoch = time.time_ns() - time.monotonic_ns()
        self._hurry = threading.Event()
        self.is_open = True
        self.lost = 0  # messages
        self.error = ""
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def put(self, name: str, raw: bytes) -> bool:
        """Queue a message of a topic; returns whether there was room for it."""
        size = len(raw) + PER_MESSAGE
        with self._lock:
            if not self.is_open:
                return False
            if self._waiting + size > self._most.get(name, MOST_WAITING):
                self.lost += 1
                if name not in self._most:
                    self._fail(f"the disk can't keep up, {1e-6 * self._waiting:.0f} MB wait")
                    self._queue.put(None)
                return False
            self._waiting += size
            # Wall time, but never running backwards within a bag.
            self._newest = max(self._newest, self._epoch + time.monotonic_ns())
            self._queue.put((name, self._newest, raw))
            return True

    def flush(self) -> None:
        """Have all that is queued on the disk soon."""
        self._queue.put((_FLUSH, 0, b""))

    def close(self, patience: float) -> None:
        """End the bag; what is not written within `patience` s is left out and counted as lost."""
        with self._lock:
            if self.is_open:
                self.is_open = False
                self._queue.put(None)
        self._thread.join(timeout=patience)
        self._hurry.set()
        self._thread.join(timeout=CLOSING_TIME)
        if self._thread.is_alive():
            self._fail("the disk doesn't answer")

    def _fail(self, reason: str) -> None:
        self.is_open = False
        self.error = self.error or f"recording to {self._writer.path} failed: {reason}"

    def _run(self) -> None:
        """Write until told to stop; a disk that fails ends the bag and is reported, the node goes on."""
        writer = self._writer
        try:
            self._write()
            writer.close()
        except Exception as error:  # anything that goes wrong on the way to the disk
            with self._lock:
                self._fail((isinstance(error, OSError) and error.strerror) or str(error))
                self.lost += self._queue.qsize()
                self._queue = queue.SimpleQueue()  # what nobody will write needs no memory
            writer.abort()

    def _write(self) -> None:
        writer, due = self._writer, time.monotonic() + FLUSH_EVERY
        while True:
            try:
                item = self._queue.get(timeout=max(0.0, due - time.monotonic()))
            except queue.Empty:
                item = (_FLUSH, 0, b"")
            if item is None:
                return
            name, stamp, raw = item
            if self._hurry.is_set():
                self.lost += self._queue.qsize()  # all but the None at the end, and this one
                return
            if name != _FLUSH:
                writer.write(self._topics[name], stamp, raw)
                with self._lock:
                    self._waiting -= len(raw) + PER_MESSAGE
            if name == _FLUSH or time.monotonic() >= due:
                writer.flush()
                due = time.monotonic() + FLUSH_EVERY
