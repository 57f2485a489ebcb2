"""`recover`: make a complete MCAP file, with index and statistics, from one that was cut off or damaged.

Copies what can be read, byte for byte, and reports what could not. The damaged file stays as it is.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from rb_dynamics.errors import LogError
from rb_dynamics.formats.bag_source import absent_before, absent_between, bag_facts, in_order, joined_losses
from rb_dynamics.formats.log_metadata import CUT_OFF, DAMAGED, INTERRUPTED, MISSING_FILES, UNPLACED, next_file, version
from rb_dynamics.formats.mcap_records import END_OF_TIME, McapChannel, McapFile, Message, Schema, instead_of_recover
from rb_dynamics.formats.mcap_writer import McapWriter
from rb_dynamics.formats.output_file import OutputFile, require_other
from rb_dynamics.formats.rosbag2_metadata import BagFile, write_metadata

WHOLE = "whole"


@dataclass
class Recovered:
    """What was saved of one file.

    Attributes:
        file: name, times and messages of the new file.
        state: of the old file: "whole", or what it was: "cut off", "damaged" or "cut off and damaged".
        channels: of the new file.
        damage: what could not be read, one line for each piece.
        missing: first and last log time (ns) of such a piece, where it is known.
        unplaced: something may be missing of which no time is known.
        unchecked: messages have no checksum, so that changed bytes in them would not be seen.
        next_file: name of the file in which the old one says that it continues, or after the last the metadata of the
            bag; "" if they do not say so.
        absent_before: names of files of the bag between the one before and this one that are not there.
    """

    file: BagFile
    state: str
    channels: list[McapChannel]
    damage: list[str]
    missing: list[tuple[int, int]]
    unplaced: bool = False
    unchecked: bool = False
    next_file: str = ""
    absent_before: Sequence[str] = ()

    @property
    def complete(self) -> bool:
        """Whether nothing was lost."""
        return self.state == WHOLE


def recover(source: Path, target: Path) -> list[Recovered]:
    """Copy what can be read of the MCAP file `source` to `target`, or of all in a folder to a rosbag2 folder.

    Where something was lost, the copy has metadata `rb_dynamics.interrupted` with the time of the last message and the
    times of what is missing within.

    Raises:
        LogError: `source` is no MCAP file or has no whole message, or `target` is `source`, holds files of another bag
            or cannot be written.
    """
    require_other(target, source)
    if not source.is_dir():
        if not _says_something(source, part=False):
            raise _nothing(source)
        return [_recover_file(McapFile(source, salvage=True), target)]
    files = in_order(source)
    if not files:
        raise _no_files(source)
    earlier = _earlier(target, files)
    if not any(map(_says_something, files)):
        raise _nothing(source)
    named, begin_ns = _named_but_absent(source)

    def salvage(file: Path, types: Mapping[str, Schema] | None = None) -> Recovered:
        # The metadata of the copy name what is there; only between two files their names tell that one is not.
        first, last = named.get(file, []) * (file is files[0]), named.get(None, []) * (file is files[-1])
        absent = _Absent(first, last, begin_ns)
        return _recover_file(McapFile(file, salvage=True, part=True), target / file.name, types, absent)

    saved = [salvage(file) for file in files]
    # Which of its types a file has lost is known once it is read, and the other files may follow it.
    types = {each.topic: each.schema for one in saved for each in one.channels if _is_whole(each.schema)}
    for number, file in enumerate(files):
        if any(each.topic in types and not _is_whole(each.schema) for each in saved[number].channels):
            saved[number] = salvage(file, types)
    for number, (file, each) in enumerate(zip(files, saved, strict=True)):
        each.absent_before = named.get(file, [])
        if number and not each.absent_before:
            each.absent_before = absent_between(files[number - 1], file, saved[number - 1].next_file, files)
    saved[-1].next_file = saved[-1].next_file or next(iter(named.get(None, ())), "")
    channels = {channel.topic: channel for each in saved for channel in each.channels}
    for old in earlier:
        old.unlink()
    write_metadata(target, list(channels.values()), [each.file for each in saved])
    return saved


def _no_files(source: Path) -> LogError:
    why = "; give a log, or a folder of them"
    if any(source.glob("*.mcap.zstd")):
        why = f"; unpack its files first with zstd -d {source}/*.mcap.zstd"
    if tables := sorted(source.glob("*.db3")):
        why = instead_of_recover(tables[0])
    return LogError(f"{source} has no .mcap files in it{why}")


def _earlier(target: Path, files: Sequence[Path]) -> list[Path]:
    """Return the files of an earlier bag in `target`, beside those of the names of `files`, which the copy replaces.

    Raises:
        LogError: its metadata do not name a file there.
    """
    others = {file.name for file in target.glob("*.mcap")} - {file.name for file in files}
    named: set[str] = set()
    with contextlib.suppress(OSError, LogError):
        named = {file.name for file in bag_facts(target).files}
    if unknown := sorted(others - named):
        raise LogError(
            f"cannot write {target}: it holds {', '.join(unknown[:5])}, which would look like a part of the copy; give "
            "another folder"
        )
    return [target / name for name in others]


def _named_but_absent(folder: Path) -> tuple[dict[Path | None, list[str]], int | None]:
    """Return the names of files that the metadata of a bag name and that are not there, by the next one that is.

    Beside them stands the first log time of the bag, ns; None if nothing says it.
    """
    try:
        facts = bag_facts(folder)
    except (FileNotFoundError, LogError):
        return {}, None
    return absent_before(facts.files), min(facts.begins_ns.values(), default=None)


def _says_something(path: Path, part: bool = True) -> bool:
    """Return whether there is a message in a file, or its writer finished it without one."""
    old = McapFile(path, salvage=True, part=part)
    return any(True for _ in old.messages()) or (old.complete and not old.damage)


def _nothing(source: Path) -> LogError:
    return LogError(
        f"found no whole message in {source}, expected at least one before it was cut off or damaged; record it again"
    )


def _is_whole(schema: Schema) -> bool:
    """Return whether a type has its name and a definition that can be read."""
    try:
        str(schema.data, "utf-8")
    except UnicodeDecodeError:
        return False
    return bool(schema.name)


class _Absent(NamedTuple):
    """Names of files of a bag that are missing before its first one and behind its last; when it begins, ns."""

    before: Sequence[str] = ()
    behind: Sequence[str] = ()
    begin_ns: int | None = None

    def facts(self, start_ns: int) -> dict[str, str]:
        """Return what is to be told of it in that first or last file, of which `start_ns` is the first log time."""
        if not self.before and not self.behind:
            return {}
        names = ", ".join([*self.before, *self.behind])
        piece = UNPLACED if self.begin_ns is None else f"{self.begin_ns} {start_ns}"
        reason = {"reason": DAMAGED, "missing_ns": piece} if self.before else {"reason": CUT_OFF}
        return reason | {MISSING_FILES: names}


def _recover_file(
    old: McapFile, target: Path, types: Mapping[str, Schema] | None = None, absent: _Absent | None = None
) -> Recovered:
    """Copy one file; `types`: those of the other files of its bag by topic, for one that it has lost."""
    completed = _Types(types or {})
    messages = completed.typed(old.messages())
    # A file that is not MCAP at all is noticed before the new one is begun.
    first = list(itertools.islice(messages, 1))
    facts = BagFile(target.name, 2**63)
    order = _Order()
    with OutputFile.whole(target) as file:
        copy = Copy(file)
        for message in itertools.chain(first, messages):
            copy.add(message)
            order.add(message.log_time, old.holes, old.unchecked)
            facts.counts[message.channel.topic] += 1
            facts.start_ns = min(facts.start_ns, message.log_time)
            facts.end_ns = max(facts.end_ns, message.log_time)
        order.place(old)
        old.damage += [f"{old.path} lost the type of {topic}, which other files have" for topic in completed.topics]
        facts.start_ns = min(facts.start_ns, facts.end_ns)
        if not old.complete or old.damage:
            found = [CUT_OFF] * (not old.complete) + [DAMAGED] * bool(old.damage)
            missing = [f"{begin_ns} {end_ns}" for begin_ns, end_ns in old.missing] + [UNPLACED] * old.unplaced
            told = {
                "reason": " and ".join(found),
                "last_message_ns": str(facts.end_ns),
                "missing_ns": ", ".join(missing),
            }
            # A copy that is damaged in its turn lacks what the first file lacked, too.
            old.metadata[INTERRUPTED] = joined_losses(old.metadata.get(INTERRUPTED, {}), told)
        state = old.metadata.get(INTERRUPTED, {"reason": WHOLE}).get("reason", CUT_OFF)
        if absent is not None and (more := absent.facts(facts.start_ns)):
            old.metadata[INTERRUPTED] = joined_losses(old.metadata.get(INTERRUPTED, {}), more)
        # What a damaged summary alone says of channels is copied only where it gives messages their topic.
        declared = old.channels.items()
        kept = [each for number, each in declared if number not in old.doubtful or each.topic in facts.counts]
        channels = [completed.channel(each) for each in kept]
        copy.finish(channels, old.attachments, old.metadata)
    lost = old.damage, old.missing, old.unplaced
    return Recovered(facts, state, channels, *lost, old.unchecked, next_file(old.metadata))


class _Types:
    """Gives channels whose type is lost that of other files of the bag."""

    def __init__(self, known: Mapping[str, Schema]) -> None:
        self._known = known
        # One channel for each in the file, as many messages share it.
        self._channels: dict[int, tuple[McapChannel, McapChannel]] = {}
        self.topics: dict[str, None] = {}

    def typed(self, messages: Iterable[Message]) -> Iterator[Message]:
        """Yield messages, of channels with a type."""
        if not self._known:
            return iter(messages)
        return (each._replace(channel=self.channel(each.channel)) for each in messages)

    def channel(self, old: McapChannel) -> McapChannel:
        """Return a channel, with a type."""
        if old.topic not in self._known or _is_whole(old.schema):
            return old
        self.topics[old.topic] = None
        return self._channels.setdefault(id(old), (old, replace(old, schema=self._known[old.topic])))[1]


class _Order:
    """The log times of the messages of a file with holes, to bound the times of what stood in these."""

    def __init__(self) -> None:
        # How far a message is at most behind one that stands before it.
        self._late_ns = 0
        self._holes = 0
        # The latest time so far, and without the last message.
        self._high_ns: int | None = None
        self._before_last_ns: int | None = None
        # Of each hole the latest time before it, and the earliest between it and the next.
        self._around_ns: list[tuple[int | None, int]] = []

    def add(self, time_ns: int, holes: int, unchecked: bool) -> None:
        """Note the next message, which stands behind so many holes; `unchecked`: bytes of those before may differ."""
        if holes > self._holes:
            # The record before a hole may be what lost bytes: then its time is another.
            self._around_ns.append((self._before_last_ns if unchecked else self._high_ns, time_ns))
        elif self._around_ns:
            before_ns, after_ns = self._around_ns[-1]
            self._around_ns[-1] = before_ns, min(after_ns, time_ns)
        self._holes, self._before_last_ns = holes, self._high_ns
        self._high_ns = max(time_ns, time_ns if self._high_ns is None else self._high_ns)
        self._late_ns = max(self._late_ns, self._high_ns - time_ns)

    def place(self, old: McapFile) -> None:
        """Complete the times of what is missing of a file that was read to its end.

        Messages stand in the order in which they came, which need not be that of their times: what is lost is taken to
        be up to twice as late as what is there.
        """
        late_ns = 2 * self._late_ns
        missing = old.lost_chunks()
        if missing is None:
            missing, after_ns = old.missing, END_OF_TIME
            old.unplaced |= old.holes > self._holes
            for before_ns, here_ns in reversed(self._around_ns):
                after_ns = min(after_ns, here_ns)
                if before_ns is None:
                    old.unplaced = True
                else:
                    begin_ns, end_ns = before_ns - late_ns, after_ns + late_ns
                    missing.append((max(begin_ns, 0), min(end_ns, END_OF_TIME - 1)))
        if late_ns and self._high_ns is not None and not old.complete:
            # So may those in the end that was cut off.
            missing.append((max(self._high_ns - late_ns, 0), self._high_ns))
        old.missing = _joined(missing)


def _joined(spans_ns: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return spans of time in order, those that overlap as one."""
    joined: list[tuple[int, int]] = []
    for begin_ns, end_ns in sorted(spans_ns):
        if joined and begin_ns <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(joined[-1][1], end_ns)
        else:
            joined.append((begin_ns, end_ns))
    return joined


class Copy:
    """Writes the content of files to another, in the same order."""

    def __init__(self, file: OutputFile) -> None:
        # Not named as a log of this package: its log times may go back, as those of the files do.
        self._writer = McapWriter(file, f"copied by rb_dynamics {version()}")
        self._channels: dict[tuple[str, Schema], int] = {}
        self._writer.begin()

    def add(self, message: Message) -> None:
        """Copy one message.

        Raises:
            LogError: it was logged before time 0, as SQLite allows.
        """
        if message.log_time < 0:
            raise LogError(
                f"a message on {message.channel.topic} has the log time {message.log_time} ns, expected 0 or more, as "
                "MCAP has no earlier times; leave it out with --from SECONDS, counted from the start of the motion"
            )
        channel = self._declared(message.channel)
        times = message.log_time, message.publish_time
        self._writer.add_messages((channel,), (message.data,), *times, message.sequence)

    def finish(
        self,
        channels: Iterable[McapChannel],
        attachments: Mapping[str, bytes],
        metadata: Mapping[str, Mapping[str, str]],
    ) -> None:
        """Copy what is not a message, and write the index."""
        for channel in channels:
            self._declared(channel)
        for name, data in attachments.items():
            self._writer.add_attachment(name, "application/yaml" if name.endswith(".yaml") else "", data)
        for name, facts in metadata.items():
            self._writer.add_metadata(name, facts)
        self._writer.finish()

    def _declared(self, channel: McapChannel) -> int:
        """Return the number of a channel in the new file; a topic with several publishers has one."""
        key = (channel.topic, channel.schema)
        if key not in self._channels:
            self._channels[key] = self._writer.add_channel(channel)
        return self._channels[key]
