"""Bags that were broken off: the process was killed, the disk was full, the power failed.

Such a bag has no metadata.yaml, and its last file lacks its end, perhaps within a record; everything before that can be
read. rosbags reads it, up to where `_whole_records` finds that it breaks off. The readers of mcap are no help with
that, as they unpack a chunk to whatever comes (33 kB to 1 GB), follow a length within a record beyond its end, and take
zeros that a power cut leaves for records of nine bytes each.
"""

from __future__ import annotations

import shutil
import struct
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from io import BytesIO
from pathlib import Path, PurePath
from typing import BinaryIO

from lz4.frame import LZ4FrameDecompressor
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.errors import ReaderError
from rosbags.rosbag2.storage_mcap import McapReader, decompress, read_sized, read_string, zstd
from rosbags.typesys import Stores, get_typestore

from tissue_sim.errors import UserError, shown
from tissue_sim.ros.bags import metadata
from tissue_sim.ros.bags.writer import BagWriter, Topic, lock

MAGIC = b"\x89MCAP0\r\n"
# Errors that rosbags raises for arbitrary metadata and records: its own, and those of YAML, zstd, lz4, sqlite and
# Python.
OF_RUBBISH = (Exception,)
HEADER, CHUNK, DATA_END = 0x01, 0x06, 0x0F  # opcodes of records
LARGEST_CHUNK = 1 << 28  # bytes, unpacked; a recorder closes a chunk after some MB
_UNPACKERS = {"zstd": zstd.ZstdDecompressor, "lz4": LZ4FrameDecompressor}
REWRITTEN = ".recovered"  # folder in a bag where a file is rewritten


def is_interrupted(folder: Path) -> bool:
    """Return whether a folder holds a bag without its end."""
    return folder.is_dir() and not (folder / metadata.NAME).exists() and any(folder.glob("*.mcap"))


def check_folder(folder: Path) -> None:
    """Raise UserError for what is not the folder of a bag."""
    if not folder.exists():
        raise UserError(f"bag {folder} does not exist")
    if not folder.is_dir():
        hint = f", here {folder.resolve().parent}" if folder.suffix == ".mcap" else ""
        raise UserError(f"bag {folder} is a file; name the folder of a bag{hint}")
    if not (folder / metadata.NAME).exists() and not any(folder.glob("*.mcap")):
        raise UserError(f"folder {folder} holds no bag: neither {metadata.NAME} nor a .mcap file; name a bag's folder")


@contextmanager
def report_incomplete_records(folder: Path) -> Iterator[None]:
    """Raise UserError naming the bag in a folder where reading it raises anything."""
    try:
        yield
    except UserError:
        raise
    except MemoryError:
        raise UserError(f"bag {folder} can't be read: a length in it exceeds its file") from None
    except KeyError as error:
        raise UserError(f"bag {folder} can't be read: {shown(str(error), 200)} is missing or unknown") from None
    except OF_RUBBISH as error:
        raise UserError(f"bag {folder} can't be read: {shown(str(error), 200) or type(error).__name__}") from None


def listed(folder: Path) -> list[Path]:
    """Return the files that a bag's metadata lists, as a reader would open them.

    Raises UserError for another storage, and for files or messages that are compressed beyond the storage's own chunks:
    their unpacked size is unknown.
    """
    said = metadata.read(folder)
    packed = str(said.get("compression_mode") or "none").lower()
    if said["storage_identifier"] != "mcap" or packed != "none":
        raise UserError(
            f"bag {folder} has storage {shown(str(said['storage_identifier']))} and compression {shown(packed)};"
            " expected: mcap and none. `ros2 bag convert` converts it"
        )
    files = [folder / PurePath(str(name)).name for name in said["relative_file_paths"]]
    return [file for file in files if file.is_file()]  # rosbags reports those that are missing


@contextmanager
def opened(folder: Path, of_node: bool = True) -> Iterator[Sequence[Reader | McapReader]]:
    """Yield readers of a bag, the oldest first: one of a whole bag, or one for each file of a bag that was broken off.

    of_node: whether a bag that was broken off must be one of this package. Raises UserError for a bag that can't be
    read.
    """
    check_folder(folder)
    with report_incomplete_records(folder):
        if is_interrupted(folder):
            with _opened(folder, of_node) as readers:
                yield readers
            return
        for file in listed(folder):
            check_lengths(file)
        with Reader(folder) as reader:
            yield [reader]


def messages(folder: Path) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield the messages of a bag that was broken off, in their order.

    Yields topic, stamp (ns) and bytes of every whole message.
    """
    with _opened(folder) as readers:
        for reader in readers:
            yield from reader.messages(reader.connections)


def complete(folder: Path) -> str:
    """Give a bag what it lacks at its end; return a line about it.

    Raises UserError when it is empty, still being recorded, or damaged.
    """
    with ExitStack() as stack, report_incomplete_records(folder):
        for path in folder.glob("*.mcap"):
            if not lock(stack.enter_context(path.open("rb")).fileno()):
                raise UserError(f"bag {folder} is still being recorded; stop that first")
        try:
            duration = _complete(folder)
        except OSError as error:
            return f"bag {folder} was interrupted; it is read as far as possible, but not completed: {error.strerror}"
    return f"bag {folder} was interrupted: {1e-9 * duration:.1f} s of it are recovered"


def _complete(folder: Path) -> int:
    """Rewrite files without an end, and the metadata; return the bag's duration, ns."""
    with _opened(folder) as readers:
        for broken in readers:
            if isinstance(broken, _BrokenOff):
                _rewrite(folder, broken)
    store, files = get_typestore(Stores.ROS2_JAZZY), []
    with _opened(folder) as readers:
        for reader in readers:
            statistics = reader.statistics
            assert statistics is not None
            counts = {topic.topic: statistics.channel_message_counts.get(topic.id, 0) for topic in reader.connections}
            files.append(metadata.File(Path(str(reader.path)).name, statistics.start_time, statistics.end_time, counts))
        topics = [topic._replace(digest=store.hash_rihs01(topic.msgtype)) for topic in readers[0].connections]
        metadata.write(folder, files, topics)
    return files[-1].end - files[0].start


def _rewrite(folder: Path, reader: McapReader) -> None:
    rewritten = folder / REWRITTEN
    shutil.rmtree(rewritten, ignore_errors=True)  # left by a recovery that was broken off, too
    try:
        writer = BagWriter(rewritten)
        writer.open()
        try:
            topics = {topic.topic: Topic(topic.msgtype, metadata.qos_of(topic)) for topic in reader.connections}
            added = writer.add_topics(topics)
            for topic, stamp, raw in reader.messages(reader.connections):
                writer.write(added[topic.topic], stamp, raw)
            writer.close()
        except BaseException:
            writer.abort()
            raise
        (made,) = rewritten.glob("*.mcap")
        made.replace(Path(str(reader.path)))
    finally:
        shutil.rmtree(rewritten, ignore_errors=True)


@contextmanager
def _opened(folder: Path, of_node: bool = True) -> Iterator[list[McapReader]]:
    """Yield readers of a bag's files that hold messages, the oldest first; of_node: refuse bags of others."""
    readers = []
    with ExitStack() as stack:
        for path in folder.glob("*.mcap"):
            for reader in (_Whole(path), _BrokenOff(path)):
                try:
                    reader.open()
                except OF_RUBBISH:  # no end, or not even a beginning
                    continue
                stack.callback(reader.close)
                if reader.statistics is not None and reader.statistics.message_count:
                    readers.append(reader)
                break
        if not readers:
            raise UserError(f"bag {folder} was interrupted before it had any content: delete it")
        if of_node and not any(topic.topic.endswith("/config") for topic in readers[0].connections):
            raise UserError(
                f"bag {folder} was interrupted, and not recorded by a tissue_sim node: use `ros2 bag reindex`"
            )
        yield sorted(readers, key=lambda reader: reader.statistics.start_time if reader.statistics else 0)


class _Whole(McapReader):
    """Reader of a file that has its end."""

    def _open(self) -> None:
        check_lengths(Path(str(self.path)))
        super()._open()


class _BrokenOff(McapReader):
    """Reader of a file up to where it breaks off."""

    def _open(self) -> None:
        assert self.bio is not None
        self.data_start, self.data_end = _whole_records(self.bio)
        self.meta_scan()


def _whole_records(bio: BinaryIO) -> tuple[int, int]:
    """Return where the records after the header begin, and where the last whole one ends; raise ReaderError."""
    size, start, end = bio.seek(0, 2), 0, len(MAGIC)
    for opcode, length, after in _records(bio):
        # After a power cut a file may go on with zeros.
        if opcode in (0, DATA_END) or after > size:
            break
        if opcode == CHUNK:
            try:
                _check_chunk(bio.read(length))
            except OF_RUBBISH:
                break
        if opcode == HEADER:
            start = after
        end = after
    if not start:
        raise ReaderError("no header")
    return start, end


def check_lengths(file: Path) -> None:
    """Check that no record is longer than its file or unpacks to more than it says, which would exhaust memory.

    Raises ReaderError when one does; chunks that don't unpack at all raise one of OF_RUBBISH.
    """
    size = file.stat().st_size
    with file.open("rb") as bio:
        for opcode, length, after in _records(bio):
            if after > size:
                raise ReaderError(f"a record of {length} bytes, in a file of {size}")
            if opcode == CHUNK:
                _check_chunk(bio.read(length))


def _records(bio: BinaryIO) -> Iterator[tuple[int, int, int]]:
    """Yield each record's opcode, its length, and where the next one begins, with the file at the record's content.

    Raises ReaderError for a file that is not MCAP.
    """
    bio.seek(0)
    if bio.read(len(MAGIC)) != MAGIC:
        raise ReaderError("not an MCAP file")
    at = len(MAGIC)
    while len(head := bio.read(9)) == 9:
        opcode, length = struct.unpack("<BQ", head)
        at += 9 + length
        yield opcode, length, at
        bio.seek(at)


def _check_chunk(chunk: bytes) -> None:
    """Raise where a chunk's content isn't what it says, or larger than any chunk; that is never unpacked."""
    _, _, length, crc = struct.unpack_from("<QQQI", chunk)
    stream = BytesIO(chunk)
    stream.seek(28)
    compression = read_string(stream)
    packed = read_sized(stream)
    if length > LARGEST_CHUNK:
        raise ReaderError(f"a chunk of {length} bytes")
    if compression in _UNPACKERS:
        unpacker = _UNPACKERS[compression]()
        packed = unpacker.decompress(packed, max_length=length + 1)
        if not unpacker.eof or unpacker.unused_data:
            raise ReaderError(f"a chunk that doesn't unpack to its stated {length} bytes")
    decompress(packed, "", length, crc)
