"""Spikes: up to three samples in a row that go far away and come back, which no other sensor follows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.track import Array, Spikes, Times, TimeSeries, parts, unit_rows
from rb_dynamics.analysis.velocities_from_poses import rates_of
from rb_dynamics.numerics.rotation_arrays import rotate_all

# A spike is so many times the usual step of this many samples on either side from the median of these.
_FAR, _STEPS, _AROUND = 5.0, 7, 3
# Of the largest value near, a step that may be rounding, and one that may be that of single precision.
_ROUNDING, _SINGLE = 1e-12, 2.0**-23
# No sensor has coarser steps than this: rad/s, m/s, m; nor the ends of axes.
_COARSEST = 0.1
# More samples than this part are the noise of the sensor.
_MOST = 0.05
# So many times what a change of the rate makes in one interval, or the step before one at an end.
_TURNED = 2.0
# A position or an attitude is followed by what shows this part of its spike.
_FOLLOWS = 0.25
# The pose follows a spike of the twist if it shows this part of what it would if the body moved so, and this multiple
# of its own noise; of all spikes that it does not follow, it shows less than this part, even with this multiple of the
# noise of their mean more.
_SHOWS, _ABOVE_NOISE = 0.5, 3.0
# Without a pose, wrenches may make a spike where they change so many times as much as is usual.
_PUSHES = 2.0
# It cannot tell where samples are missing: where others are farther apart than usual by so many usual intervals.
_MISSING = 0.5


def without_spikes(
    twist: TimeSeries, pose: TimeSeries | None, in_world: bool, wrenches: Iterable[tuple[Times, Array]] = ()
) -> TimeSeries:
    """Return the twist with each spike named, and what lies between the samples about it in its place.

    What the pose follows is motion; without a pose, what comes where `wrenches` (times and rows of each) change may be.
    """
    if len(twist.time_ns) <= _STEPS:
        return twist
    pushed = _pushed(twist.time_ns, wrenches)
    values = twist.values
    told: list[Spikes] = []
    seconds = (twist.time_ns - twist.time_ns[0]) * 1e-9
    # Two of one stamp contradict each other, which is told as such.
    again = np.diff(twist.time_ns) == 0
    shared = np.append(again, False) | np.append(False, again)
    for number, (columns, unit) in enumerate(((slice(0, 3), "m/s"), (slice(3, 6), "rad/s"))):
        rows = twist.values[:, columns]
        odd = _all_far(rows) & ~shared
        at = np.flatnonzero(odd)
        if not 0 < len(at) <= _MOST * len(rows):
            continue
        about = _about(seconds, rows, odd)
        beyond = rows[at] - about
        size, pose_noise = np.linalg.norm(beyond, axis=1), np.inf if pose is not None else 0.0
        # How much the pose shows of each in its direction, and would if the body moved so; without a pose, all counts.
        followed, would = np.zeros(len(at)), size
        if pose is not None and (shown := rates_of(pose)) is not None:
            near = np.searchsorted(shown.twist.time_ns, twist.time_ns[at]).clip(max=len(shown.twist.time_ns) - 1)
            rates, pose_noise = shown.twist.values[near, columns], shown.noise[number]
            if in_world:
                turned = np.searchsorted(pose.time_ns, shown.twist.time_ns[near])
                rates = rotate_all(unit_rows(pose.values[turned, 3:]), rates)
            without = rows.copy()
            without[at] = about
            pose_s, at_s = (
                (times - twist.time_ns[0]) * 1e-9 for times in (np.unique(pose.time_ns), shown.twist.time_ns[near])
            )
            as_told, as_usual = (_differences(seconds, each, pose_s, at_s) for each in (rows, without))
            followed, would = (np.sum((each - as_usual) * beyond, axis=1) / size for each in (rates, as_told))
        alone = followed <= np.maximum(_SHOWS * would, _ABOVE_NOISE * pose_noise)
        alone &= _near_others(twist.time_ns, odd) & ~_goes_on(rows, odd)[at]
        # At an end, differences of the pose show less than half of a change that began just before.
        before, after = _others(odd)
        alone &= ~pushed[at] | ((pose is not None) & (before >= 0) & (after < len(odd)))
        alone &= pose is None or _between_neighbours(pose.time_ns, twist.time_ns[at])
        weight = float(np.sum(would[alone] ** 2))
        hidden = _ABOVE_NOISE * pose_noise * np.sqrt(weight / 3.0) if weight else 0.0
        if weight and float(np.sum((followed * would)[alone])) + hidden <= _SHOWS * weight:
            values = values if told else values.copy()
            values[at[alone], columns] = about[alone]
            told.append(Spikes(unit, twist.time_ns[at[alone]], size[alone]))
    return replace(twist, values=values, spikes=tuple(told)) if told else twist


def _differences(seconds: Array, rows: Array, pose_s: Array, at_s: Array) -> Array:
    """Return what differences of a pose at the times `pose_s` show at some of these of rates that are `rows`.

    The mean of the rates over the two intervals about each, as in `rates_of`.
    """
    steps = np.diff(seconds)[:, None]
    gone = np.vstack([np.zeros((1, rows.shape[1])), np.cumsum(0.5 * steps * (rows[1:] + rows[:-1]), axis=0)])

    def until(times_s: Array) -> Array:
        last = np.searchsorted(seconds, times_s, side="right").clip(1, len(seconds)) - 1
        here = np.stack([np.interp(times_s, seconds, column) for column in rows.T], axis=1)
        result: Array = gone[last] + 0.5 * (times_s - seconds[last])[:, None] * (rows[last] + here)
        return result

    place = np.searchsorted(pose_s, at_s).clip(1, len(pose_s) - 2)
    begin, middle, end = (until(pose_s[place + by]) for by in (-1, 0, 1))
    before, after = (np.diff(pose_s)[place + by][:, None] for by in (-1, 0))
    shown: Array = ((end - middle) / after * before + (middle - begin) / before * after) / (before + after)
    return shown


def spikes_of_position(
    series: TimeSeries, speeds: TimeSeries | None, wrenches: Iterable[tuple[Times, Array]] = ()
) -> Spikes | None:
    """Return the spikes of positions (n, 3) at different times; None without any.

    It is motion if the `speeds` (n,), m/s, are by then other than those to which the positions about it lead; without
    any, what comes where `wrenches` (times and rows of each) change to and fro may be.
    """
    return _that_come_back(series, speeds, wrenches, "m")


def spikes_of_attitude(
    series: TimeSeries, rates: TimeSeries | None, wrenches: Iterable[tuple[Times, Array]] = ()
) -> Spikes | None:
    """Return the spikes of attitudes, unit quaternions xyzw (n, 4), at different times; None without any.

    It is motion if the magnitudes of the `rates` (n,), rad/s, are by then other than the attitudes about it lead to;
    without any, what comes where `wrenches` change to and fro may be.
    """
    # The ends of the three axes are at one place in R^9, which moves at sqrt(2) |w| and knows no sign of quaternions.
    axes = np.hstack([rotate_all(series.values, np.tile(axis, (len(series.values), 1))) for axis in np.eye(3)])
    speeds = None if rates is None else replace(rates, values=np.sqrt(2.0) * rates.values)
    found = _that_come_back(replace(series, values=axes), speeds, wrenches, "rad")
    return found and replace(found, size=2.0 * np.arcsin((found.size / np.sqrt(8.0)).clip(max=1.0)))


def _that_come_back(
    series: TimeSeries, speeds: TimeSeries | None, wrenches: Iterable[tuple[Times, Array]], unit: str
) -> Spikes | None:
    """Return the spikes of places (n, k) as `spikes_of_position`, in `unit`."""
    time_ns, rows = series.time_ns, series.values
    if len(time_ns) <= _STEPS:
        return None
    seconds = (time_ns - time_ns[0]) * 1e-9
    rates = _usual_rates(seconds, rows)
    steps = rates * np.diff(seconds)[:, None]
    beside = rows - np.vstack([np.zeros((1, rows.shape[1])), np.cumsum(steps, axis=0)])
    odd = _all_far(beside)
    # At the ends, the usual rate is that of a time farther inside.
    for end in (slice(None, _STEPS + _AROUND), slice(-_STEPS - _AROUND, None)):
        odd[end] &= _all_far(rows)[end]
    at = np.flatnonzero(odd)
    if not 0 < len(at) <= _MOST * len(rows):
        return None
    size = np.linalg.norm(rows[at] - _about(seconds, rows, odd), axis=1)
    # Where the usual rate follows each step, none is far from it: noise is what the rates change by.
    bends = np.diff(np.diff(rows, axis=0) / np.diff(seconds)[:, None], axis=0)
    usual = float(np.median(np.diff(seconds)))
    noise = float(np.median(np.linalg.norm(bends, axis=1))) * usual
    # After an impact the body goes on at another rate.
    last = len(rates) - 1
    turned = np.linalg.norm(rates[(at + _STEPS).clip(max=last)] - rates[(at - 1 - _STEPS).clip(0, last)], axis=1)
    alone = size > np.maximum(max(_FAR * noise, _ROUNDING * float(np.abs(rows).max())), _TURNED * turned * usual)
    alone &= _near_others(time_ns, odd)
    # A jump does not come back.
    before, after = (beside[each.clip(0, len(rows) - 1)] for each in _others(odd))
    alone &= np.linalg.norm(after - before, axis=1) <= size
    if speeds is None:
        alone &= ~_pushed(time_ns, wrenches)[at]
    else:
        speed = np.linalg.norm(rates, axis=1)[at.clip(max=last)]
        # As many samples as may be a spike, and one on either side.
        ends = (time_ns[(at + by).clip(0, len(rows) - 1)] for by in (-_AROUND, _AROUND))
        spans = (slice(*each) for each in np.searchsorted(speeds.time_ns, np.stack(list(ends), axis=1)))
        beyond = [np.abs(speeds.values[s] - u).max(initial=0.0) for s, u in zip(spans, speed, strict=True)]
        alone &= np.array(beyond) * usual <= _FOLLOWS * size
    return Spikes(unit, time_ns[at[alone]], size[alone]) if alone.any() else None


def _pushed(time_ns: Times, wrenches: Iterable[tuple[Times, Array]]) -> NDArray[np.bool_]:
    """Return near which samples wrenches change to and fro, or change at all near an end, by more than usual.

    Changes are measured relative to the largest wrench of each channel.
    """
    reach = (_AROUND + 1) * int(np.median(np.diff(time_ns)))
    changed, at = np.zeros(len(time_ns)), [np.zeros(0, dtype=np.int64)]
    for times, rows in wrenches:
        largest = np.abs(rows).max(axis=0, initial=0.0)
        steps = (np.abs(np.diff(rows, axis=0, prepend=0.0)) / np.where(largest > 0.0, largest, 1.0)).sum(axis=1)
        until = np.append(0, np.cumsum(steps))
        first, last = np.searchsorted(times, time_ns - reach), np.searchsorted(times, time_ns + reach, side="right")
        changed += until[last] - until[first]
        at.append(times[steps > 0.0])
    # Changes between two samples, as of channels that are commanded together, are one, and not to and fro.
    every = np.sort(np.concatenate(at))
    apart = every[np.unique(np.searchsorted(time_ns, every, side="right"), return_index=True)[1]]
    changes = np.searchsorted(apart, time_ns + reach, side="right") - np.searchsorted(apart, time_ns - reach)
    # At an end, nothing shows that what goes away comes back.
    inside = (time_ns - reach >= time_ns[0]) & (time_ns + reach <= time_ns[-1])
    pushed: NDArray[np.bool_] = (changes > inside) & (changed > _PUSHES * np.median(changed))
    return pushed


def _usual_rates(seconds: Array, rows: Array) -> Array:
    """Return how fast the rows usually change about each step: the median, 1/s."""
    from scipy.ndimage import median_filter

    rates: Array = median_filter(np.diff(rows, axis=0) / np.diff(seconds)[:, None], (2 * _STEPS + 1, 1), mode="mirror")
    return rates


def _about(seconds: Array, rows: Array, odd: NDArray[np.bool_]) -> Array:
    """Return what lies between the other rows in the place of the odd ones."""
    return np.stack([np.interp(seconds[odd], seconds[~odd], column) for column in rows[~odd].T], axis=1)


def _goes_on(rows: Array, odd: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which odd rows at an end are reached by a step like the one before, as where the body turns faster.

    There nothing shows that they come back.
    """
    steps, others = np.linalg.norm(np.diff(rows, axis=0), axis=1), np.flatnonzero(~odd)
    first, last = others[0], others[-1]
    goes_on = np.zeros(len(odd), dtype=bool)
    goes_on[:first] = steps[first - 1] <= _TURNED * steps[first]
    goes_on[last + 1 :] = steps[min(last, len(steps) - 1)] <= _TURNED * steps[last - 1]
    return goes_on


def _between_neighbours(times: Times, at: Times) -> NDArray[np.bool_]:
    """Return at which times no samples of another sensor, of these `times`, are missing on either side."""
    near = np.searchsorted(times, at)
    return _all_there(times, near - 1, near + 1)


def _near_others(times: Times, odd: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return beside which of the odd samples, and between it and the next others on either side, none is missing."""
    before, after = _others(odd)
    # At an end, only others farther inside show where it would be.
    first, last = np.where(after < len(odd), before, before - _AROUND), np.where(before < 0, after + _AROUND, after)
    return _all_there(times, first, last)


def _others(odd: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the places of the next others before and after each of the odd samples; beyond an end -1 or the length."""
    others = np.concatenate([[-1], np.flatnonzero(~odd), [len(odd)]])
    after = np.searchsorted(others, np.flatnonzero(odd))
    return others[after - 1], others[after]


def _all_there(times: Times, first: NDArray[np.intp], last: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return between which samples about as many are as usual; beyond an end there is none."""
    first, last = first.clip(0, len(times) - 1), last.clip(0, len(times) - 1)
    usual = np.median(np.diff(times))
    there: NDArray[np.bool_] = times[last] - times[first] <= (last - first + _MISSING) * usual
    return there


def _all_far(rows: Array) -> NDArray[np.bool_]:
    """Return which rows are far from the median of those about them."""
    return np.concatenate([_far(rows, part) for part in parts(len(rows))])


def _far(rows: Array, part: slice) -> NDArray[np.bool_]:
    """Return which of a part of the rows are far from the median of those about them."""
    first, last = max(part.start - _STEPS, 0), min(part.stop + _STEPS, len(rows))
    near = rows[first:last]
    steps = np.linalg.norm(np.diff(near, axis=0), axis=1)
    if len(steps) <= _STEPS or not (steps > 0.0).any():
        return np.zeros(part.stop - part.start, dtype=bool)
    windows = np.lib.stride_tricks.sliding_window_view
    middle = np.median(
        windows(np.pad(near, ((_AROUND,) * 2, (0, 0)), mode="reflect"), 2 * _AROUND + 1, axis=0), axis=-1
    )
    usual = np.median(windows(np.pad(steps, _STEPS, mode="reflect"), 2 * _STEPS), axis=-1)
    # A coarse sensor often repeats itself: its least step is usual. Where all stands still but for spikes, that is one.
    largest = float(np.abs(near).max())
    least = min(float(steps[steps > 0.0].min()), max(_COARSEST, _SINGLE * largest))
    least = max(least, _ROUNDING * largest)
    far: NDArray[np.bool_] = np.linalg.norm(near - middle, axis=1) > _FAR * np.maximum(usual, least)
    return far[part.start - first :][: part.stop - part.start]
