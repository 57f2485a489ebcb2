"""`Signal`: one quantity of a motion over time, and its values between the samples, but never across a gap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.gaps import longest_usual
from rb_dynamics.analysis.track import Array, Times, TimeSeries, Track, filled_in, unit_rows
from rb_dynamics.numerics.rotation_arrays import (
    exponentials,
    product,
    rotate_all,
    rotate_all_inverse,
    rotations_between,
)

Mask = NDArray[np.bool_]

# A sample is an outlier if it is this many times the usual step of the samples about it away from all but two of its
# neighbours on either side.
_FAR, _NEIGHBOURS, _STEPS = 5.0, 3, 7
# A sample that is missed by so many times what is usual is beside a change of the slope.
_KINK = 8.0


@dataclass(frozen=True)
class Signal:
    """Rows over time.

    Attributes:
        time_ns: ascending, each time once.
        values: (n, 3) vectors, or (n, 4) unit quaternions xyzw.
        broken: (n - 1,), whether the interval that begins at a sample is a gap.
        again_ns: times of further rows that contradict the one of their time.
        again: these rows.
    """

    time_ns: Times
    values: Array
    broken: Mask
    again_ns: Times = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    again: Array = field(default_factory=lambda: np.empty((0, 0)))

    @classmethod
    def of(
        cls, time_ns: Times, values: Array, missing: Sequence[tuple[int, int]] = (), moved_ns: Sequence[int] = ()
    ) -> Signal:
        """Return a signal of rows, of which the first counts where several have one time.

        Pieces that are `missing` of a recording (first and last ns) are gaps however short they are. Further rows of a
        time at which the body was moved (`moved_ns`) are from after the move, and left out.
        """
        times, first, place = np.unique(time_ns, return_index=True, return_inverse=True)
        other = np.flatnonzero((values != values[first[place.reshape(-1)]]).any(axis=1))
        other = other[~np.isin(time_ns[other], moved_ns)]
        broken = np.diff(times) > longest_usual(times)
        for begin, end in missing:
            broken |= (times[:-1] < end) & (times[1:] > begin)
        return cls(times, values[first], broken, time_ns[other], values[other])

    @property
    def turns(self) -> bool:
        """Whether the rows are attitudes."""
        return bool(self.values.shape[1] == 4)

    def within(self, begin_ns: float, end_ns: float) -> Signal:
        """Return the samples from `begin_ns` to `end_ns`, both included."""
        first = int(self.time_ns.searchsorted(begin_ns))
        last = max(first, int(self.time_ns.searchsorted(end_ns, "right")))
        broken, again = (
            self.broken[first : max(first, last - 1)],
            (self.again_ns >= begin_ns) & (self.again_ns <= end_ns),
        )
        return Signal(
            self.time_ns[first:last], self.values[first:last], broken, self.again_ns[again], self.again[again]
        )

    def later(self, by_ns: int) -> Signal:
        """Return the same with all times moved."""
        return Signal(self.time_ns + by_ns, self.values, self.broken, self.again_ns + by_ns, self.again)

    def without_outliers(self) -> Signal:
        """Return the samples without those, alone or up to three in a row, that go far away and come back."""
        count = len(self.time_ns)
        if count <= 2 * _NEIGHBOURS:
            return self
        apart = np.full((count, 2 * _NEIGHBOURS), np.inf)
        for k in range(1, _NEIGHBOURS + 1):
            apart[k:, 2 * k - 2] = apart[:-k, 2 * k - 1] = np.linalg.norm(
                differences(self.values[:-k], self.values[k:]), axis=1
            )
        steps = np.pad(apart[1:, 0], _STEPS, mode="reflect")
        about = np.lib.stride_tricks.sliding_window_view(steps, 2 * _STEPS)
        # As many steps may lead to outliers.
        usual = np.partition(about, 10, axis=1)[:, 10]
        kept = np.partition(apart, 2, axis=1)[:, 2] <= _FAR * usual
        if kept.all():
            return self
        first = np.flatnonzero(kept)
        lost = np.concatenate([[0], np.cumsum(self.broken)])
        return Signal(self.time_ns[kept], self.values[kept], np.diff(lost[first]) > 0)

    def at(self, time_ns: Times) -> tuple[Array, Mask]:
        """Return the values at `time_ns`, and where they are known: at samples, and between two without a gap.

        Vectors are interpolated linearly; attitudes turn at a constant rate, on the rotation group. NaN if unknown.
        """
        values = np.full((len(time_ns), self.values.shape[1]), np.nan)
        if not len(self.time_ns):
            return values, np.zeros(len(time_ns), dtype=bool)
        before = self.time_ns.searchsorted(time_ns, "right") - 1
        known = (before >= 0) & (self.time_ns[np.maximum(before, 0)] == time_ns)
        values[known] = self.values[before[known]]
        inside = np.flatnonzero((before >= 0) & (before + 1 < len(self.time_ns)) & ~known)
        inside = inside[~self.broken[before[inside]]]
        lower = before[inside]
        length = self.time_ns[lower + 1] - self.time_ns[lower]
        share = ((time_ns[inside] - self.time_ns[lower]) / length)[:, None]
        values[inside] = self._between(self.values[lower], self.values[lower + 1], share)
        known[inside] = True
        return values, known

    def holes(self) -> list[tuple[int, int]]:
        """Return first and last time (ns) of each gap."""
        return [(int(self.time_ns[k]), int(self.time_ns[k + 1])) for k in np.flatnonzero(self.broken)]

    def interpolation_error(self) -> float:
        """Return about the largest error of a value between two samples: each is predicted from its neighbours.

        A sample is missed by x'' h^2 / 2, the middle between two by a quarter of that; by as much where the slope
        changes at once, which shows as a few samples missed by far more than the others. Noise counts as error.
        """
        if len(self.time_ns) < 3:
            return 0.0
        near = ~(self.broken[:-1] | self.broken[1:])
        apart = np.diff(self.time_ns).astype(np.float64)
        left, right = apart[:-1][near], apart[1:][near]
        guessed = self._between(self.values[:-2][near], self.values[2:][near], (left / (left + right))[:, None])
        missed = np.linalg.norm(differences(self.values[1:-1][near], guessed), axis=1)
        missed *= np.maximum(left, right) / np.minimum(left, right)
        if not len(missed):
            return 0.0
        return float(np.where(missed > _KINK * np.median(missed), missed, 0.25 * missed).max())

    def _between(self, first: Array, second: Array, share: Array) -> Array:
        if not self.turns:
            return first + share * (second - first)
        return product(first, exponentials(share * rotations_between(first, second)))


def differences(first: Array, second: Array) -> Array:
    """Return `second` minus `first`; of attitudes the rotation from one to the other (rad, body axes)."""
    return rotations_between(first, second) if first.shape[1] == 4 else second - first


@dataclass(frozen=True)
class MotionSignals:
    """The motion of a track; None for what it does not contain.

    Attributes:
        attitude: body to world.
        position: of the body origin, m, world axes.
        rate: angular velocity, rad/s, body axes.
        velocity_world: of the body origin, m/s.
        velocity_body: the same in body axes.
    """

    attitude: Signal | None = None
    position: Signal | None = None
    rate: Signal | None = None
    velocity_world: Signal | None = None
    velocity_body: Signal | None = None

    @classmethod
    def of(cls, track: Track, moved_ns: Sequence[int] = ()) -> MotionSignals:
        """Return the motion of `track`; columns that nothing measures are NaN in it. For `moved_ns` see `Signal.of`."""
        pose, twist, missing = track.pose, track.twist, track.missing

        def measured(series: TimeSeries | None, columns: slice) -> Signal | None:
            if series is None or not len(series.time_ns) or np.isnan(series.values[:, columns]).any():
                return None
            return Signal.of(series.time_ns, series.values[:, columns], missing, moved_ns)

        position, attitude = measured(pose, slice(0, 3)), None
        if pose is not None:
            filled = filled_in(pose.values[:, 3:])
            if filled.any():
                attitude = Signal.of(pose.time_ns[filled], unit_rows(pose.values[filled, 3:]), missing, moved_ns)
        linear, angular = measured(twist, slice(0, 3)), measured(twist, slice(3, 6))
        if track.twist_in_world:
            turned = [_turned(vectors, attitude, rotate_all_inverse) for vectors in (angular, linear)]
            return cls(attitude, position, turned[0], linear, turned[1])
        return cls(attitude, position, angular, _turned(linear, attitude, rotate_all), linear)

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last time at which anything is known."""
        times = [signal.time_ns for signal in vars(self).values() if signal is not None and len(signal.time_ns)]
        return (int(min(t[0] for t in times)), int(max(t[-1] for t in times))) if times else (0, 0)

    @property
    def interval_ns(self) -> float:
        """The usual interval between two samples, of the quantity in which it is longest."""
        steps = [np.diff(signal.time_ns) for signal in vars(self).values() if signal is not None]
        return max((float(np.median(step)) for step in steps if len(step)), default=0.0)

    def later(self, by_ns: int) -> MotionSignals:
        """Return the same with all times moved."""
        return MotionSignals(*(signal and signal.later(by_ns) for signal in vars(self).values()))

    def within(self, begin_ns: float, end_ns: float) -> MotionSignals:
        """Return the samples from `begin_ns` to `end_ns`, both included."""
        return MotionSignals(*(signal and signal.within(begin_ns, end_ns) for signal in vars(self).values()))

    def without_outliers(self) -> MotionSignals:
        """Return the samples of each quantity without those that go far away and come back."""
        return MotionSignals(*(signal and signal.without_outliers() for signal in vars(self).values()))


def _turned(vectors: Signal | None, attitude: Signal | None, turn: Callable[[Array, Array], Array]) -> Signal | None:
    """Return vectors in other axes, at those of their times at which the attitude is known."""
    if vectors is None or attitude is None:
        return None
    orientation, known = attitude.at(vectors.time_ns)
    if not known.any():
        return None
    times, first = vectors.time_ns[known], np.flatnonzero(known)
    broken = np.diff(first) > 1
    broken |= vectors.broken[first[:-1]]
    return Signal(times, turn(orientation[known], vectors.values[known]), broken)
