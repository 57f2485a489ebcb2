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
    "queue": lambda sent: sent + np.where(STAMPS % (20 * SECOND) > 13 * SECOND, np.ptp(sent) // 1000, 0),
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
    within = {"steady": 100, "jitter": SECOND // 1000, "bursts": SECOND // 20, "queue": SECOND // 16}.get(how)
    assert line.bounded == (within is not None)
    assert line.straight == (line.bounded and how != "queue")
    if within is not None:
        assert (line.ends_s, line.error_s) == (0.0, pytest.approx(0.06 * (how == "queue"), abs=0.05))
        assert np.abs(line.stamps(sent) - STAMPS).max() <= within


@pytest.mark.parametrize("rate", [1.0, 0.99, 3.0])
@pytest.mark.parametrize(("till", "step"), [(64.7, 3.0), (5.4, -3.0), (5.4, -0.3)])
def test_a_step_within_a_second_of_either_end_is_told(till: float, step: float, rate: float) -> None:
    """The least delay of that second was from before or after it."""
    logged = WALL + ((STAMPS + (till * SECOND < STAMPS) * round(step * SECOND)) / rate).astype(np.int64)
    line = StampClock.of(logged, STAMPS).line
    assert (line.straight, line.ends_s) == (True, pytest.approx(abs(step), rel=1e-6))


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
