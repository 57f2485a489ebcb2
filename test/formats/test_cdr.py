"""CDR against two independent implementations: rosbags, and ROS itself if installed."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import json
import os
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scripts import load_script

from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr, message_definitions
from rb_dynamics.numerics.nanoseconds import split_stamp

ROOT = Path(__file__).parents[2]

rosbags_typesys = pytest.importorskip("rosbags.typesys")
STORE = rosbags_typesys.get_typestore(rosbags_typesys.Stores.ROS2_JAZZY)

TYPES = sorted(cdr.LAYOUTS)


def field_values(field: cdr.Field) -> st.SearchStrategy[Any]:
    if isinstance(field, list):
        return st.lists(layout_values(tuple(field)), max_size=3)
    if isinstance(field, int):
        # Far quicker than drawing each number, and as good at finding NaN, infinities and denormals among bytes.
        size = 8 * field
        return st.binary(min_size=size, max_size=size).map(lambda raw: struct.unpack(f"<{field}d", raw))
    if field == cdr.STAMP:
        return st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)
    # ROS takes a byte as unsigned, rosbags as signed.
    return st.text(max_size=9) if field == cdr.STRING else st.integers(0, 127)


def layout_values(layout: tuple[cdr.Field, ...]) -> st.SearchStrategy[tuple[Any, ...]]:
    return st.tuples(*map(field_values, layout))


def leaves(values: tuple[Any, ...], layout: list[cdr.Field]) -> Iterator[Any]:
    """Flatten our values: stamps as two integers, sequences behind their length."""
    for field, value in zip(layout, values, strict=True):
        if isinstance(field, list):
            yield len(value)
            for element in value:
                yield from leaves(element, field)
        elif isinstance(field, int):
            yield from value
        elif field == cdr.STAMP:
            yield from (value // 10**9, value % 10**9)
        else:
            yield value


def message(type_name: str, source: Iterator[Any]) -> Any:
    """Build a rosbags message from leaves, by the definitions rosbags has."""
    return STORE.types[type_name](*[member(kind, source) for _, kind in STORE.fielddefs[type_name][1]])


def member(kind: Any, source: Iterator[Any]) -> Any:
    node, detail = kind
    if node.name == "NAME":
        return message(detail, source)
    if node.name == "BASE":
        return next(source)
    inner, count = detail
    if node.name == "SEQUENCE":
        found = [member(inner, source) for _ in range(next(source))]
        return np.array(found, dtype=np.float64) if inner[1] == ("float64", 0) else found
    return np.array([next(source) for _ in range(count)])


def as_rosbags(type_name: str, values: tuple[Any, ...]) -> Any:
    return message(type_name, leaves(values, list(cdr.LAYOUTS[type_name])))


@pytest.mark.parametrize("type_name", TYPES)
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_same_bytes_as_rosbags(type_name: str, data: st.DataObject) -> None:
    values = data.draw(layout_values(cdr.LAYOUTS[type_name]))
    ours = cdr.encode(type_name, *values)
    theirs = bytes(STORE.serialize_cdr(as_rosbags(type_name, values), type_name))
    # rosbags fills up to a multiple of four at the end, which the format leaves open.
    assert theirs[: len(ours)] == ours
    assert not any(theirs[len(ours) :])
    assert len(theirs) - len(ours) < 4
    assert repr(cdr.decode(type_name, ours)) == repr(values)


@pytest.mark.parametrize("type_name", TYPES)
@settings(max_examples=40, deadline=None)
@given(data=st.data(), little=st.booleans())
def test_reads_what_rosbags_writes_in_either_endianness(type_name: str, data: st.DataObject, little: bool) -> None:
    values = data.draw(layout_values(cdr.LAYOUTS[type_name]))
    theirs = bytes(STORE.serialize_cdr(as_rosbags(type_name, values), type_name, little_endian=little))
    assert repr(cdr.decode(type_name, theirs)) == repr(values)


@pytest.mark.parametrize("type_name", TYPES)
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_rosbags_reads_what_we_write(type_name: str, data: st.DataObject) -> None:
    values = data.draw(layout_values(cdr.LAYOUTS[type_name]))
    back = STORE.deserialize_cdr(cdr.encode(type_name, *values), type_name)
    assert repr(back) == repr(as_rosbags(type_name, values))


@given(frame=st.text(max_size=20), child=st.text(max_size=20), stamp=st.integers(0, 2**31 * 10**9 - 1))
def test_packers_give_the_bytes_of_encode(frame: str, child: str, stamp: int) -> None:
    split = split_stamp(stamp)
    numbers = tuple(i + 0.5 for i in range(10))
    for kind in ("Pose", "Twist", "Accel", "Wrench", "Vector3", "Inertia"):
        name = f"geometry_msgs/msg/{kind}Stamped"
        some = numbers[: cdr.LAYOUTS[name][2]]
        assert cdr.stamped_packer(name, frame)(*split, *some) == cdr.encode(name, stamp, frame, some)
    pose, twist, none = numbers[:7], numbers[:6], (0.0,) * 36
    expected = cdr.encode("nav_msgs/msg/Odometry", stamp, frame, child, pose, none, twist, none)
    assert cdr.odometry_packer(frame, child)(*split, pose, twist) == expected
    assert cdr.float64_packer()(0.1) == cdr.encode("std_msgs/msg/Float64", (0.1,))


@pytest.mark.parametrize("type_name", TYPES)
@pytest.mark.parametrize("text", ["", "body", "xyz"])
def test_every_cut_is_an_error(type_name: str, text: str) -> None:
    def example(field: cdr.Field) -> Any:
        if isinstance(field, list):
            return [tuple(map(example, field))] * 2
        if isinstance(field, int):
            return (1.5,) * field
        return {cdr.STAMP: 3_000_000_007, cdr.STRING: text, cdr.BYTE: 2}[field]

    values = tuple(map(example, cdr.LAYOUTS[type_name]))
    whole = cdr.encode(type_name, *values)
    assert cdr.decode(type_name, whole) == values
    for length in range(len(whole)):
        with pytest.raises(LogError, match=type_name):
            cdr.decode(type_name, whole[:length])


@given(st.binary(max_size=200), st.sampled_from(TYPES))
def test_any_bytes_are_values_or_a_log_error(data: bytes, type_name: str) -> None:
    with contextlib.suppress(LogError):
        cdr.decode(type_name, b"\0\1\0\0" + data)


@pytest.mark.parametrize("head", [b"", b"\0\1", b"\0\3\0\0", b"\0\7\0\0", b"\1\0\0\0"])
def test_other_encapsulations_are_refused(head: bytes) -> None:
    with pytest.raises(LogError, match="encapsulation"):
        cdr.decode("std_msgs/msg/Float64", head + bytes(8) * (len(head) == 4))


def test_an_empty_string_without_its_nul_is_read() -> None:
    data = b"\0\1\0\0" + struct.pack("<iII", 1, 2, 0) + bytes(4) + struct.pack("<6d", *range(6))
    assert cdr.decode("geometry_msgs/msg/WrenchStamped", data) == (1_000_000_002, "", (0, 1, 2, 3, 4, 5))


def test_text_that_is_not_utf8_is_an_error() -> None:
    data = cdr.encode("geometry_msgs/msg/Vector3Stamped", 0, "body", (1, 2, 3)).replace(b"body", b"\xff\xfe\xfd\xfc")
    with pytest.raises(LogError, match="UTF-8"):
        cdr.decode("geometry_msgs/msg/Vector3Stamped", data)


@pytest.mark.parametrize(("time_ns", "split"), [(0, (0, 0)), (-1, (-1, 999_999_999)), (1_500_000_000, (1, 5 * 10**8))])
def test_split_stamp(time_ns: int, split: tuple[int, int]) -> None:
    assert split_stamp(time_ns) == split


@pytest.mark.parametrize("time_ns", [2**31 * 10**9, -(2**31) * 10**9 - 1])
def test_a_stamp_beyond_32_bits_of_seconds_is_refused(time_ns: int) -> None:
    with pytest.raises(LogError, match=str(time_ns)):
        split_stamp(time_ns)


@pytest.mark.ros
@pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # ROS's parser imports them
@pytest.mark.parametrize("type_name", TYPES)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_ros_reads_what_we_write_and_the_other_way_round(type_name: str, data: st.DataObject) -> None:
    serialization = pytest.importorskip("rclpy.serialization", exc_type=ImportError)
    package, _, name = type_name.split("/")
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    kind = getattr(importlib.import_module(f"{package}.msg"), name)
    layout = cdr.LAYOUTS[type_name]
    # A C string ends at its first NUL.
    values = data.draw(layout_values(layout).filter(lambda drawn: "\\x00" not in repr(drawn)))
    ours = cdr.encode(type_name, *values)
    theirs = serialization.serialize_message(serialization.deserialize_message(ours, kind))
    assert repr(cdr.decode(type_name, theirs)) == repr(values)


@pytest.mark.parametrize("type_name", TYPES)
def test_schema_is_that_of_rosbags(type_name: str) -> None:
    assert message_definitions.schema_text(type_name) == STORE.generate_msgdef(type_name, ros_version=2)[0]
    assert message_definitions.TYPE_HASHES[type_name] == STORE.hash_rihs01(type_name)


def test_definitions_are_up_to_date() -> None:
    tool = load_script(ROOT / "tools" / "make_message_definitions.py")
    assert tool.TARGET.read_text(encoding="utf-8") == tool.generate(), "run python tools/make_message_definitions.py"


@pytest.mark.parametrize("type_name", TYPES)
def test_type_hash_is_that_of_the_installed_ros(type_name: str) -> None:
    package, _, name = type_name.split("/")
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    places = [Path(prefix, "share", package, "msg", f"{name}.json") for prefix in prefixes if prefix]
    description = next((place for place in places if place.is_file()), None)
    if description is None:
        pytest.skip(f"{package} is not installed")
    hashes = {entry["type_name"]: entry["hash_string"] for entry in json.loads(description.read_text())["type_hashes"]}
    assert message_definitions.TYPE_HASHES[type_name] == hashes[type_name]
