"""`inspect --scene` judges a bag of another program by what acts as the scene says, and does not accuse the body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bag_rows import write_rows

from rb_dynamics import Inspection, Setpoint, Wrench, compare, inspect, parse_scene, simulate
from rb_dynamics.analysis.acting_wrenches import acting_wrenches, timed_out
from rb_dynamics.analysis.identification.flights import read_flight
from rb_dynamics.analysis.read_track import TopicChoice
from rb_dynamics.analysis.track import RecordedWrench
from rb_dynamics.conversion.convert import merge_bags
from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.sinks.mcap_sink import McapSink

ODOMETRY, STAMPED = "nav_msgs/msg/Odometry", "geometry_msgs/msg/WrenchStamped"
PLAIN = "geometry_msgs/msg/Wrench"
SECOND = 10**9
SCENE = """
body:
  mass: 4.0
  inertia: {{matrix: [[0.30, -0.01, 0.04], [-0.01, 0.22, 0.0], [0.04, 0.0, {zz}]]}}
  frames: {{jet: {{position: [0, 0.2, 0], orientation: {{x: 0, y: 0, z: 0, w: 1}}}}}}
initial: {{angular_velocity_body: [0.5, 0.3, -0.4]}}
duration: 8.0
output_rate: 100.0
{rest}
"""
TORQUE = (0.05, -0.04, 0.06)
COMMANDS = [
    ("wrench", Wrench(torque=TORQUE, stamp_ns=SECOND)),
    ("wrench", Wrench(torque=(-0.03, 0.05, -0.04), stamp_ns=4 * SECOND)),
]
ACTING = {
    "delay": "wrenches: [{topic: wrench, delay: 0.2}]",
    "timeout": "wrenches: [{topic: wrench, timeout: 1.5}]",
    "bias": "wrenches: [{topic: wrench, bias: {torque: [0.02, -0.01, 0.03]}}]",
    "gravity": "wrenches: [{topic: wrench}]\neffects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}]",
    "schedule": "wrenches: [{topic: wrench}]\neffects: [{type: scheduled_wrench, frame_id: world, schedule: "
    "[{time: 2.0, torque: [0.02, -0.01, 0.03]}, {time: 5.0}]}]",
    "force at a point": "wrenches: [{topic: wrench}]\neffects: [{type: scheduled_wrench, frame_id: jet, schedule: "
    "[{time: 2.0, force: [0.2, 0, 0.1]}, {time: 5.0}]}]",
}
OFTEN = ("timeout", "force at a point")


def flown(folder: Path, rest: str, commands: list[tuple[str, Wrench | Setpoint]], later_ns: int = 0) -> Path:
    """Return the bag that another program records of a flight: the motion, and the wrenches that were commanded."""
    log = folder / "run.mcap"
    simulate(parse_scene(SCENE.format(zz=0.38, rest=rest)), commands, [McapSink(log)])
    rows = []
    for message in open_source(log).messages():
        if message.channel.topic == "/odom":
            values = cdr.decode(ODOMETRY, message.data)
            stamp = message.log_time + later_ns
            rows.append(("/odom", ODOMETRY, stamp, cdr.encode(ODOMETRY, stamp, *values[1:])))
    for topic, sent in commands:
        if isinstance(sent, Wrench):
            stamp = sent.stamp_ns + later_ns
            data = cdr.encode(STAMPED, stamp, "body", (*sent.force, *sent.torque))
            rows.append((f"/{topic}", STAMPED, stamp, data))
    return write_rows(folder / "bag.mcap", sorted(rows, key=lambda row: row[2]))


def verdict(found: Inspection) -> tuple[bool, bool]:
    (check,) = (each for each in found.summary.checks if each.name == "inertia explains the motion")
    return check.judged, check.passed


@pytest.mark.parametrize(
    "what", [pytest.param(name, marks=[pytest.mark.slow] * (name not in OFTEN)) for name in ACTING]
)
def test_what_the_scene_says_acts_is_no_fault_of_the_body(what: str, tmp_path: Path) -> None:
    bag = flown(tmp_path, ACTING[what], COMMANDS, 1_700_000_000 * SECOND)
    true = inspect(bag, parse_scene(SCENE.format(zz=0.38, rest=ACTING[what])))
    assert true.passed
    assert verdict(true) == (True, True)
    wrong = inspect(bag, parse_scene(SCENE.format(zz=0.38 * 1.02, rest=ACTING[what])))
    assert verdict(wrong) == (True, False)
    plain = inspect(bag, parse_scene(SCENE.format(zz=0.38, rest="wrenches: [{topic: wrench}]")))
    assert not plain.passed
    (said,) = (note for note in true.track.notes if "not what acted" in note)
    assert ("nothing else is assumed to act" in said) == (what in ("delay", "timeout"))
    told = {"gravity": "uniform_gravity", "bias": "wrench/bias", "delay": "its delay of 0.2", "timeout": "of 1.5 s"}
    assert told.get(what, "scheduled_wrench") in said


def renamed(bag: Path, topic: str, *more: str) -> Path:
    """Return a copy of `bag` with the wrenches on `topic`, and their first ones on `more` topics, too."""
    rows = [(m.channel.topic, m.channel.type_name, m.log_time, m.data) for m in open_source(bag).messages()]
    rows = [(topic if row[0] == "/wrench" else row[0], *row[1:]) for row in rows]
    rows += [(name, *next(row for row in rows if row[0] == topic)[1:]) for name in more]
    return write_rows(bag.with_name("renamed.mcap"), sorted(rows, key=lambda row: row[2]))


@pytest.mark.parametrize(
    ("topics", "chosen", "expected"),
    [
        (["/sat/wrench"], "", (True, True)),
        (["/cmd"], "", (False, True)),
        (["/cmd"], "/cmd=wrench", (True, True)),
        (["/a/wrench", "/b/wrench"], "", (False, True)),
        (["/a/wrench", "/b/wrench"], "/a/wrench", (True, True)),
    ],
)
def test_the_channel_of_commands_is_found_or_not_guessed(
    topics: list[str], chosen: str, expected: tuple[bool, bool], tmp_path: Path
) -> None:
    """Commands of a namespace were taken without the delay of their channel, which accused the body."""
    bag = renamed(flown(tmp_path, ACTING["delay"], COMMANDS), *topics)
    scene, choice = (
        parse_scene(SCENE.format(zz=0.38, rest=ACTING["delay"])),
        TopicChoice(wrenches=(chosen,) * bool(chosen)),
    )
    found = inspect(bag, scene, topics=choice)
    assert verdict(found) == expected
    said = [note for note in found.track.notes if "cannot tell whether" in note and all(t in note for t in topics)]
    assert len(said) == (not expected[0])
    if said:
        with pytest.raises(LogError, match=r"cannot tell whether .* has the commands of wrench"):
            read_flight(str(bag), scene, topics=choice)
    else:
        (channel,) = read_flight(str(bag), scene, topics=choice).channels
        assert (channel.time_ns / SECOND).tolist() == [1.2, 4.2]


@pytest.mark.parametrize(
    ("topics", "motion", "used"),
    [
        (["/b/wrench", "/a/wrench"], ["/b/odom"], "/b/wrench"),
        (["/b/wrench", "/a/wrench"], ["/odom"], ""),
        (["/b/wrench"], ["/a/odom", "/b/odom"], ""),
    ],
)
def test_of_the_commands_of_several_bodies_those_beside_the_motion_act_or_none_is_judged(
    topics: list[str], motion: list[str], used: str, tmp_path: Path
) -> None:
    """They were summed, which accused the body."""
    rest = "wrenches: [{topic: wrench}]"
    bag = renamed(flown(tmp_path, rest, COMMANDS), *topics)
    rows = [(m.channel.topic, m.channel.type_name, m.log_time, m.data) for m in open_source(bag).messages()]
    rows = [
        (name if row[0] == "/odom" else row[0], *row[1:])
        for row in rows
        for name in (motion if row[0] == "/odom" else [""])
    ]
    both = write_rows(tmp_path / "both.mcap", rows)
    scene = parse_scene(SCENE.format(zz=0.38, rest=rest))
    for found in (inspect(both, scene), inspect(both)):
        assert [each.topic for each in found.track.wrenches] == ([used] if used else sorted(topics))
        assert ("cannot tell whether" in found.track.unrecorded) == (not used)
    assert verdict(inspect(both, scene)) == (bool(used), True)
    parts = [
        str(write_rows(tmp_path / f"{name}.mcap", [row for row in rows if (row[1] == STAMPED) == (name == "commands")]))
        for name in ("motion", "commands")
    ]
    if used:
        for path, more in ((str(both), []), (parts[0], parts[1:])):
            assert [each.topic for each in read_flight(path, scene, more).channels] == [used]
        assert compare(scene, both, align="start", bound=1e-6).passed
    else:
        with pytest.raises(LogError, match=r"cannot tell whether .* commands the body of /\S*odom; .*--wrench-topic"):
            read_flight(str(both), scene)


def test_commands_without_stamps_follow_log_times_of_another_rate_or_are_not_judged(tmp_path: Path) -> None:
    """Put at one distance from their log times, they accused the body."""
    scene = parse_scene(SCENE.format(zz=0.38, rest="wrenches: [{topic: wrench}]"))
    rows = [
        (m.channel.topic, m.channel.type_name, m.log_time, m.data)
        for m in open_source(flown(tmp_path, "wrenches: [{topic: wrench}]", COMMANDS)).messages()
    ]

    def logged(path: str, at: Callable[[int], int], commands_at: Callable[[int], int] | None = None) -> Path:
        plain = [
            (topic, PLAIN, (commands_at or at)(time_ns), data[:4] + data[-48:])
            if kind == STAMPED
            else (topic, kind, at(time_ns), data)
            for topic, kind, time_ns, data in rows
        ]
        return write_rows(tmp_path / path, plain)

    found = inspect(logged("half.mcap", lambda at: 10**18 + 2 * at), scene)
    assert verdict(found) == (True, True)
    assert found.track.wrenches[0].time_ns.tolist() == [SECOND, 4 * SECOND]
    part = inspect(logged("half.mcap", lambda at: 10**18 + 2 * at), scene, window_s=(2.0, 5.0))
    assert part.track.wrenches[0].time_ns.tolist() == [SECOND, 4 * SECOND]
    random = np.random.default_rng(6)

    def fast(at: int) -> int:
        return 10**18 + round(1.003 * at)

    late = inspect(logged("late.mcap", lambda at: fast(at) + int(random.integers(2_000_000)), fast), scene)
    (judged,) = (each for each in late.summary.checks if each.name == "inertia explains the motion")
    assert (judged.judged, judged.passed) == (False, True)
    assert "the commands have no stamps, and the error of the times at which they were logged" in judged.detail
    for zero_ns, till in ((0, 3.0), (10**18, 3.0), (10**18, 7.9)):
        jumps = logged(
            "jumps.mcap", lambda at, begin=zero_ns, till=till: begin + at + 5 * SECOND * (at > till * SECOND)
        )
        told = inspect(jumps, scene)
        assert not verdict(told)[0]
        if till == 3.0:
            assert any("stamps; /wrench, without stamps, goes by log times." in each for each in told.summary.warnings)
        with pytest.raises(LogError, match=r"cannot tell when /wrench acted, which has no stamps") as raised:
            read_flight(str(jumps), scene)
        assert "commands with stamps" in str(raised.value)
        assert "--wrench-topic" not in str(raised.value)


@pytest.mark.parametrize(("other", "sure"), [("/a/imu", True), ("/a/truth", False)])
def test_a_wrench_of_another_namespace_is_taken_with_a_note_unless_a_pose_is_there(
    other: str, sure: bool, tmp_path: Path
) -> None:
    """Those of another body were taken without a word; an IMU may be the body's own."""
    rest, kind = "wrenches: [{topic: wrench}]", "sensor_msgs/msg/Imu"
    bag = renamed(flown(tmp_path, rest, COMMANDS), "/a/wrench")
    rows = [(m.channel.topic, m.channel.type_name, m.log_time, m.data) for m in open_source(bag).messages()]
    rows = [("/b/odom" if row[0] == "/odom" else row[0], *row[1:]) for row in rows]
    imu = cdr.encode(kind, SECOND, "imu", *map(np.zeros, (4, 1, 8, 3, 1, 8, 3, 1, 8)))
    rows += [(other, kind, SECOND, imu)] if sure else [(other, *row[1:]) for row in rows if row[0] == "/b/odom"]
    found = inspect(write_rows(tmp_path / "two.mcap", rows), parse_scene(SCENE.format(zz=0.38, rest=rest)))
    assert verdict(found) == (sure, True)
    told = "/a/wrench: taken for wrenches on the body of /b/odom, in another namespace; --wrench-topic chooses others."
    assert (told in found.track.notes) == sure


def test_a_frame_that_the_scene_does_not_have_is_to_be_declared_there(tmp_path: Path) -> None:
    """The scene was asked for although it was given."""
    scene = SCENE.format(zz=0.38, rest="wrenches: [{topic: wrench}]").replace("body:", "body:\n  frame: hull", 1)
    found = inspect(flown(tmp_path, "wrenches: [{topic: wrench}]", COMMANDS), parse_scene(scene))
    (told,) = (note for note in found.track.notes if "undeclared frame" in note)
    assert "declare these there" in told


def test_a_topic_is_chosen_for_a_channel_only(tmp_path: Path) -> None:
    bag = flown(tmp_path, ACTING["delay"], COMMANDS)
    with pytest.raises(LogError, match=r"/wrench is chosen for 'push', expected a channel of the scene: \['wrench'\]"):
        inspect(
            bag,
            parse_scene(SCENE.format(zz=0.38, rest=ACTING["delay"])),
            topics=TopicChoice(wrenches=("/wrench=push",)),
        )


@pytest.mark.parametrize("what", ["delay", "schedule"])
def test_what_a_part_of_a_bag_does_not_have_is_not_known(what: str, tmp_path: Path) -> None:
    """A command that still waits where it begins, and the time of a schedule, are not in it: it accused the body."""
    rest = "wrenches: [{topic: wrench, delay: 1.5}]" if what == "delay" else ACTING[what]
    commands = [*COMMANDS, ("wrench", Wrench(torque=(0.02, 0.06, 0.01), stamp_ns=3 * SECOND))]
    bag, part = flown(tmp_path, rest, commands), tmp_path / "part.mcap"
    merge_bags([bag], part, (4.2 if what == "delay" else 1.5, None))
    found = inspect(part, parse_scene(SCENE.format(zz=0.38, rest=rest)))
    assert all(check.passed for check in found.summary.checks if check.judged)
    assert verdict(found)[0] == (what == "delay")
    if what == "delay":
        assert compare(tmp_path / "run.mcap", part, align=0.0).commands is None


def test_a_part_of_a_bag_begins_with_the_commands_that_wait_for_their_delay(tmp_path: Path) -> None:
    # At 4.1 s the first command still acts, and the second waits until 4.5 s.
    rest = "wrenches: [{topic: wrench, delay: 0.5}]"
    bag = flown(tmp_path, rest, COMMANDS)
    found = inspect(bag, parse_scene(SCENE.format(zz=0.38, rest=rest)), window_s=(4.1, 7.0))
    assert found.track.wrenches[0].time_ns.tolist() == [SECOND, 4 * SECOND]
    assert verdict(found) == (True, True)


@pytest.mark.parametrize("even", [True, False])
def test_a_recording_that_begins_amid_commands_does_not_say_what_was_held(tmp_path: Path, even: bool) -> None:
    """Nothing was taken to act before its first command: balances failed, and no inertia explained the motion."""
    rest = "wrenches: [{topic: wrench, delay: 0.1}]"
    times_s = 0.25 * np.arange(32) + 0.01 if even else np.sort(np.random.default_rng(3).uniform(0.1, 7.9, 12))
    sent = [
        ("wrench", Wrench(torque=tuple(0.06 * np.sin([k, 2.0 * k, 3.0 * k + 1.0])), stamp_ns=round(at * SECOND)))
        for k, at in enumerate(times_s.tolist())
    ]
    bag, scene = flown(tmp_path, rest, sent), parse_scene(SCENE.format(zz=0.38, rest=rest))
    rows = [(m.channel.topic, m.channel.type_name, m.log_time, m.data) for m in open_source(bag).messages()]
    late = write_rows(tmp_path / "late.mcap", [row for row in rows if row[2] >= 3.1 * SECOND])
    found = inspect(late, scene)
    assert verdict(found) == (True, True)
    assert found.passed
    assert any("may have begun amid commands" in note for note in found.summary.notes)
    assert inspect(bag, scene).passed
    assert not inspect(late, parse_scene(SCENE.format(zz=0.45, rest=rest))).passed


def test_a_recording_that_begins_amid_commands_without_stamps_is_not_accused(tmp_path: Path) -> None:
    """The times of its commands hide the inertia, so that what acted before them counted as a torque without cause."""
    rest, random = "wrenches: [{topic: wrench}]", np.random.default_rng(5)
    sent = [
        ("wrench", Wrench(torque=tuple(0.06 * np.sin([k, 2.0 * k, 3.0 * k + 1.0])), stamp_ns=round(at * SECOND)))
        for k, at in enumerate(np.arange(0.1, 7.5, 0.6).tolist())
    ]
    rows = [
        (topic, PLAIN, at + int(random.integers(300_000)), data[:4] + data[-48:])
        if topic == "/wrench"
        else (topic, kind, at + int(random.integers(300_000)), data)
        for topic, kind, at, data in (
            (m.channel.topic, m.channel.type_name, m.log_time, m.data)
            for m in open_source(flown(tmp_path, rest, sent)).messages()
        )
        if at >= 3.2 * SECOND
    ]
    late = write_rows(tmp_path / "late.mcap", sorted(rows, key=lambda row: row[2]))
    found = inspect(late, parse_scene(SCENE.format(zz=0.38, rest=rest)))
    assert found.passed
    assert verdict(found) == (False, True)
    assert any("may have begun amid commands" in note for note in found.summary.notes)


def test_a_command_that_was_rejected_before_a_part_leaves_the_one_that_is_held(tmp_path: Path) -> None:
    """It was taken for the one that is held: nothing acted, and no inertia explained the motion."""
    rest = "wrenches: [{topic: wrench, max_torque: 0.2}]"
    bag = flown(tmp_path, rest, [*COMMANDS, ("wrench", Wrench(torque=(0.3, 0, 0), stamp_ns=2 * SECOND))])
    scene, part = parse_scene(SCENE.format(zz=0.38, rest=rest)), tmp_path / "part.mcap"
    found = inspect(bag, scene, window_s=(2.5, 7.0))
    assert found.track.wrenches[0].time_ns.tolist() == [SECOND, 4 * SECOND]
    assert verdict(found) == (True, True)
    merge_bags([bag], part, (2.5, None))
    found = inspect(part, scene)
    assert all(check.passed for check in found.summary.checks if check.judged)
    assert not found.track.by_scene[0].known[0], "the bag does not have what is held"


def test_a_part_of_a_bag_counts_the_time_of_schedules_from_its_begin(tmp_path: Path) -> None:
    bag = flown(tmp_path, ACTING["schedule"], COMMANDS)
    found = inspect(bag, parse_scene(SCENE.format(zz=0.38, rest=ACTING["schedule"])), window_s=(1.5, 7.0))
    assert verdict(found) == (True, True)


def test_what_an_actuator_does_is_not_judged(tmp_path: Path) -> None:
    rest = "actuators: [{type: thruster, name: jet, frame: jet, force: 0.5, command: on_time}]"
    bag = flown(tmp_path, rest, [("jet/command", Setpoint(1.0, 2 * SECOND))])
    found = inspect(bag, parse_scene(SCENE.format(zz=0.38, rest=rest)))
    assert verdict(found) == (False, True)
    assert any("the scene has thruster" in note for note in found.track.notes)


def test_a_wrench_topic_beside_drag_is_not_said_to_be_missing(tmp_path: Path) -> None:
    rest = "wrenches: [{topic: wrench}]\neffects: [{type: linear_drag, translation: 0.1, rotation: 0.01}]"
    bag = flown(tmp_path, rest, COMMANDS)
    found = inspect(bag, parse_scene(SCENE.format(zz=0.38, rest=rest)))
    assert found.track.uses["/wrench"] == "wrench"
    assert not any("No wrench topic" in each for each in found.summary.missing)
    assert verdict(found) == (False, True)


def test_a_command_that_comes_in_time_or_may_have_come_does_not_expire() -> None:
    times, rows = timed_out(np.array([0, 4, 9]), 5)
    assert (times.tolist(), rows.tolist()) == ([0, 4, 9, 14], [0, 1, 2, -1])

    scene = parse_scene(SCENE.format(zz=0.38, rest="wrenches: [{topic: wrench, timeout: 2.0, delay: 0.5}]"))
    sent = [time * SECOND for time in (0, 10)]
    ones, flags = np.ones((2, 3)), np.zeros(2, dtype=bool)
    (channel,) = scene.channels
    sides = (ones, ones, flags, flags, ~flags, ("body",))
    wrench = RecordedWrench("/wrench", np.array(sent), *sides, channel=channel)
    (whole,) = acting_wrenches([wrench], scene, [], 0)
    assert [t / SECOND for t in whole.time_ns.tolist()] == [0.5, 2.5, 10.5, 12.5]
    assert whole.force[:, 0].tolist() == [1.0, 0.0, 1.0, 0.0]
    (holed,) = acting_wrenches([wrench], scene, [(SECOND, 3 * SECOND)], 0)
    assert [t / SECOND for t in holed.time_ns.tolist()] == [0.5, 1.5, 10.5, 12.5]
    assert holed.known.tolist() == [True, False, True, True]
    # That the last one is not understood says nothing of the others.
    (odd,) = acting_wrenches([replace(wrench, known=~flags & [True, False])], scene, [], 0)
    assert odd.known.tolist() == [True, True, False]


def test_an_effect_whose_wrench_was_recorded_acts_once() -> None:
    scene = parse_scene(SCENE.format(zz=0.38, rest=ACTING["gravity"]))
    empty, flags = np.zeros((1, 3)), np.zeros(1, dtype=bool)
    topic = "/b/effects/uniform_gravity/applied"
    wrench = RecordedWrench(topic, np.zeros(1, np.int64), empty, empty, ~flags, flags, ~flags, ("world",))
    assert acting_wrenches([wrench], scene, [], 0)[1:] == ()
    assert len(acting_wrenches([], scene, [], 0)) == 1
