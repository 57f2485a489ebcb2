"""`Alignment`: how the times of two recordings belong together, given by the reader or found as the best lag.

The lag is that at which the magnitudes of angular and linear velocity, which no choice of axes changes, differ least;
where they say nothing or repeat themselves, the angular velocity in body axes. It is said how far it can be trusted:
by the noise, by the halves of the recording alone, and by other lags that fit as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rb_dynamics.analysis.streams import MotionStreams, Stream
from rb_dynamics.analysis.track import Array, Times
from rb_dynamics.errors import LogError
from rb_dynamics.numerics.rotation_arrays import rotation_vectors

# Grid points at most, for the search.
_GRID = 1 << 16
# At least this part of the shorter recording lies within the other at a lag.
_OVERLAP = 0.5
# A signal that changes less than this, relative to its size, has nothing to be aligned by.
_FLAT = 1e-6
# The best lag leaves at most this part of the usual difference; another one that leaves less than this many times what
# the best leaves, or this part of the usual, is a rival.
_FITS, _TIMES, _RIVAL = 0.25, 4.0, 0.02
# Steps to either side in which the lowest point is looked for, and what one that stands out leaves of what is usual.
_AROUND, _SHARP = 4, 0.5
_SECOND = 1e9


@dataclass(frozen=True)
class Alignment:
    """How two clocks belong together: a time of B minus `offset_ns` is one of A.

    Attributes:
        by: "stamp", "start", "seconds", "commands" (the bag from which A or B was flown) or "lag".
        offset_ns: B's time less A's at one instant.
        uncertainty_s: of a lag that was found; None otherwise.
        rival_s: another lag that fits about as well; None without.
        remaining: of a lag that was found, the difference that it leaves relative to the usual one, 0 to 1.
    """

    by: str
    offset_ns: int
    uncertainty_s: float | None = None
    rival_s: float | None = None
    remaining: float | None = None

    @property
    def doubtful(self) -> bool:
        """Whether another lag may be the true one, or none fits well."""
        return self.rival_s is not None or (self.remaining or 0.0) > _FITS


def best_lag(a: MotionStreams, b: MotionStreams) -> Alignment:
    """Return the alignment at which the two motions differ least.

    Raises:
        LogError: nothing changes in them by which they could be aligned.
    """
    found = [lag for signals in (_magnitudes(a, b), _vectors(a, b)) if signals and (lag := _lag(signals)) is not None]
    if not found:
        raise LogError(
            "found no change of the motion by which the two could be aligned in time, expected rates or velocities "
            "that vary in both; say how with --align start, --align stamp or --align SECONDS"
        )
    return min(found, key=lambda lag: (lag.doubtful, lag.uncertainty_s))


def misfit(a: MotionStreams, b: MotionStreams, offset_ns: int) -> float | None:
    """Return what an offset leaves, as `remaining`; None if nothing varies."""
    signals = _magnitudes(a, b)
    return _cost(signals, offset_ns) if signals else None


@dataclass(frozen=True)
class _Signal:
    """One quantity of both, and its usual squared difference if the two are not of the same time."""

    a: Stream
    b: Stream
    usual: float


def _magnitudes(a: MotionStreams, b: MotionStreams) -> list[_Signal]:
    return _varying(
        [
            (_size(a.rate or _turning(a.attitude)), _size(b.rate or _turning(b.attitude))),
            (_size(a.velocity_body or _moving(a.position)), _size(b.velocity_body or _moving(b.position))),
        ]
    )


def _vectors(a: MotionStreams, b: MotionStreams) -> list[_Signal]:
    return _varying([(a.rate or _turning(a.attitude), b.rate or _turning(b.attitude))])


def _size(stream: Stream | None) -> Stream | None:
    return stream and Stream(stream.time_ns, np.linalg.norm(stream.values, axis=1, keepdims=True), stream.broken)


def _turning(attitude: Stream | None) -> Stream | None:
    return attitude and _rates(attitude, rotation_vectors(attitude.values))


def _moving(position: Stream | None) -> Stream | None:
    return position and _rates(position, np.diff(position.values, axis=0))


def _rates(stream: Stream, changes: Array) -> Stream | None:
    """Return changes as mean rates, in the middle of their intervals; none over gaps."""
    if len(stream.time_ns) < 3:
        return None
    length, whole = np.diff(stream.time_ns), ~stream.broken
    middle = stream.time_ns[:-1] + length // 2
    return Stream.of(middle[whole], (changes / (length[:, None] * 1e-9))[whole])


def _varying(pairs: list[tuple[Stream | None, Stream | None]]) -> list[_Signal]:
    signals = []
    for one, other in pairs:
        if one is None or other is None or len(one.time_ns) < 4 or len(other.time_ns) < 4:
            continue
        both = np.concatenate([one.values, other.values])
        usual = float(np.sum(one.values.var(axis=0) + other.values.var(axis=0)))
        if min(one.values.std(axis=0).max(), other.values.std(axis=0).max()) > _FLAT * np.abs(both).max():
            signals.append(_Signal(one, other, usual))
    return signals


def _lag(signals: list[_Signal]) -> Alignment | None:
    step_ns, lags, costs = _search(signals)
    if not np.isfinite(costs).any():
        return None
    best = int(np.nanargmin(costs))
    usual = float(np.nanmedian(costs))
    valley = _refined(signals, int(lags[best]), step_ns)
    offset_ns = valley.offset_ns
    least = _cost(signals, offset_ns)
    least = float(costs[best]) if least is None else least
    # Another lag lies beyond the hollow in which the best one lies.
    level = 0.5 * (least + usual)
    above = costs > level
    left = int(np.flatnonzero(above[:best])[-1]) if above[:best].any() else 0
    right = best + int(np.flatnonzero(above[best:])[0]) if above[best:].any() else len(costs) - 1
    others = np.concatenate([costs[:left], np.full(right + 1 - left, np.nan), costs[right + 1 :]])
    rival = None
    if np.isfinite(others).any() and np.nanmin(others) < max(_TIMES * least, _RIVAL * usual):
        rival = float(lags[int(np.nanargmin(others))]) / _SECOND
    return Alignment("lag", offset_ns, _uncertainty(signals, valley, step_ns), rival, min(1.0, least / usual))


def _search(signals: list[_Signal]) -> tuple[int, Times, Array]:
    """Return the step of a grid of lags, the lags (ns) and what each leaves; NaN where too little overlaps.

    The sums of squares of all lags are correlations of the values with the masks of what is known.
    """
    from scipy.signal import fftconvolve

    both = [[each.a for each in signals], [each.b for each in signals]]
    spans = [(min(int(s.time_ns[0]) for s in one), max(int(s.time_ns[-1]) for s in one)) for one in both]
    usual_ns = max(float(np.median(np.diff(stream.time_ns))) for one in both for stream in one)
    step_ns = max(1, round(max(0.5 * usual_ns, max(end - begin for begin, end in spans) / _GRID)))
    grid_a, grid_b = (np.arange(begin, end + 1, step_ns) for begin, end in spans)
    lags = spans[1][0] - spans[0][0] + step_ns * np.arange(1 - len(grid_a), len(grid_b))
    costs = np.zeros(len(lags))
    for each in signals:
        (x, w), (y, v) = each.a.at(grid_a), each.b.at(grid_b)
        middle = x[w].mean(axis=0)
        x, y = np.where(w[:, None], x - middle, 0.0), np.where(v[:, None], y - middle, 0.0)
        reverse = slice(None, None, -1)
        count = fftconvolve(v.astype(float), w[reverse].astype(float))
        squares = fftconvolve(v.astype(float), np.sum(x * x, axis=1)[reverse])
        squares += fftconvolve(np.sum(y * y, axis=1), w[reverse].astype(float))
        for one, other in zip(x.T, y.T, strict=True):
            squares -= 2.0 * fftconvolve(other, one[reverse])
        enough = count >= max(3.0, _OVERLAP * min(w.sum(), v.sum())) - 0.5
        costs += np.where(enough, np.maximum(squares, 0.0) / np.maximum(count, 1.0) / each.usual, np.nan)
    return step_ns, lags, costs


def _cost(signals: list[_Signal], offset_ns: int) -> float | None:
    """Return what an offset leaves: mean squared difference relative to the usual one, summed over the signals."""
    costs = []
    for each in signals:
        moved = each.b.later(-offset_ns)
        coarse, fine = (each.a, moved) if len(each.a.time_ns) <= len(moved.time_ns) else (moved, each.a)
        values, known = fine.at(coarse.time_ns)
        if known.any():
            costs.append(float(np.mean(np.sum((values - coarse.values)[known] ** 2, axis=1))) / each.usual)
    return sum(costs) if costs else None


class _Valley(NamedTuple):
    """The lowest point of what offsets near the best one leave, ns, and how far it may be off."""

    offset_ns: int
    uncertainty_s: float


def _refined(signals: list[_Signal], offset_ns: int, step_ns: int) -> _Valley:
    """Return the best offset about `offset_ns`: the lowest point of a parabola through what offsets near it leave.

    Noise makes the valley rough, and no single point of it is to be trusted, unless one leaves far less than its
    neighbours: the one at which stamps coincide, or without noise the very lowest.
    """
    from scipy.optimize import minimize_scalar

    def cost(by: float) -> float:
        found = _cost(signals, offset_ns + round(by * step_ns))
        return np.inf if found is None else found

    places = np.linspace(-_AROUND, _AROUND, 4 * _AROUND + 1)
    costs = np.array([cost(place) for place in places])
    if not np.isfinite(costs).all():
        return _Valley(offset_ns, np.inf)
    curvature, slope, _ = np.polyfit(places, costs, 2).tolist()
    if curvature <= 0.0:
        return _Valley(offset_ns, np.inf)
    lowest = float(np.clip(-slope / (2.0 * curvature), -_AROUND, _AROUND))
    chosen = _coinciding(signals, offset_ns + round(lowest * step_ns))
    left = _cost(signals, chosen) or 0.0
    if left > _SHARP * cost(lowest):
        chosen, left = offset_ns + round(lowest * step_ns), cost(lowest)
        if left < 1e-3 * curvature * _AROUND**2:
            bounds = (lowest - 1.0, lowest + 1.0)
            sharp = float(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-6}).x)
            if cost(sharp) < left:
                chosen, left = offset_ns + round(sharp * step_ns), cost(sharp)
    return _Valley(chosen, _spread(signals, chosen, _AROUND * step_ns))


def _spread(signals: list[_Signal], offset_ns: int, around_ns: int) -> float:
    """Return two standard deviations (s) of a lag fitted to independent noise that may differ from sample to sample.

    With slopes s (over `around_ns`, so that noise does not steepen them) and remainders r, the variance is
    sum (s r)^2 / (sum s^2)^2 (White, Econometrica 48 (1980) 817).
    """
    scores = slopes = 0.0
    for each in signals:
        moved = each.b.later(-offset_ns)
        (before, one), (after, other), (here, known) = (
            each.a.at(moved.time_ns + by) for by in (-around_ns, around_ns, 0)
        )
        known &= one & other
        slope = (after - before)[known] / (2e-9 * around_ns)
        scores += float(np.sum(np.sum(slope * (moved.values - here)[known], axis=1) ** 2)) / each.usual**2
        slopes += float(np.sum(slope**2)) / each.usual
    return 2.0 * float(np.sqrt(scores)) / slopes if slopes > 0.0 else np.inf


def _coinciding(signals: list[_Signal], offset_ns: int) -> int:
    """Return the offset next to `offset_ns` at which the first stamp of B is one of A."""
    a, b = signals[0].a.time_ns, signals[0].b.time_ns
    first = int(b[0]) - offset_ns
    at = min(max(int(a.searchsorted(first)), 1), len(a) - 1)
    return int(b[0]) - min((int(a[at - 1]), int(a[at])), key=lambda time: abs(time - first))


def _uncertainty(signals: list[_Signal], valley: _Valley, step_ns: int) -> float:
    """Return how far the lag may be off, s: as the noise says, or half of what the halves alone differ."""
    halves = [_refined(half, valley.offset_ns, step_ns) for half in _halves(signals, valley.offset_ns)]
    apart = abs(halves[0].offset_ns - halves[1].offset_ns) / _SECOND / 2.0 if len(halves) == 2 else 0.0
    # Stamps are whole nanoseconds.
    return max(valley.uncertainty_s, apart, 1e-9)


def _halves(signals: list[_Signal], offset_ns: int) -> list[list[_Signal]]:
    begin = max(int(max(each.a.time_ns[0], each.b.time_ns[0] - offset_ns)) for each in signals)
    end = min(int(min(each.a.time_ns[-1], each.b.time_ns[-1] - offset_ns)) for each in signals)
    middle = (begin + end) // 2
    cut = [
        [_Signal(each.a.within(first, last), each.b, each.usual) for each in signals]
        for first, last in ((begin, middle), (middle, end))
    ]
    return [half for half in cut if all(len(each.a.time_ns) > 8 for each in half)]
