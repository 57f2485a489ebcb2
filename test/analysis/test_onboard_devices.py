"""What `inspect` says of wheels, actuators and sensors is what the scene gives them, and what the commands asked."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from edited_logs import edited
from recorded_runs import fly

import rb_dynamics as rb
from rb_dynamics.analysis.onboard_devices import Onboard
from rb_dynamics.cli import main
from rb_dynamics.formats.mcap_records import McapFile, Message
from rb_dynamics.loads.actuator import Setpoint
from rb_dynamics.report.html import write_html
from rb_dynamics.report.inspection_text import as_text, wheel_rows
from rb_dynamics.report.run_page import run_report

SCENE = """
body:
  mass: 10
  inertia: {diagonal: [0.2, 0.25, 0.3]}
  frames: {tilted: {position: [0.1, 0.2, 0.0], orientation: {x: 0.6, y: 0.0, z: 0.0, w: 0.8}}}
initial: {angular_velocity_body: [0.02, -0.01, 0.03]}
wrenches: []
actuators:
  - {type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 1.0e-4, max_torque: 5.0e-3, max_speed: 60.0}
  - {type: thruster, name: jet, frame: tilted, force: 0.5, command: on_time, minimum_on: 0.005}
sensors:
  - {type: imu, name: imu, frame: tilted, rate: 40, gyro: {noise_density: 1.0e-4, bias: [0.01, 0, 0]}}
  - {type: star_tracker, name: tracker, frame: tilted, rate: 10, noise: 1.0e-3}
  - {type: magnetometer, name: mag, frame: tilted, rate: 20, bias: [0, 2.0e-9, 0]}
  - {type: sun_sensor, name: sun, frame: tilted, rate: 20, direction_world: [1, 2, 0]}
  - {type: pose, name: camera, frame: tilted, rate: 3, delay: 0.2}
effects: [{type: magnetic_field, model: uniform, field_world: [0, 1.0e-5, 3.0e-5]}]
duration: 20
output_rate: 20
seed: 4
"""

COMMANDS = (
    ("wheel/command", Setpoint(0.004, 1_000_000_000)),
    ("wheel/command", Setpoint(-0.02, 10_000_000_000)),
    ("jet/command", Setpoint(0.5, 2_000_000_000)),
    ("jet/command", Setpoint(0.001, 4_000_000_000)),
)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fly(tmp_path_factory.mktemp("onboard") / "satellite.mcap", SCENE, COMMANDS).log


def test_wheels_and_commands_beyond_limits_are_told(log: Path) -> None:
    found = rb.inspect(log)
    (wheel,) = found.summary.onboard.wheels
    # 0.004 N m take a wheel of 1e-4 kg m^2 to 60 rad/s in 1.5 s, the body 1.5e-2/0.3 rad/s the other way; then, from
    # 10 s on, -0.005 N m within 2.4 s to -60 rad/s.
    assert wheel.largest == pytest.approx(60.0)
    assert wheel.at_limit_s == pytest.approx(20.0 - 2.5 - 2.4, abs=0.2)
    assert wheel.last == pytest.approx(-60.0)
    plain = found.as_dict()["onboard"]["actuators"][0]
    assert [*plain] == ["name", "kind", "unit", "commands", "largest", "limited", "rejected"]
    counts = {each.name: (each.commands, each.limited, each.rejected) for each in found.summary.onboard.actuators}
    assert counts == {"wheel": (2, 1, 0), "jet": (2, 0, 1)}
    told = " ".join(found.summary.warnings)
    for words in (
        "wheel was at its max_speed of 60",
        "wheel: 1 of 2 commands limited",
        "jet: 1 of 2 commands rejected",
    ):
        assert words in told
    uses = {topic.name: topic.use for topic in found.summary.topics}
    assert (uses["/imu"], uses["/jet/command"], uses["/wheels"]) == ("sensor", "command", "wheel speeds")
    # Of the pose sensor it was said both that it is compared and that it is left out.
    assert uses["/camera"] == "sensor"
    assert not any("left out" in note for note in found.summary.notes)


def test_commands_beside_the_first_and_last_sample_of_a_part_count(tmp_path: Path) -> None:
    """At 1 Hz the samples of this part go from 1 to 2 s: what came before and after was left out."""
    times_ns = (600_000_000, 1_200_000_000, 2_200_000_000, 2_500_000_000, 3_100_000_000)
    commands = [("wheel/command", Setpoint(-0.02, time_ns)) for time_ns in times_ns]
    flight = fly(tmp_path / "run.mcap", SCENE.replace("output_rate: 20", "output_rate: 1"), commands)
    (wheel,) = rb.inspect(flight.log, window_s=(0.5, 2.9)).summary.onboard.actuators
    assert (wheel.name, wheel.commands, wheel.limited) == ("wheel", 4, 4)


def test_commands_that_are_no_numbers_are_counted_as_rejected(tmp_path: Path) -> None:
    """They were left out: of a controller that had diverged it was said that no command was rejected."""
    commands = [
        *(("wheel/command", Setpoint(value, 10**9 * (1 + k))) for k, value in enumerate((0.001, math.nan, math.inf))),
        *(("jet/command", Setpoint(math.nan, 10**9 * k)) for k in range(1, 4)),
    ]
    flight = fly(tmp_path / "diverged.mcap", SCENE, commands)
    assert len(flight.result.rejected) == 5
    found = rb.inspect(flight.log)
    counts = {each.name: (each.commands, each.limited, each.rejected) for each in found.summary.onboard.actuators}
    assert counts == {"wheel": (3, 0, 2), "jet": (3, 0, 3)}
    assert [each.largest for each in found.summary.onboard.actuators] == [0.001, 0.0]
    assert "jet: 3 of 3 commands rejected" in as_text(found.summary)
    write_html(tmp_path / "page.html", run_report(found.track, found.summary))
    json.dumps(found.as_dict(), allow_nan=False)


def test_motor_work_and_friction_heat_are_in_the_log(tmp_path: Path) -> None:
    text = SCENE.replace("max_speed: 60.0", "speed: 30, friction: {viscous: 1.0e-6}")
    flight = fly(tmp_path / "friction.mcap", text, COMMANDS[:1])
    found = rb.inspect(flight.log)
    columns = {each.name: (each.first, each.last) for each in found.summary.moments}
    end = flight.result.sample
    assert end.motor_work
    assert end.friction_heat
    assert columns["motor work of the wheels"] == ((0.0,), (end.motor_work,))
    assert columns["friction heat of the wheels"] == ((0.0,), (end.friction_heat,))
    for name in ("motor_work", "friction_heat"):
        series = getattr(found.track, name)
        assert series.values.tolist() == getattr(flight.samples, name).tolist()
    # 1 uW s^2/rad^2 and some 30 rad/s at first, of a body that hardly turns.
    assert found.track.friction_heat.values[20] == pytest.approx(1e-6 * 30**2, rel=0.02)
    assert "motor work of the wheels [J]" in as_text(found.summary)
    assert '"friction heat of the wheels"' in json.dumps(found.as_dict())
    page = tmp_path / "page.html"
    write_html(page, run_report(found.track, found.summary))
    assert "motor work" in page.read_text()
    table = tmp_path / "friction.csv"
    assert main(["convert", str(flight.log), str(table)]) == 0
    header, *_, last = table.read_text().splitlines()
    assert dict(zip(header.split(","), last.split(","), strict=True))["motor_work"] == repr(end.motor_work)


def test_errors_of_sensors_are_those_of_the_scene(log: Path) -> None:
    found = {(each.name, each.quantity): each for each in rb.inspect(log).summary.onboard.sensors}
    assert set(found) == {
        ("imu", "angular_velocity"),
        ("tracker", "orientation_xyzw"),
        ("mag", "magnetic_field"),
        ("sun", "direction"),
        ("camera", "position_world"),
        ("camera", "orientation_xyzw"),
    }
    gyro, tracker = found["imu", "angular_velocity"], found["tracker", "orientation_xyzw"]
    assert (gyro.count, gyro.compared) == (801, 401)
    white = 1e-4 * math.sqrt(40.0)
    assert np.allclose(gyro.mean, (0.01, 0.0, 0.0), atol=4.0 * white / math.sqrt(401))
    assert np.allclose(gyro.deviation, white, rtol=0.15)
    assert np.allclose(tracker.deviation, 1e-3, rtol=0.25)
    # Without noise the error is the bias, or none, to rounding: frame, lever arm, delay and field are the model's.
    assert np.allclose(found["mag", "magnetic_field"].errors, (0.0, 2e-9, 0.0), rtol=0.0, atol=1e-19)
    for exact in (found["sun", "direction"], found["camera", "position_world"], found["camera", "orientation_xyzw"]):
        assert exact.compared > 10
        assert np.abs(exact.errors).max() < 1e-14


@pytest.mark.parametrize(
    ("topic", "at"), [("/wheels", 12), ("/wheels", 20), ("/wheels", 24), ("/imu", 12), ("/jet/command", None)]
)
def test_a_damaged_message_is_left_out_and_told(log: Path, tmp_path: Path, topic: str, at: int | None) -> None:
    """Damage in the length of a name ended the whole inspection with a traceback."""
    count = sum(message.channel.topic == topic for message in McapFile(log).messages())
    left = [True]

    def damaged(message: Message) -> Message:
        if message.channel.topic != topic or not (left and left.pop()):
            return message
        data = message.data
        return message._replace(data=data[:6] if at is None else data[:at] + b"\xff" * 4 + data[at + 4 :])

    found = rb.inspect(edited(log, tmp_path / "damaged.mcap", damaged))
    (check,) = (each for each in found.summary.checks if each.name == f"{topic} is whole")
    assert not check.passed
    assert f"1 of {count} messages are cut short or damaged" in check.detail
    if topic == "/wheels":
        assert found.summary.onboard.wheels[0].last == pytest.approx(-60.0)


def test_a_window_and_a_target(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = rb.inspect(log, window_s=(5.0, 9.0), target=(0.0, 0.0, 0.0, 1.0))
    (wheel,) = found.summary.onboard.wheels
    assert (wheel.time_ns[0], wheel.time_ns[-1], wheel.at_limit_s) == (5_000_000_000, 9_000_000_000, 4.0)
    assert not found.summary.onboard.actuators
    attitude = found.track.pose.values[:, 3:] if found.track.pose else np.empty((0, 4))
    assert found.track.pointing is not None
    expected = 2.0 * np.arctan2(np.linalg.norm(attitude[:, :3], axis=1), np.abs(attitude[:, 3]))
    assert np.allclose(found.track.pointing.values, expected, rtol=0.0, atol=1e-15)
    assert found.as_dict()["onboard"]["wheels"][0]["largest_ns"] == 5_000_000_000
    assert main(["inspect", str(log), "--target", "0,0,0,1"]) == 0
    assert "angle from the target [rad]" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["inspect", str(log), "--target", "0,0,0,2"])
    assert "norm 2, expected a unit quaternion" in capsys.readouterr().err


def test_text_and_page_show_them(log: Path, tmp_path: Path) -> None:
    found = rb.inspect(log, target=(0.0, 0.0, 0.6, 0.8))
    text = as_text(found.summary)
    for title in ("REACTION WHEEL", "ACTUATOR", "SENSOR ERROR", "camera, position world [m]"):
        assert title in text
    # At rest at first; relative to the body, that is a difference of two rates.
    (wheel,) = found.summary.onboard.wheels
    speeds = replace(wheel, speed=np.array([3e-18, *wheel.speed[1:]]))
    summary = replace(found.summary, onboard=replace(found.summary.onboard, wheels=(speeds,)))
    assert wheel_rows(summary)[1][:2] == ["wheel", "0"]
    page = tmp_path / "page.html"
    write_html(page, run_report(found.track, found.summary))
    html = page.read_text()
    # Of a satellite these matter most.
    titles = ("Angle from the target [rad]", "Wheel speeds [rad/s]", "Reaction wheels [N m]", "Thrusters [s]")
    places = [html.index(title) for title in (*titles, "error of orientation", "Angular momentum about the centre")]
    assert places == sorted(places)
    # In orbit the kinetic energy is 1e8 times that of the wheels.
    assert "Energy by the wheels [J]" in html


def test_a_scene_without_them_has_none(tmp_path: Path) -> None:
    assert rb.inspect(fly(tmp_path / "plain.mcap").log).summary.onboard == Onboard()


def test_a_single_sample_has_no_deviation(tmp_path: Path) -> None:
    """It was 0, as of a sensor without noise."""
    scene = SCENE.replace("rate: 10, noise", "rate: 0.04, noise")
    found = rb.inspect(fly(tmp_path / "one.mcap", scene, COMMANDS).log)
    (tracker,) = (each for each in found.as_dict()["onboard"]["sensors"] if each["name"] == "tracker")
    assert tracker["compared"] == 1
    assert tracker["deviation"] == [None] * 3
    assert None not in tracker["mean"]
    assert re.search(r"standard deviation +unknown +unknown +unknown", as_text(found.summary))


def test_the_deviation_of_two_samples_is_an_unbiased_estimate(tmp_path: Path) -> None:
    """It was that of all there are: 1/√2 of it in the mean of the squares."""
    scene = SCENE.replace("rate: 10, noise", "rate: 0.08, noise")
    (tracker,) = (
        each
        for each in rb.inspect(fly(tmp_path / "two.mcap", scene, COMMANDS).log).summary.onboard.sensors
        if each.name == "tracker"
    )
    first, second = tracker.errors
    assert np.allclose(tracker.deviation, np.abs(first - second) / np.sqrt(2))
