"""The MCAP container: schemas, channels, messages, metadata and attachments of a file, in the order of the file.

A reader of our own, because that of the package mcap refuses a file without an end or with one damaged chunk, and
allocates whatever a length in the file says. This one reads front to back without the index, so that it gets everything
from a file that was never finished, and checks every length before it allocates. It never looks inside a message.

Format: the MCAP specification, version 0. A record is one byte of opcode, the length of its content, the content.
"""

from __future__ import annotations

import contextlib
import enum
import os
import stat
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import BinaryIO, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.errors import LogError, MissingExtraError
from rb_dynamics.formats.log_metadata import with_earlier
from rb_dynamics.formats.read_ahead import one_ahead

# One record, and one chunk after decompression, must fit: recorders write chunks of 1 to 4 MB.
MAX_RECORD_BYTES = 256 * 2**20
# What a file may hold, so that one of kilobytes does not keep its reader busy for minutes: the most repetitive
# recording (one number that never changes) still takes a byte a message, and the index of most writers 16 more.
_FREE_RECORDS, _RECORDS_PER_BYTE = 100_000, 2

MAGIC = b"\x89MCAP0\r\n"

END_OF_TIME = 2**63


class Opcode(enum.IntEnum):
    """Kinds of records."""

    HEADER = 1
    FOOTER = 2
    SCHEMA = 3
    CHANNEL = 4
    MESSAGE = 5
    CHUNK = 6
    MESSAGE_INDEX = 7
    CHUNK_INDEX = 8
    ATTACHMENT = 9
    ATTACHMENT_INDEX = 10
    STATISTICS = 11
    METADATA = 12
    METADATA_INDEX = 13
    SUMMARY_OFFSET = 14
    DATA_END = 15


# What is read front to back has no use for an index.
_NEEDED = frozenset(Opcode) - {
    *(Opcode.HEADER, Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX),
    Opcode.SUMMARY_OFFSET,
}
_IN_CHUNKS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
# Stands for the opcode of a chunk that is cut off by the end of the file; no record has it.
_CUT_CHUNK = -1
# Likewise of what is left out to salvage, and does not say of when it was.
_HOLE = -2
_GIT_LFS = b"version https://git-lfs.github.com/spec/"
_ROS_1, _SQLITE, _PARQUET = b"#ROSBAG V", b"SQLite format 3\0", b"PAR1"
_RECORD = struct.Struct("<BQ")
# Of a chunk: its times, what is in it in bytes and their checksum, the length of the compression's name.
_CHUNK_HEAD = struct.Struct("<QQQII")
# The longest name of a compression, and the size of the bytes after it.
_CHUNK_HEAD_BYTES = _CHUNK_HEAD.size + 4 + 8
# Where the summary begins, and the part of it that says where everything is; a checksum.
_FOOTER = struct.Struct("<QQI")
_DATA_END_HEAD = _RECORD.pack(Opcode.DATA_END, 4)
# Of an attachment: its two times, the lengths of its name, type and data, its checksum.
_ATTACHMENT_TIMES_BYTES = 16
_TEXT_LENGTH, _DATA_LENGTH, _CHECKSUM = struct.Struct("<I"), struct.Struct("<Q"), struct.Struct("<I")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_MESSAGE = int(Opcode.MESSAGE)
_RECORDS = np.dtype([("opcode", "u1"), ("length", "<u8")])
# Of a message, with the record it is in.
_HEADS = np.dtype(
    [
        *(("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4")),
        *(("log_time", "<u8"), ("publish_time", "<u8")),
    ]
)
# So many records one after the other are no accident.
_ROW = 4
# The number of messages put into blocks together, where they come one by one.
_BLOCK_MESSAGES, _BLOCK_BYTES = 1024, 2**20
# Chunks are processed together up to this size; as much of the next ones is read and unpacked meanwhile.
_TOGETHER_BYTES = 2**20
# So many layouts of them are kept; those of large chunks would take much memory.
_LAYOUTS = 4
# The records of the index behind each chunk are short, and read together.
_BUFFER_BYTES = 2**18

Places: TypeAlias = NDArray[np.int64]
_Heads: TypeAlias = NDArray[np.void]
_Read = TypeVar("_Read", "Message", "MessageBlock")


class Schema(NamedTuple):
    """One message type: name, encoding of its definition and the definition, as recorded."""

    name: str = ""
    encoding: str = ""
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class McapChannel:
    """One channel: topic, type, encoding of the messages and metadata as recorded."""

    topic: str
    schema: Schema
    encoding: str
    metadata: dict[str, str]

    @property
    def type_name(self) -> str:
        """Name of the message type, as recorded."""
        return self.schema.name


class Message(NamedTuple):
    """One message: times in integer nanoseconds, content as recorded, and the number that its publisher gave it."""

    channel: McapChannel
    log_time: int
    publish_time: int
    data: bytes
    sequence: int = 0


class MessageBlock(NamedTuple):
    """Messages of one channel, in the order of the file.

    Attributes:
        channel: of all of them.
        log_times: ns, (n,) of int64; blocks of the same times may share one array.
        data: the bytes that contain the messages.
        begins, ends: where each is there, (n,).
        apart: how far apart they begin, all of one length; 0 if they are not alike, None if that is not known.
    """

    channel: McapChannel
    log_times: NDArray[np.int64]
    data: NDArray[np.uint8]
    begins: Places
    ends: Places
    apart: int | None = None

    def messages(self) -> list[Message]:
        """Return the messages one by one, as published when they were logged."""
        places = zip(self.log_times.tolist(), self.begins.tolist(), self.ends.tolist(), strict=True)
        return [Message(self.channel, at, at, self.data[begin:end].tobytes()) for at, begin, end in places]

    def alone(self) -> MessageBlock:
        """Return the messages with a copy of their own bytes alone."""
        ends = np.cumsum(self.ends - self.begins)
        data = np.concatenate([rows.ravel() for rows in self.rows()])
        return self._replace(data=data, begins=ends - (self.ends - self.begins), ends=ends, apart=None)

    def rows(self) -> list[NDArray[np.uint8]]:
        """Return the content of the messages: all in one array where they are of one length, else each in its own.

        They may be views of `data`.
        """
        apart = _apart(self.begins, self.ends) if self.apart is None else self.apart
        length = int(self.ends[0] - self.begins[0])
        if apart:
            return [np.ndarray((len(self.ends), length), np.uint8, self.data, self.begins[0], (apart, 1))]
        if length and (self.ends - self.begins == length).all():
            return [_at(self.data, self.begins, length)]
        return [self.data[None, begin:end] for begin, end in zip(self.begins, self.ends, strict=True)]


def _apart(begins: Places, ends: Places) -> int:
    """Return how far apart messages begin that are all of one length; 0 for others."""
    lengths, apart = ends - begins, begins[1:] - begins[:-1]
    alike = len(apart) and lengths[0] and (lengths == lengths[0]).all() and (apart == apart[0]).all()
    return int(apart[0]) if alike else 0


def in_blocks(messages: Iterable[Message]) -> Iterator[MessageBlock]:
    """Yield messages in blocks, those of each channel in their order; those before a damage come before its error."""
    waiting: dict[int, list[Message]] = {}
    count = size = 0
    damage: LogError | None = None
    try:
        for message in messages:
            waiting.setdefault(id(message.channel), []).append(message)
            count, size = count + 1, size + len(message.data)
            if count >= _BLOCK_MESSAGES or size >= _BLOCK_BYTES:
                yield from map(_block, waiting.values())
                waiting, count, size = {}, 0, 0
    except LogError as error:
        damage = error
    yield from map(_block, waiting.values())
    if damage is not None:
        raise damage


def _block(messages: list[Message]) -> MessageBlock:
    data = np.frombuffer(b"".join(message.data for message in messages), np.uint8)
    ends = np.cumsum([len(message.data) for message in messages])
    log_times = np.array([message.log_time for message in messages], np.int64)
    return MessageBlock(messages[0].channel, log_times, data, np.append(0, ends[:-1]), ends)


Fact: TypeAlias = "dict[str, str] | bytes | McapChannel"
"""The content of a record other than a message: a metadata record, an attachment, or a channel by its topic."""

OnFact: TypeAlias = Callable[[str, Fact], None]


@dataclass
class McapFile:
    """One MCAP file; the attributes below `on_fact` fill while `messages` or `blocks` runs.

    Attributes:
        path: the file.
        salvage: leave out chunks that are damaged, instead of stopping at the first.
        part: of a bag of several files: one that was begun and never written to is cut off, and no error.
        on_fact: called with name and content of each fact as it is read, even if a name occurs twice.
        complete: the file was finished by its writer; False for one that was cut off.
        damage: what was left out, one line for each piece.
        unchecked: messages have no checksum, so that changed bytes in them would not be seen.
        missing: first and last log time (ns) of what stood in each piece left out, where the piece still says so.
        holes: pieces left out so far: they stood between the messages around them.
        unplaced: something else may be left out, and nothing says of when.
        metadata: key and value of each metadata record, by its name; of two of one name the later.
        attachments: content by name.
        channels: by channel id, as declared in the data; if there twice, and not alike, to salvage the later counts.
        doubtful: ids of channels that only a damaged summary declares.
        span_ns: log times of the first and the last message; None without any.
    """

    path: Path
    salvage: bool = False
    part: bool = False
    on_fact: OnFact | None = None
    complete: bool = False
    damage: list[str] = field(default_factory=list)
    unchecked: bool = False
    missing: list[tuple[int, int]] = field(default_factory=list)
    holes: int = 0
    unplaced: bool = False
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    channels: dict[int, McapChannel] = field(default_factory=dict)
    doubtful: set[int] = field(default_factory=set)
    span_ns: tuple[int, int] | None = None
    _schemas: dict[int, Schema] = field(default_factory=dict)
    # Of the schemas and channels declared in the data, by opcode and id: no summary replaces them.
    _declared: dict[tuple[int, int], bytes] = field(default_factory=dict)
    # Where the index says that chunks are.
    _chunks: set[int] = field(default_factory=set)
    # First and last log time of each chunk by the index, and of those that were read; None without a sound index.
    _indexed: Counter[tuple[int, int]] | None = None
    _whole: Counter[tuple[int, int]] = field(default_factory=Counter)
    _summary_damaged: bool = False
    # Whether the chunk read last is, or may be.
    _broken: bool = False
    _data_end: int = 0
    # Where the summary begins by the footer, if the data end there.
    _summary_begin: int | None = None
    _counts: Counter[str] = field(default_factory=Counter)
    _statistics: dict[str, int] = field(default_factory=dict)
    _records_left: int = 0
    _before: tuple[Places, Places] = (np.empty(0, np.int64), np.empty(0, np.int64))
    _layouts: dict[tuple[int, ...], _Layout] = field(default_factory=dict)
    _held: list[bytes] = field(default_factory=list)
    _held_bytes: int = 0
    # Records of messages outside of chunks, after what is held; whether there were any.
    _loose: bytearray = field(default_factory=bytearray)
    _outside: bool = False

    def messages(self) -> Iterator[Message]:
        """Yield every message; ends quietly where the file was cut off.

        Raises:
            LogError: the file cannot be read, is no MCAP file or is damaged.
        """
        yield from self._read(self._one_by_one)

    def blocks(self) -> Iterator[MessageBlock]:
        """Yield every message, in blocks of one channel; several times as fast as `messages`.

        Raises:
            LogError: as `messages`.
        """
        yield from self._read(self._by_channel)

    def lost_chunks(self) -> list[tuple[int, int]] | None:
        """Return first and last log time (ns) of each chunk that was not read, once all is read to salvage.

        None if the file does not say which chunks there were, or messages stand outside of them.
        """
        return None if self._indexed is None or self._outside else sorted((self._indexed - self._whole).elements())

    def _read(self, take: _Take[_Read]) -> Iterator[_Read]:
        """Yield what `take` makes of the messages."""
        require_file(self.path)
        try:
            with self.path.open("rb", _BUFFER_BYTES) as file:
                yield from self._messages(file, take)
        except OSError as error:
            raise LogError(f"cannot read {self.path}: {error.strerror or error}; check the path") from error
        except UnicodeDecodeError as error:
            raise LogError(self._said_of(error)) from error

    def _pass_damaged_begin(self, file: BinaryIO, size: int) -> None:
        """Go to the first record of a file whose first bytes are damaged, to save what follows.

        Raises:
            LogError: nothing is to be saved, or it is no MCAP file.
        """
        file.seek(0)
        found, instead = self._instead(file.read(len(_SQLITE)), file)
        at = len(MAGIC)
        damaged = self.path.suffix == ".mcap" and _looks_like_one(file, at, size)
        # Of a bag, other files are not lost with one that is of another kind.
        if not (self.salvage and (self.part or damaged)):
            raise self._damage(found) if damaged else LogError(f"{self.path} {found}; {instead}")
        self.damage.append(str(self._damage(found)))
        self.unplaced = True
        if not _in_a_row(file, at, size):
            # Bytes were lost or added, and no record begins where it should.
            at = _first(_is_chunk, file, at, size, size) or at
        file.seek(at)

    def _messages(self, file: BinaryIO, take: _Take[_Read]) -> Iterator[_Read]:
        begin = file.read(len(MAGIC))
        if self.part and begin != MAGIC and MAGIC.startswith(begin):
            return
        size = os.fstat(file.fileno()).st_size
        if begin != MAGIC:
            self._pass_damaged_begin(file, size)
        self._records_left = _FREE_RECORDS + _RECORDS_PER_BYTE * size
        self._counts.clear()
        self._declared.clear()
        self._whole.clear()
        self._note_summary(file, size)
        self._held, self._held_bytes = [], 0
        self._loose.clear()
        self._layouts.clear()
        try:
            yield from self._taken(file, size, take)
        except (LogError, UnicodeDecodeError):
            # Messages before a damaged place are not damaged.
            yield from self._held_messages(take)
            raise

    def _taken(self, file: BinaryIO, size: int, take: _Take[_Read]) -> Iterator[_Read]:
        data_ended = False
        with contextlib.closing(self._ahead(self._records(file, size))) as records:
            for opcode, content, unpacked in records:
                if opcode == Opcode.MESSAGE and not (data_ended and self._is_stray()):
                    self.unchecked = self._outside = True
                    self._loose += _RECORD.pack(opcode, len(content)) + content
                    if len(self._loose) < _TOGETHER_BYTES:
                        continue
                if self._loose:
                    yield from self._held_messages(take)
                self.holes += opcode == _HOLE
                if opcode == _CUT_CHUNK:
                    yield from self._cut_chunk(content, take)
                elif opcode == Opcode.CHUNK:
                    yield from self._chunk(content, unpacked, take)
                elif opcode == Opcode.DATA_END:
                    yield from self._held_messages(take)
                    data_ended = True
                    if self.salvage and not self.damage:
                        self._hold_data_checksum(content)
                elif opcode == Opcode.FOOTER:
                    yield from self._held_messages(take)
                    self.complete = file.read(len(MAGIC)) == MAGIC
                    self._hold_statistics()
                    self._hold_end(file)
                    return
                elif opcode not in (Opcode.MESSAGE, _HOLE):
                    if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                        yield from self._held_messages(take)
                    self._note_loose(opcode, content, summary=data_ended)
        yield from self._held_messages(take)

    def _is_stray(self) -> bool:
        """Return whether a message after the data section is another record with a damaged opcode, and note it.

        It is if a file is salvaged whose messages are all in chunks.
        """
        if not self.salvage or self._outside:
            return False
        self._note_damage("has a message behind the end of its data; it is left out")
        return True

    def _ahead(self, records: Iterator[tuple[int, bytes]]) -> Generator[_Prepared, None, None]:
        """Yield opcode and content of each record, and of a chunk what it holds, read and unpacked by another thread.

        To salvage, nothing is read ahead: each record is examined after all before it are finished.
        """
        if self.salvage:
            yield from ((opcode, content, None) for opcode, content in self._without_misnamed(records))
            return
        with contextlib.closing(one_ahead(self._prepared(records))) as ahead:
            for several in ahead:
                yield from several

    def _without_misnamed(self, records: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
        """Yield records to salvage, without indexes of chunks that are called messages, and note these.

        A message behind a chunk is one if its sequence number is the length of an index.
        """
        before = -1
        for opcode, content in records:
            if (before, opcode) == (Opcode.CHUNK, Opcode.MESSAGE) and _is_index(content):
                what = "has an index of a chunk that is called a message; it is left out"
                self.damage.append(str(self._damage(what)))
                continue
            before = opcode
            yield opcode, content

    def _prepared(self, records: Iterator[tuple[int, bytes]]) -> Iterator[list[_Prepared]]:
        several: list[_Prepared] = []
        size = 0
        try:
            for opcode, content in records:
                unpacked = self._decompressed(content) if opcode == Opcode.CHUNK else None
                several.append((opcode, content, unpacked))
                size += len(content if unpacked is None else unpacked)
                if size >= _TOGETHER_BYTES:
                    yield several
                    several, size = [], 0
        except (LogError, OSError, UnicodeDecodeError):
            yield several
            raise
        yield several

    def _note_summary(self, file: BinaryIO, size: int) -> None:
        """Keep what the summary repeats, to salvage: schemas, channels, and places of chunks that may be damaged."""
        begin, end = file.tell(), size - len(MAGIC) - _RECORD.size - _FOOTER.size
        if self.salvage and end > begin:
            file.seek(end)
            head, footer = file.read(_RECORD.size), file.read(_FOOTER.size)
            said_start, _, said = _FOOTER.unpack(footer)
            start = _behind_data(file, max(begin, end - MAX_RECORD_BYTES), end)
            if _RECORD.unpack(head) == (Opcode.FOOTER, _FOOTER.size) and said_start and start is not None:
                file.seek(start)
                self._summary_begin = start if start == said_start else None
                summary, at = file.read(end - start), 0
                indexed, chunks = Counter[tuple[int, int]](), -1
                if said and zlib.crc32(head + footer[:-4], zlib.crc32(summary)) != said:
                    self._summary_damaged = True
                    what = "has a summary whose checksum does not fit its content"
                    self.damage.append(f"{self._damage(what)}; what the data say counts")
                while at + _RECORD.size <= len(summary):
                    opcode, length = _RECORD.unpack_from(summary, at)
                    at += _RECORD.size + length
                    content = summary[at - length : at]
                    with contextlib.suppress(LogError, UnicodeDecodeError):
                        if opcode == Opcode.CHUNK_INDEX:
                            begin_ns, end_ns, place = _Fields(content, self._damage).take("QQQ")
                            indexed[begin_ns, end_ns] += 1
                            if start == said_start:
                                self._chunks.add(place)
                        elif opcode == Opcode.STATISTICS:
                            chunks = _Fields(content, self._damage).take("QHIIII")[-1]
                        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                            self._note(opcode, content, summary=True)
                if said and not self._summary_damaged and indexed.total() == chunks:
                    self._indexed = indexed
        file.seek(begin)

    def _note_loose(self, opcode: int, content: bytes, summary: bool) -> None:
        try:
            self._note(opcode, content, summary)
        except (LogError, UnicodeDecodeError) as error:
            if not self.salvage:
                raise
            self.damage.append(self._said_of(error))
            self.holes += not summary

    def _hold(self, data: bytes) -> None:
        """Keep what a chunk holds until `_held_messages` takes it."""
        self._held.append(data)
        self._held_bytes += len(data)

    def _held_messages(self, take: _Take[_Read]) -> Iterator[_Read]:
        """Yield what `take` makes of what is held: many small chunks one by one would take long."""
        if self._loose:
            self._hold(bytes(self._loose))
            self._loose.clear()
        if not self._held:
            return
        parts, self._held, self._held_bytes = self._held, [], 0
        data, sizes = b"".join(parts), tuple(map(len, parts))
        layout = self._layouts.get(sizes)
        if layout is not None and len(layout.begins) <= self._records_left:
            heads = layout.heads(data)
            if (heads["opcode"] == _MESSAGE).all() and (heads["length"] == layout.lengths).all():
                self._records_left -= len(heads)
                yield from self._placed(data, layout, heads, take)
                return
        yield from self._walked(data, sizes, take)

    def _walked(self, data: bytes, sizes: tuple[int, ...], take: _Take[_Read]) -> Iterator[_Read]:
        """Yield what `take` makes of chunks of these sizes, after a walk from record to record."""
        places: list[tuple[Places, Places]] = []
        end, alone = 0, True
        for limit in accumulate(sizes):
            start = end
            begins, ends = self._as_before(data, start, limit)
            end = int(ends[-1]) if len(ends) else start
            left = self._records_left - len(ends)
            more: list[int] = []
            while end < limit:
                begin = end + _RECORD.size
                opcode, length = _RECORD.unpack_from(data, end) if begin <= limit else (0, 0)
                end = begin + length
                left -= 1
                if opcode == _MESSAGE and end <= limit and left >= 0:
                    more += begin, end
                    continue
                # Other records apply to what follows them.
                self._records_left, alone = left, False
                if places or more or len(begins):
                    layout = _layout([*places, _places(begins, ends, more)])
                    yield from self._placed(data, layout, layout.heads(data), take)
                places, begins, ends, more = [], begins[:0], ends[:0], []
                if opcode == 0 or end > limit:
                    raise self._damage("has a chunk that ends within a record")
                if left < 0:
                    raise _TooManyRecordsError(
                        f"{self.path} holds more records than a recording of its size: more than {_RECORDS_PER_BYTE} "
                        f"for each byte and {_FREE_RECORDS}, expected messages, which differ; record it again"
                    )
                self._note(opcode, data[begin:end])
            self._records_left = left
            begins, ends = _places(begins, ends, more)
            places.append((begins, ends))
            # A short chunk leaves those of a longer one that it begins like.
            if more:
                self._before = begins - start, ends - start
        layout = _layout(places)
        if alone and layout.timed and len(data) <= 2 * _TOGETHER_BYTES:
            if len(self._layouts) == _LAYOUTS:
                self._layouts.clear()
            self._layouts[sizes] = layout
        yield from self._placed(data, layout, layout.heads(data), take)

    def _placed(self, data: bytes, layout: _Layout, heads: _Heads, take: _Take[_Read]) -> Iterator[_Read]:
        """Yield what `take` makes of the messages of a layout."""
        if len(layout.begins):
            yield from take(data, layout, heads)
            self._counts["messages"] += len(layout.begins)
            timed = layout.begins[layout.lengths >= _MESSAGE_HEAD.size]
            for begin in timed[[0, -1]] if len(timed) else ():
                at = _MESSAGE_HEAD.unpack_from(data, begin)[2]
                self.span_ns = at if self.span_ns is None else self.span_ns[0], at

    def _sound(self, layout: _Layout, heads: _Heads) -> bool:
        """Return whether every message has possible times and a channel that is declared."""
        return (
            layout.timed
            and max(heads["log_time"].max(), heads["publish_time"].max()) < END_OF_TIME
            and self.channels.keys() >= layout.of_channels(heads["channel"]).keys()
        )

    def _one_by_one(self, data: bytes, layout: _Layout, heads: _Heads) -> Iterator[Message]:
        places = zip(layout.begins.tolist(), layout.ends.tolist(), strict=True)
        if not self._sound(layout, heads):
            # An error is raised at the message that causes it.
            yield from (message for begin, end in places if (message := self._message(data, begin, end)) is not None)
            return
        channels = map(self.channels.__getitem__, heads["channel"].tolist())
        contents = (data[begin + _MESSAGE_HEAD.size : end] for begin, end in places)
        times = heads["log_time"].tolist(), heads["publish_time"].tolist()
        yield from map(Message, channels, *times, contents, heads["sequence"].tolist())

    def _by_channel(self, data: bytes, layout: _Layout, heads: _Heads) -> Iterator[MessageBlock]:
        """Yield blocks, in the order in which the channels come."""
        if not self._sound(layout, heads):
            yield from in_blocks(self._one_by_one(data, layout, heads))
            return
        raw, log_times = np.frombuffer(data, np.uint8), heads["log_time"].astype(np.int64)
        times = np.empty(0, np.int64)
        for number, (rows, begins, ends, apart) in layout.of_channels(heads["channel"]).items():
            own_times = log_times[rows]
            times = times if np.array_equal(times, own_times) else own_times
            yield MessageBlock(self.channels[number], times, raw, begins, ends, apart)

    def _instead(self, begin: bytes, file: BinaryIO) -> tuple[str, str]:
        """Return what a file is that is not an MCAP file, and what to do with it."""
        if begin.startswith(_ROS_1):
            bag = self.path.with_suffix("").name
            return "is a bag of ROS 1, expected one of ROS 2", f"convert it with {_converted(self.path, bag)}"
        if begin.startswith(_SQLITE):
            return "is an SQLite bag, expected an MCAP file", instead_of_recover(self.path).lstrip("; ")
        if begin.startswith(_PARQUET):
            written = f'pandas.read_parquet("{self.path.name}").to_csv("{self.path.stem}.csv", index=False)'
            return (
                "is a Parquet table, expected an MCAP file",
                f"tables are read as CSV only: write one, as by {written}",
            )
        return "does not begin like an MCAP file", self._by_name(file)

    def _by_name(self, file: BinaryIO) -> str:
        if os.fstat(file.fileno()).st_size == 0:
            return "it is empty, so nothing was written to it: record it again"
        if self.path.suffix == ".zstd":
            return f"unpack it first with zstd -d {self.path}"
        if self.path.suffix in (".yaml", ".yml"):
            return f"a scene is run, and its log written, with rb-dynamics simulate {self.path} --mcap run.mcap"
        if self.path.suffix == ".csv":
            bag = self.path.with_suffix(".mcap").name
            return f"a table of wrenches is made a bag with rb-dynamics convert {self.path} {bag}"
        return "give an .mcap file, such as rosbag2 or simulate --mcap writes"

    def _records(self, file: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
        """Yield the complete records, the remains of a chunk that was cut off as `_CUT_CHUNK`, and each `_HOLE`."""
        start, chunked = file.tell(), bool(self._chunks)
        # Up to here nothing is in doubt; after lost bytes, what looks like records may hide chunks.
        sound = start
        while len(head := file.read(_RECORD.size)) == _RECORD.size:
            start += _RECORD.size
            opcode, length = self._said(file, start, size, head)
            # No record has opcode 0: a disk that lost its power leaves zeros.
            too_long = length > size - start or (self.salvage and opcode in _NEEDED and length > MAX_RECORD_BYTES)
            astray = opcode == 0 or too_long or (opcode == Opcode.FOOTER and length != _FOOTER.size)
            chunked = chunked or opcode == Opcode.CHUNK
            if astray:
                sound = sound if chunked else start
                following = self._after_damage(file, sound, start, size, chunked, opcode)
                if following is None:
                    if opcode == Opcode.CHUNK:
                        yield _CUT_CHUNK, file.read(MAX_RECORD_BYTES)
                    return
                yield _HOLE, b""
                start = sound = file.seek(following)
                continue
            if opcode in _NEEDED:
                if opcode == Opcode.DATA_END:
                    self._data_end = start - _RECORD.size
                yield opcode, self._content(file, start, length)
                if opcode == Opcode.FOOTER:
                    return
            end = start + length
            said_length: int = _RECORD.unpack(head)[1]
            if opcode == Opcode.CHUNK and said_length < length and _in_a_row(file, start + said_length, size):
                # A decoder stops at the end of what is compressed: the chunk is whole by a length that is too large.
                end = start + said_length
            if self._broken:
                sound, self._broken = start, False
                end, whole = self._behind_broken(file, start, end, size)
                if not whole:
                    yield _HOLE, b""
            elif opcode in (Opcode.CHUNK, Opcode.ATTACHMENT):
                sound = end
            start = file.seek(end)

    def _said(self, file: BinaryIO, start: int, size: int, head: bytes) -> tuple[int, int]:
        """Return opcode and length of a record, to salvage those of a whole chunk, whatever its head says.

        So of a whole attachment the length: one that is too large hides what stands behind it.
        """
        opcode, length = _RECORD.unpack(head)
        if not self.salvage:
            return opcode, length
        if opcode == Opcode.ATTACHMENT:
            own = self._attachment_length(file, start, size)
            if own is not None and own != length:
                what = f"has a whole attachment at {start - _RECORD.size} in a record of another length; it was read"
                self.damage.append(str(self._damage(what)))
                return opcode, own
        if opcode == Opcode.HEADER and not _in_a_row(file, start + length, size):
            own = _header_length(file, start)
            if own is not None and own != length and _in_a_row(file, start + own, size):
                file.seek(start)
                self.damage.append(str(self._damage("has a header whose length is wrong; it was read")))
                return opcode, own
        file.seek(start)
        if (inside := self._disguised_chunk(file, start, size, opcode, length)) is None:
            return opcode, length
        what = f"has a whole chunk at {start - _RECORD.size} in a record of another kind or length; it was read"
        self.damage.append(str(self._damage(what)))
        return Opcode.CHUNK, inside

    def _content(self, file: BinaryIO, start: int, length: int) -> bytes:
        if length > MAX_RECORD_BYTES:
            raise self._damage(f"has a record of {length} bytes at {start}, more than {MAX_RECORD_BYTES}")
        return file.read(length)

    def _behind_broken(self, file: BinaryIO, start: int, end: int, size: int) -> tuple[int, bool]:
        """Return where to go on behind a damaged chunk, and whether it has the length that it says.

        If it lost bytes, it may have lost others' as well, and the next chunk begins before its end.
        """
        following = _first(_is_chunk, file, start, end, size)
        if following is None:
            return end, _in_a_row(file, end, size)
        self.damage.append(str(self._damage(f"lost bytes before the record at {following}")))
        return following, False

    def _after_damage(
        self, file: BinaryIO, sound: int, start: int, size: int, chunked: bool, opcode: int
    ) -> int | None:
        """Return where to go on, to salvage, behind a place that is no record's; None where nothing follows.

        Raises:
            LogError: the file was not cut off there, and is not to be salvaged.
        """
        place = start - _RECORD.size
        if not self.salvage:
            if _has_end(file, start, size):
                raise self._damage(f"has no record at {place}, but more after it")
            return None
        following = _first(_is_chunk, file, sound, size, size)
        if following is None and not chunked:
            following = _first(_in_a_row, file, start, size, size)
        file.seek(start)
        if following is not None:
            where = f"has no record at {place}, and the next" if following > place else "lost bytes before the record"
            self.damage.append(str(self._damage(f"{where} at {following}")))
        elif _has_end(file, start, size):
            what = f"has no record at {place}, but more after it"
            if opcode == Opcode.CHUNK:
                # Where bytes were lost, one message has those of two.
                what += "; whether messages of the chunk there were changed cannot be known"
            self.damage.append(str(self._damage(what)))
            self.complete = self._data_end + len(_DATA_END_HEAD) + 4 == self._summary_begin
            self.unplaced |= not self.complete
        return following

    def _disguised_chunk(self, file: BinaryIO, start: int, size: int, opcode: int, length: int) -> int | None:
        """Return the length of a whole chunk from `start` on, if the record there says that it is something else.

        Does not move the position in the file.
        """
        found = _chunk_length(file.read(_CHUNK_HEAD_BYTES))
        if found is None or found > size - start or (opcode, length) == (Opcode.CHUNK, found):
            file.seek(start)
            return None
        file.seek(start)
        content = file.read(found)
        file.seek(start)
        try:
            checksum = self._chunk_head(content)[2]
            empty = not self._decompressed(content)
        except MissingExtraError:
            raise
        except (LogError, UnicodeDecodeError):
            return None
        proven = checksum or opcode == Opcode.CHUNK or start - _RECORD.size in self._chunks
        return found if proven and not empty else None

    def _attachment_length(self, file: BinaryIO, start: int, size: int) -> int | None:
        """Return the length of the attachment from `start` on by its fields, if it is whole by them.

        Does not move the position in the file.
        """
        try:
            at = start + _ATTACHMENT_TIMES_BYTES
            for length_format in (_TEXT_LENGTH, _TEXT_LENGTH, _DATA_LENGTH):
                file.seek(at)
                at += length_format.size + length_format.unpack(file.read(length_format.size))[0]
            if at + _CHECKSUM.size > size or at - start > MAX_RECORD_BYTES:
                return None
            file.seek(at)
            (said,) = _CHECKSUM.unpack(file.read(_CHECKSUM.size))
            end = at + _CHECKSUM.size
            whole = _checksum(file, start, at) == said if said else _in_a_row(file, end, size)
            return end - start if whole else None
        except (struct.error, OverflowError, ValueError):
            return None
        finally:
            file.seek(start)

    def _chunk(self, content: bytes, unpacked: bytes | None, take: _Take[_Read]) -> Iterator[_Read]:
        try:
            inside = self._decompressed(content) if unpacked is None else unpacked
            begin_ns, end_ns, _, checksum, _ = _CHUNK_HEAD.unpack_from(content)
            self.unchecked |= not checksum
            self._hold(inside)
            if self.salvage or self._held_bytes >= _TOGETHER_BYTES:
                yield from self._held_messages(take)
            if self.salvage:
                self._whole[begin_ns, end_ns] += 1
        except (LogError, UnicodeDecodeError) as error:
            if not self.salvage or isinstance(error, (MissingExtraError, _TooManyRecordsError)):
                raise
            self._broken = True
            self.damage.append(self._said_of(error))
            self.holes += 1
            with contextlib.suppress(LogError):
                begin_ns, end_ns = _Fields(content, self._damage).take("QQ")
                # Zeros are no times.
                if begin_ns <= end_ns and 0 < end_ns < END_OF_TIME:
                    self.missing.append((begin_ns, end_ns))

    def _cut_chunk(self, content: bytes, take: _Take[_Read]) -> Iterator[_Read]:
        """Yield the messages before the end of the file; a checksum, which is of the whole chunk, proves nothing."""
        yield from self._held_messages(take)
        # It ends within a record: that is not damage, the file is not complete.
        with contextlib.suppress(LogError, UnicodeDecodeError):
            compression, size, checksum, data = self._chunk_head(content, cut=True)
            self.unchecked |= not checksum
            inside = self._unpacked(compression, data, size)
            end, astray = _own_records(inside)
            if astray and self.salvage:
                what = "ends in bytes that are no record; the message before them may have some, and was left out"
                self.damage.append(str(self._damage(what)))
            self._hold(inside[:end])
            yield from self._held_messages(take)

    def _as_before(self, data: bytes, start: int, limit: int) -> tuple[Places, Places]:
        """Return the places of the first messages of a chunk, as many as have the places of those of the chunk before.

        Recorders write the same messages again and again; each that is where it is expected gives the start of the
        next.
        """
        begins, ends = self._before
        within = min(int(np.searchsorted(ends, limit - start, side="right")), self._records_left)
        begins, ends = begins[:within] + start, ends[:within] + start
        if not within or begins[0] != start + _RECORD.size:
            return begins[:0], ends[:0]
        heads = _at(np.frombuffer(data, np.uint8), begins - _RECORD.size, _RECORD.size).view(_RECORDS)[:, 0]
        differing = (heads["opcode"] != _MESSAGE) | (heads["length"] != ends - begins)
        count = int(differing.argmax()) if differing.any() else within
        return begins[:count], ends[:count]

    def _message(self, data: bytes, start: int, end: int) -> Message | None:
        """Return a message; None if it is left out because its times are impossible."""
        content = start + _MESSAGE_HEAD.size
        if content > end:
            self._note_damage("has a message without its times")
            return None
        channel_id, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(data, start)
        channel = self.channels.get(channel_id)
        if channel is None:
            self._note_damage(f"has a message on channel {channel_id}, which it does not declare")
            return None
        if log_time >= END_OF_TIME or publish_time >= END_OF_TIME:
            self._note_damage(
                f"has a message on {channel.topic} of log time {log_time} ns and publish time {publish_time} ns, "
                "beyond the 2^63 ns that ROS counts to"
            )
            return None
        return Message(channel, log_time, publish_time, data[content:end], sequence)

    def _note_damage(self, what: str) -> None:
        """Note what cannot be read, once for several in a row; it is an error unless to salvage."""
        damage = self._damage(what)
        if not self.salvage:
            raise damage
        self.unplaced = True
        if str(damage) not in self.damage[-1:]:
            self.damage.append(str(damage))

    def _declares(self, opcode: int, content: bytes, summary: bool) -> bool:
        """Return whether a schema or a channel is to be noted, as that is not done."""
        (number,) = _Fields(content, self._damage).take("H")
        before = self._declared.get((opcode, number))
        if before == content or (before and summary):
            return False
        if not summary:
            if before:
                # The messages that follow may be those of either.
                kind = "channel" if opcode == Opcode.CHANNEL else "schema"
                self._note_damage(f"declares {kind} {number} twice, and not alike")
            self._declared[opcode, number] = content
            if opcode == Opcode.CHANNEL:
                self.doubtful.discard(number)
        elif opcode == Opcode.CHANNEL and self._summary_damaged:
            self.doubtful.add(number)
        return True

    def _note(self, opcode: int, content: bytes, summary: bool = False) -> None:
        """Keep the content of a record other than a message; `summary`: of one that may repeat those in the data."""
        fields = _Fields(content, self._damage)
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and not self._declares(opcode, content, summary):
            return
        if opcode == Opcode.SCHEMA:
            (schema_id,) = fields.take("H")
            self._schemas[schema_id] = Schema(fields.text(), fields.text(), fields.block("I"))
        elif opcode == Opcode.CHANNEL:
            channel_id, schema_id = fields.take("HH")
            topic, encoding = fields.text(), fields.text()
            schema = self._schemas.get(schema_id, Schema())
            self.channels[channel_id] = channel = McapChannel(topic, schema, encoding, fields.mapping())
            self._tell(topic, channel)
        elif opcode == Opcode.ATTACHMENT:
            fields.take("QQ")
            name, _, attached, checksum = fields.text(), fields.text(), fields.block("Q"), fields.rest()
            said = int.from_bytes(checksum[:4], "little")
            if said and zlib.crc32(content[: len(content) - len(checksum)]) != said:
                damage = self._damage(f"has an attachment {name} whose checksum does not fit its content")
                if not self.salvage:
                    raise damage
                self.damage.append(f"{damage}; it is left out")
                return
            self.attachments[name] = attached
            self._counts["attachments"] += 1
            self._tell(name, attached)
        elif opcode == Opcode.METADATA:
            name = fields.text()
            facts = fields.mapping()
            self.metadata[name] = with_earlier(name, self.metadata.get(name), facts)
            self._counts["metadata records"] += 1
            self._tell(name, facts)
        elif opcode == Opcode.CHUNK:
            raise self._damage("has a chunk within a chunk")
        elif opcode == Opcode.STATISTICS:
            messages, _, _, attachments, records = fields.take("QHIII")
            self._statistics = {"messages": messages, "attachments": attachments, "metadata records": records}

    def _hold_data_checksum(self, content: bytes) -> None:
        """Note as damage what no chunk's checksum covers: the data section has one, too; 0 means that it has none."""
        said = int.from_bytes(content[:4], "little")
        if said:
            self.unchecked = False
            with self.path.open("rb") as file:
                # Most writers include the magic bytes at the start of the file, some do not.
                if said in (_checksum(file, begin, self._data_end) for begin in (0, len(MAGIC))):
                    return
            what = "has a data section whose checksum does not fit its content"
            if self._whole:
                what += ", while those of its chunks do"
            suspects = "messages outside of chunks, their types," if self._outside else "the index,"
            self.damage.append(f"{self._damage(what)}; {suspects} metadata or an attachment may be wrong")

    def _hold_statistics(self) -> None:
        """Compare what was read with the file's own statistics: a piece may be missing, or be there twice.

        Raises:
            LogError: they differ.
        """
        for name, said in self._statistics.items():
            if self._counts[name] != said and not self.damage:
                self._note_damage(f"holds {self._counts[name]} {name}, and its statistics say {said}")

    def _hold_end(self, file: BinaryIO) -> None:
        """Look for more than zeros, which some disks append, after the end of a file.

        Raises:
            LogError: there is more.
        """
        end = file.tell()
        if self.complete and any(part.strip(b"\0") for part in iter(lambda: file.read(2**20), b"")):
            rest = f"tail -c +{end + 1} {self.path} > rest.mcap"
            self._note_damage(f"goes on after its end, as if files had been joined; extract the rest with: {rest}")

    def _tell(self, name: str, said: Fact) -> None:
        if self.on_fact is not None:
            self.on_fact(name, said)

    def _decompressed(self, content: bytes) -> bytes:
        compression, size, checksum, data = self._chunk_head(content)
        data = self._unpacked(compression, data, size)
        if len(data) != size or (checksum and zlib.crc32(data) != checksum):
            raise self._damage("has a chunk whose checksum does not fit its content")
        return data

    def _chunk_head(self, content: bytes, cut: bool = False) -> tuple[str, int, int, bytes]:
        """Return compression, size and checksum of what is in a chunk, and its bytes, as many as there are if `cut`."""
        fields = _Fields(content, self._damage)
        fields.take("QQ")
        size, checksum = fields.take("QI")
        compression = fields.text()
        data = fields.rest()[8:] if cut else fields.block("Q")
        if not size and not fields.at_end:
            # As where zeros stand in its place.
            raise self._damage("has a chunk whose head is lost")
        return compression, size, checksum, data

    def _unpacked(self, compression: str, data: bytes, size: int) -> bytes:
        if size > MAX_RECORD_BYTES:
            raise self._damage(f"has a chunk of {size} bytes, more than {MAX_RECORD_BYTES}")
        if compression not in _DECOMPRESSORS:
            known = ", ".join(name or "none" for name in sorted(_DECOMPRESSORS))
            raise LogError(
                f"{self.path} is compressed with {compression!r}, expected one of {known}; write it with one of these, "
                "for example by `mcap compress`"
            )
        try:
            return _DECOMPRESSORS[compression](data, size)
        except ImportError as error:
            raise MissingExtraError(error.name or compression, "log", f"reading {self.path}") from None
        except (RuntimeError, ValueError, EOFError) as error:
            raise self._damage(f"has a chunk that cannot be decompressed ({error})") from error

    def _said_of(self, error: LogError | UnicodeDecodeError) -> str:
        """Return a line about a damage, with the name of the file."""
        return str(error if isinstance(error, LogError) else self._damage("has text that is not UTF-8"))

    def _damage(self, what: str) -> LogError:
        advice = "" if self.salvage else "; save what can be read with `rb-dynamics recover` or record it again"
        return LogError(f"{self.path} is damaged: it {what}{advice}")


def require_file(path: Path) -> None:
    """Refuse a pipe, which would be waited for, a device, which may have no end, and what stands for a file in git.

    Raises:
        LogError: it is one of them; other problems are left to its reader.
    """
    try:
        regular = stat.S_ISREG(path.stat().st_mode)
        if not (regular or path.is_dir()):
            raise LogError(f"{path} is a pipe or a device, expected a file, which can be read again; give one")
        with contextlib.ExitStack() as opened:
            begin = opened.enter_context(path.open("rb")).read(len(_GIT_LFS)) if regular else b""
    except OSError:
        return
    if begin == _GIT_LFS:
        raise LogError(
            f"{path} only stands for a file that Git LFS keeps elsewhere, expected it; fetch it with: git lfs pull"
        )


def _first(
    is_one: Callable[[BinaryIO, int, int], bool], file: BinaryIO, start: int, stop: int, size: int
) -> int | None:
    """Return the first place from `start` on, before `stop`, where `is_one` finds a record; None if there is none.

    Does not move the position in the file.
    """
    found, at = None, start
    while found is None and at < stop:
        file.seek(at)
        part = file.read(min(2**20, stop + 8 - at))
        raw = np.frombuffer(part, np.uint8)
        # Of a record that is neither huge nor of another kind; few other bytes look like it.
        likely = (raw[:-8] > 0) & (raw[:-8] <= max(Opcode)) & (raw[6:-2] == 0) & (raw[7:-1] == 0) & (raw[8:] == 0)
        found = next((at + k for k in np.flatnonzero(likely).tolist() if is_one(file, at + k, size)), None)
        at += max(len(part) - 8, 1)
    file.seek(start)
    return found


def _behind_data(file: BinaryIO, begin: int, end: int) -> int | None:
    """Return where the summary begins: behind the last end of the data there.

    That is not where the footer says if the data lost or gained bytes.
    """
    file.seek(begin)
    at = file.read(end - begin).rfind(_DATA_END_HEAD)
    return None if at < 0 else begin + at + len(_DATA_END_HEAD) + 4


def _is_chunk(file: BinaryIO, at: int, size: int) -> bool:
    """Return whether a whole chunk with consistent lengths begins here."""
    file.seek(at)
    opcode, length = _RECORD.unpack(file.read(_RECORD.size))
    inside = _chunk_length(file.read(_CHUNK_HEAD_BYTES))
    return bool(opcode == Opcode.CHUNK and inside == length <= size - (at + _RECORD.size))


def _looks_like_one(file: BinaryIO, at: int, size: int) -> bool:
    """Return whether a file holds a chunk, or records from here to its end."""
    return _first(_is_chunk, file, at, size, size) is not None or (
        size > at + len(MAGIC) and _has_end(file, at, size) and _in_a_row(file, at, size)
    )


def _in_a_row(file: BinaryIO, at: int, size: int) -> bool:
    """Return whether `_ROW` records of known kinds follow each other from here on, or all up to the end."""
    for _ in range(_ROW):
        file.seek(min(at, size))
        opcode, length = _RECORD.unpack(file.read(_RECORD.size)) if size - at >= _RECORD.size else (0, 0)
        at += _RECORD.size + length
        if not 0 < opcode <= max(Opcode) or at > size:
            return False
        if opcode == Opcode.FOOTER:
            return length == _FOOTER.size and at == size - len(MAGIC)
    return True


def _is_index(content: bytes) -> bool:
    """Return whether a record is an index of messages by its content: channel, length, and so many bytes."""
    return len(content) >= 6 and int.from_bytes(content[2:6], "little") == len(content) - 6


def _header_length(file: BinaryIO, start: int) -> int | None:
    """Return the length of the header of a file by its two texts; None if these bytes are none."""
    at = start
    try:
        for _ in range(2):
            file.seek(at)
            at += _TEXT_LENGTH.size + _TEXT_LENGTH.unpack(file.read(_TEXT_LENGTH.size))[0]
    except (struct.error, OverflowError, ValueError):
        return None
    return at - start


def _chunk_length(head: bytes) -> int | None:
    """Return the length of a chunk by its fields; None if these bytes do not begin a chunk."""
    if len(head) < _CHUNK_HEAD_BYTES:
        return None
    name: int
    begin_ns, end_ns, unpacked, _, name = _CHUNK_HEAD.unpack_from(head)
    after = _CHUNK_HEAD.size + name
    known = head[_CHUNK_HEAD.size : after] in [each.encode() for each in _DECOMPRESSORS]
    if not (known and begin_ns <= end_ns < END_OF_TIME and unpacked <= MAX_RECORD_BYTES):
        return None
    packed: int = struct.unpack_from("<Q", head, after)[0]
    return packed + after + 8


def _own_records(data: bytes) -> tuple[int, bool]:
    """Return where the records of a chunk that was cut off end, and whether other bytes stand behind them.

    As where a disk that lost its power left zeros, or what it held before. They may have completed the record before.
    """
    before = end = 0
    while end < len(data):
        opcode, length = _RECORD.unpack(data[end : end + _RECORD.size].ljust(_RECORD.size, b"\0"))
        if opcode not in _IN_CHUNKS or length > MAX_RECORD_BYTES:
            return before, True
        before, end = end, end + _RECORD.size + length
    return len(data), False


def _has_end(file: BinaryIO, start: int, size: int) -> bool:
    """Return whether a file ends like one that was finished; does not move the position in it."""
    file.seek(size - len(MAGIC))
    found = file.read(len(MAGIC)) == MAGIC
    file.seek(start)
    return found


def _checksum(file: BinaryIO, begin: int, end: int) -> int:
    """Return the checksum of a part of a file."""
    file.seek(begin)
    found = 0
    while begin < end and (part := file.read(min(2**20, end - begin))):
        found, begin = zlib.crc32(part, found), begin + len(part)
    return found


def instead_of_recover(path: Path) -> str:
    """Return a description of an SQLite file given in place of an MCAP file, and the remedy."""
    renamed = "" if path.suffix == ".db3" else f" under a name that ends in .db3 (now {path.name}),"
    return (
        f"; SQLite bags are read, not recovered: give the folder of {path.name},{renamed} to inspect or simulate "
        f"--wrench; one that is damaged is saved with sqlite3 {path.name} .recover, and made MCAP with "
        f"{_converted(path, path.stem)}"
    )


def _converted(path: Path, bag: str) -> str:
    """Return the command that makes a bag of ROS 2 in MCAP of a file."""
    return f"rosbags-convert --src {path} --dst {bag} --dst-storage mcap (pip install rosbags)"


# Opcode and content of a record, and of a chunk what it holds, if it is unpacked.
_Prepared: TypeAlias = tuple[int, bytes, "bytes | None"]


@dataclass
class _Layout:
    """Where messages are in chunks: mostly the next ones have them there, too, as recorders repeat themselves.

    Attributes:
        begins, ends: of the content of each message's record.
        lengths: of it.
        timed: every message is long enough to have its times.
    """

    begins: Places
    ends: Places
    _channels: NDArray[np.uint16] = field(default_factory=lambda: np.empty(0, np.uint16))
    _of_channels: dict[int, tuple[Places, Places, Places, int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.lengths = self.ends - self.begins
        self.timed = bool((self.lengths >= _MESSAGE_HEAD.size).all())

    def heads(self, data: bytes) -> _Heads:
        """Return the heads of the messages in chunks; none if not every message has its times."""
        if not (self.timed and len(self.begins)):
            return np.empty(0, _HEADS)
        return _at(np.frombuffer(data, np.uint8), self.begins - _RECORD.size, _HEADS.itemsize).view(_HEADS)[:, 0]

    def of_channels(self, channels: NDArray[np.uint16]) -> dict[int, tuple[Places, Places, Places, int]]:
        """Return the messages of each channel: their rows, and begins, ends and distance as in `MessageBlock`.

        Args:
            channels: that of each message.
        """
        if not np.array_equal(channels, self._channels):
            self._channels = channels.copy()
            numbers = dict.fromkeys(channels.tolist())
            rows = {number: np.flatnonzero(channels == number) for number in numbers}
            places = {number: (self.begins[at] + _MESSAGE_HEAD.size, self.ends[at]) for number, at in rows.items()}
            self._of_channels = {number: (rows[number], *each, _apart(*each)) for number, each in places.items()}
        return self._of_channels


def _layout(places: list[tuple[Places, Places]]) -> _Layout:
    begins, ends = zip(*places, strict=True)
    return _Layout(np.concatenate(begins), np.concatenate(ends))


_Take: TypeAlias = Callable[[bytes, _Layout, _Heads], Iterator[_Read]]


def _at(data: NDArray[np.uint8], begins: Places, length: int) -> NDArray[np.uint8]:
    """Return the bytes, `length` of them, that begin at each of these places, (n, length)."""
    windows = np.ndarray((len(data) - length + 1,), f"V{length}", data, strides=(1,))
    return windows[begins].view(np.uint8).reshape(-1, length)


def _places(begins: Places, ends: Places, more: list[int]) -> tuple[Places, Places]:
    """Return begins and ends, followed in turn by those in `more`."""
    added = np.array(more, np.int64)
    return np.append(begins, added[::2]), np.append(ends, added[1::2])


class _TooManyRecordsError(LogError):
    """More than what can be salvaged."""


class _Fields:
    """The fields of one record, taken one after the other."""

    def __init__(self, data: bytes, damage: Callable[[str], LogError]) -> None:
        self._data = data
        self._position = 0
        self._damage = damage

    def take(self, formats: str) -> tuple[int, ...]:
        """Return unsigned integers by their `struct` formats."""
        return struct.unpack("<" + formats, self._bytes(struct.calcsize("<" + formats)))

    def block(self, length_format: str) -> bytes:
        """Return bytes that follow their length."""
        return self._bytes(self.take(length_format)[0])

    def text(self) -> str:
        """Return a string that follows its length."""
        return str(self.block("I"), "utf-8")

    def mapping(self) -> dict[str, str]:
        """Return a map of strings that follows its length in bytes."""
        inner = _Fields(self.block("I"), self._damage)
        pairs: dict[str, str] = {}
        while not inner.at_end:
            key = inner.text()
            pairs[key] = inner.text()
        return pairs

    def rest(self) -> bytes:
        """Return all that is left."""
        return self._bytes(len(self._data) - self._position)

    @property
    def at_end(self) -> bool:
        """Whether nothing is left."""
        return self._position == len(self._data)

    def _bytes(self, count: int) -> bytes:
        end = self._position + count
        if end > len(self._data):
            raise self._damage("has a record that is shorter than its fields")
        taken = self._data[self._position : end]
        self._position = end
        return taken


# One byte more than declared is requested, so that a chunk with more than that is noticed.
def _zstd(data: bytes, size: int) -> bytes:
    import zstandard

    try:
        return bytes(zstandard.ZstdDecompressor().stream_reader(data).read(size + 1))
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from error


def _lz4(data: bytes, size: int) -> bytes:
    import lz4.frame  # type: ignore[import-untyped,import-not-found,unused-ignore]

    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))


_DECOMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {"": lambda data, _: data, "zstd": _zstd, "lz4": _lz4}
