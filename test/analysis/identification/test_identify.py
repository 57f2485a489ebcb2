"""What recordings tell about a body, and what they do not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from identified_flights import GYROSTAT, flown, guess, random_body
from scipy.integrate import solve_ivp

from rb_dynamics import Identification, LogError, MemorySink, RigidBody, SceneError, identify, parse_scene, simulate
from rb_dynamics.analysis.identification.estimation import fitted
from rb_dynamics.analysis.identification.flights import ACCELERATION, ATTITUDE, POSITION, RATES, Flight, Stream
from rb_dynamics.analysis.identification.identify import _Report
from rb_dynamics.analysis.identification.measurement_model import Model
from rb_dynamics.analysis.identification.model_omissions import _candidates
from rb_dynamics.analysis.identification.parameters import InertiaParameters
from rb_dynamics.analysis.identification.rotations import products, quaternions
from rb_dynamics.analysis.track import Array
from rb_dynamics.cli.commands.identify import as_text
from rb_dynamics.loads.drag import LinearDrag
from rb_dynamics.loads.gyrostat_rotor import Rotor
from rb_dynamics.scene.model import Scene
from rb_dynamics.sinks.mcap_sink import McapSink

AXES = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


def known(found: Identification, group: str) -> list[bool]:
    return [each.known for each in found.parameters if each.name.split(".")[0] == group]


def within(found: Identification, group: str, truth: Any, errors: float = 5.0) -> None:
    """Every known number of a group is within so many standard errors of the truth."""
    for each in found.parameters:
        name, _, axis = each.name.partition(".")
        axis = axis.rpartition(".")[2]
        if name == group and each.standard_error is not None:
            value = (
                np.array(truth)[AXES[axis]] if axis in AXES else np.atleast_1d(truth)["xyz".find(axis) if axis else 0]
            )
            assert abs(each.value - value) < errors * each.standard_error, each


@settings(max_examples=2, deadline=None, phases=[Phase.generate])
@given(seed=st.integers(0, 2**32 - 1))
def test_a_random_body_is_found_within_its_error(seed: int) -> None:
    random = np.random.default_rng(seed)
    body = random_body(random, center=0.05)
    bias = 0.02 * random.standard_normal(3)
    found = identify(guess(body), [flown(body, random, torque=1.0, force=2.0, pose=1e-3, bias=bias)])

    assert found.passed
    assert all(known(found, "inertia") + known(found, "mass") + known(found, "center_of_mass"))
    within(found, "inertia", body.inertia)
    within(found, "mass", body.mass)
    within(found, "center_of_mass", body.center_of_mass)
    within(found, "gyro_bias", bias)
    assert all(each.white for each in found.residuals)


def test_motion_without_torque_tells_ratios_only() -> None:
    random = np.random.default_rng(5)
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
    flight = flown(body, random, seconds=6.0, spin=(0.3, 3.0, 0.5), gyro=1e-3)
    found = identify(guess(body), [flight], ["inertia"])

    assert not found.passed
    assert not any(known(found, "inertia"))
    assert all(known(found, "inertia_ratios"))
    within(found, "inertia_ratios", np.diag([0.02, 0.03, 0.04]) / 0.09)
    assert found.unknown_combinations == ("scale of the inertia (all moments by one factor)",)
    assert identify(guess(body), [flight], ["inertia_ratios"]).passed


def test_a_flat_body_is_found_though_it_lies_on_the_edge_of_what_is_possible() -> None:
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.05))
    flight = flown(body, np.random.default_rng(3), torque=1.0, gyro=1e-3)
    found = identify(guess(body), [flight], ["inertia"])

    assert found.passed
    within(found, "inertia", body.inertia)
    np.testing.assert_allclose(found.body.inertia, body.inertia, rtol=0.0, atol=2e-4)


ROTOR = """\
body: {mass: 20, inertia: {diagonal: [1, 2, 3]}}
initial: {angular_velocity_body: [0.01, 0.5, 0.01]}
wrenches: []
effects:
  - {type: rotor, axis_body: [0, 1, 0], axial_inertia: 0.02, spin_rate: [{time: 5, rate: 0}, {time: 15, rate: 60}]}
duration: 60
output_rate: 10
"""


@pytest.fixture(scope="module")
def rotor_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a flat body that a rotor turns, at rest at the origin."""
    path = tmp_path_factory.mktemp("rotor") / "run.mcap"
    simulate(parse_scene(ROTOR), (), [McapSink(path)])
    return path


def test_a_flat_body_is_known_from_a_log_without_noise(rotor_log: Path) -> None:
    """Its errors were differences of large numbers and came out negative, so that nothing was known."""
    found = identify(parse_scene(ROTOR), rotor_log, ["inertia"])

    assert known(found, "inertia") == [True] * 6
    within(found, "inertia", np.diag([1.0, 2.0, 3.0]))


def test_the_axis_of_a_rotor_is_found(rotor_log: Path) -> None:
    """Its length, which does not count, was not determined, so that the axis was not either and kept its value."""
    axis = np.array([0.2, 2.0, -0.3])
    scene = parse_scene(ROTOR, "rough", {"effects[0].axis_body": axis.tolist()})
    found = identify(scene, rotor_log, ["effects[0].axis_body"])

    assert found.passed
    assert not any("axis_body" in each for each in found.unknown_combinations)
    values = [each.value for each in found.parameters if "axis_body" in each.name]
    assert values == pytest.approx([0.0, 1.0, 0.0], abs=1e-4)
    rotor = found.scene.effects[0]
    assert isinstance(rotor, Rotor)
    assert np.array(rotor.axis_body) / np.linalg.norm(rotor.axis_body) == pytest.approx([0.0, 1.0, 0.0], abs=1e-4)


def test_a_rotor_that_is_given_backwards_gives_a_scene_that_runs(rotor_log: Path) -> None:
    """Its inertia was negative, which no scene takes."""
    scene = parse_scene(ROTOR, "rough", {"effects[0].axis_body": [0.0, -1.0, 0.0]})
    found = identify(scene, rotor_log, ["effects[0].axial_inertia"])
    assert [each.value for each in found.parameters if "axial" in each.name] == pytest.approx([-0.02], rel=1e-4)
    assert any("axial_inertia is negative" in note for note in found.notes)
    rotor = found.scene.effects[0]
    assert isinstance(rotor, Rotor)
    assert rotor.axial_inertia == pytest.approx(0.02, rel=1e-4)
    assert rotor.axis_body == (0.0, 1.0, 0.0)


@pytest.mark.parametrize("center", [[0.0, 0.0, 0.0], [0.05, 0.0, -0.02]])
def test_a_body_is_found_from_a_log_whose_position_stays_at_zero(rotor_log: Path, center: list[float]) -> None:
    """Zero was taken to be exact, so that a centre of mass off by anything was no motion."""
    found = identify(parse_scene(ROTOR, "rough", {"body.center_of_mass": center}), rotor_log)

    assert found.passed
    assert known(found, "center_of_mass") == [True] * 3
    within(found, "center_of_mass", [0.0, 0.0, 0.0])
    within(found, "inertia", np.diag([1.0, 2.0, 3.0]))


def test_a_cube_tells_nothing_of_its_inertia() -> None:
    body = RigidBody.from_diagonal(2.0, (0.02, 0.02, 0.02))
    found = identify(guess(body), [flown(body, np.random.default_rng(6), spin=(1.0, 1.0, 1.0))], ["inertia_ratios"])

    assert not found.passed
    assert not any(known(found, "inertia_ratios"))


@pytest.mark.parametrize("gravity", ["", "effects: [{type: uniform_gravity, acceleration_world: [0, 0, 0]}]"])
def test_without_a_force_there_is_no_mass(gravity: str) -> None:
    random = np.random.default_rng(7)
    body = random_body(random, center=0.05)
    scene = parse_scene(guess(body).text + gravity)
    found = identify(scene, [flown(body, random, torque=1.0, pose=1e-3)], ["mass", "center_of_mass", "inertia"])

    assert not found.passed
    assert known(found, "mass") == [False]
    assert found.body.mass == scene.body.mass
    assert all(known(found, "center_of_mass"))


def test_of_a_spin_about_one_axis_the_centre_on_it_stays_that_of_the_scene() -> None:
    """The fit stops anywhere along the axis: that was said to be kept, and written into the scene."""
    body = RigidBody.from_diagonal(3.0, (0.02, 0.03, 0.045), (0.03, -0.02, 0.1))
    flight = flown(body, np.random.default_rng(0), seconds=10.0, spin=(0.0, 0.0, 2.0), gyro=1e-3, pose=1e-3)
    scene = parse_scene(guess(body).text, "given", {"body.center_of_mass": [0.0, 0.0, 0.3]})
    found = identify(scene, [flight], ["center_of_mass"])

    assert known(found, "center_of_mass") == [True, True, False]
    within(found, "center_of_mass", body.center_of_mass)
    assert [each.value for each in found.parameters if each.name == "center_of_mass.z"] == [0.3]
    assert found.body.center_of_mass[2] == found.scene.body.center_of_mass[2] == 0.3


def test_what_is_found_is_a_scene_that_flies_the_same() -> None:
    random = np.random.default_rng(8)
    body = random_body(random)
    found = identify(guess(body), [flown(body, random, torque=1.0, force=1.0, pose=1e-4)])
    again = parse_scene(found.scene.text)

    assert again.body.inertia == found.body.inertia
    np.testing.assert_allclose(again.body.inertia, body.inertia, rtol=0.0, atol=0.02 * max(body.principal_moments))
    assert again.body.mass == pytest.approx(body.mass, rel=0.02)


def test_several_recordings_are_of_one_body() -> None:
    random = np.random.default_rng(9)
    body = random_body(random)
    flights = [flown(body, random, torque=1.0) for _ in range(3)]
    one, three = (identify(guess(body), flights[:count], ["inertia"]) for count in (1, 3))

    assert three.passed
    within(three, "inertia", body.inertia)
    errors = [[each.standard_error or np.inf for each in found.parameters if each.asked] for found in (one, three)]
    assert np.all(np.array(errors[1]) < np.array(errors[0]))


def test_a_recording_that_is_given_twice_is_refused() -> None:
    """Its noise counted as that of two: errors were too small, and a rotor that is not there was found."""
    random = np.random.default_rng(9)
    body = random_body(random)
    made, other = (flown(body, random, torque=1.0) for _ in range(2))
    told = "^again has the samples of flight, expected recordings of different flights; give each recording once$"
    again = replace(made, name="again")
    for flights, validate in (([made, other, again], []), ([made, other], [again])):
        with pytest.raises(LogError, match=told):
            identify(guess(body), flights, ["inertia"], validate=validate)


def test_a_noisy_recording_beside_a_quiet_one_takes_nothing_from_it() -> None:
    """One noise was taken for both: residuals were not white, and all errors doubled."""
    random = np.random.default_rng(7)
    body = random_body(random)
    quiet, noisy = (flown(body, random, torque=1.0, seconds=2.0, gyro=gyro) for gyro in (2e-4, 2e-2))
    alone, both = (identify(guess(body), some, ["inertia"]) for some in ([quiet], [quiet, noisy]))

    assert both.residuals[0].white
    assert both.residuals[0].noise == pytest.approx(2e-2 / np.sqrt(2.0), rel=0.1)
    within(both, "inertia", body.inertia)
    errors = [[each.standard_error or np.inf for each in found.parameters if each.asked] for found in (alone, both)]
    assert np.all(np.array(errors[1]) < 1.2 * np.array(errors[0]))


def test_of_too_few_samples_no_noise_of_their_own_is_believed() -> None:
    random = np.random.default_rng(8)
    body = random_body(random)
    flights = [flown(body, random, seconds=3.0, gyro=5e-3)] + [flown(body, random, seconds=0.06) for _ in range(5)]
    fit = fitted(Model(guess(body), flights, ["inertia_ratios"]), 1, "linear", 0)
    assert list(fit.noise.values()) == pytest.approx([5e-3] * 6, rel=0.1)


def test_held_out_recording_is_predicted_to_its_noise() -> None:
    random = np.random.default_rng(10)
    body = random_body(random)
    flights = [flown(body, random, torque=1.0) for _ in range(2)]
    found = identify(guess(body), flights[:1], ["inertia"], validate=flights[1:])
    (left,) = found.validation

    assert left.rms == pytest.approx(5e-3, rel=0.1)
    assert (found.passed, found.validated, found.as_dict()["validated"]) == (True, True, True)
    assert identify(guess(body), flights[:1], ["inertia"]).validated is None


def test_a_held_out_flight_of_another_body_is_named_and_fails() -> None:
    random = np.random.default_rng(10)
    body = random_body(random)
    other = RigidBody.from_diagonal(body.mass, (0.01, 0.02, 0.025))
    made, strange = (flown(each, random, torque=1.0) for each in (body, other))
    found = identify(guess(body), [made], ["inertia"], validate=[strange])

    assert (found.explained, found.validated, found.passed) == (True, False, False)
    assert found.unexplained[0].startswith("the fit does not predict what was held out: residuals of")


@pytest.mark.slow
def test_a_short_fit_cannot_tell_of_a_long_flight_but_of_another_body() -> None:
    """A fit of 0.6 s leaves numbers that miss six seconds by many times the noise: that is no other body."""
    random = np.random.default_rng(2)
    body = random_body(random)
    made = flown(body, random, seconds=0.6, torque=2.0)
    held_out = flown(body, random, seconds=6.0, torque=2.0)
    heavier = RigidBody.from_matrix(body.mass, (1.6 * np.array(body.inertia)).tolist())
    strange = flown(heavier, random, seconds=6.0, torque=2.0)
    same, other = (identify(guess(body), [made], ["inertia"], validate=[each]) for each in (held_out, strange))

    assert same.validation[0].times_noise > 5.0
    assert (same.passed, same.validated, same.as_dict()["validated"]) == (True, None, None)
    assert (same.chance or 0.0) > 0.01
    assert "the fit is too uncertain to tell, as its own errors explain them" in same.unexplained[0]
    assert (other.passed, other.validated) == (False, False)
    assert other.chance == pytest.approx(0.0, abs=1e-6)
    assert "the body, or what acts on it, is another there" in other.unexplained[0]


@pytest.mark.slow
def test_a_short_fit_whose_errors_are_not_linear_is_no_other_body() -> None:
    """Four standard errors off in one direction, it was 30 off in another, in which linear errors are small."""
    random = np.random.default_rng(67)
    body = random_body(random)
    made, held_out = (flown(body, random, seconds=seconds, torque=2.0) for seconds in (0.6, 6.0))
    found = identify(guess(body), [made], ["inertia"], validate=[held_out])
    assert found.validation[0].times_noise > 5.0
    assert found.validated is None
    assert (found.chance or 0.0) > 0.01


@pytest.mark.parametrize("fit", ["delay", "gyro_scale"])
def test_what_was_found_of_sensors_holds_for_what_is_held_out(fit: str) -> None:
    """No scene has it, so it was missing from the prediction, which was then far off."""
    random = np.random.default_rng(0)
    body = random_body(random)
    flights = [flown(body, random, torque=3.0, force=1.0, pose=1e-3) for _ in range(2)]
    if fit == "delay":
        flights = [
            replace(each, channels=tuple(replace(c, time_ns=c.time_ns - 60_000_000) for c in each.channels))
            for each in flights
        ]
    else:
        flights = [replace(each, streams=(of_rates(each, 1.1), *each.streams[1:])) for each in flights]
    assert identify(guess(body), flights[:1], ["inertia", "mass", fit], validate=flights[1:]).validated is True


def of_rates(flight: Flight, scale: float) -> Stream:
    """Return the gyro of a flight with an error of its scale."""
    return replace(flight.streams[0], values=scale * flight.streams[0].values)


def test_a_scene_with_the_velocity_in_body_axes_is_fitted() -> None:
    """As of a file with the first row of `inspect`: the start that was found stood beside it, and it was refused."""
    random = np.random.default_rng(14)
    body = random_body(random)
    text = guess(body).text
    assert "initial" not in text
    scene = parse_scene(text + "\ninitial: {linear_velocity_body: [0.1, 0.2, 0.3]}\n")
    found = identify(scene, [flown(body, random, torque=1.0, force=2.0, pose=1e-3)], ["inertia"])
    assert "linear_velocity_world" in found.scene.text
    assert "linear_velocity_body" not in found.scene.text


def test_a_sample_that_is_recorded_twice_counts_once() -> None:
    random = np.random.default_rng(12)
    body = random_body(random)
    made = flown(body, random, torque=1.0)
    twice = [replace(s, time_ns=s.time_ns.repeat(2), values=s.values.repeat(2, axis=0)) for s in made.streams]
    once, again = (identify(guess(body), [each], ["inertia"]) for each in (made, replace(made, streams=tuple(twice))))
    assert np.array_equal(once.covariance, again.covariance)
    assert any("have the time of the one before, and are left out" in note for note in again.notes)


def test_stamps_coarser_than_the_samples_are_fitted() -> None:
    """As milliseconds of a gyro at 4 kHz: half of the intervals and more are 0."""
    random = np.random.default_rng(13)
    body = random_body(random)
    made = flown(body, random, torque=1.0)
    coarse = [replace(s, time_ns=np.sort(s.time_ns // 40_000_000 * 40_000_000)) for s in made.streams]
    found = identify(guess(body), [replace(made, streams=tuple(coarse))], ["inertia"])
    assert all(each.white for each in found.residuals)
    off = np.sort(found.body.principal_moments) - np.sort(body.principal_moments)
    assert (np.abs(off) < 5.0 * np.array(found.principal_errors)).all()


@pytest.mark.parametrize(
    ("name", "expected"),
    [("mas", "did you mean mass"), ("effects[0].rotation", "it has none"), ("nothing", "write one of them")],
)
def test_what_cannot_be_fitted_is_refused(name: str, expected: str) -> None:
    random = np.random.default_rng(11)
    body = random_body(random)
    with pytest.raises(SceneError, match=expected):
        identify(guess(body), [flown(body, random)], [name])


@given(st.lists(st.floats(-3.0, 3.0), min_size=5, max_size=5))
def test_every_number_is_an_inertia(shape: list[float]) -> None:
    matrix = InertiaParameters(RigidBody.from_diagonal(1.0, (1.0, 1.2, 1.5))).matrix(0.3, np.array(shape))
    low, middle, high = np.linalg.eigvalsh(matrix)

    assert low > 0.0
    assert low + middle >= high * (1.0 - 1e-9)


def test_a_fit_that_ran_away_to_a_rod_has_a_result() -> None:
    """Its least moment is rounding, below zero for some: `identify` ended with "SVD did not converge"."""
    body = RigidBody.from_diagonal(1.0, (1.0, 1.2, 1.5))
    model = Model(guess(body), [flown(body, np.random.default_rng(3), torque=1.0)], ("inertia",))
    report, least = object.__new__(_Report), []
    for long in np.linspace(16.0, 24.0, 50):
        z = np.zeros(model.layout.count)
        z[model.layout["shape"].at] = [-0.5 * long, -0.5 * long, 0.3, -2.7, -13.0]
        least.append(np.linalg.eigvalsh(model.body(z).inertia)[0])
        report.model, report.z = model, z
        assert np.isfinite(report._local()).all()
        (rotor,) = (each for each in _candidates(model, z) if each.part == "momentum_body")
        assert rotor.axial_inertia > 0.0
    assert min(least) < 0.0


def test_an_inertia_too_far_away_to_be_a_number_is_none_without_a_warning() -> None:
    """A search may try it: numpy's warnings stood between the lines of the output."""
    inertia = InertiaParameters(RigidBody.from_diagonal(1.0, (1.0, 1.2, 1.5)))
    assert not np.isfinite(inertia.matrix(0.0, np.array([400.0, 0.0, 0.0, 0.0, 0.0]))).all()


@given(st.lists(st.floats(-2.0, 2.0), min_size=5, max_size=5), st.floats(-3.0, 3.0))
def test_parameters_of_an_inertia_are_those_that_it_was_made_of(shape: list[float], size: float) -> None:
    inertia = InertiaParameters(RigidBody.from_diagonal(1.0, (1.0, 1.2, 1.5)))
    again, same = inertia.parameters(inertia.matrix(size, np.array(shape)))

    np.testing.assert_allclose([again, *same], [size, *shape], atol=1e-6)


HEAVY = "body: {mass: 1, inertia: {diagonal: [30, 30, 30]}}\neffects: [{type: quadratic_drag, rotation: [0, 0, 0]}]"
ALL = ["inertia", "gyro_bias", "effects[0].rotation"]


def pushed() -> Flight:
    body, random = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04)), np.random.default_rng(4)
    return flown(body, random, seconds=2.0, torque=30.0, spin=(1.0, 3.0, 20.0), gyro=1e-3)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_a_body_is_found_from_a_scene_a_thousand_times_too_light_or_too_heavy(factor: float) -> None:
    random = np.random.default_rng(4)
    body = random_body(random)
    flight = flown(body, random, torque=1.0, force=2.0, gyro=5e-4, pose=1e-3)
    found = identify(guess(body, scale=factor), [flight], ["mass", "inertia"], starts=1)

    assert found.passed
    assert found.explained
    within(found, "inertia", body.inertia)
    within(found, "mass", body.mass)


def test_a_start_a_thousand_times_too_heavy_is_left_for_that_of_the_balances_with_drag_too() -> None:
    found = identify(parse_scene(HEAVY), [pushed()], ALL, starts=1)

    assert found.passed
    within(found, "inertia", np.diag([0.02, 0.03, 0.04]))


def turned_with_the_world() -> Flight:
    """Return a flight whose torque is said to be in world axes, which it is not."""
    (channel,) = (flight := pushed()).channels
    held = np.hstack([channel.held[:, :3], np.zeros((len(channel.held), 6)), channel.held[:, 3:6], np.zeros((200, 3))])
    return replace(flight, channels=(replace(channel, held=held),))


def test_a_fit_that_runs_away_or_rests_far_off_says_so() -> None:
    """Which of the two, the last bits of the machine decide."""
    ran_away = ""
    try:
        found = identify(parse_scene(HEAVY), [turned_with_the_world()], ALL, starts=1)
    except LogError as error:
        ran_away = str(error)
    if ran_away:
        assert "body.inertia in the scene, which must be of the right order" in ran_away
    else:
        assert not found.passed
        assert not any(each.known for each in found.parameters)


def test_of_a_body_that_hardly_tumbles_nothing_is_said_because_no_body_is_two_errors_away() -> None:
    """The fit, not at rest, was 5 standard errors off: away from it no body had the numbers, so none was asked."""
    random = np.random.default_rng(7043)
    body = random_body(random)
    _, axes = np.linalg.eigh(np.array(body.inertia))
    seconds = random.uniform(1.0, 4.0)
    spin = 4.0 * axes[:, 1] + 0.02 * random.standard_normal(3)
    found = identify(guess(body), [flown(body, random, gyro=3e-3, seconds=seconds, spin=spin)], ["inertia_ratios"])
    assert not any(each.known for each in found.parameters if each.name.startswith("inertia"))


def test_of_a_fit_that_does_not_follow_its_recording_nothing_is_known() -> None:
    """It came to rest in a motion of its own, and told an inertia with errors of a thousandth."""
    scene = guess(RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04)))
    found = identify(scene, [turned_with_the_world()], ["inertia"], starts=2)

    assert not found.passed
    assert not any(each.known for each in found.parameters)
    assert found.scene.body == found.body == scene.body
    assert "such a fit determines nothing" in found.unexplained[0]


def test_residuals_beyond_noise_are_told_and_errors_doubled() -> None:
    random = np.random.default_rng(12)
    body = random_body(random)
    flight = flown(body, random, torque=1.0, gyro=5e-4)
    (gyro,) = flight.streams
    clean = identify(guess(body), [flight], ["inertia"])
    wave = 0.01 * np.sin(8.0 * gyro.time_ns[:, None] * 1e-9 + np.arange(3))
    found = identify(guess(body), [replace(flight, streams=(replace(gyro, values=gyro.values + wave),))], ["inertia"])
    (left,) = found.residuals

    faint = replace(gyro, values=gyro.values + 0.1 * wave)
    hidden = identify(guess(body), [replace(flight, streams=(faint,))], ["inertia"])

    assert clean.explained
    assert clean.residuals[0].white
    assert not any("white" in note for note in clean.notes)
    # Within the noise, but not white: that is said beside the intervals.
    assert hidden.explained
    assert not hidden.residuals[0].white
    assert any("are not white" in note for note in hidden.notes)
    assert clean.residuals[0].times_noise == pytest.approx(1.0, abs=0.2)
    assert found.passed
    assert not found.explained
    assert not found.as_dict()["explained"]
    assert left.times_noise == pytest.approx(0.01 / np.sqrt(2.0) / 5e-4, rel=0.3)
    assert f"are {left.times_noise:.3g} times its noise" in found.unexplained[0]
    within(found, "inertia", body.inertia, 2.5)


def test_a_scene_of_python_keeps_its_effects() -> None:
    """They were lost with its text, so that the fitted scene was another one."""
    random = np.random.default_rng(1)
    body = RigidBody.from_diagonal(2.0, (0.02, 0.03, 0.04))
    rotor = Rotor((0.0, 0.0, 1.0), 1e-3, ((0.0, 20.0),))
    scene = replace(guess(body), effects=(LinearDrag(rotation=(0.0, 0.0, 0.0)), rotor))
    flight = flown(body, random, torque=1.0)
    found = identify(scene, [flight], ["inertia", "effects[0].rotation", "effects[1].spin_rate"])
    values = {each.name: each.value for each in found.parameters}
    drag, turning = found.scene.effects

    assert drag == LinearDrag(rotation=tuple(max(0.0, values[f"effects[0].rotation.{axis}"]) for axis in "xyz"))
    assert turning == replace(rotor, spin_rate=((0.0, values["effects[1].spin_rate"]),))
    assert found.scene.body == found.body
    assert "no text says" in found.scene.text


@pytest.mark.slow
def test_a_flight_that_a_small_disturbance_moves_is_fitted_in_joined_segments() -> None:
    """A small disturbance decides when a spin about the middle axis flips: the fit to the whole determined nothing."""
    random = np.random.default_rng(5)
    body = RigidBody.from_matrix(2.0, np.diag([1.0, 1.6, 2.1]).tolist())
    gusts = 0.01 * random.standard_normal((1200, 3))
    made = flown(body, random, seconds=60.0, rate=20.0, spin=(1e-3, 3.0, 2e-3), unrecorded=gusts)
    found = identify(guess(body), [made], ["inertia_ratios"])
    assert found.passed
    assert found.explained
    assert any("a small disturbance acted" in note for note in found.notes)
    assert known(found, "inertia_ratios") == [True] * 6
    within(found, "inertia_ratios", np.diag([1.0, 1.6, 2.1]) / 4.7, 2.0)
    short = replace(made, streams=tuple(made.until(round(5e9)).streams))
    assert not any("segments" in note for note in identify(guess(body), [short], ["inertia_ratios"]).notes)


@pytest.mark.parametrize("seed", [1, 2])
def test_an_orbit_that_nothing_measures_is_that_of_the_scene(seed: int) -> None:
    """Position and velocity were fitted to what the gravity gradient tells of them, and moments up to 3 errors off."""
    scene = parse_scene("""
body: {mass: 5, inertia: {diagonal: [0.08, 0.1, 0.13]}}
initial:
  position_world: [7.0e+6, 0, 0]
  linear_velocity_world: [0, 7546.0, 0]
  angular_velocity_body: [0.02, -0.03, 0.015]
effects: [{type: central_gravity, gravitational_parameter: 3.986004418e+14, gravity_gradient: true}]
duration: 400
output_rate: 2
""")
    simulate(scene, (), [sink := MemorySink()])
    random = np.random.default_rng(seed)
    times = np.array([each.time_ns for each in sink.samples])
    turned = np.array([each.orientation_xyzw for each in sink.samples])
    attitude = products(turned, quaternions(2e-4 * random.standard_normal((len(times), 3))))
    rates = np.array([each.angular_velocity_body for each in sink.samples])
    rates += 2e-4 * random.standard_normal(rates.shape)
    flight = Flight("orbit", (Stream("pose", ATTITUDE, times, attitude), Stream("gyro", RATES, times, rates)))
    found = identify(scene, [flight], ["inertia_ratios"], starts=1)
    within(found, "inertia_ratios", np.diag([0.08, 0.1, 0.13]) / 0.31, 3.5)
    initial = found.scene.initial
    assert (initial.position_world, initial.linear_velocity_world) == ((7e6, 0.0, 0.0), (0.0, 7546.0, 0.0))


def test_a_number_near_those_that_its_effect_refuses_is_known() -> None:
    """Two standard errors below it gravity would repel, for which the effect has no load."""
    scene = parse_scene("""
body: {mass: 1, inertia: {diagonal: [1, 1.5, 2]}}
effects: [{type: central_gravity, gravitational_parameter: 10}]
""")
    random, seconds = np.random.default_rng(1), np.arange(1001) / 100.0
    times = np.rint(seconds * 1e9).astype(np.int64)
    fall = solve_ivp(lambda _, x: (x[1], -0.5 / x[0] ** 2), (0.0, 10.0), (5.0, 0.0), t_eval=seconds, rtol=1e-9)
    position = np.outer(fall.y[0], (1.0, 0.0, 0.0)) + 2.0 * random.standard_normal((1001, 3))
    attitude = quaternions(1e-3 * random.standard_normal((1001, 3)))
    flight = Flight("fall", (Stream("pose", ATTITUDE, times, attitude), Stream("pose", POSITION, times, position)))
    (found,) = identify(scene, [flight], ["effects[0].gravitational_parameter"]).parameters
    assert found.known
    assert found.standard_error is not None
    assert 0.5 * found.value < found.standard_error
    assert abs(found.value - 0.5) < 3.0 * found.standard_error


@pytest.mark.parametrize("count", [1, 2])
def test_the_bias_of_the_only_gyro_is_that_of_the_sensor_in_the_scene(count: int) -> None:
    random = np.random.default_rng(5)
    body, bias = random_body(random), np.array([0.02, -0.01, 0.03])
    names = ["imu", "spare"][:count]
    sensors = "\n".join(f"  - {{type: imu, name: {name}, rate: 50, gyro: {{bias: [1, 1, 1]}}}}" for name in names)
    scene = parse_scene(f"{guess(body).text}wrenches: []\nsensors:\n{sensors}\n")
    flight = flown(body, random, torque=1.0, bias=bias)

    for one in (scene, replace(scene, seed=7)):
        found = identify(one, [flight], ["inertia_ratios", "gyro_bias"], starts=1)
        within(found, "gyro_bias", bias)
        fitted_bias = tuple(each.value for each in found.parameters if each.name.startswith("gyro_bias"))
        # Of several it cannot be told whose it is.
        expected = fitted_bias if count == 1 else (1.0, 1.0, 1.0)
        assert [each.gyro.bias for each in found.scene.sensors] == [expected] * count


@pytest.mark.slow
def test_a_gyro_that_shows_a_constant_tells_no_bias() -> None:
    """One that spins was taken for one at rest, on a bias of 1 rad/s known to 0.01 rad/s."""
    random = np.random.default_rng(5)
    rate = random.standard_normal(3)
    rates = 3.0 * rate / np.linalg.norm(rate) + 2e-3 * random.standard_normal((601, 3))
    assert not any(each.known for each in of_gyro(random_body(random), rates).parameters)


@pytest.mark.slow
def test_slow_noise_of_a_gyro_about_a_constant_tells_no_bias() -> None:
    """A motion follows it a little better than a constant does: a spin of 3 rad/s was known to be 0.4 rad/s."""
    random = np.random.default_rng(7)
    body, rate = random_body(random), random.standard_normal(3)
    noise = 2e-3 * (random.standard_normal((400, 3)) + np.cumsum(0.02 * random.standard_normal((400, 3)), axis=0))
    found = of_gyro(body, 3.0 * rate / np.linalg.norm(rate) + noise, starts=2)
    assert not any(each.known for each in found.parameters)


def test_a_bias_has_the_error_of_a_position_that_the_motion_does_not_tell() -> None:
    # Turning steadily about one axis, an accelerometer shows by a bias what it shows elsewhere.
    random, bias = np.random.default_rng(18), np.array([0.05, -0.02, 0.08])
    scene = parse_scene("body: {mass: 2, inertia: {diagonal: [0.1, 0.102, 0.129]}}\n")
    flight = flown(scene.body, random, seconds=4.0, spin=(-0.1, 0.22, -0.22), force=1.0, gyro=3e-3, pose=3e-3)
    forces = flight.channels[0].held[:, :3]
    shown = forces / scene.body.mass + bias + 3e-2 * random.standard_normal(forces.shape)
    measured = Stream("accelerometer", ACCELERATION, flight.streams[0].time_ns[1:], shown)
    fit = ["mass", "center_of_mass", "inertia", "gyro_bias", "accelerometer"]
    found = identify(scene, [replace(flight, streams=(*flight.streams, measured))], fit, starts=1)

    assert not any(known(found, "accelerometer_position"))
    within(found, "accelerometer_bias", bias, errors=3.0)


def test_where_a_gyro_alone_does_not_tell_the_shape_it_tells_no_bias() -> None:
    """Bodies of other shapes follow other biases: two were known, one 3 standard errors off."""
    random = np.random.default_rng(2)
    scene = parse_scene(
        "body: {mass: 6, inertia: {diagonal: [0.258, 0.27, 0.295]}}\nwrenches: []\noutput_rate: 50\nduration: 5.98\n"
        f"initial: {{angular_velocity_body: {random.standard_normal(3).tolist()}}}\n"
    )
    _, rates = rates_of(scene)
    noisy = rates + [-0.041, 0.011, -0.041] + 5e-3 * random.standard_normal(rates.shape)
    found = of_gyro(scene.body, noisy)
    assert not any(each.known for each in found.parameters)


def of_gyro(body: RigidBody, rates: Any, starts: int = 4) -> Identification:
    """Return what rates (n, 3), 20 ms apart, tell of a body."""
    flight = Flight("flight", (Stream("gyro", RATES, np.arange(len(rates)) * 20_000_000, rates, gyro=True),))
    return identify(guess(body, moments=(1.0, 1.1, 1.2)), [flight], starts=starts)


def rates_of(scene: Scene) -> tuple[Array, Array]:
    """Return the times of the outputs of a run and the rates."""
    simulate(scene, (), [sink := MemorySink()])
    times, rates = zip(*((each.time_ns, each.angular_velocity_body) for each in sink.samples), strict=True)
    return np.array(times), np.array(rates)


@pytest.mark.parametrize(("inertia", "rate", "adapted"), [(0.02, 20.0, 10.0), (0.004, 10.0, 50.0)])
def test_where_only_a_product_is_determined_the_scene_has_values_with_that_product(
    inertia: float, rate: float, adapted: float
) -> None:
    """It had the two values of the scene given, whose product contradicted the recording."""
    times, rates = rates_of(
        parse_scene(GYROSTAT, "true", {"effects[1].axial_inertia": 0.01, "effects[1].spin_rate": 20.0})
    )
    noisy = rates + 5e-3 * np.random.default_rng(0).standard_normal(rates.shape)
    flight = Flight("flight", (Stream("twist", RATES, times, noisy),))
    rough = parse_scene(GYROSTAT, "rough", {"effects[1].axial_inertia": inertia, "effects[1].spin_rate": rate})

    found = identify(rough, [flight], ["inertia", "effects[1].axial_inertia", "effects[1].spin_rate"])

    values = {each.name: each for each in found.parameters}
    of_inertia, of_rate = (values[f"effects[1].{name}"] for name in ("axial_inertia", "spin_rate"))
    assert (of_inertia.known, of_inertia.value, of_inertia.adapted) == (False, inertia, False)
    assert (of_rate.known, of_rate.adapted) == (False, True)
    assert of_rate.value == pytest.approx(adapted, rel=0.05)
    assert "(adapted: " in as_text(found, False)
    assert "of effects[1].spin_rate only combinations" in found.notes[0]
    _, flown_again = rates_of(parse_scene(found.scene.text))
    assert np.sqrt(np.mean((flown_again - rates) ** 2)) < 5e-3


def test_pushes_of_unknown_scale_tell_the_mass_that_goes_with_them() -> None:
    """Mass and inertia of the scene, of which neither pushes nor body were known, contradicted the recording."""
    random = np.random.default_rng(3)
    body = random_body(random)
    flight = flown(body, random, seconds=2.0, torque=1.0, force=2.0, pose=1e-3)

    found = identify(guess(body), [flight], ["mass", "inertia", "wrench_scale"])

    assert not any(known(found, "mass") + known(found, "inertia") + known(found, "wrench_scale"))
    assert found.body.mass == pytest.approx(2.0, rel=0.01)
    np.testing.assert_allclose(found.body.inertia, body.inertia, rtol=0.0, atol=5e-3)
    adapted = {each.name.partition(".")[0] for each in found.parameters if each.adapted}
    assert adapted == {"mass", "inertia"}
