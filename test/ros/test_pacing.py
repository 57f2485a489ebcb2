"""The two pacers, without ROS; a follower with a clock that stops or jumps."""

from __future__ import annotations

import math
import time

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install '.[ros]'")

from rb_dynamics.ros.pacing import ClockFollower, Pacer

SECOND = 1_000_000_000


class Hand:
    """A simulated clock and steady clock."""

    def __init__(self) -> None:
        self.clock_ns, self.steady = 0, 0.0
        self.follower = ClockFollower(lambda: self.clock_ns, lambda: self.steady)

    def at(self, clock_ns: int, steady: float = 0.0) -> int:
        self.clock_ns, self.steady = clock_ns, self.steady + steady
        return self.follower.due_ns(0)


def test_time_begins_with_the_clock_and_stamps_are_the_clocks() -> None:
    hand = Hand()
    assert hand.at(0) == 0
    assert hand.follower.offset_ns is None
    assert "waiting for /clock" in hand.follower.warning()
    assert hand.at(500 * SECOND) == 0
    assert hand.follower.offset_ns == 500 * SECOND
    assert hand.at(501 * SECOND) == SECOND
    assert hand.follower.offset_ns == 500 * SECOND
    assert hand.follower.warning() == ""
    assert hand.follower.seconds_until(2 * SECOND) == math.inf


def test_a_jump_back_moves_the_stamps_and_not_the_body() -> None:
    hand = Hand()
    hand.at(100 * SECOND)
    assert hand.at(103 * SECOND) == 3 * SECOND
    assert hand.at(1 * SECOND) == 3 * SECOND
    assert hand.at(2 * SECOND) == 4 * SECOND
    assert hand.follower.offset_ns == -2 * SECOND
    assert hand.follower.values()["clock: jumps back"] == "1"
    assert "jumps of the clock: 1 back, 0 ahead" in hand.follower.warning()


def test_a_leap_of_another_clock_is_not_computed() -> None:
    hand = Hand()
    hand.at(1 * SECOND)
    assert hand.at(11 * SECOND) == 10 * SECOND
    assert hand.at(1_760_000_000 * SECOND) == 10 * SECOND
    assert hand.at(1_760_000_001 * SECOND) == 11 * SECOND
    assert hand.follower.values()["clock: leaps ahead"] == "1"


def test_a_clock_that_stands_is_counted_once_for_each_pause() -> None:
    hand = Hand()
    hand.at(1 * SECOND)
    for _ in range(5):
        assert hand.at(1 * SECOND, 0.6) == 0
    assert hand.follower.values()["clock"] == "paused"
    hand.at(2 * SECOND)
    assert hand.follower.values()["clock"] == "running"
    hand.at(2 * SECOND, 5.0)
    assert hand.follower.values()["clock: pauses"] == "2"


def test_restarted_after_a_pause_of_ours_the_time_in_between_is_left_out() -> None:
    hand = Hand()
    hand.at(10 * SECOND)
    assert hand.at(12 * SECOND) == 2 * SECOND
    hand.clock_ns = 50 * SECOND
    hand.follower.restart(2 * SECOND)
    assert hand.at(51 * SECOND) == 3 * SECOND
    assert hand.follower.offset_ns == 48 * SECOND


def test_a_pacer_gives_up_a_lag_and_counts_it() -> None:
    pacer = Pacer(1e9)
    assert pacer.warning() == ""
    # At a factor of 1e9 the clock is seconds ahead at once; in units of the steady clock the lag is small.
    assert pacer.due_ns(0) >= 0
    slow = Pacer(1.0)
    slow.restart(10 * SECOND)
    assert slow.due_ns(9 * SECOND) == 9 * SECOND
    assert slow.values()["overruns"] == "1"
    assert float(slow.values()["time dropped"].removesuffix(" s")) == pytest.approx(1.0, abs=0.5)
    dropped = slow.values()["time dropped"]
    assert slow.warning() == f"fell behind once, by {dropped} in all: the machine is too slow, or busy"
    slow.restart(10 * SECOND)
    slow.due_ns(9 * SECOND)
    assert slow.warning().startswith("fell behind 2 times, by ")


def test_stamps_in_ros_time_follow_its_clock_when_that_is_set_and_hold_at_factor_1() -> None:
    ahead = 1_700_000_000 * SECOND
    pacer = Pacer(1.0, lambda: time.monotonic_ns() + ahead)
    pacer.begin(5)
    begun = pacer.offset_ns
    pacer.correct()
    assert pacer.offset_ns == begun
    assert not pacer.warning()
    ahead += 3600 * SECOND
    pacer.correct()
    assert pacer.offset_ns is not None
    assert begun is not None
    assert pacer.offset_ns - begun == pytest.approx(3600 * SECOND, abs=SECOND)
    assert "set anew (1)" in pacer.warning()
    assert pacer.due_ns(0) < SECOND
    pacer.factor = 2.0
    assert "2 times as fast" in pacer.warning()
