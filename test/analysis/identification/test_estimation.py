"""The search of a fit: it ends at its minimum."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from identified_flights import flown, guess, random_body

from rb_dynamics.analysis.identification.estimation import _least_squares, fitted
from rb_dynamics.analysis.identification.prediction import Model


def test_a_search_that_begins_at_its_minimum_ends_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounding of the cost refused every step: shorter and shorter ones were tried, each for a whole flight."""
    random = np.random.default_rng(1)
    body = random_body(random)
    model = Model(
        guess(body), [flown(body, random, seconds=5.0, spin=(0.9, 1.2, -1.5), gyro=1e-3)], ("inertia_ratios",)
    )
    fit = fitted(model, 1, "linear", 0)
    at = _least_squares(model, fit.z, fit.noise, "linear", None).x
    flown_times, predict = [], Model.predict

    def counted(*arguments: Any) -> Any:
        flown_times.append(arguments)
        return predict(*arguments)

    monkeypatch.setattr(Model, "predict", counted)
    again = _least_squares(model, at, fit.noise, "linear", None)
    assert len(flown_times) == 1
    assert np.array_equal(again.x, at)
    assert again.status > 0
    moved = _least_squares(model, at + 1e-3, fit.noise, "linear", None)
    assert moved.cost == pytest.approx(again.cost, rel=1e-9)
    assert np.allclose(moved.x, at, atol=1e-4)
