"""`metadata.yaml`: what rosbag2 needs to know about a folder of MCAP files before it plays them."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from rb_dynamics.errors import LogError, SceneError
from rb_dynamics.formats.channel_metadata import QOS
from rb_dynamics.formats.mcap_records import McapChannel
from rb_dynamics.formats.yaml.document import load

METADATA_FILE = "metadata.yaml"


@dataclass
class BagFile:
    """One file of a bag.

    Attributes:
        name: of the file, in its folder.
        start_ns, end_ns: first and last log time; 0 if there are no messages.
        counts: messages by topic.
    """

    name: str
    start_ns: int = 0
    end_ns: int = 0
    counts: Counter[str] = field(default_factory=Counter)


def write_metadata(folder: Path, channels: Sequence[McapChannel], files: Sequence[BagFile]) -> Path:
    """Write `metadata.yaml`, version 9 as in Jazzy, for the files of a bag; returns its path.

    Raises:
        LogError: it cannot be written; then there is none, as part of one would hide the files.
    """
    counts: Counter[str] = sum((file.counts for file in files), Counter())
    spoken = [file for file in files if file.counts]
    start_ns = min((file.start_ns for file in spoken), default=0)
    end_ns = max((file.end_ns for file in spoken), default=0)
    facts = {
        "version": 9,
        "storage_identifier": "mcap",
        **_span(start_ns, end_ns, counts.total()),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": channel.topic,
                    "type": channel.type_name,
                    "serialization_format": channel.encoding,
                    QOS: offered_qos(channel),
                    "type_description_hash": channel.metadata.get("topic_type_hash", ""),
                },
                "message_count": counts[channel.topic],
            }
            for channel in channels
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [{"path": file.name, **_span(file.start_ns, file.end_ns, file.counts.total())} for file in files],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    path = folder / METADATA_FILE
    text = yaml.safe_dump({"rosbag2_bagfile_information": facts}, sort_keys=False)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        with contextlib.suppress(OSError):
            path.unlink()
        raise LogError(
            f"cannot write {path}: {error.strerror or error}; free space, the .mcap files beside it are whole"
        ) from error
    return path


def offered_qos(channel: McapChannel) -> list[Any]:
    """Return the QoS profiles of a topic as its writer recorded them; none if that is not a list."""
    try:
        found = load(channel.metadata.get(QOS, ""), channel.topic, "list of QoS profiles")
    except SceneError:
        return []
    return found if isinstance(found, list) else []


def _span(start_ns: int, end_ns: int, count: int) -> dict[str, Any]:
    return {
        "duration": {"nanoseconds": end_ns - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": count,
    }
