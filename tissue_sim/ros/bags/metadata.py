"""A bag's metadata.yaml, and how it is written to the disk."""

from __future__ import annotations

import os
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Literal, NamedTuple

from rosbags.interfaces import Connection, ConnectionExtRosbag2, Qos
from rosbags.rosbag2.metadata import dump_qos_v9
from ruamel.yaml import YAML, YAMLError

from tissue_sim.errors import UserError
from tissue_sim.json_types import JsonObject

DISTRIBUTION = "jazzy"  # whose message definitions a bag holds
VERSION: Literal[9] = 9  # version of the metadata
NAME = "metadata.yaml"


class File(NamedTuple):
    """What one whole file of a bag holds."""

    name: str
    start: int  # ns, of the first message
    end: int  # ns, of the last one
    counts: dict[str, int]  # messages by topic


def information(files: Sequence[File], connections: Sequence[Connection]) -> JsonObject:
    """Return the metadata of files that are one bag, with its topics."""
    files = [file for file in files if file.counts]
    start = min((file.start for file in files), default=0)
    counts = {topic.topic: sum(file.counts.get(topic.topic, 0) for file in files) for topic in connections}
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        **_span(start, max((file.end for file in files), default=0), sum(counts.values())),
        "topics_with_message_count": [_topic(topic, counts[topic.topic]) for topic in connections],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [{"path": f.name, **_span(f.start, f.end, sum(f.counts.values()))} for f in files],
        "custom_data": None,
        "ros_distro": DISTRIBUTION,
    }


def read(folder: Path) -> JsonObject:
    """Return the metadata of the bag in a folder. Raises UserError for a file that holds something else."""
    try:
        said = YAML(typ="safe").load((folder / NAME).read_text(encoding="utf-8"))
    except (YAMLError, UnicodeDecodeError):
        said = None
    found = said.get("rosbag2_bagfile_information") if isinstance(said, dict) else None
    if not isinstance(found, dict):
        raise UserError(f"bag {folder}: {NAME} is damaged; delete it, and a replay makes it anew from the other files")
    return found


def qos_of(topic: Connection) -> list[Qos]:
    """Return the profiles that a topic is offered with."""
    return topic.ext.offered_qos_profiles if isinstance(topic.ext, ConnectionExtRosbag2) else []


def as_yaml(values: object) -> str:
    """Return values as the text of a YAML file."""
    yaml, stream = YAML(typ="safe"), StringIO()
    yaml.default_flow_style = False
    yaml.dump(values, stream)
    return stream.getvalue().strip()


def write(folder: Path, files: Sequence[File], connections: Sequence[Connection]) -> None:
    """Write a bag's metadata.yaml, as a whole or not at all.

    connections: its topics. Raises OSError when it can't be written.
    """
    path = folder / f"{NAME}.tmp"
    with path.open("w", encoding="utf-8") as stream:
        stream.write(as_yaml({"rosbag2_bagfile_information": information(files, connections)}) + "\n")
        stream.flush()
        os.fsync(stream.fileno())
    path.replace(folder / NAME)
    sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Flush a folder's entries to the disk, so that they outlast a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _span(start: int, end: int, count: int) -> JsonObject:
    return {
        "starting_time": {"nanoseconds_since_epoch": start},
        "duration": {"nanoseconds": end - start},
        "message_count": count,
    }


def _topic(topic: Connection, count: int) -> JsonObject:
    topic_metadata = {
        "name": topic.topic,
        "type": topic.msgtype,
        "serialization_format": "cdr",
        "offered_qos_profiles": dump_qos_v9(qos_of(topic)),
        "type_description_hash": topic.digest,
    }
    return {"topic_metadata": topic_metadata, "message_count": count}
