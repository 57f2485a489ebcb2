"""Recordings with sensor noise: the right body passes every check, real errors are still found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from noisy_recordings import pushed, recording

from rb_dynamics.analysis.noise import centred, judge, means, noise_of_path, typical_at
from rb_dynamics.analysis.read_track import read_track
from rb_dynamics.analysis.summary import MASS_EXPLAINS, RunSummary, summarize
from rb_dynamics.analysis.unexplained_wrench import Residual
from rb_dynamics.loads.uniform_gravity import UniformGravity
from rb_dynamics.report.inspection_text import residual_sentence
from rb_dynamics.scene.model import Scene

FEW = 8
UNLIKE_MASS = ["linear momentum balance", "mass explains the motion"]
MANY = 1000


def summary_of(seed: int, scene: Scene | None = None, uncommanded: float = 0.0) -> RunSummary:
    made = recording(seed, uncommanded)
    return summarize(read_track(made.bag, scene or made.scene()))


def accused(seeds: range) -> list[int]:
    """Return the seeds of recordings that fail a check although body and scene are right."""
    return [seed for seed in seeds if not summary_of(seed).passed]


def test_the_body_that_flew_is_not_accused() -> None:
    assert not accused(range(FEW))


@pytest.mark.slow
def test_an_impulse_summed_over_a_noisy_attitude_accuses_nobody() -> None:
    """Noise of the attitude adds up in the impulse of a force in body axes, to more than the noise of the velocity.

    Nor is the constant acceleration taken for a lag of the twist, of which it tells nothing.
    """
    for seed in range(8):
        made = pushed(seed)
        assert summarize(read_track(made.bag, made.scene())).passed
    heavy = summarize(read_track(made.bag, made.scene(mass=1.02)))
    assert [check.name for check in heavy.checks if not check.passed] == UNLIKE_MASS


def test_a_weight_by_the_scene_tells_nothing_of_the_mass() -> None:
    """Of a fall, the given mass was said to be found, whatever it was: its own weight counted as a recorded force."""
    gravity = (0.0, 0.0, -9.81)
    made = pushed(1, gravity)
    for mass in (1.0, 2.0):
        scene = replace(made.scene(mass=mass), effects=(UniformGravity(gravity),))
        found = summarize(read_track(made.bag, scene))
        assert found.residual is not None
        assert found.residual.mass == pytest.approx(made.body.mass, abs=4.0 * found.residual.mass_error)
        assert found.residual.mass_error < 0.01 * made.body.mass
        assert [check.passed for check in found.checks if check.name == MASS_EXPLAINS] == [mass == 1.0]
        fall = {name: topic for name, topic in made.bag.topics.items() if name != "/force"}
        fallen = summarize(read_track(replace(made.bag, topics=fall), scene)).residual
        assert fallen is not None
        assert fallen.mass is None


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_of_a_thousand_recordings_at_most_ten_accuse_the_body_that_flew() -> None:
    assert len(accused(range(MANY))) <= MANY // 100


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_what_is_said_to_be_seen_above_the_noise_is_found() -> None:
    """A smallest moment 1.3 times too large is found wherever the report claims to resolve 0.3."""
    tried = [(seed, left) for seed in range(0, MANY, 10) if (left := summary_of(seed).residual) is not None]
    seen = [seed for seed, left in tried if left.unseen[0] < 0.3]
    assert len(seen) > len(tried) // 2
    missed = [seed for seed in seen if judged(seed, recording(seed).scene(moments=1.3)).explained]
    assert len(missed) <= len(seen) // 20


def judged(seed: int, scene: Scene | None = None, uncommanded: float = 0.0) -> Residual:
    left = summary_of(seed, scene, uncommanded).residual
    assert left is not None
    return left


def test_another_inertia_and_mass_are_found_where_the_noise_lets_see_them() -> None:
    found = [(recording(seed), summary_of(seed).residual) for seed in range(3)]
    for seed, (made, left) in enumerate(found):
        if left is None:
            assert not made.facts["with_pose"]
            continue
        assert left.told
        if left.unseen[0] > 0.3:
            continue
        other = judged(seed, made.scene(moments=1.3))
        assert not other.explained
        assert other.explainable
        if made.facts["commanded"]:
            assert left.mass == pytest.approx(made.body.mass, abs=4.0 * left.mass_error)
            heavy = summary_of(seed, made.scene(mass=1.3))
            assert [check.name for check in heavy.checks if not check.passed] == UNLIKE_MASS


@pytest.mark.parametrize("seed", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_a_torque_that_nobody_commanded_is_found_above_noise(seed: int) -> None:
    left = judged(seed, uncommanded=0.05)
    assert not left.explained
    assert not left.explainable
    assert left.bias is None
    size = 0.05 * max(recording(seed).body.principal_moments)
    found = left.strongest
    third = (int(left.time_ns[-1]) // 3) * 1e-9
    assert found.start_ns * 1e-9 == pytest.approx(third, rel=0.2)
    assert found.end_ns * 1e-9 == pytest.approx(2.0 * third, rel=0.2)
    assert np.linalg.norm(found.torque_body) == pytest.approx(size, rel=0.3)
    said = residual_sentence(left, 0)
    assert "NO inertia explains the motion with the commands as recorded. The torque that would" in said
    assert "a torque acted" not in said
    assert "a torque that was not commanded, commands of another sign, frame or time, or a body that changed" in said


def test_noise_is_told_and_means_take_no_two_stretches() -> None:
    random = np.random.default_rng(3)
    stretch = np.repeat([0, 1, 2], [500, 3, 700])
    values = 0.2 * random.standard_normal((1203, 3)) + np.array([5.0, -7.0, 90.0])[stretch][:, None]
    noise = judge(values, stretch)
    assert noise.level == pytest.approx(0.2 * np.sqrt(3.0), rel=0.1)
    assert not noise.beyond
    assert judge(values + 0.2 * np.sin(np.arange(1203) * 0.02)[:, None], stretch).beyond
    mean, of = means(values, stretch, 4)
    assert np.bincount(of).tolist() == [125, 0, 175]
    np.testing.assert_allclose(mean[125], values[503:507].mean(axis=0))
    assert np.abs(centred(values, stretch)[500:503].mean(axis=0)).max() < 1e-12


def test_noise_that_grows_from_stretch_to_stretch_is_no_change() -> None:
    """As of a body that falls faster and faster, where the noise of its attitude turns its velocity."""
    random = np.random.default_rng(4)
    lengths = [12] * 8 + [3] * 80
    stretch = np.repeat(np.arange(len(lengths)), lengths)
    size = np.repeat(np.linspace(0.01, 1.0, len(lengths)), lengths)[:, None]
    values = size * random.standard_normal((len(stretch), 3))
    assert not judge(values, stretch).beyond
    assert judge(values + np.sin(np.arange(len(stretch)) * 0.3)[:, None], stretch).beyond


@pytest.mark.parametrize("repeats", [1, 3])
def test_a_change_in_short_stretches_is_seen_beside_long_ones(repeats: int) -> None:
    """As of a thruster whose pulses are shorter than blocks of neighbours; each sample may come several times."""
    random = np.random.default_rng(5)
    stretch = np.repeat(np.arange(26), [*[60] * 2, *[12] * 24])
    values = np.repeat(random.standard_normal((len(stretch) // repeats, 3)), repeats, axis=0)
    slope = np.where(stretch > 1, np.arange(len(stretch)) % 12, 0)[:, None]
    assert not judge(values, stretch).beyond
    assert judge(values + slope, stretch).beyond


def test_motion_at_uneven_times_is_no_noise() -> None:
    random = np.random.default_rng(3)
    times = np.arange(1000) * 20_000_000 + random.integers(0, 8_000_000, 1000)
    path = np.outer(times * 1e-9, [2.0, -1.0, 3.0]) + 1e-4 * random.standard_normal((1000, 3))
    # The median length of three numbers whose standard deviation is 1.
    assert typical_at(path, times) == pytest.approx(1.54e-4, rel=0.1)
    steps = np.array_split(np.diff(path, axis=0), [500])
    assert noise_of_path(steps, np.zeros((1, 3)), times) == pytest.approx(typical_at(path, times), rel=1e-6)
    again = np.repeat(times[::2], 2)
    assert typical_at(1e-4 * random.standard_normal((1000, 3)), again) == pytest.approx(1.54e-4, rel=0.1)


def test_of_too_few_nothing_is_told() -> None:
    noise = judge(np.arange(12.0)[:, None], np.zeros(12, dtype=np.int_))
    assert noise.sizes == ()
    assert not noise.beyond
    assert np.isinf(noise.level)


def correlated(random: np.random.Generator, count: int, part: float) -> np.ndarray:
    """Return noise of which each sample has this part of the one before."""
    noise = random.standard_normal((count, 3))
    for k in range(1, count):
        noise[k] = part * noise[k - 1] + np.sqrt(1.0 - part**2) * noise[k]
    return noise


@pytest.mark.parametrize(
    ("count", "part"),
    [
        pytest.param(1000, 0.5, marks=pytest.mark.slow),
        (1000, 0.9),
        pytest.param(5000, 0.9, marks=pytest.mark.slow),
        (5000, 0.95),
    ],
)
def test_noise_that_is_correlated_is_told_from_a_step(count: int, part: float) -> None:
    """Poses that are filtered, or that drift, failed the balances of momentum of a body that flew freely."""
    random, stretch = np.random.default_rng(7), np.zeros(count, dtype=int)
    for _ in range(20):
        noise = correlated(random, count, part)
        found = judge(noise, stretch)
        assert not found.beyond or found.coloured
        white = random.standard_normal((count, 3)) + 3.0 * (np.arange(count) > count // 3)[:, None]
        for stepped in (white, noise + 30.0 * (np.arange(count) > count // 3)[:, None]):
            found = judge(stepped, stretch)
            assert found.beyond
            assert not found.coloured
