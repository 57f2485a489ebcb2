"""Logs with edited messages, metadata or scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from rb_dynamics.formats.mcap_records import McapFile, Message
from rb_dynamics.formats.mcap_writer import McapWriter
from rb_dynamics.formats.output_file import OutputFile


def edited(
    source: Path,
    target: Path,
    edit: Callable[[Message], Message | None] = lambda message: message,
    facts: Mapping[str, str] | None = None,
    scene: bytes | None = None,
    rearrange: Callable[[list[Message]], object] = lambda messages: None,
    twice: Mapping[str, Mapping[str, str]] | None = None,
    types: Mapping[str, str] | None = None,
) -> Path:
    """Copy a log through `edit`, which changes a message or leaves it out, with other `facts` and another `scene`.

    A fact is named by its key, in every record, or by record and key; `rearrange` changes the list of messages, and
    records of `twice` are written before those of their names, with other facts. `types` are those that topics are
    said to have.
    """
    old = McapFile(source)
    messages = list(old.messages())
    rearrange(messages)
    file = OutputFile(target)
    writer = McapWriter(file, "test")
    writer.begin()
    numbers = {}
    for channel in old.channels.values():
        schema = channel.schema._replace(name=(types or {}).get(channel.topic, channel.type_name))
        numbers[channel.topic] = writer.add_channel(replace(channel, schema=schema))
    for message in filter(None, map(edit, messages)):
        writer.add_messages((numbers[message.channel.topic],), (message.data,), message.log_time, message.publish_time)
    for name, data in old.attachments.items():
        writer.add_attachment(name, "", scene or data)
    for name, said in old.metadata.items():
        other = {key: (facts or {}).get(f"{name}.{key}", (facts or {}).get(key, value)) for key, value in said.items()}
        if name in (twice or {}):
            writer.add_metadata(name, {**said, **(twice or {})[name]})
        writer.add_metadata(name, other)
    writer.finish()
    file.close()
    return target
