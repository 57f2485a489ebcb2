"""`Comparison`: how two flights differ: motion, momenta, commands and mass properties.

Values are compared at stamps of both; where these are few, at the samples of the coarser of the two, with the other
interpolated between two samples, never across a gap. Nothing is fitted or removed: a constant rotation or shift between
the two is named, not corrected.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rb_dynamics.analysis.command_differences import CommandDifference, command_differences
from rb_dynamics.analysis.interpolated_signal import MotionSignals, Signal, differences
from rb_dynamics.analysis.time_alignment import Alignment
from rb_dynamics.analysis.track import Array, Times, Track, shared
from rb_dynamics.analysis.transform_tree import is_fixed, pose_between
from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import LogError
from rb_dynamics.formats.log_metadata import RUN
from rb_dynamics.numerics.rotation_arrays import product, rotate_all_inverse, rotations_between
from rb_dynamics.scene.model import Scene

UNITS = {
    "attitude": "rad",
    "position": "m",
    "angular_velocity": "rad/s",
    "linear_velocity": "m/s",
    "angular_momentum": "kg m^2/s",
    "linear_momentum": "kg m/s",
    "kinetic_energy": "J",
}
"""Units of the quantities that are compared."""

MOTION = ("attitude", "position", "angular_velocity", "linear_velocity")
"""The quantities that `--bound` applies to."""

Bound: TypeAlias = "float | Mapping[str, float]"
"""Largest difference accepted: in every quantity of `MOTION`, or in each that is named; rad, m, rad/s, m/s."""

# Number of consecutive samples of the coarser recording without a common stamp that are compared by interpolation.
_RARE = 10
# The error of interpolation is an estimate: it explains differences up to so many times as large, beside rounding
# errors relative to the largest value. A sample without a stamp of both is compared, too, if it differs by more.
_EXPLAINED = 4.0
_ROUNDING = 1e-12
# A constant difference is named if what remains without it is this many times smaller.
_CONSTANT = 10.0
PARTS = 6
_FACTS = ("method", "solver", "effects", "seed", "version.rb_dynamics", "platform", "machine")


@dataclass(frozen=True)
class Difference:
    """Differences of one quantity over time.

    Attributes:
        name: key in `UNITS`.
        axes: "world" or "body", "" if the quantity has none.
        time_ns: where the two are compared, by the clock of A; ascending.
        first: values of A, a row for each time.
        second: values of B.
        size: magnitude of the differences; of attitudes the angle (rad).
        first_ns: earliest time at which they differ at all, even by a bit; None if they do not.
        first_recorded_ns: the same among the times at which both have a sample.
        interpolated: number of times at which one of the two is interpolated.
        interpolation: approximate largest error of the interpolation; 0 if nothing is interpolated.
        recorded: times of the samples of A and of B in the time that both cover, by the clock of A.
    """

    name: str
    axes: str
    time_ns: Times
    first: Array
    second: Array
    size: Array
    first_ns: int | None
    first_recorded_ns: int | None
    interpolated: int
    interpolation: float
    recorded: tuple[Signal, Signal]

    @property
    def max(self) -> float:
        """The largest difference."""
        return float(self.size.max())

    @property
    def explained(self) -> bool:
        """Whether interpolation, where there is any, explains the largest difference."""
        if not self.interpolated:
            return not self.max
        largest = float(np.linalg.norm(np.vstack([self.first, self.second]), axis=1).max())
        return self.max <= _EXPLAINED * self.interpolation + _ROUNDING * largest

    @property
    def compared_s(self) -> float:
        """The time that both cover without a gap."""
        begin, end = int(self.time_ns[0]), int(self.time_ns[-1])
        holes = [
            (max(first, begin), min(last, end))
            for side in self.recorded
            for first, last in side.holes()
            if first < end and last > begin
        ]
        return (end - begin - sum(last - first for first, last in _joined(holes))) / 1e9

    @property
    def rms(self) -> float:
        """Root of the mean square over time: with even samples, over the samples."""
        largest = self.max
        return largest and largest * float(np.sqrt(np.average((self.size / largest) ** 2, weights=self._stand_for)))

    @property
    def _stand_for(self) -> Array:
        """How much time each sample stands for: half of both its intervals, none of which is a gap."""
        steps = np.diff(self.time_ns).astype(np.float64)
        for side in self.recorded:
            for first, last in side.holes():
                steps[max(int(self.time_ns.searchsorted(first, "right")) - 1, 0) : self.time_ns.searchsorted(last)] = (
                    np.nan
                )
        around = np.ma.masked_invalid([np.append(np.nan, steps), np.append(steps, np.nan)])
        usual = float(np.nanmedian(steps)) if np.isfinite(steps).any() else 1.0
        mean: Array = around.mean(axis=0).filled(usual)
        return mean

    def growth(self, span_ns: tuple[int, int]) -> list[float]:
        """Return the largest difference in each of `PARTS` equal parts of the time; NaN if there is no sample."""
        begin, end = span_ns
        edges = [begin + (end - begin) * part // PARTS for part in range(PARTS + 1)]
        cuts = [*self.time_ns.searchsorted(edges)[:-1].tolist(), len(self.time_ns)]
        parts = [self.size[first:last] for first, last in itertools.pairwise(cuts)]
        return [float(part.max()) if len(part) else math.nan for part in parts]

    @property
    def max_ns(self) -> int:
        """When the difference is largest."""
        return int(self.time_ns[int(self.size.argmax())])


@dataclass(frozen=True)
class Side:
    """Facts about one of the two flights, for the reader.

    Attributes:
        path: of the log or bag.
        own: whether it was logged by this package.
        flown: whether it was simulated for the comparison; the path is then that of the scene.
        span_s: first and last time of its motion, s as in the output.
        body: mass properties; None if unknown.
    """

    path: str
    own: bool
    flown: bool
    span_s: tuple[float, float]
    body: RigidBody | None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"path": self.path, "own": self.own, "flown": self.flown, "span_s": list(self.span_s)}


@dataclass(frozen=True)
class Comparison:
    """How two flights differ.

    Attributes:
        a: the first flight.
        b: the second.
        alignment: how their times belong together.
        zero_ns: time of A's clock from which the output counts.
        clock: what that is, in words.
        differences: by name; a quantity that one of the two does not have is missing.
        compared_s: time that both cover without a gap.
        length_s: time that the longer of the two covers, within what was asked for.
        not_compared: what was not compared, one sentence each.
        commands: channels whose commands differ; None if one of the two has none recorded.
        body: mass properties that differ: name, value of A, value of B; None if those of one are not known.
        run: facts of two runs of this package that differ, likewise.
        notes: further remarks, one sentence each.
        bound: largest difference accepted in each quantity of the motion, or in those that it names; None: nothing is
            judged.
        least_share: least fraction of the longer flight that must be compared.
    """

    a: Side
    b: Side
    alignment: Alignment
    zero_ns: int
    clock: str
    differences: Mapping[str, Difference]
    compared_s: float
    length_s: float
    not_compared: Sequence[str]
    commands: Sequence[CommandDifference] | None
    body: Sequence[tuple[str, Any, Any]] | None
    run: Sequence[tuple[str, Any, Any]]
    notes: Sequence[str]
    bound: Bound | None = None
    least_share: float = 0.0

    @property
    def share(self) -> float:
        """Fraction of the longer flight over which every judged quantity, or else the motion, is compared."""
        judged = [each for name in self.limits or MOTION if (each := self.differences.get(name)) is not None]
        least = min((each.compared_s for each in judged), default=0.0)
        return least / self.length_s if least < self.length_s else 1.0

    @property
    def samples(self) -> int:
        """Number of times at which the motion is compared."""
        return max((len(self.differences[name].size) for name in MOTION if name in self.differences), default=0)

    @property
    def first_ns(self) -> int | None:
        """First time at which the motions differ, even by a bit; None if they do not."""
        found = [each.first_ns for name, each in self.differences.items() if name in MOTION]
        return min((first for first in found if first is not None), default=None)

    @property
    def limits(self) -> dict[str, float]:
        """The largest difference accepted in each quantity that is judged."""
        if isinstance(self.bound, Mapping):
            return {name: self.bound[name] for name in MOTION if name in self.bound}
        return {name: self.bound for name in MOTION if name in self.differences and self.bound is not None}

    @property
    def beyond(self) -> tuple[str, ...]:
        """Quantities that exceed their bound, or have a bound but are not in both recordings."""
        found = self.differences
        return tuple(name for name, most in self.limits.items() if name not in found or found[name].max > most)

    @property
    def passed(self) -> bool:
        """Whether every quantity with a bound is known to be within it, over enough of the time."""
        return not self.beyond and self.share >= self.least_share

    def seconds(self, time_ns: Times | int) -> Any:
        """Return times of A's clock as s in the output; the difference is computed in integers."""
        return (time_ns - self.zero_ns) / 1e9

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last time at which anything is compared."""
        times = [each.time_ns for each in self.differences.values()]
        return int(min(time[0] for time in times)), int(max(time[-1] for time in times))

    def as_dict(self) -> dict[str, Any]:
        """Return the comparison as plain values for JSON; what is unknown is None."""
        found: dict[str, Any] = {
            "a": self.a.as_dict(),
            "b": self.b.as_dict(),
            "aligned_by": self.alignment.by,
            "offset_s": self.alignment.offset_ns / 1e9,
            "offset_ns": self.alignment.offset_ns,
            "offset_uncertainty_s": _finite(self.alignment.uncertainty_s),
            "clock": self.clock,
            "samples": self.samples,
            "compared_s": self.compared_s,
            "compared_share": self.share,
            "not_compared": list(self.not_compared),
        }
        for name, unit in UNITS.items():
            each = self.differences.get(name)
            found[name] = each and {
                "max": each.max,
                "rms": each.rms,
                "at_s": float(self.seconds(each.max_ns)),
                "unit": unit,
                "axes": each.axes,
                "samples": len(each.size),
                "interpolated": each.interpolated,
                "interpolation_error": each.interpolation,
            }
        first = self.first_ns
        return found | {
            "first_difference_s": None if first is None else float(self.seconds(first)),
            "commands": None if self.commands is None else [each.as_dict(self.zero_ns) for each in self.commands],
            "body": None if self.body is None else [_named(*each) for each in self.body],
            "run": [_named(*each) for each in self.run],
            "notes": list(self.notes),
            "bound": self.bound,
            "least_share": self.least_share,
            "passed": self.passed,
        }


def _named(name: str, a: Any, b: Any) -> dict[str, Any]:
    return {"name": name, "a": a, "b": b}


def _finite(number: float | None) -> float | None:
    return number if number is not None and math.isfinite(number) else None


def differences_of_motion(a: MotionSignals, b: MotionSignals) -> dict[str, Difference]:
    """Return the differences of two motions of one clock, by name; velocities in world axes if both are known there."""
    velocity = ("world", a.velocity_world, b.velocity_world)
    if a.velocity_world is None or b.velocity_world is None:
        velocity = ("body", a.velocity_body, b.velocity_body)
    pairs = {
        "attitude": ("", a.attitude, b.attitude),
        "position": ("world", a.position, b.position),
        "angular_velocity": ("body", a.rate, b.rate),
        "linear_velocity": velocity,
    }
    found = {name: difference(name, axes, one, other) for name, (axes, one, other) in pairs.items()}
    return {name: each for name, each in found.items() if each is not None}


def difference(name: str, axes: str, a: Signal | None, b: Signal | None) -> Difference | None:
    """Return how two signals of one clock differ; None if one is missing or they share no time."""
    if a is None or b is None or not len(a.time_ns) or not len(b.time_ns):
        return None
    begin, end = max(a.time_ns[0], b.time_ns[0]), min(a.time_ns[-1], b.time_ns[-1])
    within = [signal.time_ns[(signal.time_ns >= begin) & (signal.time_ns <= end)] for signal in (a, b)]
    # The choice does not depend on which of the two comes first.
    a_coarse = (len(within[0]), within[0].tolist()) <= (len(within[1]), within[1].tolist())
    coarse, fine = (within[0], b) if a_coarse else (within[1], a)
    common = np.intersect1d(a.time_ns, b.time_ns)
    _, known = fine.at(coarse)
    times = coarse[known]
    if not len(times):
        return None
    times = times[_compared(np.isin(times, common))]
    times = np.union1d(
        times, np.concatenate([_beyond_interpolation(a, b, begin, end), _beyond_interpolation(b, a, begin, end)])
    )
    first, second = a.at(times)[0], b.at(times)[0]
    for signal, rows, others in ((a, first, second), (b, second, first)):
        _take_worst(signal, times, rows, others)
    size = np.linalg.norm(differences(first, second), axis=1)
    interpolated = ~np.isin(times, common)
    between = (signal for signal in (a, b) if not np.isin(times, signal.time_ns).all())
    # The difference of values that differ in a bit may underflow to 0.
    other = (first != second).any(axis=1)
    if a.turns:
        other &= (first != -second).any(axis=1)
    return Difference(
        name,
        axes,
        times,
        first,
        second,
        size,
        _first(times, other),
        _first(times, other & ~interpolated),
        int(interpolated.sum()),
        max((signal.interpolation_error() for signal in between), default=0.0),
        (a.within(begin, end), b.within(begin, end)),
    )


def _beyond_interpolation(signal: Signal, other: Signal, begin_ns: int, end_ns: int) -> Times:
    """Return the times of samples without a partner that differ by more than interpolation can explain."""
    times = np.setdiff1d(signal.time_ns[(signal.time_ns >= begin_ns) & (signal.time_ns <= end_ns)], other.time_ns)
    values, known = other.at(times)
    times, values = times[known], values[known]
    size = np.linalg.norm(differences(signal.at(times)[0], values), axis=1)
    found: Times = times[size > _EXPLAINED * other.interpolation_error()]
    return found


def _take_worst(signal: Signal, times: Times, rows: Array, others: Array) -> None:
    """Put further samples of a time into `rows` where they differ more from `others` than the first."""
    for at, again in zip(signal.again_ns.tolist(), signal.again, strict=True):
        place = int(times.searchsorted(at))
        if place < len(times) and times[place] == at:
            both = np.stack([rows[place], again])
            sizes = np.linalg.norm(differences(both, np.repeat(others[place : place + 1], 2, axis=0)), axis=1)
            rows[place] = both[sizes.argmax()]


def _first(times: Times, marked: NDArray[np.bool_]) -> int | None:
    return int(times[marked.argmax()]) if marked.any() else None


def _compared(common: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which samples are compared: those at stamps of both, and all where these are rare.

    Stamps may agree for a while only; without interpolation the rest would be left out.
    """
    edges = np.diff(common.astype(np.int8), prepend=1, append=1)
    begins, ends = np.flatnonzero(edges == -1), np.flatnonzero(edges == 1)
    chosen = common.copy()
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        if end - begin >= min(_RARE, len(common)):
            chosen[begin:end] = True
    return chosen


@dataclass(frozen=True)
class Given:
    """One of two flights to compare: its track, its source, and whether it was simulated for the comparison."""

    track: Track
    path: str
    flown: bool = False


def compare_tracks(
    a: Given,
    b: Given,
    alignment: Alignment,
    bound: Bound | None = None,
    window_s: tuple[float | None, float | None] = (None, None),
    more: Sequence[str] = (),
    least_share: float = 0.0,
) -> Comparison:
    """Return how two flights differ; `alignment` relates their times.

    Args:
        a: the first flight.
        b: the second.
        alignment: relation between their times.
        bound: largest difference accepted in each quantity of the motion, or in those that it names.
        window_s: first and last time to compare, as in the output; None: all.
        more: notes to add.
        least_share: least part of the longer one that is to be compared, 0 to 1.

    Raises:
        LogError: there is nothing to compare at any time.
    """
    # A node that stands still shows the new state with the stamp of the old one; its log has only the old one.
    moved = _moved_ns(a.track, b.track, alignment.offset_ns)
    one, other = (MotionSignals.of(flight.track, moved[flight is b].tolist()) for flight in (a, b))
    other = other.later(-alignment.offset_ns)
    zero_ns, clock = _clock(a, b, alignment, one)
    begin_ns = -math.inf if window_s[0] is None else zero_ns + round(window_s[0] * 1e9)
    end_ns = math.inf if window_s[1] is None else zero_ns + round(window_s[1] * 1e9)
    cut_one, cut_other = (motion.within(begin_ns, end_ns) for motion in (one, other))
    found = differences_of_motion(cut_one, cut_other)
    if not found:
        raise LogError(_nothing(a, b, one, other, alignment, zero_ns, window_s))
    found |= {
        name: each
        for name in ("angular_momentum", "linear_momentum", "kinetic_energy")
        if (each := _logged(name, a.track, b.track, alignment.offset_ns, (begin_ns, end_ns))) is not None
    }
    times = [each.time_ns for name, each in found.items() if name in MOTION]
    span = int(min(time[0] for time in times)), int(max(time[-1] for time in times))
    compared_s, left_out = _left_out(found, cut_one, cut_other, one, other, span, zero_ns)
    gaps = _joined([hole for motion in (cut_one, cut_other) for hole in _holes(motion)])
    commands, unequal = command_differences(a.track, b.track, alignment, span, gaps)
    sides = [
        Side(each.path, each.track.own, each.flown, _span_s(motion, zero_ns), each.track.body)
        for each, motion in ((a, one), (b, other))
    ]
    return Comparison(
        a=sides[0],
        b=sides[1],
        alignment=alignment,
        zero_ns=zero_ns,
        clock=clock,
        differences=found,
        compared_s=compared_s,
        length_s=max((last - first) / 1e9 for first, last in (motion.span_ns for motion in (cut_one, cut_other))),
        not_compared=left_out,
        commands=commands,
        body=_bodies(a.track.body, b.track.body),
        run=_runs(a.track, b.track),
        notes=[
            *_frames(a.track, b.track),
            *_constants(found),
            *unequal,
            *_moved(a.track, b.track, more),
            *_unknown_body(a, b),
            *more,
        ],
        bound=bound,
        least_share=least_share,
    )


def _clock(a: Given, b: Given, alignment: Alignment, one: MotionSignals) -> tuple[int, str]:
    """Return the time of A from which output times count, and its description."""
    if a.track.own:
        return 0, "simulation time of A"
    if b.track.own:
        return -alignment.offset_ns, "simulation time of B"
    start, _ = one.span_ns
    return start, f"time since the start of the motion in A, which is stamped {start // 10**9}.{start % 10**9:09d} s"


def _span_s(motion: MotionSignals, zero_ns: int) -> tuple[float, float]:
    first, last = motion.span_ns
    return (first - zero_ns) / 1e9, (last - zero_ns) / 1e9


def _nothing(
    a: Given,
    b: Given,
    one: MotionSignals,
    other: MotionSignals,
    alignment: Alignment,
    zero_ns: int,
    window_s: tuple[float | None, float | None],
) -> str:
    """Return why nothing is compared: no time in common, none within the window, or no quantity."""
    spans = [_span_s(motion, zero_ns) for motion in (one, other)]
    begin, end = max(first for first, _ in spans), min(last for _, last in spans)
    by = {"stamp": "by their stamps, ", "seconds": "aligned as asked, "}.get(alignment.by, "")
    a_goes, b_goes = (f"from {_told(first)} to {_told(last)} s" for first, last in spans)
    found = f"nothing to compare: {by}{a.path} goes {a_goes} and {b.path} {b_goes}"
    if begin > end:
        clocks = ", for one is in simulation time" if alignment.by == "stamp" and a.track.own != b.track.own else ""
        left_out = "leave out --align for the lag that fits best, or " if alignment.asked else ""
        return (
            f"{found}{clocks}, expected a time that both have; {left_out}say how they belong together with --align "
            "start or --align SECONDS, the time of B minus that of A"
        )
    if window_s != (None, None):
        return f"{found}, expected --from and --to within both; give them from {_told(begin)} to {_told(end)}"
    return (
        f"{found}, expected a quantity that both have, one of {', '.join(MOTION)}; name topics with --pose-topic and "
        "--twist-topic"
    )


def _told(seconds: float) -> str:
    """Return a time (s) with its digits down to microseconds."""
    return f"{seconds:.6f}".rstrip("0").rstrip(".")


def _logged(name: str, a: Track, b: Track, offset_ns: int, window_ns: tuple[float, float]) -> Difference | None:
    one, other = getattr(a, name), getattr(b, name)
    if one is None or other is None:
        return None
    signals = [
        Signal.of(series.time_ns, series.values.reshape(len(series.time_ns), -1), track.missing, moved_ns.tolist())
        for series, track, moved_ns in zip((one, other), (a, b), _moved_ns(a, b, offset_ns), strict=True)
    ]
    axes = "" if name == "kinetic_energy" else "world"
    return difference(name, axes, signals[0].within(*window_ns), signals[1].later(-offset_ns).within(*window_ns))


def _moved_ns(a: Track, b: Track, offset_ns: int) -> tuple[Times, Times]:
    """Return when either was moved from outside, by the clock of each."""
    moved_ns = np.concatenate([a.breaks_ns, b.breaks_ns - offset_ns])
    return moved_ns, moved_ns + offset_ns


def _left_out(
    found: Mapping[str, Difference],
    one: MotionSignals,
    other: MotionSignals,
    whole_one: MotionSignals,
    whole_other: MotionSignals,
    span: tuple[int, int],
    zero_ns: int,
) -> tuple[float, list[str]]:
    """Return the length of time that is compared, and sentences about what is not."""
    told = []
    for name, (in_a, in_b) in (
        ("attitude", (one.attitude, other.attitude)),
        ("position", (one.position, other.position)),
        ("angular velocity", (one.rate, other.rate)),
        ("linear velocity", (one.velocity_body or one.velocity_world, other.velocity_body or other.velocity_world)),
    ):
        if name.replace(" ", "_") not in found:
            lacking = [side for side, signal in (("A", in_a), ("B", in_b)) if signal is None]
            why = (
                f"{' and '.join(lacking)} {'do' if lacking[1:] else 'does'} not tell"
                if lacking
                else "no time in common"
            )
            told.append(f"{name}: {why}")
    holes: list[tuple[int, int]] = []
    for side, motion in (("A", one), ("B", other)):
        mine = [(max(begin, span[0]), min(end, span[1])) for begin, end in sorted(_holes(motion))]
        mine = [(begin, end) for begin, end in mine if begin < end]
        if mine:
            joined = _joined(mine)
            longest = max(joined, key=lambda hole: hole[1] - hole[0])
            told.append(
                f"{sum(end - begin for begin, end in joined) * 1e-9:.6g} s in {len(joined)} "
                f"gap{'s' * (len(joined) > 1)} of {side}, the longest {(longest[1] - longest[0]) * 1e-9:.6g} s "
                f"from t = {(longest[0] - zero_ns) * 1e-9:.6g} s"
            )
        holes += mine
    usual_ns = max(whole_one.interval_ns, whole_other.interval_ns)
    for side, motion in (("A", whole_one), ("B", whole_other)):
        first, last = motion.span_ns
        for length, where in ((span[0] - first, "before"), (last - span[1], "after")):
            if length > usual_ns:
                told.append(f"{length * 1e-9:.6g} s of {side} {where} what both have")
    lost = sum(end - begin for begin, end in _joined(holes))
    return (span[1] - span[0] - lost) / 1e9, told


def _holes(motion: MotionSignals) -> set[tuple[int, int]]:
    return {hole for signal in vars(motion).values() if signal is not None for hole in signal.holes()}


def _joined(pieces: list[tuple[int, int]]) -> list[tuple[int, int]]:
    joined: list[tuple[int, int]] = []
    for begin, end in sorted(pieces):
        if joined and begin <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(end, joined[-1][1]))
        else:
            joined.append((begin, end))
    return joined


def _bodies(a: RigidBody | None, b: RigidBody | None) -> list[tuple[str, Any, Any]] | None:
    if a is None or b is None:
        return None
    names = ("mass", "center_of_mass", "inertia")
    return [(name, getattr(a, name), getattr(b, name)) for name in names if getattr(a, name) != getattr(b, name)]


def _runs(a: Track, b: Track) -> list[tuple[str, Any, Any]]:
    if not (a.own and b.own):
        return []
    one, other = a.bag.metadata[RUN], b.bag.metadata[RUN]
    facts = [(name, one.get(name, ""), other.get(name, "")) for name in _FACTS if one.get(name) != other.get(name)]
    return [*facts, *_devices(a, b)]


def _devices(a: Track, b: Track) -> list[tuple[str, Any, Any]]:
    """Return the numbers of actuators, sensors and wrench channels in which the scenes of two logs differ."""
    one, other = ({} if scene is None else _numbers_of_devices(scene) for scene in (a.scene, b.scene))
    if not (one and other):
        return []
    names = [name for name in dict.fromkeys((*one, *other)) if one.get(name) != other.get(name)]
    return [(name, one.get(name, ""), other.get(name, "")) for name in names]


def _numbers_of_devices(scene: Scene) -> dict[str, Any]:
    devices: list[tuple[str, Any]] = [
        *((f"actuators.{each.name}", each) for each in scene.actuators),
        *((f"sensors.{each.name}", each) for each in scene.sensors),
        *((f"wrenches.{each.topic}", each) for each in scene.channels),
    ]
    return {f"{name}.{field.name}": getattr(each, field.name) for name, each in devices for field in fields(each)}


def _moved(one: Track, other: Track, notes: Sequence[str]) -> list[str]:
    """Return that a body was moved from outside, and the other not so, where `notes` do not say it."""
    moves = {name: track.moved_ns - track.zero_ns for name, track in (("A", one), ("B", other))}
    first, second = moves.values()
    alike = len(first) == len(second) and len(np.unique(first - second)) <= 1
    if alike or any("set_state" in note for note in notes):
        return []
    return [
        f"{name} was moved to another state (set_state) at t = {', '.join(f'{t:.9g}' for t in (times * 1e-9).tolist())}"
        f" s: the motions differ from then on {'in any case' if by.own else 'unless the other was so, too'}"
        for (name, times), by in zip(moves.items(), (other, one), strict=True)
        if len(times)
    ]


def _unknown_body(a: Given, b: Given) -> list[str]:
    unknown = [each.path for each in (a, b) if each.track.body is None]
    if not unknown:
        return []
    which = f"{' and '.join(unknown)} {'have' if unknown[1:] else 'has'} none"
    return [f"Mass properties are not compared: {which}. Give them by a scene: --scene SCENE."]


def _frames(a: Track, b: Track) -> list[str]:
    """Return remarks on frames that the two name differently."""
    told = []
    if a.pose and b.pose and a.pose.frame.lstrip("/") != b.pose.frame.lstrip("/"):
        told.append(
            f'The poses of A are in the frame "{a.pose.frame}", those of B in "{b.pose.frame}": they are taken as one '
            "frame, which nothing in the recordings says."
        )
    if a.twist and b.twist and not (a.twist_in_world or b.twist_in_world):
        frames = [(each.turned_to or each.frame).lstrip("/") for each in (a.twist, b.twist)]
        if "" not in frames and frames[0] != frames[1]:
            said = "which nothing in the recordings says"
            for track in (a, b):
                with contextlib.suppress(LogError):
                    between = pose_between(track.bag, frames[0], frames[1])
                    if all(is_fixed(track.bag.topics[name]) for name in between.topics):
                        said = f"although {track.bag.path} says how they are fixed to each other: name the body's in a "
                        said += "scene, as body.frame, and give it with --scene SCENE"
            told.append(
                f'The twists of A are of the frame "{frames[0]}", those of B of "{frames[1]}": they are taken as one '
                f"body frame, {said}."
            )
    if a.twist_in_world != b.twist_in_world and a.twist and b.twist:
        told.append(
            f"The twist of {'A' if a.twist_in_world else 'B'} is in world axes; its pose turns it into body axes."
        )
    return told


def _constants(found: Mapping[str, Difference]) -> list[str]:
    """Return remarks on constant differences: axes that are turned against each other, origins that are apart."""
    told = []
    if (attitude := found.get("attitude")) is not None and len(attitude.size) > 3:
        inverse = attitude.first * np.array([-1.0, -1.0, -1.0, 1.0])
        sides = {
            "body": _constant_turn(product(inverse, attitude.second)),
            "world": _constant_turn(product(attitude.second, inverse)),
        }
        good = {axes: turn for axes, turn in sides.items() if turn[2] * _CONSTANT < attitude.rms}
        if good and attitude.rms > max(1e-12, 4.0 * attitude.interpolation):
            axes = min(good, key=lambda name: good[name][2])
            vector, angle, rest = good[axes]
            # Adding 0 turns -0 into 0.
            direction = ", ".join(f"{part:g}" for part in np.round(vector / angle, 4) + 0.0)
            either = "; so are the axes of the other kind, as the body hardly turns" if len(good) > 1 else ""
            told.append(
                f"The {axes} axes of B are turned against those of A by {angle:.6g} rad ({math.degrees(angle):.4g} "
                f"degrees) about ({direction}), throughout: without that {rest:.3g} rad (rms) would remain{either}. "
                "Nothing is corrected: rates and velocities are compared as they are."
            )
    if (position := found.get("position")) is not None and len(position.size) > 3 and position.rms > 1e-9:
        apart = position.second - position.first
        shifts = {"": _constant_shift(apart)}
        if attitude is not None:
            times, turns, places = shared(attitude.time_ns, position.time_ns)
            if len(times) > 3:
                in_body = rotate_all_inverse(attitude.first[turns], apart[places])
                shifts[" in the body axes of A"] = _constant_shift(in_body)
        axes, (mean, rest) = min(shifts.items(), key=lambda shift: shift[1][1])
        if rest * _CONSTANT < position.rms:
            place = ", ".join(f"{part:.6g}" for part in mean)
            told.append(
                f"The positions of B lie ({place}) m from those of A{axes}, throughout: without that {rest:.3g} m "
                "(rms) would remain."
            )
    return told + ([] if attitude is None else [*_as_another_writes(attitude), *_in_world(found, attitude)])


def _as_another_writes(attitude: Difference) -> list[str]:
    """Return a remark on quaternions that fit those of the other if they are of the inverse, or begin with w."""
    if len(attitude.size) < 4 or attitude.rms <= max(1e-12, 4.0 * attitude.interpolation):
        return []
    first, second = attitude.first, attitude.second
    readings = {
        "one of the two look like the inverse, from world to body axes": (first, second * [-1.0, -1.0, -1.0, 1.0]),
        "A look like w, x, y, z in place of x, y, z, w": (np.roll(first, -1, axis=1), second),
        "B look like w, x, y, z in place of x, y, z, w": (first, np.roll(second, -1, axis=1)),
    }
    rest = {
        told: float(np.sqrt(np.mean(np.sum(rotations_between(*both) ** 2, axis=1)))) for told, both in readings.items()
    }
    told = min(rest, key=rest.__getitem__)
    if rest[told] * _CONSTANT >= attitude.rms:
        return []
    return [f"The quaternions of {told}: read so, {rest[told]:.3g} rad (rms) would remain. Nothing is corrected."]


def _in_world(found: Mapping[str, Difference], attitude: Difference) -> list[str]:
    """Return remarks on velocities that fit those of the other if they are in world axes although not said to be."""
    told = []
    for name in ("angular_velocity", "linear_velocity"):
        each = found.get(name)
        if each is None or each.rms <= 1e-9:
            continue
        times, turns, rows = shared(attitude.time_ns, each.time_ns)
        first, second = each.first[rows], each.second[rows]
        for side, apart in (
            ("A", rotate_all_inverse(attitude.first[turns], first) - second),
            ("B", rotate_all_inverse(attitude.second[turns], second) - first),
        ):
            rest = float(np.sqrt(np.mean(np.sum(apart**2, axis=1)))) if len(times) > 3 else math.inf
            if rest * _CONSTANT < each.rms:
                told.append(
                    f"The {name.replace('_', ' ')} of {side} looks like one in world axes, which its frame does not "
                    f"say: turned into body axes, {rest:.3g} {UNITS[name]} (rms) would remain. Nothing is corrected."
                )
    return told


def _constant_shift(apart: Array) -> tuple[Array, float]:
    """Return the mean of differences (m), and the rms that remains without it."""
    mean = apart.mean(axis=0)
    return mean, float(np.sqrt(np.mean(np.sum((apart - mean) ** 2, axis=1))))


def _constant_turn(turns: Array) -> tuple[Array, float, float]:
    """Return the mean of rotations as vector and angle (rad), and the rms angle that remains without it.

    The mean is the eigenvector of the sum of q q^T of the largest eigenvalue (Markley et al., J. Guidance 30 (2007)
    1193).
    """
    mean = np.linalg.eigh(turns.T @ turns)[1][:, -1:].T
    rest = rotations_between(np.repeat(mean, len(turns), axis=0), turns)
    vector = rotations_between(np.array([[0.0, 0.0, 0.0, 1.0]]), mean)[0]
    return vector, float(np.linalg.norm(vector)), float(np.sqrt(np.mean(np.sum(rest**2, axis=1))))
