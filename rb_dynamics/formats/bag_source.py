"""`open_source`: the messages of any ROS 2 bag: an MCAP file or a rosbag2 folder, split or compressed, MCAP or SQLite.

MCAP is read here; SQLite, and files that rosbag2 compressed as a whole, by the package rosbags.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from operator import index
from pathlib import Path
from typing import Any, Protocol

from rb_dynamics.errors import LogError, MissingExtraError, SceneError
from rb_dynamics.formats.mcap_records import McapChannel, McapFile, Message, Schema
from rb_dynamics.formats.rosbag2_metadata import METADATA_FILE
from rb_dynamics.run.provenance import DAMAGED, INTERRUPTED, MISSING_FILES, RESULT, next_file
from rb_dynamics.scene.document import MAX_CHARACTERS, load


@dataclass(frozen=True)
class Joint:
    """Where one file of a bag ends and the next begins: their names, and the log times (ns) there."""

    before: str
    after: str
    end_ns: int
    begin_ns: int


class Source(Protocol):
    """A bag, as `McapFile` is one: what stands below `path` is there when `messages` has run."""

    path: Path
    complete: bool
    metadata: dict[str, dict[str, str]]
    attachments: dict[str, bytes]

    @property
    def channels(self) -> Mapping[Any, McapChannel]:
        """Channels, by whatever tells them apart."""

    def messages(self) -> Iterator[Message]:
        """Yield every message in the order of the bag."""


def open_source(path: str | Path) -> Source:
    """Return the bag at `path`: a file, or a folder as rosbag2 writes it.

    Raises:
        LogError: a folder holds no bag, or a file is only the `metadata.yaml` of one.
        MissingExtraError: it takes rosbags to read it, which is not installed.
    """
    path = Path(path)
    if path.name == METADATA_FILE and path.is_file():
        raise LogError(f"{path} only says which files a bag has, expected the bag; give the folder: {path.parent}")
    if not path.is_dir():
        return RosbagsSource(path) if path.suffix == ".db3" else McapFile(path)
    files = _files(path)
    if files and all(file.suffix == ".mcap" for file in files):
        return SplitMcap(path, files)
    if (path / METADATA_FILE).is_file():
        return RosbagsSource(path)
    raise LogError(
        f"{path} holds no bag: expected {METADATA_FILE} or .mcap files in it, as `ros2 bag record` leaves them"
    )


@dataclass
class SplitMcap:
    """Several MCAP files that are one bag, read one after the other.

    Of facts of one name the later stands, and the result is that of the last file: an earlier one's is no end. What was
    lost is all told; what an earlier file lacks at its end, and a file that is not there, are a piece that is missing
    in between.
    """

    path: Path
    files: list[Path]
    complete: bool = False
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    channels: dict[str, McapChannel] = field(default_factory=dict)
    joints: list[Joint] = field(default_factory=list)

    def messages(self) -> Iterator[Message]:
        """Yield every message of every file.

        Raises:
            LogError: as `McapFile.messages`.
        """
        before: _Part | None = None
        complete = True
        for path in self.files:
            file = McapFile(path, part=True)
            part = _Part(file)
            yield from part.messages()
            complete = complete and file.complete
            lost = self.metadata.get(INTERRUPTED, {})
            if before is not None:
                lost = _between(before, part, lost)
                self.joints += _joint(before, part)
            lost = _joined(lost, file.metadata.get(INTERRUPTED, {}))
            self.metadata.pop(RESULT, None)
            self.metadata.update(file.metadata | ({INTERRUPTED: lost} if lost else {}))
            self.attachments.update(file.attachments)
            self.channels.update({channel.topic: channel for channel in file.channels.values()})
            before = part
        self.complete = complete


@dataclass
class _Part:
    """One file of several, and the log times (ns) of its first and last message once they have been read."""

    file: McapFile
    begin_ns: int | None = None
    end_ns: int | None = None

    def messages(self) -> Iterator[Message]:
        messages = self.file.messages()
        message = next(messages, None)
        if message is None:
            return
        self.begin_ns = message.log_time
        yield message
        for message in messages:
            yield message
        self.end_ns = message.log_time

    @property
    def cut(self) -> bool:
        """Whether its end is missing, in a recovered copy too."""
        reason = self.file.metadata.get(INTERRUPTED, {}).get("reason", DAMAGED)
        return not self.file.complete or reason != DAMAGED


def _joint(before: _Part, after: _Part) -> list[Joint]:
    """Return how `after` follows `before`, where nothing is known to be missing between them."""
    absent = next_file(before.file.metadata) not in ("", after.file.path.name)
    if before.end_ns is None or after.begin_ns is None or absent or before.cut:
        return []
    return [Joint(before.file.path.name, after.file.path.name, before.end_ns, after.begin_ns)]


def _between(before: _Part, after: _Part, lost: dict[str, str]) -> dict[str, str]:
    """Return what was `lost` up to `before` and between it and `after`, the file behind it."""
    expected = next_file(before.file.metadata) or after.file.path.name
    absent = {MISSING_FILES: expected} if expected != after.file.path.name else {}
    if not (absent or before.cut):
        return lost
    known = before.end_ns is not None and after.begin_ns is not None
    hole = {"missing_ns": f"{before.end_ns} {after.begin_ns}"} if known else {}
    # Seen from the whole bag that was no end: what comes later is there.
    return {**_joined(lost, {**hole, **absent}), "reason": DAMAGED}


def _joined(one: Mapping[str, str], other: Mapping[str, str]) -> dict[str, str]:
    """Return what was lost in both of two files of a bag; of facts that are one thing the later."""
    lists = {"reason": " and ", "missing_ns": ", ", MISSING_FILES: ", "}
    texts = {key: [each[key] for each in (one, other) if each.get(key)] for key in lists}
    return {**one, **other, **{key: lists[key].join(dict.fromkeys(found)) for key, found in texts.items() if found}}


@dataclass
class RosbagsSource:
    """A bag in any format that rosbags reads."""

    path: Path
    complete: bool = False
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    channels: dict[int, McapChannel] = field(default_factory=dict)

    def messages(self) -> Iterator[Message]:
        """Yield every message; its publish time is its log time.

        Raises:
            LogError: the bag cannot be read.
        """
        try:
            from rosbags.rosbag2 import Reader
        except ImportError:
            raise MissingExtraError("rosbags", "log", f"reading {self.path}") from None
        try:
            if self.path.is_dir():
                _require_room(self.path)
            with Reader(self.path) as reader:
                self.channels = {
                    each.id: McapChannel(_name(each.topic), Schema(_name(each.msgtype)), "cdr", {})
                    for each in reader.connections
                }
                for connection, time_ns, data in reader.messages():
                    at = index(time_ns)
                    # A cell of SQLite is of any type, and bytes() of a number is that many zeros.
                    yield Message(self.channels[connection.id], at, at, bytes(memoryview(data)))
        except LogError:
            raise
        except Exception as error:  # a reader of malformed files may raise anything
            reason = str(error).rstrip(".") or type(error).__name__
            raise LogError(
                f"cannot read {self.path}: {reason}; check the path, and give a bag as `ros2 bag record` leaves it"
            ) from error
        self.complete = True


def _name(found: object) -> str:
    """Return a name as it stands in a bag.

    Raises:
        TypeError: it is no text.
    """
    if not isinstance(found, str):
        raise TypeError(f"found {found!r} where a name should stand")
    return found


def in_order(folder: Path) -> list[Path]:
    """Return the MCAP files of a folder by the numbers in their names, as recorders number them."""
    return sorted(folder.glob("*.mcap"), key=lambda file: ([int(part) for part in re.findall(r"\d+", file.stem)], file))


def _files(folder: Path) -> list[Path]:
    """Return the files of a bag in their order; those that a recorder left without metadata by number.

    Empty where they are compressed as a whole or message by message.
    """
    try:
        mode, files = _compression(folder)
        return [] if mode != "none" else files
    except FileNotFoundError:
        return in_order(folder)


def _compression(folder: Path) -> tuple[str, list[Path]]:
    """Return how a bag is compressed ("none", "file" or "message") and which files it has.

    Raises:
        FileNotFoundError: it has no metadata.
        LogError: they are damaged.
    """
    path = folder / METADATA_FILE
    try:
        # One byte more than the longest text that is read: then it is too long, whatever is behind.
        with path.open("rb") as file:
            data = file.read(4 * MAX_CHARACTERS + 1)
        document: Any = load(data.decode("utf-8"), METADATA_FILE, "list of the files of a bag")
        facts = document["rosbag2_bagfile_information"]
        files = [folder / _file_name(path) for path in facts["relative_file_paths"]]
        return str(facts.get("compression_mode") or "none").lower(), files
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
        ValueError: no file has such a name.
    """
    if "\0" in path:
        raise ValueError(f"the name {path!r} of a file")
    return Path(path).name


def _require_room(folder: Path) -> None:
    """Check that there is room for what rosbags unpacks of a bag whose files are compressed as a whole.

    Raises:
        LogError: there is none.
        MissingExtraError: zstandard is not installed.
        ValueError: a file is no zstd; likewise OSError.
    """
    mode, files = _compression(folder)
    if mode != "file":
        return
    try:
        import zstandard
    except ImportError:
        raise MissingExtraError("zstandard", "log", f"reading {folder}") from None
    place = tempfile.gettempdir()
    room = shutil.disk_usage(place).free
    for path in files:
        with path.open("rb") as file:
            unpacked = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
            while part := unpacked.read(1 << 20):
                room -= len(part)
                if room < 0:
                    raise LogError(
                        f"{folder} does not fit into {place} when it is unpacked, expected room for it; "
                        "set TMPDIR to a folder with more"
                    )
