"""Streams: interpolation on the rotation group, and never across a gap."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rb_dynamics.analysis.interpolated_signal import Signal, differences
from rb_dynamics.numerics.rotation_arrays import exponentials, product

SMALL = st.floats(-1.0, 1.0, allow_subnormal=False)
VECTORS = st.tuples(SMALL, SMALL, SMALL)


def spinning(rate: tuple[float, ...], count: int = 20, period_ns: int = 100_000_000) -> Signal:
    times = np.arange(count) * period_ns
    return Signal.of(times, exponentials(np.outer(times * 1e-9, rate)))


@given(VECTORS, st.integers(0, 1_900_000_000))
@settings(max_examples=20, deadline=None)
def test_a_constant_spin_is_interpolated_exactly(rate: tuple[float, ...], at: int) -> None:
    values, known = spinning(rate).at(np.array([at]))
    assert known.all()
    assert np.linalg.norm(differences(values, exponentials(np.outer([at * 1e-9], rate)))) < 1e-14


@given(VECTORS)
@settings(max_examples=20, deadline=None)
def test_the_sign_of_a_quaternion_says_nothing(rate: tuple[float, ...]) -> None:
    signal = spinning(rate)
    signs = np.where(np.arange(20) % 2, -1.0, 1.0)[:, None]
    other = Signal.of(signal.time_ns, signal.values * signs)
    at = np.arange(0, 1_900_000_000, 33_333_333)
    assert np.abs(differences(signal.at(at)[0], other.at(at)[0])).max() < 1e-15
    assert not np.any(differences(signal.values, other.values))


def test_products_and_exponentials_belong_together() -> None:
    axis = np.array([[0.3, -0.2, 0.9]])
    twice = product(exponentials(axis), exponentials(axis))
    assert np.allclose(twice, exponentials(2.0 * axis), rtol=0.0, atol=1e-15)
    assert np.array_equal(exponentials(np.zeros((1, 3))), [[0.0, 0.0, 0.0, 1.0]])


def test_nothing_is_known_within_a_gap_nor_outside() -> None:
    times = np.delete(np.arange(20) * 10, [7, 8, 9])
    signal = Signal.of(times, times[:, None] * [1.0, 2.0, 3.0])
    values, known = signal.at(np.array([-1, 0, 5, 60, 61, 75, 99, 100, 190, 191]))
    assert known.tolist() == [False, True, True, True, False, False, False, True, True, False]
    assert np.array_equal(values[2], [5.0, 10.0, 15.0])
    assert np.isnan(values[~known]).all()
    assert signal.holes() == [(60, 100)]
    assert signal.within(65, 120).holes() == []
    assert signal.within(60, 120).holes() == [(60, 100)]


def test_a_missing_piece_of_a_file_is_a_gap_however_short() -> None:
    times = np.arange(10) * 10
    signal = Signal.of(times, np.zeros((10, 3)), [(42, 43)])
    assert signal.holes() == [(40, 50)]
    assert Signal.of(times, np.zeros((10, 3))).holes() == []


def test_the_error_of_interpolation_is_estimated() -> None:
    times = np.arange(200) * 50_000_000
    values = np.sin(times * 1e-9)[:, None] * [1.0, 0.0, 0.0]
    signal = Signal.of(times, values)
    at = times[:-1] + 25_000_000
    true = np.abs(signal.at(at)[0][:, 0] - np.sin(at * 1e-9)).max()
    assert 0.9 * true < signal.interpolation_error() < 1.5 * true
