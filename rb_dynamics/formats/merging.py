"""`merge`: several bags as one MCAP file, or a part of one; each message byte for byte.

Merged logs of this package become a bag like any other, with their scenes attached under their names. It is not the log
of a run, and no command takes it for one.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from rb_dynamics.errors import LogError
from rb_dynamics.formats.bag_source import Source, open_source
from rb_dynamics.formats.channel_metadata import QOS, is_latched
from rb_dynamics.formats.log_metadata import (
    MERGED,
    RUN,
    SCENE,
    SIMULATION_TIME,
    in_simulation_time,
    loss,
)
from rb_dynamics.formats.mcap_records import McapChannel, Message, Schema
from rb_dynamics.formats.message_definitions import schema_text
from rb_dynamics.formats.message_fields import differ
from rb_dynamics.formats.message_types import DIAGNOSTICS, TRANSFORMS
from rb_dynamics.formats.output_file import OutputFile, require_other
from rb_dynamics.formats.recovery import Copy

# Their messages name what they are about.
_SHARED = (TRANSFORMS, DIAGNOSTICS)

# Bags further apart are of two clocks or two days, s.
_FAR = 86400.0


@dataclass
class Merged:
    """What was written: the number of messages, and remarks for the reader."""

    messages: int = 0
    notes: list[str] = field(default_factory=list)


def merge(paths: Sequence[Path], target: Path, span_ns: tuple[float, float]) -> Merged:
    """Write the messages of the bags whose log times are within `span_ns` to the MCAP file `target`, by log time.

    Fixed transforms and other latched topics are those of the whole bags. Topics of one name and type become one.
    Topics without a definition of their type are left out, since nothing could read it.

    Raises:
        LogError: a bag cannot be read, a topic is of two types, nothing is left, or `target` is one of the bags or
            cannot be written.
    """
    require_other(target, *paths)
    sources = [open_source(path) for path in paths]
    found, spans = Merged(), dict[str, dict[int, tuple[int, int]]]()
    with OutputFile.whole(target) as file:
        copy = Copy(file)
        types: dict[str, Schema] = {}
        unknown: dict[str, str] = {}
        for number, message in _by_log_time(sources):
            if not (_holds(message.channel) or span_ns[0] <= message.log_time <= span_ns[1]):
                continue
            channel = _defined(message.channel)
            if channel is None:
                unknown[message.channel.topic] = message.channel.type_name
                continue
            known = types.setdefault(channel.topic, channel.schema)
            if known.name != channel.schema.name:
                raise LogError(
                    f"{target}: topic {channel.topic} is {known.name} in one bag and {channel.schema.name} in another, "
                    "expected one type; leave out one of the bags"
                )
            if known != channel.schema and differ(known, channel.schema):
                raise LogError(
                    f"{target}: topic {channel.topic} is {known.name} of other fields in one bag than in another, "
                    "expected one definition; leave out one of the bags"
                )
            copy.add(message._replace(channel=replace(channel, schema=known)))
            found.messages += 1
            ends = spans.setdefault(channel.topic, {})
            first, last = ends.get(number, (message.log_time, message.log_time))
            ends[number] = min(first, message.log_time), max(last, message.log_time)
        for source in sources:
            if lost := loss(source.complete, source.metadata):
                found.notes.append(f"{source.path} {lost}.")
        if not found.messages:
            raise LogError(f"{target}: found no message to write, expected some; give other times, or another bag")
        told = {"sources": ", ".join(source.path.name for source in sources)}
        if all(in_simulation_time(source.metadata) for source in sources):
            told |= SIMULATION_TIME
        copy.finish((), _scenes(sources), {MERGED: told})
    if unknown:
        listed = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(unknown.items()))
        found.notes.append(f"Left out, as the bag does not define their types: {listed}.")
    alone = {topic: ends for topic, ends in spans.items() if types[topic].name not in _SHARED}
    found.notes += [*_doubled(alone, paths), *_apart(spans, paths)]
    return found


def _by_log_time(sources: Sequence[Source]) -> Iterator[tuple[int, Message]]:
    """Yield the messages of all, each with the number of its source; those of one source in its order."""

    def numbered(number: int, source: Source) -> Iterator[tuple[int, Message]]:
        for message in source.messages():
            yield number, message

    streams = [numbered(number, source) for number, source in enumerate(sources)]
    return heapq.merge(*streams, key=lambda each: each[1].log_time)


def _holds(channel: McapChannel) -> bool:
    return is_latched(channel.topic, channel.metadata.get(QOS, ""))


def _scenes(sources: Sequence[Source]) -> dict[str, bytes]:
    """Return the scenes of logs of this package, by the names under which they are attached."""
    found: dict[str, bytes] = {}
    for source in sources:
        if RUN in source.metadata and SCENE in source.attachments:
            stem = source.path.stem
            names = (f"{stem}{end}.{SCENE}" for end in ("", *(f".{k}" for k in range(2, len(found) + 2))))
            name = next(name for name in names if name not in found)
            found[name] = source.attachments[SCENE]
    return found


def _defined(channel: McapChannel) -> McapChannel | None:
    """Return the channel with the definition of its type; None if nothing has it."""
    if channel.schema.data:
        return channel
    try:
        text = schema_text(channel.type_name)
    except KeyError:
        return None
    return replace(channel, schema=Schema(channel.type_name, "ros2msg", text.encode()))


def _doubled(spans: Mapping[str, Mapping[int, tuple[int, int]]], paths: Sequence[Path]) -> Iterator[str]:
    """Yield a remark for each topic that two bags have at one time: two bodies may be on it."""
    for topic, ends in sorted(spans.items()):
        for (one, (begin, end)), (other, (first, last)) in itertools.combinations(ends.items(), 2):
            if begin < last and first < end:
                yield f"{topic} is in {paths[one]} and {paths[other]} at the same time: both are on one topic now."


def _apart(spans: Mapping[str, Mapping[int, tuple[int, int]]], paths: Sequence[Path]) -> Iterator[str]:
    """Yield a remark for each two bags whose log times are far apart."""
    wholes: dict[int, tuple[int, int]] = {}
    for ends in spans.values():
        for number, (begin, end) in ends.items():
            first, last = wholes.get(number, (begin, end))
            wholes[number] = min(first, begin), max(last, end)
    for (one, (begin, end)), (other, (first, last)) in itertools.combinations(sorted(wholes.items()), 2):
        far = max(first - end, begin - last) * 1e-9
        if far > _FAR:
            yield (
                f"{paths[one]} and {paths[other]} are {far:.6g} s apart by their log times: they were logged by two "
                "clocks, or on other days; nothing here puts them together in time."
            )
