"""Gaps in a topic: intervals far longer than usual, for messages at even and uneven intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.track import Array, Times, in_blocks

# With even intervals, an interval this much longer than usual is a gap.
_GAP = 1.5
# With uneven intervals: one or two lost messages are not a gap.
_FAR = 5.0
# A stream has at least this many samples; apart from a few, 99 % of its intervals are at most this multiple of the
# usual.
_STREAM, _FEW, _EVEN = 100, 3, 5.0
# It is silent if it pauses for this many usual intervals and this many seconds, for at most this fraction of its time.
LONG_INTERVALS, LONG_S, _PART = 10.0, 1.0, 0.2
# Stamps are strays if they are at most this fraction of all, and this many times as far away as the rest lasts.
_STRAY, _AWAY = 0.01, 10.0
# rad by which a body may turn while nothing measures it, so that its motion is still followed.
_FOLLOWED = 1.0
# Number of gaps listed individually.
NAMED = 5


def gaps(time_ns: Times) -> int:
    """Return the number of intervals longer than `longest_usual`."""
    return len(after_gaps(time_ns))


def after_gaps(times: Times | Array) -> NDArray[np.intp]:
    """Return the index of the first sample after each gap."""
    return np.flatnonzero(np.diff(times) > longest_usual(times)) + 1


def longest_usual(time_ns: Times | Array) -> float:
    """Return the longest interval that is not a gap, in the unit of the times; infinite for fewer than three.

    Intervals of 0 do not count, as several samples may have one stamp of a coarse clock.
    If nine in ten are equal to 1 %, 1.5 times the usual one. Otherwise far beyond the spread of the intervals: for
    random times, with exponential intervals, one in 20 million is longer.
    """
    steps = np.diff(time_ns)
    if not steps.all():
        steps = steps[steps != 0]
    if len(steps) < 3:
        return float(np.inf)
    if (steps == steps[0]).all():
        usual = long = float(steps[0])
    else:
        usual, long = (float(part) for part in np.quantile(steps, (0.5, 0.9), overwrite_input=True))
    even = sum(int((np.abs(part - usual) <= 0.01 * usual).sum()) for part in in_blocks(steps))
    if usual > 0.0 and even / len(steps) >= 0.9:
        return _GAP * usual
    return max(_FAR * usual, usual + 10.0 * (long - usual))


def silences(time_ns: Times) -> NDArray[np.intp]:
    """Return the index of the last sample before each pause of a stream that is otherwise steady.

    Empty for samples that are sparse, or that come in bursts: their pauses are intended.
    """
    steps = np.diff(time_ns)
    if len(steps) < _STREAM:
        return np.empty(0, np.intp)
    usual = float(np.median(steps))
    at = np.flatnonzero(steps > max(LONG_INTERVALS * usual, LONG_S * 1e9))
    even = float(np.quantile(np.delete(steps, at), 0.99)) <= _EVEN * usual
    return at if even and len(at) <= _FEW and steps[at].sum() <= _PART * steps.sum() else at[:0]


def without_strays(time_ns: Times) -> slice:
    """Return which of ascending stamps belong together: all but a few, far before or after all the others."""
    few = int(_STRAY * len(time_ns))
    if not few:
        return slice(0, len(time_ns))
    # The clock may have been anywhere: differences of whole numbers might overflow.
    before, after = (part.astype(np.float64) for part in (time_ns[: few + 1], time_ns[-1 - few :]))
    first, last = before[-1], after[0]
    if not last > first:
        return slice(0, len(time_ns))
    early = np.flatnonzero(np.diff(before) > _AWAY * (last - before[1:]))
    late = np.flatnonzero(np.diff(after) > _AWAY * (after[:-1] - first))
    begin = int(early[-1]) + 1 if len(early) else 0
    return slice(begin, len(time_ns) - few + int(late[0]) if len(late) else len(time_ns))


def strays(time_ns: Times) -> Times:
    """Return the stamps that `without_strays` leaves out of some in any order, ascending."""
    ascending = time_ns if (time_ns[1:] >= time_ns[:-1]).all() else np.sort(time_ns)
    near = without_strays(ascending)
    return np.concatenate([ascending[: near.start], ascending[near.stop :]])


def holes(times: Sequence[Times], rate: float, bridged: float = 0.0) -> list[tuple[int, int]]:
    """Return begin and end of each hole between the samples of several sensors, in which a motion is not followed.

    Args:
        times: stamps of each sensor, ascending, ns.
        rate: rad/s, at which the body turns; infinite where it is not known.
        bridged: the shortest holes are none while together they last at most this many times as long as is measured.
    """
    ends = np.unique(np.concatenate(times))
    begin, steps = ends[:-1], np.diff(ends).astype(np.float64)
    seen = np.zeros(len(begin), dtype=bool)
    for each in times:
        usual = np.diff(each) <= (longest_usual(each) if len(each) > 3 else 0.0)
        seen |= np.concatenate([[False], usual, [False]])[np.searchsorted(each, begin, side="right")]
    at = np.flatnonzero(~seen & (steps * 1e-9 > _FOLLOWED / max(rate, 1e-300)))
    at = at[np.argsort(steps[at], kind="stable")]
    at = np.sort(at[np.cumsum(steps[at]) > bridged * steps[seen].sum()])
    return list(zip(begin[at].tolist(), ends[at + 1].tolist(), strict=True))


def told(time_ns: Times, start_ns: int) -> str:
    """Return a description of the gaps: number, total length, and the longest in order of time, from `start_ns`."""
    steps = np.diff(time_ns)
    at = np.flatnonzero(steps > longest_usual(time_ns))
    if not len(at):
        return ""
    shown = np.sort(at[np.argsort(-steps[at], kind="stable")][:NAMED])
    each = [f"{steps[k] * 1e-9:.6g} s from t = {int(time_ns[k] - start_ns) * 1e-9:.6g} s" for k in shown]
    together = f", {int(steps[at].sum()) * 1e-9:.6g} s together" if len(at) > 1 else ""
    return f"{len(at)} gap{'s' * (len(at) > 1)}{together}: {listed(each, len(at))}"


def listed(each: Sequence[str], count: int) -> str:
    """Return `each` as text, shortened if there are `count`."""
    return "; ".join(each) + (f"; and {count - len(each)} more" if count > len(each) else "")
