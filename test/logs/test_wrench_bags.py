"""Recorded commands for a run: selection, order, and time zero of the bags."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from bag_rows import STAMPED, Row, stamped, write_rows
from hypothesis import given, settings
from hypothesis import strategies as st

from rb_dynamics import Simulation, inspect, parse_scene, simulate
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.cli import main
from rb_dynamics.cli.output import warn_outside
from rb_dynamics.errors import LogError
from rb_dynamics.formats import cdr
from rb_dynamics.formats.channel_metadata import log_channel
from rb_dynamics.formats.mcap_writer import McapWriter
from rb_dynamics.formats.message_types import POSE, SCALAR
from rb_dynamics.formats.output_file import OutputFile
from rb_dynamics.loads.reaction_wheel import ReactionWheel
from rb_dynamics.loads.thruster import Thruster
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.logs.wrench_bags import RecordedWrenches, Start, read_wrenches
from rb_dynamics.sinks.mcap_sink import McapSink

pytest.importorskip("mcap")

SLEW = Path(__file__).parents[2] / "examples" / "slew.mcap"
WRENCH = "geometry_msgs/msg/Wrench"
WALL_NS = 1_700_000_000_123_456_789
SECOND = 1_000_000_000
WHEEL = ReactionWheel(name="w", axis=(1.0, 0.0, 0.0), inertia=0.5)


def test_names_that_do_not_match_are_listed() -> None:
    with pytest.raises(LogError, match=r"/wrench/body \(600 messages\), /wrench/world \(600.*expects wrench;"):
        read_wrenches(SLEW, ["wrench"])


def test_a_bag_without_any_wrench(tmp_path: Path) -> None:
    scalar = "std_msgs/msg/Float64"
    path = write_rows(tmp_path / "a.mcap", [("/x", scalar, 0, cdr.encode(scalar, (1,)))])
    with pytest.raises(LogError, match="wrench topics are none"):
        read_wrenches(path, ["wrench"])


def test_a_scene_without_channels_is_told_so(example_dir: Path) -> None:
    with pytest.raises(LogError, match=r"the scene expects none; add a channel under `wrenches`"):
        read_wrenches(example_dir / "slew.mcap", [])


def test_a_channel_that_never_spoke_is_no_error(tmp_path: Path) -> None:
    scene = parse_scene("body: {mass: 1}\nwrenches: [{topic: wrench}]\nduration: 1\n")
    simulate(scene, sinks=[McapSink(tmp_path / "coast.mcap")])
    found = RecordedWrenches([tmp_path / "coast.mcap"], ["wrench"], SECOND, start="auto")
    assert list(found) == []
    found.require_some()


def test_a_bag_of_another_program_without_commands_is_an_error(tmp_path: Path) -> None:
    """The body coasted, with a note and exit code 0, as if that had been asked for."""
    with OutputFile.whole(tmp_path / "empty.mcap") as file:
        writer = McapWriter(file, "test")
        writer.begin()
        writer.add_channel(log_channel("/wrench", STAMPED, ""))
        writer.finish()
    one = write_rows(tmp_path / "one.mcap", [("/wrench", STAMPED, 0, stamped(0, 1.0))])
    with pytest.raises(LogError, match=r"empty\.mcap has no command, expected at least one"):
        RecordedWrenches([tmp_path / "empty.mcap"], ["wrench"], SECOND, start="auto").require_some()
    RecordedWrenches([tmp_path / "empty.mcap", one], ["wrench"], SECOND, start="auto").require_some()


def test_a_bag_that_was_cut_off_before_its_first_command_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: wrench}]\nduration: 10\n"
    scene, log = tmp_path / "scene.yaml", tmp_path / "run.mcap"
    scene.write_text(text)
    command = Wrench((1.0, 0.0, 0.0), (0.0, 0.0, 0.0), "body", 9 * SECOND)
    simulate(parse_scene(text), [("wrench", command)], [McapSink(log)])
    data = log.read_bytes()
    assert main(["simulate", str(scene), "--wrench", str(log)]) == 0
    log.write_bytes(data[: len(data) // 5])
    assert main(["simulate", str(scene), "--wrench", str(log)]) == 2
    assert "was cut off: no command is left in it" in capsys.readouterr().err


def test_order_is_by_stamp_and_for_equal_stamps_that_of_the_log(tmp_path: Path) -> None:
    stamps = [30, 10, 20, 10, 30, 20, 10]
    rows: list[Row] = [(f"/{'ab'[i % 2]}", STAMPED, 100 + i, stamped(at, i)) for i, at in enumerate(stamps)]
    found = read_wrenches(write_rows(tmp_path / "a.mcap", rows), ["a", "b"])
    assert [int(wrench.force[0]) for _, wrench in found] == [1, 3, 6, 2, 5, 0, 4]
    assert [topic for topic, _ in found] == ["b", "b", "a", "a", "b", "a", "a"]


def test_of_equal_stamps_the_last_to_be_recorded_counts_wherever_it_stands_in_the_file(tmp_path: Path) -> None:
    arrived = [(30, 3.0), (10, 1.0), (20, 2.0), (20, 2.5)]
    rows: list[Row] = [("/a", STAMPED, log, stamped(5, force)) for log, force in arrived]
    found = read_wrenches(write_rows(tmp_path / "a.mcap", [*rows, ("/a", STAMPED, 40, stamped(4, 0.0))]), ["a"])
    assert [wrench.force[0] for _, wrench in found] == [0.0, 1.0, 2.0, 2.5, 3.0]


@given(st.lists(st.integers(-3, 30).filter(bool), min_size=1, max_size=40))
@settings(max_examples=40)
def test_commands_are_put_in_order_without_being_kept(
    tmp_path_factory: pytest.TempPathFactory, stamps: list[int]
) -> None:
    rows: list[Row] = [(f"/{'ab'[i % 2]}", STAMPED, 100 + i, stamped(at, i)) for i, at in enumerate(stamps)]
    found = RecordedWrenches([write_rows(tmp_path_factory.mktemp("bag") / "a.mcap", rows)], ["a", "b"], end_ns=20)
    in_order = sorted(range(len(stamps)), key=stamps.__getitem__)
    for _ in range(2):
        assert [int(wrench.force[0]) for _, wrench in found] == in_order
    assert (len(found), found.first_ns, found.late) == (len(stamps), min(stamps), sum(at > 20 for at in stamps))


def test_a_wrench_without_header_takes_its_log_time(tmp_path: Path) -> None:
    data = cdr.encode(WRENCH, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    path = write_rows(tmp_path / "a.mcap", [("/push", WRENCH, 70, data), ("/push", WRENCH, 60, data)])
    first, second = read_wrenches(path, ["push"])
    assert first == ("push", Wrench((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), "", 60))
    assert second[1].stamp_ns == 70
    (told,) = RecordedWrenches([path], ["push"], 10, start="auto").notes
    assert "its commands are recorded at 0.00000006 to" in told


def test_a_damaged_command_is_named(tmp_path: Path) -> None:
    path = write_rows(tmp_path / "a.mcap", [("/w", STAMPED, 77, stamped(0, 1.0)[:40])])
    with pytest.raises(LogError, match=r"a\.mcap: topic /w, log time 77 ns: .* ends after 40 bytes"):
        read_wrenches(path, ["w"])


def recorded(path: Path, begin_ns: int, stamps: list[int], topic: str = "/wrench", latency_ns: int = 1_000_000) -> Path:
    """Write commands of 1 N at `stamps`, each recorded a little later, behind another message at `begin_ns`."""
    rows: list[Row] = [("/chatter", "std_msgs/msg/Float64", begin_ns, cdr.encode("std_msgs/msg/Float64", (0.0,)))]
    rows += [(topic, STAMPED, max(begin_ns, at + latency_ns), stamped(at, 1.0)) for at in stamps]
    return write_rows(path, rows)


@pytest.mark.parametrize(
    ("start", "expected", "noted"),
    [
        ("auto", [SECOND, 2 * SECOND], "time 0 is the start of the bag, 1700000000.123456789 s"),
        ("bag", [SECOND, 2 * SECOND], ""),
        ("first", [0, SECOND], ""),
        ("stamp", [WALL_NS + SECOND, WALL_NS + 2 * SECOND], ""),
        (WALL_NS + 7, [SECOND - 7, 2 * SECOND - 7], ""),
    ],
)
def test_what_is_time_0(tmp_path: Path, start: Start, expected: list[int], noted: str) -> None:
    bag = recorded(tmp_path / "a.mcap", WALL_NS, [WALL_NS + SECOND, WALL_NS + 2 * SECOND])
    found = RecordedWrenches([bag], ["wrench"], 10 * SECOND, start=start)
    assert [wrench.stamp_ns for _, wrench in found] == expected
    assert (found.first_ns, found.late) == (expected[0], 0 if start != "stamp" else 2)
    assert noted in "".join(found.notes)
    assert bool(found.notes) == bool(noted)
    offset = WALL_NS + SECOND - expected[0]
    assert found.facts == {"wrench_bags": "a.mcap", "wrench_start_ns": str(offset)}


@pytest.mark.parametrize("later_ns", [SECOND // 2, -SECOND // 2, 3600 * SECOND])
def test_log_times_of_another_clock_do_not_move_the_commands(tmp_path: Path, later_ns: int) -> None:
    """They were flown that much too early or late, and the motion was off by as much."""
    stamps = [WALL_NS + SECOND, WALL_NS + 2 * SECOND]
    rows: list[Row] = [("/other", STAMPED, WALL_NS + later_ns, stamped(WALL_NS, 1.0))]
    rows += [("/wrench", STAMPED, at + later_ns, stamped(at, 1.0)) for at in stamps]
    bag = write_rows(tmp_path / "a.mcap", rows)
    found = RecordedWrenches([bag], ["wrench"], 10 * SECOND, start="auto")
    assert [wrench.stamp_ns for _, wrench in found] == [SECOND, 2 * SECOND]
    assert f"s {'later' if later_ns > 0 else 'earlier'} than its stamps: the start of the bag" in found.notes[0]
    assert "is taken by the stamps" in found.notes[0]


def test_stamps_within_the_run_stand(tmp_path: Path) -> None:
    bag = recorded(tmp_path / "a.mcap", WALL_NS, [9 * SECOND, 11 * SECOND])
    found = RecordedWrenches([bag], ["wrench"], 10 * SECOND, start="auto")
    assert [wrench.stamp_ns for _, wrench in found] == [9 * SECOND, 11 * SECOND]
    assert (found.late, found.notes) == (1, [])


@pytest.mark.parametrize("by_ns", [-(10**18), -3_600_000_000_000, 3_600_000_000_000, 10**17])
@pytest.mark.parametrize("start", ["auto", "bag", "stamp"])
def test_one_stamped_far_from_when_it_was_recorded_moves_neither_time_0_nor_the_others(
    tmp_path: Path, by_ns: int, start: Start
) -> None:
    """From an early one, time 0 was its stamp, and all the others came after the end."""
    zero_ns = 0 if start == "stamp" else WALL_NS
    rows = [
        ("/wrench", STAMPED, WALL_NS + i * 100_000_000, stamped(zero_ns + i * 100_000_000 + (i == 7) * by_ns, 1.0 + i))
        for i in range(20)
    ]
    found = RecordedWrenches([write_rows(tmp_path / "a.mcap", rows)], ["wrench"], 10 * SECOND, start=start)
    times = [(wrench.stamp_ns, wrench.force[0]) for _, wrench in found]
    assert times == [(i * 100_000_000, 1.0 + i) for i in range(20)]
    assert "commands of /wrench is stamped far from when it was recorded, and acts then" in found.notes[0]


def test_a_command_stamped_before_it_was_recorded_is_the_start(tmp_path: Path) -> None:
    bag = write_rows(tmp_path / "a.mcap", [("/wrench", STAMPED, WALL_NS, stamped(WALL_NS - 2_000_000, 1.0))])
    assert [wrench.stamp_ns for _, wrench in RecordedWrenches([bag], ["wrench"], SECOND, start="auto")] == [0]


def test_commands_without_stamps_go_by_their_log_times(tmp_path: Path) -> None:
    rows: list[Row] = [("/wrench", STAMPED, WALL_NS + i * SECOND, stamped(0, 1.0)) for i in range(3)]
    bag = write_rows(tmp_path / "a.mcap", rows)
    found = RecordedWrenches([bag], ["wrench"], 10 * SECOND, start="auto")
    assert [wrench.stamp_ns for _, wrench in found] == [0, SECOND, 2 * SECOND]
    assert "have no stamps" in found.notes[0]
    by_stamps = RecordedWrenches([bag], ["wrench"], 10 * SECOND, start="stamp")
    assert [wrench.stamp_ns for _, wrench in by_stamps] == [0, 0, 0]
    assert "so all of them (3) act at time 0; --wrench-start bag" in by_stamps.notes[0]
    assert [wrench.stamp_ns for _, wrench in RecordedWrenches([bag], ["wrench"], start="stamp")] == [0, 0, 0]


def test_a_stamp_that_nobody_set_does_not_say_that_the_others_lie_within_the_run(tmp_path: Path) -> None:
    """Four of the five were after the end by it; the node lets it act when it comes."""
    rows: list[Row] = [
        ("/wrench", STAMPED, WALL_NS + i * SECOND + 7, stamped(0 if i == 2 else WALL_NS + i * SECOND, 1.0 + i))
        for i in range(5)
    ]
    found = RecordedWrenches([write_rows(tmp_path / "a.mcap", rows)], ["wrench"], 10 * SECOND, start="auto")
    times = [(wrench.stamp_ns, wrench.force[0]) for _, wrench in found]
    assert times == [(0, 1.0), (SECOND, 2.0), (2 * SECOND, 3.0), (3 * SECOND, 4.0), (4 * SECOND, 5.0)]
    assert "some of its commands have no stamps" in found.notes[0]
    # Where the clock begins at 0, that is a stamp like any other.
    rows = [("/wrench", STAMPED, i * SECOND, stamped(i * SECOND, 1.0)) for i in range(3)]
    of_a_run = RecordedWrenches([write_rows(tmp_path / "b.mcap", rows)], ["wrench"], 10 * SECOND, start="auto")
    assert ([wrench.stamp_ns for _, wrench in of_a_run], of_a_run.notes) == ([0, SECOND, 2 * SECOND], [])


def test_of_a_recording_of_two_runs_one_can_be_cut_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A simulation that was started anew while it was recorded: a flight of both was made with a note alone."""
    stamps = [k * SECOND // 2 for k in (*range(8), *range(1, 9))]
    rows: list[Row] = [("/wrench", STAMPED, k * SECOND, stamped(at, 1.0)) for k, at in enumerate(stamps)]
    bag = write_rows(tmp_path / "a.mcap", rows)
    with pytest.raises(LogError, match=r"begin again, 0.5 s after 3.5 s.*--to 7.999999, or --from 8.000000$"):
        RecordedWrenches([bag], ["wrench"], 10 * SECOND, start="auto")
    for cut, times in ((["--to", "7.999999"], stamps[:8]), (["--from", "8.000000"], stamps[8:])):
        assert main(["convert", str(bag), str(tmp_path / "part.mcap"), *cut]) == 0
        found = RecordedWrenches([tmp_path / "part.mcap"], ["wrench"], 10 * SECOND, start="auto")
        assert ([wrench.stamp_ns for _, wrench in found], found.notes) == (times, [])
    (failed,) = (check for check in inspect(bag).summary.checks if not check.passed)
    assert failed.name == "/wrench is one stream"
    assert "stamps begin again after t = 3.5 s at 0.5 s: two runs in one file" in failed.detail
    # Messages on the way for different times, and two topics, one written behind the other, are one run.
    late = [0, 2, 1, 4, 3, 6, 5]
    rows = [("/wrench", STAMPED, k, stamped(at * SECOND // 2, 1.0)) for k, at in enumerate(late)]
    rows += [("/other", STAMPED, k, stamped(k * SECOND // 2, 1.0)) for k in range(7)]
    bag = write_rows(tmp_path / "b.mcap", rows)
    assert not RecordedWrenches([bag], ["wrench", "other"], 10 * SECOND, start="stamp").notes
    rows = [("/wrench", STAMPED, k, stamped(at * SECOND, 1.0)) for k, at in enumerate((0, 1, 7, 2, 3, 4))]
    (told,) = RecordedWrenches([write_rows(tmp_path / "c.mcap", rows)], ["wrench"], 10 * SECOND).notes
    assert "the stamps of its commands go back by 5 s" in told


def test_a_leading_slash_of_a_frame_in_a_bag_means_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A habit of ROS 1: these commands were rejected."""
    (tmp_path / "a.yaml").write_text(
        "body: {mass: 2, inertia: {diagonal: [1, 1, 1]}, frames: {hull: {position: [0, 1, 0]}}}\n"
        "wrenches: [{topic: wrench}]\nduration: 4\n"
    )
    ends, log = [], tmp_path / "log.mcap"
    for slash in ("", "/"):
        frames = [f"{slash}body", "body", f"{slash}world", f"{slash}hull"]
        rows: list[Row] = [
            ("/wrench", STAMPED, k * SECOND, stamped(k * SECOND, 1.0, frame)) for k, frame in enumerate(frames)
        ]
        bag = write_rows(tmp_path / f"bag{len(slash)}.mcap", rows)
        arguments = ["simulate", str(tmp_path / "a.yaml"), "--wrench", str(bag), "--mcap", str(log), "--json"]
        assert main(arguments) == 0
        ends.append({**json.loads(capsys.readouterr().out), "wall_time_s": 0})
        assert main(["replay", str(log)]) == 0
        assert capsys.readouterr().out.endswith("the same to the last bit\n")
        assert inspect(log).passed
    assert ends[0] == ends[1]
    assert ends[0]["linear_momentum_world"][0] > 3.0


def test_a_command_whose_timeout_ends_before_the_run_does_not_act(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stamp far before the bag acted at time 0 in a run, and had expired in `inspect`."""
    text = (
        "body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}\n"
        "wrenches: [{topic: wrench, timeout: 0.5, delay: 0.25}]\nduration: 3\n"
    )
    (tmp_path / "a.yaml").write_text(text)
    ends = {}
    for begin_s in (-1.0, -0.5):
        rows: list[Row] = [
            ("/wrench", STAMPED, int((10 + at) * SECOND), stamped(int((10 + at) * SECOND), 1.0)) for at in (begin_s, 2)
        ]
        bag = write_rows(tmp_path / f"{begin_s}.mcap", rows)
        arguments = ["simulate", str(tmp_path / "a.yaml"), "--wrench", str(bag), "--wrench-start", "10", "--json"]
        assert main(arguments) == 0
        captured = capsys.readouterr()
        ends[begin_s] = json.loads(captured.out)["linear_momentum_world"][0], captured.err
    assert ends[-1.0][0] == pytest.approx(0.5)
    assert "wrench: 1 commands before time 0 never act, as their timeout ends before it" in ends[-1.0][1]
    assert ends[-0.5][0] == pytest.approx(1.0)
    assert "wrench: the last command before time 0 acts for the whole timeout from there on" in ends[-0.5][1]


@pytest.mark.parametrize("behind", ["delay: 0.25", "lag: 0.25"])
def test_delay_and_lag_of_a_command_before_time_0_begin_there_and_it_is_said(
    behind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A channel gave nothing until its delay had passed, without a word, whatever had been commanded before."""
    (tmp_path / "a.yaml").write_text(
        f"body: {{mass: 1}}\nwrenches: [{{topic: wrench, {behind}}}, {{topic: prompt}}]\nduration: 3\n"
    )
    rows: list[Row] = [
        (topic, STAMPED, 10 * SECOND + at * 10**8, stamped(10 * SECOND + at * 10**8, 1.0))
        for at in (-10, -1, 0, 20)
        for topic in ("/wrench", "/prompt")
    ]
    arguments = ["simulate", str(tmp_path / "a.yaml"), "--wrench", str(write_rows(tmp_path / "a.mcap", rows))]
    assert main([*arguments, "--wrench-start", "10"]) == 0
    assert "wrench: commands before time 0 count as received then, so delay and lag begin" in capsys.readouterr().err
    assert main([*arguments, "--wrench-start", "first"]) == 0
    assert "before time 0" not in capsys.readouterr().err


def test_of_a_log_commands_act_as_they_did_and_not_by_their_stamps(tmp_path: Path) -> None:
    """They were said to be mixed, in the order of their stamps."""
    scene = parse_scene("body: {mass: 1}\nwrenches: [{topic: wrench}]\nduration: 5\n")
    log = tmp_path / "a.mcap"
    run = Simulation(scene, [McapSink(log)])
    run.start()
    for at, stamp_ns in ((1, 40), (2, 10), (3, 20)):
        run.advance(at * SECOND)
        run.post("wrench", Wrench(force=(1.0, 0.0, 0.0), stamp_ns=stamp_ns * SECOND), at * SECOND)
    run.advance(5 * SECOND)
    run.finish()
    part, again = tmp_path / "part.mcap", tmp_path / "again.mcap"
    assert main(["convert", str(log), str(part), "--to", "4"]) == 0
    assert main(["convert", str(part), str(again), "--to", "3.5"]) == 0
    for path in (log, part, again):
        found = RecordedWrenches([path], ["wrench"], 5 * SECOND, start="auto")
        assert ([wrench.stamp_ns for _, wrench in found], found.notes) == ([SECOND, 2 * SECOND, 3 * SECOND], [])


def test_commands_of_two_clocks_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Those without stamps go by the clock of the recorder, and half were said to come after the end, not why."""
    rows: list[Row] = [("/a", STAMPED, WALL_NS + k * SECOND, stamped(k * SECOND, 1.0)) for k in (1, 2, 3)]
    plain = cdr.encode(WRENCH, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    bare: list[Row] = [("/b", WRENCH, WALL_NS + k * SECOND, plain) for k in range(3)]
    scene = parse_scene("body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}\nduration: 10\n")
    found = RecordedWrenches([write_rows(tmp_path / "a.mcap", rows + bare)], ["a", "b"], 10 * SECOND, start="auto")
    assert (found.late, found.two_clocks) == (3, True)
    warn_outside(found, scene)
    assert "their times are of another clock than those of the others" in capsys.readouterr().err
    longer = [*rows, ("/a", STAMPED, WALL_NS + 60 * SECOND, stamped(60 * SECOND, 1.0))]
    found = RecordedWrenches([write_rows(tmp_path / "b.mcap", longer)], ["a"], 10 * SECOND, start="auto")
    assert (found.late, found.two_clocks) == (1, False)


def test_commands_that_nothing_takes_are_named(tmp_path: Path) -> None:
    """Beside others that act, they vanished without a word: too late, of another topic, or of another type."""
    number = ("std_msgs/msg/Float64", "std_msgs/msg/Float32")
    rows: list[Row] = [("/wrench", STAMPED, k * SECOND, stamped(k * SECOND, 1.0)) for k in range(3)]
    rows += [("/wheel/command", number[0], k * SECOND, cdr.encode(number[0], (0.1,))) for k in (1, 20, 21)]
    rows += [("/thrust", STAMPED, SECOND, stamped(SECOND, 1.0))]
    rows += [("/rod/command", number[1], SECOND, b"\0\1\0\0" + b"\0\0\0\0")]
    bag, actuators = write_rows(tmp_path / "a.mcap", rows), [replace(WHEEL, name=name) for name in ("wheel", "rod")]
    found = RecordedWrenches([bag], ["wrench"], 10 * SECOND, actuators=actuators)
    assert "takes /rod/command (Float32), /thrust (WrenchStamped)" in found.notes[0]
    assert "2 of 3 commands to actuators lie after the end of the run at 10 s" in found.notes[1]
    found.require_some()
    late = write_rows(tmp_path / "b.mcap", [row for row in rows if row[0].endswith("/command")][1:])
    with pytest.raises(LogError, match="none of its 2 commands to actuators acts: the run goes from 0 to 10 s"):
        RecordedWrenches([late], ["wrench"], 10 * SECOND, actuators=actuators).require_some()
    other = write_rows(tmp_path / "c.mcap", [row for row in rows if row[0] == "/rod/command"])
    with pytest.raises(LogError, match=r"/rod/command \(Float32\) is of another type than its commands, Float64"):
        RecordedWrenches([other], ["wrench"], 10 * SECOND, actuators=actuators)


def test_several_bags_are_of_one_time_and_in_one_order(tmp_path: Path) -> None:
    one = recorded(tmp_path / "one.mcap", WALL_NS, [WALL_NS, WALL_NS + 2 * SECOND])
    two = recorded(tmp_path / "two.mcap", WALL_NS + SECOND, [WALL_NS + SECOND, WALL_NS + 2 * SECOND], "/push")
    found = RecordedWrenches([one, two], ["push", "wrench"], 10 * SECOND, start="auto")
    expected = [("wrench", 0), ("push", SECOND), ("wrench", 2 * SECOND), ("push", 2 * SECOND)]
    assert [(topic, wrench.stamp_ns) for topic, wrench in found] == expected
    assert len(found) == 4
    assert found.facts["wrench_start_ns"] == f"{WALL_NS}, {WALL_NS}"
    # One that was recorded in the time of a run stands as it is.
    three = recorded(tmp_path / "three.mcap", 0, [5])
    found = RecordedWrenches([one, three], ["wrench"], 10 * SECOND, start="auto")
    assert [wrench.stamp_ns for _, wrench in found] == [0, 5, 2 * SECOND]
    assert found.facts["wrench_start_ns"] == f"{WALL_NS}, 0"


def test_a_later_part_of_a_recording_is_not_flown_over_the_earlier_one(tmp_path: Path) -> None:
    one = recorded(tmp_path / "one.mcap", 0, [0, 9 * SECOND])
    two = recorded(tmp_path / "two.mcap", 10 * SECOND, [10 * SECOND, 19 * SECOND])
    found = RecordedWrenches([one, two], ["wrench"], 8 * SECOND, start="auto")
    assert [wrench.stamp_ns for _, wrench in found] == [0, 9 * SECOND, 10 * SECOND, 19 * SECOND]
    assert (found.late, found.notes, found.facts["wrench_start_ns"]) == (3, [], "0, 0")
    with pytest.raises(LogError, match=r"two\.mcap: none of its 2 wrench commands acts: they lie at 10 to 19 s"):
        found.require_some()


def test_a_mapped_topic_may_be_in_any_of_the_bags(tmp_path: Path) -> None:
    one, two = recorded(tmp_path / "one.mcap", 0, [1], "/cmd"), recorded(tmp_path / "two.mcap", 0, [2], "/push")
    found = RecordedWrenches([one, two], ["wrench", "push"], mapping={"/cmd": "wrench"})
    assert [topic for topic, _ in found] == ["wrench", "push"]
    with pytest.raises(LogError, match=r"two.mcap has no channel of the scene"):
        RecordedWrenches([one, two], ["wrench"], mapping={"/cmd": "wrench"})


@pytest.mark.parametrize(
    ("stamped_ns", "log_ns", "start", "expected"),
    [
        (SECOND, 0, "auto", 2 * SECOND),  # one clock, that of the run
        (WALL_NS + SECOND, WALL_NS, WALL_NS, 2 * SECOND),
        (WALL_NS + SECOND, 5 * WALL_NS, WALL_NS, 2 * SECOND),  # log times of another clock
        (WALL_NS + SECOND, 5 * WALL_NS, "auto", SECOND),
    ],
)
def test_commands_to_actuators_act_when_they_were_recorded_by_the_clock_of_the_stamps(
    tmp_path: Path, stamped_ns: int, log_ns: int, start: Start, expected: int
) -> None:
    rows: list[Row] = [
        ("/wrench", STAMPED, log_ns + SECOND, stamped(stamped_ns, 1.0)),
        ("/wheel", "std_msgs/msg/Float64", log_ns + 2 * SECOND, cdr.encode("std_msgs/msg/Float64", (0.5,))),
    ]
    path = write_rows(tmp_path / "bag.mcap", rows)
    found = RecordedWrenches([path], ["wrench"], 9 * SECOND, {"/wheel": "w/command"}, start, actuators=[WHEEL])
    assert [(topic, point.value, point.stamp_ns) for topic, point in found.setpoints] == [("w/command", 0.5, expected)]


@pytest.mark.parametrize(
    ("start_s", "command", "minimum_on", "expected"),
    [
        (3, "on_time", 0.0, [5.0]),
        (3, "on_time", 6.0, [0.0]),  # a pulse that short is none
        (3, "level", 0.0, [7.0]),
        (9, "on_time", 0.0, [0.0]),
        (1, "on_time", 0.0, [7.0]),
    ],
)
def test_of_a_pulse_from_before_the_run_the_rest_acts(
    tmp_path: Path, start_s: int, command: str, minimum_on: float, expected: list[float]
) -> None:
    """It began anew at time 0, with its whole on-time."""
    row = ("/jet/command", SCALAR, SECOND, cdr.encode(SCALAR, (7.0,)))
    bag = write_rows(tmp_path / "bag.mcap", [("/x", SCALAR, 0, cdr.encode(SCALAR, (0.0,))), row])
    jet = Thruster(name="jet", frame="jet", force=1.0, command=command, minimum_on=minimum_on)
    found = RecordedWrenches([bag], [], 20 * SECOND, start=start_s * SECOND, actuators=[jet])
    assert [point.value for _, point in found.setpoints] == expected


def levels(path: Path, log_ns: Sequence[int]) -> Path:
    """Write a bag of commands to an actuator alone."""
    return write_rows(path, [("/w/command", "std_msgs/msg/Float64", at, cdr.encode(SCALAR, (0.5,))) for at in log_ns])


@pytest.mark.parametrize(
    ("wrenches", "log_ns", "start", "expected"),
    [
        # Alone: by their log times, which are their only times.
        (None, 5 * SECOND, "auto", 5 * SECOND),
        (None, 5 * SECOND, "stamp", 5 * SECOND),
        (None, 5 * SECOND, 0, 5 * SECOND),
        (None, 5 * SECOND, 2 * SECOND, 3 * SECOND),
        (None, 5 * SECOND, "first", 0),
        (None, WALL_NS, "auto", 0),
        # Beside a bag of the same time, of a later start, and of stamps that are of another clock than the log times.
        ((SECOND, SECOND), 5 * SECOND, "auto", 5 * SECOND),
        ((WALL_NS, WALL_NS), WALL_NS + 5 * SECOND, "auto", 5 * SECOND),
        ((WALL_NS, WALL_NS), WALL_NS + 5 * SECOND, "bag", 5 * SECOND),
        ((WALL_NS, WALL_NS), WALL_NS + 5 * SECOND, "first", 5 * SECOND),
        ((SECOND, WALL_NS), WALL_NS + 5 * SECOND, "auto", 6 * SECOND),
        ((SECOND, WALL_NS), WALL_NS + 5 * SECOND, "stamp", 6 * SECOND),
        ((SECOND, WALL_NS), 5 * SECOND, "auto", 5 * SECOND),
    ],
)
def test_commands_to_actuators_of_a_bag_of_their_own_are_of_one_time_with_the_others(
    tmp_path: Path, wrenches: tuple[int, int] | None, log_ns: int, start: Start, expected: int
) -> None:
    """They began with their own bag: those of t = 1.5 s acted at 0."""
    bags = [levels(tmp_path / "levels.mcap", [log_ns])]
    if wrenches is not None:
        row = ("/wrench", STAMPED, wrenches[1], stamped(wrenches[0], 1.0))
        bags.append(write_rows(tmp_path / "wrenches.mcap", [row]))
    found = RecordedWrenches(bags, ["wrench"], 20 * SECOND, start=start, actuators=[WHEEL])
    assert [point.stamp_ns for _, point in found.setpoints] == [expected]


@pytest.mark.parametrize("start", ["auto", "stamp", "first"])
def test_commands_to_actuators_are_on_the_clock_of_the_bag_that_was_recorded_with_them(
    tmp_path: Path, start: Start
) -> None:
    """Two recordings in the time of one simulation, with a pause between them: those of the second came too late."""
    pause_ns, bags = 600 * SECOND, []
    for k, (sim_ns, log_ns) in enumerate([(0, WALL_NS), (20 * SECOND, WALL_NS + 20 * SECOND + pause_ns)]):
        rows: list[Row] = [
            ("/wrench", STAMPED, log_ns + at * SECOND, stamped(sim_ns + at * SECOND, 1.0)) for at in range(10)
        ]
        bags.append(write_rows(tmp_path / f"wrenches{k}.mcap", rows))
        bags.append(levels(tmp_path / f"levels{k}.mcap", [log_ns + 2 * SECOND]))
    for these in (bags, bags[::-1]):
        found = RecordedWrenches(these, ["wrench"], 1000 * SECOND, start=start, actuators=[WHEEL])
        assert sorted(point.stamp_ns for _, point in found.setpoints) == [2 * SECOND, 22 * SECOND]


def test_commands_to_actuators_alone_are_on_the_clock_of_the_motion_beside_them(tmp_path: Path) -> None:
    pose = cdr.encode(POSE, 3 * SECOND, "world", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    level = cdr.encode(SCALAR, (0.5,))
    rows: list[Row] = [("/pose", POSE, WALL_NS, pose), ("/w/command", SCALAR, WALL_NS + SECOND, level)]
    bag = write_rows(tmp_path / "bag.mcap", rows)
    found = RecordedWrenches([bag], [], 20 * SECOND, start="auto", actuators=[WHEEL])
    assert [point.stamp_ns for _, point in found.setpoints] == [4 * SECOND]


def poses(stamps: Sequence[int], log_ns: Callable[[int], int]) -> list[Row]:
    still = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    return [("/pose", POSE, log_ns(at), cdr.encode(POSE, at, "world", still)) for at in stamps]


# With start "stamp" a stamp of 0 is one.
@pytest.mark.parametrize(
    ("kind", "start"),
    [*itertools.product([SCALAR, WRENCH], ["auto", "stamp", "bag", 0]), (STAMPED, "auto"), (STAMPED, "bag")],
)
def test_commands_without_stamps_follow_a_clock_of_another_rate(tmp_path: Path, kind: str, start: Start) -> None:
    """Of a simulation at half of real time, half of the commands lay after its end, without a word."""
    at = [k * SECOND // 2 for k in range(40)]
    data = {SCALAR: cdr.encode(SCALAR, (0.5,)), WRENCH: cdr.encode(WRENCH, (1.0,) * 6), STAMPED: stamped(0, 1.0)}[kind]
    topic = "/w/command" if kind == SCALAR else "/wrench"

    def bag(logged: Callable[[int], int], rate: int = 10) -> RecordedWrenches:
        rows = [*poses(range(0, 20 * SECOND, SECOND // rate), logged), *((topic, kind, logged(k), data) for k in at)]
        path = write_rows(tmp_path / "a.mcap", sorted(rows, key=lambda row: row[2]))
        return RecordedWrenches([path], ["wrench"], 20 * SECOND, start=start, actuators=[WHEEL])

    found = bag(lambda at: WALL_NS + 2 * at)
    assert [each.stamp_ns for _, each in (*found, *found.setpoints)] == at
    assert "run 2 times as fast as the stamps of the motion" in found.notes[-1]
    with pytest.raises(LogError, match=r"of another clock than the stamps and leave a line .* by \d.*--use-sim-time"):
        bag(lambda at: WALL_NS + at + 5 * SECOND * (at > 10 * SECOND))
    queued = bag(lambda at: WALL_NS + 2 * at + 60_000_000 * (at % (5 * SECOND) > 2 * SECOND), 100)
    assert "2 times as fast" in queued.notes[-1]
    assert "by 0.03 s, as in queues: commands without stamps may have acted up to that much earlier" in queued.notes[-1]
    late = bag(lambda at: WALL_NS + at + SECOND // 20 * 3 * (at > 19.3 * SECOND))
    assert "by 0.15 s within a second of the first or the last of these" in late.notes[-1]
    # Within one clock that is only told.
    within = bag(lambda at: at + 5 * SECOND * (at > 10 * SECOND))
    assert sum("act at their log times all the same" in note for note in within.notes) == 1


def test_a_motion_in_bursts_does_not_move_commands_to_actuators(tmp_path: Path) -> None:
    """They acted up to a burst early: the first message of one was taken for the clock."""
    stamps = range(WALL_NS, WALL_NS + 20 * SECOND, SECOND // 10)
    rows = poses(stamps, lambda at: WALL_NS + -(-(at - WALL_NS + 1) // (2 * SECOND)) * 2 * SECOND)
    rows += [("/w/command", SCALAR, WALL_NS + at * SECOND, cdr.encode(SCALAR, (0.5,))) for at in range(1, 20, 3)]
    bag = write_rows(tmp_path / "a.mcap", sorted(rows, key=lambda row: row[2]))
    found = RecordedWrenches([bag], [], 20 * SECOND, start=WALL_NS, actuators=[WHEEL])
    assert [each.stamp_ns for _, each in found.setpoints] == [at * SECOND for at in range(1, 20, 3)]


def test_commands_in_bursts_leave_the_start_to_the_steady_motion_beside_them(tmp_path: Path) -> None:
    """The last of a burst is late, too: time 0 was 0.2 s before the bag."""
    begin_ns = 50_000 * SECOND
    rows = poses(range(begin_ns, begin_ns + 20 * SECOND, SECOND // 20), lambda at: at - begin_ns + WALL_NS)
    stamps = [begin_ns + 300_000_000 + k * SECOND // 4 for k in range(79)]
    rows += [
        ("/wrench", STAMPED, WALL_NS + -(-(at - begin_ns) // (2 * SECOND)) * 2 * SECOND, stamped(at, 1.0))
        for at in stamps
    ]
    bag = write_rows(tmp_path / "a.mcap", sorted(rows, key=lambda row: row[2]))
    found = RecordedWrenches([bag], ["wrench"], 20 * SECOND, start="auto")
    assert found.facts["wrench_start_ns"] == str(begin_ns)
    assert [wrench.stamp_ns for _, wrench in found] == [at - begin_ns for at in stamps]


def test_commands_of_one_stamp_are_counted(tmp_path: Path) -> None:
    """78 of 79 never acted, and a link that stalls was blamed."""
    rows = poses(range(WALL_NS, WALL_NS + 20 * SECOND, SECOND // 20), lambda at: at)
    rows += [("/wrench", STAMPED, WALL_NS + k * SECOND // 4, stamped(WALL_NS, 1.0)) for k in range(1, 79)]
    bag = write_rows(tmp_path / "a.mcap", sorted(rows, key=lambda row: row[2]))
    told = RecordedWrenches([bag], ["wrench"], 20 * SECOND, start="auto").notes
    assert "77 of its 78 commands have the stamp of an earlier one" in told[-1]
    assert not any("stalls" in note for note in told)


def test_late_copies_of_a_latched_command_are_all_counted(tmp_path: Path) -> None:
    """The first copy behind another command was not, nor one at the start of the next file."""

    def rows(*stamps: int) -> list[Row]:
        return [("/wrench", STAMPED, 40 + k, stamped(at, 1.0)) for k, at in enumerate(stamps)]

    def told(path: Path) -> list[str]:
        notes = RecordedWrenches([path], ["wrench"], SECOND).notes
        return [note.removeprefix(f"{path}: ") for note in notes]

    again = "commands have the stamp of an earlier one on their channel: of commands of one stamp only the last acts"
    assert told(write_rows(tmp_path / "a.mcap", rows(10, 20, 30, 10, 10))) == [f"2 of its 5 {again}"]
    (tmp_path / "split").mkdir()
    write_rows(tmp_path / "split" / "split_0.mcap", rows(10, 20))
    write_rows(tmp_path / "split" / "split_1.mcap", rows(0, 0, 20, 30)[2:])
    assert told(tmp_path / "split") == [f"1 of its 4 {again}"]
    assert told(write_rows(tmp_path / "late.mcap", rows(20, 10, 30))) == []


def test_commands_of_one_time_from_several_topics_or_bags_are_counted(tmp_path: Path) -> None:
    """Only those of one topic of one bag were."""

    def rows(topic: str, *seconds: int) -> list[Row]:
        return [(topic, STAMPED, at * SECOND, stamped(at * SECOND, 1.0)) for at in seconds]

    def told(*paths: Path, **mapped: str) -> list[str]:
        mapping = {f"/{topic}/wrench": channel for topic, channel in mapped.items()}
        return RecordedWrenches(paths, ["wrench", "other"], 9 * SECOND, mapping=mapping, start="auto").notes

    one = write_rows(tmp_path / "one.mcap", rows("/wrench", 0, 1, 2))
    two = write_rows(tmp_path / "two.mcap", rows("/wrench", 1, 2, 3))
    both = write_rows(tmp_path / "both.mcap", rows("/a/wrench", 0, 1, 1) + rows("/b/wrench", 1, 2))
    many = "commands come at the time of another one on their channel, from another topic or bag: of commands of one"
    assert told(one, two) == [f"2 {many} time only the last acts"]
    assert told(one) == told(both, a="wrench", b="other")[1:] == []
    (told_of_bag,) = told(both, a="wrench", b="wrench")
    assert told_of_bag.startswith(f"{both}: 2 of its 5 commands have the stamp of an earlier one")
    apart = write_rows(tmp_path / "apart.mcap", rows("/a/wrench", 0, 1) + rows("/b/wrench", 1, 2))
    assert told(apart, a="wrench", b="wrench") == [f"1 {many} time only the last acts"]


@pytest.mark.parametrize("kind", [SCALAR, WRENCH])
@pytest.mark.parametrize("every", [1, 20])
def test_commands_without_stamps_that_come_in_bursts_are_named(tmp_path: Path, kind: str, every: int) -> None:
    """20 at once each second, of a link that stalls, beside a motion that comes steadily."""
    rows = poses(range(WALL_NS, WALL_NS + 20 * SECOND, SECOND // 20), lambda at: at)
    topic, data = "/w/command", cdr.encode(SCALAR, (0.5,))
    if kind == WRENCH:
        topic, data = "/wrench", cdr.encode(WRENCH, (1.0,) * 6)
    rows += [(topic, kind, WALL_NS + -(-k // every) * every * SECOND // 20 + k, data) for k in range(1, 400)]
    bag = write_rows(tmp_path / "a.mcap", sorted(rows, key=lambda row: row[2]))
    told = RecordedWrenches([bag], ["wrench"], 20 * SECOND, start="auto", actuators=[WHEEL]).notes
    words = f"{topic} has no stamps and was recorded in bursts, up to 1 s apart"
    assert any(words in note for note in told) == (every > 1)
    if kind == WRENCH:
        assert (words in read_track(read_bag(bag)).doubt) == (every > 1)


def test_commands_to_actuators_that_the_scene_does_not_have_are_named(tmp_path: Path) -> None:
    """A log of a node in a namespace, whose wrenches alone were mapped, flew without its wheels and said nothing."""
    value = cdr.encode("std_msgs/msg/Float64", (0.5,))
    rows: list[Row] = [
        ("/sat/wrench", STAMPED, SECOND, stamped(SECOND, 1.0)),
        ("/sat/w/command", "std_msgs/msg/Float64", 2 * SECOND, value),
        ("/other/w/command", "std_msgs/msg/Float64", 2 * SECOND, value),
        ("/sat/energy", "std_msgs/msg/Float64", 2 * SECOND, value),
    ]
    path = write_rows(tmp_path / "bag.mcap", rows)
    mapping = {"/sat/wrench": "wrench"}
    found = RecordedWrenches([path], ["wrench"], 9 * SECOND, mapping, actuators=[WHEEL])
    assert found.setpoints == []
    remedy = "no actuator of the scene (w/command); map with --topic TOPIC=ACTUATOR/command"
    assert [note for note in found.notes if "actuator" in note] == [
        f"{path}: /other/w/command, /sat/w/command command {remedy}",
    ]
    both = RecordedWrenches(
        [path], ["wrench"], 9 * SECOND, {**mapping, "/sat/w/command": "w/command"}, actuators=[WHEEL]
    )
    assert len(both.setpoints) == 1
    assert [note for note in both.notes if "actuator" in note] == [
        f"{path}: /other/w/command commands {remedy}",
    ]


@pytest.mark.parametrize("actuators", ["[]", "[{type: reaction_wheel, name: w, axis: [0, 0, 1], inertia: 0.01}]"])
def test_commands_to_actuators_that_the_scene_does_not_have_are_rejected_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], actuators: str
) -> None:
    """By simulate and explain, of a bag, and in the log; not those that are mapped away from an actuator."""
    value = cdr.encode(SCALAR, (1e-3,))
    rows: list[Row] = [("/wrench", STAMPED, SECOND, stamped(SECOND, 1.0)), ("/w/speed", SCALAR, 2 * SECOND, value)]
    rows += (("/q/command", SCALAR, k * SECOND, value) for k in range(1, 6))
    bag, scene, log = write_rows(tmp_path / "bag.mcap", rows), tmp_path / "scene.yaml", tmp_path / "log.mcap"
    scene.write_text(
        "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\ninitial: {angular_velocity_body: [0, 0, 1]}\n"
        f"wrenches: [{{topic: wrench}}]\nactuators: {actuators}\nduration: 6\n"
    )
    assert main(["simulate", str(scene), "--wrench", str(bag), "--mcap", str(log)]) == 0
    told = "5 of 6 commands were rejected and had no effect; the first: /q/command at simulation time 1.000000000 s: "
    assert told in capsys.readouterr().err
    (diagnostics,) = read_bag(log).topics["/diagnostics"].decoded()
    assert "5 commands were rejected and had no effect; the first: /q/command" in str(diagnostics)
    assert main(["explain", str(scene), "--wrench", str(bag)]) == 0
    said = capsys.readouterr().out
    assert "note: 5 of 6 commands were rejected; the first: /q/command" in said
    assert "from one command to the next" not in said, "slower than the body turns, but nothing is to follow them"
    mapped = RecordedWrenches(
        [bag], ["wrench"], 9 * SECOND, {"/w/speed": "q/command"}, actuators=[replace(WHEEL, name="q")]
    )
    assert len(mapped) == 2
    assert mapped.to_absent == {}


@pytest.mark.parametrize("topic", ["/jet/command", "/w"])
def test_a_bag_whose_only_commands_fit_no_actuator_is_refused_by_their_name(tmp_path: Path, topic: str) -> None:
    bag = write_rows(tmp_path / "bag.mcap", [(topic, SCALAR, SECOND, cdr.encode(SCALAR, (0.5,)))])
    told = rf"{topic} commands no actuator of the scene \(w/command\); map with --topic TOPIC=ACTUATOR/command"
    with pytest.raises(LogError, match=told):
        RecordedWrenches([bag], [], 9 * SECOND, actuators=[WHEEL])
    found = RecordedWrenches([bag], [], 9 * SECOND, {topic: "w/command"}, actuators=[WHEEL])
    assert len(found.setpoints) == 1


def test_a_bag_of_a_namespace_drives_the_channel_and_the_actuator_that_alone_fit(tmp_path: Path) -> None:
    rows: list[Row] = [
        ("/sat/wrench", STAMPED, SECOND, stamped(SECOND, 1.0)),
        ("/sat/w/command", SCALAR, 2 * SECOND, cdr.encode(SCALAR, (0.5,))),
    ]
    path = write_rows(tmp_path / "bag.mcap", rows)
    found = RecordedWrenches([path], ["wrench"], 9 * SECOND, start="auto", actuators=[WHEEL])
    assert [topic for topic, _ in (*found, *found.setpoints)] == ["wrench", "w/command"]
    assert found.notes == [
        "/sat/wrench is taken for wrench of the scene",
        "/sat/w/command is taken for w/command of the scene",
    ]
    assert found.facts["wrench_topics"] == "/sat/wrench=wrench, /sat/w/command=w/command"
    rows.insert(0, ("/other/wrench", STAMPED, SECOND, stamped(SECOND, 1.0)))
    with pytest.raises(LogError, match="map the topic with --topic"):
        RecordedWrenches([write_rows(tmp_path / "two.mcap", rows)], ["wrench"], 9 * SECOND)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: wrench}, {topic: push}]\nduration: 4\n"
    )
    return path


def test_a_bag_by_the_clock_on_the_wall_flies_and_its_log_says_how(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = recorded(tmp_path / "one.mcap", WALL_NS, [WALL_NS + SECOND])
    two = recorded(tmp_path / "two.mcap", WALL_NS, [WALL_NS + 2 * SECOND], "/push")
    log = tmp_path / "run.mcap"
    bags = ["--wrench", str(one), "--wrench", str(two)]
    assert main(["simulate", str(scene), *bags, "--mcap", str(log), "--json"]) == 0
    said = capsys.readouterr()
    # 1 N on 2 kg for 3 s, and another for 2 s.
    assert json.loads(said.out)["linear_velocity_world"][0] == pytest.approx(2.5, rel=1e-12)
    assert "time 0 is the start of the bag" in said.err
    facts = read_bag(log).metadata["rb_dynamics"]
    assert (facts["wrench_bags"], facts["wrench_start_ns"]) == ("one.mcap, two.mcap", f"{WALL_NS}, {WALL_NS}")
    assert main(["replay", str(log)]) == 0
    # The log of that run flies again without a start of its own.
    capsys.readouterr()
    assert main(["simulate", str(scene), "--wrench", str(log), "--json"]) == 0
    again = capsys.readouterr()
    assert json.loads(again.out)["linear_velocity_world"] == json.loads(said.out)["linear_velocity_world"]
    assert again.err == ""


def test_a_log_is_flown_by_when_its_commands_took_effect(scene: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    bag = recorded(tmp_path / "one.mcap", WALL_NS, [WALL_NS + SECOND])
    assert main(["simulate", str(scene), "--wrench", str(bag), "--wrench-start", "first", "--mcap", str(log)]) == 0
    found = RecordedWrenches([log], ["wrench", "push"], 4 * SECOND, start="auto")
    assert [wrench.stamp_ns for _, wrench in found] == [0]


@pytest.mark.parametrize("duration", ["", "duration: 2\n"])
def test_the_accuracy_of_a_log_without_a_duration_is_said_to_be_another(
    duration: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The page promised its bits."""
    log = tmp_path / "run.mcap"
    run = Simulation(parse_scene(f"body: {{mass: 2, inertia: {{diagonal: [1, 2, 3]}}}}\n{duration}"), [McapSink(log)])
    run.start()
    run.advance(2 * SECOND)
    run.finish()
    assert main(["simulate", str(log)]) == 0
    told = "whose accuracy was for 3600 s; here it is for the 2 s of the log"
    assert (told in capsys.readouterr().err) == (not duration)
    assert main(["simulate", str(log), "--duration", "2"]) == 0
    assert told not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("stamps", "force", "start", "says"),
    [
        ([WALL_NS], 1.0, "stamp", "none of its 1 wrench commands acts: they lie at 1700000000.123456789 to"),
        ([4 * SECOND, 5 * SECOND], 1.0, "stamp", "none of its 2 wrench commands acts: they lie at 4 to 5 s, the run"),
        ([5 * SECOND], 1.0, "stamp", "the run goes from 0 to 4 s; let the run begin with the first one by"),
        ([5 * SECOND, 6 * SECOND], 1.0, "auto", "--wrench-start first"),
        ([0, SECOND], 1.0, "1.5", "with time 0 at 1.5 s of the bag"),
        ([0, SECOND], float("nan"), "auto", "each that the run reaches is rejected: wrench force is (nan"),
    ],
)
@pytest.mark.parametrize("command", ["simulate", "explain"])
def test_commands_that_all_miss_are_an_error(
    scene: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    command: str,
    stamps: list[int],
    force: float,
    start: str,
    says: str,
) -> None:
    begin: list[Row] = [("/tick", WRENCH, 0, b"")] if start == "auto" else []
    bag = write_rows(tmp_path / "a.mcap", begin + [("/wrench", STAMPED, at, stamped(at, force)) for at in stamps])
    log = ["--mcap", str(tmp_path / "run.mcap")] if command == "simulate" else []
    assert main([command, str(scene), "--wrench", str(bag), "--wrench-start", start, *log]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "run.mcap").exists()


def test_a_run_between_two_commands_holds_the_first(scene: Path, tmp_path: Path) -> None:
    bag = recorded(tmp_path / "a.mcap", 0, [0, 9 * SECOND])
    log = tmp_path / "run.mcap"
    assert main(["simulate", str(scene), "--wrench", str(bag), "--wrench-start", "1", "--mcap", str(log)]) == 0
    assert [wrench.force[0] for _, wrench in read_bag(log).wrenches("/wrench/applied")] == [1.0]
    assert main(["simulate", str(scene), "--wrench", str(bag), "--wrench-start", "10"]) == 2


def test_one_bag_of_several_that_misses_is_an_error(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flown, missed = recorded(tmp_path / "a.mcap", 0, [0], "/push"), recorded(tmp_path / "b.mcap", 0, [9 * SECOND])
    assert main(["simulate", str(scene), "--wrench", str(flown), "--wrench", str(missed)]) == 2
    assert "b.mcap: none of its 1 wrench commands acts: they lie at 9 to 9 s" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["soon", "nan", "1e99", ""])
def test_a_start_that_is_none_is_refused(scene: Path, capsys: pytest.CaptureFixture[str], text: str) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["simulate", str(scene), "--wrench", str(SLEW), "--wrench-start", text])
    assert "expected auto, bag, first, stamp or a number of seconds" in capsys.readouterr().err


@pytest.mark.parametrize("moves_ns", [None, -2 * SECOND])
@pytest.mark.parametrize(
    "logged",
    [
        lambda k: 25 * SECOND + k,
        lambda k: (k // 10 + 1) * 5 * SECOND + k,
        lambda k: max(3 * SECOND, k * SECOND // 2) + k,
        lambda k: 0,
        lambda k: -WALL_NS,
    ],
    ids=["one burst", "bursts", "the first late", "all at once", "no clock"],
)
def test_log_times_that_do_not_follow_the_stamps_lose_no_command(
    tmp_path: Path, logged: Callable[[int], int], moves_ns: int | None
) -> None:
    """39 of 40 lay before time 0, as the least delay was taken for another clock."""
    rows: list[Row] = [
        ("/wrench", STAMPED, WALL_NS + logged(k), stamped(WALL_NS + k * SECOND // 2, 1.0)) for k in range(40)
    ]
    if moves_ns is not None:
        pose = cdr.encode(POSE, WALL_NS + moves_ns, "world", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        rows.append(("/pose", POSE, WALL_NS + logged(0), pose))
    bag = write_rows(tmp_path / "a.mcap", sorted(rows, key=lambda row: row[2]))
    found = RecordedWrenches([bag], ["wrench"], 30 * SECOND, start="auto")
    begin = -(moves_ns or 0)
    assert [wrench.stamp_ns for _, wrench in found] == [begin + k * SECOND // 2 for k in range(40)]
    assert found.superseded == 0
    assert "do not follow the stamps" in found.notes[0]


@pytest.mark.parametrize(("at", "count", "most"), [("0.4", 0, False), ("1", 1, False), ("8.2", 8, True)])
def test_commands_before_time_0_are_told(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], at: str, count: int, most: bool
) -> None:
    """Of those the last acts, unless another is at time 0."""
    bag = recorded(tmp_path / "a.mcap", 0, [k * SECOND for k in range(10)])
    assert main(["simulate", str(scene), "--wrench", str(bag), "--wrench-start", at]) == 0
    said = capsys.readouterr().err
    assert (f"warning: {count} of 10 commands lie before time 0" in said) == bool(count)
    assert ("--wrench-start first" in said) == most
