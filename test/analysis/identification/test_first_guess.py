"""The first guess of a fit: from balances of momentum, with the memory of its recording."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from identified_flights import flown, guess, random_body
from numpy.typing import NDArray

from rb_dynamics.analysis.identification.first_guess import first_guess
from rb_dynamics.analysis.identification.measurement_model import Model


def guessed(model: Model) -> tuple[NDArray[np.float64], int]:
    """Return the first guess, and the peak of memory (bytes) while it was made."""
    tracemalloc.start()
    try:
        found = first_guess(model)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert found is not None
    return found, peak


def test_a_long_tumble_is_guessed_at_without_memory_that_grows_with_its_square() -> None:
    """An hour at 100 Hz asked for 77 GiB."""
    random = np.random.default_rng(1)
    body = random_body(random)
    flight = flown(body, random, seconds=20.0, spin=(9.0, 12.0, -15.0), gyro=1e-3)
    model = Model(guess(body), [flight], ("inertia_ratios",))
    found, peak = guessed(model)
    ratios = np.sort(model.body(found).inertia.diagonal()) / np.trace(model.body(found).inertia)
    truth = np.sort(np.diagonal(body.inertia)) / np.trace(body.inertia)
    assert ratios == pytest.approx(truth, abs=0.02)
    assert peak < 20e6


def test_the_pieces_of_a_guess_are_where_samples_are() -> None:
    """Of the time between two flights, however long, memory was asked for."""
    random = np.random.default_rng(1)
    body = random_body(random)
    flight = flown(body, random, seconds=20.0, spin=(9.0, 12.0, -15.0), gyro=1e-3)
    (rates,) = flight.streams
    apart = replace(rates, time_ns=rates.time_ns + (rates.time_ns > 10**10) * 10**14)
    _, peak = guessed(Model(guess(body), [replace(flight, streams=(apart,))], ("inertia_ratios",)))
    assert peak < 20e6
