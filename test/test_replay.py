"""A log is run again from what is in it: to the last bit, and what was changed in it shows."""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from rb_dynamics import Wrench, parse_scene, simulate
from rb_dynamics.errors import LogError
from rb_dynamics.recording.bag_sink import BagSink
from rb_dynamics.recording.bag_source import Source, open_source
from rb_dynamics.recording.log_file import LogFile
from rb_dynamics.recording.mcap_reader import read_bag
from rb_dynamics.recording.mcap_records import McapFile, Message
from rb_dynamics.recording.mcap_sink import LogSettings, McapSink
from rb_dynamics.recording.mcap_writer import McapWriter
from rb_dynamics.recording.recover import recover
from rb_dynamics.replay import replay

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


def edited(source: Path, target: Path, edit: Callable[[Message], Message | None]) -> Path:
    """Copy a log through `edit`, which changes a message or leaves it out."""
    old = McapFile(source)
    messages = list(old.messages())
    file = LogFile(target)
    writer = McapWriter(file, "test")
    writer.begin()
    numbers = {
        channel.topic: writer.add_channel(
            channel.topic, channel.encoding, writer.add_schema(*channel.schema), channel.metadata
        )
        for channel in old.channels.values()
    }
    for message in filter(None, map(edit, messages)):
        writer.add_messages((numbers[message.channel.topic],), (message.data,), message.log_time, message.publish_time)
    for name, data in old.attachments.items():
        writer.add_attachment(name, "", data)
    for name, facts in old.metadata.items():
        writer.add_metadata(name, facts)
    writer.finish()
    file.close()
    return target


@pytest.fixture
def log(tmp_path: Path) -> Path:
    simulate(SCENE, COMMANDS, [McapSink(tmp_path / "run.mcap")])
    return tmp_path / "run.mcap"


def test_the_same_bits(log: Path) -> None:
    found = replay(log)
    assert found.identical
    assert (found.samples, found.commands, found.complete, found.software) == (61, 6, True, {})
    assert set(found.hashes) == {"states_sha256", "inputs_sha256"}
    assert all(logged == here and len(logged) == 64 for logged, here in found.hashes.values())


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
    log.write_bytes(log.read_bytes()[:-6000])
    recover(log, tmp_path / "saved.mcap")
    for path in (log, tmp_path / "saved.mcap"):
        found = replay(path)
        assert found.identical
        assert not found.complete
        assert found.hashes == {}, "cut off before its first checkpoint"


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
    assert found.hashes == {}


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
        assert set(found.hashes) == {"states_sha256"}

    checkpoint = read_bag(path).metadata["rb_dynamics.checkpoint"]["states_sha256"].encode()
    path.write_bytes(path.read_bytes().replace(checkpoint, b"0" * 64))
    assert replay(path).proven_ns is None
    assert not replay(path).identical


def test_a_log_that_is_still_being_written_is_compared_up_to_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = parse_scene(SCENE.text.replace("duration: 2", "duration: 40"))
    simulate(scene, COMMANDS, [McapSink(tmp_path / "whole.mcap", settings=LogSettings(flush_s=0.0))])
    data, growing = (tmp_path / "whole.mcap").read_bytes(), tmp_path / "growing.mcap"
    lengths = iter((len(data) // 2, 3 * len(data) // 4))

    def grown(path: Path) -> Source:
        growing.write_bytes(data[: next(lengths)])
        return open_source(path)

    monkeypatch.setattr("rb_dynamics.replay.open_source", grown)
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
    assert not any(logged == here for logged, here in found.hashes.values())


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


def test_a_file_of_a_split_bag_is_not_all_of_the_run(tmp_path: Path) -> None:
    simulate(SCENE, COMMANDS, [BagSink(tmp_path / "bag", max_duration_s=0.7)])
    for number in range(3):
        with pytest.raises(LogError, match="found one file of a bag"):
            replay(tmp_path / "bag" / f"bag_{number}.mcap")


def test_a_bag_of_others_is_refused_with_the_remedy(example_dir: Path) -> None:
    with pytest.raises(LogError, match=r"cannot be run again; .*simulate SCENE --wrench BAG"):
        replay(example_dir / "slew.mcap")


def test_a_scene_that_is_not_valid_is_an_error_of_the_scene(tmp_path: Path) -> None:
    scene = dataclasses.replace(SCENE, text="body: {mass: -2}")
    simulate(scene, [], [McapSink(tmp_path / "run.mcap")])
    with pytest.raises(Exception, match="mass"):
        replay(tmp_path / "run.mcap")
