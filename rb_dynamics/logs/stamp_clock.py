"""`StampClock`: which stamp belongs to a log time, by messages that have both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.formats.topic_messages import Times

APART_NS = 100_000_000
"""Log times are of one clock with the stamps if all are within a delay of this; ns."""
# Points that are kept; of two neighbours, the one with the less delay.
_MOST = 4096
# A delay that changes by more than so much per s was not recorded by one clock.
_FASTEST = 10
# A drift is told from at least so many messages, over so many s, if it is so many times what is left or so many s.
_LEAST, _SHORTEST, _ABOVE, _SMALLEST = 8, 1.0, 4.0, 1e-3
# Over every second, but at most this part of the time, and so many messages, but at most this part of them, the least
# delay is on the line within these bounds, s: about a sample.
_PARTS, _WINDOW, _IN_WINDOW, _FINEST, _COARSEST = 32, 1.0, 8, 0.02, 0.1
# Messages come in bursts if of so many intervals more than half are shorter than this (ns) and this part of the mean.
_FEW, _AT_ONCE_NS, _PART = 8, 1_000_000, 0.1

_Windows: TypeAlias = Sequence[tuple[slice | NDArray[np.int64], NDArray[np.int64]]]


@dataclass(frozen=True)
class ClockLine:
    """A line through the delays of log times.

    Attributes:
        begin_ns: a log time.
        behind_ns: by how much it is later than its stamp.
        drift: how much this changes, s/s.
        error_s: by how much the least delay leaves the line, in the worst second.
        straight: whether that is no more than jitter.
        ends_s: by how much the first or the last delays leave it, if that is more than `error_s` and than jitter; or 0.
        count: of messages.
    """

    begin_ns: int = 0
    behind_ns: int = 0
    drift: float = 0.0
    error_s: float = 0.0
    straight: bool = True
    ends_s: float = 0.0
    count: int = 0

    def behind(self, log_times: Times) -> Times:
        """Return by how much log times (ns) are later than the stamps."""
        more: Times = np.rint(self.drift * (log_times - self.begin_ns)).astype(np.int64)
        return self.behind_ns + more

    def stamps(self, log_times: Times) -> Times:
        """Return the stamps (ns) of log times."""
        return log_times - self.behind(log_times)

    def stamp(self, log_time: int) -> int:
        """Return the same of one."""
        return int(self.stamps(np.array(log_time, dtype=np.int64)))

    @property
    def one_clock(self) -> bool:
        """Whether log times are the stamps, up to a delay."""
        return self.drift == 0.0 and abs(self.behind_ns) <= APART_NS

    @property
    def bounded(self) -> bool:
        """Whether it is off by no more than delays within one clock are."""
        return self.error_s * 1e9 <= APART_NS


class StampClock:
    """The line below the delays of all messages that is nearest to them on average, where bursts leave it.

    It is the edge of their lower convex hull over their mean time: S. B. Moon, P. Skelly, D. Towsley, "Estimation and
    removal of clock skew from network delay measurements", INFOCOM 1999.
    """

    def __init__(self) -> None:
        """Begin without messages."""
        self._points: NDArray[np.int64] = np.empty((0, 2), dtype=np.int64)
        self.count = 0

    def add(self, log_times: Times, stamps: Times) -> None:
        """Take messages."""
        self.count += len(stamps)
        points = np.concatenate([self._points, np.column_stack([log_times, log_times - stamps])])
        while len(points) > _MOST:
            pairs = points[: len(points) // 2 * 2].reshape(-1, 2, 2)
            # From before and after a clock was set back, they are kept both, be they more.
            logged, late = np.ptp(pairs, axis=1).T
            apart = late > APART_NS + _FASTEST * logged
            if apart.mean() > 0.5:
                break
            kept = apart[:, None] | (pairs[:, :, 1].argmin(axis=1)[:, None] == range(2))
            points = np.concatenate([pairs[kept], points[2 * len(pairs) :]])
        self._points = points
        self.__dict__.pop("line", None)

    @classmethod
    def of(cls, log_times: Times, stamps: Times) -> StampClock:
        """Return that of these messages, of which those without a stamp do not count."""
        found = cls()
        found.add(log_times[stamps != 0], stamps[stamps != 0])
        return found

    @cached_property
    def line(self) -> ClockLine:
        """What the messages so far say."""
        points = self._points[np.lexsort(self._points.T[::-1])]
        begin_ns, least_ns = int(points[0, 0]), int(points[:, 1].min())
        at, late = (points - (begin_ns, least_ns)).T * 1e-9
        # If a clock is set back, messages from before lie among those from after, unless in the order of the other.
        orders = (slice(None), np.argsort(at - late))
        windows = [(order, _windows(at[order], self.count)) for order in orders]
        interval = abs(float((at[-1] - at[0]) - (late[-1] - late[0]))) / max(self.count - 1, 1)
        jitter = min(max(interval, _FINEST), _COARSEST)
        outer = [(order, _outer_windows(at[order], jitter)) for order in orders]

        def lowest(heights: NDArray[np.float64], windows: _Windows = windows) -> NDArray[np.float64]:
            least = (np.minimum.reduceat(np.append(heights[order], 0.0), ends)[::2] for order, ends in windows)
            return np.concatenate([*least])

        left, level, drift = lowest(late), 0.0, 0.0
        if self.count >= _LEAST and at[-1] >= _SHORTEST:
            (x, y), (x1, y1) = _edge(at.tolist(), late.tolist(), float(at.mean()))
            slope = (y1 - y) / (x1 - x)
            rest = lowest(late - y - slope * (at - x))
            # Where messages wait in queues, a drift leaves more than jitter, but little of what there is without it.
            most = max(jitter, min(_COARSEST, float(left.max()) / _ABOVE))
            if rest.max() <= most and abs(slope) * at[-1] > max(_ABOVE * float(np.median(rest)), _SMALLEST):
                left, level, drift = rest, y - slope * x, slope
        error, ends = float(left.max()), float(lowest(late - level - drift * at, outer).max())
        ends *= ends > max(error, jitter)
        return ClockLine(begin_ns, least_ns + round(level * 1e9), drift, error, error <= jitter, ends, self.count)


def in_bursts(topic: str, log_times: Times) -> str:
    """Return that messages without stamps were recorded in bursts, as text; "" if they were not."""
    steps = np.diff(np.sort(log_times)).astype(np.float64)
    if len(steps) < _FEW or 2 * int((steps < min(_AT_ONCE_NS, _PART * float(steps.mean()))).sum()) <= len(steps):
        return ""
    return (
        f"{topic} has no stamps and was recorded in bursts, up to {float(steps.max()) * 1e-9:.3g} s apart: its "
        "messages may have been sent that much earlier"
    )


def _windows(at: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Return where windows from each point on begin and end, in turns; those that go on after the last point are none.

    A window that begins within a burst holds the rest of it, with the least delay.
    """
    newest, points = np.maximum.accumulate(at), np.arange(len(at))
    width = max(1, min(len(at) // _PARTS, _IN_WINDOW * len(at) // count))
    end = np.searchsorted(newest, newest + min(_WINDOW, at.max() / _PARTS)) + 1
    windows = np.column_stack([points, np.maximum(end, points + width)])
    return windows[windows[:, 1] <= len(at)].ravel()


def _outer_windows(at: NDArray[np.float64], length: float) -> NDArray[np.int64]:
    """Return the same of those of this length (s) at both ends, where a step is shorter than a window."""
    newest = np.maximum.accumulate(at)
    first, last = np.searchsorted(newest, (newest[0] + length, newest[-1] - length))
    return np.array([0, max(first, 1), min(last, len(at) - 1), len(at)])


def _edge(at: list[float], late: list[float], middle: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ends of the edge of the lower convex hull over `middle`; points are in the order of `at`."""
    hull: list[tuple[float, float]] = []
    for x, y in zip(at, late, strict=True):
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2:]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                break
            hull.pop()
        if not hull or x > hull[-1][0]:
            hull.append((x, y))
    return next((a, b) for a, b in pairwise(hull) if b[0] >= middle)
