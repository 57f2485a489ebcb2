"""Definitions of a type: which differ in fields, and that a type of other fields is not read as the known one."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import pytest

from rb_dynamics.conversion.convert import to_table
from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.mcap_records import Schema
from rb_dynamics.formats.merging import merge
from rb_dynamics.formats.message_definitions import TYPE_HASHES, schema_text
from rb_dynamics.formats.message_fields import differ, is_other
from rb_dynamics.formats.message_types import POSE
from rb_dynamics.logs.bag_reader import read_bag

pytest.importorskip("mcap")

from mcap.writer import Writer

STATE = "my_msgs/msg/State"


def schema(text: str, name: str = STATE) -> Schema:
    return Schema(name, "ros2msg", text.encode())


def write(path: Path, *messages: tuple[str, str, str, bytes]) -> Path:
    """Write one message each of topic, type, definition and content."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "test")
        for number, (topic, name, text, data) in enumerate(messages):
            channel = writer.register_channel(topic, "cdr", writer.register_schema(name, "ros2msg", text.encode()))
            writer.add_message(channel, number, data, number)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        ("float64 a\nfloat64 b\n", "float64 b\nfloat64 a\n", True),
        ("float64 a\n", "float32 a\n", True),
        ("float64[3] a\n", "float64[4] a\n", True),
        ("my_msgs/Part a\n===\nMSG: my_msgs/Part\nint32 x\n", "Part a\n====\nMSG: my_msgs/Part\nint64 x\n", True),
        (
            "my_msgs/msg/Part a\n===\nMSG: my_msgs/msg/Part\nint32 x\n",
            "Part a\n====\nMSG: my_msgs/Part\nint32 x",
            False,
        ),
        ("# speed\nint8 UP=1\nfloat64 a 0.5 # m/s\n\n", "float64   a\n", False),
        ("string<=10 a\nbyte[<=3] b", "string a\nuint8[] b", False),
        # What cannot be read is not judged: an inner type that is not there, or another language.
        ("other_msgs/Part a\n", "float64 a\n", False),
        ("float64\n", "float64 a\n", False),
        ("", "float64 a\n", False),
    ],
)
def test_definitions_differ_in_fields_alone(one: str, other: str, expected: bool) -> None:
    assert differ(schema(one), schema(other)) == differ(schema(other), schema(one)) == expected


def test_the_types_known_here_are_those_of_every_distribution() -> None:
    rosbags = pytest.importorskip("rosbags.typesys")
    for store in (each for each in rosbags.Stores if each.name.startswith("ROS2")):
        types = rosbags.get_typestore(store)
        for name in TYPE_HASHES:
            assert not is_other(schema(types.generate_msgdef(name, ros_version=2)[0], name)), (store, name)


def test_a_known_name_with_other_fields_is_another_type(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    known = schema_text(POSE)
    other = known.replace("geometry_msgs/Pose pose\n", "float64 quality\ngeometry_msgs/Pose pose\n", 1)
    data = cdr.encode(POSE, 1, "world", (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0))
    more = data[:-56] + struct.pack("<d", 99.0) + data[-56:]
    path = write(tmp_path / "a.mcap", ("/pose", POSE, known, data), ("/other", POSE, other, more))
    assert read_bag(path).topics["/other"].type_name == f"other fields:{POSE}"
    assert read_bag(path).poses("/pose")[1].tolist() == [[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]]
    (written,) = to_table([path], tmp_path / "a.csv")
    assert written.rows == 1
    assert f"left out, as types without known quantities: /other (other fields:{POSE}" in caplog.text


def test_messages_of_other_fields_are_not_merged_under_one_definition(tmp_path: Path) -> None:
    one = write(tmp_path / "one.mcap", ("/state", STATE, "float64 speed\nfloat64 voltage\n", bytes(20)))
    text = "float64 speed # m/s\nfloat64 voltage # V\n"
    same = write(tmp_path / "same.mcap", ("/state", STATE, text, bytes(19) + b"\1"))
    other = write(tmp_path / "other.mcap", ("/state", STATE, "float64 voltage\nfloat64 speed\n", bytes(20)))
    assert merge([one, same], tmp_path / "all.mcap", (-math.inf, math.inf)).messages == 2
    with pytest.raises(LogError, match="topic /state is my_msgs/msg/State of other fields in one bag than in another"):
        merge([one, other], tmp_path / "all.mcap", (-math.inf, math.inf))
