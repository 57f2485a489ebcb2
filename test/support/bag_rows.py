"""Bags of single rows, written with the mcap package, for tests of readers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rb_dynamics.formats import cdr
from rb_dynamics.formats.mcap_records import McapChannel, Message, Schema, in_blocks
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
