"""Flights of bodies that recorded wheels turn: the inertia is found, or it is said what is missing.

The flights are integrated by SciPy: wheels with friction, driven by torques that no recording has.
"""

from __future__ import annotations

import re
from dataclasses import replace
from operator import methodcaller
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from foreign_bags import GEOMETRY, IMU, SENSOR, Row, header, imu, of, pose, write_bag
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import rb_dynamics as rb
from rb_dynamics.analysis.identification import identify
from rb_dynamics.analysis.identification.flights import ATTITUDE, flight_of
from rb_dynamics.analysis.identification.measurement_model import Model
from rb_dynamics.analysis.identification.noise_of_wheels import NoiseOfWheels, noise_of_wheels
from rb_dynamics.analysis.identification.residuals import Fit
from rb_dynamics.analysis.identification.stacked_rows import covariance_of
from rb_dynamics.analysis.wheel_speeds import WheelSpeeds, wheel_speeds
from rb_dynamics.logs.bag_reader import read_bag
from rb_dynamics.sinks.mcap_sink import McapSink

JOINTS = f"{SENSOR}JointState"
NAMES = ("wheel_x", "wheel_y", "wheel_z")
SECONDS = 8.0


class Flight(NamedTuple):
    """A body with three wheels: inertia with the wheels locked, axes, inertias; times (s), rates and wheel speeds."""

    inertia: Any
    axes: Any
    wheels: Any
    times: Any
    rates: Any
    speeds: Any

    def scene(self, more: str = "", names: tuple[str, ...] = NAMES) -> rb.Scene:
        """Return the scene with a rough inertia."""
        wheels = "".join(
            f"  - {{type: reaction_wheel, name: {name}, axis: {axis.tolist()}, inertia: {inertia}, max_torque: 1, "
            "max_speed: 1.0e+4}\n"
            for name, axis, inertia in zip(names, self.axes, self.wheels, strict=True)
        )
        rough = float(np.trace(self.inertia) / 3.0)
        return rb.parse_scene(f"body: {{mass: 5, inertia: {{diagonal: {[rough] * 3}}}}}\nactuators:\n{wheels}{more}")


def flown(
    seed: int,
    size: float = 0.03,
    held: float = 0.5,
    step: float = 0.01,
    dragged: bool = False,
    seconds: float = SECONDS,
) -> Flight:
    """Fly a random body whose wheels are driven by random torques of this size (N m), held for so long (s).

    If they are `dragged`, they begin at rest, and only viscous friction turns them, on a body that tumbles.
    """
    rng = np.random.default_rng([seed, 8])
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    moments = rng.uniform(0.75, 1.25, 3)
    inertia = 0.1 * turn @ np.diag([0.4, 0.9, 1.1] if dragged else moments) @ turn.T
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0] if seed % 2 else np.eye(3)
    wheels = 0.1 * rng.uniform(0.01, 0.04, 3)
    coulomb, viscous = (0.0, 1e-3) if dragged else (1e-4, 1e-5)
    rest = np.linalg.inv(inertia - axes.T * wheels @ axes)
    torques = size * rng.uniform(-1.0, 1.0, (round(seconds / held), 3))

    def slope(t: float, state: Any, torque: Any) -> Any:
        rate, speed = state[:3], state[3:]
        on_wheels = torque - viscous * speed - coulomb * np.tanh(speed)
        change = rest @ (-np.cross(rate, inertia @ rate + axes.T @ (wheels * speed)) - axes.T @ on_wheels)
        return np.hstack([change, on_wheels / wheels - axes @ change])

    times, rows = np.arange(0, seconds, step), []
    state = np.hstack([0.5 * rng.standard_normal(3), rng.uniform(-50, 50, 3)])
    if dragged:
        state, torques = np.hstack([2.0 * state[:3], np.zeros(3)]), 0.0 * torques
    for k, torque in enumerate(torques):
        span = (held * k, held * k + held)
        at = times[(times >= span[0] - 1e-9) & (times < span[1] - 1e-9)]
        found = solve_ivp(slope, span, state, "DOP853", np.append(at, span[1]), args=(torque,), rtol=1e-11, atol=1e-12)
        rows.append(found.y[:, :-1].T)
        state = found.y[:, -1]
    states = np.vstack(rows)
    return Flight(inertia, axes, wheels, times, states[:, :3], states[:, 3:])


def joints(stamp_ns: int, names: tuple[str, ...], speeds: Any) -> Any:
    return of(JOINTS, header(stamp_ns, ""), list(names), np.zeros(0), np.array(speeds, float), np.zeros(0))


def recorded(
    flight: Flight,
    folder: Path,
    seed: int,
    *,
    noise: float = 0.0,
    gyro: float = 1e-3,
    first: int = 0,
    last: int | None = None,
    every: int = 2,
    of_imu: int = 1,
    tracker: float | None = None,
) -> Path:
    """Write gyro, noisy, and speeds of the wheels, another joint among them, as another program does.

    Of so many samples one is kept: `every`, of the gyro `of_imu`. `tracker` is the noise (rad) of poses with it.
    """
    rng, begin = np.random.default_rng([seed, 9]), 1_700_000_000 * 10**9
    stamps = (begin + np.rint(flight.times * 1e9).astype(np.int64)).tolist()
    rates = flight.rates + gyro * rng.standard_normal(flight.rates.shape)
    told = flight.speeds + noise * rng.standard_normal(flight.speeds.shape)
    rows: list[Row] = [
        ("/imu", IMU, at + 1000, imu(at, (0, 0, 0, 1), rate, (0, 0, 0), (False, True, False)))
        for at, rate in zip(stamps, rates, strict=True)
    ][::of_imu]
    if tracker is not None:
        turns = np.diff(flight.times)[:, None] * (flight.rates[1:] + flight.rates[:-1]) / 2.0
        attitude = Rotation.identity()
        for k, at in enumerate(stamps):
            if k % of_imu == 0:
                seen = attitude * Rotation.from_rotvec(tracker * rng.standard_normal(3))
                row = np.append(np.zeros(3), seen.as_quat())
                rows.append(
                    ("/pose", f"{GEOMETRY}PoseStamped", at + 3000, of("PoseStamped", header(at, "world"), pose(row)))
                )
            if k < len(turns):
                attitude *= Rotation.from_rotvec(turns[k])
    order = ("wheel_z", "boom", "wheel_x", "wheel_y")
    rows += [
        ("/joint_states", JOINTS, stamps[k] + 2000, joints(stamps[k], order, (told[k, 2], 3.0, *told[k, :2])))
        for k in range(first, len(stamps) if last is None else last, every)
    ]
    return write_bag(folder, sorted(rows, key=lambda row: row[2]))


@pytest.mark.parametrize("noise", [pytest.param(0.0, marks=pytest.mark.slow), 0.1])
def test_the_inertia_of_a_body_turned_by_its_wheels_is_found(tmp_path: Path, noise: float) -> None:
    """Nothing but the momentum of the wheels has a scale here; 95 % of the intervals contain the truth."""
    within, count, errors = 0, 0, list[float]()
    for seed in range(8):
        flight = flown(seed)
        found = rb.identify(
            flight.scene(), [str(recorded(flight, tmp_path / str(seed), seed, noise=noise))], ["inertia"]
        )
        for number in found.parameters:
            if re.fullmatch("inertia.[xyz]{2}", number.name):
                i, j = ("xyz".index(axis) for axis in number.name[-2:])
                assert number.interval is not None
                assert number.standard_error is not None
                within += number.interval[0] <= flight.inertia[i, j] <= number.interval[1]
                errors.append(number.standard_error)
                count += 1
    assert count == 48
    assert within >= 42
    assert max(errors) < 2e-3


@pytest.mark.parametrize(
    "step", [pytest.param(0.1, marks=pytest.mark.slow), pytest.param(0.5, marks=pytest.mark.slow), np.pi / 30.0]
)
def test_rounding_of_speeds_that_hold_still_is_in_the_intervals(tmp_path: Path, step: float) -> None:
    """Drives hold the speeds: no sample differs from another, and all are off by the same."""
    times, off = np.arange(0, SECONDS, 0.01), list[float]()
    for seed in range(3):
        rng = np.random.default_rng([seed, 10])
        inertia, axes, wheels = 0.1 * np.diag([0.7, 0.9, 1.2]), np.eye(3), np.full(3, 2e-4)
        speed = rng.uniform(-200, 200, 3)

        def slope(t: float, rate: Any, inertia: Any = inertia, momentum: Any = wheels * speed) -> Any:
            return np.linalg.solve(inertia, -np.cross(rate, inertia @ rate + momentum))

        flown_by = solve_ivp(slope, (0, SECONDS), 0.4 * rng.standard_normal(3), "DOP853", times, rtol=1e-11, atol=1e-12)
        told = np.tile(np.rint(speed / step) * step, (len(times), 1))
        flight = Flight(inertia, axes, wheels, times, flown_by.y.T, told)
        path = recorded(flight, tmp_path / str(seed), seed, gyro=1e-4)
        found = rb.identify(flight.scene(), [str(path)], ["inertia"])
        assert not [each.what for each in found.omissions if each.found]
        for number in found.parameters:
            if number.standard_error and re.fullmatch("inertia.[xyz]{2}", number.name):
                i, j = ("xyz".index(axis) for axis in number.name[-2:])
                off.append(abs(number.value - inertia[i, j]) / number.standard_error)
    assert len(off) == 18
    assert max(off) < 3.5


def test_speeds_that_change_or_are_not_rounded_have_no_offset() -> None:
    times = np.arange(4) * 10**9
    still, change, rest = np.full(4, 100.1), np.array([7.0, 9.0, 12.0, 3.0]), np.zeros(4)
    told = WheelSpeeds.of("", times, np.column_stack([still, change, rest])).offset
    assert told == pytest.approx([0.1 / 12**0.5, 0.0, 0.0])
    assert not WheelSpeeds.of("", times, np.column_stack([still + np.pi / 100, change, rest])).offset.any()


def test_the_scene_found_has_the_speeds_with_which_the_recording_begins(tmp_path: Path) -> None:
    flight = flown(2)
    path, scene = recorded(flight, tmp_path / "bag", 2), flight.scene()
    slow = replace(scene.wheels[0], max_speed=20.0)
    for given in (scene, replace(scene, actuators=(slow, *scene.wheels[1:]))):
        found = rb.identify(given, [str(path)], ["inertia"]).scene
        most = [wheel.max_speed for wheel in given.wheels]
        assert [wheel.speed for wheel in found.wheels] == pytest.approx(
            np.clip(flight.speeds[0], np.negative(most), most)
        )
        assert abs(flight.speeds[0, 0]) > 20.0


@pytest.mark.slow
def test_what_slow_speeds_leave_open_is_in_the_intervals(tmp_path: Path) -> None:
    """Chords at 5 Hz are flatter than what the wheels did: of noise alone, the truth is up to 3.5 errors off."""
    worst, told = 0.0, 0
    for seed in range(8):
        flight = flown(seed, size=0.005, held=4.0, step=0.0025)
        path = recorded(flight, tmp_path / str(seed), seed, every=80)
        found = rb.identify(flight.scene(), [str(path)], ["inertia"])
        told += any("between samples of their speeds" in note for note in found.notes)
        for number in found.parameters:
            if re.fullmatch("inertia.[xyz]{2}", number.name):
                i, j = ("xyz".index(axis) for axis in number.name[-2:])
                assert number.standard_error is not None
                worst = max(worst, abs(number.value - flight.inertia[i, j]) / number.standard_error)
    assert worst < 2.6
    assert told == 8


@pytest.mark.slow
def test_torques_that_change_between_samples_are_no_omission(tmp_path: Path) -> None:
    """A log has no noise that would hide how wheels turned between its outputs."""
    text = "body: {{mass: {}, inertia: {{matrix: {}}}}}\nduration: 8\noutput_rate: 50\nactuators:\n{}"
    within, count = 0, 0
    for seed in range(6):
        rng = np.random.default_rng([seed, 12])
        truth = np.diag([0.4, 0.5, 0.6]) + 0.05 * (np.ones((3, 3)) - np.eye(3))
        wheels = "".join(
            f"  - {{type: reaction_wheel, name: wheel_{k}, axis: {rng.standard_normal(3).tolist()}, inertia: 0.005, "
            f"max_torque: 1, speed: {rng.uniform(-50, 50)}}}\n"
            for k in range(2)
        )
        commands: list[Any] = []
        for at in np.arange(0.0, 8.0, 0.5):
            (*force, x, y, z, first, second), (when, later, last) = rng.uniform(-1, 1, 8), rng.uniform(0.0, 0.4, 3)
            turn = (0.15 * x, 0.15 * y, 0.15 * z)
            commands += [
                ("wrench", rb.Wrench(tuple(force), turn, "body", int(1e9 * (at + when)))),
                ("wheel_0/command", rb.Setpoint(0.02 * first, int(1e9 * (at + later)))),
                ("wheel_1/command", rb.Setpoint(0.02 * second, int(1e9 * (at + last)))),
            ]
        log = tmp_path / f"{seed}.mcap"
        rb.simulate(rb.parse_scene(text.format(5, truth.tolist(), wheels)), commands, sinks=[McapSink(log)])
        rough = rb.parse_scene(text.format(6, np.diag([0.5, 0.5, 0.5]).tolist(), wheels))
        found = rb.identify(rough, log, ["mass", "center_of_mass", "inertia"])
        assert not any(each.found for each in found.omissions), found.notes
        for number in found.parameters:
            if re.fullmatch("inertia.[xyz]{2}", number.name):
                i, j = ("xyz".index(axis) for axis in number.name[-2:])
                assert number.interval is not None
                within += number.interval[0] <= truth[i, j] <= number.interval[1]
                count += 1
    assert count == 36
    assert within >= 33


def test_noise_in_the_speeds_is_in_the_intervals(tmp_path: Path) -> None:
    """Of the noise of the gyro alone, the truth is up to 2.6 errors off: by noise, what wheels do looks less."""
    flight, off, told = flown(2, held=4.0, dragged=True), list[float](), 0
    for seed in (100, 102):
        path = recorded(flight, tmp_path / str(seed), seed, noise=0.003, gyro=2e-4, every=1)
        found = rb.identify(flight.scene(), [str(path)], ["inertia"])
        told += any("noise in the speeds of the wheels is much of the errors" in note for note in found.notes)
        assert not any(each.found for each in found.omissions)
        for number in found.parameters:
            if re.fullmatch("inertia.[xyz]{2}", number.name) and number.standard_error is not None:
                i, j = ("xyz".index(axis) for axis in number.name[-2:])
                off.append(abs(number.value - flight.inertia[i, j]) / number.standard_error)
    assert len(off) == 12
    assert max(off) < 2.0
    assert told


def test_what_noise_in_the_speeds_does_over_a_long_flight_is_in_the_covariance(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of noise in the first speeds, which a fit takes up, it was thought that it stands for noise of the attitudes."""
    seen: list[Any] = []

    def spied(model: Model, fit: Fit, local: Any) -> NoiseOfWheels:
        seen[:] = model, fit, local, noise_of_wheels(model, fit, local)
        return seen[3]

    monkeypatch.setattr(identify, "noise_of_wheels", spied)
    flight, tracker, gyro = flown(3, size=0.003, held=2.0, seconds=40.0), 2e-4, 1e-3
    bag = recorded(flight, tmp_path / "a", 103, noise=0.005, gyro=gyro, every=10, of_imu=10, tracker=tracker)
    rb.identify(flight.scene(), [str(bag)], ["inertia"], starts=1)
    model, fit, local, found = seen
    weighted = fit.weighted @ local
    covariance = covariance_of(weighted)

    def left(other: Model) -> Any:
        predicted = other.predict(fit.z, derivatives=False)
        return np.concatenate([np.ravel(each.left / fit.noise[each.key]) for each in predicted])

    others = (model.with_speeds(methodcaller("disturbed", number)) for number in range(100, 132))
    moves = np.array([left(other) - left(model) for other in others if other is not None]) @ weighted @ covariance
    noises = {key: tracker if key[1] == ATTITUDE else gyro for key in fit.noise}
    true = covariance * min(noises[key] / fit.noise[key] for key in noises) ** 2 + moves.T @ moves / len(moves)
    assert np.sqrt(np.diag(covariance + found.spread) / np.diag(true)).min() > 0.7


def test_the_noise_of_speeds_is_that_of_their_samples_whatever_the_wheels_do() -> None:
    rng, at = np.random.default_rng(1), np.arange(0, 10_000) * 10_000_000
    smooth = 50.0 * np.sin(0.7e-9 * at)[:, None] + np.array([0.0, 20.0])
    noisy = WheelSpeeds("/w", at, smooth + [0.02, 0.1] * rng.standard_normal(smooth.shape))
    assert noisy.noise == pytest.approx([0.02, 0.1], rel=0.03)
    assert noisy.disturbed(3).noise == pytest.approx(np.sqrt(2.0) * noisy.noise, rel=0.03)
    rounded = WheelSpeeds("/w", at, np.round(smooth))
    assert rounded.noise == pytest.approx(np.full(2, 12.0**-0.5), rel=0.3)
    gap = WheelSpeeds("/w", at[[*range(5000), *range(8000, 10_000)]], smooth[[*range(5000), *range(8000, 10_000)]])
    assert max(gap.noise) < 1e-4


def test_a_table_tells_the_speeds_in_columns(tmp_path: Path) -> None:
    flight = flown(3)
    path = tmp_path / "flight.csv"
    names = ",".join(f"wheel_speed_{name}" for name in NAMES)
    lines = [
        ",".join([f"{at:.2f}", *(f"{x:.17g}" for x in rate), *(f"{x:.17g}" if k % 2 == 0 else "" for x in speed)])
        for k, (at, rate, speed) in enumerate(zip(flight.times, flight.rates, flight.speeds, strict=True))
    ]
    text = "\n".join([f"time_s,gyro_x,gyro_y,gyro_z,{names}", *lines, ""])
    path.write_text(text)
    found = rb.identify(flight.scene(), [str(path)], ["inertia"])
    assert np.allclose(found.body.inertia, flight.inertia, rtol=0.0, atol=1e-5)
    path.write_text(text.replace("wheel_speed_wheel_", "rpm_"))
    with pytest.raises(rb.LogError, match="no speeds of wheel_x, wheel_y, wheel_z, expected a column of each"):
        rb.identify(flight.scene(), [str(path)], ["inertia"])
    columns = {"gyro": ("gyro_x", "gyro_y", "gyro_z"), "wheels": ("rpm_x", "rpm_y", "rpm_z")}
    again = rb.identify(flight.scene(), [str(path)], ["inertia"], columns=columns)
    assert again.body.inertia == found.body.inertia


def test_a_recorder_that_hears_of_the_wheels_late_costs_only_the_beginning(tmp_path: Path) -> None:
    flight = flown(4)
    found = rb.identify(flight.scene(), [str(recorded(flight, tmp_path / "late", 1, first=7))], ["inertia"])
    assert np.allclose(found.body.inertia, flight.inertia, rtol=0.0, atol=2e-5)
    assert any("speeds from 0.07 to 7.99 s: only that part is fitted of the motion" in note for note in found.notes)
    speeds = WheelSpeeds("/w", np.arange(0, 8 * 10**9, 10**7), flight.speeds[:800])
    shifted = speeds.since(-(10**8))
    assert shifted.part_of(0, 8 * 10**9 - 10**7) == (0, 8 * 10**9 - 10**7), "by another clock they end later, too"
    assert shifted.part_of(0, 8 * 10**9 + 10**8) == (10**8, 8 * 10**9 + 10**8)
    assert speeds.since(10**8).part_of(-(10**8), 8 * 10**9 - 10**7) == (-(10**8), 789 * 10**7)


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    flight = flown(1)
    late = recorded(flight, tmp_path / "late", 1, first=300)
    with pytest.raises(rb.LogError, match=r"speeds of the wheels from 3 to 7\.98 s, and the motion is recorded from 0"):
        rb.identify(flight.scene(), [str(late)], ["inertia"])
    whole = str(recorded(flight, tmp_path / "whole", 1))
    with pytest.raises(
        rb.LogError, match=r"of left, right, up are not recorded.*\(/joint_states has wheel_z, boom, wheel_x, wheel_y\)"
    ):
        rb.identify(flight.scene(names=("left", "right", "up")), [whole], ["inertia"])
    told = rb.identify(flight.scene("  - {type: magnetorquer, name: rod, axis: [0, 0, 1], max_dipole: 1}\n"
                                    "effects: [{type: magnetic_field, model: uniform, field_world: [1.0e-5, 0, 0]}]\n"),
                       [whole], ["inertia"]).notes  # fmt: skip
    assert any(note.endswith("rod: no command is recorded: taken to have done nothing") for note in told)
    assert any("/joint_states: speeds of the wheels are taken as recorded" in note for note in told)
    assert not any("not all known" in note for note in told)


def test_an_imbalance_or_a_ramp_that_is_logged_at_outputs_alone_is_refused(tmp_path: Path) -> None:
    scene = rb.parse_scene(
        "body: {mass: 5, inertia: {diagonal: [0.1, 0.1, 0.1]}, frames: {jet: {position: [0, 0, 1]}}}\n"
        "initial: {angular_velocity_body: [0.1, 0.2, 0.3]}\n"
        "actuators:\n"
        "  - {type: reaction_wheel, name: wheel, axis: [0, 0, 1], inertia: 1.0e-4, max_torque: 1, max_speed: 1.0e+4,\n"
        "     imbalance: {dynamic: 1.0e-9}}\n"
        "  - {type: thruster, name: jet, frame: jet, force: 1, command: level, rise: 0.1}\n"
        "duration: 1\noutput_rate: 100\n"
    )
    quiet, pushed = tmp_path / "quiet.mcap", tmp_path / "pushed.mcap"
    rb.simulate(scene, sinks=[McapSink(quiet)])
    with pytest.raises(rb.SceneError, match="actuators: found an imbalance of wheel"):
        rb.identify(scene, [str(quiet)], ["inertia"])
    rb.simulate(scene, [("jet/command", rb.Setpoint(0.5, 10**8))], sinks=[McapSink(pushed)])
    with pytest.raises(rb.SceneError, match="actuators: found commands to jet, expected only wheels, and thrusters"):
        rb.identify(scene, [str(pushed)], ["inertia"])


@pytest.mark.parametrize("drift", [0.0, 0.01])
def test_speeds_without_stamps_are_put_on_the_clock_of_the_motion(tmp_path: Path, drift: float) -> None:
    """The log has another clock, and the motion begins after the speeds and ends before them."""
    flight = flown(4)
    begin, rows = 1_700_000_000 * 10**9, list[Row]()
    for k, (rate, speed) in enumerate(zip(flight.rates, flight.speeds, strict=True)):
        at = begin + round(flight.times[k] * 1e9)
        logged = begin + round((1.0 + drift) * flight.times[k] * 1e9) + 2 * 10**9
        if 100 <= k < len(flight.times) - 100:
            rows.append(("/imu", IMU, logged, imu(at, (0, 0, 0, 1), rate, (0, 0, 0), (False, True, False))))
        rows.append(("/joint_states", JOINTS, logged, joints(0, NAMES, speed)))
    found = rb.identify(flight.scene(), [str(write_bag(tmp_path / "bag", rows))], ["inertia"])
    assert np.allclose(found.body.inertia, flight.inertia, rtol=0.0, atol=1e-5)
    assert any("/joint_states is put" in note and "s earlier than it was logged" in note for note in found.notes)


def test_speeds_without_stamps_count_from_when_they_were_logged(tmp_path: Path) -> None:
    scene = flown(0).scene()
    times = [10**9 + 10**7 * k for k in range(30) if k not in (7, 8)]
    rows = [
        ("/joints", JOINTS, at, joints(0, NAMES, (k, 2.0, float("nan") if k == 3 else 3.0)))
        for k, at in enumerate(times)
    ]
    found = wheel_speeds(read_bag(write_bag(tmp_path / "bag", rows)), scene.wheels).since(10**9)
    assert found.time_ns.tolist() == [at - 10**9 for at in times if at != times[3]]
    assert found.speeds[:, 0].tolist() == [k for k in range(28) if k != 3]
    (remark,) = found.remarks
    assert remark.endswith(
        "as recorded, and as linear in between; without stamps, they count from when they were logged; it has 2 gaps, "
        "the longest of 0.03 s"
    )


def test_speeds_far_beyond_the_limits_of_the_wheels_are_named(tmp_path: Path) -> None:
    """As those in rpm are: the inertia would be ten times too large, and nothing in the motion would contradict it."""
    flight = flown(1)
    fastest = float(np.abs(flight.speeds).max())
    for factor, count in ((1.0, 0), (60.0 / (2.0 * np.pi), 1)):
        bag = recorded(flight._replace(speeds=factor * flight.speeds), tmp_path / f"{factor:.0f}", 1)
        scene = rb.parse_scene(flight.scene().text.replace("max_speed: 1.0e+4", f"max_speed: {fastest}"))
        notes = flight_of(read_bag(bag), scene).notes
        assert sum("if the speeds are in rpm" in note for note in notes) == count


def test_of_several_bodies_the_wheels_are_those_of_the_motion_that_is_chosen(tmp_path: Path) -> None:
    at = [10**9 * k for k in range(1, 5)]
    rows = [(f"/{body}/wheels", JOINTS, t, joints(t, NAMES, [v, v, v])) for t in at for body, v in (("a", 1), ("b", 2))]
    bag, wheels = read_bag(write_bag(tmp_path / "bag", rows)), flown(1).scene().wheels
    assert [wheel_speeds(bag, wheels, f"/{body}/imu").speeds[0, 0] for body in "ab"] == [1.0, 2.0]
