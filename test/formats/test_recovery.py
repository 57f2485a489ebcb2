"""Recovery of files truncated within a chunk, and the message for files of another kind."""

from __future__ import annotations

import os
import random
import shutil
import sqlite3
import struct
from pathlib import Path
from typing import Any

import pytest
from bag_rows import STAMPED, Row, stamped, write_rows

from rb_dynamics import parse_scene, simulate
from rb_dynamics.cli import main
from rb_dynamics.errors import LogError
from rb_dynamics.formats.mcap_records import McapFile, Opcode
from rb_dynamics.formats.recovery import recover
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.sinks.mcap_sink import McapSink

pytest.importorskip("mcap")

from mcap.writer import CompressionType, IndexType, Writer


def _places(data: bytes, opcode: int) -> list[int]:
    """Return where the records of a kind begin in a file."""
    at, places = 8, list[int]()
    while at + 9 < len(data):
        found, length = struct.unpack_from("<BQ", data, at)
        places += [at] * (found == opcode)
        at += 9 + length
    return places


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_a_chunk_that_was_cut_gives_the_messages_before_its_end(tmp_path: Path, compression: CompressionType) -> None:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, i * 0.1 + 1 / (i + 1))) for i in range(10_000)]
    whole = write_rows(tmp_path / "a.mcap", rows, chunk_size=10**9, compression=compression)
    data = whole.read_bytes()
    expected = read_bag(whole).wrenches("/w")
    # All are in one chunk, which is at least a third of the file: index and summary stand behind it.
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) // 4])
    (saved,) = recover(cut, tmp_path / "saved.mcap")
    found = read_bag(tmp_path / "saved.mcap").wrenches("/w")
    assert saved.state == "cut off"
    assert 500 < len(found) < 10_000
    assert found == expected[: len(found)]


def test_a_copy_keeps_times_and_numbers_of_publishers(tmp_path: Path) -> None:
    from mcap.reader import make_reader

    whole = tmp_path / "a.mcap"
    with whole.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "test")
        channel = writer.register_channel("/w", "cdr", writer.register_schema(STAMPED, "ros2msg", b""))
        for k in range(2000):
            writer.add_message(channel, 10 * k, stamped(k, 0.1 * k), 10 * k - k % 7, sequence=2**32 - 2000 + k)
        writer.finish()
    whole.write_bytes(whole.read_bytes()[:-30])
    recover(whole, tmp_path / "saved.mcap")
    with (tmp_path / "saved.mcap").open("rb") as file:
        found = [message for _, _, message in make_reader(file).iter_messages()]
    assert [message.publish_time for message in found] == [10 * k - k % 7 for k in range(2000)]
    assert [message.sequence for message in found] == list(range(2**32 - 2000, 2**32))


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
@pytest.mark.parametrize("with_head", [False, True])
def test_a_zeroed_first_chunk_loses_only_its_own_messages(
    tmp_path: Path, compression: CompressionType, with_head: bool
) -> None:
    """Writers declare the channels in the first chunk only, and again in the summary at the end."""
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, i * 0.1 + 1 / (i + 1))) for i in range(2000)]
    whole = write_rows(tmp_path / "a.mcap", rows, chunk_size=20_000, compression=compression)
    expected = read_bag(whole).wrenches("/w")
    data = bytearray(whole.read_bytes())
    from mcap.reader import make_reader

    with whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    first = summary.chunk_indexes[0]
    begin = first.chunk_start_offset + (0 if with_head else 50)
    end = first.chunk_start_offset + first.chunk_length
    data[begin:end] = bytes(end - begin)
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data)
    (saved,) = recover(damaged, tmp_path / "saved.mcap")
    found = read_bag(tmp_path / "saved.mcap").wrenches("/w")
    lost = first.message_end_time + 1
    assert found == expected[lost:]
    assert saved.state == "damaged"
    assert saved.damage
    assert saved.missing == [(0, first.message_end_time)]


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4])
@pytest.mark.parametrize("lost", [1, 40, 500])
@pytest.mark.parametrize("index", [IndexType.NONE, IndexType.ALL])
def test_bytes_lost_in_a_chunk_cost_no_chunk_behind_it(
    tmp_path: Path, compression: CompressionType, lost: int, index: IndexType
) -> None:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, i * 0.1 + 1 / (i + 1))) for i in range(500)]
    whole = write_rows(tmp_path / "a.mcap", rows, chunk_size=5000, compression=compression, index_types=index)
    data = whole.read_bytes()
    place = _places(data, Opcode.CHUNK)[3]
    begin, end = struct.unpack_from("<QQ", data, place + 9)
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data[: place + 100] + data[place + 100 + lost :])
    (saved,) = recover(damaged, tmp_path / "saved.mcap")
    found = read_bag(tmp_path / "saved.mcap").wrenches("/w")
    expected = read_bag(whole).wrenches("/w")
    assert found == expected[:begin] + expected[end + 1 :]
    # The index tells exactly what was there, else the messages around it do.
    assert saved.missing == [(begin, end) if index == IndexType.ALL else (begin - 1, end + 1)]


def _rows_in_chunks(path: Path) -> tuple[bytes, list[int]]:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, i * 0.1 + 1 / (i + 1))) for i in range(500)]
    data = write_rows(path, rows, chunk_size=5000, compression=CompressionType.NONE).read_bytes()
    return data, _places(data, Opcode.CHUNK)


def test_bytes_lost_from_an_index_of_messages_cost_no_chunk_behind_it(tmp_path: Path) -> None:
    data, places = _rows_in_chunks(tmp_path / "a.mcap")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data[: places[4] - 12] + data[places[4] - 4 :])
    (saved,) = recover(damaged, tmp_path / "saved.mcap")
    assert saved.damage
    assert sum(saved.file.counts.values()) == 500


def test_bytes_lost_in_the_chunk_of_the_channels_cost_no_chunk_behind_it(tmp_path: Path) -> None:
    data, places = _rows_in_chunks(tmp_path / "a.mcap")
    second, _ = struct.unpack_from("<QQ", data, places[1] + 9)
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data[: places[0] + 60] + data[places[0] + 70 :])
    (saved,) = recover(damaged, tmp_path / "saved.mcap")
    assert sum(saved.file.counts.values()) == 500 - second
    assert not any("summary" in line for line in saved.damage)


@pytest.mark.parametrize("checksums", [True, False])
def test_a_last_chunk_that_lost_bytes_is_not_said_to_have_its_messages(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], checksums: bool
) -> None:
    """One message then has bytes of two, and no checksum of a chunk whose end is not known proves the others."""
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, 1.0 + i)) for i in range(100)]
    options = {"chunk_size": 10**9, "compression": CompressionType.NONE, "enable_crcs": checksums}
    data = write_rows(tmp_path / "a.mcap", rows, **options).read_bytes()
    (chunk,) = _places(data, Opcode.CHUNK)
    end = chunk + 9 + struct.unpack_from("<Q", data, chunk + 1)[0]
    lost = len(data) - end + 100
    assert lost < end - chunk
    (tmp_path / "damaged.mcap").write_bytes(data[: end - lost] + data[end:])
    assert main(["recover", str(tmp_path / "damaged.mcap"), str(tmp_path / "copy.mcap")]) == 1
    said = capsys.readouterr().out
    assert "whether messages of the chunk there were changed cannot be known" in said
    assert ("left out checksums" in said) == (not checksums)


@pytest.mark.parametrize("tail", [bytes(4096), bytes(range(200, 256)) * 3])
def test_what_stands_behind_the_cut_completes_no_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], tail: bytes
) -> None:
    """Where power was lost, zeros or what the disk held before stand there: the message at the cut had some of them."""
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, 1.0 + i)) for i in range(1000)]
    whole = write_rows(tmp_path / "a.mcap", rows, chunk_size=10**9, compression=CompressionType.NONE)
    data, expected = whole.read_bytes(), [message.data for message in McapFile(whole).messages()]
    for cut in range(20_000, 20_120):
        (tmp_path / "cut.mcap").write_bytes(data[:cut])
        (tmp_path / "tail.mcap").write_bytes(data[:cut] + tail)
        clean = sum(1 for _ in McapFile(tmp_path / "cut.mcap").messages())
        found = [message.data for message in McapFile(tmp_path / "tail.mcap").messages()]
        # Where the cut is between two messages, the one before it may be left out, too.
        assert found == expected[: len(found)]
        assert clean - 1 <= len(found) <= clean
    assert main(["recover", str(tmp_path / "tail.mcap"), str(tmp_path / "copy.mcap")]) == 1
    assert "ends in bytes that are no record" in capsys.readouterr().out


def test_a_length_that_no_record_has_costs_only_its_chunk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data, places = _rows_in_chunks(tmp_path / "a.mcap")
    assert len(data) > places[3] + 20_000
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data[: places[3] + 1] + struct.pack("<Q", 15_000) + b"?" * 100 + data[places[3] + 109 :])
    begin, end = struct.unpack_from("<QQ", data, places[3] + 9)
    with monkeypatch.context() as small:
        small.setattr("rb_dynamics.formats.mcap_records.MAX_RECORD_BYTES", 10_000)
        recover(damaged, tmp_path / "saved.mcap")
    found = read_bag(tmp_path / "saved.mcap").wrenches("/w")
    expected = read_bag(tmp_path / "a.mcap").wrenches("/w")
    assert found == expected[:begin] + expected[end + 1 :]


def test_a_piece_lost_of_two_chunks_is_missing_at_the_times_of_both(tmp_path: Path) -> None:
    data, places = _rows_in_chunks(tmp_path / "a.mcap")
    first, second = (struct.unpack_from("<QQ", data, places[k] + 9) for k in (3, 4))
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data[: places[3] + 100] + data[places[4] + 400 :])
    (saved,) = recover(damaged, tmp_path / "saved.mcap")
    assert sum(saved.file.counts.values()) == 500 - (second[1] + 1 - first[0])
    assert saved.missing == [first, second]


@pytest.mark.parametrize("number", [4, 8])
def test_a_message_without_its_times_costs_no_other(tmp_path: Path, number: int) -> None:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, 0.1 * i)) for i in range(9)]
    data = write_rows(tmp_path / "a.mcap", rows, use_chunking=False).read_bytes()
    place = _places(data, Opcode.MESSAGE)[number]
    place += number == 8 and 9 + struct.unpack_from("<Q", data, place + 1)[0]
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data[:place] + struct.pack("<BQ", Opcode.MESSAGE, 5) + b"short" + data[place:])
    (saved,) = recover(damaged, tmp_path / "saved.mcap")
    assert sum(saved.file.counts.values()) == 9
    assert any("without its times" in line for line in saved.damage)


@pytest.mark.parametrize("folder", [False, True])
def test_where_nothing_can_be_read_nothing_is_written(tmp_path: Path, folder: bool) -> None:
    source = tmp_path / "bag" / "a.mcap"
    source.parent.mkdir()
    write_rows(source, [("/w", STAMPED, 0, stamped(0, 1.0))], compression=CompressionType.NONE)
    source.write_bytes(source.read_bytes()[:60])
    target = tmp_path / "saved"
    with pytest.raises(LogError, match=r"found no whole message in .*record it again"):
        recover(source.parent if folder else source, target)
    assert not target.exists()


@pytest.mark.parametrize("command", [["recover", "BAG", "out"], ["inspect", "BAG"], ["replay", "BAG"]])
def test_bags_of_another_kind_are_named_with_the_command_that_helps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    ros_1, renamed = tmp_path / "flight.bag", tmp_path / "flight.mcap"
    ros_1.write_bytes(b"#ROSBAG V2.0\nE\0\0\0")
    with sqlite3.connect(renamed) as database:
        database.execute("create table topics (id integer)")
    for file, says in (
        (
            ros_1,
            f"is a bag of ROS 1, expected one of ROS 2; convert it with rosbags-convert --src {ros_1} --dst flight",
        ),
        (renamed, "is an SQLite bag, expected an MCAP file; SQLite bags are read, not recovered"),
    ):
        assert main([str(file) if word == "BAG" else word for word in command]) == 2
        assert says in capsys.readouterr().err


@pytest.mark.parametrize("folder", [False, True])
def test_packed_files_are_to_be_unpacked_first(tmp_path: Path, folder: bool) -> None:
    packed = tmp_path / "run_0.mcap.zstd"
    packed.write_bytes(b"\x28\xb5\x2f\xfd\x04\x00")
    with pytest.raises(LogError, match=rf"unpack .* first with zstd -d {tmp_path}/.*\.mcap\.zstd"):
        recover(tmp_path if folder else packed, tmp_path / "saved")


@pytest.mark.parametrize("how", ["gone", "twice"])
@pytest.mark.parametrize(("opcode", "kind"), [(6, "messages"), (9, "attachments"), (12, "metadata records")])
def test_a_piece_that_is_gone_or_there_twice_shows_in_the_statistics(
    tmp_path: Path, how: str, opcode: int, kind: str
) -> None:
    """A copy that lost exactly its last chunk has an end and no gap."""
    log, saved = tmp_path / "run.mcap", tmp_path / "saved.mcap"
    simulate(parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 0.1\n"), [], [McapSink(log)])
    data, places, at = log.read_bytes(), [], 8
    while at + 9 < len(data):
        found, length = struct.unpack_from("<BQ", data, at)
        places += [(at, at + 9 + length)] * (found == opcode)
        at += 9 + length
    begin, end = places[-1]
    log.write_bytes(data[:begin] + data[begin:end] * 2 * (how == "twice") + data[end:])
    with pytest.raises(LogError, match=rf"is damaged: it holds \d+ {kind}, and its statistics say \d+"):
        read_bag(log)
    (found_back,) = recover(log, saved)
    assert found_back.state == "damaged"
    assert not read_bag(saved).complete


def test_zeros_between_chunks_cost_no_chunk_behind_them(tmp_path: Path) -> None:
    log, saved = tmp_path / "run.mcap", tmp_path / "saved.mcap"
    simulate(parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 0.1\n"), [], [McapSink(log)])
    data = log.read_bytes()
    before = read_bag(log).topics["/pose"].log_times.tolist()
    places, at = [], 8
    while at + 9 < len(data):
        found, length = struct.unpack_from("<BQ", data, at)
        places += [at] * (found not in (5, 6))
        at += 9 + length
    for place in places:
        log.write_bytes(data[:place] + bytes(9) + data[place + 9 :])
        recover(log, saved)
        assert read_bag(saved).topics["/pose"].log_times.tolist() == before


@pytest.mark.parametrize("chunks", [1, 5])
@pytest.mark.parametrize("flip", [(0, 1), (0, 2), (0, 4), (0, 64), (1, 4), (2, 8), (4, 2), (6, 128)])
@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_a_flip_in_the_head_of_a_chunk_costs_no_message_and_is_not_said_to_be_a_cut(
    tmp_path: Path, compression: CompressionType, flip: tuple[int, int], chunks: int
) -> None:
    """Opcode and length stand outside of every checksum; the fields within the chunk say what they were."""
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, i * 0.1 + 1 / (i + 1))) for i in range(2000)]
    log = write_rows(tmp_path / "a.mcap", rows, chunk_size=250_000 // chunks, compression=compression)
    data, expected = bytearray(log.read_bytes()), read_bag(log).wrenches("/w")
    places = _places(data, Opcode.CHUNK)
    assert len(places) >= chunks
    place, mask = flip
    data[places[len(places) // 2] + place] ^= mask
    log.write_bytes(data)
    with pytest.raises(LogError, match=r"is damaged: .*save what can be read with `rb-dynamics recover`"):
        read_bag(log)
    (saved,) = recover(log, tmp_path / "saved.mcap")
    assert saved.state == "damaged"
    assert read_bag(tmp_path / "saved.mcap").wrenches("/w") == expected


@pytest.mark.parametrize("more", [1, 16, 256])
@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_length_of_what_is_compressed_that_is_too_large_costs_no_message(
    tmp_path: Path, compression: CompressionType, more: int
) -> None:
    """A decoder stops at the end of its data: too long, the chunk is whole, and would hide the begin of the next."""
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, i * 0.1 + 1 / (i + 1))) for i in range(500)]
    log = write_rows(tmp_path / "a.mcap", rows, chunk_size=5000, compression=compression, index_types=IndexType.NONE)
    data, expected = bytearray(log.read_bytes()), read_bag(log).wrenches("/w")
    # Behind the head of the record, times, size, checksum, and the name of the compression.
    at = _places(data, Opcode.CHUNK)[1] + 9 + 28 + 4 + len(compression.name)
    struct.pack_into("<Q", data, at, struct.unpack_from("<Q", data, at)[0] + more)
    log.write_bytes(data)
    (saved,) = recover(log, tmp_path / "saved.mcap")
    assert saved.state == "damaged"
    assert read_bag(tmp_path / "saved.mcap").wrenches("/w") == expected


@pytest.mark.parametrize("flip", [(0, 128), (1, 1), (2, 1), (7, 128)])
@pytest.mark.parametrize("checksums", [True, False])
def test_a_flip_in_the_length_of_an_attachment_costs_no_chunk_behind_it(
    tmp_path: Path, checksums: bool, flip: tuple[int, int]
) -> None:
    log = tmp_path / "a.mcap"
    with log.open("wb") as file:
        writer = Writer(file, chunk_size=1000, index_types=IndexType.NONE, enable_crcs=checksums)
        writer.start("ros2", "test")
        channel = writer.register_channel("/w", "cdr", writer.register_schema(STAMPED, "ros2msg", b""))
        for k in range(300):
            writer.add_message(channel, k, stamped(k, 0.1 * k), k)
            if k == 50:
                writer.add_attachment(1, 1, "notes.txt", "text/plain", bytes(range(80)))
        writer.finish()
    data, expected = bytearray(log.read_bytes()), read_bag(log).wrenches("/w")
    place, mask = flip
    data[_places(data, Opcode.ATTACHMENT)[0] + 1 + place] ^= mask
    log.write_bytes(data)
    (saved,) = recover(log, tmp_path / "saved.mcap")
    assert saved.state == "damaged"
    again = read_bag(tmp_path / "saved.mcap")
    assert again.wrenches("/w") == expected
    assert again.attachments == {"notes.txt": bytes(range(80))}


@pytest.mark.parametrize("flip", [(0, 1), (0, 64), (1, 2), (2, 16)])
def test_a_flip_in_the_length_of_the_header_costs_no_chunk(tmp_path: Path, flip: tuple[int, int]) -> None:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, i * 0.1 + 1 / (i + 1))) for i in range(300)]
    log = write_rows(tmp_path / "a.mcap", rows, chunk_size=1000, index_types=IndexType.NONE)
    data, expected = bytearray(log.read_bytes()), read_bag(log).wrenches("/w")
    place, mask = flip
    data[8 + 1 + place] ^= mask
    log.write_bytes(data)
    (saved,) = recover(log, tmp_path / "saved.mcap")
    assert saved.state == "damaged"
    assert read_bag(tmp_path / "saved.mcap").wrenches("/w") == expected


def test_a_channel_of_the_summary_that_a_flip_calls_a_message_is_none(tmp_path: Path) -> None:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, i * 0.1)) for i in range(50)]
    log = write_rows(tmp_path / "a.mcap", rows)
    data, expected = bytearray(log.read_bytes()), read_bag(log).wrenches("/w")
    data[_places(data, Opcode.CHANNEL)[-1]] = Opcode.MESSAGE
    log.write_bytes(data)
    (saved,) = recover(log, tmp_path / "saved.mcap")
    assert saved.state == "damaged"
    again = read_bag(tmp_path / "saved.mcap")
    assert again.wrenches("/w") == expected
    assert sum(len(each.log_times) for each in again.topics.values()) == 50


def test_an_index_of_a_chunk_that_a_flip_calls_a_message_is_none(tmp_path: Path) -> None:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, i * 0.1)) for i in range(300)]
    log = write_rows(tmp_path / "a.mcap", rows, chunk_size=3000)
    whole, expected = log.read_bytes(), read_bag(log).wrenches("/w")
    for place in _places(whole, Opcode.MESSAGE_INDEX):
        data = bytearray(whole)
        data[place] = Opcode.MESSAGE
        log.write_bytes(data)
        (saved,) = recover(log, tmp_path / "saved.mcap")
        assert (saved.state, saved.missing, saved.unplaced) == ("damaged", [], False)
        again = read_bag(tmp_path / "saved.mcap")
        assert again.wrenches("/w") == expected
        assert sum(len(each.log_times) for each in again.topics.values()) == 300


def test_a_flip_that_changes_a_message_outside_of_chunks_is_said_to_be_possible(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only the checksum of the data shows it, and it was said that those of chunks fit, or that there was none."""
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, 1.0)) for i in range(100)]
    path = write_rows(tmp_path / "a.mcap", rows, use_chunking=False, enable_data_crcs=True)
    data = bytearray(path.read_bytes())
    data[data.index(rows[50][3]) + 60] ^= 8
    path.write_bytes(data)
    assert main(["recover", str(path), str(tmp_path / "saved.mcap")]) == 1
    said = capsys.readouterr().out
    assert "checksum does not fit its content; messages outside of chunks" in said
    assert "left out checksums" not in said


@pytest.mark.parametrize(("place", "mask"), [(0, 1), (1, 1), (2, 1), (4, 2), (8, 64), (9, 64)])
def test_a_flip_outside_of_chunks_costs_the_messages_it_hides(tmp_path: Path, place: int, mask: int) -> None:
    """Opcode, length (small, large, beyond the file) and channel of a message of a file without chunks."""
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, i * 0.1 + 1 / (i + 1))) for i in range(300)]
    log = write_rows(tmp_path / "a.mcap", rows, use_chunking=False)
    data, expected = bytearray(log.read_bytes()), read_bag(log).wrenches("/w")
    places = _places(data, Opcode.MESSAGE)
    data[places[100] + place] ^= mask
    log.write_bytes(data)
    (saved,) = recover(log, tmp_path / "saved.mcap")
    assert saved.state == "damaged"
    kept = [each for each in read_bag(tmp_path / "saved.mcap").wrenches("/w") if each in expected]
    # A length that is 256 too large hides those behind it.
    assert len(kept) >= 300 - 4
    assert saved.file.end_ns == 299
    # Without an index or a chunk that has its times, those of its neighbours bound what is missing.
    known = [begin <= 100 <= end for begin, end in saved.missing]
    assert any(known) or saved.unplaced or len(kept) == 300
    again = read_bag(tmp_path / "saved.mcap")
    assert (again.missing, again.unplaced) == (sorted(saved.missing), saved.unplaced)
    with pytest.raises(LogError, match="is damaged"):
        read_bag(log)


def test_a_copy_of_a_file_that_lost_a_message_is_not_called_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, log, saved = (tmp_path / name for name in ("run.mcap", "a.mcap", "saved.mcap"))
    simulate(parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 3\n"), [], [McapSink(run)])
    rows: list[Row] = [
        ("/pose", each.channel.schema.name, each.log_time, each.data)
        for each in McapFile(run).messages()
        if each.channel.topic == "/pose"
    ]
    data = bytearray(write_rows(log, rows, use_chunking=False).read_bytes())
    data[_places(data, Opcode.MESSAGE)[100] + 3] ^= 16
    log.write_bytes(data)
    assert main(["recover", str(log), str(saved)]) == 1
    assert "missing: t = 0.98 to 1.01 s" in capsys.readouterr().out
    assert main(["inspect", str(saved)]) == 1
    assert "FAIL  recording has all its parts: a piece is missing from t = 0.98 to 1.01 s" in capsys.readouterr().out


def test_a_piece_that_may_be_of_any_time_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A damaged log time far ahead leaves no message before the piece that is lost, and none after it."""
    run, log, saved = (tmp_path / name for name in ("run.mcap", "a.mcap", "saved.mcap"))
    simulate(parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 3\n"), [], [McapSink(run)])
    rows: list[Row] = [
        ("/pose", each.channel.schema.name, each.log_time, each.data)
        for each in McapFile(run).messages()
        if each.channel.topic == "/pose" and each.log_time > 0
    ]
    data = bytearray(write_rows(log, rows, use_chunking=False).read_bytes())
    places = _places(data, Opcode.MESSAGE)
    data[places[100] + 15 : places[100] + 23] = struct.pack("<Q", 8 * 10**18)
    data[places[200] + 3] ^= 16
    log.write_bytes(data)
    assert main(["recover", str(log), str(saved)]) == 1
    assert main(["inspect", str(saved)]) == 1
    assert "FAIL  recording has all its parts: a piece is missing from" in capsys.readouterr().out


def test_a_finished_file_of_which_nothing_can_be_read_is_not_copied(tmp_path: Path) -> None:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, 1.0)) for i in range(100)]
    log = write_rows(tmp_path / "a.mcap", rows, compression=CompressionType.ZSTD)
    data = bytearray(log.read_bytes())
    data[data.index(b"zstd") + 20] ^= 1
    log.write_bytes(data)
    with pytest.raises(LogError, match="found no whole message"):
        recover(log, tmp_path / "saved.mcap")
    assert not (tmp_path / "saved.mcap").exists()


@pytest.mark.parametrize("text", [b"float64 x", b"/twist"])
def test_a_flip_in_the_summary_is_named_and_what_the_data_say_is_copied(tmp_path: Path, text: bytes) -> None:
    log, saved = tmp_path / "run.mcap", tmp_path / "saved.mcap"
    simulate(parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 0.1\n"), [], [McapSink(log)])
    (whole,) = recover(log, saved)
    assert (whole.state, whole.damage) == ("whole", [])
    data = bytearray(log.read_bytes())
    (summary,) = struct.unpack_from("<Q", data, len(data) - 28)
    data[data.index(text, summary) + len(text) - 1] ^= 1
    log.write_bytes(data)
    (found,) = recover(log, saved)
    assert found.state == "damaged"
    assert "summary whose checksum does not fit" in found.damage[0]
    assert found.channels == whole.channels


def test_a_wrong_length_in_the_summary_loses_nothing(tmp_path: Path) -> None:
    log, saved = tmp_path / "run.mcap", tmp_path / "saved.mcap"
    simulate(parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 0.1\n"), [], [McapSink(log)])
    whole = log.read_bytes()
    (at,) = struct.unpack_from("<Q", whole, len(whole) - 28)
    while whole[at] != 2:  # the footer
        data = bytearray(whole)
        data[at + 5] ^= 1  # its length is wrong by 2^32
        log.write_bytes(data)
        (found,) = recover(log, saved)
        assert (found.state, found.missing, found.unplaced) == ("damaged", [], False)
        assert read_bag(saved).whole
        assert not read_bag(saved).unplaced
        at += 9 + struct.unpack_from("<Q", whole, at + 1)[0]


def test_a_flip_in_the_scene_is_no_other_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The motion of another mass would look as good; and its copy would have a checksum that fits."""
    log, saved = tmp_path / "run.mcap", tmp_path / "saved.mcap"
    simulate(parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 0.1\n"), [], [McapSink(log)])
    data = bytearray(log.read_bytes())
    data[data.index(b"mass: 2") + 6] ^= 1
    log.write_bytes(data)
    for command in (["simulate"], ["replay"], ["inspect"], ["body"]):
        assert main([*command, str(log)]) == 2
        assert "has an attachment scene.yaml whose checksum does not fit its content; save" in capsys.readouterr().err
    (found,) = recover(log, saved)
    assert (found.state, found.missing, found.unplaced) == ("damaged", [], False)
    assert found.damage[0].endswith("scene.yaml whose checksum does not fit its content; it is left out")
    assert read_bag(saved).attachments == {}
    assert main(["simulate", str(saved)]) == 2


def test_a_flip_that_only_the_checksum_of_the_data_covers_is_named(tmp_path: Path) -> None:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, 1.0)) for i in range(100)]
    log = write_rows(tmp_path / "a.mcap", rows, enable_data_crcs=True)
    (whole,) = recover(log, tmp_path / "saved.mcap")
    assert whole.state == "whole"
    data, at = bytearray(log.read_bytes()), 8
    while data[at] != Opcode.MESSAGE_INDEX:
        at += 9 + int(struct.unpack_from("<Q", data, at + 1)[0])
    data[at + 8 + int(struct.unpack_from("<Q", data, at + 1)[0])] ^= 1
    log.write_bytes(data)
    (found,) = recover(log, tmp_path / "saved.mcap")
    assert found.state == "damaged"
    assert "data section whose checksum does not fit" in found.damage[0]


def test_an_end_of_the_data_of_another_length_costs_no_message(tmp_path: Path) -> None:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, 1.0)) for i in range(100)]
    log = write_rows(tmp_path / "a.mcap", rows)
    data = bytearray(log.read_bytes())
    data[data.rindex(struct.pack("<BQ", Opcode.DATA_END, 4)) + 1] = 0
    log.write_bytes(data)
    (found,) = recover(log, tmp_path / "saved.mcap")
    assert found.file.counts["/w"] == 100


@pytest.mark.parametrize("name", ["bag.mcap", "bag.db3"])
def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(LogError, match="is a pipe or a device"):
        read_bag(tmp_path / name)


@pytest.mark.parametrize("chunked", [True, False])
def test_a_flip_that_no_checksum_shows_is_not_ruled_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], chunked: bool
) -> None:
    """A log time was changed, and the file was called whole and nothing else."""
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, 1.0)) for i in range(100)]
    told = {}
    for crcs in (True, False):
        name = tmp_path / f"{crcs}.mcap"
        options = {"use_chunking": chunked, "enable_crcs": crcs, "enable_data_crcs": crcs}
        path = write_rows(name, rows, compression=CompressionType.NONE, **options)
        if not crcs:
            data = bytearray(path.read_bytes())
            data[data.index(rows[50][3]) - 16] ^= 8
            path.write_bytes(data)
        assert main(["recover", str(path), str(tmp_path / "saved.mcap")]) == 0
        told[crcs] = capsys.readouterr().out
    assert all("the file was whole" in each for each in told.values())
    assert "cannot be known" in told[False]
    assert "cannot be known" not in told[True]


@pytest.mark.parametrize(
    ("gone", "metadata", "code", "said"),
    [
        (1, False, 1, "\nsplit_1.mcap is missing"),
        (1, True, 1, "\nsplit_1.mcap is missing"),
        (0, True, 1, "split_0.mcap is missing"),
        (2, True, 0, "the next file, split_2.mcap, is missing"),
        (2, False, 0, ""),
        (None, False, 0, ""),
    ],
)
def test_recover_names_a_missing_file_of_another_writer(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], gone: int | None, metadata: bool, code: int, said: str
) -> None:
    folder, kept = tmp_path / "split", [number for number in range(3) if number != gone]
    folder.mkdir()
    for number in range(3):
        write_rows(folder / f"split_{number}.mcap", [("/w", STAMPED, number, stamped(number, 1.0))])
    if metadata:
        assert main(["recover", str(folder), str(tmp_path / "first")]) == 0
        shutil.copy(tmp_path / "first" / "metadata.yaml", folder)
    if gone is not None:
        (folder / f"split_{gone}.mcap").unlink()
    capsys.readouterr()
    assert main(["recover", str(folder), str(tmp_path / "saved")]) == code
    found = capsys.readouterr().out
    assert said in found
    assert ("is missing" in found) == bool(said)
    assert sorted(file.name for file in (tmp_path / "saved").glob("*.mcap")) == [f"split_{n}.mcap" for n in kept]
    # And so the copy says to whoever reads it.
    assert read_bag(tmp_path / "saved").missing_files == [f"split_{gone}.mcap"] * bool(said)


@pytest.mark.parametrize("index", [IndexType.NONE, IndexType.ALL])
@pytest.mark.parametrize("lost", [0, 9, 300])
def test_zeros_in_place_of_the_head_of_a_chunk_are_no_empty_chunk(tmp_path: Path, index: IndexType, lost: int) -> None:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, 0.1 * i)) for i in range(500)]
    options = {"index_types": index, "use_statistics": index == IndexType.ALL, "compression": CompressionType.NONE}
    data = write_rows(tmp_path / "a.mcap", rows, chunk_size=5000, **options).read_bytes()
    place = _places(data, Opcode.CHUNK)[3]
    begin, end = struct.unpack_from("<QQ", data, place + 9)
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data[: place + 9] + bytes(40) + data[place + 49 + lost :])
    with pytest.raises(LogError, match="has a chunk whose head is lost"):
        read_bag(damaged)
    (saved,) = recover(damaged, tmp_path / "saved.mcap")
    assert (saved.state, saved.unplaced) == ("damaged", False)
    assert saved.file.counts.total() == 500 - (end + 1 - begin)
    assert saved.missing == [(begin, end) if index == IndexType.ALL else (begin - 1, end + 1)]


def test_a_copy_that_is_damaged_in_its_turn_lacks_both_pieces(tmp_path: Path) -> None:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, 1 / (i + 1))) for i in range(10_000)]
    file = write_rows(tmp_path / "a.mcap", rows, chunk_size=100_000)
    lost: list[tuple[int, int]] = []
    for number in (3, 1):
        data = bytearray(file.read_bytes())
        data[_places(data, Opcode.CHUNK)[number] + 1000] ^= 1
        file = tmp_path / f"saved{number}.mcap"
        (tmp_path / "damaged.mcap").write_bytes(data)
        (saved,) = recover(tmp_path / "damaged.mcap", file)
        assert saved.state == "damaged"
        lost += saved.missing
    assert len(lost) == 2
    assert read_bag(file).missing == sorted(lost)


def _damaged(data: bytes, chance: random.Random) -> bytes:
    """Return a file of which bytes are gone, zero, others, swapped, or there twice."""
    for _ in range(chance.choice([1, 1, 2, 3])):
        at, size = chance.randrange(8, len(data)), chance.randint(1, chance.choice([1, 9, 100, 500, 6000]))
        piece, rest = data[at : at + size], data[at + size :]
        flipped = bytes([piece[0] ^ 1 << chance.randrange(8)]) + piece[1:]
        instead = [b"", bytes(len(piece)), chance.randbytes(len(piece)), flipped, 2 * piece, bytes(size) + piece]
        data = data[:at] + chance.choice(instead) + (rest if chance.random() < 0.95 else b"")
        if len(data) < 1000:
            break
    return data


@pytest.mark.parametrize("order", ["in order", "in pairs", "late"])
@pytest.mark.parametrize("chunks", [{"use_chunking": False}, *({"compression": each} for each in CompressionType)])
def test_what_was_lost_lies_within_the_times_that_are_told(
    tmp_path: Path, order: str, chunks: dict[str, object]
) -> None:
    chance = random.Random(f"{order} {chunks}")
    for _ in range(20):
        count = 150
        place = {"in order": lambda k: k, "in pairs": lambda k: k // 2, "late": lambda k: k + chance.randrange(40)}
        times = [1000 + 10 * place[order](k) for k in range(count)]
        rows: list[Row] = [(f"/{k % 2}", STAMPED, at, stamped(k, 1 / (k + 1))) for k, at in enumerate(times)]
        options = {
            "chunk_size": chance.choice([300, 2000, 5000]),
            "index_types": chance.choice([IndexType.NONE, IndexType.ALL]),
            "use_statistics": chance.choice([False, True]),
        }
        whole = write_rows(tmp_path / "a.mcap", rows, **options, **chunks).read_bytes()
        damaged, copy = tmp_path / "damaged.mcap", tmp_path / "saved.mcap"
        damaged.write_bytes(_damaged(whole, chance))
        try:
            (saved,) = recover(damaged, copy)
        except LogError:
            continue
        found = {message.data for message in McapFile(copy).messages()}
        alien = found - {row[3] for row in rows}
        lost = sorted(row[2] for row in rows if row[3] not in found)
        outside = [at for at in lost if not any(begin <= at <= end for begin, end in saved.missing)]
        if "cut off" in saved.state:
            outside = [at for at in outside if at < saved.file.end_ns]
        if (saved.unchecked and not saved.damage) or (order == "late" and len(found) < count / 4):
            # Nothing shows that bytes were changed, or how late messages may be.
            continue
        # Without checksums a message may have changed, which is no loss.
        assert saved.unplaced or len(outside) <= (len(alien) if saved.unchecked else 0), (saved, outside)


def write_hundred(path: Path, first: int, **options: Any) -> None:
    """Write a file with a hundred wrenches, the first of which has the stamp `first` (ns)."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start("ros2", "test")
        channel = writer.register_channel("/w", "cdr", writer.register_schema(STAMPED, "ros2msg", b"definition"))
        for k in range(first, first + 100):
            writer.add_message(channel, k, stamped(k, 0.1 * k), k)
        writer.finish()


@pytest.mark.parametrize("lost", ["geometry_msgs", "definition"])
def test_a_type_that_one_file_lost_is_that_of_the_others(tmp_path: Path, lost: str) -> None:
    """Without it the whole bag could not be read: a topic would have two types."""
    folder = tmp_path / "split"
    folder.mkdir()
    for number, name in enumerate("abc"):
        write_hundred(folder / f"{name}.mcap", 100 * number, chunk_size=2000, compression=CompressionType.NONE)
    damaged = folder / "b.mcap"
    data = bytearray(damaged.read_bytes())
    # The chunk with the channels, and the summary, which repeats them.
    for at in (data.index(lost.encode()), data.rindex(lost.encode())):
        data[at] = 0xFF
    damaged.write_bytes(data)
    before, found, after = recover(folder, tmp_path / "saved")
    assert f"{damaged} lost the type of /w, which other files have" in found.damage
    assert f"{damaged} is damaged: it has text that is not UTF-8" in found.damage or lost == "definition"
    assert (before.state, found.state, after.state) == ("whole", "damaged", "whole")
    assert found.channels == before.channels
    stamps = [stamp for stamp, _ in read_bag(tmp_path / "saved").wrenches("/w")]
    assert len(stamps) == 200 + found.file.counts["/w"] > 200


@pytest.mark.parametrize(("chunked", "added", "lost"), [(True, 0, 0), (False, 0, 0), (True, 5, 0), (True, 0, 5)])
@pytest.mark.parametrize("folder", [True, False])
def test_damage_in_the_first_bytes_costs_no_message(
    tmp_path: Path, chunked: bool, added: int, lost: int, folder: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    for number in range(3):
        write_hundred(bag / f"bag_{number}.mcap", 100 * number, use_chunking=chunked)
    damaged = bag / "bag_1.mcap"
    data = bytearray(damaged.read_bytes())
    data[3] ^= 1
    # The records behind then no longer stand where they should.
    del data[4 : 4 + lost]
    data[4:4] = bytes(range(100, 100 + added))
    damaged.write_bytes(data)
    saved = recover(bag if folder else damaged, tmp_path / ("saved" if folder else "saved.mcap"))
    assert [sum(each.file.counts.values()) for each in saved] == [100] * (3 if folder else 1)
    said = f"{damaged} is damaged: it does not begin like an MCAP file"
    assert saved[len(saved) // 2].damage == [said]
    assert main(["inspect", str(damaged)]) == 2
    assert f"{said}; save what can be read with `rb-dynamics recover`" in capsys.readouterr().err


def test_a_file_of_another_kind_costs_no_other_of_its_bag(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    write_rows(bag / "bag_0.mcap", [("/w", STAMPED, 0, stamped(0, 1.0))])
    (bag / "bag_1.mcap").write_bytes(b"no log at all " * 100)
    whole, other = recover(bag, tmp_path / "saved")
    assert (whole.state, sum(whole.file.counts.values())) == ("whole", 1)
    assert (other.state, sum(other.file.counts.values())) == ("cut off and damaged", 0)
    assert "does not begin like an MCAP file" in other.damage[0]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_disk_that_is_full_at_the_end_leaves_files_that_can_be_read(tmp_path: Path) -> None:
    bag, saved = tmp_path / "bag", tmp_path / "saved"
    bag.mkdir()
    saved.mkdir()
    write_rows(bag / "bag_0.mcap", [("/w", STAMPED, 0, stamped(0, 1.0))])
    (saved / "metadata.yaml").symlink_to("/dev/full")
    with pytest.raises(LogError, match=r"metadata\.yaml: No space left on device; free space, the .mcap files"):
        recover(bag, saved)
    # Part of it would hide them.
    assert [file.name for file in saved.iterdir()] == ["bag_0.mcap"]


def test_a_copy_is_not_mixed_with_files_of_another_bag(tmp_path: Path) -> None:
    long, short, saved = tmp_path / "long", tmp_path / "short", tmp_path / "saved"
    for folder, count in ((long, 2), (short, 1)):
        folder.mkdir()
        for number in range(count):
            write_rows(folder / f"bag_{number}.mcap", [("/w", STAMPED, number, stamped(number, 1.0))])
    for folder in (long, long, short):
        # A copy of before is replaced.
        recover(folder, saved)
        assert len(read_bag(saved).topics["/w"].log_times) == len(list(folder.iterdir()))
    (saved / "bag_0.mcap").rename(saved / "bag_7.mcap")
    with pytest.raises(LogError, match=r"it holds bag_7\.mcap, which would look like a part of the copy"):
        recover(short, saved)
    assert [file.name for file in saved.glob("*.mcap")] == ["bag_7.mcap"]
