"""Segments of a flight that are joined: the flight from a single start, or one that a small disturbance moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from identified_flights import flown, guess, random_body
from scipy.spatial.transform import Rotation

from rb_dynamics import identify
from rb_dynamics.analysis.identification import multiple_shooting
from rb_dynamics.analysis.identification.estimation import fitted
from rb_dynamics.analysis.identification.flights import ATTITUDE, Flight
from rb_dynamics.analysis.identification.measurement_model import Model
from rb_dynamics.analysis.identification.multiple_shooting import joined
from rb_dynamics.analysis.identification.sensor_noise import noise_shown
from rb_dynamics.analysis.identification.stacked_rows import information
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import LogError
from rb_dynamics.motion.fixed_step_kernel import Tally, counted_by


def near_the_middle_axis(seed: int) -> tuple[RigidBody, Flight]:
    """Return a body, and a flight of it that begins about its middle axis: one of tools/calibrate_identify.py."""
    random = np.random.default_rng(seed)
    body = random_body(random)
    seconds, off, _ = 10.0 ** random.uniform((1.5, -7.0, -4.0), (2.8, -3.0, -2.0))
    _, axes = np.linalg.eigh(np.array(body.inertia))
    spin = 2.0 * (axes[:, 1] + off * random.standard_normal(3))
    still = np.zeros((round(20.0 * seconds), 3))
    return body, flown(body, random, seconds=seconds, rate=20.0, spin=spin, unrecorded=still)


@pytest.mark.parametrize("moves", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_they_give_numbers_and_errors_of_a_flight_from_a_single_start(moves: bool) -> None:
    random = np.random.default_rng(3)
    body = random_body(random, center=0.05 * moves)
    force, pose = (2.0, 1e-3) if moves else (0.0, None)
    made = flown(body, random, seconds=8.0, torque=0.3, force=force, pose=pose, bias=(0.01, -0.02, 0.01))
    names = ("inertia", "gyro_bias", "delay", *(("mass", "center_of_mass") if moves else ()))
    model = Model(guess(body), [made], names)
    noise = noise_shown(model)
    with counted_by(Tally()):
        whole = fitted(model, 1, "linear", 0)
        found = joined(model, [np.zeros(len(whole.z)), whole.z], noise, 30.0)
    assert whole.disturbance is None
    assert found is not None
    assert found.disturbance == 0.0
    told = information(whole.weighted)
    apart = found.z - whole.z
    # A tenth of a standard error.
    assert apart @ told @ apart < 0.01 * len(apart)
    errors = [
        np.sqrt(np.diagonal(np.linalg.inv(of + np.eye(len(apart))))) for of in (told, information(found.weighted))
    ]
    assert errors[1] == pytest.approx(errors[0], rel=0.02)


@pytest.mark.slow
def test_starts_are_compared_in_the_first_segments_of_a_long_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(3)
    body = random_body(random)
    model = Model(guess(body), [flown(body, random, seconds=20.0, torque=0.3)], ("inertia",))
    # So that no start leaves only noise.
    noise = {key: 0.1 * level for key, level in noise_shown(model).items()}
    begun, begin = [], multiple_shooting._Shooting.begun
    monkeypatch.setattr(
        multiple_shooting._Shooting, "begun", lambda own, z: (begun.append(len(own.segments)), begin(own, z))[1]
    )
    found = []
    for most in (6, 200):
        monkeypatch.setattr(multiple_shooting, "_COMPARED", most)
        with counted_by(Tally()):
            start = fitted(model, 1, "linear", 0).z
            found.append(joined(model, [start, 0.9 * start], noise, 30.0))
    whole = begun[-1]
    assert whole > 6
    assert begun == [6, 6, whole, whole, whole]
    assert found[0].z == pytest.approx(found[1].z, abs=1e-4)


@pytest.mark.slow
def test_a_spin_whose_start_has_too_few_digits_is_followed_to_its_noise() -> None:
    body, made = near_the_middle_axis(10)
    found = identify(guess(body), [made], ["inertia_ratios"])
    (left,) = found.residuals
    assert (found.passed, left.white) == (True, True)
    assert left.rms == pytest.approx(5e-3, rel=0.05)
    assert not any("disturbance" in note for note in found.notes)
    truth = np.array(body.inertia) / np.trace(np.array(body.inertia))
    fitted = np.array(found.body.inertia) / np.trace(np.array(found.body.inertia))
    assert np.abs(fitted - truth).max() < 1e-3


@pytest.mark.slow
def test_of_a_spin_that_has_not_flipped_nothing_is_known() -> None:
    """Bodies with ratios of 0.22 to 0.47 and of 0.009 to 0.50 left the same noise; one was 255 errors off."""
    body, made = near_the_middle_axis(20)
    found = identify(guess(body), [made], ["inertia_ratios"])
    assert not found.passed
    assert not any(each.known for each in found.parameters)


def test_attitudes_that_no_segment_follows_end_the_search() -> None:
    """Of Euler angles in degrees that were taken for radians, every start was searched for minutes."""
    random = np.random.default_rng(7)
    body = random_body(random)
    made = flown(body, random, seconds=1.5, spin=(0.8, -0.9, 0.7), torque=0.3, pose=1e-3)
    (turns,) = (stream for stream in made.streams if stream.kind == ATTITUDE)
    angles = Rotation.from_quat(turns.values).as_euler("xyz", degrees=True)
    wrong = replace(turns, values=Rotation.from_euler("xyz", angles).as_quat())

    with pytest.raises(LogError, match=r"follows the attitudes of pose, not even over segments.* such as gravity"):
        identify(guess(body), [replace(made, streams=(wrong,))], ["inertia"], starts=2)
