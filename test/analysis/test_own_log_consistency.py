"""A log that contradicts itself fails; one that was cut, split or renamed does not."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edited_logs import edited

from rb_dynamics import Simulation, Wrench, inspect, parse_scene, simulate
from rb_dynamics.analysis import own_log_consistency
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.track import TimeSeries
from rb_dynamics.formats import cdr
from rb_dynamics.formats.mcap_records import Message
from rb_dynamics.formats.recovery import recover
from rb_dynamics.formats.topic_messages import Topic
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.sinks.rosbag2_sink import BagSink
from rb_dynamics.study.continued_run import scene_at

TEXT = """
body: {mass: 2, center_of_mass: [0.1, 0, 0.2], inertia: {matrix: [[1, 0.1, 0], [0.1, 2, -0.2], [0, -0.2, 2.5]]},
  frames: {jet: {position: [0, 1, 0]}}}
initial: {angular_velocity_body: [0.1, 2, 0.1], linear_velocity_world: [1, 2, 3],
  orientation: {x: 0.6, y: 0, z: 0, w: 0.8}}
wrenches: [{topic: push, timeout: 0.35, max_force: 2.5, on_excess: clip}, {topic: /robot/turn}]
effects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}, {type: linear_drag, translation: 0.1}]
solver: {method: rkmk4, step: 0.01}
duration: 2
output_rate: 30
"""
COMMANDS = [
    ("push", Wrench((1.0, 2.0, 3.0), (0.1, 0.0, -0.1), "world", 0)),
    ("push", Wrench((float("nan"), 0.0, 0.0), (0.0, 0.0, 0.0), "body", 100_000_000)),
    ("robot/turn", Wrench((0.0, 0.0, 0.0), (0.3, 0.2, 0.1), "", 333_333_333)),
    ("robot/turn", Wrench((0.0, 0.0, 0.0), (0.1, 0.2, 0.1), "", 333_333_333)),
    ("push", Wrench((-0.0, 1.0, 0.0), (0.0, 0.0, 0.0), "jet", 333_333_333)),
    ("push", Wrench((0.0, 1.0, 0.0), (0.0, 0.0, 0.0), "nowhere", 400_000_000)),
    ("push", Wrench((0.0, 2.0, 0.0), (0.0, 0.0, 0.0), "body", 1_999_999_999)),
]
WHEEL = "type: reaction_wheel, name: w, axis: [0, 0, 1], inertia: 0.01, speed: 1, friction: {coulomb: 0.03}"
ENERGY, ODOM = "energy/defect is T - T₀ - W", "/odom repeats pose and twist"
MOMENTA = "momenta fit pose, twist and inertia"
APPLIED, FITS = "applied wrenches fit the commands", "log fits its scene"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("own") / "run.mcap"
    simulate(parse_scene(TEXT), COMMANDS, [McapSink(path)])
    return path


def failed(path: Path) -> dict[str, str]:
    return {check.name: check.detail for check in inspect(path).summary.checks if not check.passed}


def scaled(topic: str, factor: float, first: int = 0, last: int = 99) -> Callable[[Message], Message]:
    """Return an edit that multiplies the numbers from `first` to before `last` of every message on `topic`."""

    def edit(message: Message) -> Message:
        if message.channel.topic != topic:
            return message
        kind = message.channel.type_name
        layout, values = cdr.LAYOUTS[kind], cdr.decode(kind, message.data)
        numbers = [x * factor if first <= i < last else x for i, x in enumerate(cdr.numbers(layout, values))]
        return message._replace(data=cdr.encode(kind, *cdr.with_numbers(layout, values, iter(numbers))))

    return edit


def nothing(message: Message) -> Message:
    return message


@pytest.mark.parametrize(
    ("change", "facts", "expected"),
    [
        (nothing, {}, set()),
        (scaled("/odom", 1.5), {}, {ODOM}),
        (scaled("/odom", 1.0 + 1e-15, 43), {}, {ODOM}),
        (scaled("/pose", 1.01, 0, 3), {}, {ODOM}),
        (scaled("/inertia", 1.5), {}, {MOMENTA, FITS}),
        (scaled("/inertia", 1.1, 9, 10), {}, {MOMENTA, FITS}),
        (scaled("/angular_momentum", 1.01), {}, {MOMENTA}),
        (scaled("/linear_momentum", 1.0 + 1e-10), {}, {MOMENTA}),
        (scaled("/energy/kinetic", 1.01), {}, {ENERGY, MOMENTA}),
        (scaled("/energy/work", 1.01), {}, {ENERGY}),
        (scaled("/energy/defect", 1e-3), {}, {ENERGY}),
        (scaled("/twist", 1.01), {}, {ODOM, MOMENTA, FITS}),
        (scaled("/push/applied", 1.1), {}, {APPLIED}),
        (scaled("/push", 1.1), {}, {APPLIED}),
        (scaled("/effects/uniform_gravity/applied", 1.1), {}, {APPLIED}),
        (nothing, {"method": "exact"}, {FITS}),
        (nothing, {"end_time_ns": "9000000000"}, {FITS}),
        (nothing, {"end_time_ns": "1900000000"}, {FITS}),
    ],
)
def test_what_contradicts_itself_fails(
    log: Path, tmp_path: Path, change: Any, facts: dict[str, str], expected: set[str]
) -> None:
    # Impulses of what was changed balance no longer, where they are known.
    found = failed(edited(log, tmp_path / "edited.mcap", change, facts))
    assert {name for name in found if "balance" not in name} == expected


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("mass: 2", "mass: 3", "SHA-256"),
        ("mass: 2", "mass: 3", "the same mass"),
        ("[0, -0.2, 2.5]", "[0, -0.2, 2.6]", "the same inertia"),
        ("[0.1, 0, 0.2]", "[0.1, 0, 0.3]", "the same centre of mass"),
        ("[0.1, 2, 0.1]", "[0.1, 2, 0.2]", "the first angular velocity"),
        ("[1, 2, 3]", "[1, 2, 4]", "the first velocity"),
        ("{x: 0.6, y: 0, z: 0, w: 0.8}", "{x: 0.8, y: 0, z: 0, w: 0.6}", "the first attitude"),
        ("initial: {", "initial: {position_world: [1, 0, 0], ", "the first position"),
        ("wrenches: [", "wrenches: [{topic: third}, ", "/third, /third/applied of the scene are not in the log"),
        ("output_rate: 30", "output_rate: 31", "where none is due"),
        ("output_rate: 30", "output_rate: 60", "are missing: 60 Hz were due"),
        ("duration: 2", "duration: 1", "the scene at 1000000000 ns"),
    ],
)
def test_another_scene_fails(log: Path, tmp_path: Path, old: str, new: str, words: str) -> None:
    """Its hash is adapted, except where the hash is under test."""
    from hashlib import sha256

    assert old in TEXT
    scene = TEXT.replace(old, new).encode()
    facts = {} if words == "SHA-256" else {"scene_sha256": sha256(scene).hexdigest()}
    assert words in failed(edited(log, tmp_path / "edited.mcap", facts=facts, scene=scene))[FITS]


def test_what_is_missing_amid_the_samples_fails(log: Path, tmp_path: Path) -> None:
    def without(topics: set[str]) -> Callable[[Message], Message | None]:
        return lambda message: (
            None if message.channel.topic in topics and message.log_time == 1_000_000_000 else message
        )

    samples = {"/pose", "/twist", "/odom", "/tf", "/angular_momentum", "/linear_momentum"}
    samples |= {"/energy/kinetic", "/energy/work", "/energy/defect", "/energy/potential"}
    assert "are missing: 30 Hz" in failed(edited(log, tmp_path / "a.mcap", without(samples)))[FITS]
    found = failed(edited(log, tmp_path / "b.mcap", without({"/odom"})))
    assert "60 messages" in found[ODOM]
    assert "/odom has other times than /pose" in found[FITS]


def test_a_drop_at_another_time_than_the_timeout_fails(log: Path, tmp_path: Path) -> None:
    drop = 683_333_333

    def later(message: Message) -> Message:
        if message.channel.topic != "/push/applied" or message.log_time != drop:
            return message
        kind, at = message.channel.type_name, drop + 5
        _, *rest = cdr.decode(kind, message.data)
        return message._replace(log_time=at, publish_time=at, data=cdr.encode(kind, at, *rest))

    assert set(failed(edited(log, tmp_path / "edited.mcap", later))) == {APPLIED}


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("output_rate: 30", "output_rate: 0"),
        ("output_rate: 30", "output_rate: 7.123456"),
        ("output_rate: 30", "output_rate: 0.3"),
        (
            "{type: linear_drag, translation: 0.1}",
            "{type: rotor, axis_body: [0, 0.6, 0.8], axial_inertia: 0.1, spin_rate: 300}",
        ),
        ("mass: 2, center_of_mass: [0.1, 0, 0.2]", "mass: 2.0e+3, center_of_mass: [1, 0, 2]"),
        ("initial: {", "initial: {position_world: [1.0e9, -1.0e12, 3], "),
    ],
)
def test_a_genuine_log_does_not_fail(tmp_path: Path, old: str, new: str) -> None:
    assert old in TEXT
    text = TEXT.replace(old, new)
    simulate(
        parse_scene(text), COMMANDS, [McapSink(tmp_path / "a.mcap", "/ns"), BagSink(tmp_path / "b", max_duration_s=0.6)]
    )
    for name in ("a.mcap", "b"):
        assert not {ENERGY, "/ns" + ODOM, ODOM, MOMENTA, APPLIED, FITS} & failed(tmp_path / name).keys()


def test_one_wrench_is_not_several(tmp_path: Path) -> None:
    text = "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: push}]\nduration: 1"
    simulate(parse_scene(text), [("push", Wrench((1.0, 0.0, 0.0)))], [McapSink(tmp_path / "run.mcap")])
    (found,) = [check for check in inspect(tmp_path / "run.mcap").summary.checks if check.name == APPLIED]
    assert (found.passed, found.detail) == (True, "1 wrench")


def test_a_huge_command_that_was_followed_at_once_is_none_without_a_cause(tmp_path: Path) -> None:
    huge = [("push", Wrench((x, 0.0, 0.0), frame_id="body", stamp_ns=7)) for x in (1e100, 1.0)]
    text = "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: push}]\nduration: 1"
    simulate(parse_scene(text), huge, [McapSink(tmp_path / "run.mcap")])
    assert not {APPLIED, FITS} & failed(tmp_path / "run.mcap").keys()


def test_a_particle_and_what_was_cut_off_do_not_contradict_themselves(log: Path, tmp_path: Path) -> None:
    text = "body: {mass: 2}\ninitial: {linear_velocity_world: [1, 2, 3]}\nduration: 1"
    simulate(parse_scene(text), [], [McapSink(tmp_path / "particle.mcap")])
    assert not failed(tmp_path / "particle.mcap")
    for percent in (50, 90, 99):
        cut = tmp_path / f"cut{percent}.mcap"
        data = log.read_bytes()
        cut.write_bytes(data[: len(data) * percent // 100])
        recover(cut, tmp_path / "recovered.mcap")
        for path in (cut, tmp_path / "recovered.mcap"):
            assert set(failed(path)) <= {"file is whole", "recording has all its parts"}


def test_a_fingerprint_is_of_every_bit(log: Path) -> None:
    kind, rng = "nav_msgs/msg/Odometry", np.random.default_rng(0)
    rows = rng.normal(size=(50, 13))
    rows[::2] = rows[0]
    for k in range(13):
        rows[2 * k + 2, k] = np.nextafter(rows[0, k], 9.0)
    kept, alone = Topic("/odom", kind), Topic("/odom", kind, keeps=False)
    from bag_rows import add

    for k, row in enumerate(rows.tolist()):
        data = cdr.encode(kind, k, "world", "body", row[:7], (0.0,) * 36, row[7:], (0.0,) * 36)
        add(kept, k, data)
        add(alone, k, data)
    whole = slice(None)
    assert np.array_equal(kept.fingerprints(whole), alone.fingerprints(whole))
    assert alone.numbers.shape == (50, 0)
    assert alone.stamps.tolist() == list(range(50))
    same = kept.fingerprints(whole) == kept.fingerprints(whole)[0]
    assert same[28::2].all()
    for k in range(13):
        assert same[2 * k + 2].tolist() == [k >= 7, k < 7]


@pytest.mark.parametrize("factor", [1.0, 1.0 + 1e-9])
def test_momenta_are_checked_in_blocks(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, factor: float
) -> None:
    """With the same result; at once, what is computed takes more memory than all numbers of a long log."""
    other = tmp_path / "other.mcap"
    edited(log, other, scaled("/linear_momentum", factor))
    details = []
    for size in (100, 61, 60, 7, 1):
        monkeypatch.setattr(own_log_consistency, "_BLOCK", size)
        details += [check.detail for check in inspect(other).summary.checks if check.name == MOMENTA]
    assert len(details) == 5
    assert len({*details}) == 1

    count = 20_000
    track = read_track(read_bag(log))
    assert track.pose is not None
    assert track.twist is not None
    assert track.body is not None
    times = np.arange(count)
    pose, twist = (
        replace(each, time_ns=times, values=np.resize(each.values, (count, each.values.shape[1])))
        for each in (track.pose, track.twist)
    )
    errors = own_log_consistency._Errors(np.inf)
    logged = {"angular": (TimeSeries("", times, np.zeros((count, 3))), errors)}
    monkeypatch.setattr(own_log_consistency, "_BLOCK", 1000)
    tracemalloc.start()
    try:
        own_log_consistency._add_errors(track, pose, twist, track.body, logged)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert errors.worst > 0.0
    assert peak < 40 * count


def test_commands_of_one_time_in_a_log_of_this_package_are_no_clock_that_stands(tmp_path: Path) -> None:
    """A node that is paused takes all at one simulation time; inspect failed its log."""
    scene = parse_scene("body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: push}]\nduration: 1\n")
    commands = [("push", Wrench((float(k), 0.0, 0.0))) for k in range(5)]
    simulate(scene, commands, [McapSink(tmp_path / "run.mcap")])
    assert inspect(tmp_path / "run.mcap").passed


@pytest.mark.parametrize(
    ("keys", "until_ns"),
    [
        ("sensors: [{type: imu, name: imu, rate: 33}]", 95_000_000),
        ("sensors: [{type: imu, name: imu, rate: 33, delay: 0.5}]", 95_000_000),
        (f"actuators: [{{{WHEEL}}}]", 330_000_000),
    ],
)
@pytest.mark.parametrize("setting", ["step: 0.01", "accuracy: 1.0e-9"])
def test_a_run_that_stopped_within_a_step_that_is_an_output(
    tmp_path: Path, keys: str, until_ns: int, setting: str
) -> None:
    """It ends where a sensor measured or a wheel came to rest, after the last sample; inspect failed its log."""
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 2.5]}}\ninitial: {angular_velocity_body: [0.3, -0.2, 0.1]}\n"
        f"solver: {{method: dop853, {setting}}}\noutput_rate: 0\n{keys}\n"
    )
    path = tmp_path / "run.mcap"
    run = Simulation(scene, [McapSink(path)])
    run.start()
    # A wheel comes to rest at 0.3294 s.
    run.advance(until_ns - 1)
    run.finish()
    assert run.time_ns > int(read_bag(path).topics["/pose"].log_times[-1])
    assert not failed(path)


def test_long_steps_that_are_outputs_are_no_gaps(tmp_path: Path) -> None:
    """Commands cut the first steps short; inspect called the long ones after them gaps."""
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 2.5]}}\ninitial: {angular_velocity_body: [0.3, -0.2, 0.1]}\n"
        "solver: {method: dop853, accuracy: 1.0e-9}\noutput_rate: 0\nduration: 10\n"
    )
    commands = [("wrench", Wrench(torque=(0.1, 0.0, 0.0), stamp_ns=ns)) for ns in range(0, 300_000_000, 1_000_000)]
    path = tmp_path / "run.mcap"
    simulate(scene, commands, [McapSink(path)])
    found = inspect(path).summary
    assert [check.name for check in found.checks if not check.passed] == []
    assert not any("gap" in warning for warning in found.warnings)


def test_a_command_that_waits_where_a_scene_goes_on(tmp_path: Path) -> None:
    """It acts after the delay of its channel; inspect took it to be held from the start, and failed the log."""
    first, then = tmp_path / "first.mcap", tmp_path / "then.mcap"
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: push, delay: 0.4}]\nduration: 3\n"
    )
    commands = [("push", Wrench((x, 0.0, 0.0), stamp_ns=at)) for x, at in ((1.0, 500_000_000), (2.0, 1_000_000_000))]
    simulate(scene, commands, [McapSink(first)])
    simulate(parse_scene(scene_at(first, 1_200_000_000).text), sinks=[McapSink(then)])
    assert not failed(then)
    # Its effect is no timeout.
    assert not any("timed out" in warning for warning in inspect(then).summary.warnings)
    assert set(failed(edited(then, tmp_path / "wrong.mcap", scaled("/push/applied", 1.1)))) >= {APPLIED}


def test_commands_whose_delay_ends_where_a_scene_goes_on(tmp_path: Path) -> None:
    """The log has each of them, and what they replace; inspect knew the last alone, and took a zero for a timeout."""
    first, then = tmp_path / "first.mcap", tmp_path / "then.mcap"
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: push, delay: 0.4}]\nduration: 3\n"
    )
    pushes = ((1.0, 500_000_000), (2.0, 800_000_000), (0.0, 800_000_000), (3.0, 800_000_000), (0.0, 900_000_000))
    simulate(scene, [("push", Wrench((x, 0.0, 0.0), stamp_ns=at)) for x, at in pushes], [McapSink(first)])
    simulate(parse_scene(scene_at(first, 1_200_000_000).text), sinks=[McapSink(then)])
    assert not failed(then)
    assert not any("timed out" in warning for warning in inspect(then).summary.warnings)
    assert set(failed(edited(then, tmp_path / "wrong.mcap", scaled("/push/applied", 1.1)))) >= {APPLIED}


def test_a_command_that_comes_where_a_scene_goes_on_and_another_expires(tmp_path: Path) -> None:
    """A node logs that timeout before the command; inspect knew no cause of it, and failed the log."""
    first, then = tmp_path / "first.mcap", tmp_path / "then.mcap"
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: push, timeout: 0.5}]\nduration: 3\n"
    )
    simulate(scene, [("push", Wrench((1.0, 0.0, 0.0)))], [McapSink(first)])
    run = Simulation(parse_scene(scene_at(first, 500_000_000).text), [McapSink(then)])
    run.start()
    run.advance(0)
    run.post("push", Wrench((2.0, 0.0, 0.0)), 0)
    run.advance(1_000_000_000)
    run.finish()
    assert not failed(then)


def test_a_command_at_the_time_at_which_a_scene_goes_on(tmp_path: Path) -> None:
    """Its timeout begins there; inspect counted it from the command before, and failed the log."""
    first, then = tmp_path / "first.mcap", tmp_path / "then.mcap"
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1, 2, 3]}}\nwrenches: [{topic: push, timeout: 0.5}]\nduration: 3\n"
    )
    simulate(scene, [("push", Wrench((1.0, 0.0, 0.0)))], [McapSink(first)])
    rest = parse_scene(scene_at(first, 400_000_000).text)
    simulate(rest, [("push", Wrench((2.0, 0.0, 0.0)))], [McapSink(then)])
    assert not failed(then)
