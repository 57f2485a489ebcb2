"""The velocities of joints are those of the messages, whatever their order, their neighbours and their byte order."""

from __future__ import annotations

import struct

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rb_dynamics.formats import cdr
from rb_dynamics.formats.joint_states import velocities
from rb_dynamics.formats.mcap_records import McapChannel, Message, Schema, in_blocks
from rb_dynamics.formats.message_types import JOINTS

NAMES = ("wheel_x", "wheel_y", "wheel_z")
CHANNEL = McapChannel("/joints", Schema(JOINTS), "cdr", {})


def joints(stamp_ns: int, speeds: dict[str, float], positions: bool = False, told: bool = True) -> bytes:
    names = [(name,) for name in speeds]
    places = [((9.0,),) for _ in speeds] if positions else []
    rates = [((speed,),) for speed in speeds.values()] if told else []
    return cdr.encode(JOINTS, stamp_ns, "base", names, places, rates, [])


@st.composite
def recordings(draw: st.DrawFn) -> list[tuple[int, dict[str, float], bool, bool]]:
    found = []
    for _ in range(draw(st.integers(1, 12))):
        names = draw(st.permutations([*NAMES, *draw(st.sampled_from([(), ("arm",), ("a", "bc")]))]))
        names = names[: draw(st.sampled_from([len(names), len(names), 2]))]
        speed = st.floats(-1e3, 1e3)
        stamp = draw(st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1))
        found.append((stamp, {name: draw(speed) for name in names}, draw(st.booleans()), draw(st.booleans())))
    return found


@given(recordings())
def test_messages_that_tell_all_are_found_with_their_stamps_and_speeds(
    made: list[tuple[int, dict[str, float], bool, bool]],
) -> None:
    messages = [Message(CHANNEL, k, k, joints(*each)) for k, each in enumerate(made)]
    told, stamps, speeds = (
        np.concatenate(parts)
        for parts in zip(*(velocities(block, NAMES) for block in in_blocks(messages)), strict=True)
    )
    wanted = [has and set(NAMES) <= set(rates) for _, rates, _, has in made]
    assert told.tolist() == wanted
    assert stamps.tolist() == [each[0] for each, want in zip(made, wanted, strict=True) if want]
    expected = [[each[1][name] for name in NAMES] for each, want in zip(made, wanted, strict=True) if want]
    assert speeds.tolist() == expected


def test_damaged_messages_and_a_joint_that_comes_twice_tell_nothing() -> None:
    whole = joints(5, dict.fromkeys(NAMES, 1.0))
    twice = cdr.encode(JOINTS, 5, "", [("wheel_x",)] * 2, [], [((1.0,),)] * 2, [])
    for data in (whole[:-9], b"\x07" + whole[1:], b"", twice):
        (block,) = in_blocks([Message(CHANNEL, 0, 0, data)])
        told, stamps, speeds = velocities(block, NAMES if data != twice else NAMES[:1])
        assert (told.tolist(), len(stamps), speeds.size) == ([False], 0, 0)


def test_big_endian_messages_are_read() -> None:
    name = b"wheel_x\0"
    parts = [
        struct.pack(">iI", -1, 5), struct.pack(">I", 1), b"\0" + 3 * b"\0", struct.pack(">I", 1),
        struct.pack(">I", len(name)), name, struct.pack(">IId", 0, 1, 7.5),
        struct.pack(">I", 0),
    ]  # fmt: skip
    data = b"\x00\x00\x00\x00" + b"".join(parts)
    (block,) = in_blocks([Message(CHANNEL, 0, 0, data)])
    told, stamps, speeds = velocities(block, ("wheel_x",))
    assert (told.tolist(), stamps.tolist(), speeds.tolist()) == ([True], [-(10**9) + 5], [[7.5]])
