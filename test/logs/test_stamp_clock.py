"""The line of log times against stamps: with jitter, in bursts, at another rate, and where there is none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from rb_dynamics.formats.topic_messages import Times
from rb_dynamics.logs.stamp_clock import APART_NS, StampClock

SECOND = 1_000_000_000
WALL = 1_700_000_000_123_456_789
STAMPS = np.arange(5 * SECOND, 65 * SECOND, SECOND // 20)
JITTER = np.random.default_rng(1).exponential(3e6, len(STAMPS)).astype(np.int64)
LOGGED: dict[str, Callable[[Times], Times]] = {
    "steady": lambda sent: sent,
    "jitter": lambda sent: sent + JITTER,
    "bursts": lambda sent: sent + -sent % (2 * SECOND),
    "one early": lambda sent: sent - np.where(np.arange(len(STAMPS)) == 700, 5 * SECOND, 0),
    "jump": lambda sent: sent + np.where(STAMPS > 30 * SECOND, 5 * SECOND, 0),
    "jump near the end": lambda sent: sent + np.where(STAMPS > 61.5 * SECOND, 3 * SECOND // 10, 0),
    "jump near the begin": lambda sent: sent + np.where(STAMPS > 7 * SECOND, 5 * SECOND, 0),
    "log clock set back": lambda sent: sent - np.where(STAMPS > 8 * SECOND, 3 * SECOND, 0),
    "stamps set back": lambda sent: sent + np.where(STAMPS < 8 * SECOND, np.ptp(sent) - 3 * SECOND, 0),
    "uneven rate": lambda sent: sent + (0.3 * SECOND * np.sin(STAMPS / 20e9)).astype(np.int64),
}


@pytest.mark.parametrize("rate", [1.0, 0.99, 0.5, 3.0])
@pytest.mark.parametrize("how", LOGGED)
def test_a_log_time_is_put_on_the_clock_of_the_stamps_or_that_is_refused(how: str, rate: float) -> None:
    sent = WALL + (STAMPS / rate).astype(np.int64)
    logged, clock = LOGGED[how](sent), StampClock()
    # What has not arrived at the end is not there.
    for part in np.array_split(np.argsort(logged, kind="stable")[: np.count_nonzero(logged <= sent[-1])], 7):
        clock.add(logged[part], STAMPS[part])
    line = clock.line
    within = {"steady": 100, "jitter": SECOND // 1000, "bursts": SECOND // 20}.get(how)
    assert line.straight == (within is not None)
    if within is not None:
        assert np.abs(line.stamps(sent) - STAMPS).max() <= within


def test_a_delay_makes_no_second_clock_and_few_messages_no_drift() -> None:
    steady = StampClock.of(STAMPS + APART_NS // 2, STAMPS).line
    assert (steady.one_clock, steady.drift) == (True, 0.0)
    few = StampClock.of(WALL + np.array([0, 2, 3]) * SECOND, np.array([1, 2, 3]) * SECOND).line
    assert (few.drift, few.behind_ns) == (0.0, WALL - SECOND)


def test_of_many_messages_few_are_kept_and_the_line_is_the_same() -> None:
    stamps = np.arange(200_000) * SECOND // 100
    clock = StampClock()
    for part in np.array_split(stamps, 50):
        clock.add(WALL + 2 * part, part)
    assert len(clock._points) <= 4096
    assert np.abs(clock.line.stamps(WALL + 2 * stamps) - stamps).max() < 1000
    logged = WALL + stamps - np.where(stamps > 3 * SECOND, 3 * SECOND, 0)
    first = np.argsort(logged, kind="stable")[:20_000]
    assert not StampClock.of(logged[first], stamps[first]).line.straight
