"""Jumps of a recorded pose: intervals with much more motion than their neighbours, and than the twist explains.

Real motion is continuous. A pose jumps if markers are swapped, a filter is reset, or samples are lost while their
stamps continue.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.gaps import NAMED, listed, longest_usual
from rb_dynamics.analysis.track import LARGEST, Array, Times, TimeSeries, Track, in_blocks, parts, sizes_of, unit_rows
from rb_dynamics.formats.message_types import ODOMETRY
from rb_dynamics.numerics.rotation_arrays import exponentials, product, rotation_vectors, rotations_between

# Number of intervals on either side that define the usual motion.
_AROUND = 3
# A jump exceeds this multiple of the usual motion, and this multiple of its variation.
_TIMES, _SPREADS = 3.0, 10.0
# Smaller changes are not jumps: rad; and as a fraction of the longest distance between two positions.
_LEAST_TURN, _LEAST_PART = 0.02, 1e-3
# If two samples of one body alternate with one of another, the pose returns at every third sample to within this.
_RETURNS, _LAST, _NEAR = 0.3, 8, 0.05
# Noise takes rounded numbers back and forth between values that are so many steps of the rounding apart, but at most
# this far: m, rad. Two bodies at rest look like numbers that are rounded to steps as large as their distance.
_STEPS, _ROUNDED = 5.0, 0.1
# Two runs of stamps overlap where so many of so many samples in a row come within this part of the usual time, and jump
# this many times as far as the next two are apart.
_ROW, _OF_ROW, _DENSE, _JUMPS = 9, 12, 0.75, 3.0
# Two topics of one frame show two bodies if they are this far apart in the median: rad, m, fraction of the extent.
_APART_TURN, _APART, _APART_PART = 0.5, 0.5, 0.5
# They move alike if the distances between pairs of so many instants agree, to this fraction of the usual distance.
_INSTANTS, _ALIKE = 40, 0.3
# A frozen pose repeats itself this many times, and for this multiple of the usual time; a larger twist than this
# (rad/s, m/s) is not a constant error of a sensor.
_REPEATS, _MOVES = 10, 0.1
# A larger rotation between samples is ambiguous; rad.
FARTHEST = 0.5


@dataclass(frozen=True)
class Jump:
    """One jump.

    Attributes:
        turns: whether the attitude jumps; otherwise the position.
        start_ns: stamp of the sample before.
        end_ns: stamp of the sample after it.
        size: rad or m.
    """

    turns: bool
    start_ns: int
    end_ns: int
    size: float


@dataclass(frozen=True)
class Returns:
    """A pose that jumps away and back: whether in attitude, at which fraction of samples, how far (rad or m)."""

    turns: bool
    share: float
    size: float

    def __str__(self) -> str:
        """Return how often, how far and why, as text."""
        size = f"{np.rad2deg(self.size):.4g}°" if self.turns else f"{self.size:.4g} m"
        return (
            f"the {'attitude' if self.turns else 'position'} jumps away and back in {100.0 * self.share:.3g} % of the "
            f"samples, by {size} in the median: two bodies on one topic, or markers that are mistaken for one another"
        )


@dataclass(frozen=True)
class Other:
    """Another topic for the same frame in the same world that shows it at another place.

    Attributes:
        topic: as recorded.
        frame: of the body.
        angle: how far apart the two are in the median, rad.
        distance: likewise, m.
        alike: whether both make the same motion, as two estimates of one body do that differ by drift, noise or origin;
            so do two bodies that move together.
    """

    topic: str
    frame: str
    angle: float
    distance: float
    alike: bool


@dataclass(frozen=True)
class Continuity:
    """Result of `continuity`.

    Attributes:
        jumps: in order of time.
        turn: usual rotation between two samples of the pose, rad; from `FARTHEST` on, no rotation is called a jump.
        returns: how often the pose returns, if it shows two bodies alternately.
        others: topics that show the same frame at another place.
        frozen: first and last stamp of each interval in which no bit of the pose changes although the body moves.
        frozen_twist: of each in which no bit of the twist changes although the attitude turns otherwise.
    """

    jumps: tuple[Jump, ...]
    turn: float
    returns: Returns | None = None
    others: tuple[Other, ...] = ()
    frozen: tuple[tuple[int, int], ...] = ()
    frozen_twist: tuple[tuple[int, int], ...] = ()


def continuity(track: Track) -> Continuity | None:
    """Return the jumps of the pose; None for too few samples, and for a log of this package."""
    pose = track.pose
    if track.own or pose is None or len(pose.time_ns) <= 2 * _AROUND + 1:
        return None
    ends = np.array([[each(rows[:, :3], axis=0) for each in (np.min, np.max)] for rows in in_blocks(pose.values)])
    extent = float(np.linalg.norm(ends[:, 1].max(axis=0) - ends[:, 0].min(axis=0)))
    rounding = 100.0 * np.finfo(float).eps * float(np.abs(ends).max())
    turned = _changes(pose, turns=True)
    found = _jumps(track, pose.time_ns, turned, _LEAST_TURN, turns=True)
    turning = turned[turned > 0.0]
    turn = float(np.median(turning)) if len(turning) else 0.0
    del turned, turning
    placed = not np.isnan(extent)
    if placed:
        moved = _changes(pose, turns=False)
        found += _jumps(track, pose.time_ns, moved, max(_LEAST_PART * extent, rounding), turns=False)
        del moved
    # A body that makes half a turn between samples returns, too.
    slow = min(turn, _turn_by_rates(track.twist, pose)) < FARTHEST
    returns = _returns(pose, track.twist, turns=False) if placed and slow else None
    return Continuity(
        jumps=tuple(sorted(found, key=lambda jump: (jump.start_ns, not jump.turns))),
        turn=turn,
        returns=returns or _returns(pose, track.twist, turns=True),
        others=_others(track, extent if placed else 0.0),
        frozen=_frozen(track, found),
        frozen_twist=_frozen_twist(track.twist, pose),
    )


def jumps_told(jumps: Sequence[Jump], start_ns: int) -> str:
    """Return jumps as text, the largest in order of time, from `start_ns`."""
    largest = sorted(jumps, key=lambda jump: -jump.size)[:NAMED]
    each = [
        (f"attitude, by {np.rad2deg(jump.size):.4g}°" if jump.turns else f"position, by {jump.size:.4g} m")
        + f" within {(jump.end_ns - jump.start_ns) * 1e-9:.4g} s at t = {(jump.start_ns - start_ns) * 1e-9:.6g} s"
        for jump in jumps
        if jump in largest
    ]
    return listed(each[:NAMED], len(jumps))


def _turn_by_rates(twist: TimeSeries | None, pose: TimeSeries) -> float:
    """Return the usual rotation between two samples of a pose by the rates, rad; infinity where none are recorded.

    A second body on the topic turns the pose from sample to sample, but not the body whose rates these are.
    """
    rate = 0.0 if twist is None else _usual_rate(twist)
    return rate * float(np.median(np.diff(pose.time_ns))) * 1e-9 if rate else math.inf


def _usual_rate(twist: TimeSeries) -> float:
    """Return the usual rate, rad/s, of those that are not 0; 0 if there are none."""
    rates = np.concatenate([np.empty(0), *(np.linalg.norm(rows[:, 3:], axis=1) for rows in in_blocks(twist.values))])
    rates = rates[rates > 0.0]
    return float(np.median(rates)) if len(rates) else 0.0


def contradictions(series: TimeSeries, start_ns: int) -> str:
    """Return where a pose or twist has two samples of one stamp that differ, as text; "" if nowhere.

    Stamps of a coarse clock may be alike, too: such samples differ by no more than the motion to another stamp does.
    """
    twice = np.flatnonzero(np.diff(series.time_ns) == 0)
    if not len(twice):
        return ""
    first = np.flatnonzero(np.diff(series.time_ns, prepend=series.time_ns[0] - 1))
    after = np.minimum(np.searchsorted(first, twice, "right") - 1, max(len(first) - 2, 0))
    pose, found = series.values.shape[1] == 7, []
    names = (("position", "m"), ("attitude", "rad")) if pose else (("velocity", "m/s"), ("angular velocity", "rad/s"))
    for (name, unit), columns in zip(names, (slice(0, 3), slice(3, None)), strict=True):
        turns, rows = name == "attitude", series.values[:, columns]
        rows = unit_rows(rows) if turns else rows
        size = _apart(rows[twice + 1], rows[twice], turns=turns)
        moves = _apart(rows[first[1:]], rows[first[:-1]], turns=turns)
        usual = np.maximum(_around(moves), moves) if len(moves) else np.zeros(1)
        spread = float(np.median(np.abs(moves - usual))) if len(moves) else 0.0
        rounding = 100.0 * np.finfo(float).eps * float(np.nanmax(np.abs(rows), initial=0.0))
        beyond = size > _TIMES * usual[after] + _SPREADS * spread + rounding
        if beyond.any():
            at = (int(series.time_ns[twice[beyond][0]]) - start_ns) * 1e-9
            found.append(
                f"{name} jumps within 0 s, by up to {size[beyond].max():.4g} {unit}: {int(beyond.sum())} samples have "
                f"the stamp of one that they contradict, first at t = {at:.6g} s"
            )
    return "; ".join(found)


def overlaps(series: TimeSeries, start_ns: int) -> str:
    """Return where two runs of stamps overlap in a pose or twist, as of a clock that was set back; "" if nowhere.

    In a file that is sorted by these stamps, samples there come twice as often as usual, and jump to and fro.
    """
    shared = _OF_ROW + 1
    if len(series.time_ns) <= shared:
        return ""
    usual = float(np.median(series.time_ns[2:] - series.time_ns[:-2], overwrite_input=True))

    def dense(times: Times) -> NDArray[np.bool_]:
        return times[2:] - times[:-2] < _DENSE * usual

    if not any(len(_in_a_row(dense(times))) for times in in_blocks(series.time_ns, shared)):
        return ""
    columns = slice(0, 3), slice(3, None)
    turns = False, series.values.shape[1] == 7
    least = [smallest_change(series, part, turns=turn) for part, turn in zip(columns, turns, strict=True)]
    ends: list[int] = []
    for times, values in zip(in_blocks(series.time_ns, shared), in_blocks(series.values, shared), strict=True):
        jumps = np.zeros(len(times) - 2, dtype=bool)
        for part, turn, smallest in zip(columns, turns, least, strict=True):
            rows = unit_rows(values[:, part]) if turn else values[:, part]
            far, near = (_apart(rows[:-2], rows[k : k + len(jumps)], turns=turn) for k in (1, 2))
            jumps |= (far > _JUMPS * near) & (far > smallest)
        many = _in_a_row(dense(times) & jumps)
        ends += [int(times[k]) for k in (*many[:1], *(many[-1:] + shared))]
    if not ends:
        return ""
    begin, end = ((at - start_ns) * 1e-9 for at in (ends[0], ends[-1]))
    return (
        f"from t = {begin:.6g} to {end:.6g} s samples come twice as often as usual and jump to and fro: two runs in "
        "one file, or a clock that was set back"
    )


def _in_a_row(true: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return where `_OF_ROW` values in a row begin of which at least `_ROW` are true."""
    before = np.append(0, np.cumsum(true))
    return np.flatnonzero(before[_OF_ROW:] - before[:-_OF_ROW] >= _ROW)


def _changes(pose: TimeSeries, *, turns: bool) -> Array:
    """Return the rotation (rad) or the distance (m) from each sample to the next."""
    blocks = in_blocks(pose.values, 1)
    return np.concatenate(
        [
            np.linalg.norm(rotation_vectors(unit_rows(rows[:, 3:])) if turns else np.diff(rows[:, :3], axis=0), axis=1)
            for rows in blocks
        ]
    )


def _frozen(track: Track, jumps: Sequence[Jump]) -> tuple[tuple[int, int], ...]:
    """Return when the pose repeats itself although the body moves, as a jump at its end or the twist shows.

    A pose that is measured seldom also repeats itself, and so does that of a simulated body at rest.
    """
    pose, twist = track.pose, track.twist
    assert pose is not None
    after_jump = {jump.start_ns for jump in jumps}
    return tuple(
        (begin, end)
        for begin, end in (pose.time_ns[[first, last]].tolist() for first, last in _repeated(pose))
        if end in after_jump or _moved(twist, begin, end)
    )


def _frozen_twist(twist: TimeSeries | None, pose: TimeSeries) -> tuple[tuple[int, int], ...]:
    """Return when the twist repeats itself although the attitude turns otherwise, as that of a steady spin does not."""
    found = []
    for first, last in _repeated(twist) if twist is not None and len(twist.values) else []:
        assert twist is not None
        begin, end = twist.time_ns[[first, last]].tolist()
        a, b = np.searchsorted(pose.time_ns, begin), np.searchsorted(pose.time_ns, end, side="right") - 1
        if b - a < _REPEATS:
            continue
        seconds = float(pose.time_ns[b] - pose.time_ns[a]) * 1e-9
        told = product(unit_rows(pose.values[[a], 3:]), exponentials(seconds * twist.values[[first], 3:]))
        off = float(np.linalg.norm(rotations_between(told, unit_rows(pose.values[[b], 3:]))))
        if off > _MOVES * seconds:
            found.append((begin, end))
    return tuple(found)


def _repeated(series: TimeSeries) -> list[tuple[int, int]]:
    """Return the first and the last of samples that are the same to the last bit, for much longer than usual."""
    changed = [(np.diff(np.nan_to_num(rows), axis=0) != 0.0).any(axis=1) for rows in in_blocks(series.values, 1)]
    if not changed:
        return []
    ends = np.append(np.flatnonzero(np.concatenate(changed)), len(series.values) - 1)
    begins = np.append(0, ends[:-1] + 1)
    # Usually none: then memory for more is not needed.
    long = np.flatnonzero(ends - begins >= _REPEATS)
    if not len(long):
        return []
    usual = float(np.median(np.diff(series.time_ns[begins]))) if len(begins) > 1 else np.inf
    runs = np.stack([begins[long], ends[long]], axis=1)
    lengths = np.diff(series.time_ns[runs], axis=1)[:, 0]
    return [(first, last) for first, last in runs[lengths > _REPEATS * usual].tolist()]


def _moved(twist: TimeSeries | None, begin_ns: int, end_ns: int) -> bool:
    """Return whether a twist shows more motion, on average over a time, than the constant error of a sensor."""
    if twist is None:
        return False
    first, last = np.searchsorted(twist.time_ns, [begin_ns, end_ns])
    if last - first < _REPEATS:
        return False
    mean = np.nan_to_num(twist.values[first:last].mean(axis=0))
    return bool(max(np.linalg.norm(mean[:3]), np.linalg.norm(mean[3:])) > _MOVES)


def _apart(one: Array, other: Array, *, turns: bool) -> Array:
    """Return the distance between positions, or the angle between attitudes."""
    if not turns:
        distance: Array = np.linalg.norm(one - other, axis=1)
        return distance
    near = np.minimum(np.linalg.norm(one - other, axis=1), np.linalg.norm(one + other, axis=1))
    angle: Array = 4.0 * np.arcsin(np.minimum(0.5 * near, 1.0))
    return angle


def _returns(pose: TimeSeries, twist: TimeSeries | None, *, turns: bool) -> Returns | None:
    """Return how often, and from how far, a pose returns to one of its last places.

    None if this is rare, or if the twist or rounding explains it. Noise about one place makes at most 25 % of the
    samples return as closely, but most of those that are rounded to steps as large as the noise.
    """
    sizes, start = [np.empty(0)], pose.time_ns[0]
    smallest = smallest_change(pose, pose_columns(turns=turns), turns=turns)
    if known := twist is not None and len(twist.time_ns) > 0:
        part = slice(3, 6) if turns else slice(0, 3)
        rates = np.nan_to_num(sizes_of(twist.values[:, part]))
        at = (twist.time_ns - start).astype(np.float64)
    for time_ns, values in zip(in_blocks(pose.time_ns, _LAST), in_blocks(pose.values, _LAST), strict=True):
        rows = unit_rows(values[:, 3:]) if turns else values[:, :3]
        here = rows[_LAST:]
        moved = _apart(here, rows[_LAST - 1 : -1], turns=turns)
        back = np.min([_apart(here, rows[_LAST - k : -k], turns=turns) for k in range(2, _LAST + 1)], axis=0)
        least = np.full(len(moved), smallest)
        if known:
            told = np.interp(time_ns[_LAST:] - start, at, rates)
            least = np.maximum(least, _TIMES * told * np.diff(time_ns)[_LAST - 1 :] * 1e-9)
        sizes.append(moved[(moved > least) & (back < _NEAR * moved)])
    returned = np.concatenate(sizes)
    share = len(returned) / max(len(pose.time_ns) - _LAST, 1)
    return Returns(turns, share, float(np.median(returned))) if share > _RETURNS else None


def pose_columns(*, turns: bool) -> slice:
    """Return the columns of the attitude of a pose, or of its position."""
    return slice(3, 7) if turns else slice(0, 3)


def smallest_change(series: TimeSeries, columns: slice, *, turns: bool) -> float:
    """Return the smallest distance, or angle between attitudes, that is more than rounding."""
    # A turn is twice the change of the quaternion.
    rounded = (2.0 if turns else 1.0) * _step(series, columns)
    return max(min(_STEPS * rounded, _ROUNDED), _LEAST_TURN if turns else 0.0)


def _step(pose: TimeSeries, columns: slice) -> float:
    """Return the smallest change of a number to one of the next two samples: of rounded numbers, the step.

    The second next, as bodies may alternate. What the last digits of a calculation change is the least.
    """
    rounding = (
        100.0
        * np.finfo(float).eps
        * max((float(np.abs(rows[:, columns]).max(initial=0.0)) for rows in in_blocks(pose.values)), default=0.0)
    )
    found = math.inf
    for rows in in_blocks(pose.values[:, columns], 2):
        for changed in (np.abs(np.diff(rows, axis=0)), np.abs(rows[2:] - rows[:-2])):
            found = min(found, float(changed.min(initial=math.inf, where=changed > rounding)))
    return found if math.isfinite(found) else rounding


def _others(track: Track, extent: float) -> tuple[Other, ...]:
    """Return the topics of Odometry that describe the frame of the pose, far from it."""
    pose, twist, bag = track.pose, track.twist, track.bag
    if pose is None or twist is None or not twist.frame:
        return ()
    found, rate = [], _usual_rate(twist)
    for topic in bag.topics.values():
        if topic.type_name != ODOMETRY or not topic.count or topic.name in track.uses:
            continue
        if topic.kinds[0][0] != (pose.frame, twist.frame):
            continue
        time_ns, rows = bag.poses(topic.name)
        within = (time_ns >= pose.time_ns[0]) & (time_ns <= pose.time_ns[-1]) & (np.abs(rows) < LARGEST).all(axis=1)
        if not within.any():
            continue
        order = np.flatnonzero(within)[np.argsort(time_ns[within], kind="stable")]
        theirs = time_ns[order]
        ours = np.flatnonzero((pose.time_ns >= theirs[0]) & (pose.time_ns <= theirs[-1]))
        # Each sample of the one that has fewer, beside the nearest of the other.
        if 0 < len(ours) < len(order):
            at, beside_it = ours, order[_nearest(theirs, pose.time_ns[ours])]
        else:
            at, beside_it = _nearest(pose.time_ns, theirs), order
        here, beside = pose.values[at], rows[beside_it]
        distance = float(np.median(_apart(here[:, :3], beside[:, :3], turns=False)))
        angle = float(np.median(_apart(unit_rows(here[:, 3:]), unit_rows(beside[:, 3:]), turns=True)))
        # One body turns, too, from the sample of the one topic to that of the other.
        turned = rate * 1e-9 * float(np.median(np.abs(pose.time_ns[at] - time_ns[beside_it])))
        if angle > _APART_TURN + turned or distance > max(_APART, _APART_PART * extent):
            found.append(Other(topic.name, twist.frame, angle, distance, _alike(here, beside)))
    return tuple(found)


def _nearest(time_ns: Times, at_ns: Times) -> Any:
    """Return the indices of the times, ascending, that are nearest to others."""
    after = np.minimum(np.searchsorted(time_ns, at_ns), len(time_ns) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(at_ns - time_ns[before] < time_ns[after] - at_ns, before, after)


def _alike(one: Array, other: Array) -> bool:
    """Return whether two poses at the same times make the same motion, up to a constant offset.

    Moving positions or turning attitudes show it. If neither changes, nothing distinguishes two bodies.
    """
    at = np.unique(np.linspace(0, len(one) - 1, _INSTANTS).astype(int))
    i, j = np.triu_indices(len(at), 1)
    told = []
    for part, turns, least in ((slice(0, 3), False, 0.0), (slice(3, 7), True, _LEAST_TURN)):
        rows = [unit_rows(each[at, part]) if turns else each[at, part] for each in (one, other)]
        went, goes = (_apart(each[i], each[j], turns=turns) for each in rows)
        usual = max((float(np.median(each)) for each in (went, goes)), default=0.0) if len(i) else 0.0
        if usual > least:
            told.append(float(np.median(np.abs(went - goes))) <= _ALIKE * usual)
    return any(told) or not told


def _jumps(track: Track, time_ns: Times, size: Array, least: float, *, turns: bool) -> list[Jump]:
    apart = np.diff(time_ns)
    # A gap is reported elsewhere. A pose that repeats the last measurement does not move in between.
    at = np.flatnonzero((size > 0.0) & (apart <= longest_usual(time_ns)))
    if not len(at):
        return []
    since = np.diff(time_ns[at + 1]).astype(np.float64)
    usual = float(np.median(since)) if len(since) else float(apart[at[0]])
    since = np.clip(np.insert(since, 0, usual), 0.2 * usual, np.maximum(5.0 * usual, apart[at]))
    # Moves at equal times take a nanosecond, to keep the speed finite.
    since = np.maximum(since, 1.0) * 1e-9
    gone = size[at]
    expected = np.maximum(_around(gone / since) * since, _around(gone))
    # What goes there and back is not usual, though nothing else may move.
    back = _there_and_back(track.pose, at, gone, turns=turns)
    expected[back] = 0.0
    # If a pose moves only once, or there and back, its usual variation is not known.
    usually = np.abs(gone - expected)[~back]
    spread = float(np.median(usually)) if len(usually) > 2 else 0.0
    beyond = gone > np.maximum(_TIMES * expected + _SPREADS * spread, least)
    # A motion at the first or last samples may continue outside.
    beyond &= (at >= _AROUND) & (at < len(size) - _AROUND)
    if turns:
        beyond &= expected < FARTHEST
    found = [Jump(turns, int(time_ns[k]), int(time_ns[k + 1]), float(size[k])) for k in at[beyond]]
    return [jump for jump in found if not _explained(track, jump)]


def _there_and_back(pose: TimeSeries | None, at: NDArray[np.intp], gone: Array, *, turns: bool) -> NDArray[np.bool_]:
    """Return which changes, of the sizes `gone` after the samples `at`, take a pose at rest away and back.

    Both happen within a few samples, and by more than rounding.
    """
    first = np.flatnonzero(np.append(True, np.diff(at) > _REPEATS))
    last = np.append(first[1:], len(at)) - 1
    found = (last > first) & (at[last] - at[first] <= _AROUND)
    if pose is None or not found.any():
        return np.zeros(len(at), dtype=bool)
    columns = pose_columns(turns=turns)
    found &= (at[first] >= _REPEATS) & (at[last] < len(pose.values) - 1 - _REPEATS)
    found &= gone[first] > smallest_change(pose, columns, turns=turns)
    ends = [pose.values[rows, columns] for rows in (at[first], at[last] + 1)]
    before, after = (unit_rows(rows) for rows in ends) if turns else ends
    found &= _apart(before, after, turns=turns) < _NEAR * gone[first]
    return np.repeat(found, last - first + 1)


def _around(rates: Array) -> Array:
    """Return for each the larger of the medians of its neighbours before and after; 0 if there are none."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(rates, _AROUND, constant_values=np.nan), _AROUND)
    middle = np.zeros(len(windows))
    for part in parts(len(windows)):
        some = np.isfinite(windows[part]).any(axis=1)
        middle[part][some] = np.nanmedian(windows[part][some], axis=1)
    result: Array = np.maximum(middle[: len(rates)], middle[_AROUND + 1 :])
    return result


def _explained(track: Track, jump: Jump) -> bool:
    """Return whether somebody moved the body, twist or wrench explains it, or the twist makes attitudes ambiguous."""
    if ((track.moved_ns >= jump.start_ns) & (track.moved_ns < jump.end_ns)).any():
        return True
    length = jump.end_ns - jump.start_ns
    around, told = [jump.start_ns - length, jump.end_ns + length + 1], 0.0
    if track.twist is not None:
        begin, end = np.searchsorted(track.twist.time_ns, around)
        rates = track.twist.values[begin:end, 3:] if jump.turns else track.twist.values[begin:end, :3]
        told = float(np.linalg.norm(rates, axis=1).max(initial=0.0)) * length * 1e-9
    # What one interval of the largest wrench sets in motion.
    body = track.body
    least = 0.0 if body is None else min(body.principal_moments) if jump.turns else body.mass
    for each in (wrench.accepted() for wrench in track.wrenches if least):
        begin, end = np.searchsorted(each.time_ns, around)
        acting = (each.torque if jump.turns else each.force)[max(begin - 1, 0) : end]
        told += float(np.linalg.norm(acting, axis=1).max(initial=0.0)) / least * (length * 1e-9) ** 2
    return jump.size <= _TIMES * told or (jump.turns and told > 0.5 * np.pi)
