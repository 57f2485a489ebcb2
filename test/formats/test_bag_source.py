"""Wrench commands from bags of other programs: MCAP and SQLite, split, compressed, renamed topics."""

from __future__ import annotations

import contextlib
import re
import shutil
import sqlite3
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rb_dynamics.analysis.checks import one_recording
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.errors import LogError
from rb_dynamics.formats.mcap_writer import McapWriter
from rb_dynamics.formats.output_file import OutputFile
from rb_dynamics.formats.rosbag2_metadata import BagFile, write_metadata
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.wrench_bags import read_wrenches

pytest.importorskip("rosbags")

from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
COMMANDS = [Wrench((float(i), 0.0, 0.5), (0.0, -float(i), 0.0), "body", i * 1000) for i in range(20)]


def record(
    path: Path,
    storage: StoragePlugin,
    mode: CompressionMode = CompressionMode.NONE,
    topic: str = "/wrench",
    commands: list[Wrench] = COMMANDS,
    start_ns: int = 10**18,
) -> Path:
    kinds = STORE.types
    vector, stamp = kinds["geometry_msgs/msg/Vector3"], kinds["builtin_interfaces/msg/Time"]
    writer = Writer(path, version=9, storage_plugin=storage)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(topic, "geometry_msgs/msg/WrenchStamped", typestore=STORE)
        for wrench in commands:
            header = kinds["std_msgs/msg/Header"](stamp(*divmod(wrench.stamp_ns, 10**9)), wrench.frame_id)
            content = kinds["geometry_msgs/msg/Wrench"](vector(*wrench.force), vector(*wrench.torque))
            message = kinds["geometry_msgs/msg/WrenchStamped"](header, content)
            data = STORE.serialize_cdr(message, "geometry_msgs/msg/WrenchStamped")
            writer.write(connection, start_ns + wrench.stamp_ns, data)
    return path


@pytest.mark.parametrize("storage", list(StoragePlugin))
@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_bags_of_rosbag2(tmp_path: Path, storage: StoragePlugin, mode: CompressionMode) -> None:
    if storage is StoragePlugin.MCAP and mode is CompressionMode.MESSAGE:
        mode = CompressionMode.STORAGE
    bag = record(tmp_path / "bag", storage, mode)
    assert read_wrenches(bag, ["wrench"]) == [("wrench", wrench) for wrench in COMMANDS]
    topic = read_bag(bag).topics["/wrench"]
    assert (topic.count, topic.log_times[0]) == (20, 10**18)


def test_a_database_without_its_folder(tmp_path: Path) -> None:
    (file,) = record(tmp_path / "bag", StoragePlugin.SQLITE3).glob("*.db3")
    assert [wrench for _, wrench in read_wrenches(file, ["/wrench"])] == COMMANDS


@pytest.mark.parametrize("mode", ["wal", "delete"])
def test_a_database_whose_recorder_was_killed_is_refused(tmp_path: Path, mode: str) -> None:
    """The messages in the file beside it were left out without a word, or those of half a write were read."""
    bag, killed = record(tmp_path / "bag", StoragePlugin.SQLITE3), tmp_path / "killed"
    (file,) = bag.glob("*.db3")
    with contextlib.closing(sqlite3.connect(file, isolation_level=None)) as connection:
        for line in (
            f"PRAGMA journal_mode={mode}",
            # So that half of what is written is in the file.
            "PRAGMA cache_size=1",
            "BEGIN",
            "INSERT INTO messages SELECT id + 100, topic_id, timestamp, zeroblob(5000) FROM messages",
            *["COMMIT"] * (mode == "wal"),
        ):
            connection.execute(line)
        shutil.copytree(bag, killed)
    with pytest.raises(LogError, match=r"bag.db3 is not finished.*bag.db3 'SELECT count"):
        read_bag(killed)
    with contextlib.closing(sqlite3.connect(killed / file.name)) as connection:
        connection.execute("SELECT count(*) FROM messages")
    assert read_bag(killed).topics["/wrench"].count == (40 if mode == "wal" else 20)


def test_a_file_of_the_bag_that_its_metadata_do_not_name_is_told(tmp_path: Path) -> None:
    """It was left out without a word."""
    bag = record(tmp_path / "bag", StoragePlugin.MCAP)
    (file,) = bag.glob("*.mcap")
    part = file.rename(bag / "bag_0.mcap")
    (bag / "metadata.yaml").write_text((bag / "metadata.yaml").read_text().replace(file.name, part.name))
    for other in ("bag_0_copy.mcap", "other_1.mcap"):
        (bag / other).write_bytes(part.read_bytes())
    assert read_bag(bag).topics["/wrench"].count == 20
    part.with_name("bag_1.mcap").write_bytes(part.read_bytes())
    with pytest.raises(
        LogError, match=r"bag holds bag_1.mcap, which its metadata.yaml does not name.*; remove metadata.yaml"
    ):
        read_bag(bag)


def test_split_files_without_metadata_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    # Equal stamps keep the order of the bag: file 10 comes after file 9.
    for number in (9, 10):
        part = [Wrench((float(number), 0.0, 0.0), (0.0, 0.0, 0.0), "body", 5)]
        (file,) = record(tmp_path / f"part_{number}", StoragePlugin.MCAP, commands=part).glob("*.mcap")
        file.rename(folder / f"bag_{number}.mcap")
    assert [wrench.force[0] for _, wrench in read_wrenches(folder, ["wrench"])] == [9.0, 10.0]


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.FILE, None])
def test_files_are_read_in_the_order_of_their_times(tmp_path: Path, mode: CompressionMode | None) -> None:
    """Names or metadata in another order made two recordings of one; None is without metadata."""
    folder = tmp_path / "bag"
    folder.mkdir()
    facts = []
    for name, second in (("bag_0", 200), ("bag_1", 100), ("bag_3", 0), ("bag_2", 300)):
        start, storage = 10**18 + second * 10**9, StoragePlugin.SQLITE3 if mode else StoragePlugin.MCAP
        bag = record(tmp_path / name, storage, mode or CompressionMode.NONE, start_ns=start)
        (file,) = (each for each in bag.iterdir() if each.suffix != ".yaml")
        file = file.rename(folder / file.name)
        facts.append(BagFile(file.name, start, start + 19000, Counter({"/wrench": 20})))
    if mode:
        write_metadata(folder, [], facts)
        told = (folder / "metadata.yaml").read_text().replace("mode: ''", f"mode: {mode.name}")
        (folder / "metadata.yaml").write_text(told.replace("storage_identifier: mcap", "storage_identifier: sqlite3"))
    bag = read_bag(folder)
    assert np.diff(bag.topics["/wrench"].log_times).min() >= 0
    assert [boundary.begin_ns - boundary.end_ns for boundary in bag.boundaries] == [100 * 10**9 - 19000] * 3
    assert bag.complete


def test_files_named_in_another_order_are_one_recording_and_copies_of_one_are_not(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    slow = [Wrench((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), "body", k * 10**9) for k in range(20)]
    for name, second in (("first", 0), ("then", 20), ("last", 40)):
        bag = record(tmp_path / name, StoragePlugin.MCAP, commands=slow, start_ns=10**18 + second * 10**9)
        (bag / f"{name}.mcap").rename(folder / f"{name}.mcap")
    found = one_recording(read_track(read_bag(folder)))
    assert found.passed
    assert "3 files that follow one another, in the order of their times, not of their names" in found.detail
    shutil.copy(folder / "then.mcap", folder / "copy.mcap")
    assert "begins 19 s before" in one_recording(read_track(read_bag(folder))).detail


def test_a_topic_of_another_name_is_mapped(tmp_path: Path) -> None:
    bag = record(tmp_path / "bag", StoragePlugin.MCAP, topic="/robot/cmd")
    with pytest.raises(LogError, match=r"/robot/cmd \(20 messages\).*--topic TOPIC=CHANNEL"):
        read_wrenches(bag, ["wrench"])
    for mapping in ({"/robot/cmd": "wrench"}, {"robot/cmd": "/wrench"}):
        assert read_wrenches(bag, ["wrench", "other"], mapping) == [("wrench", wrench) for wrench in COMMANDS]
    with pytest.raises(LogError, match=r"mapped are \['cmd'\], expected wrench topics of the bag: /robot/cmd"):
        read_wrenches(bag, ["wrench"], {"cmd": "wrench"})
    with pytest.raises(LogError, match=r"mapped to 'push', expected a channel of the scene: \['wrench'\]"):
        read_wrenches(bag, ["wrench"], {"/robot/cmd": "push"})


def test_a_mapped_channel_hears_that_topic_only(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    for number, topic in enumerate(("/wrench", "/cmd")):
        part = [Wrench((float(number), 0.0, 0.0), (0.0, 0.0, 0.0), "body", 5)]
        (file,) = record(tmp_path / f"part_{number}", StoragePlugin.MCAP, topic=topic, commands=part).glob("*.mcap")
        file.rename(folder / f"bag_{number}.mcap")
    assert [wrench.force[0] for _, wrench in read_wrenches(folder, ["wrench"], {"/cmd": "wrench"})] == [1.0]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "rosbag2_bagfile_information: 3\n",
        "}{",
        "- " * 20_000,
        "[1," * 300_000,
        "[" + "1," * 50_000 + "]",
        "a: &a [1]\nrosbag2_bagfile_information: {relative_file_paths: *a}\n",
        "rosbag2_bagfile_information: {relative_file_paths: [1]}\n",
        "rosbag2_bagfile_information: {relative_file_paths: [2001-99-99]}\n",
        " " * (1 << 20) + "#",
    ],
    ids=lambda text: text[:20],
)
def test_a_damaged_metadata_file_is_named(tmp_path: Path, text: str) -> None:
    bag = record(tmp_path / "bag", StoragePlugin.MCAP)
    (bag / "metadata.yaml").write_text(text)
    with pytest.raises(LogError, match=r"metadata\.yaml is not what rosbag2 writes"):
        read_bag(bag)


def test_a_file_name_with_a_nul_is_no_file(tmp_path: Path) -> None:
    bag = record(tmp_path / "bag", StoragePlugin.MCAP)
    text = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(re.sub(r"(?<=relative_file_paths:\n  - ).*", r'"bag\\0_0.mcap"', text))
    with pytest.raises(LogError, match=r"metadata\.yaml is not what rosbag2 writes .*the name .*x00_0\.mcap"):
        read_bag(bag)


def test_what_does_not_fit_unpacked_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = record(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.FILE)
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=100))
    with pytest.raises(LogError, match=r"bag\.db3\.zstd does not fit into .* when it is unpacked"):
        read_bag(bag)


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_file_that_was_renamed_is_named(tmp_path: Path, storage: StoragePlugin) -> None:
    bag = record(tmp_path / "bag", storage)
    (file,) = (each for each in bag.iterdir() if each.suffix in (".db3", ".mcap"))
    renamed = file.rename(file.with_stem("my_run"))
    with pytest.raises(LogError, match=rf"it was renamed; give .*{renamed.name} itself"):
        read_bag(bag)
    assert read_bag(renamed).topics
    (bag / "metadata.yaml").unlink()
    if storage is StoragePlugin.SQLITE3:
        with pytest.raises(LogError, match=rf"holds no bag: .*; give .*{renamed.name} itself"):
            read_bag(bag)


@pytest.mark.parametrize("name", ["bag.db3", "bag.mcap"])
def test_what_stands_for_a_file_of_git_lfs_is_told(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 491278336\n")
    with pytest.raises(LogError, match=r"Git LFS keeps elsewhere.*git lfs pull"):
        read_bag(tmp_path / name)


def test_a_folder_without_a_bag_and_a_damaged_database_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"holds no bag: expected metadata\.yaml"):
        read_bag(tmp_path)
    (tmp_path / "bag.db3").write_text("not a database")
    with pytest.raises(LogError, match=r"cannot read .*bag\.db3"):
        read_bag(tmp_path / "bag.db3")


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_a_bag_compressed_as_a_whole_that_is_cut_off_or_damaged_is_refused(
    tmp_path: Path, storage: StoragePlugin
) -> None:
    (file,) = record(tmp_path / "bag", storage, CompressionMode.FILE).glob("*.zstd")
    whole = file.read_bytes()
    for at in range(0, len(whole) // 2, len(whole) // 50):
        file.write_bytes(whole[:at])
        with pytest.raises(LogError, match=r"cannot read .*\.zstd: .+; check the path"):
            read_bag(tmp_path / "bag")
        file.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
        with contextlib.suppress(LogError):
            read_bag(tmp_path / "bag")


CELLS = {"name": "/wrench", "type": "std_msgs/msg/Float64", "timestamp": 5, "data": bytes(12)}


def database(path: Path, cells: Mapping[str, object]) -> Path:
    """Return a bag of one message in one file, with any `cells`, since SQLite allows any type in any column."""
    with contextlib.closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE topics(id, name, type, serialization_format, offered_qos_profiles)")
        connection.execute("CREATE TABLE messages(id, topic_id, timestamp, data)")
        connection.execute("INSERT INTO topics VALUES(1, :name, :type, 'cdr', '')", cells)
        connection.execute("INSERT INTO messages VALUES(1, 1, :timestamp, :data)", cells)
    return path


@pytest.mark.parametrize(
    ("cell", "found"),
    [
        ("name", None),
        ("name", b"/wrench"),
        ("type", 3),
        ("timestamp", None),
        ("timestamp", "5"),
        ("timestamp", 5.0),
        ("data", None),
        ("data", "text"),
        ("data", 12),
        ("data", 2**63 - 1),
    ],
)
def test_a_cell_of_another_type_is_refused(tmp_path: Path, cell: str, found: object) -> None:
    assert read_bag(database(tmp_path / "sound.db3", CELLS)).topics["/wrench"].log_times.tolist() == [5]
    with pytest.raises(LogError, match=r"cannot read .*bag\.db3: .+; check the path"):
        read_bag(database(tmp_path / "bag.db3", CELLS | {cell: found}))


def test_the_metadata_alone_is_answered_with_the_folder(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    with pytest.raises(LogError, match=f"give the folder: {re.escape(str(tmp_path))}$"):
        read_bag(tmp_path / "metadata.yaml")


def test_what_was_lost_in_any_file_of_a_bag_is_kept(tmp_path: Path) -> None:
    lost = ({"reason": "damaged", "missing_ns": "1 2"}, {}, {"reason": "damaged", "missing_ns": "7 9"})
    for number, facts in enumerate(lost):
        with contextlib.closing(OutputFile(tmp_path / f"bag_{number}.mcap")) as file:
            writer = McapWriter(file, "test")
            writer.begin()
            if facts:
                writer.add_metadata("rb_dynamics.interrupted", facts)
            writer.finish()
    bag = read_bag(tmp_path)
    assert bag.missing == [(1, 2), (7, 9)]
    assert bag.whole
    assert bag.ended
    assert not bag.complete


def packed_message(path: Path, size: int) -> Path:
    """Return a bag of one message that unpacks to so many bytes."""
    import zstandard

    bag = record(path, StoragePlugin.SQLITE3, CompressionMode.MESSAGE, commands=COMMANDS[:1])
    (file,) = bag.glob("*.db3")
    frame = zstandard.ZstdCompressor().compressobj(size=size)
    data = b"".join([frame.compress(bytes(min(2**24, size - at))) for at in range(0, size, 2**24)]) + frame.flush()
    with contextlib.closing(sqlite3.connect(file)) as connection, connection:
        connection.execute("UPDATE messages SET data = ?", (data,))
    return bag


def test_a_small_message_that_unpacks_to_a_large_one_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"message on /wrench, log time 10{18} ns, unpacks to more than 268435456 bytes"):
        read_bag(packed_message(tmp_path / "bag", 2**28 + 1))


def test_a_message_that_cannot_be_unpacked_is_refused(tmp_path: Path) -> None:
    bag = packed_message(tmp_path / "bag", 10)
    (file,) = bag.glob("*.db3")
    for fault, data in (("ends too soon", b""), ("ends too soon", b"\x28\xb5\x2f\xfd"), ("Unknown frame", b"12345678")):
        with contextlib.closing(sqlite3.connect(file)) as connection, connection:
            connection.execute("UPDATE messages SET data = ?", (data,))
        with pytest.raises(LogError, match=rf"cannot be unpacked \(.*{fault}.*\)"):
            read_bag(bag)


@pytest.mark.parametrize("storage", list(StoragePlugin))
@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_two_recordings_in_one_folder_are_told_apart(
    tmp_path: Path, storage: StoragePlugin, mode: CompressionMode
) -> None:
    if storage is StoragePlugin.MCAP and mode is CompressionMode.MESSAGE:
        mode = CompressionMode.STORAGE
    folder, names = tmp_path / "both", []
    for number, later_ns in enumerate((0, 10**14)):
        bag = record(tmp_path / f"bag_{number}", storage, mode, start_ns=10**18 + later_ns)
        (file,) = (each for each in bag.iterdir() if each.suffix != ".yaml")
        names.append(file.name)
        folder.mkdir(exist_ok=True)
        file.rename(folder / file.name)
        text = (bag / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(text.replace(f"  - {names[1]}\n", f"  - {names[0]}\n  - {names[1]}\n", 1))
    bag = read_bag(folder)
    assert bag.topics["/wrench"].count == 40
    (boundary,) = bag.boundaries
    assert (boundary.begin_ns - boundary.end_ns) // 10**12 == 99
    assert not one_recording(read_track(bag)).passed


@pytest.mark.parametrize(("lost", "holes", "ended"), [((1,), 1, True), ((0,), 1, True), ((1, 2), 0, False)])
def test_of_files_that_the_metadata_name_those_that_are_there_are_read(
    tmp_path: Path, lost: tuple[int, ...], holes: int, ended: bool
) -> None:
    """One missing file was an error of every command: nothing of the others could be read."""
    folder = tmp_path / "bag"
    folder.mkdir()
    facts = []
    for number in range(3):
        start = 10**18 + number * 10**9
        (file,) = record(tmp_path / str(number), StoragePlugin.MCAP, start_ns=start).glob("*.mcap")
        file.rename(folder / f"bag_{number}.mcap")
        facts.append(BagFile(f"bag_{number}.mcap", start, start + 1, Counter({"/wrench": 20})))
    write_metadata(folder, [], facts)
    whole = read_bag(folder)
    assert whole.complete
    for number in lost:
        (folder / f"bag_{number}.mcap").unlink()
    bag = read_bag(folder)
    assert bag.topics["/wrench"].count * 3 == whole.topics["/wrench"].count * (3 - len(lost))
    assert bag.missing_files == [f"bag_{number}.mcap" for number in lost]
    assert (bag.complete, bag.ended, len(bag.missing)) == (False, ended, holes)
    if lost == (0,):
        # What is held here began in the missing file: it is not known, and not zero.
        assert bag.missing == [(10**18, 10**18 + 10**9)]


def test_a_number_that_is_skipped_in_the_names_of_files_is_a_missing_file(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Without metadata.yaml the names alone say so; dates in names are no numbers of files."""
    for folder, numbers, absent in (
        ("bag", (0, 1, 4), ["bag_2.mcap", "bag_3.mcap"]),
        ("days", (20261124, 20261126), []),
        ("late", (9, 10, 11), []),
    ):
        path = tmp_path / folder
        path.mkdir()
        for place, number in enumerate(numbers):
            start = 10**18 + place * 10**9
            (file,) = record(tmp_path / f"{folder}{place}", StoragePlugin.MCAP, start_ns=start).glob("*.mcap")
            file.rename(path / f"{folder}_{number}.mcap")
        bag = read_bag(path)
        assert bag.missing_files == absent
        assert len(bag.missing) == bool(absent)
        caplog.clear()
        read_wrenches(path, ["wrench"])
        assert ("is without bag_2.mcap, bag_3.mcap" in caplog.text) == bool(absent)  # what simulate warns of
