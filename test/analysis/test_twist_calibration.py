"""A lag and a factor of a twist are told only by a motion in which nothing else looks like them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

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
