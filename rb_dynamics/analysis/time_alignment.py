"""`Alignment`: how the times of two recordings belong together, given by the reader or found as the best lag.

The lag makes the magnitudes of angular and linear velocity, which do not depend on the axes, differ least. If they are
constant or periodic, the angular velocity in body axes is used, and attitudes decide between lags that fit equally
well. How certain the lag is follows from the noise, from other differences, from each half of the recording
alone, and from other lags that fit as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rb_dynamics.analysis.interpolated_signal import MotionSignals, Signal, differences
from rb_dynamics.analysis.track import Array, Times
from rb_dynamics.errors import LogError

# The most grid points of the search, and samples at which two recordings are compared.
_GRID = 1 << 16
# At least this part of the shorter recording lies within the other at a lag.
_OVERLAP = 0.5
# A signal that changes less than this, relative to its size, cannot be aligned by.
_FLAT = 1e-6
# Rates of a pose that are rougher than this are taken over twice the interval, while at least this many remain.
_ROUGH, _LEAST = 0.05, 50
# The best lag leaves at most this part of the usual difference; another one that leaves less than this many times what
# the best leaves, or this part of the usual, is a rival.
_FITS, _TIMES, _RIVAL = 0.25, 4.0, 0.02
# So many rivals are told apart by attitudes at so many instants. Those of the best lag differ by at most so many rad,
# and those of the next by this many times more: world and body axes of both are then the same.
_MOST, _INSTANTS, _ALIKE, _SURELY = 32, 2000, 0.3, 3.0
# Steps to either side over which a slope is taken, and how many reaches of it are tried, each four times the last.
_AROUND, _REACHES = 4, 4
# The most steps of Newton's method, and steps of the search within which it must stay to count.
_ROUNDS, _FARTHEST = 20, 400
# Offsets so many times as far as the nearest that is excluded are excluded, too.
_BEYOND = (1.0, 1.5, 2.0, 3.0, 4.0)
# So many samples later, what remains shares no sample with what remains now.
_LATER = 5
# Part of the time that both cover to which a lag must be known.
_KNOWN = 0.1
# What an offset at which stamps coincide leaves, at most, of what the best one does.
_SHARP = 0.5
_SECOND = 1e9


@dataclass(frozen=True)
class Alignment:
    """How two clocks are related: a time of B minus `offset_ns` is one of A.

    Attributes:
        by: "stamp", "start", "seconds", "commands" (A or B was simulated under those of the other) or "lag".
        offset_ns: time of B minus time of A at one instant.
        uncertainty_s: of a lag that was found; None otherwise.
        rival_s: another lag that fits about as well; None without.
        remaining: of a lag that was found, the difference that it leaves relative to the usual one, 0 to 1.
        shared_s: time that both cover at a lag that was found; None otherwise.
        asked: the user chose it.
    """

    by: str
    offset_ns: int
    uncertainty_s: float | None = None
    rival_s: float | None = None
    remaining: float | None = None
    shared_s: float | None = None
    asked: bool = False

    @property
    def doubtful(self) -> bool:
        """Whether another lag may be the true one, or none fits well."""
        return bool(self.doubts)

    @property
    def doubts(self) -> list[str]:
        """Why another lag may be the true one, in words; empty if there is none."""
        told = []
        if (self.remaining or 0.0) > _FITS:
            told.append(f"it leaves {100.0 * (self.remaining or 0.0):.0f} % of the usual difference of rates")
        if self.rival_s is not None:
            told.append(f"{self.rival_s:.6f} s fits about as well")
        if self.shared_s is not None and (self.uncertainty_s or 0.0) > _KNOWN * self.shared_s:
            told.append(f"it is known to +- {self.uncertainty_s:.2g} s only, of {self.shared_s:.3g} s that both cover")
        return told


def best_lag(a: MotionSignals, b: MotionSignals) -> Alignment:
    """Return the alignment at which the two motions differ least.

    Raises:
        LogError: nothing in them changes, so they cannot be aligned.
    """
    a, b = a.without_outliers(), b.without_outliers()
    poses = a.attitude, b.attitude
    found = [
        lag for signals in (_magnitudes(a, b), _vectors(a, b)) if signals and (lag := _lag(signals, *poses)) is not None
    ]
    if not found:
        raise LogError(
            "found no change of the motion by which the two could be aligned in time, expected rates or velocities "
            "that vary in both; say how with --align start, --align stamp or --align SECONDS"
        )
    return min(found, key=lambda lag: (lag.doubtful, lag.uncertainty_s))


def misfit(a: MotionSignals, b: MotionSignals, offset_ns: int) -> float | None:
    """Return the difference that remains at an offset, as `remaining`; None if nothing varies."""
    signals = _magnitudes(a.without_outliers(), b.without_outliers())
    return _cost(signals, offset_ns) if signals else None


@dataclass(frozen=True)
class _SignalPair:
    """One quantity of both, and its usual squared difference if the two are not of the same time."""

    a: Signal
    b: Signal
    usual: float


def _magnitudes(a: MotionSignals, b: MotionSignals) -> list[_SignalPair]:
    return _varying(
        [
            (_size(a.rate or _changing(a.attitude)), _size(b.rate or _changing(b.attitude))),
            (_size(a.velocity_body or _changing(a.position)), _size(b.velocity_body or _changing(b.position))),
        ]
    )


def _vectors(a: MotionSignals, b: MotionSignals) -> list[_SignalPair]:
    return _varying([(a.rate or _changing(a.attitude), b.rate or _changing(b.attitude))])


def _size(signal: Signal | None) -> Signal | None:
    return signal and Signal(signal.time_ns, np.linalg.norm(signal.values, axis=1, keepdims=True), signal.broken)


def _changing(signal: Signal | None) -> Signal | None:
    """Return the rates of a pose, over the shortest intervals at which its noise does not hide them."""
    found: dict[float, Signal] = {}
    every = 1
    while signal is not None and len(signal.time_ns) > every * (_LEAST if found else 2):
        rates = _rates(signal, every)
        found.setdefault(_roughness(rates), rates)
        if min(found) < _ROUGH:
            break
        every *= 2
    return found[min(found)] if found else None


def _rates(signal: Signal, every: int) -> Signal:
    """Return changes from one of `every` samples to the next as mean rates, in the middle; none over gaps."""
    times, values = signal.time_ns[::every], signal.values[::every]
    lost = np.concatenate([[0], np.cumsum(signal.broken)])[::every]
    length, whole = np.diff(times), np.diff(lost) == 0
    changes = differences(values[:-1], values[1:]) / (length[:, None] * 1e-9)
    return Signal.of((times[:-1] + length // 2)[whole], changes[whole])


def _roughness(signal: Signal) -> float:
    """Return mean squared difference of neighbours, of twice the variance: 1 for noise (von Neumann), 0 if smooth."""
    spread = float(np.sum(signal.values.var(axis=0))) if len(signal.values) > 1 else 0.0
    steps = np.sum(np.diff(signal.values, axis=0)[~signal.broken] ** 2, axis=1)
    return float(steps.mean()) / (2.0 * spread) if spread > 0.0 and len(steps) else np.inf


def _varying(pairs: list[tuple[Signal | None, Signal | None]]) -> list[_SignalPair]:
    signals = []
    for one, other in pairs:
        if one is None or other is None or len(one.time_ns) < 4 or len(other.time_ns) < 4:
            continue
        both = np.concatenate([one.values, other.values])
        usual = float(np.sum(one.values.var(axis=0) + other.values.var(axis=0)))
        if min(one.values.std(axis=0).max(), other.values.std(axis=0).max()) > _FLAT * np.abs(both).max():
            signals.append(_SignalPair(one, other, usual))
    return signals


def _lag(signals: list[_SignalPair], a: Signal | None, b: Signal | None) -> Alignment | None:
    """Return the best lag of the signals; the attitudes `a` and `b` decide between lags that fit equally well."""
    step_ns, lags, costs = _search(signals)
    if not np.isfinite(costs).any():
        return None
    best, usual = int(np.nanargmin(costs)), float(np.nanmedian(costs))
    valley, least = _found(signals, lags, costs, best, step_ns)
    rivals = _rivals(costs, best, least, usual)
    if len(rivals) and a is not None and b is not None:
        left = {at: _angle(a, b.later(-int(lags[at]))) for at in (best, *rivals)}
        first, second = sorted(left, key=left.__getitem__)[:2]
        if left[first] < min(_ALIKE, left[second] / _SURELY):
            best, rivals = first, []
            valley, least = _found(signals, lags, costs, best, step_ns)
    if not np.isfinite(valley.uncertainty_s):
        return None
    rival = float(lags[rivals[0]]) / _SECOND if rivals else None
    uncertainty_s = _uncertainty(signals, valley, step_ns)
    shared_s = max((_shared_s(each, valley.offset_ns) for each in signals), default=0.0)
    return Alignment("lag", valley.offset_ns, uncertainty_s, rival, min(1.0, least / usual), shared_s)


def _shared_s(pair: _SignalPair, offset_ns: int) -> float:
    """Return the time (s) that the two cover at an offset."""
    begin = max(int(pair.a.time_ns[0]), int(pair.b.time_ns[0]) - offset_ns)
    end = min(int(pair.a.time_ns[-1]), int(pair.b.time_ns[-1]) - offset_ns)
    return (end - begin) / _SECOND


def _found(signals: list[_SignalPair], lags: Times, costs: Array, at: int, step_ns: int) -> tuple[_Valley, float]:
    """Return the minimum near a lag of the search, and the difference that remains there."""
    valley = _refined(signals, int(lags[at]), step_ns)
    least = _cost(signals, valley.offset_ns)
    return valley, float(costs[at]) if least is None else least


def _rivals(costs: Array, best: int, least: float, usual: float) -> list[int]:
    """Return the lags that fit about as well as the best, the best first, one for each other minimum."""
    low = np.flatnonzero(costs <= 0.5 * (least + usual))
    hollows = np.split(low, np.flatnonzero(np.diff(low) > 1) + 1)
    found = [int(each[costs[each].argmin()]) for each in hollows if len(each) and best not in each]
    below = max(_TIMES * least, _RIVAL * usual)
    return sorted((at for at in found if costs[at] < below), key=costs.__getitem__)[:_MOST]


def _angle(a: Signal, b: Signal) -> float:
    """Return the rms angle (rad) between two attitudes of one clock; infinite if they share no time."""
    times = min(a.time_ns, b.time_ns, key=len)
    times = times[:: 1 + len(times) // _INSTANTS]
    (one, known), (other, here) = a.at(times), b.at(times)
    known &= here
    squares = np.sum(differences(one[known], other[known]) ** 2, axis=1)
    return float(np.sqrt(squares.mean())) if known.any() else np.inf


def _search(signals: list[_SignalPair]) -> tuple[int, Times, Array]:
    """Return the step of a grid of lags, the lags (ns) and the difference at each; NaN where too little overlaps.

    The sums of squares of all lags are correlations of the values with the masks of what is known.
    """
    from scipy.signal import fftconvolve

    both = [[each.a for each in signals], [each.b for each in signals]]
    spans = [(min(int(s.time_ns[0]) for s in one), max(int(s.time_ns[-1]) for s in one)) for one in both]
    usual_ns = max(float(np.median(np.diff(signal.time_ns))) for one in both for signal in one)
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


def _cost(signals: list[_SignalPair], offset_ns: int) -> float | None:
    """Return the difference at an offset: mean square relative to the usual one, summed over the signals."""
    costs = [
        float(np.mean(np.sum(rest**2, axis=1))) / each.usual for each in signals if len(rest := _rest(each, offset_ns))
    ]
    return sum(costs) if costs else None


def _rest(pair: _SignalPair, offset_ns: int) -> Array:
    """Return the difference of the two at an offset, at the samples of the coarser one where both are known."""
    moved = pair.b.later(-offset_ns)
    coarse, fine = (pair.a, moved) if len(pair.a.time_ns) <= len(moved.time_ns) else (moved, pair.a)
    values, known = fine.at(coarse.time_ns)
    rest: Array = (values - coarse.values)[known]
    return rest


class _Valley(NamedTuple):
    """The offset near the best of the search at which the two agree, ns, and its uncertainty."""

    offset_ns: int
    uncertainty_s: float


def _refined(signals: list[_SignalPair], offset_ns: int, step_ns: int) -> _Valley:
    """Return the offset near `offset_ns` at which the difference is no longer correlated with the slopes.

    This is not the minimum of the difference: between two samples interpolation averages their noise, so that it is
    lower at some offsets than at others whatever the motion. An offset at which stamps coincide and which leaves far
    less than its neighbours is believed, for the two are then of one recording.
    """
    reaches = [_AROUND * step_ns * 4**k for k in range(_REACHES)]
    reach_ns = min(reaches, key=lambda reach: _deviations(*_scores(signals, offset_ns, step_ns, reach)))
    valley = _balanced(signals, offset_ns, step_ns, reach_ns)
    chosen = _coinciding(signals, valley.offset_ns)
    left, least = _cost(signals, chosen), _cost(signals, valley.offset_ns)
    if left is None or least is None or left > _SHARP * least:
        return valley
    return _Valley(chosen, _within(signals, chosen, step_ns, reach_ns))


def _balanced(signals: list[_SignalPair], offset_ns: int, step_ns: int, reach_ns: int) -> _Valley:
    """Return the offset found by Newton's method, with slopes over `reach_ns` as weights."""
    near = _AROUND * step_ns
    at = offset_ns
    for _ in range(_ROUNDS):
        scores, slope = _scores(signals, at, step_ns, reach_ns)
        if slope <= 0.0:
            break
        by = round(min(max(-_SECOND * float(scores.sum()) / slope, -near), near))
        at += by
        if abs(by) <= 1:
            break
    return _Valley(at, _within(signals, at, step_ns, reach_ns))


def _within(signals: list[_SignalPair], offset_ns: int, step_ns: int, reach_ns: int) -> float:
    """Return how far (s) from an offset the others lie that noise of independent samples excludes; infinite for none.

    An offset is excluded if the sum of its scores is beyond two standard deviations, the root of the sum of their
    squares (White, Econometrica 48 (1980) 817), and so without the slope, which noise may hide (Anderson & Rubin,
    Annals of Mathematical Statistics 20 (1949) 46). Where noise hides most of the slopes, offsets farther away may be
    in again.
    """

    def excluded(at_ns: int) -> bool:
        scores, _ = _scores(signals, at_ns, step_ns, reach_ns)
        return float(scores.sum()) ** 2 > 4.0 * float(np.sum(scores**2))

    deviations = _deviations(*_scores(signals, offset_ns, step_ns, reach_ns))
    by_ns = max(1.0, _SECOND * deviations if np.isfinite(deviations) else 1e-3 * step_ns)
    while by_ns < _FARTHEST * step_ns:
        if all(excluded(offset_ns + side * round(far * by_ns)) for far in _BEYOND for side in (-1, 1)):
            return by_ns / _SECOND
        by_ns *= 1.25
    return np.inf


def _deviations(scores: Array, slope: float) -> float:
    """Return two standard deviations (s) of an offset; infinite without a slope."""
    return 2.0 * float(np.sqrt(np.sum(scores**2))) / slope if slope > 0.0 else np.inf


def _scores(signals: list[_SignalPair], offset_ns: int, step_ns: int, reach_ns: int) -> tuple[Array, float]:
    """Return for each sample what remains at an offset times the slopes over `reach_ns`, and the slope of their sum.

    No factor shares a sample with the other, nor do those of the slope of the sum, so that noise does not add up in
    either (instrumental variables).
    """
    parts: list[Array] = []
    total = 0.0
    for each in signals:
        moved = each.b.later(-offset_ns)
        times = min(each.a.time_ns, moved.time_ns, key=len)
        times = times[:: 1 + len(times) // _GRID]
        (a, known), (b, here) = each.a.at(times), moved.at(times)
        known &= here
        slopes = []
        for signal in (each.a, moved):
            for by_ns in (reach_ns, _AROUND * step_ns):
                (before, one), (after, other) = signal.at(times - by_ns), signal.at(times + by_ns)
                known &= one & other
                slopes.append((after - before) / (2e-9 * by_ns))
        weight_a, slope_a, weight_b, slope_b = (slope[known] for slope in slopes)
        parts.append(np.sum((weight_a + weight_b) * (b - a)[known], axis=1) / each.usual)
        total += float(np.sum(weight_a * slope_b + weight_b * slope_a)) / each.usual
    return np.concatenate(parts), total


def _coinciding(signals: list[_SignalPair], offset_ns: int) -> int:
    """Return the offset next to `offset_ns` at which the first stamp of B is one of A."""
    a, b = signals[0].a.time_ns, signals[0].b.time_ns
    first = int(b[0]) - offset_ns
    at = min(max(int(a.searchsorted(first)), 1), len(a) - 1)
    return int(b[0]) - min((int(a[at - 1]), int(a[at])), key=lambda time: abs(time - first))


def _uncertainty(signals: list[_SignalPair], valley: _Valley, step_ns: int) -> float:
    """Return the uncertainty of the lag, s: from the noise, from each half alone, or from other differences."""
    halves = [_refined(half, valley.offset_ns, step_ns) for half in _halves(signals, valley.offset_ns)]
    told = len(halves) == 2 and all(np.isfinite(half.uncertainty_s) for half in halves)
    apart = abs(halves[0].offset_ns - halves[1].offset_ns) / _SECOND / 2.0 if told else 0.0
    # Stamps are whole nanoseconds.
    return max(valley.uncertainty_s, apart, _bias(signals, valley, step_ns), 1e-9)


def _bias(signals: list[_SignalPair], valley: _Valley, step_ns: int) -> float:
    """Return how far (s) motions that differ by more than noise and time may have moved the lag, at most.

    What remains moves it by its correlation with the slopes, which is no more than the product of their sizes (Cauchy
    and Schwarz). Of what remains, noise is the part that is independent of what remains some samples later.
    """
    left = 0.0
    for each in signals:
        rest = _rest(each, valley.offset_ns)
        if len(rest) > _LATER:
            together = float(np.mean(np.sum(rest[_LATER:] * rest[:-_LATER], axis=1)))
            chance = 2.0 * float(np.mean(np.sum(rest**2, axis=1))) / np.sqrt(len(rest))
            left += len(rest) * max(0.0, together - chance) / each.usual
    _, slope = _scores(signals, valley.offset_ns, step_ns, _AROUND * step_ns)
    return float(np.sqrt(2.0 * left / slope)) if slope > 0.0 else np.inf


def _halves(signals: list[_SignalPair], offset_ns: int) -> list[list[_SignalPair]]:
    begin = max(int(max(each.a.time_ns[0], each.b.time_ns[0] - offset_ns)) for each in signals)
    end = min(int(min(each.a.time_ns[-1], each.b.time_ns[-1] - offset_ns)) for each in signals)
    middle = (begin + end) // 2
    cut = [
        [_SignalPair(each.a.within(first, last), each.b, each.usual) for each in signals]
        for first, last in ((begin, middle), (middle, end))
    ]
    return [half for half in cut if all(len(each.a.time_ns) > 8 for each in half)]
