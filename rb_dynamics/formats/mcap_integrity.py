"""`verify`: check a finished MCAP file with the reader of the package mcap, which is independent of ours."""

from __future__ import annotations

import contextlib
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from rb_dynamics.errors import LogError, needing
from rb_dynamics.formats.bag_source import SplitBag, bag_facts, open_source
from rb_dynamics.formats.mcap_records import MAGIC, MAX_RECORD_BYTES, Opcode
from rb_dynamics.formats.rosbag2_metadata import METADATA_FILE
from rb_dynamics.numerics.argument_checks import shown

if TYPE_CHECKING:
    from mcap.records import Chunk, Footer, Message

# Of a record, before its content.
_HEAD_BYTES = 9
# Of an index of messages, up to the number of its channel.
_INDEX_BYTES = _HEAD_BYTES + 2
_CHECKSUM = struct.Struct("<I")


def require_library(purpose: str) -> None:
    """Check that the package mcap is installed.

    Raises:
        MissingExtraError: it is not.
    """
    with needing("mcap", "log", purpose):
        import mcap.reader  # noqa: F401


def verify_bag(path: Path) -> int:
    """Return how many messages a bag holds, after `verify` of each of its files and of what its `metadata.yaml` says.

    Raises:
        LogError: as `verify`, or a file is not MCAP.
        MissingExtraError: the package mcap is not installed.
    """
    source = open_source(path)
    files = source.files if isinstance(source, SplitBag) else [source.path]
    if any(file.suffix in (".db3", ".zstd") for file in files):
        raise LogError(f"cannot verify {path}: it is no MCAP bag, expected .mcap; leave out --verify")
    found = [_verified(file) for file in files]
    if path.is_dir():
        with contextlib.suppress(FileNotFoundError):
            _require_told(path / METADATA_FILE, bag_facts(path).totals, found)
    return sum(read.messages.total() for read in found)


def _require_told(path: Path, told: Sequence[object], found: Sequence[_Read]) -> None:
    """Check number and times of the messages against `metadata.yaml`.

    Raises:
        LogError: they differ.
    """
    spoken = [read for read in found if read.messages]
    begin_ns, end_ns = min((r.begin_ns for r in spoken), default=0), max((r.end_ns for r in spoken), default=0)
    there = (sum(read.messages.total() for read in found), begin_ns, end_ns - begin_ns)
    for what, number, claimed in zip(("messages", "ns at the start", "ns of duration"), there, told, strict=True):
        # A file without messages has no times.
        if claimed not in (None, number) and (spoken or what == "messages"):
            raise LogError(
                f"{path} says {shown(claimed)} {what}, the files beside it have {number}; make it again with "
                "`rb-dynamics recover`"
            )


def verify(path: Path, written: Mapping[str, int] | None = None) -> int:
    """Read all of a finished MCAP file, front to back and again by its index, and return how many messages it holds.

    Every checksum must match, indexes and statistics must agree with the content, and in logs of this package no log
    time may be earlier than the one before it. A file without indexes of the messages in its chunks is whole, too.

    Args:
        path: the file.
        written: number of messages expected, by topic; None if unknown.

    Raises:
        LogError: something is not so; says what.
        MissingExtraError: the package mcap is not installed.
    """
    return _verified(path, written).messages.total()


def _verified(path: Path, written: Mapping[str, int] | None = None) -> _Read:
    require_library(f"verifying {path}")
    try:
        with path.open("rb") as file:
            found = _front_to_back(file)
            faults = list(_faults(file, found, written))
    except OSError as error:
        raise LogError(f"cannot read {path}: {error.strerror or error}; check the path") from error
    except Exception as error:  # a reader of malformed files may raise anything
        raise _unlike(path, f"the package mcap cannot read it ({type(error).__name__}: {error})") from error
    if faults:
        raise _unlike(path, "; ".join(faults))
    return found


def _unlike(path: Path, faults: str) -> LogError:
    return LogError(
        f"{path} does not read back as it should: {faults}. Save what can be read with `rb-dynamics recover`, or run "
        "again, and check the disk if that helps nothing"
    )


@dataclass
class _Read:
    """The content of the file, in its order.

    Attributes:
        messages: by number of the channel.
        records: by kind; those in chunks are not counted.
        begin_ns, end_ns: first and last log time, ns.
        sorted: whether no log time is earlier than the one before it.
        library: that wrote the file, as its header says.
        footer: None if there is none.
        misled: number of chunks whose messages are not all where the indexes behind it say, or not at that time.
    """

    messages: Counter[int] = field(default_factory=Counter)
    records: Counter[str] = field(default_factory=Counter)
    begin_ns: int = 2**64
    end_ns: int = 0
    sorted: bool = True
    library: str = ""
    footer: Footer | None = None
    misled: int = 0
    _last_ns: int = 0

    def add(self, message: Message) -> None:
        self.sorted = self.sorted and message.log_time >= self._last_ns
        self.messages[message.channel_id] += 1
        self.begin_ns, self.end_ns = min(self.begin_ns, message.log_time), max(self.end_ns, message.log_time)
        self._last_ns = message.log_time


def _front_to_back(file: BinaryIO) -> _Read:
    from mcap.records import Chunk, Footer, Header, Message, MessageIndex
    from mcap.stream_reader import StreamReader

    found = _Read()
    # Channel, log time and place of the messages of the last chunk, less those of its indexes: these follow it.
    places: set[tuple[int, int, int]] = set()
    reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES)
    for record in reader.records:
        found.records[type(record).__name__] += 1
        if isinstance(record, MessageIndex):
            places ^= {(record.channel_id, time_ns, place) for time_ns, place in record.records}
            continue
        found.misled += bool(places)
        places = set()
        if isinstance(record, Chunk):
            for place, inner in _messages(record):
                found.add(inner)
                places.add((inner.channel_id, inner.log_time, place))
        elif isinstance(record, Message):
            found.add(record)
        elif isinstance(record, Header):
            found.library = record.library
        elif isinstance(record, Footer):
            found.footer = record
    return found


def _messages(chunk: Chunk) -> Iterator[tuple[int, Message]]:
    """Yield each message of a chunk with its place: where its record begins in the uncompressed data."""
    from mcap.records import Message
    from mcap.stream_reader import get_chunk_data_stream

    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    while (place := stream.count) < size:
        opcode, length = stream.read1(), stream.read8()
        if opcode == Opcode.MESSAGE:
            yield place, Message.read(stream, length)
        else:
            stream.read(length)


def _faults(file: BinaryIO, found: _Read, written: Mapping[str, int] | None) -> Iterator[str]:
    from mcap.reader import make_reader

    file.seek(0)
    reader = make_reader(file, validate_crcs=True)
    summary = reader.get_summary()
    if summary is None or summary.statistics is None or found.footer is None:
        yield "it has no summary with statistics"
        return
    if not found.sorted and found.library.startswith("rb_dynamics"):
        yield "a log time is before the one in front of it"
    names = {number: channel.topic for number, channel in summary.channels.items()}
    said = summary.statistics
    told = Counter(said.channel_message_counts)
    yield from _differing("its statistics say otherwise", _by_topic(names, found.messages), _by_topic(names, told))
    by_index = Counter(message.channel_id for _, _, message in reader.iter_messages())
    yield from _differing("its index leads elsewhere", _by_topic(names, found.messages), _by_topic(names, by_index))
    indexes = [entry for chunk in summary.chunk_indexes for entry in chunk.message_index_offsets.items()]
    if found.misled and (indexes or found.records["MessageIndex"]):
        yield f"the index of messages leads elsewhere in {found.misled} of {found.records['Chunk']} chunks"
    astray = sum(not _begins_index(_bytes(file, place, place + _INDEX_BYTES), number) for number, place in indexes)
    if astray:
        yield f"its summary leads elsewhere than to {astray} of {len(indexes)} indexes of messages"
    if written is not None:
        yield from _differing("other was written", _by_topic(names, found.messages), Counter(written))
    facts = {
        "messages": (found.messages.total(), said.message_count),
        "chunks": (found.records["Chunk"], said.chunk_count),
        "chunks in the index": (found.records["Chunk"], len(summary.chunk_indexes)),
        "indexes of messages": (found.records["MessageIndex"], len(indexes)),
        "attachments": (found.records["Attachment"], said.attachment_count),
        "attachments in the index": (found.records["Attachment"], len(summary.attachment_indexes)),
        "metadata records": (found.records["Metadata"], said.metadata_count),
        "metadata records in the index": (found.records["Metadata"], len(summary.metadata_indexes)),
        "channels": (len(summary.channels), said.channel_count),
        "schemas": (len(summary.schemas), said.schema_count),
    }
    if found.messages:
        facts["ns, the first log time"] = found.begin_ns, said.message_start_time
        facts["ns, the last log time"] = found.end_ns, said.message_end_time
    for what, (there, claimed) in facts.items():
        if there != claimed:
            yield f"{there} {what}, and its summary says {claimed}"
    # The library does not check these two checksums.
    for index in summary.attachment_indexes:
        if not _fits(_bytes(file, index.offset, index.offset + index.length)[_HEAD_BYTES:]):
            yield f"the checksum of the attachment {index.name} does not fit"
    end = file.seek(0, 2) - len(MAGIC)
    if not _fits(_bytes(file, found.footer.summary_start, end)):
        yield "the checksum of its summary does not fit"


def _by_topic(names: Mapping[int, str], counts: Mapping[int, int]) -> Counter[str]:
    found: Counter[str] = Counter()
    for number, count in counts.items():
        found[names.get(number, f"channel {number}")] += count
    return found


def _differing(why: str, found: Counter[str], claimed: Counter[str]) -> Iterator[str]:
    differing = sorted(topic for topic in found | claimed if found[topic] != claimed[topic])
    if differing:
        yield f"{why}: " + ", ".join(f"{topic}: {found[topic]} of {claimed[topic]} messages" for topic in differing)


def _begins_index(data: bytes, channel: int) -> bool:
    """Return whether `data` begins an index of the messages of a channel: opcode, length, number of the channel."""
    return data[:1] == bytes([Opcode.MESSAGE_INDEX]) and data[_HEAD_BYTES:] == channel.to_bytes(2, "little")


def _bytes(file: BinaryIO, begin: int, end: int) -> bytes:
    file.seek(begin)
    return file.read(end - begin)


def _fits(data: bytes) -> bool:
    """Return whether the checksum at the end of `data` is that of the bytes before it; 0 means that there is none."""
    (checksum,) = _CHECKSUM.unpack(data[-_CHECKSUM.size :])
    return checksum in (0, zlib.crc32(data[: -_CHECKSUM.size]))
