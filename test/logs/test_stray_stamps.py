"""Messages stamped far from when they were recorded."""

from __future__ import annotations

import numpy as np
import pytest

from rb_dynamics.logs.stray_stamps import Strays, StrayStamps

LATE_NS = 3_000_000
LOGGED = 1_700_000_000_123_456_789 + np.arange(20) * 100_000_000


def found_in(log_times: np.ndarray, stamps: np.ndarray, pieces: int = 1) -> Strays | None:
    lags = StrayStamps()
    # In any order.
    for rows in reversed(np.array_split(np.arange(len(log_times)), pieces)):
        lags.add(log_times[rows], stamps[rows])
    return lags.found


@pytest.mark.parametrize("by_s", [-1.7e9, -3600.0, 3600.0, 1e8])
@pytest.mark.parametrize("row", [1, 10, 19])
@pytest.mark.parametrize("pieces", [1, 7])
def test_a_stamp_far_off_is_placed_by_the_log_time(by_s: float, row: int, pieces: int) -> None:
    stamps = LOGGED - LATE_NS
    stamps[row] += round(by_s * 1e9)
    found = found_in(LOGGED, stamps, pieces)
    assert found is not None
    assert np.flatnonzero(found.among(LOGGED, stamps)).tolist() == [row]
    assert found.placed(LOGGED, stamps).tolist() == (LOGGED - LATE_NS).tolist()
    assert found.told("b", "/w") == (
        "b: 1 of the 20 commands of /w is stamped far from when it was recorded, and acts then"
    )


def test_a_first_one_from_the_future_is_a_stray_and_one_from_the_past_is_kept_for_who_joins_late() -> None:
    for by_ns, count in ((10**18, 1), (-(10**18), None)):
        stamps = LOGGED.copy()
        stamps[0] += by_ns
        found = found_in(LOGGED, stamps)
        assert (found and found.number) == count


def test_a_clock_that_was_set_two_strays_of_twenty_and_stamps_of_0_are_none() -> None:
    for rows, by_ns in ((slice(10, None), -(10**18)), ([5, 7], 10**18)):
        stamps = LOGGED.copy()
        stamps[rows] += by_ns
        assert found_in(LOGGED, stamps) is None
    stamps = LOGGED.copy()
    stamps[5] = 0
    assert found_in(LOGGED, stamps) is None
    assert found_in(LOGGED[:7], LOGGED[:7] - np.array([0, 0, 0, 10**15, 0, 0, 0])) is None


def test_stamps_of_a_slow_simulation_are_none() -> None:
    log_times = LOGGED[0] + np.arange(5000) * 10_000_000_000
    assert found_in(log_times, np.arange(5000) * 1_000_000) is None
