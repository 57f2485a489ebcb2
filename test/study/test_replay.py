"""A log is rerun from its content to the last bit, and changes to it are found."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import random
import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from edited_logs import edited

from rb_dynamics import RigidBody, Wrench, parse_scene, simulate
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import summarize
from rb_dynamics.body.state import State
from rb_dynamics.cli import main
from rb_dynamics.conversion.convert import to_table
from rb_dynamics.errors import ConvergenceError, LogError, WrenchError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import Source, open_source
from rb_dynamics.formats.mcap_records import McapFile, Message, OnFact
from rb_dynamics.formats.message_types import WRENCH
from rb_dynamics.formats.recovery import recover
from rb_dynamics.loads.wrench_channels import AppliedWrench
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.messages import decode_wrench
from rb_dynamics.logs.own_log import logged_scene, scene_and_names
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.run.sink import Event, RunInfo, Status
from rb_dynamics.run.state_change import StateChange
from rb_dynamics.sinks.mcap_sink import LogSettings, McapSink
from rb_dynamics.sinks.rosbag2_sink import BagSink
from rb_dynamics.study.replay import Replay, replay

SCENE = parse_scene(
    "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}, center_of_mass: [0.1, 0, 0.2]}\n"
    "initial: {angular_velocity_body: [0.1, 2, 0.1], linear_velocity_world: [1, 2, 3]}\n"
    "wrenches: [{topic: push, timeout: 0.35}, {topic: /robot/turn}]\n"
    "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}, {type: linear_drag, translation: 0.1}]\n"
    "solver: {method: rkmk4, step: 0.01}\nduration: 2\noutput_rate: 30\n"
)
COMMANDS = [
    ("push", Wrench((1.0, 2.0, 3.0), (0.1, 0.0, -0.1), "world", 0)),
    ("push", Wrench((float("nan"), 0.0, 0.0), (0.0, 0.0, 0.0), "body", 100_000_000)),
    ("robot/turn", Wrench((0.0, 0.0, 0.0), (0.3, 0.2, 0.1), "", 333_333_333)),
    ("push", Wrench((-0.0, 1.0, 0.0), (0.0, 0.0, 0.0), "body", 333_333_333)),
    ("push", Wrench((0.0, 1.0, 0.0), (0.0, 0.0, 0.0), "nowhere", 400_000_000)),
    ("push", Wrench((0.0, 2.0, 0.0), (0.0, 0.0, 0.0), "body", 1_999_999_999)),
]


def hashes(found: Replay) -> set[str]:
    """Return the names of the hashes that were compared, without the package's."""
    return {name.removeprefix("rb_dynamics.") for name in found.facts if name.endswith("sha256")}


@pytest.fixture
def log(tmp_path: Path) -> Path:
    simulate(SCENE, COMMANDS, [McapSink(tmp_path / "run.mcap")])
    return tmp_path / "run.mcap"


def test_the_same_bits(log: Path) -> None:
    found = replay(log)
    assert found.identical
    assert (found.samples, found.commands, found.complete, found.software) == (61, 6, True, {})
    # How many checkpoints there are, wall time says.
    ends = {"scene_sha256", "result.states_sha256", "result.inputs_sha256"}
    assert hashes(found) - {"checkpoint.states_sha256"} == ends
    assert found.uncompared == {
        ("/push", "rejected commands, whose numbers have no effect"): 2,
        ("/diagnostics", "warnings and the state of a node"): 1,
    }
    assert all(logged == here for logged, here in found.facts.values())
    assert "rb_dynamics.result.steps" in found.facts


@pytest.mark.parametrize("delay", ["0.0", "0.013"])
def test_what_was_too_large_or_clipped_is_so_again(tmp_path: Path, delay: str) -> None:
    text = SCENE.text.replace("timeout: 0.35", "max_force: 2.5, on_excess: clip")
    text = text.replace("/robot/turn", f"/robot/turn, delay: {delay}")
    huge = [
        ("robot/turn", Wrench((1e308, 0.0, 0.0), stamp_ns=400_000_000)),
        # Possible as a wrench, but not with steps of 10 ms.
        ("robot/turn", Wrench(torque=(0.0, 1e8, 2e8), stamp_ns=500_000_000)),
    ]
    run = simulate(parse_scene(text), COMMANDS + huge, [McapSink(tmp_path / "run.mcap")])
    assert (len(run.rejected), run.clipped) == (4, 1)

    found = replay(tmp_path / "run.mcap")
    assert found.identical
    assert found.commands == 8
    log = read_bag(tmp_path / "run.mcap")
    [(_, received), *_], [(_, applied), *_] = log.wrenches("/push"), log.wrenches("/push/applied")
    assert received.force == (1.0, 2.0, 3.0)
    assert applied.force == pytest.approx([2.5 / 14.0**0.5 * v for v in received.force], rel=1e-15)
    shown = {channel.topic: channel for channel in summarize(read_track(log)).channels}
    assert {topic: (c.received, c.rejected, c.timeouts) for topic, c in shown.items() if c.received} == {
        "/push": (5, 2, 0),
        "/robot/turn": (3, 2, 0),
    }


@pytest.mark.parametrize(("torque", "goes_on"), [(200.0, False), (300.0, True)])
def test_a_log_of_a_motion_that_could_not_be_continued(tmp_path: Path, torque: float, goes_on: bool) -> None:
    """Not in the step after the last output, nor, if another command came there and helped, in that without it."""
    path = tmp_path / "run.mcap"
    scene = parse_scene("""
body: {mass: 10, inertia: {diagonal: [0.05, 0.12, 0.14]}}
wrenches: []
solver: {method: dop853, step: 0.01}
actuators: [{type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 1.0e-4, friction: {coulomb: 1.0e-5}}]
""")
    run = Simulation(scene, [McapSink(path)])
    run.start()
    run.actuate("wheel/command", torque, 20_000_000)
    with pytest.raises(ConvergenceError, match="the body turns too far in one step"):
        run.advance(3 * 10**9)
    failed_ns = run.time_ns
    run.actuate("wheel/command", 0.0, run.computed_ns)
    with contextlib.nullcontext() if goes_on else pytest.raises(ConvergenceError):
        run.advance(failed_ns + 10**8)
    assert (run.time_ns == failed_ns + 10**8) == goes_on
    run.finish()
    assert replay(path).identical


def test_a_command_is_logged_as_the_bytes_that_came_and_replayed(tmp_path: Path) -> None:
    texts = {
        "big endian": struct.pack(">4siI I6s6x 6d", b"\0\0\0\0", 0, 250_000_000, 6, b"world\0", *range(6)),
        "nanoseconds beyond a second, bytes left of what was there before, a padded end": struct.pack(
            "<4siI I5s7s 6d 4s", b"\0\1\0\0", 0, 1_250_000_000, 5, b"body\0", b"garbage", *range(6), b"rest"
        ),
        "a string without its end": struct.pack("<4siI I4x 6d", b"\0\1\0\3", 1, 500_000_000, 0, *range(6)),
        "no command": struct.pack("<4siI I8s4x 6d", b"\0\1\0\0", 1, 750_000_000, 8, b"nowhere\0", *range(6)),
    }
    came = [decode_wrench(WRENCH, 0, data) for data in texts.values()]
    assert [wrench.stamp_ns for wrench in came] == [250_000_000, 1_250_000_000, 1_500_000_000, 1_750_000_000]
    simulate(SCENE, [("push", wrench) for wrench in came], [McapSink(tmp_path / "run.mcap")])
    messages = [each for each in McapFile(tmp_path / "run.mcap").messages() if each.channel.topic == "/push"]
    assert [each.data for each in messages] == list(texts.values())
    found = replay(tmp_path / "run.mcap")
    assert (found.identical, found.commands) == (True, 4)
    # The same numbers are the same command, and a changed copy has no bytes of its own.
    plain = [dataclasses.replace(wrench) for wrench in came]
    assert plain == came
    simulate(SCENE, [("push", wrench) for wrench in plain], [McapSink(tmp_path / "plain.mcap")])
    assert replay(tmp_path / "plain.mcap").identical
    assert [wrench for _, wrench in read_bag(tmp_path / "plain.mcap").wrenches("/push")] == plain


def test_names_in_a_namespace_and_remapped(tmp_path: Path) -> None:
    sink = McapSink(tmp_path / "run.mcap", namespace="/sat", remap={"pose": "/truth", "push": "/cmd/push"})
    simulate(SCENE, COMMANDS, [sink])
    found = replay(tmp_path / "run.mcap")
    assert found.identical
    assert found.commands == 6


def test_every_step_and_frames_of_other_names(tmp_path: Path) -> None:
    scene = parse_scene(
        "world_frame: inertial\nbody: {frame: sat, mass: 2, inertia: {diagonal: [1, 2, 3]}}\n"
        "wrenches: [{topic: wrench}]\nsolver: {method: dop853, accuracy: 1.0e-8}\nduration: 2\noutput_rate: 0\n"
    )
    command = Wrench((1.0, 0.0, 0.0), (0.0, 0.5, 0.0), "inertial", 123_456_789)
    simulate(scene, [("wrench", command)], [McapSink(tmp_path / "run.mcap")])
    assert replay(tmp_path / "run.mcap").identical


def test_a_split_bag_and_a_recovered_beginning(tmp_path: Path, log: Path) -> None:
    simulate(SCENE, COMMANDS, [BagSink(tmp_path / "bag", max_duration_s=0.7)])
    assert replay(tmp_path / "bag").identical
    data = log.read_bytes()
    log.write_bytes(data[: data.index(b"rb_dynamics.result")])
    recover(log, tmp_path / "saved.mcap")
    for path in (log, tmp_path / "saved.mcap"):
        found = replay(path)
        assert found.identical
        assert not found.complete
        assert hashes(found) == {"scene_sha256"}, "cut off before its first checkpoint"


def test_a_recovered_log_of_which_only_the_summary_was_damaged_is_proven(
    tmp_path: Path, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No hash was said to prove it, although that of the result did."""
    data = bytearray(log.read_bytes())
    data[-60] ^= 0xFF
    log.write_bytes(data)
    recover(log, tmp_path / "saved.mcap")
    found = replay(tmp_path / "saved.mcap")
    assert (found.identical, found.complete, found.proven_ns) == (True, False, 2_000_000_000)
    assert main(["replay", str(tmp_path / "saved.mcap")]) == 0
    assert capsys.readouterr().out.endswith("and the hash at its end proves it\n")


def test_whole_files_are_proven_though_the_last_one_has_no_sample_left(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    simulate(SCENE, COMMANDS, [BagSink(folder, max_duration_s=0.7)])
    last = max(folder.glob("*.mcap"))
    start = McapFile(last)
    begun_ns = next(start.messages()).log_time
    # A kill right after the file was begun: its first chunk is there, no sample is.
    data = last.read_bytes()
    last.write_bytes(data[: data.index(b"rb_dynamics.result") // 2])
    found = replay(folder)
    assert found.identical
    assert not found.complete
    assert found.proven_ns is not None
    assert found.proven_ns == read_bag(folder).poses("/pose")[0][-1]
    assert found.proven_ns < begun_ns


def test_behind_a_piece_that_is_missing_nothing_is_said(tmp_path: Path, log: Path) -> None:
    def edit(message: Message) -> Message | None:
        return None if 900_000_000 < message.log_time < 1_100_000_000 else message

    damaged = edited(log, tmp_path / "damaged.mcap", edit)
    damaged.write_bytes(damaged.read_bytes()[:-8])
    recover(damaged, tmp_path / "saved.mcap")
    found = replay(tmp_path / "saved.mcap")
    assert found.gap_ns == 933_333_333
    assert not found.identical
    assert found.differences == {}
    assert "rb_dynamics.result.states_sha256" not in found.facts


def test_the_states_of_a_log_that_was_cut_off_are_proven_up_to_its_last_checkpoint(tmp_path: Path) -> None:
    scene = dataclasses.replace(
        SCENE, text=SCENE.text.replace("output_rate: 30", "output_rate: 1000"), output_rate=1000.0
    )
    whole, path = tmp_path / "whole.mcap", tmp_path / "run.mcap"
    simulate(scene, COMMANDS, [McapSink(whole, settings=LogSettings(flush_s=0.0))])
    assert replay(whole).proven_ns == 2_000_000_000
    path.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    recover(path, tmp_path / "saved.mcap")
    for each in (path, tmp_path / "saved.mcap"):
        found = replay(each)
        last_ns = read_bag(each).poses("/pose")[0][-1]
        assert found.identical
        assert found.proven_ns is not None
        assert last_ns - 100_000_000 < found.proven_ns <= last_ns
        assert hashes(found) == {"checkpoint.states_sha256", "scene_sha256"}

    checkpoint = read_bag(path).metadata["rb_dynamics.checkpoint"]["states_sha256"].encode()
    path.write_bytes(path.read_bytes().replace(checkpoint, b"0" * 64))
    cut = replay(path).proven_ns
    assert cut is not None
    assert cut < found.proven_ns
    assert replay(path).differing == ["rb_dynamics.checkpoint.states_sha256"]


def test_a_log_that_is_still_being_written_is_compared_up_to_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = parse_scene(SCENE.text.replace("duration: 2", "duration: 40"))
    simulate(scene, COMMANDS, [McapSink(tmp_path / "whole.mcap", settings=LogSettings(flush_s=0.0))])
    data, growing = (tmp_path / "whole.mcap").read_bytes(), tmp_path / "growing.mcap"
    lengths = iter((len(data) // 2, 3 * len(data) // 4))

    def grown(path: Path, on_fact: OnFact | None = None) -> Source:
        growing.write_bytes(data[: next(lengths)])
        return open_source(path, on_fact)

    monkeypatch.setattr("rb_dynamics.study.replay.open_source", grown)
    found = replay(growing)
    assert found.identical
    assert not found.complete
    assert 0 < found.samples < 1200


def test_one_changed_bit_is_found_where_it_is(tmp_path: Path, log: Path) -> None:
    def edit(message: Message) -> Message:
        if message.channel.topic == "/linear_momentum" and message.log_time == 1_000_000_000:
            (z,) = struct.unpack("<d", message.data[-8:])
            return message._replace(data=message.data[:-8] + struct.pack("<d", z * (1.0 + 2.0**-52)))
        return message

    found = replay(edited(log, tmp_path / "edited.mcap", edit))
    assert not found.identical
    assert found.first == (1_000_000_000, "/linear_momentum")
    assert list(found.differences) == ["/linear_momentum"]
    difference = found.differences["/linear_momentum"]
    assert difference.largest_ns == 1_000_000_000
    assert 0.0 < difference.relative < 1e-15


def test_a_changed_command_moves_what_comes_after(tmp_path: Path, log: Path) -> None:
    def edit(message: Message) -> Message:
        if message.channel.topic == "/robot/turn":
            return message._replace(data=message.data[:-8] + struct.pack("<d", 0.1001))
        return message

    found = replay(edited(log, tmp_path / "edited.mcap", edit))
    assert found.first == (333_333_333, "/robot/turn/applied")
    assert found.differences["/pose"].first_ns == 366_666_667
    assert {name for name in hashes(found) if f"rb_dynamics.{name}" not in found.differing} == {"scene_sha256"}


def test_not_a_number_is_no_small_difference(tmp_path: Path, log: Path) -> None:
    def edit(message: Message) -> Message:
        if message.channel.topic == "/energy/work" and message.log_time == 1_000_000_000:
            return message._replace(data=message.data[:-8] + struct.pack("<d", float("nan")))
        return message

    found = replay(edited(log, tmp_path / "edited.mcap", edit))
    assert not found.differences["/energy/work"].relative <= 1.0


@pytest.mark.parametrize("times", [{1_000_000_000}, {2_000_000_000}])
def test_what_was_taken_out_is_missed(tmp_path: Path, log: Path, times: set[int]) -> None:
    def edit(message: Message) -> Message | None:
        return None if message.channel.topic == "/twist" and message.log_time in times else message

    found = replay(edited(log, tmp_path / "edited.mcap", edit))
    assert not found.identical
    assert len(found.missing) == 1
    assert found.missing[0].startswith("/twist at 2.0")


def test_what_was_put_in_is_seen(tmp_path: Path, log: Path) -> None:
    late: list[Message] = []

    def edit(message: Message) -> Message:
        if message.channel.topic == "/twist" and not late:
            late.append(message)
        if message.log_time == 2_000_000_000 and message.channel.topic == "/energy/potential":
            return message._replace(channel=late[0].channel, data=late[0].data)
        return message

    found = replay(edited(log, tmp_path / "edited.mcap", edit))
    assert any(line.startswith("/twist at 2.0") and "1 messages that the replay" in line for line in found.missing)


def test_another_version_is_named(tmp_path: Path, log: Path) -> None:
    old = McapFile(log)
    for _ in old.messages():
        pass

    def software(path: Path) -> Path:
        data = log.read_bytes()
        there = old.metadata["rb_dynamics"]["version.numpy"].encode()
        path.write_bytes(data.replace(there, b"9" * len(there)))
        return path

    found = replay(software(tmp_path / "edited.mcap"))
    assert found.identical
    was, here = found.software["version.numpy"]
    assert set(was) == {"9"}
    assert here == old.metadata["rb_dynamics"]["version.numpy"]


def test_a_method_that_was_removed_is_named_and_its_log_read_all_the_same(tmp_path: Path, log: Path) -> None:
    text = SCENE.text.replace("rkmk4", "strang4")
    old = edited(log, tmp_path / "old.mcap", facts={"method": "strang4"}, scene=text.encode())

    with pytest.raises(
        LogError, match=r"made by strang4, a method that was removed.* with --method dmv104, or strang6"
    ):
        replay(old)
    assert logged_scene(read_bag(old).attachments) is not None
    to_table([old], tmp_path / "old.csv")
    to_table([log], tmp_path / "new.csv")
    assert (tmp_path / "old.csv").read_bytes() == (tmp_path / "new.csv").read_bytes()
    assert scene_and_names(whole(old), "read")[0].text == text


def whole(path: Path) -> Source:
    source = open_source(path)
    for _ in source.messages():
        pass
    return source


def off_by(relative: float, *topics: str) -> Callable[[Message], Message]:
    """Return an edit that puts the last number of the first array in messages of `topics` at 1 s off by so much."""

    def moved(layout: Sequence[cdr.Field], values: Sequence[Any]) -> tuple[Any, ...]:
        place = next(number for number, kind in enumerate(layout) if isinstance(kind, int | list))
        kind, found = layout[place], values[place]
        new = [moved(kind, found[0])] if isinstance(kind, list) else (*found[:-1], found[-1] * (1.0 + relative))
        return (*values[:place], new, *values[place + 1 :])

    def edit(message: Message) -> Message:
        if message.channel.topic not in topics or message.log_time != 1_000_000_000:
            return message
        name = message.channel.type_name
        values = moved(cdr.LAYOUTS[name], cdr.decode(name, message.data))
        return message._replace(data=cdr.encode(name, *values))

    return edit


FRAMES = parse_scene(
    SCENE.text.replace("body: {", "body: {frames: {jet: {position: [0.1, 0, 0]}}, ").replace(
        "duration: 2", "duration: 1"
    )
)


@pytest.fixture
def full(tmp_path: Path) -> Path:
    """Return a log with every topic there is."""
    sink = McapSink(tmp_path / "full.mcap", settings=LogSettings(accel=True))
    run = Simulation(FRAMES, [sink])
    run.start()
    for topic, wrench in COMMANDS[:1] + COMMANDS[2:4]:
        run.post(topic, wrench, wrench.stamp_ns)
    run.write(Status(0, 0, "fine", {}))
    run.advance(1_000_000_000)
    run.finish()
    return tmp_path / "full.mcap"


def test_one_bit_of_any_topic_is_seen(tmp_path: Path, full: Path) -> None:
    found = replay(full)
    assert found.identical
    assert found.uncompared == {("/diagnostics", "warnings and the state of a node"): 1}
    topics = (
        {channel.topic for channel in open_source(full).channels.values()} if list(McapFile(full).messages()) else {}
    )
    topics = set(read_bag(full).topics) - {"/diagnostics"}
    assert {"/inertia", "/tf_static", "/accel", "/push", "/push/applied", "/odom"} <= topics
    for topic in sorted(topics):
        seen: list[Message] = []

        def edit(message: Message, topic: str = topic, seen: list[Message] = seen) -> Message:
            if message.channel.topic != topic or seen:
                return message
            seen.append(message)
            # The lowest bit of the exponent of its last number.
            return message._replace(data=message.data[:-2] + bytes([message.data[-2] ^ 0x10, message.data[-1]]))

        found = replay(edited(full, tmp_path / "edited.mcap", edit))
        assert seen
        assert not found.identical, topic
        commanded = {"/push": "/push/applied", "/robot/turn": "/robot/turn/applied"}
        assert commanded.get(topic, topic) in found.differences


@pytest.mark.parametrize("topic", ["/inertia", "/tf_static", "/accel", "/push/applied"])
def test_a_topic_that_is_gone_or_of_another_time_is_missed(tmp_path: Path, full: Path, topic: str) -> None:
    def gone(message: Message) -> Message | None:
        return None if message.channel.topic == topic else message

    def late(message: Message) -> Message:
        return message._replace(publish_time=message.publish_time + 1) if message.channel.topic == topic else message

    assert [line.partition(" ")[0] for line in replay(edited(full, tmp_path / "e.mcap", gone)).missing] == [topic]
    assert list(replay(edited(full, tmp_path / "e.mcap", late)).differences) == [topic]


OTHER = {"version.numpy": "9.9"}


@pytest.mark.parametrize("topic", ["/pose", "/odom", "/tf", "/energy/work", "/linear_momentum"])
def test_with_another_numpy_a_change_within_the_bound_is_corruption_where_the_states_are_proven(
    tmp_path: Path, full: Path, topic: str
) -> None:
    found = replay(edited(full, tmp_path / "e.mcap", off_by(1e-12, topic), OTHER))
    assert set(found.software) == {"version.numpy"}
    assert found.differences[topic].relative < 1e-11
    assert found.corrupt == [topic]
    assert not found.within(1e-9)
    # What no hash is over may have other digits on another version, and on this one not.
    found = replay(edited(full, tmp_path / "e.mcap", off_by(1e-12, "/accel"), OTHER))
    assert found.corrupt == []
    assert found.within(1e-9)
    assert not found.within(0.0)
    assert not replay(edited(full, tmp_path / "e.mcap", off_by(1e-12, "/accel"))).within(1e-9)


def test_with_another_numpy_and_other_bits_a_log_must_agree_with_itself(tmp_path: Path, full: Path) -> None:
    other = OTHER | {"states_sha256": "0" * 64}
    found = replay(edited(full, tmp_path / "e.mcap", off_by(1e-12, "/pose", "/odom", "/tf"), other))
    assert found.torn == []
    assert found.within(1e-9)
    found = replay(edited(full, tmp_path / "e.mcap", off_by(1e-12, "/pose", "/tf"), other))
    assert [line.partition(" ")[0] for line in found.torn] == ["/odom"]
    assert not found.within(1e-9)
    found = replay(edited(full, tmp_path / "e.mcap", off_by(1e-12, "/energy/work"), other))
    assert found.torn == found.corrupt == []
    assert found.within(1e-9)


@pytest.mark.parametrize("place", [3, 24])
def test_bytes_that_hold_no_number_are_compared_too(tmp_path: Path, full: Path, place: int) -> None:
    """The options of CDR, and the padding behind the frame `world`."""

    def changed(message: Message) -> Message:
        if message.channel.topic != "/pose":
            return message
        data = bytearray(message.data)
        data[place] ^= 1
        return message._replace(data=bytes(data))

    found = replay(edited(full, tmp_path / "e.mcap", changed))
    assert list(found.differences) == ["/pose"]
    assert not found.identical


def test_other_code_under_the_same_version_is_told(
    tmp_path: Path, full: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whoever edits the package in place has another program of the same version."""
    other = edited(full, tmp_path / "e.mcap", facts={"code_sha256": "0" * 64})
    found = replay(other)
    assert set(found.software) == {"code_sha256"}
    assert found.other_code
    assert found.identical
    assert main(["replay", str(other)]) == 0
    assert "the version is the same but the code is not: one of the two was changed" in capsys.readouterr().out
    # What another version may say otherwise, other code may.
    assert replay(edited(full, tmp_path / "e.mcap", facts={"code_sha256": "0", "steps": "1"})).within(1e-9)
    assert not replay(edited(full, tmp_path / "e.mcap", facts={"steps": "1"})).within(1e-9)


FORGED = {"version.rb_dynamics": "0.0.1"}


@pytest.mark.parametrize("name", ["method", "solver", "seed", "effects", "effects_not_logged_as_wrench"])
def test_what_a_log_says_of_its_run_is_held_against_the_scene(tmp_path: Path, full: Path, name: str) -> None:
    found = replay(edited(full, tmp_path / "e.mcap", facts={f"rb_dynamics.{name}": "rk4"}))
    assert found.differing == [f"rb_dynamics.{name}"]
    assert not found.identical
    # What follows from the scene alone no version says otherwise.
    found = replay(edited(full, tmp_path / "e.mcap", facts=FORGED | {f"rb_dynamics.{name}": "rk4"}))
    assert found.within(1e-9) == (name in {"solver", "effects_not_logged_as_wrench"})


@pytest.mark.parametrize("name", ["method", "steps", "end_time_ns", "inputs_rule", "inputs_sha256", "states_sha256"])
def test_what_a_log_says_of_the_end_is_held_against_the_run(tmp_path: Path, full: Path, name: str) -> None:
    end = read_bag(full).metadata["rb_dynamics.result"][name]
    forged = {f"rb_dynamics.result.{name}": f"{end[:-1]}{int(end[-1], 16) ^ 1:x}"}
    found = replay(edited(full, tmp_path / "e.mcap", facts=forged))
    assert found.differing[:1] == [f"rb_dynamics.result.{name}"]
    assert not found.identical
    # Of a hash of states nobody can tell more than that it is another; of a rule that is not known, no more either.
    found = replay(edited(full, tmp_path / "e.mcap", facts=FORGED | forged))
    assert found.within(1e-9) == (name in {"states_sha256", "inputs_rule", "steps"})


def test_what_no_run_gives_is_said_to_be_unchecked(tmp_path: Path) -> None:
    simulate(SCENE, COMMANDS, [McapSink(tmp_path / "run.mcap")], facts={"wrench_bags": "a.mcap"})
    found = replay(tmp_path / "run.mcap")
    assert found.identical
    named = {name for name in found.unchecked if "version" not in name}
    assert named == {"rb_dynamics.scene_file", "rb_dynamics.python", "rb_dynamics.wrench_bags"}


@pytest.mark.parametrize("old", [b"world", b"body"])
def test_another_version_excuses_no_other_frame(tmp_path: Path, full: Path, old: bytes) -> None:
    def edit(message: Message) -> Message:
        other = message.data.replace(old, old[::-1])
        return message._replace(data=other) if message.channel.topic == "/odom" else message

    found = replay(edited(full, tmp_path / "e.mcap", edit, FORGED | {"states_sha256": "0" * 64}))
    assert found.corrupt == ["/odom"]
    assert not found.within(math.inf)


def test_another_version_excuses_an_attitude_by_its_own_size_not_by_that_of_the_position(tmp_path: Path) -> None:
    text = SCENE.text.replace("initial: {", "initial: {position_world: [7.0e6, 0, 0], ")
    simulate(parse_scene(text), COMMANDS, [McapSink(tmp_path / "run.mcap")])
    facts = FORGED | {"states_sha256": "0" * 64}
    found = replay(edited(tmp_path / "run.mcap", tmp_path / "e.mcap", off_by(1e-6, "/pose", "/odom", "/tf"), facts))
    assert found.torn == found.corrupt == []
    assert found.relative > 1e-8
    assert not found.within(1e-9)


def test_a_log_of_an_older_version_with_other_bits_is_the_same_within_rounding() -> None:
    """0.1.0 rounded the kicks of splittings otherwise."""
    found = replay(Path(__file__).parent / "version_0_1.mcap")
    assert found.software["version.rb_dynamics"][0] == "0.1.0"
    assert "rb_dynamics.result.states_sha256" in found.differing
    assert found.corrupt == found.missing == found.torn == []
    assert 0.0 < found.relative < 1e-12
    # Though the defects of its balances are rounding alone, and differ wholly.
    assert found.differences["/energy/defect"].largest > 0.0
    assert found.within(1e-12)


def test_records_of_one_name_and_checkpoints_agree(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    scene = parse_scene(SCENE.text.replace("output_rate: 30", "output_rate: 400"))
    simulate(scene, COMMANDS, [McapSink(path, settings=LogSettings(flush_s=0.0))])
    found = replay(path)
    assert found.identical
    assert found.facts["rb_dynamics.checkpoint.states_sha256"][0] != found.facts["rb_dynamics.result.states_sha256"][0]
    data = path.read_bytes()
    hashed = read_bag(path).metadata["rb_dynamics.checkpoint"]["states_sha256"].encode()
    assert data.count(hashed) == 1
    path.write_bytes(data.replace(hashed, b"0" * 64))
    assert replay(path).differing == ["rb_dynamics.checkpoint.states_sha256"]
    # A second record of a name, which another reader may take for the first.
    path.write_bytes(data)
    found = replay(edited(path, tmp_path / "e.mcap", twice={"rb_dynamics": {"machine": "another"}}))
    assert [line.partition(":")[0] for line in found.torn] == ["rb_dynamics"]
    assert not found.within(math.inf)


def test_a_channel_that_says_its_messages_are_read_otherwise_is_seen(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    scene = parse_scene(SCENE.text.replace("timeout: 0.35", "timeout: 0.35, optional: true"))
    with pytest.MonkeyPatch.context() as patch:
        # Uncompressed, so that a text of the same length can stand in the place of another.
        patch.setattr("rb_dynamics.formats.mcap_writer._compression", lambda: ("", bytes))
        patch.setattr("zlib.crc32", lambda *_: 0)
        simulate(scene, COMMANDS, [BagSink(folder, max_duration_s=0.7)])
    assert replay(folder).identical
    file = min(folder.glob("*.mcap"))
    data = file.read_bytes()
    for old, new, fact in (
        (b"float64 x\nfloat64 y", b"float64 y\nfloat64 x", ".schema"),
        (b"reliability: reliable", b"reliability: reliablf", ".QoS"),
    ):
        assert old in data
        file.write_bytes(data.replace(old, new))
        found = replay(folder)
        assert found.differing
        assert all(name.endswith(fact) for name in found.differing)


def test_whatever_is_changed_in_a_log_is_seen(tmp_path: Path, full: Path) -> None:
    """Any change of bits, times, order or number of messages is found, except in the state of the node."""
    rng = random.Random(14)

    def spoil(messages: list[Message]) -> None:
        # Inertia and a file's other facts come first; a received command may have other padding.
        place = rng.choice([n for n, m in enumerate(messages) if m.channel.topic not in {"/diagnostics", "/push"}])
        message = messages[place]
        same = [n for n, m in enumerate(messages) if m.channel is message.channel and m.data != message.data]
        match rng.choice(["bit", "bit", "log_time", "publish_time", "leave out", "twice", "exchange"]):
            case "bit":
                data = bytearray(message.data)
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
                messages[place] = message._replace(data=bytes(data))
            case "leave out":
                del messages[place]
            case "twice":
                messages.insert(place, message)
            case "exchange" if same:
                other = rng.choice(same)
                messages[place] = message._replace(data=messages[other].data)
                messages[other] = messages[other]._replace(data=message.data)
            case "publish_time":
                messages[place] = message._replace(publish_time=message.publish_time ^ 1 << rng.randrange(40))
            case _:
                messages[place] = message._replace(log_time=message.log_time ^ 1 << rng.randrange(40))

    for _ in range(25):
        state = rng.getstate()
        try:
            found = replay(edited(full, tmp_path / "e.mcap", rearrange=spoil))
        except LogError:
            continue
        assert not found.identical, state
        assert not found.within(1.0), state


def test_scene_and_commands_are_the_same_whatever_the_version(tmp_path: Path, full: Path) -> None:
    for name in ("scene_sha256", "result.inputs_sha256"):
        found = replay(edited(full, tmp_path / "e.mcap", facts=OTHER | {name.removeprefix("result."): "0" * 64}))
        assert found.corrupt == [f"rb_dynamics.{name}"]
        assert not found.within(1e-9)


def test_a_log_of_rule_1_is_the_same_still() -> None:
    """Commands arrived in a different order than in a replay, one exactly at the timeout of its channel."""
    found = replay(Path(__file__).parent / "rule_1.mcap")
    logged, here = found.facts["rb_dynamics.result.inputs_sha256"]
    assert logged == here
    assert found.missing == []
    assert found.identical or found.software


def test_the_order_in_which_changes_of_a_nanosecond_were_seen_does_not_count(tmp_path: Path) -> None:
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\n"
        "wrenches: [{topic: a, timeout: 0.1}, {topic: b, timeout: 0.1}]\n"
        "effects:\n- {type: uniform_gravity, acceleration_world: [0, 0, -9.8]}\n"
        "- {type: scheduled_wrench, schedule: [{time: 0.1, force: [0, 0, 1]}]}\n"
        "solver: {method: rkmk4, step: 0.05}\nduration: 0.3\noutput_rate: 20\n"
    )
    commands = [(name, Wrench((1.0, 2.0, 3.0), stamp_ns=ns)) for ns in (0, 100_000_000) for name in ("a", "b", "a")]
    hashes = []
    for order in (range(6), (1, 0, 2, 4, 3, 5), (0, 2, 1, 3, 5, 4)):
        path = tmp_path / "run.mcap"
        run = Simulation(scene, [McapSink(path)])
        run.start()
        for number in order:
            topic, wrench = commands[number]
            # As a node in lockstep: time goes to the stamp before the next command has come.
            run.advance(wrench.stamp_ns)
            run.post(topic, wrench, wrench.stamp_ns)
        run.advance(300_000_000)
        run.finish()
        assert replay(path).identical
        hashes.append(open_result(path))
    at_once = tmp_path / "at_once.mcap"
    simulate(scene, commands, [McapSink(at_once)])
    assert {*hashes} == {open_result(at_once)}


def test_a_command_that_still_waits_at_the_end_is_not_compared(tmp_path: Path) -> None:
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: a, delay: 0.3}]\nduration: 1\n"
        "solver: {method: rkmk4, step: 0.05}\n"
    )
    times = (0, 700_000_000, 700_000_001, 1_000_000_000)
    simulate(scene, [("a", Wrench((1.0, 0.0, 0.0), stamp_ns=ns)) for ns in times], [McapSink(tmp_path / "run.mcap")])
    found = replay(tmp_path / "run.mcap")
    assert found.identical
    assert [(topic, count) for (topic, _), count in found.uncompared.items()] == [("/a", 2)]


def test_a_body_that_is_moved_when_a_command_comes_at_the_timeout_of_another(tmp_path: Path) -> None:
    """The command was known before: there was no timeout, but replay goes to the time of the move without it."""
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: a, timeout: 0.1}]\nduration: 0.5\n"
    )
    run = Simulation(scene, [McapSink(tmp_path / "run.mcap")])
    for time_ns in (0, 100_000_000, 200_000_000):
        run.post("a", Wrench(torque=(0.0, 0.0, 0.1)), time_ns)
    run.start()
    run.advance(200_000_000)
    run.set_state(StateChange.to(State(time_ns=200_000_000, position_world=(1.0, 2.0, 3.0)), scene.body))
    run.advance(500_000_000)
    run.finish()
    assert replay(tmp_path / "run.mcap").identical


@pytest.mark.parametrize("lag", [0.0, 0.05])
@pytest.mark.parametrize("frame", ["body", "world"])
@pytest.mark.parametrize("size", [0.0, 0.1])
def test_a_command_at_the_timeout_of_another_may_look_like_the_timeout(
    tmp_path: Path, lag: float, frame: str, size: float
) -> None:
    """A zero command and a timeout have the same message, and so do both where the wrench follows with a lag."""
    scene = parse_scene(
        f"body: {{mass: 2, inertia: {{diagonal: [1, 2, 3]}}}}\nwrenches: [{{topic: a, timeout: 0.1, lag: {lag}}}]\n"
        "solver: {method: rkmk4, step: 0.05}\nduration: 0.5\noutput_rate: 20\n"
    )
    commands = [(0, 1.0), *((ns, size) for ns in (100_000_000, 200_000_000, 200_000_000, 350_000_000))]
    for early in (True, False):
        run = Simulation(scene, [McapSink(tmp_path / "run.mcap")])
        run.start()
        for time_ns, torque in commands:
            if not early:
                # As a node in lockstep: time goes to the timeout before the next command has come.
                run.advance(time_ns)
            run.post("a", Wrench(torque=(0.0, 0.0, torque), frame_id=frame), time_ns)
        run.advance(500_000_000)
        run.finish()
        assert replay(tmp_path / "run.mcap").identical

    def add(messages: list[Message]) -> None:
        last = max(i for i, each in enumerate(messages) if each.channel.topic == "/a/applied")
        messages.insert(last, messages[last])

    more = replay(edited(tmp_path / "run.mcap", tmp_path / "more.mcap", rearrange=add))
    assert [line.split()[0] for line in more.missing] == ["/a/applied"]


@pytest.mark.parametrize("delay", ["0.0", "0.013"])
def test_a_command_that_is_replaced_at_its_time_is_tried_as_where_it_comes_alone(tmp_path: Path, delay: str) -> None:
    """A paused node knows only the first of them when it tries it."""
    scene = parse_scene(SCENE.text.replace("/robot/turn", f"/robot/turn, delay: {delay}"))
    huge, small = (Wrench(torque=(size, 0.0, 0.0), stamp_ns=500_000_000) for size in (3e8, 0.1))
    commands = [("robot/turn", each) for each in (huge, small, huge, small)]
    simulate(scene, commands, [McapSink(tmp_path / "offline.mcap")])
    run = Simulation(scene, [McapSink(tmp_path / "node.mcap")])
    run.start()
    for topic, wrench in commands:
        run.advance(500_000_000)
        run.post(topic, wrench, 500_000_000)
    run.advance(2_000_000_000)
    run.finish()

    for path in (tmp_path / "offline.mcap", tmp_path / "node.mcap"):
        assert replay(path).identical
        assert len(read_bag(path).wrenches("/robot/turn/applied")) == 2
    assert open_result(tmp_path / "node.mcap") == open_result(tmp_path / "offline.mcap")


def test_a_command_of_a_wheel_that_is_replaced_at_its_time_is_tried_too(tmp_path: Path) -> None:
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: []\n"
        "actuators: [{type: reaction_wheel, name: x, axis: [1, 2, 3], inertia: 0.1}]\n"
        "solver: {method: dop853, step: 0.01}\nduration: 1\noutput_rate: 20\n"
    )
    run = Simulation(scene, [McapSink(tmp_path / "run.mcap")])
    run.start()
    for torque in (1e9, 0.1):
        run.advance(500_000_000)
        run.actuate("x/command", torque, 500_000_000)
    run.advance(1_000_000_000)
    run.finish()
    assert len(run.taken_back) == 1
    assert replay(tmp_path / "run.mcap").identical


def test_what_comes_one_by_one_while_time_stands_replays(tmp_path: Path) -> None:
    """As in a paused node: rejected commands between those that a delay keeps waiting, moves between commands."""
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0.3, -0.2, 0.1]}\n"
        "wrenches: [{topic: a, delay: 0.05}, {topic: b, lag: 0.1}]\n"
        "actuators:\n- {type: reaction_wheel, name: x, axis: [1, 2, 3], inertia: 0.1, friction: {coulomb: 0.01}}\n"
        "- {type: reaction_wheel, name: y, axis: [0, 1, 0], inertia: 0.1}\nduration: 0.5\noutput_rate: 20\n"
    )
    path, time_ns = tmp_path / "run.mcap", 123_456_789
    run = Simulation(scene, [McapSink(path)])
    run.start()
    run.post("b", Wrench((1.0, 2.0, 3.0), frame_id="world"), 10_000_000)
    moved = StateChange.to(State(0, orientation_xyzw=(0.6, 0.0, 0.0, 0.8)), scene.body)
    for topic in ("a", "y", "a", "nowhere", "b", "move", "b", "x", "y", "a", "x", "move", "b"):
        run.advance(time_ns)
        if topic in ("x", "y"):
            run.actuate(f"{topic}/command", 0.5 if run.sample.work else 0.0, time_ns)
        elif topic == "move":
            run.set_state(moved.at(time_ns))
        else:
            wrench = Wrench((1.0, 2.0, 3.0), frame_id="nowhere" if topic == "nowhere" else "")
            run.take(run.check("a" if topic == "nowhere" else topic, wrench), time_ns)
    run.advance(500_000_000)
    run.finish()
    assert replay(path).identical


def open_result(path: Path) -> str:
    """Return the hash of the inputs of a log."""
    return read_bag(path).metadata["rb_dynamics.result"]["inputs_sha256"]


def test_a_file_of_a_split_bag_is_not_all_of_the_run(tmp_path: Path) -> None:
    simulate(SCENE, COMMANDS, [BagSink(tmp_path / "bag", max_duration_s=0.7)])
    for number in range(3):
        with pytest.raises(LogError, match="found one file of a bag"):
            replay(tmp_path / "bag" / f"bag_{number}.mcap")


def test_a_bag_without_its_first_file_is_not_called_one_file_of_a_bag(tmp_path: Path) -> None:
    """With no metadata.yaml, nothing names the first file: the folder is what is there to be given."""
    simulate(SCENE, COMMANDS, [BagSink(bag := tmp_path / "bag", max_duration_s=0.7)])
    (bag / "bag_0.mcap").unlink()
    (bag / "metadata.yaml").unlink()
    with pytest.raises(LogError, match=r"bag begins at 0\.7 s, expected a run .*; add its first files, or inspect"):
        replay(bag)


def test_a_bag_without_its_last_file_is_compared_up_to_there(tmp_path: Path) -> None:
    simulate(SCENE, COMMANDS, [BagSink(bag := tmp_path / "bag", max_duration_s=0.7)])
    whole = replay(bag)
    files = sorted(bag.glob("*.mcap"))
    for last in reversed(files[1:]):
        last.unlink()
        found = replay(bag)
        assert found.identical
        assert not found.complete
        assert 0 < found.samples < whole.samples
    files[0].rename(bag / "bag_9.mcap")
    (bag / "metadata.yaml").unlink()
    assert replay(bag).identical


def test_a_bag_of_others_is_refused_with_the_remedy(example_dir: Path) -> None:
    with pytest.raises(LogError, match=r"cannot be run again; .*simulate SCENE --wrench BAG"):
        replay(example_dir / "slew.mcap")


def test_a_scene_that_is_not_valid_is_an_error_of_the_scene(tmp_path: Path) -> None:
    scene = dataclasses.replace(SCENE, text="body: {mass: -2}")
    simulate(scene, [], [McapSink(tmp_path / "run.mcap")])
    with pytest.raises(Exception, match="mass"):
        replay(tmp_path / "run.mcap")


def test_a_log_of_a_scene_that_no_text_says_is_not_run_again_as_another(tmp_path: Path) -> None:
    """After `replace` the text is that of the previous scene, so the log would fail."""
    scene = parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nduration: 0.1\n")
    path = tmp_path / "run.mcap"
    simulate(dataclasses.replace(scene, body=RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0))), sinks=[McapSink(path)])
    with pytest.raises(LogError, match="cannot be run again: its scene was made or changed in Python"):
        replay(path)

    simulate(dataclasses.replace(scene, source="other.yaml"), sinks=[McapSink(path)])
    assert replay(path).identical


MANY_DEVICES = """
body:
  mass: 3.3
  inertia: {matrix: [[0.3, 0.01, 0.0], [0.01, 0.4, -0.02], [0.0, -0.02, 0.5]]}
  frames: {jet: {position: [0.3, 0.1, -0.2], orientation: {x: 0, y: 0, z: 0.6, w: 0.8}}}
initial: {angular_velocity_body: [0.3, -0.2, 1.1]}
wrenches:
  - {topic: a, timeout: 0.31, max_force: 1.0, on_excess: clip, delay: 0.013}
  - {topic: b, lag: 0.07, bias: {force: [0, 0.1, 0]}}
actuators:
  - {type: reaction_wheel, name: wheel, axis: [1, 0.2, 0], inertia: 1.0e-3, max_torque: 0.02, speed: 10.0}
  - {type: thruster, name: jet, frame: jet, force: 0.5, minimum_on: 0.005, delay: 0.002, rise: 0.003, fall: 0.004}
sensors: [{type: imu, name: imu, rate: 250}]
solver: {method: dop853, step: 0.003}
duration: 0.5
"""


@pytest.mark.parametrize("outputs", ["output_rate: 100", "output_rate: 0"])
@pytest.mark.parametrize("seed", [pytest.param(seed, marks=[pytest.mark.slow] * (seed >= 4)) for seed in range(12)])
def test_whatever_meets_at_a_nanosecond_replays_to_the_bit(seed: int, outputs: str, tmp_path: Path) -> None:
    """Commands, pulses, moves, samples and steps as they come in a node; on a grid of 1 ms they often meet."""
    dice, log = random.Random(seed), tmp_path / "run.mcap"
    run = Simulation(parse_scene(MANY_DEVICES + outputs), [McapSink(log)])
    run.start()
    while run.computed_ns < 200_000_000:
        now_ns, kind = run.computed_ns, dice.random()
        then_ns = now_ns + 1_000_000 * dice.choice([0, 0, 1, 2, 5, 10])
        push = dice.gauss(0.0, 0.5), dice.gauss(0.0, 0.5), dice.gauss(0.0, 0.5)
        if kind < 0.3:
            run.post(dice.choice("ab"), Wrench(push, frame_id=dice.choice(["", "jet", "world"])), then_ns)
        elif kind < 0.55:
            run.actuate("jet/command", dice.choice([0.005, 0.008, 0.01, 0.02, 0.0]), then_ns)
        elif kind < 0.6:
            run.actuate("wheel/command", 0.02 * dice.random(), then_ns)
        elif kind < 0.7:
            run.move(StateChange.to(State(angular_velocity_body=push), run.scene.body))
        else:
            run.advance(now_ns + 1_000_000 * dice.choice([0, 1, 2, 3, 10, 20]))
    run.advance(500_000_000)
    run.finish()
    assert replay(log).identical


@pytest.mark.parametrize("seed", range(10))
def test_commands_that_come_as_others_expire_while_the_body_is_moved_replay_to_the_bit(
    seed: int, tmp_path: Path
) -> None:
    """As in a node in lockstep whose timeouts are multiples of the time between commands."""
    dice, log = random.Random(seed), tmp_path / "run.mcap"
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nsolver: {method: rk4, step: 0.01}\nduration: 0.25\n"
        "wrenches: [{topic: a, timeout: 0.01, lag: 0.02}, {topic: b, timeout: 0.01},"
        f" {{topic: c, timeout: 0.02, max_force: 1.0, lag: 0.03}}]\noutput_rate: {dice.choice([0, 20, 100])}\n"
    )
    run = Simulation(scene, [McapSink(log)])
    run.start()
    while run.computed_ns < 200_000_000:
        now_ns, kind = run.computed_ns, dice.random()
        push = dice.choice([0.0, dice.gauss(0.0, 1.0), 0.5, 9.0]), 0.0, 0.0
        if kind < 0.5:
            then_ns = now_ns + 10_000_000 * dice.choice([0, 0, 0, 1, 1, 2])
            wrench = Wrench(push, frame_id=dice.choice(["", "world"]))
            with contextlib.suppress(WrenchError):
                run.post(dice.choice("aabc"), wrench, then_ns)
        elif kind < 0.65:
            run.move(StateChange.to(State(angular_velocity_body=push), scene.body))
        else:
            run.advance(now_ns + 10_000_000 * dice.choice([0, 1, 1, 1, 2]))
    run.advance(250_000_000)
    run.finish()
    assert replay(log).identical


def test_a_body_that_is_turned_back_as_its_command_expires_and_another_comes_replays(tmp_path: Path) -> None:
    """The wrench on its way is in body axes before the move, and of both frames after it: other numbers."""
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0, 0, 9]}\n"
        "wrenches: [{topic: a, timeout: 0.01, lag: 0.02}]\nsolver: {method: dop853, step: 0.01}\n"
        "duration: 0.05\noutput_rate: 100\n"
    )
    run = Simulation(scene, [McapSink(tmp_path / "run.mcap")])
    run.start()
    for time_ns, frame in ((0, "world"), (10_000_000, ""), (20_000_000, "world")):
        run.advance(time_ns)
        run.move(StateChange.to(State(angular_velocity_body=(0.0, 0.0, 9.0)), scene.body))
        run.post("a", Wrench((1.0, 2.0, 3.0), frame_id=frame), time_ns)
    run.advance(50_000_000)
    run.finish()
    assert replay(tmp_path / "run.mcap").identical


@pytest.mark.parametrize("sensors", ["", "sensors: [{type: imu, name: imu, rate: 10}]\n"])
def test_a_state_from_which_the_motion_could_not_continue_has_no_output_of_its_own(
    sensors: str, tmp_path: Path
) -> None:
    """Where every step is an output: the log does not name the state, so a replay does not come by."""
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\ninitial: {position_world: [9, 0, 0]}\n"
        "effects: [{type: central_gravity, gravitational_parameter: 1.0}]\n"
        "solver: {method: rkmk4, step: 0.03}\nduration: 1\noutput_rate: 0\n" + sensors
    )
    run = Simulation(scene, [McapSink(tmp_path / "run.mcap")])
    run.start()
    run.advance(500_000_000)
    run.set_state(StateChange.to(State(position_world=(0.0, 0.0, 0.0)), scene.body).at(500_000_000))
    run.advance(1_000_000_000)
    run.finish()
    assert len(run.refused) == 1
    assert replay(tmp_path / "run.mcap").identical


def test_a_run_that_ends_at_its_start_has_what_acts_from_there(tmp_path: Path) -> None:
    """As that of a node that is reset twice at once."""
    scene = parse_scene(
        "body: {mass: 2}\nwrenches: [{topic: a, bias: {force: [1, 0, 0]}}]\n"
        "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}]\n"
    )
    run = Simulation(scene, [McapSink(tmp_path / "run.mcap")])
    run.start()
    run.finish()
    assert replay(tmp_path / "run.mcap").identical


def test_a_sink_that_fails_as_a_run_ends_at_its_start_leaves_the_others_closed(tmp_path: Path) -> None:
    class Full:
        def open(self, run: RunInfo) -> None: ...
        def write(self, event: Event) -> None:
            if isinstance(event, AppliedWrench):
                raise OSError("no space left on device")

        def close(self, result: Mapping[str, str]) -> None: ...

    scene = parse_scene("body: {mass: 2}\nwrenches: [{topic: a, bias: {force: [1, 0, 0]}}]\n")
    run = Simulation(scene, [McapSink(log := tmp_path / "run.mcap"), Full()])
    run.start()
    with pytest.raises(OSError, match="no space"):
        run.finish()
    assert replay(log).identical
