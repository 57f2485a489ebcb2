"""`open_source`: the messages of any ROS 2 bag: an MCAP file or a rosbag2 folder, split or compressed, MCAP or SQLite.

MCAP is read here, SQLite by the package rosbags.
"""

from __future__ import annotations

import contextlib
import io
import math
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import index
from pathlib import Path
from typing import Any, BinaryIO, Protocol, TypeAlias, TypeVar

from rb_dynamics.errors import LogError, SceneError, needing
from rb_dynamics.formats.log_metadata import (
    CUT_OFF,
    DAMAGED,
    INTERRUPTED,
    MISSING_FILES,
    RESULT,
    next_file,
    with_earlier,
)
from rb_dynamics.formats.mcap_records import (
    MAX_RECORD_BYTES,
    McapChannel,
    McapFile,
    Message,
    MessageBlock,
    OnFact,
    Schema,
    in_blocks,
    require_file,
)
from rb_dynamics.formats.rosbag2_metadata import METADATA_FILE
from rb_dynamics.formats.yaml.document import MAX_CHARACTERS, load

# Numbers that are farther apart are no numbers of files of one bag.
_MOST_SKIPPED = 1000
# Name, number and suffix of a file of several, as rosbag2 names them.
_NUMBERED = re.compile(r"(.*_)(0|[1-9][0-9]{0,9})(\.\w+)")
# Bytes given to zstd at once.
_PACKED_BYTES = 4096


@dataclass(frozen=True)
class FileBoundary:
    """Where one file of a bag ends and the next begins: their names, and the log times (ns) there."""

    before: str
    after: str
    end_ns: int
    begin_ns: int


class Source(Protocol):
    """A bag, like `McapFile`: the attributes after `path` are complete when `messages` or `blocks` has run."""

    path: Path
    complete: bool
    metadata: dict[str, dict[str, str]]
    attachments: dict[str, bytes]

    @property
    def channels(self) -> Mapping[Any, McapChannel]:
        """Channels, by whatever distinguishes them."""

    def messages(self) -> Iterator[Message]:
        """Yield every message in the order of the bag."""

    def blocks(self) -> Iterator[MessageBlock]:
        """Yield every message in blocks of one channel, those of each channel in the order of the bag."""


def open_source(path: str | Path, on_fact: OnFact | None = None) -> Source:
    """Return the bag at `path`: a file, or a folder as rosbag2 writes it; `on_fact` as in `McapFile`.

    Raises:
        LogError: a folder holds no bag, or a file is only the `metadata.yaml` of one.
    """
    path = Path(path)
    if path.name == METADATA_FILE and path.is_file():
        raise LogError(f"{path} only says which files a bag has, expected the bag; give the folder: {path.parent}")
    if not path.is_dir():
        return _opened(path, on_fact=on_fact)
    mode, files, begins_ns = _files(path)
    there = sorted(each.name for each in path.iterdir() if each.suffix in (".db3", ".mcap"))
    if any(file.exists() for file in files):
        _require_named(path, files, there)
        found = in_time([file for file in files if file.exists()], begins_ns, mode)
        return SplitBag(path, found, mode, on_fact, absent_before(files), min(begins_ns.values(), default=None))
    if files and not there:
        raise LogError(
            f"{path} has none of the files that its {METADATA_FILE} names: {files[0]} is missing; check the path"
        )
    if files:
        raise LogError(
            f"{path} has none of the files that its {METADATA_FILE} names ({files[0].name}), but {there[0]}: it was "
            f"renamed; give {path / there[0]} itself, or correct the name"
        )
    itself = f"; give {path / there[0]} itself" if there else ""
    raise LogError(
        f"{path} holds no bag: expected {METADATA_FILE} or .mcap files in it, as `ros2 bag record` leaves them{itself}"
    )


def absent_before(files: Sequence[Path]) -> dict[Path | None, list[str]]:
    """Return the names of those that are not there, by the next one that is; None behind the last."""
    absent: dict[Path | None, list[str]] = {}
    lacking: list[str] = []
    for file in (*files, None):
        if file is not None and not file.exists():
            lacking.append(file.name)
        elif lacking:
            absent[file], lacking = lacking, []
    return absent


def in_time(files: Sequence[Path], begins_ns: Mapping[Path, int], compression: str) -> list[Path]:
    """Return the files of a bag in the order of their first log times, equal ones and those without in their own.

    These are as the metadata say, `begins_ns`, or as the files do; not where it would take to unpack a whole file.
    """
    if len(files) < 2:
        return list(files)
    begin_ns, found = -math.inf, list[tuple[float, Path]]()
    for file in files:
        known = begins_ns.get(file)
        if known is None and compression != "file":
            known = _first_log_time(file)
        begin_ns = begin_ns if known is None else known
        found.append((begin_ns, file))
    return [file for _, file in sorted(found, key=lambda each: each[0])]


def _first_log_time(path: Path) -> int | None:
    """Return that of a file; None without a message, or where it cannot be read, which whoever reads it learns."""
    with contextlib.suppress(LogError):
        return next((message.log_time for message in _opened(path, part=True).messages()), None)
    return None


def _require_named(path: Path, files: Sequence[Path], there: Sequence[str]) -> None:
    """Refuse files that differ from those of a bag only in their number.

    Raises:
        LogError: there are some, which the metadata do not name.
    """
    named = {file.name for file in files}
    series = {_NUMBERED.sub(r"\1\3", name) for name in named if _NUMBERED.fullmatch(name)}
    more = [name for name in there if name not in named and _NUMBERED.sub(r"\1\3", name) in series]
    if more:
        raise LogError(
            f"{path} holds {', '.join(more[:5])}, which its {METADATA_FILE} does not name, expected only files that it "
            f"names; remove {METADATA_FILE}, and all are read in the order of their numbers, or move them elsewhere"
        )


def _opened(path: Path, part: bool = False, on_fact: OnFact | None = None) -> McapFile | DatabaseFile:
    return DatabaseFile(path) if path.suffix == ".db3" else McapFile(path, part=part, on_fact=on_fact)


@dataclass
class SplitBag:
    """Several files that are one bag, read one after the other.

    Of facts of one name the later is kept, and the result is that of the last file, as no other is the end. All losses
    are reported; what an earlier file lacks at its end, and a file that is not there, count as a piece that is missing
    in between.

    Attributes:
        path: the folder.
        files: in the order of their times.
        absent: names of files that the metadata name and that are not there, each by the file that follows; by None
            those after the last.
        begin_ns: first log time of the whole bag, where its metadata say it.
        compression: "none", "file" (each as a whole) or "message" (each message).
        on_fact: as in `McapFile`.
        boundaries: where one file ends and the next begins, where nothing is known to be missing between them.
    """

    path: Path
    files: list[Path]
    compression: str = "none"
    on_fact: OnFact | None = None
    absent: Mapping[Path | None, list[str]] = field(default_factory=dict)
    begin_ns: int | None = None
    complete: bool = False
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    channels: dict[str, McapChannel] = field(default_factory=dict)
    boundaries: list[FileBoundary] = field(default_factory=list)

    def messages(self) -> Iterator[Message]:
        """Yield every message of every file.

        Raises:
            LogError: as `McapFile.messages`, or something in a file is damaged that is compressed.
        """
        if self.compression == "message":
            yield from map(self._unpacked, self._read(lambda file: file.messages()))
        else:
            yield from self._read(lambda file: file.messages())

    def blocks(self) -> Iterator[MessageBlock]:
        """Yield every message of every file, in blocks of one channel.

        Raises:
            LogError: as `messages`.
        """
        yield from (
            in_blocks(self.messages()) if self.compression == "message" else self._read(lambda file: file.blocks())
        )

    def _read(self, read: Callable[[_File], Iterator[_Read]]) -> Iterator[_Read]:
        before: _File | None = None
        complete = True
        for path in self.files:
            with self._whole(path) as file:
                yield from read(file)
            complete = complete and file.complete
            lost = self.metadata.get(INTERRUPTED, {})
            absent = self.absent.get(path, [])
            if before is None and absent:
                lost = {**lost, "reason": DAMAGED, MISSING_FILES: ", ".join(absent)}
                if self.begin_ns is not None and file.span_ns:
                    lost["missing_ns"] = f"{self.begin_ns} {file.span_ns[0]}"
            elif before is not None:
                absent = absent or absent_between(before.path, file.path, next_file(before.metadata), self.files)
                lost = _between(before, file, lost, absent)
                self.boundaries += [] if absent else _boundary(before, file)
            lost = joined_losses(lost, file.metadata.get(INTERRUPTED, {}))
            self.metadata.pop(RESULT, None)
            told = {name: with_earlier(name, self.metadata.get(name), facts) for name, facts in file.metadata.items()}
            self.metadata.update(told | ({INTERRUPTED: lost} if lost else {}))
            self.attachments.update(file.attachments)
            self.channels.update({channel.topic: channel for channel in file.channels.values()})
            before = file
        if (absent := self.absent.get(None, [])) and not next_file(self.metadata):
            lost = joined_losses(self.metadata.get(INTERRUPTED, {}), {MISSING_FILES: ", ".join(absent)})
            self.metadata[INTERRUPTED] = {**lost, "reason": CUT_OFF}
        self.complete = complete

    @contextlib.contextmanager
    def _whole(self, path: Path) -> Iterator[_File]:
        """Open a file of the bag, unpacked where it is compressed as a whole."""
        if self.compression != "file":
            yield _opened(path, part=True, on_fact=self.on_fact)
            return
        with tempfile.TemporaryDirectory() as folder:
            unpacked = Path(folder, path.stem)
            _unpack(path, unpacked)
            try:
                yield _opened(unpacked, part=True, on_fact=self.on_fact)
            except LogError as error:
                raise type(error)(str(error).replace(str(unpacked), str(path))) from error

    def _unpacked(self, message: Message) -> Message:
        data, fault = bytearray(), ""
        try:
            for part in _zstd_parts(io.BytesIO(message.data)):
                data += part
                if len(data) > MAX_RECORD_BYTES:
                    fault = f"unpacks to more than {MAX_RECORD_BYTES} bytes"
                    break
        except ValueError as error:
            fault = f"cannot be unpacked ({error})"
        if fault:
            where = f"on {message.channel.topic}, log time {message.log_time} ns,"
            raise LogError(f"{self.path} is damaged: a message {where} {fault}; record it again")
        return message._replace(data=bytes(data))


def absent_between(before: Path, after: Path, following: str, files: Sequence[Path]) -> list[str]:
    """Return the names of the files of a bag that are not there between two of its `files`.

    `following` is the name of the next file as the first says it; where it does not, the numbers of rosbag2 tell.
    """
    if following:
        return [following] if following != after.name else []
    named = [_NUMBERED.fullmatch(each.name) for each in (before, after)]
    if (one := named[0]) is None or (other := named[1]) is None:
        return []
    name, suffix = one[1], one[3]
    skipped = range(int(one[2]) + 1, int(other[2]))
    there = {file.name for file in files}
    if (other[1], other[3]) != (name, suffix) or f"{name}0{suffix}" not in there or len(skipped) > _MOST_SKIPPED:
        return []
    return [absent for number in skipped if (absent := f"{name}{number}{suffix}") not in there]


def _cut(file: _File) -> bool:
    """Return whether the end of a file is missing, in a recovered copy too."""
    reason = file.metadata.get(INTERRUPTED, {}).get("reason", DAMAGED)
    return not file.complete or reason != DAMAGED


def _boundary(before: _File, after: _File) -> list[FileBoundary]:
    """Return how `after` follows `before`, if nothing of that one is known to be missing."""
    if before.span_ns is None or after.span_ns is None or _cut(before):
        return []
    return [FileBoundary(before.path.name, after.path.name, before.span_ns[1], after.span_ns[0])]


def _between(before: _File, after: _File, lost: dict[str, str], files: list[str]) -> dict[str, str]:
    """Return what was `lost` up to `before` and between it and `after`, the file behind it, without these `files`."""
    absent = {MISSING_FILES: ", ".join(files)} if files else {}
    if not (absent or _cut(before)):
        return lost
    hole = {"missing_ns": f"{before.span_ns[1]} {after.span_ns[0]}"} if before.span_ns and after.span_ns else {}
    # For the whole bag this was not the end: later messages are there.
    return {**joined_losses(lost, {**hole, **absent}), "reason": DAMAGED}


def joined_losses(one: Mapping[str, str], other: Mapping[str, str]) -> dict[str, str]:
    """Return what was lost in two files of a bag, or twice in one; of facts about the same thing the later."""
    lists = {"reason": " and ", "missing_ns": ", ", MISSING_FILES: ", "}
    texts = {
        key: [part for each in (one, other) for part in each.get(key, "").split(by) if part]
        for key, by in lists.items()
    }
    return {**one, **other, **{key: lists[key].join(dict.fromkeys(found)) for key, found in texts.items() if found}}


@dataclass
class DatabaseFile:
    """One SQLite file, as rosbags reads it."""

    path: Path
    complete: bool = False
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    channels: dict[int, McapChannel] = field(default_factory=dict)
    span_ns: tuple[int, int] | None = None

    def messages(self) -> Iterator[Message]:
        """Yield every message; its publish time is its log time.

        Raises:
            LogError: the file cannot be read.
            MissingExtraError: rosbags is not installed.
        """
        with needing("rosbags", "log", f"reading {self.path}"):
            from rosbags.rosbag2 import Reader
        require_file(self.path)
        try:
            _require_finished(self.path)
            with Reader(self.path) as reader:
                self.channels = {
                    each.id: McapChannel(_name(each.topic), _schema(each), _encoding(each), {})
                    for each in reader.connections
                }
                for connection, time_ns, data in reader.messages():
                    at = index(time_ns)
                    # A cell of SQLite is of any type, and bytes() of a number is that many zeros.
                    yield Message(self.channels[connection.id], at, at, bytes(memoryview(data)))
                    self.span_ns = at if self.span_ns is None else self.span_ns[0], at
        except LogError:
            raise
        except Exception as error:  # a reader of malformed files may raise anything
            raise _unreadable(self.path, error) from error
        self.complete = True

    def blocks(self) -> Iterator[MessageBlock]:
        """Yield every message, in blocks of one channel.

        Raises:
            LogError: as `messages`; likewise MissingExtraError.
        """
        return in_blocks(self.messages())


_File: TypeAlias = McapFile | DatabaseFile
_Read = TypeVar("_Read", Message, MessageBlock)


def _require_finished(path: Path) -> None:
    """Refuse a database whose last messages are in a file beside it, as of a recorder that was killed.

    Raises:
        LogError: they are.
    """
    for beside in (path.with_name(f"{path.name}{end}") for end in ("-wal", "-journal")):
        with contextlib.ExitStack() as opened:
            # SQLite fills the head of one that is done with with zeros.
            if beside.exists() and opened.enter_context(beside.open("rb")).read(8).strip(b"\0"):
                raise LogError(
                    f"{path} is not finished: {beside.name} holds messages of it, expected none; once the recorder has "
                    f"ended, merge them with: sqlite3 {path} 'SELECT count(*) FROM messages'"
                )


def _schema(connection: Any) -> Schema:
    """Return the type, with its definition where the bag has it: before ROS 2 Iron none had."""
    definition = getattr(connection.msgdef, "data", "")
    return Schema(_name(connection.msgtype), "ros2msg" if definition else "", _name(definition).encode())


def _encoding(connection: Any) -> str:
    return _name(connection.ext.serialization_format)


def _unreadable(path: Path, error: Exception) -> LogError:
    reason = str(error).rstrip(".") or type(error).__name__
    return LogError(f"cannot read {path}: {reason}; check the path, and give a bag as `ros2 bag record` leaves it")


def _name(found: object) -> str:
    """Return a name as recorded in a bag.

    Raises:
        TypeError: it is not text.
    """
    if not isinstance(found, str):
        raise TypeError(f"found {found!r} where a name should stand")
    return found


def in_order(folder: Path) -> list[Path]:
    """Return the MCAP files of a folder by the numbers in their names, as recorders number them."""
    return sorted(folder.glob("*.mcap"), key=by_number)


def by_number(file: Path) -> tuple[list[int], Path]:
    """Return the key of files in the order of the numbers in their names."""
    return [int(part) for part in re.findall(r"\d+", file.stem)], file


def _files(folder: Path) -> tuple[str, list[Path], Mapping[Path, int]]:
    """Return how a bag is compressed, its files, by number without metadata, and when they begin as metadata say it.

    Raises:
        LogError: its metadata are damaged.
    """
    try:
        facts = bag_facts(folder)
    except FileNotFoundError:
        return "none", in_order(folder), {}
    return facts.compression, facts.files, facts.begins_ns


@dataclass(frozen=True)
class BagFacts:
    """The content of the `metadata.yaml` of a bag.

    Attributes:
        compression: "none", "file" or "message".
        files: as they are listed.
        begins_ns: first log time of each file with messages, where it is said.
        totals: number of messages, first log time (ns) and duration (ns); None for what it does not say.
    """

    compression: str
    files: list[Path]
    begins_ns: dict[Path, int]
    totals: tuple[Any, Any, Any]


def bag_facts(folder: Path) -> BagFacts:
    """Return the content of the metadata of a bag.

    Raises:
        FileNotFoundError: it has none.
        LogError: they are damaged.
    """
    path = folder / METADATA_FILE
    try:
        # One byte more than the longest text that is read: if it is there, the text is too long.
        with path.open("rb") as file:
            data = file.read(4 * MAX_CHARACTERS + 1)
        document: Any = load(data.decode("utf-8"), METADATA_FILE, "list of the files of a bag")
        facts = document["rosbag2_bagfile_information"]
        files = [folder / _file_name(path) for path in facts["relative_file_paths"]]
        start, duration = facts.get("starting_time") or {}, facts.get("duration") or {}
        times = start.get("nanoseconds_since_epoch"), duration.get("nanoseconds")
        compression = str(facts.get("compression_mode") or "none").lower()
        begins_ns = {
            folder / _file_name(each["path"]): index(each["starting_time"]["nanoseconds_since_epoch"])
            for each in facts.get("files") or ()
            if each["message_count"]
        }
        return BagFacts(compression, files, begins_ns, (facts.get("message_count"), *times))
    except FileNotFoundError:
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError, SceneError) as error:
        reason = str(error) if isinstance(error, SceneError) else repr(error)
        raise LogError(
            f"{path} is not what rosbag2 writes ({reason}); remove it, and the .mcap files are read in the order of "
            "their numbers"
        ) from error


def _file_name(path: str) -> str:
    """Return the name of a file without its folder.

    Raises:
        ValueError: a file cannot have such a name.
    """
    if "\0" in path:
        raise ValueError(f"the name {path!r} of a file")
    return Path(path).name


def _unpack(path: Path, target: Path) -> None:
    """Unpack a file that was compressed as a whole.

    Raises:
        LogError: there is no room for it, or it cannot be read.
        MissingExtraError: zstandard is not installed.
    """
    room = shutil.disk_usage(target.parent).free
    try:
        with path.open("rb") as packed, target.open("wb") as file:
            for part in _zstd_parts(packed):
                room -= len(part)
                if room < 0:
                    raise LogError(
                        f"{path} does not fit into {tempfile.gettempdir()} when it is unpacked, expected room for it; "
                        "set TMPDIR to a folder with more"
                    )
                file.write(part)
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def _zstd_parts(packed: BinaryIO) -> Iterator[bytes]:
    """Yield what is in zstd frames, in parts of no more than some 100 MB: bytes of zeros shrink 30 000 times.

    Raises:
        ValueError: it is not zstd data, or is cut off.
        MissingExtraError: zstandard is not installed.
    """
    with needing("zstandard", "log", "reading a compressed bag"):
        import zstandard
    frame, count = None, 0
    try:
        while part := packed.read(_PACKED_BYTES):
            while part:
                if frame is None:
                    frame, count = zstandard.ZstdDecompressor().decompressobj(), count + 1
                yield frame.decompress(part)
                part, frame = (frame.unused_data, None) if frame.eof else (b"", frame)
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from error
    if frame is not None or not count:
        raise ValueError("what is compressed ends too soon")
