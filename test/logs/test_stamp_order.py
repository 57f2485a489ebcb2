"""Stamps that do not ascend: messages that come late are told apart from a second run, whatever else is mixed in."""

from __future__ import annotations

import numpy as np
import pytest

from rb_dynamics.logs.stamp_order import Disorder, disorder

EVERY = 10_000_000
COUNT = 400
EVEN = np.arange(COUNT, dtype=np.int64)


def swapped(*places: int) -> np.ndarray:
    order = EVEN.copy()
    for place in places:
        order[[place, place + 1]] = order[[place + 1, place]]
    return order


def delayed(begin: int, end: int, by: int) -> np.ndarray:
    """Return the messages `begin` to `end` after those that were sent `by` later."""
    late = np.where((begin <= EVEN) & (end > EVEN), end - 0.5 + by, EVEN)
    return np.argsort(late, kind="stable")


@pytest.mark.parametrize(
    ("order", "odd", "most", "first"),
    [
        (swapped(0), 1, 1, 0),
        (swapped(200), 1, 1, 200),
        (swapped(COUNT - 2), 1, 1, COUNT - 2),
        (swapped(*range(0, COUNT, 2)), 200, 1, 0),
        (np.roll(EVEN, 1), 1, 399, 399),
        (np.insert(EVEN, 200, 9000), 1, 8800, 9000),
        (delayed(100, 101, 290), 1, 290, 100),
        (delayed(100, 200, 3), 100, 102, 100),
        (delayed(100, 200, COUNT), 100, 299, 100),
        (np.ravel(np.column_stack([EVEN, EVEN + 300])), 399, 299, 1),
        (np.ravel(np.concatenate([EVEN.reshape(-1, 10), EVEN.reshape(-1, 10) + 5000], axis=1)), 390, 4999, 10),
    ],
)
def test_messages_that_come_late_are_no_run(order: np.ndarray, odd: int, most: int, first: int) -> None:
    assert disorder(EVERY * order) == Disorder(len(order), odd, most * EVERY, first * EVERY, ())


@pytest.mark.parametrize(
    ("order", "odd", "restarts"),
    [
        (np.concatenate([EVEN, EVEN]), 0, ((399, 0),)),
        (np.concatenate([EVEN, np.arange(3)]), 0, ((399, 0),)),
        (np.concatenate([EVEN, np.arange(1000)]), 0, ((399, 0),)),
        (np.concatenate([EVEN, EVEN - 10_000]), 0, ((399, -10_000),)),
        (np.concatenate([EVEN, EVEN[200:]]), 0, ((399, 200),)),
        (np.concatenate([EVEN, EVEN, EVEN + 7]), 0, ((399, 0), (399, 7))),
        (np.concatenate([swapped(3), swapped(5), swapped(9)]), 3, ((399, 0), (399, 0))),
    ],
)
def test_a_run_that_begins_again_is_told(order: np.ndarray, odd: int, restarts: tuple[tuple[int, int], ...]) -> None:
    found = disorder(EVERY * order)
    assert found is not None
    assert (found.odd, found.restarts) == (odd, tuple((EVERY * end, EVERY * begin) for end, begin in restarts))


def test_both_are_told_in_words() -> None:
    assert disorder(EVERY * EVEN) is disorder(np.zeros(3, np.int64)) is disorder(np.zeros(0, np.int64)) is None
    again = (
        "stamps begin again, first after t = 4.99 s at 1 s: 3 runs in one file, which cannot be told apart, or a "
        "clock that was set back; 3 of 1200 "
    )
    for order, start_ns, told in (
        (swapped(7), 0, "1 of 400 stamps is out of order, by 0.01 s, at t = 0.07 s; messages are taken by "),
        (swapped(7, 9), 0, "2 of 400 stamps are out of order, by at most 0.01 s, first at t = 0.07 s; messages are "),
        (np.tile(swapped(7), 3), -(10**9), again),
    ):
        found = disorder(EVERY * order)
        assert found is not None
        assert found.told(start_ns).startswith(told)


def test_messages_that_are_often_late_are_no_run() -> None:
    """Of a network that delays each message by a random time, some are late in a row."""
    for seed in range(5):
        late = np.random.default_rng(seed).exponential(5.0, 2000)
        order = np.argsort(np.arange(2000) + late, kind="stable")
        found = disorder(EVERY * order)
        assert found is not None
        assert not found.restarts
        twice = disorder(EVERY * np.concatenate([order, order]))
        assert twice is not None
        assert len(twice.restarts) == 1
