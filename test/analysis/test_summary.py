"""The summary has the numbers of the run, and each check fails on the fault it is for."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_runs import SCENE

from rb_dynamics.analysis.gaps import gaps
from rb_dynamics.analysis.identification.flights import read_flight
from rb_dynamics.analysis.inspection import inspect
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import RunSummary, summarize
from rb_dynamics.errors import LogError
from rb_dynamics.formats.mcap_records import McapFile, Message
from rb_dynamics.formats.mcap_writer import McapWriter
from rb_dynamics.formats.merging import merge
from rb_dynamics.formats.output_file import OutputFile
from rb_dynamics.loads.wrench import Wrench
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.report.inspection_text import as_text
from rb_dynamics.run.simulate import simulate
from rb_dynamics.run.simulation import Simulation
from rb_dynamics.run.sink import Status
from rb_dynamics.scene import parse_scene, read_scene
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study.compare import compare

COMMANDS = (
    ("thrust", Wrench(torque=(0.2, -0.1, 0.3), stamp_ns=700_000_000)),
    ("push", Wrench((1.0, -2.0, 0.5), frame_id="world", stamp_ns=1_000_000_000)),
    ("push", Wrench((0.0, 1.0, 0.0), frame_id="world", stamp_ns=2_250_000_000)),
)

POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"
ODOMETRY, WRENCH = "nav_msgs/msg/Odometry", "geometry_msgs/msg/WrenchStamped"
STILL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
EVERY = 10_000_000


def summary_of(log: Path, **options: Any) -> RunSummary:
    scene = options.pop("scene", None)
    return summarize(read_track(read_bag(log), scene), **options)


def failed(summary: RunSummary) -> list[str]:
    return [check.name for check in summary.checks if not check.passed]


def pose(time_ns: int, values: tuple[float, ...] = STILL, topic: str = "/b/pose", frame: str = "world") -> Any:
    return (topic, POSE, time_ns, (time_ns, frame, values))


def twist(time_ns: int, values: tuple[float, ...] = (0.0,) * 6, topic: str = "/b/twist", frame: str = "base") -> Any:
    return (topic, TWIST, time_ns, (time_ns, frame, values))


def test_times_are_the_whole_nanoseconds_of_the_log(tmp_path: Path) -> None:
    """60 s were 60.00000000000001, as 1e-9 is no double."""
    scene = "body: {mass: 1, inertia: {diagonal: [1, 2, 3]}}\nduration: 60\noutput_rate: 1\nwrenches: [{topic: w}]\n"
    commands = [("w", Wrench((1, 0, 0), (0, 0, 0), "body", 59_000_000_003))]
    simulate(parse_scene(scene), commands, [McapSink(tmp_path / "a.mcap")])
    found = asdict(summary_of(tmp_path / "a.mcap"))
    assert found["duration_s"] == 60.0
    (channel,) = found["channels"]
    assert channel["first_s"] == 59.000000003


def test_numbers_are_those_of_the_run(flight: Any) -> None:
    summary, samples, last = summary_of(flight.log), flight.samples, flight.result.sample
    assert summary.own
    assert summary.complete
    assert summary.passed, failed(summary)
    assert summary.scene == "test.yaml"
    assert (summary.method, summary.asked) == ("rkmk4", "rkmk4")
    assert summary.solver.startswith("rkmk4")
    assert summary.steps == flight.result.steps
    assert summary.duration_s == 3.0
    assert summary.samples == len(samples.samples) == 151
    ends = {moment.name: moment.last for moment in summary.moments}
    assert ends["position, world"] == last.position_world
    assert ends["orientation x y z w"] == last.orientation_xyzw
    assert ends["angular velocity, body"] == last.angular_velocity_body
    assert ends["angular momentum, world"] == last.angular_momentum_world
    assert ends["linear momentum, world"] == last.linear_momentum_world
    assert ends["kinetic energy"] == (last.kinetic_energy,)
    assert ends["work"] == (last.work,)
    energy = summary.balance("energy")
    assert energy is not None
    assert energy.worst == np.abs(samples.energy_defect).max()
    assert energy.scale == max(np.abs(samples.kinetic_energy).max(), np.abs(samples.work).max())


def test_extremes_are_those_of_the_run(flight: Any) -> None:
    ranges = {r.name: r for r in summary_of(flight.log).ranges}
    size = np.linalg.norm(flight.samples.angular_momentum_world, axis=1)
    found = ranges["angular momentum |L|"]
    assert (found.low, found.high) == (size.min(), size.max())
    assert found.high_at_s == flight.samples.time_ns[size.argmax()] / 1e9
    assert ranges["kinetic energy T"].high == flight.samples.kinetic_energy.max()


def test_channels_count_commands_and_timeouts(flight: Any) -> None:
    thrust, push = sorted(summary_of(flight.log).channels, key=lambda channel: channel.topic, reverse=True)
    assert (thrust.topic, thrust.received, thrust.applied, thrust.timeouts) == ("/thrust", 2, 2, 1)
    assert (push.topic, push.received, push.applied, push.timeouts) == ("/push", 2, 2, 0)
    assert thrust.frames == ("body",)
    assert thrust.largest_torque == pytest.approx(np.linalg.norm([0.2, -0.1, 0.3]))
    assert push.largest_force == pytest.approx(np.linalg.norm([1.0, -2.0, 0.5]))
    assert (thrust.rejected, push.rejected) == (0, 0)
    assert thrust.timed_out_s == pytest.approx(1.05)


def test_a_channel_that_falls_silent_is_warned_of(flown: Callable[..., Any]) -> None:
    """If a commander dies and its channel has no timeout, its last force acts to the end."""
    dies = [("push", Wrench((1.0, 0.0, 0.0), frame_id="world", stamp_ns=k * 100_000_000)) for k in range(10)]
    summary = summary_of(flown(dies).log)
    (channel,) = (each for each in summary.channels if each.topic == "/push")
    assert (channel.first_s, channel.last_s, channel.held_s) == pytest.approx((0.0, 0.9, 2.1))
    assert channel.usual_s == pytest.approx(0.1)
    said = "/push received no more commands: the last one, at t = 0.9 s, was held for the remaining 2.1 s"
    assert any(said in each for each in summary.warnings)


def test_commands_that_a_paused_node_takes_at_one_time_came_at_no_rate(flown: Callable[..., Any]) -> None:
    """Of a channel that fell silent later, "before, they came every 0 s" was said."""
    at_once = [("push", Wrench((float(k), 0.0, 0.0), frame_id="world", stamp_ns=500_000_000)) for k in range(20)]
    summary = summary_of(flown(at_once).log)
    (channel,) = (each for each in summary.channels if each.topic == "/push")
    assert channel.received == 20
    assert not any("no more commands" in each for each in summary.warnings)


@pytest.mark.parametrize(
    ("topic", "count", "last_force"),
    [("push", 2, 1.0), ("push", 28, 1.0), ("push", 10, 0.0), ("thrust", 10, 1.0)],
    ids=["a single step", "to the end", "ended by zero", "timed out"],
)
def test_a_command_that_is_meant_to_stay_is_no_silence(
    flown: Callable[..., Any], topic: str, count: int, last_force: float
) -> None:
    forces = [*[1.0] * (count - 1), last_force]
    sent = [(topic, Wrench((x, 0.0, 0.0), stamp_ns=k * 100_000_000)) for k, x in enumerate(forces)]
    assert not any("received no more" in each for each in summary_of(flown(sent).log).warnings)


def test_timeouts_of_a_log_that_was_cut_off_are_counted_up_to_its_last_sample(flight: Any, tmp_path: Path) -> None:
    """A command may be there whose applied wrench is lost; a timeout before the last sample still counts."""
    whole = McapFile(flight.log)
    messages = list(whole.messages())
    found = {}
    for count, message in enumerate(messages):
        if message.channel.topic in ("/thrust", "/thrust/applied") or count == len(messages) - 1:
            summary = summary_of(begun(tmp_path / "cut.mcap", whole, messages[: count + 1]))
            assert not summary.complete
            found[count] = {channel.topic: channel.timeouts for channel in summary.channels}.get("/thrust")
    assert {*found.values()} <= {None, 0, 1}
    assert found[len(messages) - 1] == 1


def test_timeouts_are_not_known_where_a_piece_is_missing(flight: Any, tmp_path: Path) -> None:
    whole = McapFile(flight.log)
    left = [each for each in whole.messages() if not 400_000_000 < each.log_time < 600_000_000]
    summary = summary_of(begun(tmp_path / "cut.mcap", whole, left))
    assert {channel.timeouts for channel in summary.channels} == {None}
    assert not any("timed out" in each for each in summary.warnings)


def damaged(path: Path, flight: Any, begin_ns: int, end_ns: int, reason: str = "damaged") -> RunSummary:
    """Return the summary of the recovered copy of a damaged log."""
    whole = McapFile(flight.log)
    left = [each for each in whole.messages() if not begin_ns <= each.log_time <= end_ns]
    whole.metadata["rb_dynamics.interrupted"] = {"reason": reason, "missing_ns": f"{begin_ns} {end_ns}"}
    return summary_of(begun(path, whole, left, ended=True))


def test_a_missing_piece_is_named_and_the_rest_judged(flown: Callable[..., Any], tmp_path: Path) -> None:
    again = ("thrust", Wrench(torque=(0.1, 0.0, 0.0), stamp_ns=2_400_000_000))
    flight = flown((*COMMANDS, again))
    summary = damaged(tmp_path / "saved.mcap", flight, 1_500_000_000, 2_000_000_000)
    piece = "a piece is missing from t = 1.5 to 2 s"
    assert [check.detail for check in summary.checks if check.name == "recording has all its parts"] == [piece]
    assert "file is whole" not in failed(summary)
    assert f"A{piece[1:]}: what came and acted there is not known." in summary.warnings
    assert not any("cut off" in each for each in summary.warnings)
    assert "/thrust timed out at least 2×, first at t = 1.05 s." in summary.warnings
    # What acts is known again when each channel has had a command.
    for name in ("linear momentum", "angular momentum"):
        balance = summary.balance(name)
        assert balance is not None
        assert balance.covered == pytest.approx((1.5 + 0.6) / 3.0, abs=0.03)
        assert balance.relative < 1e-6


@pytest.mark.parametrize("told", ["", "7", "x y", "5 3", f"0 {2**63}", f"{10**19 - 1} {10**19 - 1}", "٣ ٤"])
def test_nonsense_about_missing_pieces_is_not_believed(flight: Any, told: str) -> None:
    bag = read_bag(flight.log)
    bag.metadata["rb_dynamics.interrupted"] = {"reason": "damaged", "missing_ns": told}
    assert bag.missing == []
    assert summarize(read_track(bag)).passed


def test_missing_pieces_are_in_order(flight: Any) -> None:
    bag = read_bag(flight.log)
    bag.metadata["rb_dynamics.interrupted"] = {"missing_ns": "2000000000 2100000000, 1000000000 1100000000"}
    assert bag.missing == [(1_000_000_000, 1_100_000_000), (2_000_000_000, 2_100_000_000)]
    for steps in read_track(bag).acting:
        assert (np.diff(steps.time_ns) >= 0).all()
        assert (~steps.known).sum() == 2


def test_what_is_held_behind_a_missing_piece_is_not_known(flown: Callable[..., Any], tmp_path: Path) -> None:
    sent = [("push", Wrench((1.0, 0.0, 0.0), frame_id="world", stamp_ns=k * 100_000_000)) for k in range(10)]
    summary = damaged(tmp_path / "saved.mcap", flown(sent), 1_000_000_000, 1_200_000_000)
    assert {channel.held_s for channel in summary.channels} == {None}
    assert not any("received no more" in each for each in summary.warnings)


def test_a_log_that_was_cut_off_says_of_how_much(flight: Any, tmp_path: Path) -> None:
    whole = McapFile(flight.log)
    messages = [each for each in whole.messages() if each.log_time <= 1_000_000_000]
    del whole.metadata["rb_dynamics.result"]
    summary = summary_of(begun(tmp_path / "cut.mcap", whole, messages))
    assert summary.lacks == "cut off at t = 1 of 3 s"
    assert "The run was cut off at t = 1 of 3 s: everything later is lost." in summary.warnings
    assert {"file is whole", "recording has all its parts"} <= {*failed(summary)}


def test_a_run_that_ended_early_is_noted(flight: Any, tmp_path: Path) -> None:
    early, endless = tmp_path / "early.mcap", tmp_path / "endless.mcap"
    for log, scene in ((early, SCENE), (endless, SCENE.replace("duration: 3.0\n", ""))):
        run = Simulation(parse_scene(scene), [McapSink(log)])
        run.start()
        run.advance(1_240_000_000)
        run.finish()
    note = "The run ended early, by an error or a stop: at t = 1.24 s of 3 s."
    assert summary_of(early).notes == (note,)
    assert not failed(summary_of(early))
    for log in (endless, flight.log):
        assert note not in summary_of(log).notes


def begun(path: Path, whole: McapFile, messages: list[Message], *, ended: bool = False) -> Path:
    """Write these messages and everything else in `whole` to a file, truncated or complete."""
    with contextlib.closing(OutputFile(path)) as file:
        writer = McapWriter(file, "test")
        writer.begin()
        numbers = {channel.topic: writer.add_channel(channel) for channel in whole.channels.values()}
        for each in messages:
            writer.add_messages((numbers[each.channel.topic],), (each.data,), each.log_time, each.publish_time)
        for name, data in whole.attachments.items():
            writer.add_attachment(name, "", data)
        for name, facts in whole.metadata.items():
            writer.add_metadata(name, facts)
        writer.finish()
    if not ended:
        path.write_bytes(path.read_bytes()[:-8])
    return path


def test_topics_have_count_rate_and_longest_interval(flight: Any) -> None:
    topics = {topic.name: topic for topic in summary_of(flight.log).topics}
    assert topics["/pose"].count == 151
    assert topics["/pose"].rate == pytest.approx(50.0)
    assert topics["/pose"].longest_s == pytest.approx(0.02)
    assert topics["/inertia"].count == 1
    assert topics["/diagnostics"].count == 0
    assert topics["/inertia"].rate == 0.0


def test_logged_momenta_agree_with_those_from_pose_twist_and_inertia(flight: Any, bagger: Any) -> None:
    """The same motion as another writer would log it gives the same momenta and the same verdicts."""
    rows = []
    for sample in flight.samples.samples:
        turn = np.array(sample.linear_velocity_world)
        rows.append(pose(sample.time_ns, (*sample.position_world, *sample.orientation_xyzw)))
        rows.append(twist(sample.time_ns, (*_to_body(sample.orientation_xyzw, turn), *sample.angular_velocity_body)))
    scene = parse_scene(_text(flight))
    summary = summary_of(bagger(rows), scene=scene)
    ends = {moment.name: moment.last for moment in summary.moments}
    last = asdict(flight.result.sample)
    assert ends["angular momentum, world"] == pytest.approx(last["angular_momentum_world"], rel=1e-13)
    assert ends["linear momentum, world"] == pytest.approx(last["linear_momentum_world"], rel=1e-13)
    assert ends["kinetic energy"] == pytest.approx((last["kinetic_energy"],), rel=1e-13)
    assert not summary.balances
    assert any("No wrench topic" in remark for remark in summary.missing)


def test_twist_in_world_axes_is_turned(flight: Any, bagger: Any) -> None:
    rows = []
    for sample in flight.samples.samples:
        rate = _to_body(_conjugate(sample.orientation_xyzw), np.array(sample.angular_velocity_body))
        rows.append(pose(sample.time_ns, (*sample.position_world, *sample.orientation_xyzw)))
        rows.append(twist(sample.time_ns, (*sample.linear_velocity_world, *rate), frame="world"))
    summary = summary_of(bagger(rows), scene=parse_scene(_text(flight)))
    ends = {moment.name: moment.last for moment in summary.moments}
    last = flight.result.sample
    assert ends["angular velocity, world"] == pytest.approx(rate)
    assert ends["angular momentum, world"] == pytest.approx(last.angular_momentum_world, rel=1e-12)
    assert ends["linear momentum, world"] == pytest.approx(last.linear_momentum_world, rel=1e-12)


def test_recorded_flight_balances_with_the_mass_properties_of_the_scene(example_dir: Path, scene_dir: Path) -> None:
    bare = summary_of(example_dir / "slew.mcap")
    assert bare.passed
    assert not bare.momenta_from
    assert any("--scene SCENE" in remark for remark in bare.missing)
    full = summary_of(example_dir / "slew.mcap", scene=read_scene(scene_dir / "slew.yaml"))
    assert full.passed
    for name in ("angular momentum", "linear momentum"):
        balance = full.balance(name)
        assert balance is not None
        assert balance.covered == 1.0
        assert 0.0 < balance.relative < 1e-9


def test_wrong_mass_is_found(example_dir: Path, scene_dir: Path) -> None:
    scene = read_scene(scene_dir / "slew.yaml", {"body.mass": 16.9})
    assert failed(summary_of(example_dir / "slew.mcap", scene=scene)) == [
        "linear momentum balance",
        "mass explains the motion",
    ]


def test_a_failed_balance_says_since_when(example_dir: Path, scene_dir: Path) -> None:
    scene = read_scene(scene_dir / "slew.yaml", {"body.mass": 16.9})
    summary = summary_of(example_dir / "slew.mcap", scene=scene)
    balance = summary.balance("linear momentum")
    assert balance is not None
    onset = balance.onset_ns(1e-6)
    assert onset is not None
    assert onset < balance.worst_ns
    assert np.linalg.norm(balance.defect[balance.time_ns < onset], axis=1).max(initial=0.0) <= 1e-6 * balance.scale
    detail = next(check.detail for check in summary.checks if not check.passed)
    assert f"beyond it first at t = {(onset - summary.start_ns) * 1e-9:.6g} s" in detail
    assert balance.onset_ns(1.0) is None


def test_bound_is_the_one_given(flight: Any) -> None:
    assert failed(summary_of(flight.log, bound=1e-19)) == [
        "quaternion is unit",
        "energy balance",
        "angular momentum balance",
        "linear momentum balance",
    ]


def test_poor_method_fails_its_energy(flown: Callable[..., Any]) -> None:
    poor = flown(step="0.1", output_rate="10.0")
    assert "energy balance" in failed(summary_of(poor.log, bound=1e-12))


def test_cut_off_log_is_incomplete_and_still_read(flown: Callable[..., Any], tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    # Of several chunks.
    data = flown(output_rate="200").log.read_bytes()
    cut.write_bytes(data[: 2 * len(data) // 3])
    summary = summary_of(cut)
    assert not summary.complete
    assert "file is whole" in failed(summary)
    assert summary.steps is None
    assert 0 < summary.samples < 601


@pytest.mark.parametrize(
    ("steps", "count"),
    [
        ([5] * 40, 0),
        ([5] * 20 + [15] + [5] * 20, 1),
        ([5] * 40 + [2], 0),
        ([1, 7, 3, 9, 2, 8, 4, 6], 0),
        ([5], 0),
        ([9, 10, 12] * 9 + [3000], 1),
    ],
)
def test_gaps_stand_out(steps: list[int], count: int) -> None:
    assert gaps(np.cumsum([0, *steps])) == count


def test_gap_in_the_motion_fails(bagger: Any) -> None:
    summary = summary_of(bagger([pose(EVERY * (k if k < 30 else k + 7)) for k in range(60)]))
    assert failed(summary) == ["/b/pose is whole"]
    assert "1 gap: 0.08 s from t = 0.29 s" in next(check.detail for check in summary.checks if not check.passed)


def test_random_intervals_have_no_gap_and_a_hole_in_them_is_one() -> None:
    random = np.random.default_rng(5)
    for _ in range(200):
        scale, spread = 10 ** random.uniform(5.0, 8.0), random.uniform(0.0, 1.0)
        steps = scale * ((1.0 - spread) + spread * random.exponential(1.0, 2000))
        assert gaps(np.cumsum(np.rint(steps).astype(np.int64))) == 0
        steps[700] = 40.0 * scale
        assert gaps(np.cumsum(np.rint(steps).astype(np.int64))) == 1


def test_a_bag_of_a_log_with_a_sample_at_every_step_is_whole(tmp_path: Path) -> None:
    """Steps grow where nothing acts; the bag said that a piece was missing there."""
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [0.2, 0.3, 0.4]}}\ninitial: {angular_velocity_body: [0.1, 0.02, 0.03]}\n"
        "wrenches: [{topic: wrench}]\nduration: 10\noutput_rate: 0\n"
    )
    log, bag, again = (tmp_path / f"{name}.mcap" for name in ("log", "bag", "again"))
    acted = [
        ("wrench", Wrench((0, 0, 0), (0.1 * (-1) ** k, 0.0, 0.02), "body", 5 * 10**9 + k * 10**8)) for k in range(40)
    ]
    simulate(scene, acted, [McapSink(log)])
    merge([log], bag, (-math.inf, math.inf))
    merge([bag], again, (-math.inf, math.inf))
    assert gaps(read_bag(bag).topics["/pose"].log_times)
    merge([log], part := tmp_path / "part.mcap", (0, 4.5e9))
    for path in (log, bag, again, part):
        assert not failed(summary_of(path)), path


@pytest.mark.parametrize("count", [2, 3])
def test_a_few_samples_need_not_reach_the_very_end(bagger: Any, count: int) -> None:
    rows = [pose(3 * 10**9 * k) for k in range(count)] + [twist(EVERY * k) for k in range(300 * (count - 1) + 150)]
    assert "/b/pose is whole" not in failed(summary_of(bagger(rows)))


def test_a_stream_that_stops_before_the_recording_fails(bagger: Any) -> None:
    rows = [pose(EVERY * k) for k in range(200)] + [twist(EVERY * k) for k in range(600)]
    summary = summary_of(bagger(rows))
    assert failed(summary) == ["/b/pose is whole"]
    said = next(check.detail for check in summary.checks if not check.passed)
    assert said == "it stops 4 s before the recording does, which goes on with /b/twist"


def test_odometry_that_is_not_used_is_named(bagger: Any) -> None:
    none = (0.0,) * 36
    rows = [*(pose(EVERY * k) for k in range(9)), *(twist(EVERY * k) for k in range(9))]
    rows += [("/odom", ODOMETRY, EVERY * k, (EVERY * k, "w", "b", STILL, none, (0.0,) * 6, none)) for k in range(9)]
    assert any("left out: /odom" in note for note in summary_of(bagger(rows)).notes)


@pytest.mark.parametrize(
    ("second_begins_s", "words"),
    [
        (17_208, "2 recordings in one folder: 17198 s lie between day_0.mcap and day_1.mcap"),
        (-90, "2 recordings in one folder: 80 s lie between day_1.mcap and day_0.mcap"),
    ],
)
def test_two_recordings_in_one_folder_are_two(bagger: Any, tmp_path: Path, second_begins_s: int, words: str) -> None:
    folder = tmp_path / "both"
    folder.mkdir()
    for number, begin_s in enumerate((100, 100 + second_begins_s)):
        times = [begin_s * 10**9 + EVERY * k for k in range(1001)]
        rows = [row for time_ns in times for row in (pose(time_ns), twist(time_ns))]
        bagger(rows).rename(folder / f"day_{number}.mcap")
    summary = summary_of(folder, scene=parse_scene(BRIEF))
    found = {check.name: check for check in summary.checks}
    assert found["inertia explains the motion"].detail == "not judged; these are several recordings"
    assert summary.residual is None
    assert not found["files are one recording"].passed
    assert words in found["files are one recording"].detail


def test_files_of_one_recording_are_one(bagger: Any, tmp_path: Path) -> None:
    folder = tmp_path / "split"
    folder.mkdir()
    for number in range(3):
        rows = [pose(EVERY * (k + 100 * number)) for k in range(100)]
        bagger(rows).rename(folder / f"day_{number}.mcap")
    summary = summary_of(folder)
    assert summary.passed
    (check,) = (each for each in summary.checks if each.name == "files are one recording")
    assert check.detail == "3 files that follow one another"


def test_time_that_goes_back_fails(bagger: Any) -> None:
    assert failed(summary_of(bagger([pose(EVERY * (k % 20)) for k in range(40)]))) == ["/b/pose is whole"]


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1e300])
def test_unusable_numbers_are_left_out_and_fail(bagger: Any, bad: float) -> None:
    rows = [pose(EVERY * k, (bad if k == 3 else 1.0, *STILL[1:])) for k in range(20)]
    summary = summary_of(bagger(rows))
    assert summary.samples == 19
    assert failed(summary) == ["/b/pose is whole"]


@pytest.mark.parametrize("part", [3, 7])
def test_unusable_numbers_of_one_part_of_an_odometry_fail(bagger: Any, part: int) -> None:
    """Pose and twist come from one topic; the one that lacks rows is named."""
    rows = []
    for k in range(12):
        numbers = [*STILL, *(0.0,) * 6]
        numbers[part] = float("nan") if 3 < k < 9 else numbers[part]
        values = (k * 10_000_000, "world", "base", numbers[:7], (0.0,) * 36, numbers[7:], (0.0,) * 36)
        rows.append(("/odom", "nav_msgs/msg/Odometry", k * 10_000_000, values))
    check = next(check for check in summary_of(bagger(rows)).checks if check.name == "/odom is whole")
    assert not check.passed
    assert "5 of 12 messages have a number that is not finite" in check.detail


def test_physics_is_not_judged_by_quaternions_that_were_not_filled_in(bagger: Any, scene_dir: Path) -> None:
    def row(k: int) -> Any:
        q = (0.0,) * 4 if k in (30, 31) else (0.0, 0.0, float(np.sin(0.01 * k)), float(np.cos(0.01 * k)))
        values = (k * 10_000_000, "world", "base", (0.0, 0.0, 0.0, *q), (0.0,) * 36, (0.0,) * 5 + (2.0,), (0.0,) * 36)
        return "/odom", "nav_msgs/msg/Odometry", k * 10_000_000, values

    summary = summary_of(bagger(map(row, range(500))), scene=read_scene(scene_dir / "slew.yaml"))
    assert "quaternion is unit" in failed(summary)
    assert "inertia explains the motion" not in failed(summary)


def test_quaternion_that_is_not_unit_fails(bagger: Any) -> None:
    rows = [pose(EVERY * k, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.001)) for k in range(5)]
    assert failed(summary_of(bagger(rows))) == ["quaternion is unit"]


@pytest.mark.parametrize(("places", "length", "fails"), [(4, 1.0, False), (4, 1.001, True), (12, 1.00005, True)])
def test_quaternions_rounded_to_some_decimal_places_are_unit(
    bagger: Any, places: int, length: float, fails: bool
) -> None:
    half = 0.01 * np.arange(200)
    q = np.round(length * np.column_stack([0.6 * np.sin(half), 0.8 * np.sin(half), 0.0 * half, np.cos(half)]), places)
    rows = [pose(EVERY * k, (0.0, 0.0, 0.0, *row)) for k, row in enumerate(q.tolist())]
    assert failed(summary_of(bagger(rows))) == (["quaternion is unit"] if fails else [])


def test_odometry_alone_gives_both_pose_and_twist(bagger: Any) -> None:
    none = (0.0,) * 36
    velocity = (2.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    rows = [
        ("/odom", ODOMETRY, EVERY * k, (EVERY * k, "world", "base", (0.02 * k, *STILL[1:]), none, velocity, none))
        for k in range(30)
    ]
    summary = summary_of(bagger(rows))
    ends = {moment.name: moment.last for moment in summary.moments}
    assert ends["linear velocity, body"] == (2.0, 0.0, 0.0)
    assert ends["position, world"] == (0.02 * 29, 0.0, 0.0)


def test_of_several_bodies_one_is_taken_and_the_others_are_named(bagger: Any) -> None:
    rows = [row for k in range(5) for name in ("/a", "/b") for row in _both(EVERY * k, name)]
    summary = summary_of(bagger(rows))
    assert any("left out: /b/pose, /b/twist" in note for note in summary.notes)


def _both(time_ns: int, parent: str) -> list[Any]:
    return [pose(time_ns, topic=f"{parent}/pose"), twist(time_ns, topic=f"{parent}/twist")]


def test_wrench_in_an_unknown_frame_is_not_judged(bagger: Any, scene_dir: Path) -> None:
    rows = [
        row
        for k in range(20)
        for row in (
            pose(EVERY * k),
            twist(EVERY * k),
            ("/w", WRENCH, EVERY * k, (EVERY * k, "nozzle", (1.0, 0.0, 0.0, 0.0, 0.0, 0.0))),
        )
    ]
    summary = summary_of(bagger(rows), scene=read_scene(scene_dir / "slew.yaml"))
    assert all(balance.covered == 0.0 for balance in summary.balances)
    unknown = {check.name: check.detail for check in summary.checks if check.name.endswith("balance")}
    assert {"angular momentum balance", "linear momentum balance"} <= {*unknown}
    assert all(detail.startswith("not judged; not known at any time") for detail in unknown.values())
    assert "--    angular momentum balance: not judged" in as_text(summary)
    judged = sum(check.judged for check in summary.checks)
    assert as_text(summary).endswith(
        f"all {judged} checks passed; whether the inertia explains the motion is not judged"
    )
    assert any("frames: nozzle" in note for note in summary.notes)
    assert "not judged; the effect of /w is not known" in as_text(summary)
    assert summary.passed


@pytest.mark.parametrize("frame", ["/world", "world", "map", ""])
def test_the_world_of_a_bag_may_have_any_name(bagger: Any, frame: str) -> None:
    command = ("/b/push", WRENCH, 0, (0, frame, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    summary = summary_of(bagger([command, *(pose(EVERY * k, frame=frame) for k in range(9))]))
    assert not any("nobody declared" in note for note in summary.notes)
    assert summary_of(bagger([pose(0, frame=frame)] * 9)).checks


def test_mixed_frames_on_one_topic_are_refused(bagger: Any) -> None:
    with pytest.raises(LogError, match=r"has the frames \['a', 'b'\]"):
        summary_of(bagger([pose(EVERY * k, frame="ab"[k % 2]) for k in range(4)]))


def test_messages_out_of_order_are_no_second_run(bagger: Any) -> None:
    """They are sorted, and what they tell is judged; of two runs, nothing tells which message is of which."""
    order = [*range(100)]
    order[40:42] = 41, 40
    for again, words in (
        ([], "1 of 100 stamps is out of order, by 0.01 s, at t = 0.4 s"),
        (order, "two runs in one file"),
    ):
        rows = [
            row
            for k in [*order, *again]
            for row in (pose(EVERY * k, (0.01 * k, *STILL[1:])), twist(EVERY * k, (1.0, *STILL[1:6])))
        ]
        path = bagger([(topic, kind, EVERY * n, values) for n, (topic, kind, _, values) in enumerate(rows)])
        summary = summary_of(path, scene=parse_scene(SCENE))
        details = [check.detail for check in summary.checks if check.name in ("/b/pose is whole", "/b/twist is whole")]
        assert len(details) == 2
        assert all(words in detail for detail in details)
        assert any("these are several runs" in check.detail for check in summary.checks) == bool(again)
        assert sum(words in note for note in compare(path, path).notes) == 4


@pytest.mark.parametrize("strays", [{0: "a:b"}, {7: "a:b", 8: "c:b", 99: "a:d"}, dict.fromkeys(range(10), ":b")])
def test_a_few_messages_of_another_frame_are_left_out_and_named(bagger: Any, strays: dict[int, str]) -> None:
    """Of another parent or of another body: both spoil a pose; the axes of a twist are those of its child frame."""
    still, spread = (0.0,) * 6, (0.0,) * 36
    rows = []
    for k in range(100):
        parent, child = strays.get(k, "odom:base").split(":")
        place = (0.01 * k if k not in strays else 1e6, *STILL[1:])
        rows += [("/odom", ODOMETRY, EVERY * k, (EVERY * k, parent, child, place, spread, still, spread))]
    summary = summary_of(bagger(rows))
    assert "/odom is whole" in failed(summary)
    (detail,) = (check.detail for check in summary.checks if check.name == "/odom is whole")
    begin = f"{len(strays)} of 100 messages are of other frames than the rest, and left out: "
    assert detail.startswith(begin)
    each = set(detail.removeprefix(begin).split(", "))
    assert each == {f"{frame} {sum(other == frame for other in strays.values())}×" for frame in strays.values()}
    assert summary.samples == 100 - len(strays)
    assert next(m.last for m in summary.moments if m.name == "position, world")[0] < 1.0
    found = compare(summary.path, summary.path)
    assert sum(f"/odom: {detail}" in note for note in found.notes) == 2
    assert any(f"/odom: {detail}" in note for note in read_flight(summary.path, parse_scene(SCENE)).notes)


def test_frames_of_more_than_a_tenth_are_mixed(bagger: Any) -> None:
    with pytest.raises(LogError, match=r"has the frames \['a', 'b'\], expected one in 90 % of its messages or more"):
        summary_of(bagger([pose(EVERY * k, frame="ab"[k < 11]) for k in range(100)]))


def test_bag_of_nothing_known_is_refused(bagger: Any) -> None:
    with pytest.raises(LogError, match=r"expected at least one topic[^\n]*\n  /x +std_msgs/msg/Float64 +1 messages"):
        summary_of(bagger([("/x", "std_msgs/msg/Float64", 0, ([1.0],))]))


def test_stamps_of_the_epoch_keep_their_digits(bagger: Any) -> None:
    start = 1_700_000_000_123_456_789
    summary = summary_of(bagger([pose(start + EVERY * k) for k in range(11)]))
    assert summary.start_ns == start
    assert summary.duration_s == pytest.approx(0.1, abs=1e-12)
    assert "1700000000.123456789 s" in as_text(summary)


# Every 350 ms, which is the timeout of the channel: two come at the very time at which it drops to zero.
MISTAKEN = [
    ("thrust", Wrench(torque=(0.1, 0.0, 0.0), frame_id=frame, stamp_ns=350_000_000 * (1 + k)))
    for k, frame in enumerate(("body", "bdoy", "", "wrold", "world"))
]


def test_rejected_commands_are_told_of_an_offline_run_and_are_no_timeouts(flown: Callable[..., Any]) -> None:
    flight = flown(MISTAKEN)
    assert len(flight.result.rejected) == 2
    summary = summary_of(flight.log)
    (thrust,) = (channel for channel in summary.channels if channel.topic == "/thrust")
    assert (thrust.received, thrust.applied, thrust.rejected, thrust.timeouts) == (5, 3, 2, 3)
    assert thrust.timed_out_s == pytest.approx(0.7)
    assert thrust.undeclared == {"bdoy": 1, "wrold": 1}
    said = "/thrust: 2 commands rejected and had no effect (the scene declares no frame bdoy, wrold)."
    assert said in summary.warnings
    mixed = summary_of(flown([*MISTAKEN, ("thrust", Wrench((math.inf, 0.0, 0.0), stamp_ns=100_000_000))]).log)
    told = "/thrust: 3 commands rejected and had no effect (2 of them as the scene declares no frame bdoy, wrold)."
    assert told in mixed.warnings
    assert "/thrust timed out 3×, first at t = 0.7 s." in summary.warnings


def test_a_command_that_is_not_finite_is_rejected_whatever_its_frame(flown: Callable[..., Any]) -> None:
    bad = ("push", Wrench((math.nan, 0.0, 0.0), frame_id="body", stamp_ns=100_000_000))
    summary = summary_of(flown([*COMMANDS, bad]).log)
    assert [(c.received, c.applied, c.rejected, c.undeclared) for c in summary.channels] == [
        (3, 2, 1, {}),
        (1, 1, 0, {}),
    ]
    assert "/push: 1 command rejected and had no effect." in summary.warnings


def test_rejected_commands_are_told_of_a_log_that_was_cut_off(flown: Callable[..., Any], tmp_path: Path) -> None:
    whole = McapFile(flown(MISTAKEN).log)
    messages = list(whole.messages())
    last = max(k for k, each in enumerate(messages) if each.channel.topic == "/thrust")
    for end in (last, last + 1, last + 2):  # without the last command, with it alone, with what it did
        summary = summary_of(begun(tmp_path / "cut.mcap", whole, messages[:end]))
        (thrust,) = (channel for channel in summary.channels if channel.topic == "/thrust")
        told = (thrust.received, thrust.applied, thrust.rejected, thrust.timeouts)
        assert told == {last: (4, 2, 2, 2), last + 1: (5, 2, 2, 2), last + 2: (5, 3, 2, 2)}[end]


def test_rejections_come_from_the_diagnostics(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    run = Simulation(parse_scene(BRIEF), [McapSink(log, namespace="/robot")])
    run.start()
    run.post("thrust", Wrench(torque=(0.1, 0.0, 0.0)))
    run.advance(100_000_000)
    run.write(Status(run.time_ns, 1, "thrust: rejected: not finite", {"thrust: rejected": "3", "state": "running"}))
    run.write(Status(run.time_ns, 0, "running", {"thrust: rejected": "4", "state": "running"}))
    run.finish()
    summary = summary_of(log)
    assert [(c.topic, c.received, c.rejected) for c in summary.channels] == [("/robot/thrust", 1, 4)]
    assert summary.health is not None
    assert summary.health.worst_level == 1
    assert summary.health.message == "running"


def test_what_a_node_counted_since_its_start_is_not_told_of_a_later_part(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    run = Simulation(parse_scene(BRIEF), [McapSink(log)])
    run.start()
    counts = {"thrust: late": "3", "thrust: lost": "2", "overruns": "5", "time dropped": "0.5 s"}
    for until_ns in (20_000_000, 90_000_000):
        run.advance(until_ns)
        run.write(Status(run.time_ns, 0, "running", counts))
    run.finish()
    whole, first, later = (
        inspect(log, window_s=window_s).summary for window_s in ((None, None), (None, 0.05), (0.05, None))
    )
    for told in (whole, first):
        assert [(each.late, each.lost) for each in told.channels] == [(3, 2)]
        assert any("The machine was too slow, or busy, 5×" in each for each in told.warnings)
    assert [(each.late, each.lost) for each in later.channels] == [(None, None)]
    assert not later.warnings


BRIEF = """
body: {mass: 2.0, inertia: {diagonal: [1, 2, 2.5]}}
wrenches: [{topic: thrust}]
solver: {method: rkmk4, step: 0.01}
duration: 0.1
"""


def _text(flight: Any) -> str:
    return bytes(read_bag(flight.log).attachments["scene.yaml"]).decode()


def _conjugate(q: tuple[float, ...]) -> tuple[float, ...]:
    return (-q[0], -q[1], -q[2], q[3])


def _to_body(q: tuple[float, ...], v: np.ndarray) -> tuple[float, float, float]:
    axis, twice = -np.array(q[:3]), 2.0 * np.cross(-np.array(q[:3]), v)
    x, y, z = v + q[3] * twice + np.cross(axis, twice)
    return (float(x), float(y), float(z))
