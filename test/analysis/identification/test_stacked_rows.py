"""What is decomposed of stacked rows."""

from __future__ import annotations

import numpy as np

from rb_dynamics.analysis.identification.stacked_rows import covariance_of, sane, tame


def test_a_covariance_keeps_a_weak_direction_beside_a_strong_one() -> None:
    """(J^T J + 1)^-1 of squared derivatives has variances that are negative, or a thousand times too large."""
    random = np.random.default_rng(0)
    along, axes = (np.linalg.qr(random.standard_normal((n, 3)))[0] for n in (500, 3))
    sizes = np.array([1e9, 10.0, 1e-2])
    covariance = covariance_of(along @ np.diag(sizes) @ axes.T)
    assert np.allclose(axes.T @ covariance @ axes, np.diag(1.0 / (sizes**2 + 1.0)), atol=1e-6)
    assert np.linalg.eigvalsh(covariance).min() >= -1e-15


def test_a_sensitive_motion_that_follows_the_recording_has_not_diverged() -> None:
    """Derivatives grow along a tumble, past the limit of residuals: a motion that fitted was called none."""
    left, by = np.ones(3), np.full((3, 2), 3e13)
    assert sane(left, by)
    assert all(np.array_equal(one, other) for one, other in zip(tame(left, by), (left, by), strict=True))
    assert not sane(by[:, 0], by)
    assert not sane(left, 10.0 * by)
