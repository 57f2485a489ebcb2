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
