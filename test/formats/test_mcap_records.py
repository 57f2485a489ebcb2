"""`McapFile` reads ahead and takes chunks together: order, damage, an early end, and layouts that look alike."""

from __future__ import annotations

import struct
import threading
from pathlib import Path

import pytest
from bag_rows import STAMPED, Row, stamped, write_rows

from rb_dynamics.errors import LogError
from rb_dynamics.formats.channel_metadata import log_channel
from rb_dynamics.formats.mcap_records import McapFile, Message
from rb_dynamics.formats.mcap_writer import McapWriter
from rb_dynamics.formats.output_file import OutputFile

pytest.importorskip("mcap")

from mcap.reader import make_reader
from mcap.writer import CompressionType

Read = tuple[str, int, bytes]


def rows_of(count: int, topics: tuple[str, ...] = ("/a", "/b", "/c")) -> list[Row]:
    return [(topic, STAMPED, k, stamped(k, float(k), topic)) for k in range(count) for topic in topics]


def by_topic(messages: list[Read]) -> dict[str, list[tuple[int, bytes]]]:
    found: dict[str, list[tuple[int, bytes]]] = {}
    for topic, at, data in messages:
        found.setdefault(topic, []).append((at, data))
    return found


def read(message: Message) -> Read:
    return message.channel.topic, message.log_time, message.data


def blocks_of(file: McapFile, found: list[Read]) -> None:
    """Add what the blocks of a file contain, as far as they come."""
    for block in file.blocks():
        found += map(read, block.messages())


def test_messages_outside_of_chunks_come_in_the_order_of_the_file(tmp_path: Path) -> None:
    rows = rows_of(10_000)
    path = write_rows(tmp_path / "bag.mcap", rows, use_chunking=False)
    expected = [(topic, at, data) for topic, _, at, data in rows]
    assert [*map(read, McapFile(path).messages())] == expected
    # All before the first record that cannot be read.
    content = path.read_bytes()
    message = content.index(rows[20_000][3], len(content) // 2)
    path.write_bytes(content[: message - 22] + bytes(8) + content[message - 14 :])
    for single in (True, False):
        found: list[Read] = []
        file = McapFile(path)
        with pytest.raises(LogError, match="channel 0, which it does not declare"):
            found.extend(map(read, file.messages())) if single else blocks_of(file, found)
        assert by_topic(found) == by_topic(expected[:20_000])


@pytest.mark.parametrize("compression", [*CompressionType])
@pytest.mark.parametrize("chunk_size", [1000, 40_000, 3_000_000])
def test_messages_come_in_the_order_of_the_file(tmp_path: Path, compression: CompressionType, chunk_size: int) -> None:
    rows = rows_of(3_000)
    path = write_rows(tmp_path / "bag.mcap", rows, compression=compression, chunk_size=chunk_size)
    expected = [(topic, at, data) for topic, _, at, data in rows]
    assert [*map(read, McapFile(path).messages())] == expected
    found: list[Read] = []
    blocks_of(McapFile(path), found)
    assert by_topic(found) == by_topic(expected)


def test_damage_in_the_middle_comes_after_all_messages_before_it(tmp_path: Path) -> None:
    rows = rows_of(20_000)
    path = write_rows(tmp_path / "bag.mcap", rows, chunk_size=50_000)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunk = summary.chunk_indexes[len(summary.chunk_indexes) // 2]
    content = bytearray(path.read_bytes())
    content[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 1
    path.write_bytes(content)
    before = threading.enumerate()
    whole = [(topic, at, data) for topic, _, at, data in rows if at < chunk.message_start_time]
    single: list[Read] = []
    with pytest.raises(LogError, match=r"is damaged: it has a chunk"):
        single.extend(map(read, McapFile(path).messages()))
    together: list[Read] = []
    with pytest.raises(LogError, match=r"is damaged: it has a chunk"):
        blocks_of(McapFile(path), together)
    for found in (single, together):
        assert by_topic([each for each in found if each[1] < chunk.message_start_time]) == by_topic(whole)
        # A chunk begins between the messages of one time.
        assert {at for _, at, _ in found} <= set(range(chunk.message_start_time + 1))
    saved = McapFile(path, salvage=True)
    assert {at for _, at, _ in map(read, saved.messages())} >= {0, 19_999}
    assert saved.missing == [(chunk.message_start_time, chunk.message_end_time)]
    assert threading.enumerate() == before


def test_what_follows_the_end_of_a_file_is_named(tmp_path: Path) -> None:
    """Of two files that `cat` had joined, the second was left out without a word."""
    path = write_rows(tmp_path / "bag.mcap", rows_of(100))
    content = path.read_bytes()
    path.write_bytes(content + bytes(4096))
    assert len([*McapFile(path).messages()]) == 300
    path.write_bytes(content + bytes(4096) + content)
    for read_all in (McapFile.messages, McapFile.blocks):
        with pytest.raises(LogError, match=rf"goes on after its end.*: tail -c \+{len(content) + 1} .*bag.mcap"):
            _ = [*read_all(McapFile(path))]  # type: ignore[operator]
    saved = McapFile(path, salvage=True)
    assert len([*saved.messages()]) == 300
    assert "goes on after its end" in saved.damage[-1]


def test_a_chunk_within_a_chunk_is_damage(tmp_path: Path) -> None:
    """Its messages were left out without a word."""
    path = write_rows(tmp_path / "bag.mcap", rows_of(100), compression=CompressionType.NONE)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    (chunk,) = summary.chunk_indexes
    content, end = path.read_bytes(), chunk.chunk_start_offset + chunk.chunk_length
    inner = content[chunk.chunk_start_offset : end]
    head = struct.pack("<QQQII", 0, 99, len(inner), 0, 0) + struct.pack("<Q", len(inner))
    outer = struct.pack("<BQ", 6, len(head + inner)) + head + inner
    path.write_bytes(content[: chunk.chunk_start_offset] + outer + content[end:])
    with pytest.raises(LogError, match="a chunk within a chunk"):
        _ = [*McapFile(path).messages()]


def test_a_reader_that_stops_early_leaves_no_thread(tmp_path: Path) -> None:
    path = write_rows(tmp_path / "bag.mcap", rows_of(30_000), chunk_size=50_000)
    before = threading.enumerate()
    for reading in (McapFile(path).blocks(), McapFile(path).messages()):
        next(reading)
        reading.close()  # type: ignore[attr-defined]
        assert threading.enumerate() == before


def test_an_error_of_who_reads_leaves_no_thread(tmp_path: Path) -> None:
    path = write_rows(tmp_path / "bag.mcap", rows_of(30_000), chunk_size=50_000)
    before = threading.enumerate()
    with pytest.raises(ZeroDivisionError):
        sum(1 // len(block.data[:0]) for block in McapFile(path).blocks())
    assert threading.enumerate() == before


@pytest.mark.parametrize("changed", ["order of topics", "lengths"])
def test_chunks_of_one_size_may_have_other_messages(tmp_path: Path, changed: str) -> None:
    """Where the messages of chunks of the same sizes were is no more than a guess."""
    path = tmp_path / "log.mcap"
    file = OutputFile(path)
    writer = McapWriter(file, "test")
    writer.begin()
    topics = {topic: writer.add_channel(log_channel(topic, STAMPED, "")) for topic in ("/a", "/b", "/c")}
    expected: list[Read] = []
    for k in range(30_000):
        here, frames = [*topics], ["f", "f" * 40, "f"]
        if k // 10_000 % 2 and changed == "order of topics":
            here = here[::-1]
        elif k // 10_000 % 2:
            frames = ["f", "f", "f" * 40]
        group = [(topic, k, stamped(k, float(ord(topic[1])), frame)) for topic, frame in zip(here, frames, strict=True)]
        writer.add_messages([topics[topic] for topic in here], [data for _, _, data in group], k, k)
        expected += group
    writer.finish()
    file.close()
    assert [*map(read, McapFile(path).messages())] == expected
    found: list[Read] = []
    blocks_of(McapFile(path), found)
    assert by_topic(found) == by_topic(expected)


def test_a_channel_that_is_declared_twice_and_not_alike_is_refused(tmp_path: Path) -> None:
    """All its messages were taken for those of the first, without a word."""
    rows = [(topic, STAMPED, k, stamped(k, float(k), topic)) for topic in ("/a", "/b") for k in range(3)]
    path = write_rows(tmp_path / "bag.mcap", rows, use_chunking=False)
    content, at = bytearray(path.read_bytes()), 8
    while at < len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, at)
        if opcode in (0x04, 0x05):  # Channel and Message begin with the number of the channel.
            content[at + 9] = 1
        at += 9 + length
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"declares channel 1 twice, and not alike; .*recover"):
        list(McapFile(path).messages())
    saved = McapFile(path, salvage=True)
    assert [message.channel.topic for message in saved.messages()] == ["/a"] * 3 + ["/b"] * 3
    assert "declares channel 1 twice" in saved.damage[-1]
