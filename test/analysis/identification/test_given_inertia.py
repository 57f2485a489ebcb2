"""What `inspect --scene` says is said by the fit: of poses alone, too, and nothing that sensors may be to blame for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from noisy_recordings import Recording, flipping, recording, scene_of, shaken, spun_up

from rb_dynamics.analysis.bag_selection import part_of
from rb_dynamics.analysis.identification import given_inertia
from rb_dynamics.analysis.identification.flights import RATES
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.track import Track
from rb_dynamics.analysis.unexplained_wrench import Residual, residual
from rb_dynamics.analysis.velocities_from_poses import rates_of
from rb_dynamics.report.inspection_text import residual_sentence


def judged(track: Track) -> Residual:
    left = residual(track, 1e-6)
    assert left is not None
    return left


def track_of(made: Recording, *, without: str = "", moments: float = 1.0) -> Track:
    topics = {name: topic for name, topic in made.bag.topics.items() if name != without}
    return read_track(replace(made.bag, topics=topics), made.scene(moments=moments))


def with_rates(track: Track, rates: Any) -> Track:
    assert track.twist is not None
    return replace(track, twist=replace(track.twist, values=np.hstack([track.twist.values[:, :3], rates])))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_an_inertia_is_judged_by_poses_alone(seed: int) -> None:
    made = recording(seed)
    assert judged(track_of(made, without="/b/twist")).explained
    other = judged(track_of(made, without="/b/twist", moments=1.2))
    assert not other.explained
    assert other.explainable
    assert other.moment_errors is not None
    np.testing.assert_allclose(
        np.linalg.eigvalsh(other.inertia),
        sorted(made.body.principal_moments),
        rtol=0,
        atol=6.0 * max(other.moment_errors),
    )


@pytest.mark.parametrize("factor", [0.03, pytest.param(0.003, marks=pytest.mark.slow)])
def test_a_body_that_tumbles_away_from_its_poses_does_not_explain_them(factor: float) -> None:
    """What it leaves changes as quickly as noise does, and was taken for the noise of the poses."""
    made = recording(0)
    whole, body = track_of(made, without="/b/twist"), made.body
    light = scene_of(body.mass, factor * np.array(body.inertia), body.center_of_mass)
    assert not judged(read_track(whole.bag, light)).explained


def test_of_a_sensor_that_no_motion_follows_nothing_is_explained() -> None:
    """Torques a thousand times too large: a fit to one sensor alone may diverge, whose numbers no SVD takes."""
    made = recording(36)
    light = scene_of(made.body.mass, 1e-3 * np.array(made.body.inertia), made.body.center_of_mass)
    track = read_track(made.bag, light)
    assert track.twist is not None
    part = given_inertia._part(track, track.twist, None)
    assert part is not None
    judge = given_inertia._Judge(light.body, *part)
    assert [judge._alone(stream) for stream in judge.flight.streams] == [np.inf, np.inf]


def test_an_error_of_two_per_cent_is_found_with_its_standard_error() -> None:
    made = recording(0)
    other = judged(track_of(made, moments=1.02))
    assert other.explainable
    assert other.moment_errors is not None
    off = np.linalg.eigvalsh(other.inertia) - sorted(made.body.principal_moments)
    assert (np.abs(off) < 5.0 * np.array(other.moment_errors)).all()
    assert "does NOT explain the motion" in (said := residual_sentence(other, 0))
    assert " ± " in said


def test_a_sensor_that_shows_more_noise_than_it_has_hides_no_inertia() -> None:
    """As where torques change between its samples."""
    made = recording(31)
    track = track_of(made, moments=1.1)
    assert track.twist is not None
    part = given_inertia._part(track, track.twist, None)
    assert part is not None
    judge = given_inertia._Judge(made.scene(moments=1.1).body, *part)
    judge.noise = {key: (10.0 if key[1] == RATES else 1.0) * level for key, level in judge.noise.items()}
    found = judge._inertia()
    assert found is not None
    assert found.explains


def test_the_part_that_is_fitted_is_said() -> None:
    made = recording(2)
    for without, rest in (("", "is judged by its momentum alone"), ("/b/twist", "is not judged")):
        left = judged(track_of(made, without=without))
        assert "Fitted" not in residual_sentence(left, 0)
        part = replace(left, fitted_ns=(1_000_000_000, 3_000_000_000))
        assert f" Fitted: t = 0.5 to 2.5 s; the rest {rest}." in (said := residual_sentence(part, 500_000_000))
        assert ("their noise included" in said) is bool(without)


def test_a_torque_outside_of_the_middle_of_poses_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the middle of a long recording was fitted, and the inertia was said to explain all of it."""
    for uncommanded in (0.0, 0.05):
        made = recording(2, uncommanded)
        whole = track_of(made, without="/b/twist")
        # The torque acts in the first two fifths of what is left.
        late = read_track(part_of(whole, (3.2, None)), made.scene())
        monkeypatch.setattr(given_inertia, "_TURN", 0.3 * turned_in(late))
        left = judged(late)
        assert (left.explained and left.told) is not bool(uncommanded)
        if not uncommanded:
            assert left.covered > 0.95


def test_what_the_fit_rejects_is_not_hidden_by_the_error_of_the_quadrature() -> None:
    """With commands at a tenth of the samples, an error of 2 % was called an explanation."""
    for moments in (1.0, 1.02):
        track = track_of(recording(3), moments=moments)
        assert track.pose is not None
        assert track.twist is not None
        pose, twist = (
            replace(each, time_ns=each.time_ns[::10], values=each.values[::10]) for each in (track.pose, track.twist)
        )
        assert judged(replace(track, pose=pose, twist=twist)).explained is (moments == 1.0)


def test_an_unrecorded_torque_stands_out_of_noise_that_grows_with_the_rate() -> None:
    """The noise at the end was told as a torque of 0.04 s, 32 times as large."""
    made = spun_up((0.02, -0.1, -0.13))
    left = judged(read_track(made.bag, made.scene()))
    assert not left.explained
    found, torque = left.strongest, max(made.body.principal_moments) * np.array([0.02, -0.1, -0.13])
    np.testing.assert_allclose(found.torque_world, torque, rtol=0, atol=0.05 * float(np.linalg.norm(torque)))
    assert found.end_ns - found.start_ns > 60e9


def turned_in(track: Track) -> float:
    assert track.pose is not None
    rates = rates_of(track.pose)
    assert rates is not None
    begin, end = track.span_ns
    return float(np.median(np.linalg.norm(rates.twist.values[:, 3:], axis=1))) * (end - begin) * 1e-9


def test_a_bias_of_a_gyro_is_no_torque_and_no_inertia() -> None:
    track = track_of(recording(1))
    assert track.twist is not None
    left = judged(with_rates(track, track.twist.values[:, 3:] + [2e-3, -1e-3, 1e-3]))
    assert not left.explained
    np.testing.assert_allclose(left.bias, [2e-3, -1e-3, 1e-3], atol=2e-4)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_bias_is_no_torque_where_the_fit_has_other_minima(seed: int) -> None:
    """From one of them, a torque was said to have acted that nobody commanded, and a delay to explain poses alone."""
    made, bias = flipping(seed), np.array([-9.1e-3, 4.2e-3, -12.3e-3])
    track = read_track(made.bag, made.scene())
    assert track.twist is not None
    left = judged(with_rates(track, track.twist.values[:, 3:] + bias))
    np.testing.assert_allclose(left.bias, bias, atol=5e-4)
    assert left.pieces is None
    assert judged(track_of(made, without="/twist")).explained


def test_of_commands_that_are_late_nothing_is_said() -> None:
    """A torque was said to have acted that nobody commanded."""
    track = track_of(recording(3))
    late = tuple(replace(each, time_ns=each.time_ns + 10_000_000) for each in track.acting)
    left = judged(replace(track, by_scene=late))
    assert not left.told
    assert "a delay of a sensor or of the commands" in residual_sentence(left, 0)


def test_coloured_noise_is_no_torque() -> None:
    """A torque was said to have acted that nobody commanded."""
    told = []
    for seed in range(1, 4):
        track = track_of(recording(seed))
        assert track.twist is not None
        white = np.random.default_rng(seed).standard_normal(track.twist.values[:, 3:].shape)
        coloured = np.zeros_like(white)
        for k in range(1, len(white)):
            coloured[k] = 0.9 * coloured[k - 1] + np.sqrt(1.0 - 0.81) * white[k]
        left = judged(with_rates(track, track.twist.values[:, 3:] + 2e-3 * coloured))
        assert left.explained or left.untold
        told.append(left.untold)
    assert any("coloured noise" in each for each in told)


def test_what_is_left_of_poses_without_noise_is_not_said_to_be_coloured_noise() -> None:
    left = judged(track_of(shaken(), without="/twist"))
    assert not left.told
    assert "the sensors show no noise; a torque that varies faster" in left.untold
    assert "coloured" not in left.untold


@pytest.mark.parametrize("what", ["scale", "alignment"])
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (3, 10))])
def test_rates_by_another_scale_or_of_turned_axes_are_no_torque(what: str, seed: int) -> None:
    """A torque was said to have acted that nobody commanded."""
    track = track_of(recording(seed))
    assert track.twist is not None
    rates = track.twist.values[:, 3:]
    turned = rates + np.cross([0.005, 0.005, -0.005], rates)
    left = judged(with_rates(track, rates * [1.01, 0.995, 1.007] if what == "scale" else turned))
    assert not left.told
    assert not left.explained
    assert "errors of the measured rates, factors of (" in left.untold


@pytest.mark.parametrize(
    ("seed", "told"), [(0, "axes turned by 1.7°"), (2, "errors of the measured rates, of factors")]
)
def test_errors_of_rates_are_told_where_they_are_determined(seed: int, told: str) -> None:
    """A body that hardly turns about two of its axes tells nothing of theirs: a turn by 1.7° was told as any number."""
    made = flipping(seed)
    track = read_track(made.bag, made.scene())
    assert track.twist is not None
    rates = track.twist.values[:, 3:]
    assert told in judged(with_rates(track, rates + np.cross([0.02, 0.01, -0.02], rates))).untold


@pytest.mark.parametrize("what", ["rates", "attitude"])
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (3, 4))])
def test_a_sensor_that_wanders_is_no_torque(what: str, seed: int) -> None:
    """What each of pose and twist shows alone is explained: they contradict each other."""
    track = track_of(recording(seed))
    assert track.twist is not None
    assert track.pose is not None
    walk = np.cumsum(np.random.default_rng(seed).standard_normal(track.twist.values[:, 3:].shape), axis=0)
    if what == "rates":
        track = with_rates(track, track.twist.values[:, 3:] + 2e-4 * walk)
    else:
        values = track.pose.values.copy()
        count = len(values)
        half = 1e-4 * np.resize(walk, (count, 3))
        turn, w = half, values[:, 6:]
        values[:, 3:6] += w * turn + np.cross(turn, values[:, 3:6])
        values[:, 6] -= np.sum(turn * track.pose.values[:, 3:6], axis=1)
        track = replace(track, pose=replace(track.pose, values=values))
    left = judged(track)
    assert left.explained or not left.told


@pytest.mark.slow
def test_torques_that_are_all_weaker_are_told_beside_another_inertia() -> None:
    track = track_of(recording(3))
    stronger = tuple(replace(each, torque=each.torque / 0.95) for each in track.acting)
    left = judged(replace(track, by_scene=stronger))
    assert left.factor == pytest.approx(0.95, rel=1e-2)
    assert "A factor of 0.9" in residual_sentence(left, 0)
    assert judged(track_of(recording(3), moments=1.05)).factor is None


def with_hole(made: Recording, begin: int, end: int) -> Recording:
    """Return a recording without these samples."""
    topics = {
        name: topic.only(~np.isin(np.arange(topic.count), np.arange(begin, end))) if topic.count > 1 else topic
        for name, topic in made.bag.topics.items()
    }
    return replace(made, bag=replace(made.bag, topics=topics))


def test_an_inertia_is_judged_by_a_part_without_a_hole() -> None:
    """Of a body that turns by 15 rad meanwhile, the motion was followed over the hole."""
    made = with_hole(flipping(1), 800, 1300)
    left = judged(track_of(made))
    assert left.explained
    assert left.fitted_ns is not None
    assert left.fitted_ns[1] <= 800 * 20_000_000 or left.fitted_ns[0] >= 1300 * 20_000_000
