"""Errors of a fit hold where its residuals are not white."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, lfilter
from scipy.special import stdtrit

from rb_dynamics.analysis.identification.residual_whiteness import (
    DOUBT,
    axes_of,
    bands_of,
    noise_beneath,
    root_of,
    uneven,
    whiteness,
    widened,
)

COUNT, PARAMETERS, DRAWS = 300, 6, 150


@pytest.mark.parametrize(("slow", "shake"), [(0.0, 0.0), (0.9, 0.0), (0.97, 0.0), (0.95, 3.0)])
def test_95_of_100_intervals_hold_the_truth_with_slow_noise_and_with_a_vibration_over_it(
    slow: float, shake: float
) -> None:
    random = np.random.default_rng(1)
    time = np.linspace(0.0, 1.0, COUNT)
    held = []
    for _ in range(DRAWS):
        # Parameters that act slowly, as those of a flight do.
        waves = np.cos(np.pi * time[:, None, None] * random.uniform(0.0, 6.0, (3, PARAMETERS)) + random.uniform(0, 7))
        by = waves.reshape(3 * COUNT, PARAMETERS)
        noise = lfilter([np.sqrt(1.0 - slow**2)], [1.0, -slow], random.standard_normal((2 * COUNT, 3)), axis=0)[COUNT:]
        noise = noise + shake * np.sin(350.0 * time + random.uniform(0, 7))[:, None]
        error, *_ = np.linalg.lstsq(by, noise.ravel(), rcond=None)
        left = noise.ravel() - by @ error
        strength = np.sqrt(left @ left / (len(left) - PARAMETERS))
        white = np.linalg.inv(by.T @ by) * strength**2
        root = root_of(white)
        covariance, freedom = widened(root, bands_of(left / strength, by / strength, root, [COUNT]))
        covariance /= DOUBT**2
        assert np.linalg.eigvalsh(covariance - white)[0] >= -1e-9 * np.linalg.eigvalsh(covariance)[-1]
        held.append(np.abs(error) <= stdtrit(freedom, 0.975) * np.sqrt(np.diag(covariance)))

    assert 0.91 <= np.mean(held) <= 0.995


def judged(noise: Any) -> bool:
    left = noise / noise.std()
    return whiteness([left], bands_of(left.ravel(), np.zeros((left.size, 1)), np.eye(1), [len(left)]))[0]


@pytest.mark.parametrize("seed", range(5))
def test_a_slow_change_far_below_the_noise_of_a_sample_is_seen(seed: int) -> None:
    noise = np.random.default_rng(seed).standard_normal((300, 3))

    assert judged(noise)
    assert not judged(noise + 0.35 * np.cos(np.linspace(0.0, 9.0, 300))[:, None])


@pytest.mark.parametrize("kind", ["white", "unequal", "filtered", "coarse", "wild"])
def test_noise_beneath_residuals_is_told_from_them(kind: str) -> None:
    random = np.random.default_rng(3)
    noise, step, slow = random.standard_normal((2000, 3)), 0.0, np.sin(np.linspace(0.0, 20.0, 2000))[:, None]
    if kind == "unequal":
        noise *= (1.0, 1.0, 30.0)
    elif kind == "filtered":
        noise = lfilter(*butter(2, 0.1), noise, axis=0)
    elif kind == "coarse":
        step = 3.0
        noise = step * (np.round(7.0 * slow / step) - 7.0 * slow / step) + np.zeros((2000, 3))
    elif kind == "wild":
        noise[::100] += 30.0
    strength = 1.0 if kind == "wild" else float(noise.std())
    for change in (0.0, 40.0 * strength * slow):
        assert 0.5 * strength < noise_beneath(noise + change, 0.02, step) < 1.5 * strength
    assert noise_beneath(noise[:10], 0.02, step) == np.inf


@pytest.mark.parametrize("sizes", [(1.0, 1.0, 1.0), (0.4, 0.4, 1.6)])
def test_errors_are_those_of_the_axis_that_tells_where_axes_are_not_equally_noisy(sizes: tuple[float, ...]) -> None:
    random = np.random.default_rng(5)
    # Each axis tells a number of its own, and all tell the fourth.
    by = np.zeros((COUNT, 3, 4))
    by[:, range(3), range(3)] = random.standard_normal((COUNT, 3))
    by[:, :, 3] = random.standard_normal((COUNT, 3))
    rows = by.reshape(3 * COUNT, 4)
    errors, told = [], []
    for _ in range(400):
        noise = (sizes * random.standard_normal((COUNT, 3))).ravel()
        error, *_ = np.linalg.lstsq(rows, noise, rcond=None)
        left = noise - rows @ error
        strength = np.sqrt(left @ left / (len(left) - 4))
        root = root_of(strength**2 * np.linalg.inv(rows.T @ rows))
        covariance = uneven(root, axes_of(left / strength, rows / strength, root, [COUNT]))
        errors.append(error)
        told.append(np.diag(covariance))
    assert np.mean(np.square(errors), axis=0) == pytest.approx(np.mean(told, axis=0), rel=0.2)
