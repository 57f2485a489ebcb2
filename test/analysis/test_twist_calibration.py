"""A lag and a factor of a twist are told only by a motion in which nothing else looks like them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rb_dynamics.analysis.track import TimeSeries
from rb_dynamics.analysis.twist_calibration import TwistFit, fit_of_twist

TIMES = np.arange(1200) * 10_000_000
SECONDS = TIMES * 1e-9


def fitted(path: Callable[[Any], Any], speed: Callable[[Any], Any], seed: int, lag_s: float = 0.0) -> TwistFit:
    """Return the fit to a motion along x, with noise; the twist is stamped `lag_s` late."""
    random = np.random.default_rng(seed)
    position, velocity = (np.outer(of(at), (1.0, 0.0, 0.0)) for of, at in ((path, SECONDS), (speed, SECONDS - lag_s)))
    position += 1e-4 * random.standard_normal(position.shape)
    velocity += 5e-3 * random.standard_normal(velocity.shape)
    return fit_of_twist(TIMES, np.diff(position, axis=0), TIMES, velocity, 0.0)


ALIKE: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    "a constant force": (lambda t: 0.25 * t**2, lambda t: 0.5 * t),
    "linear drag": (lambda t: -8.0 * np.exp(-0.25 * t), lambda t: 2.0 * np.exp(-0.25 * t)),
}


@pytest.mark.parametrize("motion", ALIKE)
def test_of_a_motion_that_tells_no_lag_none_is_told(motion: str) -> None:
    found = [fitted(*ALIKE[motion], seed) for seed in range(20)]
    assert not [fit for fit in found if fit.lag_s or fit.scale or fit.turn]


def test_of_a_motion_that_tells_a_lag_it_is_told() -> None:
    found = fitted(lambda t: np.sin(1.5 * t), lambda t: 1.5 * np.cos(1.5 * t), 0, 0.06)
    assert found.lag_s == pytest.approx(0.06, abs=4.0 * found.lag_error_s)
    assert found.large
    assert found.scale == 0.0


def drive(step: float, seed: int) -> TwistFit:
    """Return the fit to a drive along an oblique axis, with noise below the `step` to which the velocity is rounded."""
    random = np.random.default_rng(seed)
    times = np.arange(1000) * 100_000_000
    position = np.outer(np.clip((times * 1e-9 - 40.0) * 0.5, 0.0, 2.0), (0.951, -0.286, 0.118))
    velocity = np.gradient(position, 0.1, axis=0) + 0.07 * step * random.standard_normal(position.shape)
    velocity = step * np.rint(velocity / step)
    return fit_of_twist(times, np.diff(position, axis=0), times, velocity, 0.0)


def test_rounding_of_the_velocity_of_a_straight_drive_is_no_error_of_it() -> None:
    found = [drive(step, seed) for step in (0.003, 0.0065, 0.02, 0.05, 0.12) for seed in range(20)]
    assert not [fit for fit in found if fit.scale or fit.turn]


def test_axes_of_a_rounded_velocity_are_told() -> None:
    # The path turns through all directions.
    position = np.stack([np.sin(0.6 * SECONDS), np.cos(0.9 * SECONDS), np.sin(1.4 * SECONDS)], axis=1)
    turned = np.gradient(position, 0.01, axis=0) + np.cross((0.0, 0.0, -0.1), np.gradient(position, 0.01, axis=0))
    fit = fit_of_twist(TIMES, np.diff(position, axis=0), TIMES, 0.01 * np.rint(turned / 0.01), 0.0)
    assert fit.turned == pytest.approx((0.0, 0.0, 0.1), abs=4.0 * fit.turn_error)
    assert fit.large


@pytest.mark.parametrize(("degrees", "factor"), [(6.0, 1.0), (12.0, 1.0), (12.0, 1.15), (40.0, 0.9)])
def test_of_a_large_turn_factor_and_angle_are_within_their_errors(degrees: float, factor: float) -> None:
    speeds = np.array([0.6, 0.9, 1.4])
    phases = np.outer(SECONDS, speeds) + np.array([0.0, 1.6, 0.0])
    position, velocity = np.sin(phases), speeds * np.cos(phases)
    turn = np.deg2rad(degrees) * np.array([2.0, -1.0, 2.0]) / 3.0
    for seed in range(8):
        random = np.random.default_rng(seed)
        said = factor * Rotation.from_rotvec(-turn).apply(velocity) + 1e-3 * random.standard_normal(velocity.shape)
        gone = np.diff(position + 1e-4 * random.standard_normal(position.shape), axis=0)
        fit = fit_of_twist(TIMES, gone, TIMES, said, 0.0)
        assert fit.turned == pytest.approx(tuple(turn), abs=5.0 * fit.turn_error)
        assert 1.0 + fit.scale == pytest.approx(factor, abs=5.0 * fit.scale_error)
        twist = TimeSeries("/twist", TIMES, np.hstack([said, said]))
        assert np.abs(fit.corrected(twist).values[:, :3] - velocity).max() < 0.02
