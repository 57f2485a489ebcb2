"""`McapWriter`: the MCAP container, written front to back with index and statistics; the twin of `mcap_records`.

A writer of our own, for two reasons. It takes the messages of a sample at once, some six times as fast as
`mcap.writer.Writer` takes them one by one (`benchmarks/recording.py`). And on a full disk it drops its last chunks to
make room for the end of the file. The library's reader checks what it writes: `mcap_integrity.py`, and the tests.

Never looks inside a message, and holds in memory one chunk and, until the end of the file, its index: some 300 bytes
for each chunk, which is about 1 % of the file.

Format: the MCAP specification, version 0: a record is one byte of opcode, the length of its content, the content.
"""

from __future__ import annotations

import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from rb_dynamics.errors import LogError
from rb_dynamics.formats.mcap_records import MAGIC, McapChannel, Opcode, Schema
from rb_dynamics.formats.output_file import OutputFile

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

CHUNK_BYTES = 256 * 1024

# How many of the last chunks may be given up to make room for the index on a full disk.
_SPARE_CHUNKS = 4

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS = _MESSAGE.size - _RECORD.size
HEAD = _MESSAGE.size
"""Bytes of the record of a message before the message."""
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_ENTRY = struct.Struct("<QQ")
_PLACE = struct.Struct("<HQ")
# Of a message index: opcode, length of its content, channel, length of the entries, which follow.
_INDEX = struct.Struct("<BQHI")
_INDEX_FIELDS = _INDEX.size - _RECORD.size
_INDEX_OPCODE = int(Opcode.MESSAGE_INDEX)

# First and last time where there is none yet.
_NO_TIMES = (2**64 - 1, 0)


class InPieces(NamedTuple):
    """Messages of a channel: one at `offset` in each of `pieces`, (k,), which grow."""

    channel: int
    pieces: npt.NDArray[np.int64]
    offset: int


def framed(channel: int, message: bytes) -> bytes:
    """Return the record of a message of time 0."""
    return _MESSAGE.pack(_MESSAGE_OPCODE, _MESSAGE_FIELDS + len(message), channel, 0, 0, 0) + message


def copies(records: bytes, places: Iterable[int], log_times: npt.NDArray[np.int64]) -> npt.NDArray[np.uint8]:
    """Return records from `framed`, which begin at `places`, once for each time: (n, length)."""
    import numpy as np

    rows = np.tile(np.frombuffer(records, np.uint8), (len(log_times), 1))
    # Logged and published.
    times = np.stack([log_times, log_times], axis=1).astype("<i8").view(np.uint8)
    for place in places:
        rows[:, place + HEAD - 16 : place + HEAD] = times
    return rows


def in_rows(records: npt.NDArray[np.uint8]) -> list[bytes]:
    """Return the rows of records, (n, length)."""
    data, width = records.tobytes(), records.shape[1]
    return [data[begin : begin + width] for begin in range(0, len(data), width)]


@dataclass
class _Written:
    """The data for the index, so far."""

    schemas: list[bytes] = field(default_factory=list)
    channels: list[bytes] = field(default_factory=list)
    chunks: list[bytes] = field(default_factory=list)
    attachments: list[bytes] = field(default_factory=list)
    metadata: list[bytes] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    start_time: int = 2**64 - 1
    end_time: int = 0


@dataclass
class _Mark:
    """A place in the file to which the writer can return: all that was written and counted before one chunk."""

    position: int
    chunks: int
    attachments: int
    metadata: int
    counts: dict[int, int]
    start_time: int
    end_time: int


class McapWriter:
    """Writes one file of profile `ros2`; zstd where it is installed."""

    def __init__(self, file: OutputFile, library: str) -> None:
        """Prepare to write `file`; `library` names the software that writes."""
        self._file = file
        self._compression, self._compress = _compression()
        self._written = _Written()
        self._schemas: dict[Schema, int] = {}
        self._marks: deque[_Mark] = deque(maxlen=_SPARE_CHUNKS)
        self._library = library
        self._start_time, self._end_time = _NO_TIMES
        self._begin_chunk()

    def begin(self) -> None:
        """Write the header; comes first.

        Raises:
            LogError: the file cannot be written; so for every method below.
        """
        self._file.write(MAGIC + _record(Opcode.HEADER, _text("ros2") + _text(self._library)))

    @property
    def end_time(self) -> int:
        """The latest time of a message that is in the file, ns; 0 without any."""
        return self._written.end_time

    @property
    def counts(self) -> dict[int, int]:
        """Messages in finished chunks, by channel."""
        return self._written.counts

    @property
    def between_chunks(self) -> bool:
        """Whether everything so far is in the file."""
        return not self._chunk

    def add_channel(self, channel: McapChannel) -> int:
        """Declare a channel, and its message type if it is the first of it; return its id."""
        number, schema = len(self._written.channels) + 1, self._schema_id(channel.schema)
        names = _text(channel.topic) + _text(channel.encoding)
        record = _record(Opcode.CHANNEL, struct.pack("<HH", number, schema) + names + _mapping(channel.metadata))
        self._written.channels.append(record)
        self._written.counts[number] = 0
        self._chunk += record
        self._index[number] = bytearray()
        return number

    def _schema_id(self, schema: Schema) -> int:
        if schema not in self._schemas:
            number = self._schemas[schema] = len(self._schemas) + 1
            fields = (struct.pack("<H", number), _text(schema.name), _text(schema.encoding), _block("I", schema.data))
            record = _record(Opcode.SCHEMA, b"".join(fields))
            self._written.schemas.append(record)
            self._chunk += record
        return self._schemas[schema]

    def add_messages(
        self, channels: Iterable[int], messages: Iterable[bytes], log_time: int, publish_time: int, sequence: int = 0
    ) -> None:
        """Write messages of one time, ns, each on its channel, with the number that their publisher gave them."""
        chunk, index = self._chunk, self._index
        for channel, data in zip(channels, messages, strict=True):
            index[channel] += _ENTRY.pack(log_time, len(chunk))
            length = _MESSAGE_FIELDS + len(data)
            chunk += _MESSAGE.pack(_MESSAGE_OPCODE, length, channel, sequence, log_time, publish_time)
            chunk += data
        self._start_time = min(self._start_time, log_time)
        self._end_time = max(self._end_time, log_time)
        if len(chunk) >= CHUNK_BYTES:
            self.end_chunk()

    def add_pieces(
        self,
        data: bytes | memoryview,
        ends: npt.NDArray[np.int64],
        log_times: npt.NDArray[np.int64],
        messages: Iterable[InPieces],
    ) -> Iterator[int]:
        """Write pieces, each one or several records of messages of one time; yield how many whenever a chunk has ended.

        Chunks end where `add_messages` would end them, with the messages of a piece at once.

        Args:
            data: records of messages, in the order of their times.
            ends: (n,), of the pieces in `data`.
            log_times: (n,), ns.
            messages: where they are in the pieces.
        """
        import numpy as np

        # Where chunks end in the pieces, and the place in the pieces where each would have begun.
        bounds, origins = [0], [-len(self._chunk)]
        while (full := int(ends.searchsorted(origins[-1] + CHUNK_BYTES))) < len(ends):
            bounds.append(full + 1)
            origins.append(int(ends[full]))
        starts, complete = np.append(0, ends[:-1]), len(bounds) - 1
        if bounds[-1] < len(ends):
            bounds.append(len(ends))
        offsets = starts - np.repeat(origins[: len(bounds) - 1], np.diff(bounds))
        entries = []
        for each in messages:
            both = np.stack([log_times[each.pieces], offsets[each.pieces] + each.offset], axis=1)
            places = _ENTRY.size * each.pieces.searchsorted(bounds)
            entries.append((each.channel, both.astype("<u8").tobytes(), places.tolist()))
        view = memoryview(data)
        for k, (begin, end) in enumerate(pairwise(bounds)):
            self._chunk += view[starts[begin] : ends[end - 1]]
            for channel, mine, places in entries:
                self._index[channel] += mine[places[k] : places[k + 1]]
            self._start_time = min(self._start_time, int(log_times[begin]))
            self._end_time = max(self._end_time, int(log_times[end - 1]))
            if k < complete:
                self.end_chunk()
                yield end

    def add_metadata(self, name: str, facts: Mapping[str, str]) -> None:
        """Write a metadata record."""
        self.end_chunk()
        offset, record = self._file.tell(), _record(Opcode.METADATA, _text(name) + _mapping(facts))
        self._file.write(record)
        entry = struct.pack("<QQ", offset, len(record)) + _text(name)
        self._written.metadata.append(_record(Opcode.METADATA_INDEX, entry))

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write a file into the file, at time 0."""
        self.end_chunk()
        content = struct.pack("<QQ", 0, 0) + _text(name) + _text(media_type) + _block("Q", data)
        offset = self._file.tell()
        record = _record(Opcode.ATTACHMENT, content + struct.pack("<I", zlib.crc32(content)))
        self._file.write(record)
        entry = struct.pack("<QQQQQ", offset, len(record), 0, 0, len(data)) + _text(name) + _text(media_type)
        self._written.attachments.append(_record(Opcode.ATTACHMENT_INDEX, entry))

    def end_chunk(self) -> None:
        """Write the chunk in progress, so that it survives a kill; does nothing where it is empty."""
        if not self._chunk:
            return
        written = self._written
        self._marks.append(
            _Mark(
                self._file.tell(),
                len(written.chunks),
                len(written.attachments),
                len(written.metadata),
                written.counts.copy(),
                written.start_time,
                written.end_time,
            )
        )
        indexed = [(channel, entries) for channel, entries in self._index.items() if entries]
        start_time, end_time = (self._start_time, self._end_time) if indexed else (0, 0)
        data = self._compress(self._chunk)
        size, compression = len(self._chunk), _text(self._compression)
        head = struct.pack("<QQQI", start_time, end_time, size, zlib.crc32(self._chunk)) + compression
        offset = self._file.tell()
        out = bytearray(_record(Opcode.CHUNK, head + _block("Q", data)))
        length = len(out)
        places = bytearray()
        for channel, entries in indexed:
            places += _PLACE.pack(channel, offset + len(out))
            out += _INDEX.pack(_INDEX_OPCODE, _INDEX_FIELDS + len(entries), channel, len(entries))
            out += entries
            written.counts[channel] += len(entries) // _ENTRY.size
        self._file.write(out)
        entry = struct.pack("<QQQQ", start_time, end_time, offset, length) + _block("I", places)
        entry += struct.pack("<Q", len(out) - length) + compression + struct.pack("<QQ", len(data), size)
        written.chunks.append(_record(Opcode.CHUNK_INDEX, entry))
        if indexed:
            written.start_time = min(written.start_time, start_time)
            written.end_time = max(written.end_time, end_time)
        self._begin_chunk()

    def finish(self) -> None:
        """Write the summary: nothing may be added any more."""
        self.end_chunk()
        out = bytearray(_record(Opcode.DATA_END, bytes(4)))
        start = self._file.tell() + len(out)
        summary, offsets = bytearray(), bytearray()
        written = self._written
        groups = {
            Opcode.SCHEMA: written.schemas,
            Opcode.CHANNEL: written.channels,
            Opcode.STATISTICS: [self._statistics()],
            Opcode.CHUNK_INDEX: written.chunks,
            Opcode.ATTACHMENT_INDEX: written.attachments,
            Opcode.METADATA_INDEX: written.metadata,
        }
        for opcode, records in groups.items():
            if records:
                group = b"".join(records)
                entry = struct.pack("<BQQ", opcode, start + len(summary), len(group))
                offsets += _record(Opcode.SUMMARY_OFFSET, entry)
                summary += group
        foot = _RECORD.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", start, start + len(summary))
        summary += offsets
        summary += foot
        self._file.write(out + summary + struct.pack("<I", zlib.crc32(summary)) + MAGIC)

    def rescue(self, name: str, facts: Mapping[str, str]) -> bool:
        """After a failed write: finish the file with what fits, and metadata `name` that says so.

        Gives up chunks from the end until the index fits; False if that does not help: the file then ends after a
        whole chunk if it can be cut there, and is readable without an index.
        """
        while self._marks:
            if not self._return_to(self._marks.pop()):
                return False
            position = self._file.tell()
            try:
                self.add_metadata(name, facts)
                self.finish()
            except LogError:
                self._file.cut(position)
            else:
                return True
        return False

    def _return_to(self, mark: _Mark) -> bool:
        self._begin_chunk()
        written = self._written
        del written.chunks[mark.chunks :], written.attachments[mark.attachments :], written.metadata[mark.metadata :]
        # Of channels that came later, none.
        written.counts = dict.fromkeys(written.counts, 0) | mark.counts
        written.start_time, written.end_time = mark.start_time, mark.end_time
        return self._file.cut(mark.position)

    def _begin_chunk(self) -> None:
        self._chunk = bytearray()
        self._index = {number: bytearray() for number in range(1, len(self._written.channels) + 1)}
        self._start_time, self._end_time = _NO_TIMES

    def _statistics(self) -> bytes:
        written = self._written
        counts = {channel: count for channel, count in written.counts.items() if count}
        total = sum(counts.values())
        fields = struct.pack(
            "<QHIIIIQQ",
            total,
            len(written.schemas),
            len(written.channels),
            len(written.attachments),
            len(written.metadata),
            len(written.chunks),
            written.start_time if total else 0,
            written.end_time,
        )
        by_channel = b"".join(struct.pack("<HQ", *pair) for pair in sorted(counts.items()))
        return _record(Opcode.STATISTICS, fields + _block("I", by_channel))


def _record(opcode: Opcode, content: bytes) -> bytes:
    return _RECORD.pack(opcode, len(content)) + content


def _block(length_format: str, data: bytes | bytearray) -> bytes:
    return struct.pack("<" + length_format, len(data)) + data


def _text(text: str) -> bytes:
    """Return a string preceded by its length; the name of a file need not be UTF-8."""
    return _block("I", text.encode("utf-8", "replace"))


def _mapping(pairs: Mapping[str, str]) -> bytes:
    return _block("I", b"".join(_text(key) + _text(value) for key, value in pairs.items()))


def _compression() -> tuple[str, Callable[[bytearray], bytes]]:
    try:
        import zstandard
    except ImportError:
        return "", bytes
    # Numbers of a smooth motion hardly shrink further at higher levels.
    return "zstd", zstandard.ZstdCompressor(level=1).compress
