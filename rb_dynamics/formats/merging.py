"""`merge`: several bags as one MCAP file, or a part of one; each message byte for byte.

Merged logs of this package become a bag like any other, with their scenes attached under their names. It is not the log
of a run, and no command takes it for one.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias

from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import Source, open_source
from rb_dynamics.formats.channel_metadata import QOS, is_latched
from rb_dynamics.formats.log_metadata import (
    DAMAGED,
    INTERRUPTED,
    MERGED,
    PART_NS,
    RUN,
    SCENE,
    SIMULATION_TIME,
    TOPICS,
    UNLOGGED,
    in_simulation_time,
    loss,
    missing_pieces,
    next_file,
    part_ns,
    unlogged,
    unlogged_key,
)
from rb_dynamics.formats.mcap_records import McapChannel, Message, Schema
from rb_dynamics.formats.message_definitions import schema_text
from rb_dynamics.formats.message_fields import differ
from rb_dynamics.formats.message_types import COMMAND, DIAGNOSTICS, PLAIN_WRENCH, SCALAR, TRANSFORMS, WRENCH
from rb_dynamics.formats.output_file import OutputFile, require_other
from rb_dynamics.formats.recovery import Copy

# Their messages name what they are about.
_SHARED = (TRANSFORMS, DIAGNOSTICS)

_Numbered: TypeAlias = tuple[int, Message]
"""A message and the number of its source."""

# Bags further apart are of two clocks or two days, s.
_FAR = 86400.0


@dataclass
class Merged:
    """What was written: the number of messages, and remarks for the reader."""

    messages: int = 0
    notes: list[str] = field(default_factory=list)


def merge(paths: Sequence[Path], target: Path, span_ns: tuple[float, float]) -> Merged:
    """Write the messages of the bags whose log times are within `span_ns` to the MCAP file `target`, by log time.

    Fixed transforms and other latched topics are those of the whole bags; of each topic of commands the last message
    before `span_ns` is there too, as it is held then. Topics of one name and type become one; what several bags have
    with the same bytes at the same time, as parts of one do, is there once.
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
        shared = _Shared()
        unknown: dict[str, str] = {}
        begin_ns = end_ns = None
        held = _held(paths, span_ns[0]) if span_ns[0] > -math.inf else []
        for number, message in _part(sources, span_ns, held):
            channel = _defined(message.channel)
            if channel is None:
                unknown[message.channel.topic] = message.channel.type_name
                continue
            known = types.setdefault(channel.topic, channel.schema)
            _require_one_type(target, known, channel)
            if not shared.has(number, message):
                copy.add(message._replace(channel=replace(channel, schema=known)))
                found.messages += 1
            if span_ns[0] <= message.log_time <= span_ns[1]:
                begin_ns, end_ns = message.log_time if begin_ns is None else begin_ns, message.log_time
            ends = spans.setdefault(channel.topic, {})
            first, last = ends.get(number, (message.log_time, message.log_time))
            ends[number] = min(first, message.log_time), max(last, message.log_time)
        for source in sources:
            if lost := loss(source.complete, source.metadata):
                found.notes.append(f"{source.path} {lost}.")
        if not found.messages:
            raise LogError(f"{target}: found no message to write, expected some; give other times, or another bag")
        told = _told(sources)
        if span_ns[0] > -math.inf and begin_ns is not None:
            told[PART_NS] = f"{begin_ns} {end_ns}"
        elif any(part_ns(source.metadata) for source in sources):
            told[PART_NS] = _of_parts(sources, spans, span_ns[1])
        since_ns = min((message.log_time for _, message in held), default=span_ns[0])
        pieces = [(a, b) for a, b in _missing(sources, spans) if since_ns <= b and a <= span_ns[1]]
        missing = {"reason": DAMAGED, "missing_ns": ", ".join(f"{a} {b}" for a, b in pieces)}
        copy.finish((), _scenes(sources), {MERGED: told} | ({INTERRUPTED: missing} if pieces else {}))
    if unknown:
        listed = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(unknown.items()))
        found.notes.append(f"Left out, as the bag does not define their types: {listed}.")
    alone = {topic: ends for topic, ends in spans.items() if types[topic].name not in _SHARED}
    found.notes += [*_doubled(alone, paths), *_apart(spans, paths)]
    return found


def _require_one_type(target: Path, known: Schema, channel: McapChannel) -> None:
    """Refuse a topic of two types.

    Raises:
        LogError: that of `channel` is not the `known` one.
    """
    topic, name = channel.topic, known.name
    if name != channel.schema.name:
        raise LogError(
            f"{target}: topic {topic} is {name} in one bag and {channel.schema.name} in another, expected one type; "
            "leave out one of the bags"
        )
    if known != channel.schema and differ(known, channel.schema):
        raise LogError(
            f"{target}: topic {topic} is {name} of other fields in one bag than in another, expected one definition; "
            "leave out one of the bags"
        )


def _told(sources: Sequence[Source]) -> dict[str, str]:
    """Return what a bag says of those of which it is made."""
    told = {"sources": ", ".join(source.path.name for source in sources)}
    if all(in_simulation_time(source.metadata) for source in sources):
        told |= SIMULATION_TIME
    for source in sources:
        topic = source.metadata.get(TOPICS, {}).get("pose", "/pose")
        if RUN in source.metadata and (effects := unlogged(source.metadata, topic)):
            told[unlogged_key(topic)] = effects
        told |= {key: text for key, text in source.metadata.get(MERGED, {}).items() if key.startswith(UNLOGGED)}
    return told


def _of_parts(sources: Sequence[Source], spans: Mapping[str, Mapping[int, tuple[int, int]]], until_ns: float) -> str:
    """Return first and last log time of bags of which some are parts, without what these hold from before."""
    logged: dict[int, list[int]] = {}
    for each in spans.values():
        for number, ends in each.items():
            logged.setdefault(number, []).extend(ends)
    found = [part_ns(sources[number].metadata) or (min(times), max(times)) for number, times in logged.items()]
    return f"{min(begin for begin, _ in found)} {int(min(until_ns, max(end for _, end in found)))}"


def _by_log_time(sources: Sequence[Source]) -> Iterator[_Numbered]:
    """Yield the messages of all, each with the number of its source; those of one source in its order."""

    def numbered(number: int, source: Source) -> Iterator[_Numbered]:
        for message in source.messages():
            yield number, message

    streams = [numbered(number, source) for number, source in enumerate(sources)]
    return heapq.merge(*streams, key=lambda each: each[1].log_time)


class _Shared:
    """Tells which messages, in the order of their log times, an earlier bag has as well: parts have what they hold."""

    def __init__(self) -> None:
        self._time_ns = -1
        self._written: Counter[tuple[str, bytes]] = Counter()
        self._seen: Counter[tuple[int, tuple[str, bytes]]] = Counter()

    def has(self, number: int, message: Message) -> bool:
        """Return whether a bag of another number had the same bytes on the same topic at the same time as often."""
        if message.log_time != self._time_ns:
            self._time_ns = message.log_time
            self._written.clear()
            self._seen.clear()
        what = message.channel.topic, message.data
        self._seen[number, what] += 1
        if self._seen[number, what] <= self._written[what]:
            return True
        self._written[what] += 1
        return False


def _part(sources: Sequence[Source], span_ns: tuple[float, float], held: Sequence[_Numbered]) -> Iterator[_Numbered]:
    """Yield the messages in `span_ns`, and before it, by log time, those that hold in it: `held`, and latched ones."""
    before: list[_Numbered] | None = []
    for number, message in _by_log_time(sources):
        within = span_ns[0] <= message.log_time <= span_ns[1]
        if within and before is not None:
            yield from sorted([*before, *held], key=lambda each: each[1].log_time)
            before = None
        if within or (before is None and _latched(message.channel)):
            yield number, message
        elif before is not None and _latched(message.channel):
            before.append((number, message))
    yield from before or ()


def _held(paths: Sequence[Path], begin_ns: float) -> list[_Numbered]:
    """Return the last message before `begin_ns` of each topic of commands, by log time: it is held until the next.

    Where the next stamp is earlier, another run has begun, in which it is not held.
    """
    found: list[_Numbered] = []
    for number, path in enumerate(paths):
        last: dict[str, Message] = {}
        following: dict[str, Message] = {}
        for block in open_source(path).blocks():
            if _commands(block.channel) and not _latched(block.channel):
                for message in block.messages():
                    if message.log_time < begin_ns:
                        last[block.channel.topic] = message
                    else:
                        following.setdefault(block.channel.topic, message)
        found += (
            (number, message)
            for topic, message in last.items()
            if topic not in following or _stamp(message) <= _stamp(following[topic])
        )
    return sorted(found, key=lambda each: each[1].log_time)


def _commands(channel: McapChannel) -> bool:
    actuates = channel.type_name == SCALAR and channel.topic.endswith(COMMAND)
    return actuates or channel.type_name in (WRENCH, PLAIN_WRENCH)


def _stamp(message: Message) -> int:
    """Return the stamp, ns; 0 where there is none."""
    try:
        return int(cdr.decode(WRENCH, message.data)[0]) if message.channel.type_name == WRENCH else 0
    except LogError:
        return 0


def _missing(
    sources: Sequence[Source], spans: Mapping[str, Mapping[int, tuple[int, int]]]
) -> Iterator[tuple[int, int]]:
    """Yield first and last log time of each piece that a source lacks, from where it was cut off to the end of all."""
    ends: dict[int, int] = {}
    for each in spans.values():
        for number, (_, last) in each.items():
            ends[number] = max(last, ends.get(number, last))
    for number, source in enumerate(sources):
        yield from missing_pieces(source.metadata)
        reason = source.metadata.get(INTERRUPTED, {}).get("reason", DAMAGED)
        if number in ends and (not source.complete or reason != DAMAGED or next_file(source.metadata)):
            yield ends[number], max(ends.values())


def _latched(channel: McapChannel) -> bool:
    return is_latched(channel.topic, channel.metadata.get(QOS, ""))


def _scenes(sources: Sequence[Source]) -> dict[str, bytes]:
    """Return the scenes of logs of this package, by the names under which they are attached."""
    found: dict[str, bytes] = {}
    for source in sources:
        if MERGED in source.metadata:
            found |= {name: text for name, text in source.attachments.items() if name.endswith(f".{SCENE}")}
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
