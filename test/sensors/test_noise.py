"""Noise of the sensors: the generator against numpy's, and what its statistics measure against what was asked."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rb_dynamics.errors import SceneError
from rb_dynamics.sensors.axis_errors import AxisErrors
from rb_dynamics.sensors.random_numbers import RandomNumbers, philox

RATE = 50.0


def allan_deviation(samples: np.ndarray, count: int) -> float:
    """Return the Allan deviation of samples averaged over `count` of them."""
    means = samples[: len(samples) // count * count].reshape(-1, count).mean(axis=1)
    return math.sqrt(0.5 * float(np.mean(np.diff(means) ** 2)))


def drawn(errors: AxisErrors, count: int, seed: int = 3) -> np.ndarray:
    measure = errors.measuring(RandomNumbers(seed, "imu"), 0, RATE)
    return np.array([measure(k, (0.0, 0.0, 0.0)) for k in range(count)])


def test_the_generator_is_philox_as_numpy_has_it() -> None:
    for counter, key in (((0, 0, 0, 0), (0, 0)), ((7, 2, 0, 0), (1, 2**64 - 1)), ((2**64 - 1, 5, 1, 0), (3, 4))):
        # numpy counts up before it draws.
        whole = sum(word << 64 * k for k, word in enumerate(counter)) - 1
        before = [(whole >> 64 * k) & (2**64 - 1) for k in range(4)]
        expected = np.random.Philox(counter=np.array(before, "u8"), key=np.array(key, "u8")).random_raw(4).tolist()
        assert list(philox(counter, key)) == expected


def test_noise_density_and_random_walk_have_the_allan_deviation_that_was_asked_for() -> None:
    white = drawn(AxisErrors(noise_density=2e-3), 6000)
    walk = drawn(AxisErrors(random_walk=3e-3), 6000)
    assert np.std(white) == pytest.approx(2e-3 * math.sqrt(RATE), rel=0.02)
    for count in (1, 5, 25):
        tau = count / RATE
        found = math.sqrt(sum(allan_deviation(white[:, k], count) ** 2 for k in range(3)) / 3.0)
        assert found == pytest.approx(2e-3 / math.sqrt(tau), rel=0.08)
    for count in (20, 50):
        tau = count / RATE
        found = math.sqrt(sum(allan_deviation(walk[:, k], count) ** 2 for k in range(3)) / 3.0)
        assert found == pytest.approx(3e-3 * math.sqrt(tau / 3.0), rel=0.15)
    assert max(abs(np.corrcoef(white.T)[np.triu_indices(3, 1)])) < 0.05


def test_noise_depends_on_seed_name_and_sample_alone() -> None:
    numbers = RandomNumbers(5, "imu")
    later = numbers.normal(9, 1)
    assert RandomNumbers(5, "imu").normal(9, 1) == later
    others = {RandomNumbers(6, "imu").normal(9, 1), RandomNumbers(5, "imv").normal(9, 1), numbers.normal(9, 2)}
    assert len({later, *others, numbers.normal(8, 1)}) == 5
    assert all(0.0 < value < 1.0 for k in range(200) for value in numbers.uniform(k, 0))


def test_errors_of_an_axis_act_in_the_order_that_they_say() -> None:
    errors = AxisErrors(
        bias=(0.1, 0.0, -0.2), scale=(0.01, 0.0, 0.0), misalignment=(0.0, 0.0, math.pi / 2), range=2.0, resolution=0.25
    )
    measure = errors.measuring(RandomNumbers(0, "x"), 0, 1.0)
    # Turned to (-2, 1, 5), scaled and off by the bias: (-1.92, 1, 4.8); rounded to the resolution, cut to the range.
    assert measure(0, (1.0, 2.0, 5.0)) == pytest.approx((-2.0, 1.0, 2.0))
    assert measure(1, (1.0, 1.7, 0.3)) == pytest.approx((-1.5, 1.0, 0.0))
    assert errors.covariance(4.0)[0] == pytest.approx(0.25**2 / 12.0)


@pytest.mark.parametrize(
    ("limit", "resolution", "largest"),
    [
        (1.0, 0.6, 0.6),  # rounded after the cut it was 1.2, beyond the range
        (1.0, 0.3, 3 * 0.3),
        (0.3, 0.1, 0.3),  # three times 0.1 is 0.30000000000000004 in doubles
        (4.0, 1e-5, 4.0),  # in decimals a whole multiple
        (1.0, 1.0, 1.0),
        (2.0, 0.0, 2.0),
        (2.0, 5e-324, 2.0),  # the number of steps is beyond the range of doubles
    ],
)
def test_an_output_saturates_at_the_last_step_within_the_range(limit: float, resolution: float, largest: float) -> None:
    measure = AxisErrors(range=limit, resolution=resolution).measuring(RandomNumbers(0, "x"), 0, 1.0)
    assert measure(0, (9.0, -9.0, limit)) == (largest, -largest, largest)


def test_a_range_that_holds_no_step_is_refused() -> None:
    """Its output would always be 0."""
    with pytest.raises(SceneError, match=r"range is 1.0, expected a number of at least the resolution, 1.5"):
        AxisErrors(range=1.0, resolution=1.5)
    with pytest.raises(SceneError, match=r"range is 0.0, expected a number greater than 0"):
        AxisErrors(range=0.0)
