"""The best lag between two recordings, and what is said of how far it can be trusted."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rb_dynamics.analysis.interpolated_signal import MotionSignals, Signal
from rb_dynamics.analysis.time_alignment import best_lag
from rb_dynamics.errors import LogError
from rb_dynamics.numerics.rotation_arrays import exponentials, product

GENERATOR = np.random.default_rng(5)
TIMES = np.arange(600) * 20_000_000
# Sums of sines without a common period.
PHASES = GENERATOR.uniform(0.0, 6.0, (3, 7))
FREQUENCIES = GENERATOR.uniform(0.2, 3.0, (3, 7))


def wandering(time_ns: np.ndarray, noise: float = 0.0) -> MotionSignals:
    seconds = time_ns[:, None, None] * 1e-9
    rates = np.sin(FREQUENCIES * seconds + PHASES).sum(axis=2) + noise * GENERATOR.standard_normal((len(time_ns), 3))
    return MotionSignals(rate=Signal.of(time_ns, rates))


@given(st.integers(-(10**18), 10**18))
@settings(max_examples=5, deadline=None)
def test_the_lag_of_a_motion_against_itself_is_found_to_the_nanosecond(later_ns: int) -> None:
    motion = wandering(TIMES)
    found = best_lag(motion, motion.later(later_ns))
    assert found.offset_ns == later_ns
    assert not found.doubtful
    assert found.remaining == 0.0


@pytest.mark.parametrize("later_ns", [1_234_567_890, -777_777_777])
def test_the_lag_is_found_in_noise_at_other_stamps_and_as_well_as_is_said(later_ns: int) -> None:
    part = np.sort(GENERATOR.choice(12_000_000_000, 450, replace=False))
    one, other = wandering(TIMES, 0.2), wandering(part, 0.2).later(later_ns)
    found, back = best_lag(one, other), best_lag(other, one)
    assert found.uncertainty_s is not None
    assert abs(found.offset_ns - later_ns) * 1e-9 < 2.0 * found.uncertainty_s < 0.05
    assert abs(found.offset_ns + back.offset_ns) < 2_000_000
    assert not found.doubtful


def test_as_many_lags_of_slow_noisy_motions_lie_within_what_is_said_as_should() -> None:
    # A slow motion tells little from one sample to the next: noise and interpolation then hide its slopes.
    generator, beyond = np.random.default_rng(11), 0
    for _ in range(10):
        later_ns = int(generator.integers(-(10**9), 10**9))
        part = np.sort(generator.choice(TIMES, 420, replace=False))
        phases, frequencies = generator.uniform(0.0, 6.0, (3, 7)), generator.uniform(0.0125, 0.2, (3, 7))
        both = []
        for times in (TIMES, part + 7_000_000):
            rates = np.sin(frequencies * times[:, None, None] * 1e-9 + phases).sum(axis=2)
            rates += 0.1 * generator.standard_normal(rates.shape)
            both.append(MotionSignals(rate=Signal.of(times, rates)))
        found = best_lag(both[0], both[1].later(later_ns))
        assert found.uncertainty_s is not None
        beyond += abs(found.offset_ns - later_ns) * 1e-9 > 1.5 * found.uncertainty_s  # three standard deviations
    assert beyond <= 1


@pytest.mark.parametrize("seed", [10, 45, 51])
def test_a_lag_is_not_known_better_where_noise_hides_most_of_the_slopes(seed: int) -> None:
    """Of a nearly steady spin the lags that are excluded are no interval: the true one was beyond the first of them."""
    generator = np.random.default_rng(seed)
    later_ns = int(generator.integers(-(10**9), 10**9))
    frequency, phase, size = generator.uniform(0.02, 0.06), generator.uniform(0, 6), generator.uniform(1e-3, 4e-3)
    both = []
    for times in (np.arange(2000) * 10_000_000, np.arange(2000) * 10_000_000 + 3_000_000):
        turned = 2e-9 * np.pi * frequency * times + phase
        rates = np.stack([size * np.sin(turned), size * np.cos(turned), np.full(len(times), -0.25)], axis=1)
        both.append(MotionSignals(rate=Signal.of(times, rates + 1e-3 * generator.standard_normal(rates.shape))))
    with contextlib.suppress(LogError):
        found = best_lag(both[0], both[1].later(later_ns))
        assert found.uncertainty_s is None or abs(found.offset_ns - later_ns) * 1e-9 < 1.5 * found.uncertainty_s


def test_an_outlier_of_the_attitude_and_noise_of_poses_do_not_move_the_lag() -> None:
    """One wrong sample of motion capture moved it by 26 s: the lag was sought at which it is not compared."""
    generator = np.random.default_rng(13)
    times = np.arange(6000) * 10_000_000
    rates = wandering(times).rate
    assert rates is not None
    turns = exponentials(np.cumsum(rates.values, axis=0) * 2e-3)
    noisy = product(turns, exponentials(2e-3 * generator.standard_normal((6000, 3))))
    offsets = []
    for wrong in ([], [3500], [100, 2000, 2001, 2002]):
        seen = noisy.copy()
        seen[wrong] = product(seen[wrong], exponentials(np.full((len(wrong), 3), 0.5)))
        attitude = Signal.of(times[::2] + 3_000_000, seen[::2]) if not wrong else Signal.of(times, seen)
        assert len(attitude.without_outliers().time_ns) == len(attitude.time_ns) - len(wrong)
        found = best_lag(MotionSignals(attitude=Signal.of(times, turns)), MotionSignals(attitude=attitude))
        assert not found.doubtful
        assert found.uncertainty_s is not None
        assert found.uncertainty_s < 0.1
        offsets.append(found.offset_ns * 1e-9 / found.uncertainty_s)
    assert max(map(abs, offsets)) < 1.5


def test_what_differs_beside_the_time_is_covered_by_the_uncertainty() -> None:
    """A body of another inertia: the noise, small, said 0.1 s, and the lag was 0.3 s off."""
    beyond = 0
    for seed in range(8):
        generator = np.random.default_rng(seed)
        phases, frequencies = generator.uniform(0.0, 6.0, (2, 3, 7)), generator.uniform(0.2, 3.0, (2, 3, 7))
        one, other = np.sin(frequencies[:, None] * TIMES[:, None, None] * 1e-9 + phases[:, None]).sum(axis=3)
        a, b = (MotionSignals(rate=Signal.of(TIMES, rates)) for rates in (one, one + 0.3 * other))
        found = best_lag(a, b.later(10**9))
        assert found.uncertainty_s is not None
        beyond += abs(found.offset_ns - 10**9) * 1e-9 > found.uncertainty_s
    assert beyond == 0


def test_attitudes_decide_between_the_periods_of_a_motion() -> None:
    """Rates of a tumbling body repeat themselves, and so does not what it has turned by."""
    motions = []
    for times in (TIMES, TIMES[::3] + 7_000_000):
        seconds = times * 1e-9
        angles = np.stack([0 * seconds, 0 * seconds, seconds - 0.25 * np.cos(2.0 * seconds)], axis=1)
        motions.append(MotionSignals(attitude=Signal.of(times, exponentials(angles))))
    found = best_lag(motions[0], motions[1].later(10**9))
    assert found.rival_s is None
    assert abs(found.offset_ns - 10**9) < 2_000_000


def test_noise_alone_cannot_be_aligned() -> None:
    generator = np.random.default_rng(12)
    one, other = (MotionSignals(rate=Signal.of(TIMES, generator.standard_normal((600, 3)))) for _ in range(2))
    with pytest.raises(LogError, match="--align start"):
        best_lag(one, other)


def test_a_part_of_a_motion_is_found_within_the_whole() -> None:
    motion = wandering(TIMES)
    part = motion.within(4_000_000_000, 9_000_000_000).later(55_000_000_000)
    found = best_lag(motion, part)
    assert found.offset_ns == 55_000_000_000
    assert not found.doubtful


def test_a_motion_that_repeats_itself_is_doubtful() -> None:
    rates = np.stack([np.sin(2.0 * TIMES * 1e-9), np.zeros(600), np.ones(600)], axis=1)
    motion = MotionSignals(rate=Signal.of(TIMES, rates))
    found = best_lag(motion, motion.later(500_000_000))
    assert found.doubtful
    assert found.rival_s is not None


def test_two_motions_of_nothing_in_common_are_doubtful() -> None:
    rates = np.cos(FREQUENCIES[::-1] ** 1.3 * TIMES[:, None, None] * 1.7e-9).sum(axis=2)
    found = best_lag(wandering(TIMES), MotionSignals(rate=Signal.of(TIMES + 10**15, rates)))
    assert found.doubtful


def test_attitudes_and_positions_align_where_there_is_no_twist() -> None:
    angles = np.cumsum(wandering(TIMES).rate.values * 0.02, axis=0)  # type: ignore[union-attr]
    vectors = np.column_stack([0.3 * angles[:, 0], np.zeros(600), np.zeros(600)])
    attitude = Signal.of(TIMES, exponentials(vectors))
    one = MotionSignals(attitude=attitude, position=Signal.of(TIMES, angles))
    assert best_lag(one, one.later(3_000_000_001)).offset_ns == 3_000_000_001


def test_a_body_at_rest_cannot_be_aligned() -> None:
    still = MotionSignals(rate=Signal.of(TIMES, np.zeros((600, 3))))
    with pytest.raises(LogError, match="--align start"):
        best_lag(still, still.later(10**12))
    with pytest.raises(LogError, match="--align start"):
        best_lag(MotionSignals(), still)
