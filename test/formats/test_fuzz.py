"""Any bag gives either its readable content or a `LogError`, and no file outside it is touched."""

from __future__ import annotations

import contextlib
import functools
import sqlite3
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from rb_dynamics import parse_scene, simulate
from rb_dynamics.errors import LogError
from rb_dynamics.formats.mcap_records import MAGIC, McapFile, Message, MessageBlock
from rb_dynamics.formats.recovery import recover
from rb_dynamics.formats.topic_messages import KEPT
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.sinks.mcap_sink import LogSettings, McapSink

MANY = settings(max_examples=120, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
SCENE = parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 0.05\noutput_rate: 50\n")

# Where, how many bytes go, and what comes instead.
edits = st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 9), st.binary(max_size=9)), min_size=1, max_size=4)


def edited(data: bytes, changes: list[tuple[float, int, bytes]]) -> bytes:
    for part, gone, come in changes:
        place = int(part * len(data))
        data = data[:place] + come + data[place + gone :]
    return data


@functools.cache
def own_log(folder: Path) -> bytes:
    path = folder / "own.mcap"
    simulate(SCENE, sinks=[McapSink(path, settings=LogSettings(flush_s=0.0))])
    return path.read_bytes()


def all_of(path: Path, read: Callable[[McapFile], Iterator[Message | MessageBlock]]) -> object:
    """Return the content of a file, read by `read`, or the reason why it cannot be read."""
    file, found = McapFile(path, salvage=True), defaultdict[str, list[tuple[int, bytes]]](list)
    try:
        for each in read(file):
            if isinstance(each, Message):
                found[repr(each.channel)].append((each.log_time, each.data))
            else:
                contents = [row.tobytes() for rows in each.rows() for row in rows]
                found[repr(each.channel)] += zip(each.log_times.tolist(), contents, strict=True)
    except LogError as error:
        return str(error)
    return found, file.damage, file.missing, file.complete, file.span_ns, file.metadata


def look(path: Path) -> None:
    """Read a file completely with each reader."""
    assert all_of(path, McapFile.blocks) == all_of(path, McapFile.messages)
    with contextlib.suppress(LogError):
        for topic in read_bag(path).topics.values():
            topic.decoded()
            if topic.type_name in KEPT:
                assert len(topic.numbers) == len(topic.stamps) == topic.count


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@MANY
@given(changes=edits)
@example(changes=[(0.75, 0, b"\x00"), (0.125, 6, b"\x00" * 6)])
def test_a_log_with_bytes_replaced_added_or_removed(folder: Path, changes: list[tuple[float, int, bytes]]) -> None:
    path = folder / "fuzzed.mcap"
    path.write_bytes(edited(own_log(folder), changes))
    look(path)
    try:
        recover(path, folder / "recovered.mcap")
    except LogError:
        return
    look(folder / "recovered.mcap")


@MANY
@given(records=st.lists(st.tuples(st.integers(0, 20), st.binary(max_size=60), st.integers(-3, 3)), max_size=8))
def test_any_records(folder: Path, records: list[tuple[int, bytes, int]]) -> None:
    """Records with any opcode and content, and slightly wrong lengths."""
    data = b"".join(
        bytes([opcode]) + max(0, len(content) + wrong).to_bytes(8, "little") + content
        for opcode, content, wrong in records
    )
    path = folder / "records.mcap"
    path.write_bytes(MAGIC + data)
    look(path)


texts = st.one_of(
    st.text(max_size=60),
    st.text("{}[]:,-?&*!|>'\"%@ \n\tab0./", max_size=60).map(lambda text: f"rosbag2_bagfile_information: {text}"),
    st.recursive(
        st.one_of(
            st.none(), st.integers(), st.sampled_from(["a.mcap", "../own.mcap", "/etc/passwd", "..", "", "zstd"])
        ),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from(["relative_file_paths", "compression_mode", "version", "files"]), inner)
        ),
        max_leaves=8,
    ).map(lambda value: f"rosbag2_bagfile_information: {value!r}".replace("None", "null")),
)


@MANY
@given(text=texts)
@example("[" * 5000)
@example("rosbag2_bagfile_information: {relative_file_paths: [../own.mcap, /etc/passwd.mcap]}")
def test_any_metadata_of_a_folder(folder: Path, text: str) -> None:
    own_log(folder)
    bag = folder / "bag"
    bag.mkdir(exist_ok=True)
    (bag / "metadata.yaml").write_bytes(text.encode("utf-8", "surrogatepass"))
    look(bag)


def test_metadata_that_swells_is_not_expanded(folder: Path) -> None:
    bag = folder / "swollen"
    bag.mkdir()
    layers = "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 12))
    text = (
        f"a0: &a0 x\n{layers}rosbag2_bagfile_information: {{compression_mode: *a11, relative_file_paths: [a.mcap]}}\n"
    )
    (bag / "metadata.yaml").write_text(text)
    with pytest.raises(LogError):
        read_bag(bag)


def test_the_files_of_a_bag_are_looked_for_in_its_folder(folder: Path) -> None:
    own_log(folder)
    bag = folder / "escape"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {relative_file_paths: [../own.mcap]}\n")
    with pytest.raises(LogError, match=r"escape/own\.mcap"):
        read_bag(bag)


@settings(MANY, max_examples=60)
@given(changes=edits)
@example([(0.984375, 0, b"\0\0\0")])  # sound but for its messages
def test_a_database_with_bytes_replaced_added_or_removed(folder: Path, changes: list[tuple[float, int, bytes]]) -> None:
    pytest.importorskip("rosbags")
    path = folder / "bag.db3"
    path.write_bytes(edited(database(folder), changes))
    look(path)


@functools.cache
def database(folder: Path) -> bytes:
    path = folder / "whole.db3"
    with sqlite3.connect(path) as connection:
        connection.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT,"
            " offered_qos_profiles TEXT);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);"
            "INSERT INTO topics VALUES(1, '/a', 'std_msgs/msg/Float64', 'cdr', '');"
        )
        connection.executemany("INSERT INTO messages VALUES(?, 1, ?, ?)", [(i, i, bytes(12)) for i in range(50)])
    connection.close()
    return path.read_bytes()
