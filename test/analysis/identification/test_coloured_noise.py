"""Errors of a fit hold where its residuals are not white."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.special import stdtrit

from rb_dynamics.analysis.identification.coloured_noise import widened

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
        covariance, freedom = widened(white, left / strength, by / strength, [COUNT])
        assert np.linalg.eigvalsh(covariance - white)[0] >= -1e-9 * np.linalg.eigvalsh(covariance)[-1]
        held.append(np.abs(error) <= stdtrit(freedom, 0.975) * np.sqrt(np.diag(covariance)))

    assert 0.91 <= np.mean(held) <= 0.995
