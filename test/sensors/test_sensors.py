"""What sensors give, against the true motion, and when: in runs, at any rate of outputs, in pieces and in replay."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import rb_dynamics as rb
from rb_dynamics.formats import cdr
from rb_dynamics.formats.bag_source import open_source
from rb_dynamics.run.sink import Measurement, RunInfo
from rb_dynamics.sinks.mcap_sink import McapSink
from rb_dynamics.study.replay import replay

BODY = """
body:
  mass: 10
  center_of_mass: [0.01, 0.02, -0.01]
  inertia: {matrix: [[0.2, 0.01, 0], [0.01, 0.3, 0.02], [0, 0.02, 0.25]]}
  frames:
    imu: {position: [0.1, 0, 0.05], orientation: {x: 0, y: 0, z: 0.6, w: 0.8}}
initial: {angular_velocity_body: [0.4, -0.2, 0.3], linear_velocity_world: [0.3, 0, 0]}
wrenches: [{topic: wrench, timeout: 0.4}]
"""
NOISY = """
effects:
  - {type: uniform_gravity, acceleration_world: [0, 0, -9.81]}
  - {type: magnetic_field, model: uniform, field_world: [2.0e-5, 0, -4.0e-5]}
sensors:
  - {type: imu, name: imu, frame: imu, rate: 60.0, gyro: {noise_density: 1.0e-4, random_walk: 1.0e-5},
     accelerometer: {noise_density: 1.0e-3, resolution: 1.0e-4}, delay: 0.005}
  - {type: star_tracker, name: tracker, rate: 7.0, noise: 1.0e-4, delay: 0.33}
  - {type: magnetometer, name: mag, rate: 10.0, noise_density: 1.0e-8, dropout: 0.3}
  - {type: pose, name: mocap, rate: 9.0, position_noise: 1.0e-3, orientation_noise: 1.0e-3}
  - {type: sun_sensor, name: sun, rate: 5.0, direction_world: [1, 0, 0], noise: 1.0e-3}
seed: 4
duration: 2
"""
COMMANDS = [("wrench", rb.Wrench((1.0, 0.0, 0.5), (0.02, 0.0, 0.1), "body", 700_000_000))]


def measured(text: str, commands: object = (), **overrides: object) -> list[Measurement]:
    sink = rb.MemorySink()
    rb.simulate(rb.parse_scene(text, overrides=overrides), commands, [sink])  # type: ignore[arg-type]
    return sink.measurements


def numbers(found: list[Measurement], topic: str) -> np.ndarray:
    return np.array([each.numbers for each in found if each.topic == topic])


def test_an_imu_feels_specific_force_at_its_place() -> None:
    """Its path, differentiated: the acceleration of the frame's origin less gravity, in its own axes."""
    text = f"""{BODY}
effects: [{{type: uniform_gravity, acceleration_world: [0, 0, -9.81]}}]
sensors: [{{type: imu, name: imu, frame: imu, rate: 1000}}, {{type: pose, name: place, frame: imu, rate: 1000}}]
duration: 0.01
"""
    found = measured(text, [("wrench", rb.Wrench((3.0, 1.0, 0.0), (0.2, 0.0, 0.4)))])
    imu, place = numbers(found, "imu"), numbers(found, "place")
    h = 1e-3
    path, axes = place[:, :3], Rotation.from_quat(place[:, 3:7])
    acceleration = (path[2:] - 2.0 * path[1:-1] + path[:-2]) / h**2
    expected = axes[1:-1].inv().apply(acceleration - [0.0, 0.0, -9.81])
    turned = (axes[:-1].inv() * axes[1:]).as_rotvec() / h
    assert imu[1:-1, 25:28] == pytest.approx(expected, abs=2e-5)
    assert 0.5 * (imu[:-1, 13:16] + imu[1:, 13:16]) == pytest.approx(turned, abs=1e-6)
    assert np.linalg.norm(imu[1, 25:28]) > 0.3
    assert (imu[:, 4] == -1.0).all(), "an attitude that is not there has -1 in its covariance"


def test_the_first_sample_feels_what_acts_from_the_beginning_on() -> None:
    """As the one a nanosecond later does: gravity, schedules and biases are not commands, which act after a sample."""
    text = f"""{BODY.replace("timeout: 0.4", "bias: {force: [1, 2, 3], torque: [0.1, 0.2, 0.3]}")}
effects:
  - {{type: uniform_gravity, acceleration_world: [0, 0, -9.81]}}
  - {{type: scheduled_wrench, frame_id: imu, schedule: [{{time: 0, force: [4, 0, 0], torque: [0, 0, 0]}}]}}
  - {{type: linear_drag, translation: 0.5, rotation: 0.1}}
actuators: [{{type: reaction_wheel, name: wheel, axis: [1, 1, 0], inertia: 0.05, friction: {{coulomb: 0.01}}}}]
sensors: [{{type: imu, name: imu, frame: imu, rate: 1.0e+9}}]
duration: 2.0e-9
"""
    imu = numbers(measured(text), "imu")
    assert np.linalg.norm(imu[0, 25:28]) > 0.5
    assert imu[0] == pytest.approx(imu[1], abs=1e-7)


def test_in_free_fall_only_the_place_off_the_centre_of_mass_feels_a_force() -> None:
    text = """
body:
  mass: 3
  inertia: {diagonal: [1, 1, 1]}
  frames: {side: {position: [0.5, 0, 0], orientation: {x: 0, y: 0, z: 0, w: 1}}}
initial: {position_world: [7.0e+6, 0, 0], angular_velocity_body: [0, 0, 0.2]}
wrenches: []
effects: [{type: central_gravity, gravitational_parameter: 3.986004418e+14}]
sensors: [{type: imu, name: center, rate: 5}, {type: imu, name: side, frame: side, rate: 5}]
duration: 0.1
"""
    found = measured(text)
    assert numbers(found, "center")[0][25:28] == pytest.approx((0.0, 0.0, 0.0), abs=1e-14)
    tide = 2.0 * 3.986004418e14 / 7.0e6**3 * 0.5
    assert numbers(found, "side")[0][25:28] == pytest.approx((-0.5 * 0.04 + -tide, 0.0, 0.0), abs=1e-12, rel=1e-6)


def test_a_dipole_has_the_field_of_a_dipole() -> None:
    text = """
body: {mass: 1, inertia: {diagonal: [1, 1, 1]}}
wrenches: []
initial: {position_world: [POSITION]}
effects: [{type: magnetic_field, model: dipole, moment_world: [0, 0, -7.8e+22]}]
sensors: [{type: magnetometer, name: mag, rate: 1}]
duration: 0.1
"""
    equator = numbers(measured(text.replace("POSITION", "7.0e+6, 0, 0")), "mag")[0]
    pole = numbers(measured(text.replace("POSITION", "0, 0, 7.0e+6")), "mag")[0]
    strength = 1e-7 * 7.8e22 / 7.0e6**3
    assert equator[:3] == pytest.approx((0.0, 0.0, strength))
    assert pole[:3] == pytest.approx((0.0, 0.0, -2.0 * strength))


def test_samples_fall_on_their_nanosecond_whatever_the_outputs() -> None:
    found = measured(BODY + NOISY, COMMANDS)
    tracker = [each for each in found if each.topic == "tracker"]
    assert [each.taken_ns for each in tracker] == [round(k * 10**9 / 7) for k in range(12)]
    assert all(each.time_ns == each.taken_ns + 330_000_000 for each in tracker)
    assert [each.time_ns for each in found] == sorted(each.time_ns for each in found)
    assert len([each for each in found if each.topic == "imu"]) == 120
    assert 8 <= len([each for each in found if each.topic == "mag"]) < 21, "some of 21 drop out"
    for rate in (0.0, 3.0, 977.0):
        assert measured(BODY + NOISY, COMMANDS, output_rate=rate) == found


def test_sensors_change_no_motion_and_pieces_change_no_sensor() -> None:
    scene = rb.parse_scene(BODY + NOISY)
    bare = rb.parse_scene(BODY + NOISY.partition("sensors:")[0] + "duration: 2\n")
    whole, alone, pieces = rb.MemorySink(), rb.MemorySink(), rb.MemorySink()
    rb.simulate(scene, COMMANDS, [whole])
    rb.simulate(bare, COMMANDS, [alone])
    assert whole.samples == alone.samples
    run = rb.Simulation(scene, [pieces])
    run.post(*COMMANDS[0], 700_000_000)
    run.start()
    for k in range(200):
        run.advance(k * 10_012_345)
    run.advance(2 * 10**9)
    run.finish()
    assert pieces.measurements == whole.measurements
    assert pieces.samples == whole.samples


def test_measurements_scatter_about_the_truth_as_asked() -> None:
    text = f"{BODY}{NOISY}".replace("duration: 2", "duration: 40").replace("rate: 9.0", "rate: 25.0")
    found = measured(text.replace("angular_velocity_body: [0.4, -0.2, 0.3], ", ""))
    mocap = numbers(found, "mocap")
    turned = Rotation.from_quat(mocap[:, 3:7]).as_rotvec()
    assert np.std(turned) == pytest.approx(1e-3, rel=0.06)
    times = np.array([each.taken_ns for each in found if each.topic == "mocap"]) * 1e-9
    # The body falls; nothing turns it.
    fallen = np.outer(times, (0.3, 0.0, 0.0)) + np.outer(-0.5 * 9.81 * times**2, (0.0, 0.0, 1.0))
    assert np.std(mocap[:, :3] - fallen) == pytest.approx(1e-3, rel=0.06)
    assert mocap[0, 7] == pytest.approx(1e-6)
    assert np.std(2.0 * numbers(found, "tracker")[:, :3]) == pytest.approx(1e-4, rel=0.12)
    assert np.std(numbers(found, "sun")[:, 1:]) == pytest.approx(1e-3, rel=0.12)


def test_a_log_with_sensors_replays_to_the_bit(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    rb.simulate(rb.parse_scene(BODY + NOISY), COMMANDS, [McapSink(path)])
    found = replay(path)
    assert found.identical
    source = open_source(path)
    messages = [each for each in source.messages() if each.channel.topic == "/imu"]
    assert source.metadata["rb_dynamics"]["seed"] == "4"
    stamp, frame, *values = cdr.decode("sensor_msgs/msg/Imu", messages[3].data)
    assert (stamp, frame, messages[3].log_time) == (50_000_000, "imu", 55_000_000)
    assert values[4][0] == pytest.approx(1e-8 * 60.0), "the variance of a sample with noise of density 1e-4 at 60 Hz"


def test_a_changed_measurement_shows_in_replay(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"

    class OfAnotherSeed(McapSink):
        def open(self, run: RunInfo) -> None:
            text = run.scene.text.replace("seed: 4", "seed: 5")
            super().open(replace(run, scene=replace(run.scene, text=text)))

    rb.simulate(rb.parse_scene(BODY + NOISY), sinks=[OfAnotherSeed(path)])
    assert "/imu" in replay(path).differences


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("name: imu, frame: imu", "name: imu, frame: imv"),
        ("rate: 60.0", "rate: 0"),
        ("seed: 4", "seed: 1.5"),
        ("name: tracker", "name: imu"),
        ("name: tracker", "name: pose"),
        ("name: tracker, ", ""),
        ("type: star_tracker", "type: star_trakcer"),
        ("noise: 1.0e-4", "nosie: 1.0e-4"),
        ("dropout: 0.3", "dropout: 1.0"),
        ("  - {type: magnetic_field, model: uniform, field_world: [2.0e-5, 0, -4.0e-5]}\n", ""),
        ("model: uniform, ", ""),
        ("model: uniform", "model: dipole"),
        ("direction_world: [1, 0, 0]", "direction_world: [0, 0, 0]"),
    ],
)
def test_what_is_no_sensor_is_one_clear_error(change: str, expected: str) -> None:
    text = BODY + NOISY
    assert change in text
    with pytest.raises(rb.SceneError, match="expected") as error:
        rb.parse_scene(text.replace(change, expected))
    assert len(str(error.value).splitlines()) <= 2


@pytest.mark.parametrize("size", ["1.0e-320", "1.7e+308"])
def test_the_length_of_a_direction_does_not_count(size: str) -> None:
    text = f"""
body: {{mass: 3, inertia: {{diagonal: [1, 1, 1]}}}}
wrenches: []
effects:
  - {{type: magnetic_field, model: uniform, field_world: [0, 0, 1.0e-5]}}
  - {{type: rotor, axis_body: [0, {size}, {size}], axial_inertia: 0.1, spin_rate: 2}}
actuators: [{{type: magnetorquer, name: rod, axis: [{size}, {size}, {size}], max_dipole: 1}}]
sensors: [{{type: sun_sensor, name: sun, rate: 10, direction_world: [{size}, {size}, {size}]}}]
duration: 0.01
"""
    commands = [("rod/command", rb.Setpoint(1.0))]
    assert measured(text, commands)[0].numbers == pytest.approx((3.0**-0.5,) * 3)
    here = rb.simulate(rb.parse_scene(text), commands).sample.angular_velocity_body
    there = rb.simulate(rb.parse_scene(text.replace(size, "1")), commands).sample.angular_velocity_body
    assert here == pytest.approx(there, abs=1e-12)
    assert here != (0.0, 0.0, 0.0)


def test_a_sun_sensor_sees_within_its_view_alone() -> None:
    text = """
body: {mass: 3, inertia: {diagonal: [1, 1, 1]}}
initial: {angular_velocity_body: [0, 0, 1]}
wrenches: []
sensors: [{type: sun_sensor, name: sun, rate: 10, direction_world: [1, 0, 0], field_of_view: 0.55}]
duration: 6.283
"""
    found = measured(text)
    assert [each.taken_ns // 10**8 for each in found] == [*range(6), *range(58, 63)]
    for each in found:
        angle = each.taken_ns * 1e-9
        assert each.numbers == pytest.approx((math.cos(angle), -math.sin(angle), 0.0), abs=1e-9)


def test_the_pointing_error_from_a_target_is_logged(tmp_path: Path) -> None:
    """A body at the target turned by 0.1 rad about y turns on about it; in a log, in replay, and in inspect."""
    target, turn = Rotation.from_rotvec([0.4, -0.3, 2.0]), Rotation.from_rotvec([0.0, 0.1, 0.0])
    frame = Rotation.from_quat([0.0, 0.0, 0.6, 0.8])

    def written(rotation: Rotation) -> str:
        return (
            "{" + ", ".join(f"{name}: {float(x)!r}" for name, x in zip("xyzw", rotation.as_quat(), strict=True)) + "}"
        )

    text = f"""
body:
  mass: 3
  inertia: {{diagonal: [1, 1, 1]}}
  frames: {{camera: {{position: [0, 0, 0], orientation: {written(frame)}}}}}
initial: {{orientation: {written(target * turn)}, angular_velocity_body: [0, 0.05, 0]}}
wrenches: []
sensors:
  - {{type: attitude_error, name: pointing, rate: 2, target: {written(target)}}}
  - {{type: attitude_error, name: looking, frame: camera, rate: 2, target: {written(target)}}}
duration: 2
output_rate: 2
"""
    path = tmp_path / "run.mcap"
    sink = rb.MemorySink()
    rb.simulate(rb.parse_scene(text), sinks=[sink, McapSink(path)])
    angle = 0.1 + 0.05 * 0.5 * np.arange(5)
    found = numbers(sink.measurements, "pointing")
    assert found == pytest.approx(np.outer(angle, [0.0, 1.0, 0.0]), abs=1e-15)
    looking = (Rotation.from_rotvec(found) * frame).as_rotvec()
    assert numbers(sink.measurements, "looking") == pytest.approx(looking, abs=1e-15)
    assert replay(path).identical
    (message, *_) = [each for each in open_source(path).messages() if each.channel.topic == "/pointing"]
    assert cdr.decode("geometry_msgs/msg/Vector3Stamped", message.data) == (0, "body", tuple(found[0]))
    pointing = rb.inspect(path).track.pointing
    assert pointing is not None
    assert pointing.values == pytest.approx(angle, abs=1e-15)
    for wrong in ("target: 3", "target: {x: 1, w: 1}", "goal: {w: 1}"):
        with pytest.raises(rb.SceneError, match="expected"):
            rb.parse_scene(text.replace(f"target: {written(target)}", wrong))
