"""Bags of single rows, written with the mcap package, for tests of readers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from rb_dynamics.formats import cdr
from rb_dynamics.formats.mcap_records import McapChannel, Message, MessageBlock, Schema, in_blocks
from rb_dynamics.formats.message_definitions import schema_text
from rb_dynamics.formats.topic_messages import Topic

STAMPED = "geometry_msgs/msg/WrenchStamped"

# Topic, type, log time, data.
Row = tuple[str, str, int, bytes]


def stamped(stamp_ns: int, first: float, frame: str = "body") -> bytes:
    return cdr.encode(STAMPED, stamp_ns, frame, (first, 0.0, 0.0, 0.0, 0.0, 0.0))


def add(topic: Topic, log_time: int, data: bytes) -> None:
    """Add one message to a topic of a bag in memory."""
    channel = McapChannel(topic.name, Schema(topic.type_name), "cdr", {})
    for block in in_blocks([Message(channel, log_time, log_time, data)]):
        topic.take(block)


def add_stamped(
    topic: Topic, log_times: Any, stamps: Any, rows: Any, encode: Callable[[int, list[float]], bytes]
) -> None:
    """Add a message for each row, of a type that ends with its numbers, in one block as a reader has it.

    `encode` returns the message of a stamp and a row.
    """
    found = [encode(int(stamps[k]), rows[k].tolist()) for k in (0, -1)]
    data = np.tile(np.frombuffer(found[0], np.uint8), (len(rows), 1))
    data[:, 4:12] = np.column_stack(np.divmod(stamps, 10**9)).astype("<i4").view(np.uint8)
    data[:, -8 * rows.shape[1] :] = np.ascontiguousarray(rows, "<f8").view(np.uint8)
    assert data[-1].tobytes() == found[-1]
    ends = data.shape[1] * np.arange(1, len(rows) + 1)
    channel = McapChannel(topic.name, Schema(topic.type_name), "cdr", {})
    topic.take(MessageBlock(channel, np.array(log_times, np.int64), data.ravel(), ends - data.shape[1], ends))


def write_rows(path: Path, rows: list[Row], encoding: str = "cdr", **options: Any) -> Path:
    """Write rows to a file, as they are."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start("ros2", "test")
        channels: dict[str, int] = {}
        for topic, type_name, log_time, data in rows:
            if topic not in channels:
                text = schema_text(type_name).encode() if type_name in cdr.LAYOUTS else b""
                schema = writer.register_schema(type_name, "ros2msg", text)
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], log_time, data, log_time)
        writer.finish()
    return path
