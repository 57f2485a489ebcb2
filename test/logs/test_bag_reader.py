"""Reading ROS 2 MCAP files: those of other writers, our own, truncated, damaged and hostile ones."""

from __future__ import annotations

import logging
import random
import struct
import sys
import time
import tracemalloc
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_rows import STAMPED, Row, stamped, write_rows

from rb_dynamics import parse_scene, simulate
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import summarize
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.body.state import State
from rb_dynamics.errors import LogError, MissingExtraError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.mcap_records import MAX_RECORD_BYTES, McapFile
from rb_dynamics.formats.recovery import recover
from rb_dynamics.loads.wrench import Wrench, WrenchFrames
from rb_dynamics.logs.bag_reader import Bag, read_bag
from rb_dynamics.logs.wrench_bags import read_wrenches
from rb_dynamics.run.sample import Sample
from rb_dynamics.run.sink import AppliedWrench, RunInfo
from rb_dynamics.scene.model import Scene
from rb_dynamics.sinks.mcap_sink import McapSink

pytest.importorskip("mcap")

from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, Header
from mcap.writer import CompressionType, Writer

SLEW = Path(__file__).parents[2] / "examples" / "slew.mcap"
WRENCH = "geometry_msgs/msg/Wrench"
MAGIC = b"\x89MCAP0\r\n"


def write_log(path: Path, count: int) -> Path:
    """Write a log of our own: `count` samples, a wrench before every tenth."""
    scene = Scene(RigidBody.from_diagonal(2.0, (1.0, 2.0, 2.5)), WrenchFrames(), State(), text="body: {}\n")
    sink = McapSink(path)
    sink.open(RunInfo(scene, "rk4", {"seed": ""}))
    zero, identity = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    for i in range(count):
        force = (float(i), 0.5, -0.5)
        if i % 10 == 0:
            sink.write(AppliedWrench(i * 1000, "wrench", Wrench(force, zero, "body", i * 1000), "body", force, zero))
        numbers = (0.1 * i, 0.2 * i, 1.0 / (i + 1))
        energies = (1.0 * i, 2.0, 3.0)
        sink.write(Sample(i * 1000, numbers, identity, force, numbers, force, numbers, *energies, zero, zero))
    sink.close({"steps": "1"})
    return path


def test_the_recorded_flight() -> None:
    commands = read_wrenches(SLEW, ["wrench/body", "/wrench/world"])
    assert [topic for topic, _ in commands].count("wrench/body") == 600
    assert [topic for topic, _ in commands].count("/wrench/world") == 600
    assert [wrench.stamp_ns for _, wrench in commands[::2]] == [i * 100_000_000 for i in range(600)]
    assert {topic: wrench.frame_id for topic, wrench in commands} == {"wrench/body": "body", "/wrench/world": "world"}
    assert commands[0][1] == Wrench((0.0, 0.0, 0.0), (-0.01545, -0.0255, 0.0315), "body", 0)
    bag = read_bag(SLEW)
    assert bag.complete
    times, poses = bag.poses("/truth/pose")
    np.testing.assert_array_equal(times, np.arange(601) * 100_000_000)
    np.testing.assert_allclose(np.linalg.norm(poses[:, 3:], axis=1), 1.0, rtol=1e-14)
    assert bag.twists("/truth/twist")[1].shape == (601, 6)


def test_the_recorded_flight_as_rosbags_reads_it() -> None:
    highlevel = pytest.importorskip("rosbags.highlevel")
    expected = []
    with highlevel.AnyReader([SLEW]) as reader:
        chosen = [each for each in reader.connections if each.topic == "/wrench/body"]
        for connection, _, data in reader.messages(chosen):
            message = reader.deserialize(data, connection.msgtype)
            force, torque = message.wrench.force, message.wrench.torque
            expected.append((force.x, force.y, force.z, torque.x, torque.y, torque.z))
    found = [(*wrench.force, *wrench.torque) for _, wrench in read_wrenches(SLEW, ["wrench/body"])]
    assert found == expected


@pytest.mark.parametrize(("name", "remedy"), [("w.csv", "rb-dynamics convert "), ("s.yaml", "rb-dynamics simulate ")])
def test_what_is_no_log_is_told_what_it_may_become(tmp_path: Path, name: str, remedy: str) -> None:
    (tmp_path / name).write_text("body: {mass: 1}")
    with pytest.raises(LogError, match=f"{name} does not begin like an MCAP file; .*{remedy}"):
        read_wrenches(tmp_path / name, ["wrench"])
    (tmp_path / name).write_text("")
    with pytest.raises(LogError, match="it is empty"):
        read_wrenches(tmp_path / name, ["wrench"])


def test_a_parquet_table_is_told_how_to_become_csv(tmp_path: Path) -> None:
    (tmp_path / "w.parquet").write_bytes(b"PAR1\x15\x04PAR1")
    with pytest.raises(
        LogError,
        match=r"w\.parquet is a Parquet table, expected .*; tables are read as CSV only: .*to_csv\(\"w\.csv\", ind",
    ):
        read_wrenches(tmp_path / "w.parquet", ["wrench"])


def test_a_file_cut_off_before_its_first_message_is_told_apart(tmp_path: Path, example_dir: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((example_dir / "slew.mcap").read_bytes()[:100])
    with pytest.raises(LogError, match=r"wrench topics are none.*cut off before a whole message"):
        read_wrenches(cut, ["wrench"])


def test_older_type_names_and_other_encodings(tmp_path: Path) -> None:
    row: Row = ("/w", "geometry_msgs/WrenchStamped", 0, stamped(5, 1.0))
    assert read_wrenches(write_rows(tmp_path / "old.mcap", [row]), ["w"])[0][1].stamp_ns == 5
    with pytest.raises(LogError, match="wrench topics are none"):
        read_wrenches(write_rows(tmp_path / "ros1.mcap", [row], encoding="ros1"), ["w"])


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.ZSTD},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE},
        {"compression": CompressionType.ZSTD, "chunk_size": 300},
        {"compression": CompressionType.NONE, "use_chunking": False},
        {"compression": CompressionType.ZSTD, "use_statistics": False, "repeat_channels": False, "enable_crcs": False},
    ],
)
def test_every_way_to_write_a_container(tmp_path: Path, options: dict[str, Any]) -> None:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, i)) for i in range(100)]
    bag = read_bag(write_rows(tmp_path / "a.mcap", rows, **options))
    assert bag.complete
    assert [wrench.force[0] for _, wrench in bag.wrenches("/w")] == list(range(100))


def test_a_bag_of_rosbags(tmp_path: Path) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    with rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/wrench", STAMPED, typestore=store)
        text = writer.add_connection("/text", "std_msgs/msg/String", typestore=store)
        writer.write(
            text, 1, bytes(store.serialize_cdr(store.types["std_msgs/msg/String"]("x"), "std_msgs/msg/String"))
        )
        for i in range(5):
            writer.write(connection, i, stamped(i, i))
    (path,) = (tmp_path / "bag").glob("*.mcap")
    assert [wrench.stamp_ns for _, wrench in read_wrenches(path, ["wrench"])] == list(range(5))
    unknown = read_bag(path).topics["/text"]
    assert (unknown.type_name, unknown.count, unknown.messages) == ("std_msgs/msg/String", 1, [])
    assert read_wrenches(tmp_path / "bag", ["wrench"]) == read_wrenches(path, ["wrench"])


def test_our_own_log_as_arrays(tmp_path: Path) -> None:
    bag = read_bag(write_log(tmp_path / "run.mcap", 50))
    index = np.arange(50)
    for times, rows in (bag.poses("/pose"), bag.poses("/odom")):
        assert (times.dtype, rows.dtype) == (np.int64, np.float64)
        np.testing.assert_array_equal(times, index * 1000)
        np.testing.assert_array_equal(rows[:, 0], 0.1 * index)
        np.testing.assert_array_equal(rows[:, 6], 1.0)
    for _, rows in (bag.twists("/twist"), bag.twists("/odom")):
        np.testing.assert_array_equal(rows[:, 0], index)
        np.testing.assert_array_equal(rows[:, 5], 1.0 / (index + 1))
    np.testing.assert_array_equal(bag.vectors("/linear_momentum")[1][:, 1], 0.2 * index)
    times, energy = bag.scalars("/energy/kinetic")
    np.testing.assert_array_equal(times, index * 1000)
    np.testing.assert_array_equal(energy, index)
    assert bag.wrenches("/wrench")[1] == (10_000, Wrench((10.0, 0.5, -0.5), (0.0, 0.0, 0.0), "body", 10_000))
    assert bag.topics["/twist"].texts == [(0, ("body",))]
    assert tuple(bag.topics["/inertia"].numbers[0, :4]) == (2.0, 0.0, 0.0, 0.0)
    assert "transient_local" in bag.topics["/inertia"].qos
    assert bag.scalars("/energy/work")[1].shape == (50,)
    empty = read_bag(write_log(tmp_path / "empty.mcap", 0))
    assert (empty.poses("/pose")[1].shape, empty.scalars("/energy/work")[1].shape) == ((0, 7), (0,))


def test_messages_that_differ_in_frame_or_length_or_endianness(tmp_path: Path) -> None:
    store = pytest.importorskip("rosbags.typesys")
    jazzy = store.get_typestore(store.Stores.ROS2_JAZZY)
    name = "geometry_msgs/msg/Vector3Stamped"
    for count, frames in enumerate((["a", "b"], ["a", "longer"], ["a", "a"]), 1):
        rows: list[Row] = []
        for i, frame in enumerate(frames):
            data = cdr.encode(name, -(10**9) + i, frame, (i, 2.0 * i, 0.1))
            if count == 3:
                data = bytes(jazzy.serialize_cdr(jazzy.deserialize_cdr(data, name), name, little_endian=False))
            rows.append(("/v", name, i, data))
        bag = read_bag(write_rows(tmp_path / f"{count}.mcap", rows))
        times, vectors = bag.vectors("/v")
        assert times.tolist() == [-1_000_000_000, -999_999_999]
        assert vectors.tolist() == [[0.0, 0.0, 0.1], [1.0, 2.0, 0.1]]
        assert {text for (text,) in bag.topics["/v"].kinds[0]} == set(frames)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda bag: bag.poses("/nowhere"), "no such topic, expected .*PoseStamped or nav_msgs/msg/Odom.*; .*'/pose'"),
        (lambda bag: bag.poses("/twist"), "type 'geometry_msgs/msg/TwistStamped', expected"),
        (lambda bag: bag.poses("/energy/work"), "type 'std_msgs/msg/Float64', expected"),
    ],
)
def test_a_topic_of_another_kind_is_an_error(tmp_path: Path, ask: Callable[[Bag], object], message: str) -> None:
    bag = read_bag(write_log(tmp_path / "run.mcap", 2))
    with pytest.raises(LogError, match=message):
        ask(bag)


def test_one_topic_of_two_publishers_is_merged_and_of_two_types_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    for second, fits in ((STAMPED, True), (WRENCH, False)):
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start("ros2", "test")
            for type_name in (STAMPED, second):
                schema = writer.register_schema(type_name, "ros2msg", b"")
                channel = writer.register_channel("/w", "cdr", schema)
                writer.add_message(channel, 1, stamped(1, 1.0), 1)
            writer.finish()
        if fits:
            assert read_bag(path).topics["/w"].count == 2
        else:
            with pytest.raises(LogError, match="both types"):
                read_bag(path)


def test_a_file_cut_off_anywhere_gives_its_beginning(tmp_path: Path) -> None:
    data = write_log(tmp_path / "run.mcap", 600).read_bytes()
    whole = read_bag(tmp_path / "run.mcap").poses("/pose")[1]
    source = random.Random(3)
    cut = tmp_path / "cut.mcap"
    counts = []
    lengths = sorted({8, 9, 17, len(data) - 1, *(source.randrange(8, len(data)) for _ in range(60))})
    for length in lengths:
        cut.write_bytes(data[:length])
        bag = read_bag(cut)
        assert not bag.complete
        poses = bag.poses("/pose")[1] if "/pose" in bag.topics else whole[:0]
        np.testing.assert_array_equal(poses, whole[: len(poses)])
        counts.append(len(poses))
    assert counts == sorted(counts)
    # The log is of several chunks, so a cut in the middle leaves the chunks before it.
    assert {0, 600} < set(counts)


def test_commands_of_a_file_cut_off_are_used_with_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_log(tmp_path / "run.mcap", 600)
    path.write_bytes(path.read_bytes()[:-300])
    with caplog.at_level(logging.WARNING):
        assert len(read_wrenches(path, ["wrench"])) == 60
    assert "cut off" in caplog.text


def test_zeros_after_a_power_loss_end_the_file(tmp_path: Path) -> None:
    path = write_log(tmp_path / "run.mcap", 100)
    path.write_bytes(path.read_bytes()[:-40] + bytes(5000))
    bag = read_bag(path)
    assert (bag.complete, bag.topics["/pose"].count) == (False, 100)
    whole = write_log(tmp_path / "whole.mcap", 100).read_bytes()
    path.write_bytes(whole[:8] + bytes(9) + whole[8:])
    # Its end is there, so nothing was cut off.
    with pytest.raises(LogError, match="is damaged: it has no record at 8, but more after it"):
        read_bag(path)


@pytest.mark.parametrize("content", [b"", b"\x89MCA", b"#ROSBAG V2.0\n", b"SQLite format 3\0", bytes(100)])
def test_what_is_no_mcap_file_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=r"does not begin like an MCAP file|is a bag of ROS 1|is an SQLite bag"):
        read_bag(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"cannot read .*none\.mcap: No such file"):
        read_wrenches(tmp_path / "none.mcap", ["wrench"])


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.NONE])
def test_flipped_bits_are_a_log_error_or_harmless(tmp_path: Path, compression: CompressionType) -> None:
    rows: list[Row] = [("/w", STAMPED, i, stamped(i, i)) for i in range(20)]
    data = write_rows(tmp_path / "a.mcap", rows, compression=compression, chunk_size=500).read_bytes()
    source = random.Random(11)
    bad = tmp_path / "bad.mcap"
    refused = 0
    for _ in range(300):
        flipped = bytearray(data)
        flipped[source.randrange(8, len(data))] ^= 1 << source.randrange(8)
        bad.write_bytes(flipped)
        try:
            for topic in read_bag(bad).topics.values():
                assert not topic.count or topic.numbers.shape == (topic.count, 6)
        except LogError:
            refused += 1
    assert refused > 50


def chunk_file(path: Path, chunk: Chunk) -> Path:
    builder = RecordBuilder()
    Header("ros2", "test").write(builder)
    chunk.write(builder)
    path.write_bytes(MAGIC + builder.end())
    return path


def bomb(compression: str) -> bytes:
    """Return compressed data of twice the allowed size."""
    size = 2 * MAX_RECORD_BYTES
    if compression == "zstd":
        zstandard = pytest.importorskip("zstandard")
        packer = zstandard.ZstdCompressor().compressobj(size=size)
        return b"".join([*(packer.compress(bytes(2**24)) for _ in range(size // 2**24)), packer.flush()])
    frame = pytest.importorskip("lz4.frame")
    out = BytesIO()
    with frame.open(out, "wb") as packed:
        for _ in range(size // 2**24):
            packed.write(bytes(2**24))
    return out.getvalue()


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("claimed", [1000, 2 * MAX_RECORD_BYTES])
def test_a_chunk_that_swells_is_refused_before_it_fills_the_memory(
    tmp_path: Path, compression: str, claimed: int
) -> None:
    chunk = Chunk(compression, bomb(compression), 0, 0, 0, claimed)
    path = chunk_file(tmp_path / "a.mcap", chunk)
    chunk.data = b""
    tracemalloc.start()
    try:
        with pytest.raises(LogError, match=r"a\.mcap is damaged"):
            read_bag(path)
        assert tracemalloc.get_traced_memory()[1] < 32 * 2**20
    finally:
        tracemalloc.stop()


def test_a_record_beyond_the_limit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    length = MAX_RECORD_BYTES + 1
    with path.open("wb") as file:
        file.write(MAGIC + b"\x06" + length.to_bytes(8, "little"))
        file.truncate(length + 100)  # holes take no room on the disk
    with pytest.raises(LogError, match=f"{length} bytes"):
        read_bag(path)


@pytest.mark.parametrize(
    ("chunk", "message"),
    [
        (Chunk("brotli", b"", 0, 0, 0, 0), "compressed with 'brotli', expected one of"),
        (Chunk("", b"\x05\xff", 0, 0, 0, 2), "ends within a record"),
        (Chunk("", b"\x05" + (99).to_bytes(8, "little") + bytes(20), 0, 0, 0, 29), "ends within a record"),
        (Chunk("", b"\x05" + (3).to_bytes(8, "little") + bytes(3), 0, 0, 0, 12), "message without its times"),
        (Chunk("", b"\x05" + (22).to_bytes(8, "little") + bytes(22), 0, 0, 0, 31), "channel 0, which it does not"),
        (Chunk("", b"\x04" + (2).to_bytes(8, "little") + bytes(2), 0, 0, 0, 11), "shorter than its fields"),
        (Chunk("", b"abc", 0, 0, 1, 3), "checksum"),
        (Chunk("", b"abc", 0, 0, 0, 4), "checksum"),
    ],
)
def test_a_damaged_chunk_is_described(tmp_path: Path, chunk: Chunk, message: str) -> None:
    with pytest.raises(LogError, match=message):
        read_bag(chunk_file(tmp_path / "a.mcap", chunk))


def test_without_zstandard_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_log(tmp_path / "run.mcap", 1)
    monkeypatch.setitem(sys.modules, "zstandard", None)
    with pytest.raises(MissingExtraError, match="zstandard"):
        read_bag(path)


def test_the_container_alone(tmp_path: Path) -> None:
    file = McapFile(write_log(tmp_path / "run.mcap", 3))
    first = next(iter(file.messages()))
    assert (first.channel.topic, first.log_time, first.publish_time) == ("/inertia", 0, 0)
    assert not file.complete
    assert len(list(file.messages())) == 1 + 3 * 9 + 2
    assert file.complete
    assert set(file.metadata) >= {"rb_dynamics", "rb_dynamics.topics", "rb_dynamics.result"}
    assert file.attachments == {"scene.yaml": b"body: {}\n"}


def packed(*records: tuple[int, bytes]) -> bytes:
    """Return a file of these records, without an end."""
    return MAGIC + plain(*records)


def plain(*records: tuple[int, bytes]) -> bytes:
    return b"".join(struct.pack("<BQ", opcode, len(content)) + content for opcode, content in records)


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


POSES = [
    (3, struct.pack("<H", 1) + text("geometry_msgs/msg/PoseStamped") + text("ros2msg") + bytes(4)),
    (4, struct.pack("<HH", 1, 1) + text("/pose") + text("cdr") + bytes(4)),
]


def a_chunk(data: bytes) -> tuple[int, bytes]:
    """Return the record of a compressed chunk."""
    zstandard = pytest.importorskip("zstandard")
    content = zstandard.ZstdCompressor().compress(data)
    return 6, struct.pack("<QQQI", 0, 0, len(data), 0) + text("zstd") + struct.pack("<Q", len(content)) + content


def test_small_chunks_are_taken_together_up_to_a_damage(tmp_path: Path) -> None:
    def chunk(first: int) -> tuple[int, bytes]:
        heads = (struct.pack("<HIQQ", 1, 0, at, at) for at in range(first, first + 3))
        return a_chunk(plain(*((5, head + bytes(60)) for head in heads)))

    path = tmp_path / "small.mcap"
    path.write_bytes(packed(*POSES, *map(chunk, range(0, 300, 3)), a_chunk(b"\5" + bytes(20)), chunk(300)))
    blocks = McapFile(path).blocks()
    block = next(blocks)
    assert block.log_times.tolist() == [*range(300)]
    assert [rows.shape for rows in block.rows()] == [(300, 60)]
    with pytest.raises(LogError, match="a message without its times"):
        next(blocks)
    saved = McapFile(path, salvage=True)
    assert [message.log_time for message in saved.messages()] == [*range(303)]
    assert "a message without its times" in saved.damage[0]
    assert "ends within a record" in saved.damage[1]


@pytest.mark.parametrize(
    "record",
    [(99, b""), (5, struct.pack("<HIQQ", 1, 0, 5, 5)), POSES[0]],
    ids=["records of no kind", "empty messages", "schemas"],
)
def test_kilobytes_that_hold_millions_of_records_are_refused_at_once(tmp_path: Path, record: tuple[int, bytes]) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(packed(*POSES, *[a_chunk(plain(record) * 2_000_000)] * 3))
    assert path.stat().st_size < 60_000
    for read in (read_bag, lambda path: recover(path, tmp_path / "saved.mcap")):
        began = time.process_time()
        with pytest.raises(LogError, match="holds more records than a recording of its size"):
            read(path)
        # Each of millions of records took over a minute.
        assert time.process_time() - began < 20.0


def test_the_most_repetitive_recording_is_read(tmp_path: Path) -> None:
    """A constant number, a million times a second, which compresses extremely well."""
    data = b"".join(
        struct.pack("<BQHIQQ", 5, 22 + 12, 1, 0, k, k) + b"\0\1\0\0" + bytes(8) for k in range(0, 400_000_000, 1000)
    )
    path = tmp_path / "zero.mcap"
    path.write_bytes(packed(*POSES, a_chunk(data)))
    assert sum(1 for _ in McapFile(path).messages()) == 400_000


def test_a_time_beyond_2_63_is_damage_and_all_else_is_recovered(tmp_path: Path) -> None:
    def message(at: int) -> tuple[int, bytes]:
        return 5, struct.pack("<HIQQ", 1, 0, at, at) + cdr.encode("geometry_msgs/msg/PoseStamped", 0, "w", (0.0,) * 7)

    path, saved = tmp_path / "late.mcap", tmp_path / "saved.mcap"
    times = [1, 2**63, 2**64 - 1, 2, 2**63, 3]
    path.write_bytes(packed(*POSES, a_chunk(plain(*map(message, times[:4]))), *map(message, times[4:])))
    with pytest.raises(LogError, match=r"is damaged: .* on /pose of log time 9223372036854775808 ns .*rb-dynamics rec"):
        read_bag(path)
    (found,) = recover(path, saved)
    assert len(found.damage) == 3
    assert read_bag(saved).topics["/pose"].log_times.tolist() == [1, 2, 3]


def test_the_odometry_of_an_own_log_need_not_be_kept(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    simulate(parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 0.1\n"), [], [McapSink(log)])
    whole, less = read_bag(log), read_bag(log, repeated=False)
    assert whole.topics["/odom"].numbers.shape == (11, 13)
    assert less.topics["/odom"].numbers.shape == (11, 0)
    assert {name: topic.count for name, topic in less.topics.items()} == {
        name: topic.count for name, topic in whole.topics.items()
    }
    assert summarize(read_track(less)).checks == summarize(read_track(whole)).checks
