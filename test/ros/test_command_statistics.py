"""Matching of stamped commands, compared with the definition by brute force."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")

from hypothesis import given
from hypothesis import strategies as st

from rb_dynamics.ros.command_statistics import Arrival, Arrivals, Losses


def test_each_kind() -> None:
    arrivals = Arrivals()
    assert arrivals.classify(0, 0) is Arrival.ON_TIME
    assert arrivals.classify(50, 10) is Arrival.EARLY
    assert arrivals.classify(30, 10) is Arrival.EARLY
    assert arrivals.classify(30, 10) is Arrival.DUPLICATE
    assert arrivals.classify(20, 29) is Arrival.LATE
    assert arrivals.classify(25, 31) is Arrival.SUPERSEDED
    assert arrivals.classify(40, 45) is Arrival.LATE
    assert arrivals.classify(40, 46) is Arrival.DUPLICATE
    assert arrivals.classify(50, 60) is Arrival.DUPLICATE


@given(st.lists(st.tuples(st.integers(0, 20), st.integers(0, 5)), max_size=40))
def test_the_kinds_are_what_they_say(commands: list[tuple[int, int]]) -> None:
    arrivals, taken, now = Arrivals(), set(), 0
    for stamp, passed in commands:
        now += passed
        acted = max((s for s in taken if s <= now), default=-1)
        kind = arrivals.classify(stamp, now)
        if kind is Arrival.SUPERSEDED:
            assert stamp < acted
            continue
        assert stamp >= acted
        assert (kind is Arrival.DUPLICATE) == (stamp in taken)
        if kind is not Arrival.DUPLICATE:
            assert kind is (Arrival.EARLY if stamp > now else Arrival.LATE if stamp < now else Arrival.ON_TIME)
        taken.add(stamp)


@given(st.lists(st.booleans(), max_size=40), st.integers(1, 9), st.integers(0, 50))
def test_gaps_and_what_the_middleware_says_are_not_counted_twice(came: list[bool], first: int, told: int) -> None:
    losses = Losses()
    numbers = [first + index for index, each in enumerate(came) if each]
    found = sum(losses.take(number, lambda: True) for number in numbers)
    assert found == (numbers[-1] - numbers[0] + 1 - len(numbers) if numbers else 0)
    assert found + losses.tell(told) == max(found, told)


def test_numbers_count_for_a_commander_that_is_alone_and_known() -> None:
    losses = Losses()
    assert losses.take(5, lambda: True) == 0
    assert losses.take(8, lambda: False) == 0
    losses.forget()
    assert losses.take(20, lambda: True) == 0
    assert losses.take(1, lambda: True) == 0
    assert losses.take(None, lambda: True) == 0
    assert losses.take(9, lambda: True) == 0
    assert losses.take(11, lambda: True) == 1


def test_a_commander_that_came_and_went_takes_nothing_from_the_other() -> None:
    # Whether the message of the other is taken while it is there or when it has gone.
    for there in (True, False):
        losses = Losses()
        assert sum(losses.take(number, lambda: True) for number in range(1, 501)) == 0
        losses.forget()
        assert losses.take(500, lambda: False) == 0
        assert losses.take(1, lambda there=there: not there) == 0
        assert losses.take(501, lambda: True) == 0
        assert losses.take(503, lambda: True) == 1
