"""What a fit lacks is found where it is there, and only there."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from identified_flights import GYROSTAT, flown, guess, random_body

from rb_dynamics import Identification, MemorySink, RigidBody, identify, parse_scene, simulate
from rb_dynamics.analysis.identification.estimation import fitted
from rb_dynamics.analysis.identification.flights import ATTITUDE, POSITION, RATES, Flight, Stream
from rb_dynamics.analysis.identification.identify import _of_parts, _Report
from rb_dynamics.analysis.identification.measurement_model import Model
from rb_dynamics.analysis.identification.model_omissions import Omission, _candidates, trials
from rb_dynamics.analysis.identification.parameters import AXES, PLACES
from rb_dynamics.analysis.identification.rotations import products, quaternions
from rb_dynamics.loads.gyrostat_rotor import Rotor

TORQUE = np.array([0.06, -0.08, 0.05])


def flight_of(seed: int, **options: Any) -> tuple[RigidBody, Flight]:
    """Return a body and a flight of it under commands, of which a gyro and a pose tell."""
    random = np.random.default_rng(seed)
    body = random_body(random)
    return body, flown(body, random, seconds=2.0, torque=1.0, force=2.0, pose=1e-3, **options)


def furthest(found: Identification, body: RigidBody) -> float:
    """Return by how many standard errors the inertia is off at most."""
    truth = {f"inertia.{axis}": np.array(body.inertia)[place] for axis, place in zip(AXES, PLACES, strict=True)}
    return max(abs(p.value - truth[p.name]) / (p.standard_error or np.nan) for p in found.parameters if p.name in truth)


@pytest.mark.slow
def test_a_constant_torque_that_hides_in_the_noise_is_found_and_named() -> None:
    body, flight = flight_of(3, unrecorded=TORQUE)
    value = TORQUE * max(body.principal_moments)

    found = identify(guess(body), [flight], ["inertia", "mass", "gyro_bias", "delay", "gyro_alignment"])

    first = found.omissions[0]
    assert first.found
    assert first.what == "a constant torque in body axes"
    assert first.names == ("effects[0].schedule[0].torque",)
    assert np.all(np.abs(np.array(first.value) - value) < 3.0 * np.array(first.standard_error))
    # Without it they would be far off, and said with confidence.
    assert first.shift > 2.0
    assert furthest(found, body) < 2.5
    assert found.passed
    assert not any(each.found for each in found.omissions[1:])
    (note,) = found.notes
    assert note.startswith("a constant torque in body axes of (")
    assert "explains the residuals" in note
    # What is found stands in the scene, and can be asked for by its name there: that is no doubt any more.
    told = json.loads(json.dumps(found.as_dict()))["omissions"][0]
    assert told["effect"]["schedule"][0]["torque"] == list(first.value)
    assert parse_scene(found.scene.text).effects == found.scene.effects
    again = identify(found.scene, [flight], ["inertia", "mass", "gyro_bias", "effects[0].schedule[0].torque"])
    assert not any(each.found for each in again.omissions)
    assert not again.notes
    doubled, plain = (next(p for p in f.parameters if p.name == "inertia.xx") for f in (found, again))
    assert (plain.standard_error or 0.0) < 0.7 * (doubled.standard_error or 0.0)


@pytest.mark.slow
def test_without_a_torque_that_is_as_large_as_those_commanded_nothing_is_known() -> None:
    """It was said that without it numbers would be 0 standard errors elsewhere."""
    body, flight = flight_of(3, unrecorded=12.0 * TORQUE)

    found = identify(guess(body), [flight], ["inertia", "mass"])

    assert found.omissions[0].found
    assert found.as_dict()["omissions"][0]["shift"] is None
    assert "Without it nothing would be known of the body" in found.notes[0]


@pytest.mark.parametrize("seed", range(4))
def test_in_a_flight_of_which_all_is_told_nothing_is_found(seed: int) -> None:
    body, flight = flight_of(seed, bias=0.01)

    found = identify(guess(body), [flight], ["inertia", "mass", "gyro_bias"])

    assert {each.what for each in found.omissions} >= {"a constant torque in world axes", "a linear drag of rotation"}
    assert not any(each.found for each in found.omissions)
    assert not found.notes


def test_a_constant_force_a_bias_and_a_delay_are_told_from_a_torque() -> None:
    body, flight = flight_of(5)
    (channel,) = flight.channels
    # What acted is more than what was recorded.
    less = channel.held - np.array([0.4, 0.0, -0.3, *np.zeros(12)])
    pushed = replace(flight, channels=(replace(channel, held=less),))
    _, biased = flight_of(5, bias=np.array([0.02, -0.01, 0.03]))
    late = replace(flight, channels=(replace(channel, time_ns=channel.time_ns - 20_000_000),))

    for given, what, value in (
        (pushed, "a constant force in body axes", [0.4, 0.0, -0.3]),
        (biased, "a bias of the gyro", [0.02, -0.01, 0.03]),
        (late, "a delay", [0.02]),
    ):
        found = identify(guess(body), [given], ["inertia", "mass"])
        first, count = found.omissions[0], len(value)
        assert (first.what, first.found) == (what, True)
        off = np.array(first.value[:count]) - value
        assert np.all(np.abs(off) < 3.0 * np.array(first.standard_error[:count])), what
        assert furthest(found, body) < 2.5


@pytest.mark.slow
def test_what_explains_a_part_only_widens_the_intervals() -> None:
    seconds = np.arange(200) / 100.0
    body, flight = flight_of(7, unrecorded=TORQUE * (1.0 + 0.5 * np.sin(9.0 * seconds[:, None])))

    found = identify(guess(body), [flight], ["inertia", "mass"])

    assert not any(each.found for each in found.omissions)
    assert not any(each.name.startswith("effects[") for each in found.parameters)
    (told,) = (note for note in found.notes if "a constant torque in body axes" in note)
    assert ") ± (" in told
    assert ") N m that is not in the scene would explain a part of the residuals, not all" in told
    assert furthest(found, body) < 2.5


@pytest.mark.parametrize(
    ("sizes", "told"), [((2.0, 2.0), "s that"), ((0.5, -0.5), "s, so that its size is not known,")]
)
def test_what_explains_a_part_is_told_with_its_errors(sizes: tuple[float, float], told: str) -> None:
    """Together two numbers may be far from zero by an F test, though each is not."""
    value = (sizes[0] * 4e-5, sizes[1] * 6e-5)
    found = Omission("a delay", ("delay",), value, (4e-5, 6e-5), "s", 1e-9, np.inf, False, None)
    (note,) = _of_parts([found], cast(Any, None))
    assert note.startswith(f"a delay of ({value[0]:.3g}, {value[1]:.3g}) ± (4e-05, 6e-05) {told}")


@pytest.mark.slow
def test_a_torque_is_relative_to_an_inertia_that_no_torque_tells() -> None:
    """Twice the inertia and twice the torque give the same motion."""
    seconds = np.arange(200) / 100.0
    body, flight = flight_of(7, unrecorded=TORQUE * (1.0 + 0.5 * np.sin(9.0 * seconds[:, None])))
    alone = replace(flight, channels=())
    found = identify(guess(body), [alone], ["inertia"])
    torques = [note for note in found.notes if "torque" in note and "a part of the residuals" in note]
    assert torques
    assert all(") N m, for the inertia kept, that is not in the scene" in note for note in torques)


SPINNER = """
body: {mass: 1, inertia: {diagonal: [4.6, 1.4, 5.4]}}
initial: {angular_velocity_body: [6, -3, 5]}
effects:
  - {type: quadratic_drag, rotation: [0.02, 0.01, 0.02]}
  - {type: rotor, axis_body: [0, 0, 1], axial_inertia: 0.02, spin_rate: 2000}
duration: 2
output_rate: 200
"""


def test_an_error_of_the_gyro_that_is_not_told_does_not_take_the_inertia() -> None:
    """Drag alone tells how a gyro is turned about the axis of a rotor: in slow noise, not to a radian.

    One step went there, and what it moved by hundreds of standard errors was not known any more.
    """
    scene, sink, random = parse_scene(SPINNER), MemorySink(), np.random.default_rng(0)
    simulate(scene, [], [sink])
    rates = np.array([each.angular_velocity_body for each in sink.samples])
    slow = [np.convolve(random.standard_normal(len(rates) + 14), np.ones(15) / 15.0, "valid") for _ in range(3)]
    tilted = rates @ np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -0.02], [0.0, 0.02, 1.0]])
    noisy = tilted + 0.01 * np.stack(slow, axis=1) + 1e-3 * random.standard_normal(rates.shape)
    times = np.array([each.time_ns for each in sink.samples])
    flight = Flight("flight", (Stream("gyro", RATES, times, noisy, gyro=True),))
    ball = replace(scene, body=RigidBody.from_matrix(1.0, (3.8 * np.eye(3)).tolist()))

    found = identify(ball, [flight], ["inertia", "gyro_bias", "effects[0].rotation"], starts=1)

    assert found.passed
    assert sorted(found.body.principal_moments) == pytest.approx([1.4, 4.6, 5.4], rel=0.05)
    assert all(max(each.standard_error) <= 0.3 for each in found.omissions if each.unit == "rad")


def test_axes_that_nothing_but_the_gyro_knows_are_its_own() -> None:
    """A gyro turned against axes in which drag alone is diagonal took the ratios of a racket."""
    random = np.random.default_rng(0)
    body = random_body(random)
    for torque in (0.0, 1.0):
        model = Model(guess(body), [flown(body, random, seconds=1.0, torque=torque)], ("inertia_ratios",))
        assert any(each.part == "gyro_alignment" for each in _candidates(model, np.zeros(model.layout.count))) == bool(
            torque
        )


def test_numbers_that_something_else_may_have_moved_stay_told() -> None:
    body, flight = flight_of(3)
    model = Model(guess(body), [flight], ("inertia", "mass"))
    fit, step = fitted(model, 1, "linear", 0), np.zeros(model.layout.count)
    step[model.layout["shape"].at] = 1.0
    plain, moved = (_Report(model, fit, ["inertia"], moved=some).identification() for some in ([], [step]))
    assert moved.body == plain.body
    assert moved.passed
    assert min(moved.principal_errors) > 10.0 * min(plain.principal_errors)


def test_what_is_lacking_does_not_depend_on_how_close_the_search_came() -> None:
    """A step for the candidate alone took what the fit itself had left for a part of it."""
    _, flight = flight_of(4)
    model = Model(guess(random_body(np.random.default_rng(4))), [flight], ("inertia", "mass", "gyro_bias"))
    fit = fitted(model, 1, "linear", 0)
    errors = np.sqrt(np.diagonal(np.linalg.inv(fit.weighted.T @ fit.weighted + np.eye(len(fit.z)))))
    here, near = trials(model, fit), trials(model, fit._replace(z=fit.z + 0.03 * errors))
    assert len(here) == len(near) > 3
    for one, other in zip(here, near, strict=True):
        assert np.abs((one.value - other.value) / one.standard_error).max() < 1e-3


@pytest.mark.parametrize("size", [0.5, 2.0])
def test_what_may_be_zero_by_its_own_errors_explains_nothing(size: float) -> None:
    """Where a sample lies on the edge of a command one step says much of a delay, and the fit after it nothing."""
    found = Omission("a delay", ("delay",), (size * 4e-5, -size * 6e-5), (4e-5, 6e-5), "s", 1e-9, np.inf, True, None)
    assert found.significant == (size > 1.0)


def test_a_rotor_that_the_scene_lacks_is_named() -> None:
    """It was taken for a torque that explained all, with numbers up to 15 standard errors off."""
    true, sink, random = parse_scene(GYROSTAT), MemorySink(), np.random.default_rng(0)
    simulate(true, [], [sink])
    times = np.array([each.time_ns for each in sink.samples])
    rates = np.array([each.angular_velocity_body for each in sink.samples])
    turned = np.array([each.orientation_xyzw for each in sink.samples])
    turned = products(turned, quaternions(1e-3 * random.standard_normal(rates.shape)))
    moved = np.array([each.position_world for each in sink.samples]) + 1e-3 * random.standard_normal(rates.shape)
    noisy = rates + 5e-3 * random.standard_normal(rates.shape)
    kinds = {ATTITUDE: turned, POSITION: moved, RATES: noisy}
    flight = Flight("flight", tuple(Stream("body", kind, times, values) for kind, values in kinds.items()))
    momentum = np.array([0.02, -0.01, 0.02])
    text = GYROSTAT.replace("  - {type: rotor, axis_body: [2, -1, 2], axial_inertia: 1e-4, spin_rate: 300}\n", "")
    without = parse_scene(text.replace("[0.05, 0.09, 0.11]", "[0.08, 0.08, 0.08]"))

    # One made in Python has no text to which the rotor could be added.
    for scene in (without, replace(without, body=replace(without.body, mass=3.0))):
        found = identify(scene, [flight], ["inertia", "mass"])

        first = found.omissions[0]
        assert (first.what, first.found, first.unit) == ("a rotor momentum in body axes", True, "N m s")
        assert np.all(np.abs(np.array(first.value) - momentum) < 3.0 * np.array(first.standard_error))
        assert furthest(found, true.body) < 2.5
        assert "a rotor momentum in body axes of (0.0" in found.notes[0]
        # What is found stands in the scene as a rotor, and can be asked for by its name there.
        rotor = found.scene.effects[1]
        assert isinstance(rotor, Rotor)
        assert rotor.momentum_body == pytest.approx(first.value)
        assert first.entry is not None
        assert rotor.axial_inertia == first.entry["axial_inertia"]
    again = identify(found.scene, [flight], ["inertia", "mass", "effects[1].momentum_body"])
    assert not again.notes
    assert not any(each.found for each in again.omissions)
