"""Commands as arrays change the held wrench at the same times and in the same way as single commands."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import WrenchError
from rb_dynamics.loads.wrench import FixedFrame, Wrench, WrenchFrames, held_of
from rb_dynamics.loads.wrench_channels import AppliedWrench, Channel, WrenchChannels
from rb_dynamics.loads.wrench_command_arrays import CommandBatch, Wrenches, listed

BODY = RigidBody.from_matrix(2.0, np.diag([1.0, 2.0, 2.5]), center_of_mass=(0.1, -0.2, 0.3))
FRAMES = WrenchFrames(fixed={"nozzle": FixedFrame((0.5, 0.1, -0.3), (0.5, -0.5, 0.5, 0.5))}).of(BODY)
CHANNELS = (Channel("a", timeout=7e-9), Channel("b", max_force=5.0, on_excess="clip"), Channel("c", max_torque=3.0))

_numbers = st.sampled_from([0.0, -0.0, 0.1, -1.5, 3.0, 4.9999, 5.0, 1e7, 1e300, float("inf"), float("nan")])
_commands = st.lists(
    st.tuples(
        st.integers(0, 60),
        st.integers(0, 2),
        st.tuples(*[_numbers] * 6),
        st.sampled_from(["", "body", "world", "nozzle", "nowhere"]),
    ),
    max_size=25,
)


def _batch(commands: Sequence[tuple[int, int, tuple[float, ...], str]]) -> CommandBatch:
    wrenches = [Wrench(n[:3], n[3:], frame, time) for time, _, n, frame in commands]  # type: ignore[arg-type]
    return listed([channel for _, channel, *_ in commands], wrenches)


def _changes(channels: WrenchChannels, until_ns: int) -> list[tuple[int, object]]:
    """Return what is held from each change on, found one by one."""
    found: list[tuple[int, object]] = []
    while (time := channels.next_change_ns()) is not None and time <= until_ns:
        if any(isinstance(change, AppliedWrench) for change in channels.apply(time)):
            found.append((time, channels.total()))
    return found


@given(_commands, st.integers(0, 70), st.integers(0, 70))
@settings(max_examples=150)
def test_arrays_and_single_commands_change_what_is_held_alike(
    commands: list[tuple[int, int, tuple[float, ...], str]], middle: int, end: int
) -> None:
    singly, together, skipping = (WrenchChannels(CHANNELS, FRAMES, body=BODY) for _ in range(3))
    for time, channel, numbers, frame in sorted(commands, key=lambda command: command[0]):
        singly.take(singly.check("abc"[channel], Wrench(numbers[:3], numbers[3:], frame, time)), time)  # type: ignore[arg-type]
    for channels in (together, skipping):
        if not commands:
            continue
        batch = CommandBatch.of([_batch(commands)])
        table, others = channels.regular(batch)
        for row in others.tolist():
            topic = "abc"[int(batch.channel[row])]
            channels.take(channels.check(topic, batch.received(row)), int(batch.time_ns[row]))
        channels.extend(table)
        assert np.isfinite(table.held).all()
    expected = _changes(singly, end)
    assert repr(_changes(together, end)) == repr(expected)

    timeline, known_ns = skipping.timeline(middle, 1000)
    told = list(zip(timeline.time_ns.tolist(), map(held_of, timeline.held.tolist()), strict=True))
    assert repr(told) == repr([(time, held) for time, held in expected if time <= min(known_ns, end)]) or end < known_ns
    skipping.skip(min(known_ns, middle))
    rest = [(time, held) for time, held in expected if time > min(known_ns, middle)]
    assert repr(_changes(skipping, end)) == repr(rest)


def test_rows_far_from_any_limit_are_regular_and_others_are_not() -> None:
    channels = WrenchChannels(CHANNELS, FRAMES, body=BODY)
    commands = [(k, k % 3, (0.1,) * 6, "world") for k in range(30)]
    table, others = channels.regular(CommandBatch.of([_batch(commands)]))
    assert len(table.time_ns) == 30
    assert not others.size
    commands[4] = (4, 1, (9.0,) + (0.0,) * 5, "world")  # too large for its channel
    commands[7] = (4, 1, (0.2,) * 6, "world")  # at its time
    table, others = channels.regular(CommandBatch.of([_batch(commands)]))
    assert sorted(others.tolist()) == [4, 5]


def test_blocks_that_are_behind_are_let_go() -> None:
    table = WrenchChannels(CHANNELS, FRAMES).regular(CommandBatch.of([_batch([(1, 0, (0.0,) * 6, "")])]))[0]
    later = WrenchChannels(CHANNELS, FRAMES).regular(CommandBatch.of([_batch([(2, 0, (1.0,) * 6, "")])]))[0]
    assert len(table.followed_by(later, 0).received.blocks) == 2
    assert len(table.followed_by(later, 1).received.blocks) == 1


def test_a_particle_takes_no_torque_from_arrays_either() -> None:
    particle = RigidBody.particle(1.0)
    channels = WrenchChannels(CHANNELS, WrenchFrames().of(particle), body=particle)
    commands = [(1, 0, (1.0, 0.0, 0.0, 0.1, 0.0, 0.0), ""), (2, 0, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0), "")]
    assert channels.regular(CommandBatch.of([_batch(commands)]))[1].tolist() == [0]
    with pytest.raises(WrenchError):
        channels.check("a", Wrench((1.0, 0.0, 0.0), (0.1, 0.0, 0.0))).require()


@pytest.mark.parametrize(
    ("arguments", "found", "error"),
    [
        ({"stamp_ns": [0.0, 1.0]}, "stamp_ns has shape (2,) and type float64", TypeError),
        ({"stamp_ns": 7}, "stamp_ns has shape ()", TypeError),
        (
            {"force": np.zeros((3, 3)), "stamp_ns": [0, 1]},
            "force has shape (3, 3), expected (2, 3)",
            ValueError,
        ),
        ({"torque": [[1.0, 2.0]]}, "torque has the shape (1, 2)", ValueError),
        ({"force": "strong"}, "force is 'strong'", TypeError),
        ({"frame_id": 3}, "frame_id is 3", TypeError),
    ],
)
def test_arrays_of_wrenches_that_do_not_fit_are_refused(
    arguments: dict[str, Any], found: str, error: type[Exception]
) -> None:
    with pytest.raises(error, match=re.escape(f"wrenches {found}")):
        Wrenches(**arguments)


def test_arrays_of_wrenches_keep_copies() -> None:
    forces, times = np.ones((2, 3)), np.arange(2)
    wrenches = Wrenches(forces, frame_id="/body", stamp_ns=times)
    forces[:], times[:] = 5.0, 5

    assert list(wrenches) == [Wrench((1.0, 1.0, 1.0), (0.0, 0.0, 0.0), "body", k) for k in range(2)]
    assert wrenches.frame_id == "body"
