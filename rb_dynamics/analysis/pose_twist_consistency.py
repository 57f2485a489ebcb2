"""Whether pose and twist agree: the integral of the twist against the change of the pose.

Over windows of a second or more, the integral of the angular velocity in world axes is compared with the change of the
attitude, and that of the velocity with the change of the position. If they contradict each other, other axes, the
opposite sign, other units and quaternions are tried as explanations. A lag, a factor and turned axes are estimated
(`twist_calibration.py`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.continuity import pose_columns, smallest_change
from rb_dynamics.analysis.gaps import longest_usual
from rb_dynamics.analysis.noise import noise_of_path, typical_at
from rb_dynamics.analysis.track import Array, Times, TimeSeries, Track, filled_in, in_blocks, parts, sizes_of, unit_rows
from rb_dynamics.analysis.twist_calibration import TwistFit, fit_of_twist
from rb_dynamics.numerics.growing_array import give_back, stored
from rb_dynamics.numerics.rotation_arrays import rotate_all, rotate_all_inverse, rotation_vectors

# A difference larger than this fraction of either change is a contradiction.
_CONTRADICTS = 0.3
# Another interpretation explains it if it leaves no more than this fraction.
_RECONCILED = 0.1
# Smaller differences may be sensor errors, such as the constant error of gyros: rad/s and m/s.
_SENSORS = 0.05
# A window counts if it turns by at least this (rad), and by this multiple of the noise.
_LEAST_TURN, _ABOVE_NOISE = 0.05, 10.0
_LEAST_WINDOWS = 3
# In a window they also contradict each other beyond this fraction, and this multiple of that in a quarter of them.
_PART, _ABOVE_USUAL = 0.1, 20.0
_SECOND = 1_000_000_000
# A recording that is too short for windows of a second is judged by shorter ones.
_SHORTER = _SECOND // 10
# A lever arm of so many standard errors counts if it leaves at most this part of the difference; and how much less than
# about its other axes a body turns about one that tells nothing of it.
_SIGNIFICANT, _BETTER, _SEEN = 8.0, 0.5, 1e-3
# Larger rotations between samples do not determine how the body rotated; rad.
_FARTHEST, _AROUND = 1.0, 2.0
# An attitude leaps if that many intervals turn so far, all together by this multiple of what the rates say at most.
_OFTEN, _TIMES = 0.1, 3.0
# What interpolation may explain of a difference, of its change with every second sample left out: a third to leading
# order, and more for large rotations between samples.
_OF_HALVED = 0.5
# So many times its own noise, the integral of the twist may be off.
_NOISES = 3.0
RARE = "as interpolation between samples as rare or as noisy as these may"


_AS_IS = (1, 2, 3)
_DEGREE, _MILLIMETRE = np.pi / 180.0, 1e-3
# What programs write for x, y, z, w of body to world: from 1 on, with sign.
_QUATERNIONS = {
    "": (1, 2, 3, 4),
    "with attitudes from world to body": (-1, -2, -3, 4),
    "with (w, x, y, z) for the (x, y, z, w) of attitudes": (2, 3, 4, 1),
    "with (w, x, y, z) for the (x, y, z, w) of attitudes from world to body": (-2, -3, -4, 1),
}


def _other_axes() -> list[tuple[int, ...]]:
    """Return signed orders of axes that programs take for each other: one sign, or a rotation by quarter turns."""
    signed = [
        tuple(s * a for s, a in zip(signs, order, strict=True))
        for order in itertools.permutations(_AS_IS)
        for signs in itertools.product((1, -1), repeat=3)
    ]
    one_sign = [axes for axes in signed if tuple(map(abs, axes)) == _AS_IS and sum(axis < 0 for axis in axes) == 1]
    turns = [a for a in signed if np.linalg.det(np.sign(a)[:, None] * np.eye(3)[np.abs(a) - 1]) > 0.0 and a != _AS_IS]
    return one_sign + turns


@dataclass(frozen=True)
class TwistReading:
    """An interpretation of a twist: its frame, a factor, and which of its numbers are x, y, z, from 1 on, with sign.

    `attitude`, a key of `_QUATERNIONS`, is that of the attitudes beside it.
    """

    world: bool
    factor: float
    axes: tuple[int, ...] = _AS_IS
    attitude: str = ""

    def words(self, given: TwistReading) -> str:
        """Return the difference from the `given` interpretation, as text."""
        parts = [f"in {'world' if self.world else 'body'} axes"] if self.world != given.world else []
        parts += ["with the opposite sign"] if self.factor < 0.0 else []
        parts += ["in degrees per second"] if abs(self.factor) == _DEGREE else []
        parts += ["multiplied by 180/π, as if converted twice"] if self.factor == 1.0 / _DEGREE else []
        parts += ["in millimetres per second"] if self.factor == _MILLIMETRE else []
        parts += ["with positions in millimetres"] if self.factor == 1.0 / _MILLIMETRE else []
        parts += [self.attitude] if self.attitude else []
        if self.axes != _AS_IS:
            named = ["-" * (axis < 0) + "xyz"[abs(axis) - 1] for axis in self.axes]
            parts.append(f"with ({', '.join(named)}) for its (x, y, z)")
        return " and ".join(parts)


class Leaps(NamedTuple):
    """Of an attitude that leaps from sample to sample: in which fraction of them, and by how much in the median.

    Attributes:
        share: fraction of the samples.
        turned: median, rad.
        told: how far the rates turn the body meanwhile, median, rad.
    """

    share: float
    turned: float
    told: float

    def __str__(self) -> str:
        """Return it as text."""
        return (
            f"the attitude leaps in {100.0 * self.share:.3g} % of the samples, by {self.turned:.3g} rad in the median, "
            f"while the angular velocity turns the body by {self.told:.2g} rad"
        )


@dataclass(frozen=True)
class Agreement:
    """How well twist and pose agree.

    Attributes:
        of: "attitude" or "position".
        error: median difference over a window, relative to the larger change; None if unknown.
        window_s: length of a window.
        windows: number compared.
        contradicts: whether at least one of the two must be wrong.
        remedy: interpretation of the twist with which they agree, "" if none was found.
        remaining: `error` with it.
        nothing: whether the twist is always zero.
        reason: why `error` is unknown, "" if it is known.
        partly: fraction of the windows that contradict each other, if that of the median does not; 0 for a single one.
        aligned: lag, factor and turn of the twist relative to the pose.
        odd: whether they contradict each other in any window, be it a single one.
        when_ns: first and last time of the windows, as far as they follow each other, in which they do so `partly`.
        arm: of the position that of the pose lies from that of the twist, m, body axes; None where that is not seen.
        arm_error: its standard error, m.
        rare: whether interpolation between samples may explain a large `error`.
        leaps: of the attitude; None of a motion.
        speed: median difference per s that interpolation does not explain, rad/s or m/s; of what `contradicts`.
    """

    of: str
    error: float | None
    window_s: float = 0.0
    windows: int = 0
    contradicts: bool = False
    remedy: str = ""
    remaining: float = 0.0
    nothing: bool = False
    reason: str = ""
    partly: float = 0.0
    aligned: TwistFit = TwistFit()
    odd: bool = False
    when_ns: tuple[tuple[int, int], ...] = ()
    arm: tuple[float, float, float] | None = None
    arm_error: float = 0.0
    rare: bool = False
    leaps: Leaps | None = None
    speed: float = 0.0

    @property
    def words(self) -> str:
        """What makes them agree, with standard errors; "" if nothing is significant."""
        if self.arm is None:
            return self.aligned.words
        point = ", ".join(f"{each:.4g}" for each in self.arm)
        return f"the pose is of a point ({point}) ± {self.arm_error:.2g} m, in body axes, from that of the twist"

    @property
    def doubt(self) -> str:
        """Why a torque must not be concluded from the twist; "" if nothing speaks against it."""
        return self.aligned.words or ("pose and twist contradict each other for a moment" if self.odd else "")


def agreements(track: Track) -> tuple[Agreement, ...]:
    """Return how attitude and position agree with the twist.

    Empty if pose or twist is absent, and for a log of this package, whose pose and twist come from one state.
    """
    if track.own or track.pose is None or track.twist is None:
        return ()
    return agreements_of(track.pose, track.twist, track.twist_in_world)


def agreements_of(pose: TimeSeries, twist: TimeSeries, twist_in_world: bool) -> tuple[Agreement, ...]:
    """Return how attitude and position of a pose agree with a twist; NaN: not measured. Empty for too few samples."""
    pose, twist = pose.once, twist.once
    if len(pose.time_ns) < 2 or len(twist.time_ns) < 2:
        return ()
    pose = _without_blanks(pose)
    both = _Both.of(pose, twist)
    if both is None:
        apart = pose.time_ns[0] > twist.time_ns[-1] or twist.time_ns[0] > pose.time_ns[-1]
        reason = f"{pose.topic} and {twist.topic} {'are not' if apart else 'have too few samples'} of the same time"
        return Agreement("attitude", None, reason=reason), Agreement("position", None, reason=reason)
    if leaping := _leaping(both):
        return leaping, Agreement("position", None, reason="the attitude leaps")
    given = TwistReading(twist_in_world, 1.0)
    turns = [TwistReading(w, f) for f in (1.0, -1.0, _DEGREE, 1.0 / _DEGREE) for w in (given.world, not given.world)]
    # Other axes with the opposite sign look the same as inverted attitudes, which are what occurs in practice.
    turns.remove(TwistReading(not given.world, -1.0))
    turns += [replace(given, attitude=attitude) for attitude in _QUATERNIONS if attitude]
    lengths = (1.0, -1.0, _MILLIMETRE, 1.0 / _MILLIMETRE)
    moves = [TwistReading(w, f) for f in lengths for w in (given.world, not given.world)]
    far = float((sizes_of(both.twist[:, 3:]) > _AROUND).mean()) > 0.5
    if float((sizes_of(both.turned) > _FARTHEST).mean()) > 0.5:
        reason = f"between two poses the body turns by more than {_FARTHEST:g} rad"
        return Agreement("attitude", None, reason=reason), Agreement("position", None, reason=reason)
    attitude = _with_alignment(_judged("attitude", both, turns), both, pose, twist, turns)
    if far and attitude.error is not None and not attitude.remedy:
        attitude = Agreement("attitude", None, reason=f"between two poses the twist turns by more than {_AROUND:g} rad")
    lacking = (series.topic for series in (pose, twist) if _lacks_position(series))
    if lacks := next(lacking, ""):
        return attitude, Agreement("position", None, reason=f"{lacks} does not measure it")
    position = _with_alignment(_judged("position", both, moves), both, pose, twist, moves)
    return attitude, _with_arm(position, both, pose, twist, moves)


def _without_blanks(pose: TimeSeries) -> TimeSeries:
    """Return the pose without samples whose quaternion was not filled in, unless that is so of all."""
    filled = filled_in(pose.values[:, 3:])
    if filled.all() or not filled.any():
        return pose
    return replace(pose, time_ns=pose.time_ns[filled], values=pose.values[filled])


def _leaping(both: _Both) -> Agreement | None:
    """Return the contradiction if the attitude turns between samples by far more than the rates can; None if not.

    Between two attitudes lies the shortest rotation of all that lead from one to the other.
    """
    turned, start, twist = sizes_of(both.turned), both.time_ns[0], both.series[1]
    wide = turned > _FARTHEST
    if float(wide.mean()) <= _OFTEN:
        return None
    rates = np.interp(both.time_ns - start, twist.time_ns - start, sizes_of(twist.values[:, 3:]))
    told = np.maximum(rates[1:], rates[:-1]) * np.diff(both.time_ns) * 1e-9
    turned, told = turned[wide], told[wide]
    if float(turned.sum()) <= _TIMES * float(told.sum()):
        return None
    return Agreement(
        "attitude",
        float(np.median(np.maximum(1.0 - told / turned, 0.0))),
        float(np.median(np.diff(both.time_ns)[wide])) * 1e-9,
        len(turned),
        contradicts=True,
        leaps=Leaps(float(wide.mean()), float(np.median(turned)), float(np.median(told))),
    )


def _with_arm(
    found: Agreement, both: _Both, pose: TimeSeries, twist: TimeSeries, readings: list[TwistReading]
) -> Agreement:
    """Return the agreement with the point of which the pose is, if that explains the difference better.

    The velocity of such a point has a part that turns with the body: of a marker it looks like turned axes.
    """
    if found.error is None or found.nothing or found.remedy:
        return found
    (x, y, z), error = _lever_arm(both, readings[0])
    arm = float(np.hypot(np.hypot(x, y), z))
    if arm <= _SIGNIFICANT * error:
        return found
    rare = both.halved()
    changed = (
        np.inf if rare is None else float(np.linalg.norm(np.subtract(_lever_arm(rare, readings[0])[0], (x, y, z))))
    )
    if arm <= _OF_HALVED * changed:
        return found
    error = float(np.hypot(error, _OF_HALVED * changed))
    at_origin = replace(
        both,
        pose=stored(
            (np.hstack([rows[:, :3] - _turned((x, y, z), rows[:, 3:]), rows[:, 3:]]) for rows in in_blocks(both.pose)),
            7,
        ),
    )
    rest = _with_alignment(_judged("position", at_origin, readings), at_origin, pose, twist, readings)
    if rest.error is None or rest.error > _BETTER * found.error or rest.aligned.words:
        return found
    contradicts = found.error > _CONTRADICTS
    return replace(rest, error=found.error, contradicts=contradicts or rest.contradicts, arm=(x, y, z), arm_error=error)


def _turned(vector: Sequence[float] | Array, attitude: Array) -> Array:
    return rotate_all(unit_rows(attitude), np.tile(np.array(vector), (len(attitude), 1)))


def _lever_arm(both: _Both, given: TwistReading) -> tuple[tuple[float, float, float], float]:
    """Return where the pose is from the origin of the twist, and the standard error: m, body axes.

    Over a window the position changes by the integral of the velocity of the origin and by the change of R r.
    """
    sums = [np.empty((0, 12))]
    for part in both.rows():
        judged = both.stretch[part] >= 0
        if judged.any():
            ends = slice(part.start, part.stop + 1)
            times, attitude = both.time_ns[ends], both.pose[ends, 3:]
            turns = np.stack([np.diff(_turned(axis, attitude), axis=0) for axis in np.eye(3)], axis=2)
            left = both.changes("position", part) - both.said(slice(0, 3), given, part)
            window, stretch = ((times[:-1] - both.time_ns[0]) // _SECOND)[judged], both.stretch[part][judged]
            begins = np.flatnonzero(np.append(True, (np.diff(window) != 0) | (np.diff(stretch) != 0)))
            sums.append(np.add.reduceat(np.hstack([turns.reshape(-1, 9), left])[judged], begins, axis=0))
    every = np.concatenate(sums)
    turns, left = every[:, :9].reshape(-1, 3), every[:, 9:].ravel()
    inverse = np.linalg.pinv(turns, rcond=_SEEN)
    x, y, z = (inverse @ left).tolist()
    rest = left - turns @ (inverse @ left)
    return (x, y, z), float(np.linalg.norm(inverse) * np.linalg.norm(rest) / np.sqrt(max(1, len(left) - 3)))


def _with_alignment(
    found: Agreement, both: _Both, pose: TimeSeries, twist: TimeSeries, readings: list[TwistReading]
) -> Agreement:
    """Return the agreement with the misalignment of the twist, and judged again without it."""
    if found.nothing or found.remedy:
        return found
    given, part = readings[0], slice(3, 6) if found.of == "attitude" else slice(0, 3)
    rows, said = both.increments(found.of, given.world, twist), twist.values[:, part]
    apart = (float(np.median(np.diff(each))) for each in (twist.time_ns, both.time_ns))
    turn = float(np.median(sizes_of(both.turned))) * max(1.0, next(apart) / next(apart))
    aligned = fit_of_twist(both.time_ns, rows, twist.time_ns, said, turn)
    if not aligned.words:
        return found
    without = _Both.of(pose, aligned.corrected(twist))
    rest = found if without is None else _judged(found.of, without, readings)
    if found.error is None or rest.error is None:
        return replace(found, aligned=aligned)
    # A difference in a part of the recording only has no single lag and factor.
    if found.partly and rest.error > _CONTRADICTS * found.error:
        return found
    return replace(
        found, aligned=aligned, contradicts=found.contradicts or aligned.large, partly=rest.partly, when_ns=rest.when_ns
    )


class _Found(NamedTuple):
    """Median relative error, number and length (s) of windows, fraction that contradict.

    `sure` and `speed` are medians, relative and per second, of what interpolation between samples does not explain,
    `odd` is whether any is far from the best, `when_ns` are first and last times of those that contradict.
    """

    error: float
    sure: float
    speed: float
    windows: int
    window_s: float
    beyond: float
    odd: bool
    when_ns: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class _Both:
    """Pose, and the integral of the twist over each of its intervals.

    Attributes:
        time_ns: (n,).
        pose: (n, 7), quaternions of unit length.
        twist: (n - 1, 6), integral of the twist over each interval, in its own axes.
        turned: (n - 1, 3), rotation in each interval, rad, world axes.
        stretch: number of the stretch of each interval, -1 if it is not judged.
        series: pose and twist as recorded.
    """

    time_ns: Times
    pose: Array
    twist: Array
    turned: Array
    stretch: NDArray[np.int32]
    series: tuple[TimeSeries, TimeSeries]

    @staticmethod
    def of(pose: TimeSeries, twist: TimeSeries, every: int = 1) -> _Both | None:
        start = twist.time_ns[0]
        within = (pose.time_ns >= start) & (pose.time_ns <= twist.time_ns[-1])
        time_ns = pose.time_ns if within.all() else pose.time_ns[within]
        if len(time_ns) * every < 2 * _LEAST_WINDOWS:
            return None
        kept = (values[each] for values, each in zip(in_blocks(pose.values), in_blocks(within), strict=True))
        rows = stored((np.hstack([values[:, :3], unit_rows(values[:, 3:])]) for values in kept), 7)
        turned = stored((rotate_all(part[:-1, 3:], rotation_vectors(part[:, 3:])) for part in in_blocks(rows, 1)), 3)
        broken = _across_gaps(time_ns, twist.time_ns)
        broken |= sizes_of(turned) > every * _FARTHEST
        stretch = np.where(broken, -1, np.cumsum(broken, dtype=np.int32)).astype(np.int32, copy=False)
        return _Both(time_ns, rows, _integrals(twist, time_ns), turned, stretch, (pose, twist))

    def halved(self) -> _Both | None:
        """Return the same of every second sample; None for too few."""
        pose, twist = self.series
        rare = replace(pose, time_ns=self.time_ns[::2], values=self.pose[::2])
        every_second = replace(twist, time_ns=twist.time_ns[::2], values=twist.values[::2])
        return _Both.of(rare, every_second, 2)

    def increments(self, of: str, world: bool, twist: TimeSeries) -> Array:
        """Return the change in each interval in the axes of the twist, NaN where it is not judged."""
        return stored((self._increments(of, world, twist, part) for part in self.rows()), 3)

    def _increments(self, of: str, world: bool, twist: TimeSeries, part: slice) -> Array:
        ends = slice(part.start, part.stop + 1)
        attitude = self.pose[ends, 3:]
        if of == "attitude":
            start, times = self.time_ns[0], self.time_ns[ends]
            since, near = (times - start) * 1e-9, _about(times, twist.time_ns)
            at = (twist.time_ns[near] - start) * 1e-9
            rates = np.stack([np.interp(since, at, column) for column in twist.values[near, 3:].T], axis=1)
            # An integral of rates is not a rotation if their axis turns (Bortz, IEEE Trans. AES-7 (1971) 61).
            cone = np.diff(since)[:, None] ** 2 / 12.0 * np.cross(rates[:-1], rates[1:])
            result = self.turned[part] + cone if world else rotation_vectors(attitude) - cone
            give_back(twist.values)
        else:
            result = self.changes(of, part)
            if not world:
                turned = rotate_all_inverse(attitude[:-1], result), rotate_all_inverse(attitude[1:], result)
                result = 0.5 * (turned[0] + turned[1])
        return np.where(self.stretch[part, None] >= 0, result, np.nan)

    def changes(self, of: str, part: slice, reading: str = "") -> Array:
        """Return the change of attitude or position in some intervals, world axes; see `TwistReading.attitude`."""
        if of == "position":
            return np.diff(self.pose[part.start : part.stop + 1, :3], axis=0)
        if not reading:
            return self.turned[part]
        turns = self.attitudes(part, reading)
        return rotate_all(turns[:-1], rotation_vectors(turns))

    def attitudes(self, part: slice, reading: str) -> Array:
        """Return the attitudes at the ends of some intervals; see `TwistReading.attitude`."""
        order = np.array(_QUATERNIONS[reading])
        turns: Array = self.pose[part.start : part.stop + 1, 3:][:, np.abs(order) - 1] * np.sign(order)
        return turns

    def said(self, columns: slice, reading: TwistReading, part: slice) -> Array:
        """Return the integral of some columns of the twist over each of some intervals, world axes."""
        added = self.twist[part, columns][:, np.abs(reading.axes) - 1] * np.sign(reading.axes) * reading.factor
        if reading.world:
            return added
        attitude = self.attitudes(part, reading.attitude)
        turned: Array = 0.5 * (rotate_all(attitude[:-1], added) + rotate_all(attitude[1:], added))
        return turned

    def rows(self) -> Iterator[slice]:
        """Yield the intervals in blocks."""
        for part in parts(len(self.stretch)):
            yield part
            for values in (self.pose, self.twist, self.turned):
                give_back(values)


def _lacks_position(series: TimeSeries) -> bool:
    return any(bool(np.isnan(rows[:, :3]).any()) for rows in in_blocks(series.values))


def _about(times: Times, time_ns: Times) -> slice:
    """Return the rows at `time_ns` between which `times`, which ascend, lie."""
    first, last = np.searchsorted(time_ns, times[[0, -1]], side="right")
    return slice(max(int(first) - 1, 0), int(last) + 1)


def _integrals(twist: TimeSeries, time_ns: Times) -> Array:
    """Return the integral of a twist over each interval, (n - 1, 6)."""
    start = twist.time_ns[0]

    def added() -> Iterator[Array]:
        yield (last := np.zeros((1, 6)))
        for times, values in zip(in_blocks(twist.time_ns, 1), in_blocks(twist.values, 1), strict=True):
            steps = np.diff((times - start) * 1e-9)[:, None]
            sums = np.cumsum(np.concatenate([last, 0.5 * steps * (values[1:] + values[:-1])]), axis=0)
            last = sums[-1:]
            yield sums[1:]

    def apart() -> Iterator[Array]:
        for times in in_blocks(time_ns, 1):
            near = _about(times, twist.time_ns)
            at, wanted = ((each - start) * 1e-9 for each in (twist.time_ns[near], times))
            yield np.diff(np.stack([np.interp(wanted, at, column) for column in sums[near].T], axis=1), axis=0)
            give_back(sums)

    sums = stored(added(), 6)
    return stored(apart(), 6)


def _across_gaps(time_ns: Times, twist_ns: Times) -> NDArray[np.bool_]:
    """Return which intervals are gaps of the pose, or lie across one of the twist."""
    holes = np.flatnonzero(np.diff(twist_ns) > longest_usual(twist_ns))
    ends, begins = twist_ns[holes], twist_ns[holes + 1]
    usual = longest_usual(time_ns)
    found = [
        (np.searchsorted(ends, times[1:], side="left") > np.searchsorted(begins, times[:-1], side="right"))
        | (np.diff(times) > usual)
        for times in in_blocks(time_ns, 1)
    ]
    return np.concatenate(found)


def _judged(of: str, both: _Both, readings: list[TwistReading]) -> Agreement:
    """Return how the change of the pose in each interval agrees with the twist in the first of `readings`."""
    columns = slice(3, 6) if of == "attitude" else slice(0, 3)
    least = _LEAST_TURN if of == "attitude" else 1e-9 * _farthest(both.pose[:, :3])
    changes = (both.changes(of, part) for part in both.rows())
    floor = max(least, _ABOVE_NOISE * noise_of_path(changes, np.zeros((1, 3)), both.time_ns))
    given, *others = readings

    def compared(reading: TwistReading) -> _Found | None:
        return _windows(both, of, columns, reading, floor, known=reading is given)

    found = compared(given)
    filled = any(bool(rows.any()) for rows in in_blocks(both.twist[:, columns]))
    if found is not None and not filled:
        # Rounding takes a pose at rest away and back.
        turns = of == "attitude"
        pose = TimeSeries("", both.time_ns, both.pose)
        floor = max(floor, smallest_change(pose, pose_columns(turns=turns), turns=turns))
        found = compared(given)
    if found is None:
        moves = "turns" if of == "attitude" else "moves"
        return Agreement(of, None, reason=f"the body {moves} too little above the noise of the pose")
    error, sure, speed, count, window_s, beyond, odd, when_ns = found
    if not filled:
        return Agreement(of, error, window_s, count, True, nothing=True)
    remedy, remaining = "", 0.0
    if sure > _CONTRADICTS:
        remedy, remaining = _remedy(given, others, compared, _RECONCILED)
    if not remedy and speed > _SENSORS:
        # A difference about an axis about which the body hardly turns is small, and only that axis explains it.
        turned = [replace(given, axes=axes) for axes in _other_axes()]
        remedy, remaining = _remedy(given, turned, compared, _RECONCILED * min(1.0, error))
    if sure <= _CONTRADICTS < error and not remedy:
        return Agreement(of, None, reason=f"they differ by {100.0 * error:.3g} %, {RARE}")
    if error <= _CONTRADICTS and not remedy:
        partly = beyond if beyond * count > 1.5 else 0.0
        when_ns = when_ns if partly else ()
        rare = sure <= _PART < error
        return Agreement(of, error, window_s, count, partly > 0.0, partly=partly, odd=odd, when_ns=when_ns, rare=rare)
    contradicts = bool(remedy) or speed > _SENSORS
    if not contradicts:
        unit = "rad/s" if of == "attitude" else "m/s"
        return Agreement(of, None, reason=f"they differ by {speed:.2g} {unit}, as the constant error of a sensor may")
    return Agreement(of, error, window_s, count, contradicts, remedy, remaining, speed=speed)


def _farthest(positions: Array) -> float:
    return max(float(np.abs(rows).max()) for rows in in_blocks(positions))


def _remedy(
    given: TwistReading, others: list[TwistReading], compared: Callable[[TwistReading], _Found | None], accepted: float
) -> tuple[str, float]:
    """Return the first of `others` that fits about as well as the best, and what it leaves; "" beyond `accepted`."""
    tried = [(found[0], reading) for reading in others if (found := compared(reading))]
    least = min((error for error, _ in tried), default=np.inf)
    if least > accepted:
        return "", 0.0
    error, first = next(each for each in tried if each[0] <= max(1.5 * least, 1e-12))
    return first.words(given), error


def _windows(both: _Both, of: str, columns: slice, reading: TwistReading, floor: float, known: bool) -> _Found | None:
    """Return how they differ, and what interpolation and noise leave if it is `known`; None for too few windows.

    The shortest of 1 s, 10 s, ... in which the body moves far enough; from 0.1 s on of a short recording.
    """
    whole = int(both.time_ns[-1] - both.time_ns[0])
    length = _SECOND if whole >= _SECOND * _LEAST_WINDOWS else _SHORTER
    while length * _LEAST_WINDOWS <= max(whole, _SHORTER * _LEAST_WINDOWS):
        window, sums = _sums(both, of, columns, reading, length)
        seconds, did, told, pieces = sums[:, 0] * 1e-9, sums[:, 1:4], sums[:, 4:7], sums[:, 7]
        size = np.maximum(np.linalg.norm(did, axis=1), np.linalg.norm(told, axis=1))
        error = np.linalg.norm(did - told, axis=1)
        # The noise of the ends of each piece adds up.
        kept = (size > floor * np.sqrt(pieces)) & (seconds >= 0.5e-9 * length)
        if int(kept.sum()) >= _LEAST_WINDOWS:
            ratio, sure = error[kept] / size[kept], error[kept]
            if known and ratio.max() > _PART:
                changed = _halving(both, of, columns, reading, length, window, did - told)
                sure = sure - _OF_HALVED * changed[kept] - _NOISES * _noise(both, columns) * np.sqrt(seconds[kept])
                sure = np.maximum(sure, 0.0)
            speed, rest = sure / seconds[kept], sure / size[kept]
            beyond = (rest > max(_PART, _ABOVE_USUAL * float(np.quantile(ratio, 0.25)))) & (speed > _SENSORS)
            begins = np.sort(both.time_ns[0] + window[kept][beyond] * length)
            odd = (rest > max(_PART, _ABOVE_USUAL * float(ratio.min()))) & (speed > _SENSORS)
            middle = float(np.median(ratio)), float(np.median(rest)), float(np.median(speed))
            share, when = float(beyond.mean()), _spans(begins, length)
            return _Found(*middle, int(kept.sum()), length * 1e-9, share, bool(odd.any()), when)
        length *= 10
    return None


def _noise(both: _Both, columns: slice) -> float:
    """Return the noise of the integral of the twist over a second; it grows with the root of the time."""
    twist = both.series[1]
    level = typical_at(twist.values[:, columns], twist.time_ns)
    return level * float(np.sqrt(np.median(np.diff(twist.time_ns)) * 1e-9))


def _halving(
    both: _Both, of: str, columns: slice, reading: TwistReading, length: int, window: Times, left: Array
) -> Array:
    """Return by how much the difference in each window changes if every second sample is left out."""
    rare = both.halved()
    times, sums = (np.empty(0, np.int64), left) if rare is None else _sums(rare, of, columns, reading, length)
    if not len(times):
        return np.full(len(window), np.inf)
    begins, first = np.unique(times, return_index=True)
    # A window in which none of the longer intervals begins is within that of the window before.
    at = np.maximum(np.searchsorted(begins, window, side="right") - 1, 0)
    before: Array = np.array([np.bincount(at, column, len(begins)) for column in left.T]).T
    return sizes_of(np.add.reduceat(sums[:, 1:4] - sums[:, 4:7], first) - before)[at]


def _sums(both: _Both, of: str, columns: slice, reading: TwistReading, length: int) -> tuple[Times, Array]:
    """Return the number of each window, and sums in it: ns, the change, what the twist says, pieces without gaps."""
    numbers: list[Times] = [np.empty(0, np.int64)]
    found: list[Array] = [np.empty((0, 8))]
    last, carried = (-1, -1), found[0]
    for part in both.rows():
        judged = both.stretch[part] >= 0
        if not judged.any():
            continue
        times = both.time_ns[part.start : part.stop + 1]
        rows = [np.diff(times)[:, None], both.changes(of, part, reading.attitude), both.said(columns, reading, part)]
        stretch, window = both.stretch[part][judged], ((times[:-1] - both.time_ns[0]) // length)[judged]
        begins = np.append(True, np.diff(window) != 0)
        piece = begins | np.append(True, np.diff(stretch) != 0)
        piece[0] = (int(stretch[0]), int(window[0])) != last
        # What stands for the part of a window in the block before is added up first, as it came.
        goes_on = int(window[0]) == last[1]
        label = np.append(np.zeros(len(carried) if goes_on else 0, np.intp), np.cumsum(begins) - 1)
        values = np.concatenate([carried if goes_on else carried[:0], np.c_[np.hstack(rows)[judged], piece]])
        sums: Array = np.array([np.bincount(label, column) for column in values.T], dtype=np.float64).T
        if goes_on:
            numbers[-1], found[-1] = numbers[-1][:-1], found[-1][:-1]
        numbers.append(window[begins])
        found.append(sums)
        last, carried = (int(stretch[-1]), int(window[-1])), sums[-1:]
    return np.concatenate(numbers), np.concatenate(found)


def _spans(begins: Times, length: int) -> tuple[tuple[int, int], ...]:
    """Return begin and end of windows of this length that begin at these times, those that follow each other as one."""
    runs = np.split(begins, np.flatnonzero(np.diff(begins) > length) + 1)
    return tuple((int(run[0]), int(run[-1]) + length) for run in runs if len(run))
