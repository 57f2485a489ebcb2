"""Time in whole nanoseconds: from seconds as they were written, and as the two integers of a ROS stamp."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING

from rb_dynamics.errors import LogError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from rb_dynamics.numerics.array_types import Numbers

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second."""

# Times are whole nanoseconds, and the seconds of a stamp end at 2^31, in ROS messages and in the log. In seconds:
SHORTEST = 1e-9
LONGEST = 2.0**31 - 1.0
# s. Steps may be fractions of a nanosecond; shorter ones than this would not advance a run noticeably.
SHORTEST_STEP = 1e-15

LAST_STAMP_NS = 2**31 * NANOSECONDS
"""Largest ROS stamp: seconds are signed 32-bit integers, which is 68 years."""


# Cached, because each run of a scene asks for the same times.
@lru_cache(maxsize=256)
def nanoseconds(seconds: float) -> int:
    """Return a time (s), taken as the decimal number that was written, in whole nanoseconds."""
    return round(Fraction(repr(float(seconds))) * NANOSECONDS)


def nanoseconds_of_each(seconds: Numbers) -> npt.NDArray[np.int64]:
    """Return `nanoseconds` of each of an array of times (s) from 0 to `LONGEST`."""
    import numpy as np

    product = seconds * NANOSECONDS
    found = np.rint(product)
    # Elsewhere rounding errors of the number and of the product do not reach halfway to the next nanosecond.
    near = (np.abs(np.abs(product - found) - 0.5) < 1e-3) | (product > 2.0**40)
    whole: npt.NDArray[np.int64] = found.astype(np.int64)
    whole[near] = [nanoseconds(each) for each in seconds[near].tolist()]
    return whole


def exact_period_ns(rate: float) -> Fraction:
    """Return the exact time (ns) between samples at `rate` (Hz), taken as the decimal number that was written."""
    return NANOSECONDS / Fraction(repr(rate))


def sample_ns(sample: int, period_ns: Fraction) -> int:
    """Return the time of sample number `sample`, one every `period_ns`, rounded to a nanosecond."""
    period, parts = period_ns.numerator, period_ns.denominator
    return (2 * sample * period + parts) // (2 * parts)


def on_nanosecond(seconds: float) -> float:
    """Return a time (s), taken as the decimal number that was written, rounded to whole nanoseconds."""
    return nanoseconds(seconds) / NANOSECONDS


def seconds_text(time_ns: int) -> str:
    """Return a time (ns) as text in seconds, with all digits: a double cannot resolve nanoseconds since 1970."""
    seconds, rest = divmod(abs(time_ns), NANOSECONDS)
    return f"{'-' if time_ns < 0 else ''}{seconds}.{rest:09d}"


def split_stamp(time_ns: int) -> tuple[int, int]:
    """Return a time (ns) as (sec, nanosec) of `builtin_interfaces/Time`.

    Raises:
        LogError: the seconds do not fit in 32 bits.
    """
    if not -LAST_STAMP_NS <= time_ns < LAST_STAMP_NS:
        raise LogError(
            f"time is {time_ns} ns, expected |time| < 2^31 s (68 years): a ROS stamp holds no more; count time from "
            "the start of the run"
        )
    return divmod(time_ns, NANOSECONDS)
