"""What a bag of another program says, as `identify` takes it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_rows import STAMPED, add, stamped, write_rows
from identified_flights import flown, guess, random_body
from noisy_recordings import recording
from tumbling import POSE, SPIN_AXIS, TWIST, bag_of, failing, fill, spin

from rb_dynamics import (
    Channel,
    LogError,
    ReactionWheel,
    RigidBody,
    Scene,
    SceneError,
    Setpoint,
    Simulation,
    State,
    Wrench,
    identify,
    parse_scene,
    simulate,
)
from rb_dynamics.analysis.identification.flights import (
    ACCELERATION,
    ATTITUDE,
    NO_WRENCH,
    POSITION,
    RATES,
    VELOCITY,
    Flight,
    Stream,
    WrenchSeries,
    flight_of,
    read_flight,
)
from rb_dynamics.analysis.read_track import TopicChoice, read_track
from rb_dynamics.analysis.summary import EXPLAINS, summarize
from rb_dynamics.cli import main
from rb_dynamics.formats import cdr
from rb_dynamics.formats.log_metadata import DAMAGED, INTERRUPTED
from rb_dynamics.formats.merging import merge
from rb_dynamics.formats.message_types import SCALAR
from rb_dynamics.logs.bag_reader import Bag, Topic, read_bag
from rb_dynamics.numerics.rotation_arrays import product, rotate_all_inverse
from rb_dynamics.run.state_change import StateChange
from rb_dynamics.sinks.mcap_sink import McapSink

IMU = "sensor_msgs/msg/Imu"


def imu_bag(flight: Flight) -> Bag:
    """Return a bag with the rates of `flight` in an IMU that measures nothing else."""
    topic, unknown = Topic("/imu", IMU), (-1.0, *[0.0] * 8)
    stream = flight.streams[0]
    for stamp, rate in zip(stream.time_ns.tolist(), stream.values.tolist(), strict=True):
        nothing = (unknown[:1], unknown[1:])
        data = cdr.encode(
            IMU, stamp + 10**9, "imu", (0.0, 0.0, 0.0, 1.0), *nothing, rate, (0.0,), [0.0] * 8, [0.0] * 3, *nothing
        )
        add(topic, stamp + 10**9, data)
    return Bag(Path("imu.mcap"), True, {topic.name: topic}, {}, {})


def test_motion_between_samples_that_cannot_be_told_is_refused_before_the_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of times in milliseconds that are called seconds; one sensor that is fast enough tells what others miss."""
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
    made = flown(body, np.random.default_rng(3), seconds=20.0, spin=(0.3, 3.0, 0.5), gyro=1e-3, pose=1e-3)
    rates, attitude, _ = made.streams
    slow_rates = replace(rates, time_ns=1000 * rates.time_ns)
    slow_attitude = replace(attitude, time_ns=1000 * attitude.time_ns)
    few = slice(None, None, 300)
    rare = replace(attitude, time_ns=attitude.time_ns[few], values=attitude.values[few])
    for streams in ((rates,), (attitude,), (attitude, rates), (slow_attitude, rates), (slow_attitude,)):
        replace(made, streams=streams).require_dense()
    monkeypatch.setattr("rb_dynamics.analysis.identification.identify.fitted", None)
    for wrong in ((slow_rates,), (slow_attitude, slow_rates), (rare,)):
        flight = replace(made, streams=wrong)
        with pytest.raises(
            LogError, match=r"^flight: .* at most .* check that times are in sec.*; or record (\d+|several) "
        ):
            identify(guess(body), [flight])
        with pytest.raises(LogError, match="its motion is ambiguous"):
            identify(guess(body), [made], validate=[flight])


def test_topics_of_a_bag_can_be_chosen(tmp_path: Path) -> None:
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
    bags = [imu_bag(flown(body, np.random.default_rng(k), seconds=1.0, spin=(0.3, 3.0, 0.5))) for k in (1, 2)]
    bag, other = bags[0], bags[1].topics["/imu"]
    other.name = "/other"
    bag.topics["/other"] = other
    for choice, topic in ((None, "/imu"), (TopicChoice(twist="/other"), "/other")):
        assert [stream.topic for stream in flight_of(bag, guess(body), topics=choice).streams] == [topic]
    with pytest.raises(LogError, match="/none"):
        flight_of(bag, guess(body), topics=TopicChoice(twist="/none"))
    # Wrenches are those of the bags of commands, where some are given.
    commands = write_rows(tmp_path / "c.mcap", [(name, STAMPED, 10**9, stamped(10**9, 1.0)) for name in ("/a", "/b")])
    wanted = TopicChoice(wrenches=("/b",))
    assert [each.topic for each in flight_of(bag, guess(body), [str(commands)], wanted).channels] == ["/b"]


SENSED = """
body:
  mass: 2
  inertia: {diagonal: [0.02, 0.03, 0.04]}
  frames: {box: {position: [0.1, 0, 0], orientation: {x: 0.6, y: 0, z: 0, w: 0.8}}}
initial: {angular_velocity_body: [0.3, -0.2, 0.4]}
wrenches: [{topic: push}]
sensors:
  - {type: imu, name: imu, frame: box, rate: 100, gyro: {noise_density: 1.0e-5}, accelerometer: {noise_density: 1.0e-4}}
  - {type: pose, name: cam, frame: box, rate: 50, position_noise: 1.0e-3, orientation_noise: 1.0e-3}
  - {type: star_tracker, name: tracker, frame: box, rate: 20, noise: 1.0e-4}
duration: 2
output_rate: 10
"""
PUSHED = [
    ("push", Wrench((0.1 * (-1) ** i, 0.0, 0.2), (0.01, 0.02 * (-1) ** i, 0.01), "body", i * 10**8)) for i in range(20)
]


@pytest.mark.parametrize(
    ("choice", "taken"),
    [
        (None, {"/pose", "/twist"}),
        (TopicChoice(pose="pose", twist="/twist"), {"/pose", "/twist"}),
        (TopicChoice(twist="imu"), {"/imu"}),
        (TopicChoice(pose="/cam"), {"/cam"}),
        (TopicChoice(pose="/cam", twist="/imu"), {"/cam", "/imu"}),
        (TopicChoice(pose="tracker", twist="/imu"), {"/tracker", "/imu"}),
        (TopicChoice(pose="/odom"), {"/odom"}),
    ],
)
def test_of_a_log_of_this_package_the_sensors_that_are_chosen_count_without_its_true_motion(
    tmp_path: Path, choice: TopicChoice | None, taken: set[str]
) -> None:
    """The true motion was fitted whatever was chosen."""
    scene = parse_scene(SENSED)
    simulate(scene, PUSHED, [McapSink(tmp_path / "a.mcap")])

    flight = read_flight(str(tmp_path / "a.mcap"), scene, topics=choice)
    assert {each.topic for each in flight.streams} == taken
    (channel,) = flight.channels
    assert len(channel.time_ns) == 20

    found = identify(scene, [flight], ["inertia"])
    for number in found.parameters:
        if number.name.startswith("inertia."):
            i, j = ("xyz".index(axis) for axis in number.name[-2:])
            assert number.standard_error is not None
            assert abs(number.value - scene.body.inertia[i][j]) < 4.0 * number.standard_error


def test_the_scene_says_where_a_sensor_of_a_bag_of_others_is_mounted(tmp_path: Path) -> None:
    """As of a node that `ros2 bag record` recorded: its pose was taken for that of the body."""
    scene = parse_scene(SENSED.replace("_noise: 1.0e-3", "_noise: 0").replace("noise: 1.0e-4", "noise: 0"))
    simulate(scene, PUSHED, [McapSink(tmp_path / "a.mcap")])
    bag = replace(read_bag(str(tmp_path / "a.mcap")), metadata={}, attachments={})
    true = flight_of(bag, scene, topics=TopicChoice(pose="/pose", alone=True))
    for topic, kinds in (("/cam", {ATTITUDE, POSITION}), ("/tracker", {ATTITUDE})):
        seen = flight_of(bag, scene, topics=TopicChoice(pose=topic, alone=True))
        assert {each.kind for each in seen.streams} == kinds
        for one, other in zip(true.streams, seen.streams, strict=False):
            rows = np.isin(other.time_ns, one.time_ns)
            assert np.abs(one.values) == pytest.approx(np.abs(other.values[rows]), abs=1e-12)


def test_errors_of_a_gyro_are_along_its_own_axes(tmp_path: Path) -> None:
    """Along those of the body, factors of a gyro that is mounted askew are a full matrix, and no scale fitted them."""
    scale, bias = (0.02, -0.02, 0.01), (0.02, -0.01, 0.03)
    askew = SENSED.replace("x: 0.6, y: 0, z: 0, w: 0.8", "x: 0.1, y: 0.7, z: -0.5, w: 0.5")
    text = askew.replace("noise_density: 1.0e-5", f"noise_density: 1.0e-5, bias: {list(bias)}, scale: {list(scale)}")
    simulate(parse_scene(text), PUSHED, [McapSink(tmp_path / "a.mcap")])
    scene = parse_scene(askew)
    flight = read_flight(str(tmp_path / "a.mcap"), scene, topics=TopicChoice(pose="/cam", twist="/imu"))

    found = identify(scene, [flight], ["inertia", "gyro_bias", "gyro_scale"])

    assert found.scene.sensors[0].gyro.bias == pytest.approx(bias, abs=4e-3)
    known = {number.name: number for number in found.parameters}
    for name, true in (("gyro_bias", bias), ("gyro_scale", tuple(1.0 + part for part in scale))):
        for axis, value in zip("xyz", true, strict=True):
            number = known[f"{name}./imu.{axis}"]
            assert number.standard_error is not None
            assert abs(number.value - value) < 4.0 * number.standard_error < 0.02


MOUNTED = """
body:
  mass: 2
  center_of_mass: [0.03, -0.02, 0.01]
  inertia: {diagonal: [0.02, 0.03, 0.04]}
  frames:
    marker: {position: [0.3, -0.2, 0.1], orientation: {x: 0.6, y: 0, z: 0, w: 0.8}}
    jet: {position: [0.1, 0.2, 0], orientation: {x: 0, y: 0.28, z: 0, w: 0.96}}
initial: {angular_velocity_body: [0.3, -0.2, 0.4]}
wrenches: [{topic: push}]
actuators: [{type: thruster, name: jet, frame: jet, force: 0.3, rise: 0.1, fall: 0.2}]
effects: [{type: scheduled_wrench, schedule: [{time: 1, force: [0, 0.3, 0], torque: [0, 0.01, 0.02]}]}]
sensors:
  - {type: pose, name: cam, frame: marker, rate: 50, position_noise: 1.0e-4, orientation_noise: 1.0e-4, dropout: LOST}
duration: 3
output_rate: 10
"""


def measured(path: Path, dropout: float = 0.0, firings: bool = True) -> Scene:
    """Write the log of a run whose pose sensor is mounted in a frame of the body; return its scene."""
    scene = parse_scene(MOUNTED.replace("LOST", f"{dropout:g}"))
    commands = [
        ("push", Wrench((0.1 * (-1) ** i, 0.0, 0.2), (0.01, 0.02 * (-1) ** i, 0.01), "body", i * 10**8))
        for i in range(30)
    ]
    pulses = [("jet/command", Setpoint(0.15, 40_000_000 + i * 600_000_000)) for i in range(5 if firings else 0)]
    simulate(scene, [*commands, *pulses], [McapSink(path)])
    return scene


@pytest.mark.parametrize("part", [False, True])
def test_the_pose_that_a_sensor_of_this_package_measures_is_that_of_its_frame(tmp_path: Path, part: bool) -> None:
    """Its messages do not name that frame: a centre of mass was found 0.3 m off, with an error of 0.1 mm."""
    log, scene = tmp_path / "a.mcap", measured(tmp_path / "a.mcap")
    if part:
        log = tmp_path / "part.mcap"
        assert main(["convert", str(tmp_path / "a.mcap"), str(log), "--to", "2.9"]) == 0
    found = identify(scene, [log], ["center_of_mass"], topics=TopicChoice(pose="cam"))
    assert np.abs(np.subtract(found.body.center_of_mass, scene.body.center_of_mass)).max() < 5e-4
    assert found.explained


def test_ramps_of_thrusters_are_those_of_the_commands_where_a_sensor_is_chosen(tmp_path: Path) -> None:
    """What acted is logged at outputs alone, and was held in between: here up to 0.1 s too long."""
    scene = measured(tmp_path / "a.mcap")
    flight = read_flight(str(tmp_path / "a.mcap"), scene, topics=TopicChoice(pose="cam"))
    (jet,) = (each for each in flight.channels if "jet" in each.topic)
    force = np.linalg.norm(jet.held[:-1, :3], axis=1)
    # Half of either ramp counts as full force.
    assert np.dot(force, np.diff(jet.time_ns) * 1e-9) == pytest.approx(5 * 0.3 * (0.15 - 0.05 + 0.1), rel=1e-9)


def test_times_of_a_log_of_this_package_are_those_of_its_run_where_the_first_samples_are_lost(tmp_path: Path) -> None:
    """What the scene schedules came later by as much as was lost."""
    scene = measured(tmp_path / "a.mcap", dropout=0.8, firings=False)
    flight = read_flight(str(tmp_path / "a.mcap"), scene, topics=TopicChoice(pose="cam"))
    assert flight.zero_ns == 0 < flight.span_ns[0]


def test_what_is_missing_of_a_log_of_this_package_is_missing_where_a_sensor_is_chosen(tmp_path: Path) -> None:
    scene = measured(tmp_path / "a.mcap", firings=False)
    bag = read_bag(str(tmp_path / "a.mcap"), repeated=True)
    bag.metadata[INTERRUPTED] = {"reason": DAMAGED, "missing_ns": "1000000000 1500000000"}
    with pytest.raises(LogError, match="a piece of the recording is missing"):
        flight_of(bag, scene, topics=TopicChoice(pose="cam"))


def test_gyro_alone_tells_ratios_and_its_bias() -> None:
    body, bias = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04)), np.array([0.02, -0.01, 0.03])
    random = np.random.default_rng(3)
    made = flown(body, random, seconds=6.0, spin=(0.3, 3.0, 0.5), gyro=1e-3, bias=bias)
    flight = flight_of(imu_bag(made), guess(body))
    found = identify(guess(body), [flight], ["inertia_ratios", "gyro_bias"])

    assert [(stream.kind, stream.gyro) for stream in flight.streams] == [(RATES, True)]
    assert flight.span_ns[0] == 0
    assert found.passed
    for each in found.parameters:
        if each.name.startswith("gyro_bias"):
            assert each.standard_error is not None
            assert abs(each.value - bias["xyz".index(each.name[-1])]) < 5.0 * each.standard_error


def test_a_bias_of_a_gyro_breaks_no_balance() -> None:
    """The momentum of such rates is none of the body, and it was said not to be conserved."""
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
    random = np.random.default_rng(3)
    made = flown(body, random, seconds=6.0, spin=(0.3, 3.0, 0.5), gyro=1e-3, pose=1e-3, bias=(0.05, -0.04, 0.03))
    bag = imu_bag(made)
    _, attitude, position = made.streams
    bag.topics["/pose"] = Topic("/pose", POSE)
    fill(bag.topics["/pose"], attitude.time_ns + 10**9, "world", np.hstack([position.values, attitude.values]), 0)
    bag.topics["/w"] = Topic("/w", STAMPED)
    add(bag.topics["/w"], 10**9, cdr.encode(STAMPED, 10**9, "world", [0.0] * 6))
    summary = summarize(read_track(bag, rigid(body)))
    assert summary.passed
    told = next(check.detail for check in summary.checks if check.name == "angular momentum balance")
    assert "/imu has a constant error, as gyros have, with which the inertia explains the motion" in told


def test_a_bag_of_pose_twist_and_commands_tells_the_body() -> None:
    made = next(each for each in map(recording, range(20)) if each.facts["commanded"] and each.facts["with_pose"])
    flight = flight_of(made.bag, made.scene(moments=1.5, mass=1.5))
    found = identify(made.scene(moments=1.5, mass=1.5), [flight], ["inertia", "mass"])

    assert {stream.kind for stream in flight.streams} == {ATTITUDE, POSITION, RATES, VELOCITY}
    assert found.passed
    np.testing.assert_allclose(
        found.body.inertia, made.body.inertia, rtol=0.0, atol=0.1 * max(made.body.principal_moments)
    )
    assert found.body.mass == pytest.approx(made.body.mass, rel=0.1)


def test_a_bag_with_too_few_samples_is_refused() -> None:
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
    made = flown(body, np.random.default_rng(4), seconds=0.1)
    with pytest.raises(LogError, match="found 3 samples of the motion, expected at least 4"):
        flight_of(imu_bag(made), guess(body)).until(2 * 10**7)


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        (
            {"actuators": (ReactionWheel(name="wheel", axis=(0.0, 0.0, 1.0), inertia=1e-4),)},
            "actuators: found wheel, expected none",
        ),
        ({"channels": (Channel("push", bias_torque=(0.0, 0.0, 1e-3)),)}, "found a bias of push, expected none"),
    ],
)
def test_what_would_be_taken_for_a_torque_is_refused(part: dict[str, object], expected: str) -> None:
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
    made = flown(body, np.random.default_rng(3), seconds=1.0, spin=(0.3, 3.0, 0.5), gyro=1e-3)
    with pytest.raises(SceneError, match=expected):
        identify(replace(guess(body), **part), [made], ["inertia_ratios"])


def test_commands_to_actuators_that_the_scene_does_not_have_are_named() -> None:
    """A bag of a body with wheels was fitted without a word about their commands."""
    bag = bag_of(spin(0.0))
    bag.topics["/wheel/command"] = Topic("/wheel/command", SCALAR)
    scene = guess(RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04)))
    told = "/wheel/command: taken for commands to actuators, which the scene does not have"
    assert told in flight_of(bag, scene).notes
    bag.topics["/battery"] = bag.topics.pop("/wheel/command")
    assert not any("actuators" in note for note in flight_of(bag, scene).notes)


def test_commands_act_after_the_delay_of_their_channel() -> None:
    made = next(each for each in map(recording, range(20)) if each.facts["commanded"] and each.facts["with_pose"])
    scene = made.scene(moments=1.0, mass=1.0)
    late = replace(scene, channels=tuple(replace(channel, delay=0.125) for channel in scene.channels))
    for prompt, delayed in zip(flight_of(made.bag, scene).channels, flight_of(made.bag, late).channels, strict=True):
        assert (delayed.time_ns == prompt.time_ns + 125_000_000).all()


def test_gravity_in_a_log_of_this_package_does_not_act_twice(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    gravity = "effects: [{type: uniform_gravity, acceleration_world: [0, 0, -9.8]}]\n"
    text = f"body: {{mass: 2, inertia: {{diagonal: [1, 2, 3]}}}}\n{gravity}wrenches: [{{topic: push}}]\nduration: 0.1\n"
    for namespace in ("", "a"):
        simulate(parse_scene(text), [("push", Wrench((1.0, 0.0, 0.0)))], [McapSink(path, namespace=namespace)])
        flight = flight_of(read_bag(path), parse_scene(text))
        assert [channel.topic.rpartition("/")[2] for channel in flight.channels] == ["push"]


def test_a_log_whose_body_was_moved_is_fitted_piece_by_piece(tmp_path: Path) -> None:
    """No motion leads across a set_state, and it was looked for in a torque or a sensor."""
    scene = parse_scene(
        "body: {mass: 2, inertia: {diagonal: [1.2, 2, 2.7]}}\ninitial: {angular_velocity_body: [0.3, -0.5, 0.4]}\n"
        "wrenches: [{topic: a}]\nduration: 10\noutput_rate: 20\n"
    )
    run = Simulation(scene, [McapSink(tmp_path / "run.mcap")])
    run.start()
    run.post("a", Wrench((0.0, 0.0, 0.0), (0.2, -0.1, 0.3)), 1_000_000_000)
    run.advance(5_000_000_000)
    run.set_state(StateChange.to(State(0, angular_velocity_body=(-0.4, 0.1, 0.6)), scene.body).at(5_000_000_000))
    run.advance(10_000_000_000)
    run.finish()
    # The messages of a log, as a bag.
    assert main(["convert", str(tmp_path / "run.mcap"), str(tmp_path / "bag.mcap")]) == 0
    for name in ("run.mcap", "bag.mcap"):
        found = identify(guess(scene.body), tmp_path / name, ["inertia"])
        assert found.explained
        assert found.passed
        np.testing.assert_allclose(found.body.inertia, scene.body.inertia, rtol=0.0, atol=1e-5)
        assert sum("moved to another state (set_state) at 5 s" in note for note in found.notes) == 1
        summary = summarize(read_track(read_bag(tmp_path / name), scene))
        assert summary.passed
        assert any("(set_state) at t = 5 s" in note for note in summary.notes)
    assert summary.residual is not None
    assert summary.residual.explained
    assert next(check for check in summary.checks if check.name == EXPLAINS).judged


JET = """\
body:
  mass: 10.0
  center_of_mass: [0.03, -0.02, 0.04]
  inertia: {diagonal: [0.3, 0.4, 0.5]}
  frames: {jet: {position: [0.2, 0.1, -0.1]}}
initial: {angular_velocity_body: [0.2, -0.3, 0.1]}
wrenches: [{topic: cmd, max_force: 1.5, on_excess: ON_EXCESS}]
duration: 4.0
output_rate: 50.0
"""


def thrust_bag(path: Path, scene: Scene, strange: int = 1) -> Bag:
    """Return a flight by a jet as another program records it, with `strange` commands in a frame that nobody knows."""
    forces = [(1.0, 0.0, 0.0), (0.0, 1.2, 0.0), (0.0, 0.0, 3.0), (-1.0, 1.0, 0.0), (0.0, -2.0, 1.0), (1.0, 0.0, -1.0)]
    commands = [(round(k * 6e8), "jet", force) for k, force in enumerate(forces)]
    commands += [(round(k * 1e8) + 5, "nozzle", (0.5, 0.5, 0.5)) for k in range(1, 1 + strange)]
    sent = [("cmd", Wrench(force, (0.0, 0.0, 0.0), frame, stamp)) for stamp, frame, force in commands]
    simulate(scene, sent, [McapSink(path)])
    topics = {name: topic for name, topic in read_bag(path).topics.items() if name in ("/pose", "/twist")}
    topics["/cmd"] = Topic("/cmd", STAMPED)
    for stamp, frame, force in commands:
        add(topics["/cmd"], stamp, cdr.encode(STAMPED, stamp, frame, (*force, 0.0, 0.0, 0.0)))
    return Bag(path, True, topics, {}, {})


@pytest.mark.parametrize("on_excess", ["clip", "reject"])
def test_jets_turn_the_body_about_the_center_of_mass_that_is_fitted(tmp_path: Path, on_excess: str) -> None:
    """And the channel keeps to its limits, and to its frames, as in a run."""
    scene = parse_scene(JET.replace("ON_EXCESS", on_excess))
    rough = parse_scene(scene.text, "rough", {"body.center_of_mass": [0.0, 0.0, 0.0], "body.mass": 9.0})
    flight = flight_of(thrust_bag(tmp_path / "flown.mcap", scene), rough)
    found = identify(rough, [flight], ["mass", "center_of_mass", "inertia"])

    assert found.body.mass == pytest.approx(10.0, rel=1e-6)
    np.testing.assert_allclose(found.body.center_of_mass, scene.body.center_of_mass, atol=1e-7)
    np.testing.assert_allclose(found.body.inertia, scene.body.inertia, atol=1e-6)
    changed = {"clip": "clipped to", "reject": "rejected by"}[on_excess]
    assert any(f"/cmd: 2 of 7 commands are {changed} the limits" in note for note in flight.notes)
    assert any("wrenches on /cmd are damaged" in note and "taken as rejected" in note for note in flight.notes)


def test_scheduled_jets_do_too(tmp_path: Path) -> None:
    schedule = "[{time: 0, force: [1, 0, 0]}, {time: 1, force: [0, 1, 0]}, {time: 2, force: [0, 0, 1]}]"
    effect = f"effects: [{{type: scheduled_wrench, frame_id: jet, schedule: {schedule}}}]\n"
    scene = parse_scene(JET.replace("ON_EXCESS", "clip") + effect)
    rough = parse_scene(scene.text, "rough", {"body.center_of_mass": [0.0, 0.0, 0.0]})
    bag = thrust_bag(tmp_path / "flown.mcap", scene)
    found = identify(rough, [flight_of(bag, rough)], ["center_of_mass", "inertia"])
    np.testing.assert_allclose(found.body.center_of_mass, scene.body.center_of_mass, atol=1e-7)
    np.testing.assert_allclose(found.body.inertia, scene.body.inertia, atol=1e-6)


def test_commands_in_frames_that_nobody_knows_are_refused_if_there_are_many(tmp_path: Path) -> None:
    scene = parse_scene(JET.replace("ON_EXCESS", "clip"))
    with pytest.raises(LogError, match=r"2 of 8 wrenches on /cmd are damaged or in a frame .*frames: jet, nozzle"):
        flight_of(thrust_bag(tmp_path / "flown.mcap", scene, strange=2), scene)


WRONG: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any], str]] = {
    "degrees": (np.degrees, np.copy, "in degrees per second"),
    "twice converted": (np.radians, np.copy, "multiplied by 180/π"),
    "negative": (np.negative, np.copy, "with the opposite sign"),
    "a sign": (lambda rates: rates * [1.0, -1.0, 1.0], np.copy, "with (x, -y, z)"),
    "inverse": (np.copy, lambda turns: turns * [-1.0, -1.0, -1.0, 1.0], "with attitudes from world to body"),
    "wxyz": (np.copy, lambda turns: turns[:, [3, 0, 1, 2]], "with (w, x, y, z) for the (x, y, z, w)"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_rates_and_attitudes_of_two_conventions_are_refused_by_name(wrong: str) -> None:
    """A fit followed one of them, or neither, and told a body with small errors."""
    random = np.random.default_rng(3)
    flight = flown(random_body(random), random, torque=1.0, pose=1e-3, seconds=2.0)
    gyro, attitude, position = flight.streams
    of_rates, of_turns, words = WRONG[wrong]
    streams = (
        replace(gyro, values=of_rates(gyro.values)),
        replace(attitude, values=of_turns(attitude.values)),
        position,
    )

    assert flight.require_agreement() is flight
    with pytest.raises(LogError, match=re.escape(f"read {words}")):
        replace(flight, streams=streams).require_agreement()


@pytest.mark.parametrize(
    ("of_pose", "of_twist", "words"),
    [
        (1e3, 1.0, "with positions in millimetres"),
        (1.0, 1e3, "in millimetres per second"),
        (1.0, -1.0, "with the opposite sign"),
    ],
)
def test_positions_and_velocities_of_two_units_are_refused_by_name(of_pose: float, of_twist: float, words: str) -> None:
    """As inspect names them; a fit looked for a motion that follows both."""
    motion, scene = spin(noise=1e-4), guess(RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04)))
    twist = np.hstack([rotate_all_inverse(motion.orientation_xyzw, motion.velocity), motion.rate])
    assert flight_of(bag_of(motion), scene).require_agreement().notes == (NO_WRENCH,)
    twist[:, :3] *= of_twist
    bag = bag_of(replace(motion, position=of_pose * motion.position), twist_rows=twist)
    with pytest.raises(LogError, match=f"velocities of /b/twist and positions of /b/pose .* read {words} they fit"):
        flight_of(bag, scene).require_agreement()
    assert words in failing(bag)["linear velocity fits the position"]


@pytest.mark.parametrize("apart", ["a position is lacking", "attitudes at other times", "no attitude, world axes"])
def test_velocities_are_compared_with_positions_whatever_the_stamps_of_the_attitudes(apart: str) -> None:
    """Only positions with the stamps of the attitudes were compared: where a spike was left out, none."""
    motion, scene = spin(noise=1e-4), guess(RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04)))
    twist = np.hstack([rotate_all_inverse(motion.orientation_xyzw, motion.velocity), motion.rate])
    flight = flight_of(bag_of(motion, twist_rows=twist), scene)
    by_kind = {stream.kind: stream for stream in flight.streams}
    position, attitude, velocity = (by_kind[kind] for kind in (POSITION, ATTITUDE, VELOCITY))
    if apart == "a position is lacking":
        position = position.rows(np.arange(len(position.time_ns)) != 100)
    elif apart == "attitudes at other times":
        attitude = attitude.rows(np.arange(len(attitude.time_ns)) % 7 == 3)
    else:
        velocity = replace(velocity, values=motion.velocity, world=True)
    others = () if apart.startswith("no") else (attitude,)
    fitting = replace(flight, streams=(*others, position, velocity))
    assert fitting.require_agreement() is fitting
    wrong = replace(velocity, values=-velocity.values)
    with pytest.raises(LogError, match="read with the opposite sign they fit"):
        replace(flight, streams=(*others, position, wrong)).require_agreement()


def test_rates_of_another_body_than_the_attitudes_are_refused_and_those_with_a_bias_are_fitted() -> None:
    """A fit to both took long, and blamed the quaternions; of a bias, it was said that none follows."""
    random = np.random.default_rng(3)
    one, other = (random_body(random) for _ in range(2))
    quick = flown(one, random, spin=(1.0, 2.0, 0.5), pose=1e-3, seconds=6.0)
    turning = flown(other, random, spin=(-2.0, 0.3, 1.0), pose=1e-3, seconds=6.0)
    with pytest.raises(LogError, match="neither other axes or units nor a delay explain it, expected those of one"):
        replace(quick, streams=(quick.streams[0], *turning.streams[1:])).require_agreement()
    slow = flown(one, random, spin=(0.04, 0.12, -0.03), pose=1e-3, seconds=6.0, bias=(0.06, -0.06, 0.05))
    (note,) = slow.require_agreement().notes
    assert re.search(r"contradict each other by [\d.]+ %$", note)
    assert identify(guess(one), [slow], ["gyro_bias"]).explained


def test_a_sensor_that_is_late_is_named_with_what_to_fit() -> None:
    motion = spin(rate=0.5, speed=1.0)
    turning = replace(motion, rate=motion.rate * (1.0 + np.sin(3e-9 * motion.time_ns))[:, None])
    angle = 0.5e-9 * motion.time_ns + 0.5 * (1.0 - np.cos(3e-9 * motion.time_ns)) / 3.0
    half = 0.5 * angle[:, None]
    turning.orientation_xyzw = np.hstack([np.sin(half) * SPIN_AXIS, np.cos(half)])
    bag = bag_of(turning, twist=turning.moved(80_000_000))
    found = flight_of(bag, guess(RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04)))).require_agreement()
    assert any("are not of the same time: the twist lags behind the pose by 80" in note for note in found.notes)


def test_an_accelerometer_at_the_time_of_a_command_shows_which_force_is_not_known() -> None:
    times = 10_000_000 * np.arange(100)
    values = np.ones((100, 3))
    streams = tuple(Stream("/imu", kind, times, values) for kind in (RATES, ACCELERATION))
    channel = WrenchSeries("/wrench", np.array([0, 300_000_000, 505_000_000]), np.zeros((3, 15)))
    rates, force = (found := Flight("flight", streams, (channel,)).between_commands()).streams
    assert len(rates.time_ns) == 100
    assert np.array_equal(np.setdiff1d(times, force.time_ns), [0, 300_000_000])
    assert found.notes[0].startswith("2 of 100 samples of /imu acceleration have the time of a command")


def later(flight: Flight, by_ns: int, half: int) -> Flight:
    """Return the flight with all its stamps from `half` on later: a clock that was set."""
    moved = (
        replace(stream, time_ns=stream.time_ns + np.where(stream.time_ns > half, by_ns, 0)) for stream in flight.streams
    )
    return replace(flight, streams=tuple(moved))


def test_a_motion_is_not_followed_over_a_hole_far_longer_than_what_is_measured() -> None:
    """The work grew with the time, not with the samples: a clock set by a year took forever, or all the memory."""
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
    made = flown(body, np.random.default_rng(3), seconds=4.0, spin=(0.3, 3.0, 0.5), gyro=1e-3, pose=1e-3)
    assert len(made.pieces()) == len(later(made, 30 * 10**9, 2 * 10**9).pieces()) == 1
    set_once = later(made, 10**18, 2 * 10**9)
    first, second = set_once.pieces()
    assert first.span_ns[1] < 2 * 10**9 + 1
    assert second.span_ns[0] > 10**18
    assert any("nothing was measured for 1e+09 s from 2 s" in note for note in first.notes)
    found = identify(guess(body), [set_once], ["inertia_ratios"])
    assert any("nothing was measured" in note for note in found.notes)


def test_sensors_of_two_clocks_are_refused() -> None:
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
    made = flown(body, np.random.default_rng(3), seconds=4.0, spin=(0.3, 3.0, 0.5), gyro=1e-3, pose=1e-3)
    rates, attitude, *_ = made.streams
    apart = replace(made, streams=(replace(rates, time_ns=rates.time_ns + 10**18), attitude))
    with pytest.raises(LogError, match="no sensor measured both before and after"):
        apart.pieces()


def test_a_sensor_that_ends_before_another_begins_is_led_across() -> None:
    """It was refused as one of two clocks; the log times say whether it is."""
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
    made = flown(body, np.random.default_rng(3), seconds=5.0, spin=(0.3, 3.0, 0.5), gyro=1e-3, pose=1e-3)
    rates, *pose = made.streams
    until, since = (slice(0, 200), slice(260, None))
    found = identify(
        guess(body),
        [replace(made, streams=(rates.rows(since), *(each.rows(until) for each in pose)))],
        ["inertia_ratios"],
    )
    assert found.explained
    for each in found.parameters:
        i, j = ("xyz".index(axis) for axis in each.name[-2:])
        assert each.interval is not None
        assert each.interval[0] <= body.inertia[i][j] / 0.09 <= each.interval[1]


def test_sensors_logged_at_one_time_and_stamped_one_after_the_other_are_of_two_clocks() -> None:
    bag = bag_of(spin(), with_twist=False)
    bag.topics["/b/twist"] = Topic("/b/twist", TWIST)
    rows = np.hstack([spin().velocity, spin().rate])
    fill(bag.topics["/b/twist"], spin().time_ns + 30 * 10**9, "base", rows, -30 * 10**9)
    with pytest.raises(LogError, match=r"/b/pose ends 20\.01 s before /b/twist begins, by the stamps, while both were"):
        flight_of(bag, guess(RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))))


def test_a_bag_of_commands_alone_is_no_flight() -> None:
    alone = replace(bag_of(spin()), topics={"/w": Topic("/w", STAMPED)})
    add(alone.topics["/w"], 0, stamped(0, 1.0))
    with pytest.raises(LogError, match="found 0 samples of the motion"):
        flight_of(alone, guess(RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))))


def rigid(body: RigidBody) -> Scene:
    """Return the scene of a body."""
    return parse_scene(f"body: {{mass: {body.mass}, inertia: {{matrix: {[list(row) for row in body.inertia]}}}}}\n")


@pytest.mark.parametrize(("every", "kept"), [(100, 990), (5, 0)])
def test_a_few_quaternions_that_are_no_attitudes_do_not_take_the_others(every: int, kept: int) -> None:
    motion = spin()
    motion.orientation_xyzw[::every] = 0.0
    flight = flight_of(bag_of(motion), rigid(RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))))
    assert sum(len(stream.time_ns) for stream in flight.streams if stream.kind == ATTITUDE) == kept
    assert any(f"{1000 // every} of 1000 quaternions are no attitudes (lengths 0 to 1)" in n for n in flight.notes)


def leapt(by_s: float, twist_by_s: float) -> Bag:
    """Return a bag whose stamps leap after 6 s while the log goes on, those of the twist by another time."""
    pose, twist = ((np.arange(1000) >= 600) * round(by * 1e9) for by in (by_s, twist_by_s))
    bags = [bag_of(replace(spin(), time_ns=spin().time_ns + by), logged_later_ns=-by) for by in (pose, twist)]
    topics = {name: bag.topics[name] for name, bag in zip(("/b/pose", "/b/twist"), bags, strict=True)}
    return replace(bags[0], topics=topics)


@pytest.mark.parametrize("by_s", [0.6, 2.0, 60.0])
def test_a_clock_that_was_set_forward_begins_another_piece(by_s: float) -> None:
    """A fit across looked for minutes for a motion that leads over the time that never was."""
    scene = guess(RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04)))
    first, second = flight_of(leapt(by_s, by_s), scene).pieces()
    assert [piece.seconds for piece in (first, second)] == pytest.approx([5.99, 3.99])
    assert any("the clock of the stamps was set forward at 5.99 s: each piece" in note for note in first.notes)
    assert not any("nothing was measured" in note for note in first.notes)


@pytest.mark.parametrize(
    ("by", "words"),
    [
        (
            (-2.0, -2.0),
            "stamps begin again after t = 5.99 s at 4 s: two runs .*, or a clock that was set back; .*; cut it",
        ),
        ((2.0, 0.0), "/b/pose by 2 s at 5.99 s; /b/twist never; expected sensors of one clock; cut"),
    ],
)
def test_a_clock_that_was_set_back_or_of_one_sensor_alone_is_refused(by: tuple[float, float], words: str) -> None:
    with pytest.raises(LogError, match=words):
        flight_of(leapt(*by), guess(RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))))


def test_two_bodies_on_one_topic_are_refused_before_the_fit() -> None:
    """Without a twist, the fit searched for minutes."""
    motion = spin(noise=1e-3)
    motion.orientation_xyzw[::2] = motion.turned(1.5)[::2]
    with pytest.raises(LogError, match=r"/b/pose: the attitude jumps away and back .*: two bodies on one topic"):
        flight_of(bag_of(motion, with_twist=False), guess(RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0))))


def test_samples_of_one_stamp_that_contradict_each_other_are_named() -> None:
    motion = spin(noise=1e-3)
    motion.time_ns[500] = motion.time_ns[499]
    motion.position[500] += (0.5, 0.0, 0.0)
    found = flight_of(bag_of(motion, with_twist=True), guess(RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0))))
    assert any("/b/pose: position jumps within 0 s, by up to 0.5" in note for note in found.notes)


def test_jumps_of_a_pose_are_named() -> None:
    """As of markers that are mistaken for one another; the fit said only that it does not explain the recording."""
    motion = spin(noise=1e-4)
    motion.orientation_xyzw[400:] = motion.turned(1.5)[400:]
    found = flight_of(bag_of(motion, with_twist=False), guess(RigidBody.from_diagonal(1.0, (1.0, 1.0, 1.0))))
    assert any(
        re.search(r"/b/pose jumps, .*: attitude, by 8\d\.\d*° within 0.01 s at t = 3.99 s; cut", note)
        for note in found.notes
    )


def test_a_position_far_away_is_left_out_and_named() -> None:
    """It left more than all noise, and nothing was known."""
    body = random_body(np.random.default_rng(3), center=0.05)
    made = flown(body, np.random.default_rng(3), torque=1.0, force=2.0, pose=1e-3)
    (place,) = (k for k, each in enumerate(made.streams) if each.kind == POSITION)
    values = made.streams[place].values.copy()
    values[100, 2] += 5.0
    streams = list(made.streams)
    streams[place] = replace(streams[place], values=values)
    found = identify(guess(body), [replace(made, streams=tuple(streams))], ["mass", "center_of_mass", "inertia"])
    assert found.passed
    assert found.explained
    (said,) = (note for note in found.notes if "spike" in note)
    assert re.search(r"position: of 301 samples 1 is a spike, up to 5 m from the samples about them", said)
    (mass,) = (each for each in found.parameters if each.name == "mass")
    assert mass.standard_error is not None
    assert abs(mass.value - body.mass) < 4.0 * mass.standard_error


def test_attitudes_far_away_are_left_out_and_named() -> None:
    """As where markers are mistaken for one another; five of 301 left nothing known."""
    body = random_body(np.random.default_rng(3))
    made = flown(body, np.random.default_rng(3), torque=1.0, pose=1e-3)
    gyro, attitude, position = made.streams
    values = attitude.values.copy()
    flipped = [40, 120, 121, 122, 250]
    values[flipped] = product(values[flipped], np.tile([0.0, 0.0, 1.0, 0.0], (5, 1)))
    streams = (gyro, replace(attitude, values=values), position)
    found = identify(guess(body), [replace(made, streams=streams)], ["inertia"])
    assert found.passed
    assert found.explained
    (said,) = (note for note in found.notes if "spike" in note)
    assert "pose attitude: of 301 samples 5 are spikes, up to 3.07 rad from the samples about them" in said


@pytest.mark.parametrize("pose", [None, 1e-3])
def test_rates_far_away_are_left_out_and_named(pose: float | None) -> None:
    """Three of 300 left nothing known."""
    body = random_body(np.random.default_rng(3))
    made = flown(body, np.random.default_rng(3), torque=1.0, pose=pose)
    gyro, *others = made.streams
    values = gyro.values.copy()
    values[[50, 130, 131], 1] += [5.0, -4.0, 4.0]
    found = identify(guess(body), [replace(made, streams=(replace(gyro, values=values), *others))], ["inertia"])
    assert found.passed
    assert found.explained
    (said,) = (note for note in found.notes if "spike" in note)
    assert "imu rates: of 301 samples 3 are spikes, up to 5" in said


def test_what_is_left_out_of_a_recording_that_is_held_out_is_named() -> None:
    """It was said to be predicted, without a word about the samples that did not count."""
    body = random_body(np.random.default_rng(3))
    made = flown(body, np.random.default_rng(3), torque=1.0)
    values = made.streams[0].values.copy()
    values[60, 1] += 5.0
    held_out = replace(made, name="other", streams=(replace(made.streams[0], values=values),))
    found = identify(guess(body), [made], ["inertia"], validate=[held_out])
    assert found.validated
    assert [note for note in found.notes if note.startswith("other: imu rates: of 301 samples 1 is a spike")]


def with_hole(flight: Flight, begin_s: float, end_s: float, commands: bool) -> Flight:
    """Return the same without what was measured, and commanded, in between."""
    streams = (s.rows((s.time_ns <= begin_s * 1e9) | (s.time_ns >= end_s * 1e9)) for s in flight.streams)
    channels = []
    for each in flight.channels:
        # Only changes are commands.
        kept = np.append(True, (np.diff(each.held, axis=0) != 0.0).any(axis=1))
        kept &= (each.time_ns <= begin_s * 1e9) | (each.time_ns >= end_s * 1e9) | commands
        channels.append(WrenchSeries(each.topic, each.time_ns[kept], each.held[kept]))
    return replace(flight, streams=tuple(streams), channels=tuple(channels))


def test_a_hole_without_the_commands_that_came_steadily_begins_another_piece() -> None:
    """Those before it acted on through it: the fit was wrong, and took minutes."""
    made = flown(random_body(np.random.default_rng(3)), np.random.default_rng(3), torque=1.0, seconds=20.0)
    assert len(made.pieces()) == 1
    (whole,) = with_hole(made, 8.0, 10.0, commands=True).pieces()
    assert "nothing was measured for 2 s from 8 s: the motion there is that of the model alone" in whole.notes[-1]
    first, second = with_hole(made, 8.0, 10.0, commands=False).pieces()
    assert [each.span_ns for each in (first, second)] == [(0, 8 * 10**9), (10 * 10**9, 20 * 10**9)]
    assert "2 s from 8 s, over which the motion is not followed" in first.notes[-1]
    # A hole in which no command was due says nothing.
    (whole,) = with_hole(made, 8.0, 8.1, commands=False).pieces()
    assert not whole.notes


def test_a_hole_without_commands_is_one_if_the_last_of_them_was_kept() -> None:
    """Of two parts that `convert` cut and merged the second has what was held: it was said that no body explains it."""
    made = flown(random_body(np.random.default_rng(3)), np.random.default_rng(3), torque=1.0, seconds=20.0)
    (channel,) = made.channels
    (held,) = np.flatnonzero(channel.time_ns < 10 * 10**9)[-1:]
    less = with_hole(made, 8.0, 10.0, commands=False)
    (cut,) = less.channels
    time, wrench = channel.time_ns[held], channel.held[held]
    at = np.searchsorted(cut.time_ns, time)
    kept = WrenchSeries(cut.topic, np.insert(cut.time_ns, at, time), np.insert(cut.held, at, wrench, axis=0))
    first, second = replace(less, channels=(kept,)).pieces()
    assert [each.span_ns for each in (first, second)] == [(0, 8 * 10**9), (10 * 10**9, 20 * 10**9)]


def test_many_holes_without_commands_do_not_make_as_many_pieces() -> None:
    made = flown(random_body(np.random.default_rng(3)), np.random.default_rng(3), torque=1.0, seconds=130.0)
    for k in range(25):
        made = with_hole(made, 5.0 * k + 1.0, 5.0 * k + 2.0, commands=False)
    assert len(made.pieces()) == 21


def test_a_part_of_a_recording_does_not_say_when_a_schedule_began(tmp_path: Path) -> None:
    """It was taken to begin with the part: no torque explained the motion."""
    schedule = "[{time: 0, torque: [0.02, 0, 0]}, {time: 0.5, torque: [0, 0.03, 0]}]"
    body = "body: {mass: 2, inertia: {diagonal: [0.2, 0.3, 0.4]}}\nwrenches: []\nduration: 3\noutput_rate: 50\n"
    scene = parse_scene(f"{body}effects: [{{type: scheduled_wrench, schedule: {schedule}}}]\n")
    log, part = tmp_path / "log.mcap", tmp_path / "part.mcap"
    simulate(scene, [], [McapSink(log)])
    merge([log], part, (10**9, math.inf))
    assert read_flight(str(log), scene)
    with pytest.raises(LogError, match=r"does not say when the schedule of effects/scheduled_wrench began"):
        read_flight(str(part), scene)
    always = parse_scene(f"{body}effects: [{{type: uniform_gravity, acceleration_world: [0, 0, -1]}}]\n")
    assert read_flight(str(part), always)
