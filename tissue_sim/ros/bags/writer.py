"""A bag's folder while it is written: one MCAP file after another, on the disk as far as they were flushed."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.typesys import Stores, get_typestore

from tissue_sim.ros.bags import metadata


class Topic(NamedTuple):
    """A topic of a bag."""

    kind: str  # its type
    qos: Sequence[Qos]  # that it is offered with


class Split(NamedTuple):
    """When a bag continues in another file; 0: never."""

    size: float = 0.0  # bytes
    duration: float = 0.0  # s


WHOLE = Split()


class _Shelved:
    """Stand-in for a list of records that only grows, such as the index of a file's chunks, in an unnamed file.

    In memory it would take some MB an hour of a node that records.
    """

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - it ends with this object
        self._count = 0

    def append(self, record: BytesIO) -> None:
        """Put one behind the others; raise OSError when that fails."""
        self._file.write(record.tell().to_bytes(4, "little"))
        self._file.write(record.getbuffer())
        self._count += 1

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[BytesIO]:
        self._file.seek(0)
        while length := self._file.read(4):
            record = BytesIO()
            record.write(self._file.read(int.from_bytes(length, "little")))
            yield record


class BagWriter(Writer):
    """Writer of a bag that can be opened without its end, too.

    What was flushed outlasts a process that is killed, or a power cut. Files are called <bag>_0.mcap and so on, as
    `ros2 bag reindex` wants them; each is locked while it is written.
    """

    def __init__(self, path: Path, split: Split = WHOLE) -> None:
        super().__init__(path, version=metadata.VERSION, storage_plugin=StoragePlugin.MCAP)
        self.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._split = split
        self._file: McapWriter | None = None
        self._counts: Counter[str] = Counter()  # messages in it, by topic
        self._flushed = 0  # bytes of it on the disk: whole records
        self._files: list[metadata.File] = []  # those before it

    def open(self) -> None:
        """Make the folder and its first file. Raises OSError when that fails."""
        self.path.mkdir(parents=True)
        metadata.sync_folder(self.path.parent)
        self._open_file()

    def add_topics(self, topics: Mapping[str, Topic]) -> dict[str, Connection]:
        """Give the bag its topics, by name."""
        store = get_typestore(Stores.ROS2_JAZZY)
        return {
            name: self.add_connection(name, topic.kind, typestore=store, offered_qos_profiles=topic.qos)
            for name, topic in topics.items()
        }

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write a message.

        connection: its topic; timestamp: its time (must not decrease), ns. Raises OSError when that fails.
        """
        if self._is_full(timestamp):
            self._close_file()
            self._open_file()
        super().write(connection, timestamp, data)
        self._counts[connection.topic] += 1

    def end_chunk(self) -> None:
        """Compress the messages so far, which until then occupy several times their size.

        Raises OSError when that fails.
        """
        if self._file is not None and self._file.chunk.msgs:
            self._file.close_chunk()

    def flush(self) -> None:
        """Write all messages so far to the disk. Raises OSError when that fails."""
        self.end_chunk()
        file = self._file
        assert file is not None
        if file.bio.tell() > self._flushed:
            file.bio.flush()
            os.fsync(file.bio.fileno())
            self._flushed = file.bio.tell()

    def close(self) -> None:
        """Write the ends of the last file and of the bag. Raises OSError when that fails."""
        self._close_file()
        metadata.write(self.path, self._files, self.connections)

    def abort(self) -> None:
        """Leave the last file without its end, cut after a whole record: a full disk has taken a part of one."""
        file, self._file, self.storage = self._file, None, None
        if file is not None:
            with suppress(OSError):  # what could not be written before can't be now
                file.bio.close()
            with suppress(OSError):
                os.truncate(file.path, self._flushed)

    def _open_file(self) -> None:
        self._flushed = 0
        file = self.storage = self._file = McapWriter(self.path, self.compression_mode)
        lock(file.bio.fileno())
        file.chunks = _Shelved(self.path)  # type: ignore[assignment]
        file.path = file.path.rename(self.path / f"{self.path.name}_{len(self._files)}.mcap")
        self._counts = Counter()
        for topic in self.connections:
            if topic.msgtype not in {schema.name for schema in file.schemas}:
                file.add_msgtype(topic)
            file.add_connection(topic, metadata.as_yaml(dump_qos_v9(metadata.qos_of(topic))))
        self.flush()
        metadata.sync_folder(self.path)

    def _is_full(self, timestamp: int) -> bool:
        file, split = self._file, self._split
        if file is None or not self._counts:
            return False
        lasts, takes = timestamp - file.message_start_time, file.bio.tell()
        return bool((split.duration and lasts >= 1e9 * split.duration) or (split.size and takes >= split.size))

    def _close_file(self) -> None:
        self.flush()
        file = self._file
        assert file is not None
        summary = metadata.File(file.path.name, file.message_start_time, file.message_end_time, dict(self._counts))
        descriptor = os.dup(file.bio.fileno())  # rosbags closes the file without an fsync
        try:
            file.close(metadata.VERSION, metadata.as_yaml(metadata.information([summary], self.connections)))
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        self._files.append(summary)
        self._file = self.storage = None


def lock(descriptor: int) -> bool:
    """Lock an open file for as long as it is open.

    descriptor: descriptor of the file. Returns False when another process has locked it.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True
