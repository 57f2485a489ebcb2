"""Step control: chooses the grid of an arc, by a fixed step or by the requested accuracy.

A method is only a function that advances a phase. The functions that choose a step work on plain floats, and
`adaptive_kernel.py` compiles them unchanged.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any, NamedTuple, Protocol

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.motion.method import Inertia
from rb_dynamics.motion.phase_state import MOMENTUM, POSITION, PhaseState, elapsed, gain, is_finite
from rb_dynamics.motion.step_checks import NO_ATTITUDE
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import angle_of, conjugate, multiply
from rb_dynamics.numerics.vector import Vector, norm, subtract


class Advance(Protocol):
    """A method with its body and load."""

    def __call__(self, phase: PhaseState, h: float) -> PhaseState:
        """Return the phase after a step of h s."""

    def pair(self, phase: PhaseState, h: float) -> tuple[PhaseState, PhaseState]:
        """Return the phase after a step of h s, and the embedded result of one order less."""

    def longest_step(self, phase: PhaseState, accuracy: float, horizon: float) -> float:
        """Return the longest step in s that adds at most accuracy * step / horizon to the error at the end."""

    def slowing(self, phase: PhaseState) -> float:
        """Return the rate (1/s) at which drag makes differences of speed decay in `phase`; 0 without drag."""

    def steady(self, phase: PhaseState, longest: float) -> float:
        """Return for how long (s), at most `longest`, the load stays close to that in `phase`."""

    def sight(self, phase: PhaseState) -> float:
        """Return for how long (s) the load in `phase` predicts the load ahead."""

    @property
    def settled(self) -> float:
        """When (s of the run) the load stops changing gradually; infinite for other loads."""

    def strength(self, phase: PhaseState) -> float:
        """Return the sum of the magnitudes (N) of the forces in `phase`, which may cancel."""


MOST_STEPS = 10**12
"""Largest number of fixed steps in one run: compiled, they take days."""

MOST_GROWTH = 5.0
"""A stride is at most so many times as long as the one before."""

_EPSILON = 2.0**-52

# Share of the accuracy that step doubling uses, because errors grow faster than linearly while a body flips. A pair
# keeps the better of its results and needs no such reserve.
_SHARE = 0.2

# However short the stride, the two results of doubling may differ by this many roundings of rate and attitude, and one
# more: together, half of the strides differ by 0.6 to 2.6 roundings, and none of a thousand by more than 10. The
# results of a pair are rounded alike.
_NOISE = 9.0

# Results for position and velocity may differ by this many roundings of what the stride adds to them: those of a pair
# with twelve stages differ by up to 5.
_ROUNDINGS = 16.0

# Forces cancel if less than this share remains of them: their rounding errors may then look like an error of the step.
_CANCELLED = 1e-3

# ns, a whole number.
_LONGEST = 2.0**62


class Goal(NamedTuple):
    """Requirements on the strides of a run, and how their errors are estimated.

    Attributes:
        accuracy: the accepted error.
        horizon: the time (s) for which it holds.
        ends: whether the run ends at the horizon; otherwise the horizon is counted from the present time.
        mass: of the body, kg.
        order: order of the result whose error is estimated.
        errors: difference of the two results, in errors of that result.
        share: usable share of the accuracy.
        x, y, z: where the centre of mass starts, world axes, m.
        slowing: present rate at which errors of velocity decay, 1/s; see `Advance.slowing`.
        noise: number of roundings of rate and attitude, besides one, by which the results may differ without an error.
    """

    accuracy: float
    horizon: float
    ends: bool
    mass: float = 1.0
    order: float = 1.0
    errors: float = 1.0
    share: float = 1.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    slowing: float = 0.0
    noise: float = 0.0


class Learnt(NamedTuple):
    """State of step control.

    Attributes:
        step: guess for the next stride, s; 0 before the first.
        farthest: largest distance from the start so far, m: a lower bound of the path length.
        resolved_stride: length of a trial stride whose results differ by more than rounding, s; 0 if none was needed.
        resolved_error: error of the attitude that the trial stride adds.
        until: end of the trial stride, s since the start of the run: up to then, the errors of shorter strides follow
            from it.
    """

    step: float = 0.0
    farthest: float = 0.0
    resolved_stride: float = 0.0
    resolved_error: float = 0.0
    until: float = 0.0


class Stride(NamedTuple):
    """A chosen stride.

    Attributes:
        length: ns; 0 if not even 1 ns meets the accuracy.
        after: the phase at its end if it was taken to choose it, otherwise that at its start.
        learnt: state of step control after it.
        error: the error that it adds.
        steady: length (s) of those to come, as far as it shows; infinite if they grow as fast as they may.
    """

    length: int
    after: PhaseState
    learnt: Learnt
    error: float
    steady: float


class StepControl(Protocol):
    """Chooses the grid of an arc. Lengths of strides are integers in units of 1/`denominator` ns.

    Attributes:
        denominator: defines the unit of time.
        parts: number of equal steps with the accuracy of a stride over the same time.
    """

    denominator: int
    parts: int

    def stride(self, phase: PhaseState, advance: Advance) -> tuple[int, PhaseState | None]:
        """Return the length of the next stride and, if it was taken to choose it, the phase at its end."""

    def begin(self) -> None:
        """Adopt what the last chosen stride taught, once time enters it. A stride never entered must leave no trace."""


class FixedStep:
    """A fixed step. If it is not a whole number of nanoseconds, its fraction is carried exactly.

    Attributes:
        length: of every stride, in units of 1/`denominator` ns.
    """

    parts = 1

    def __init__(self, step: float) -> None:
        """Use the step in s, as the decimal number written by the user."""
        exact = Fraction(repr(float(step))) * NANOSECONDS
        self.denominator = exact.denominator
        self.length = exact.numerator

    def require_few(self, time_ns: int, name: str = "step", error: type[Exception] = ValueError) -> None:
        """Check that a run of `time_ns` takes at most `MOST_STEPS` steps.

        Raises:
            Exception: `error`, if it takes more.
        """
        count = time_ns * self.denominator // self.length
        if count > MOST_STEPS:
            step, time = self.length / self.denominator / NANOSECONDS, time_ns / NANOSECONDS
            raise error(
                f"{name} is {step:g} s, which makes {count:.3g} steps in {time:g} s, expected at most {MOST_STEPS:g}: "
                f"that many take days; take a step of {time / MOST_STEPS:.2g} s or more"
            )

    def stride(self, phase: PhaseState, advance: Advance) -> tuple[int, PhaseState | None]:
        """Return the length of the step, without taking it."""
        return self.length, None

    def begin(self) -> None:
        """Do nothing: every step is the same."""


class WholeArc:
    """One stride for the whole arc, for a closed form: every state is computed from the start.

    Attributes:
        length: of the stride, ns: longer than any run.
    """

    denominator = parts = 1
    length = 2**64

    def __init__(self, accuracy: float = math.inf, turned: float = 0.0) -> None:
        """Use the accepted error, and the rotation (rad) before the arc."""
        self._accuracy, self._turned = accuracy, turned

    def require_known(self, start: PhaseState, end: PhaseState, h: float) -> None:
        """Check that rounding allows the accuracy after h s of motion from `start` to `end`.

        Raises:
            ConvergenceError: names the accuracy that can be reached.
        """
        error = closed_form_rounding(self._turned, start, end, h)
        if error > self._accuracy:
            turned = error / _EPSILON - 1.0
            raise ConvergenceError(
                f"accuracy {self._accuracy:g} cannot be kept: in closed form too, rounding alone adds about "
                f"{_rounded_up(error):g} rad in a turn of {turned:.3g} rad; accept that much as solver.accuracy, or "
                "shorten the run"
            )

    def stride(self, phase: PhaseState, advance: Advance) -> tuple[int, PhaseState | None]:
        """Return the length of the whole arc."""
        return self.length, None

    def begin(self) -> None:
        """Do nothing."""


class OwnControl:
    """Steps as long as `accuracy` allows, by the method's own error estimate; see `AccuracyControl`.

    Attributes:
        goal: requirements on the steps.
        learnt: always the initial value, like `following`.
    """

    denominator = parts = 1

    def __init__(self, accuracy: float, horizon: float, *, ends: bool = True) -> None:
        """Use the accepted error and the length of the run in s; see `AccuracyControl` for an open-ended run."""
        self.goal = Goal(accuracy, horizon, ends)
        self.learnt = self.following = Learnt()

    def stride(self, phase: PhaseState, advance: Advance) -> tuple[int, PhaseState | None]:
        """Return the length of the longest acceptable step, without taking it.

        Raises:
            ConvergenceError: not even a step of 1 ns meets the accuracy.
        """
        chosen = by_method(self.goal, self.learnt, phase, advance)
        if chosen.length == 0:
            raise ConvergenceError(
                f"accuracy {self.goal.accuracy:g} cannot be kept: at simulation time {elapsed(phase):.9g} s a step "
                f"would have to be shorter than 1 ns; {_TOO_FAST}"
            )
        _require_reachable(self.goal, phase, chosen.steady)
        return chosen.length, None

    def begin(self) -> None:
        """Do nothing: every step is chosen independently."""


class AccuracyControl:
    """Steps as long as `accuracy` allows, by step doubling or an embedded pair (Hairer, Norsett & Wanner I, II.4).

    Doubling takes each stride once as a whole and once in two halves; the difference, divided by 2^p - 1, estimates the
    error of the halves, whose result is kept. An embedded pair takes each stride once: the difference of its two
    results estimates the error of the lower order, and the result of the higher order is kept.

    The error is the effect of the stride on attitude (rad) and position at the end of the run: errors of rate and
    velocity are multiplied by the remaining time, those of velocity with drag by less. A stride of h s may add the
    error e = share * accuracy * h / horizon to the attitude. To the position it may add e times the largest distance so
    far or, if that is more, share * accuracy times its own length: together at most twice share * accuracy times the
    distance travelled.

    However short the stride, the two results of doubling differ by some roundings of the rate. If that is more than a
    stride may add, the comparison does not show the error. Then a longer stride is tried, whose results differ by more
    than rounding, and its error is scaled down to the stride by the order of the method. Rounding is not a reason for
    shorter steps; if rounding alone exceeds the accuracy, the accuracy is refused.

    If the motion amplifies errors faster, as near the middle axis or in a chaotic tumble, the total exceeds the
    accuracy, which is then not a bound; `explain` and `trade` show the actual error.

    Attributes:
        goal: requirements on the strides.
        learnt: learnt state after the strides that time has entered.
        following: learnt state after the last chosen stride. Time may never enter that stride, because a new arc may
            begin before.
        embedded: whether the method is an embedded pair.
    """

    denominator = 1

    def __init__(
        self,
        accuracy: float,
        horizon: float,
        order: int,
        inertia: Inertia,
        *,
        start: Vector,
        embedded: bool = False,
        ends: bool = True,
    ) -> None:
        """Use the accepted error, the length of the run in s, and the order of the method.

        `start` is the initial position of the centre of mass, world axes, m. Without `ends`, the run is open-ended and
        the horizon is counted from any time.
        """
        if embedded:
            self.goal = Goal(accuracy, horizon, ends, inertia.mass, order - 1.0, 1.0, 1.0, *start)
        else:
            self.goal = Goal(
                accuracy, horizon, ends, inertia.mass, float(order), 2.0**order - 1.0, _SHARE, *start, noise=_NOISE
            )
        self.learnt = self.following = Learnt()
        self.embedded = embedded
        self.parts = 1 if embedded else 2

    def stride(self, phase: PhaseState, advance: Advance) -> tuple[int, PhaseState | None]:
        """Return the length of an accepted stride and the phase at its end.

        Raises:
            ConvergenceError: not even a stride of 1 ns meets the accuracy.
        """
        trials = _Trials(advance, self.embedded)
        goal = self.goal._replace(slowing=advance.slowing(phase))
        step = self.learnt.step or advance.steady(phase, first_guess(self.goal, phase))
        known = self.learnt._replace(step=min(step, max(advance.sight(phase), 1.0 / NANOSECONDS)))
        length, after, learnt, error, steady = by_trial(goal, known, phase, trials)
        if length == 0 and trials.refused is not None:
            raise ConvergenceError(
                f"accuracy {self.goal.accuracy:g} cannot be kept: at simulation time {elapsed(phase):.9g} s not "
                f"even a step of 1 ns can be taken: {trials.refused}"
            ) from trials.refused
        if length == 0:
            # The load may have no value a little later.
            trials.attempt(phase, _SHORT / NANOSECONDS)
            raise ConvergenceError(
                f"accuracy {self.goal.accuracy:g} cannot be kept: at simulation time {elapsed(phase):.9g} s a step "
                f"of 1 ns has an error of {error:.3g}; "
                + _LOW_ORDER * (self.goal.order <= 2.0)
                + (_TOO_FAST if trials.refused is None else f"one of {_SHORT:g} ns cannot be taken: {trials.refused}")
            )
        # Steps that are short because of a gradual change of the load need not stay short after it.
        lasting = self.goal._replace(horizon=min(self.goal.horizon, advance.settled))
        _require_reachable(lasting, phase, steady)
        self.following = learnt
        return length, after

    def start(self, longest: float = math.inf) -> None:
        """Forget what applies only to the last arc: another wrench has other errors.

        The first stride will be at most `longest` s, if one of a known length could be taken at all.
        """
        self.learnt = self.learnt._replace(until=0.0, step=min(self.learnt.step, longest))

    def begin(self) -> None:
        """Use the last stride as the guess for the next one."""
        self.learnt = self.following


# Steps (ns) this short indicate a discontinuous load, not a strong one.
_SHORT = 1e3
_TOO_FAST = (
    "a load is discontinuous there, and its effect should name the time in knots() and choose the load by `start`, or "
    "it is too strong, as near a centre of gravity into which the body falls; correct it, or accept a larger "
    "solver.accuracy"
)
# However short such a step, its error is as large as the distance it covers.
_LOW_ORDER = (
    "a body that starts from rest needs a method of higher order, such as auto, where its load changes gradually, and "
    "for euler under any load; or "
)


class _Trials:
    """Takes trial strides, and keeps the error of the last one if the method refused it."""

    def __init__(self, advance: Advance, embedded: bool) -> None:
        self._advance, self._embedded = advance, embedded
        self.refused: ConvergenceError | None = None

    def attempt(self, phase: PhaseState, h: float) -> tuple[PhaseState, PhaseState]:
        advance, self.refused = self._advance, None
        try:
            if self._embedded:
                return advance.pair(phase, h)
            return advance(advance(phase, 0.5 * h), 0.5 * h), advance(phase, h)
        except ConvergenceError as refused:
            self.refused = refused
            nowhere = phase._replace(orientation=NO_ATTITUDE)
            return nowhere, nowhere

    def strength(self, phase: PhaseState) -> float:
        return self._advance.strength(phase)


def by_trial(goal: Goal, learnt: Learnt, phase: PhaseState, trials: Any) -> Stride:
    """Return a stride from `phase` on that meets `goal`, found by trial; its length is 0 if there is none.

    `trials` is passed to `_attempt`: in a kernel, body and wrench.
    """
    h = learnt.step if learnt.step > 0.0 else first_guess(goal, phase)
    first = True
    while True:
        length = max(1, round(min(h * NANOSECONDS, _LONGEST)))
        h = length / NANOSECONDS
        kept, other = _attempt(trials, phase, h)
        attitude, position, farthest, noise = estimate(goal, learnt.farthest, phase, kept, other, h, 0.0)
        allowed = goal.share * goal.accuracy * h / goal.horizon
        if position > allowed:
            strength = _strength(trials, phase)
            attitude, position, farthest, noise = estimate(goal, learnt.farthest, phase, kept, other, h, strength)
        if attitude <= noise and noise > allowed:
            if learnt.until <= elapsed(phase):
                learnt = taught(goal, learnt, phase, trials, h, noise)
            attitude = learnt.resolved_error * (h / learnt.resolved_stride) ** (goal.order + 1.0)
        error = max(attitude, position)
        following = following_step(goal, allowed, error, h)
        if error <= allowed:
            return Stride(
                length,
                kept,
                Learnt(following, farthest, learnt.resolved_stride, learnt.resolved_error, learnt.until),
                error,
                steady_length(h, following, first),
            )
        if length == 1:
            return Stride(0, phase, learnt, error, h)
        # Some nanoseconds less may round to the same length.
        h, first = min(following, (length - 1) / NANOSECONDS), False


def following_step(goal: Goal, allowed: float, error: float, h: float) -> float:
    """Return the length (s) of the stride to try after one of h s with this error."""
    following = MOST_GROWTH * h
    if error > 0.0:
        factor = 0.9 * (allowed / error) ** (1.0 / goal.order)
        following = h * min(MOST_GROWTH, max(0.2, factor))
    return following


def steady_length(h: float, following: float, first: bool) -> float:
    """Return the length (s) of strides after one of h s; infinite if it says nothing about them.

    That is so if the `first` trial was good, and the next one may grow in full: after commands in quick succession,
    strides are as short as those, and grow again.
    """
    return math.inf if first and following >= MOST_GROWTH * h else max(h, following)


def taught(goal: Goal, learnt: Learnt, phase: PhaseState, trials: Any, h: float, noise: float) -> Learnt:
    """Return the state learnt from strides longer than h s: from the one that implies the least error of shorter ones.

    Ever longer strides are tried, up to one whose results differ by more than rounding, or to the longest possible one.
    `noise` is the error of the attitude that rounding may hide over h s.
    """
    power, now = goal.order + 1.0, elapsed(phase)
    resolved_stride, resolved_error, trial = h, noise, 2.0 * h
    if learnt.resolved_stride > 0.0:
        guess = learnt.resolved_stride * min(2.0, max(0.5, (4.0 * noise / learnt.resolved_error) ** (1.0 / power)))
        trial = max(trial, min(guess, goal.horizon))
    found = False
    while trial <= goal.horizon:
        kept, other = _attempt(trials, phase, trial)
        attitude, _, _, hidden = estimate(goal, learnt.farthest, phase, kept, other, trial, 0.0)
        if not found and trial > 2.0 * h and not math.isfinite(attitude):
            trial = max(2.0 * h, 0.5 * trial)
            continue
        found = True
        # Add the error that rounding may hide.
        if (attitude + hidden) * (resolved_stride / trial) ** power < resolved_error:
            resolved_stride, resolved_error = trial, attitude + hidden
        if not attitude <= hidden:
            break
        trial *= 2.0
    return Learnt(learnt.step, learnt.farthest, resolved_stride, resolved_error, now + resolved_stride)


def by_method(goal: Goal, learnt: Learnt, phase: PhaseState, advance: Any) -> Stride:
    """Return the longest step from `phase` on that meets `goal` by the method's own error estimate.

    `advance` is passed to `_longest_step`: in a kernel, body and wrench.
    """
    rest = _rest(goal, phase)
    # The same share of the accuracy for each second; errors grow for the rest of the run.
    longest = _longest_step(advance, phase, goal.accuracy * rest / goal.horizon, rest) * NANOSECONDS
    length = int(min(longest, _LONGEST)) if longest >= 1.0 else 0
    return Stride(length, phase, learnt, 0.0, length / NANOSECONDS)


def rounding(goal: Goal, phase: PhaseState, steady: float) -> float:
    """Return the rounding error at the end of the run: each step of `steady` s rounds the rate, as in a random walk.

    0 for an open-ended run, which must not be refused because of rounding over a merely assumed horizon.
    """
    if not goal.ends:
        return 0.0
    rest, rate = _rest(goal, phase), norm(phase.angular_velocity)
    return _EPSILON * (1.0 + rate * rest) * math.sqrt(max(1.0, rest / steady))


def closed_form_rounding(turned: float, start: PhaseState, end: PhaseState, h: float) -> float:
    """Return the rounding error (rad) of rotations by `turned` rad and then for h s from `start` to `end`."""
    return _EPSILON * (1.0 + (turned + max(norm(start.angular_velocity), norm(end.angular_velocity)) * h))


def _rounded_up(error: float) -> float:
    """Return the value rounded up to one digit, so that the number in a message is itself acceptable."""
    unit = float(f"1e{math.floor(math.log10(error))}")
    return math.ceil(error / unit) * unit


def _attempt(trials: _Trials, phase: PhaseState, h: float) -> tuple[PhaseState, PhaseState]:
    """Return two results for the phase after a stride of h s; the first is kept. A kernel has its own version."""
    return trials.attempt(phase, h)


def _strength(trials: _Trials, phase: PhaseState) -> float:
    """Return the sum of the magnitudes (N) of the forces in `phase`. A kernel has its own version."""
    return trials.strength(phase)


def _longest_step(advance: Advance, phase: PhaseState, accuracy: float, horizon: float) -> float:
    """Return the method's longest step. A kernel has its own version."""
    return advance.longest_step(phase, accuracy, horizon)


def first_guess(goal: Goal, phase: PhaseState) -> float:
    """Return a guess for the first stride, s."""
    rate = norm(phase.angular_velocity)
    return min(0.01 * goal.horizon, 0.1 / rate if rate > 0.0 else math.inf)


def estimate(
    goal: Goal, farthest: float, phase: PhaseState, kept: PhaseState, other: PhaseState, h: float, strength: float
) -> tuple[float, float, float, float]:
    """Return the errors that the stride of h s from `phase` to `kept` adds, and the largest distance.

    The errors are those of attitude and position, infinite if the stride is refused, and the error of the attitude that
    rounding may hide. `strength` is the sum of the magnitudes of the forces (N), 0 if they are known not to cancel.
    """
    if not (is_finite(kept) and is_finite(other)):
        return math.inf, math.inf, farthest, 0.0
    return errors_of(goal, farthest, discrepancy(goal, farthest, phase, kept, other, h, strength))


class Discrepancy(NamedTuple):
    """By how much two results for a stride differ.

    Attributes:
        sine, cosine: of half the angle between their attitudes.
        turned: by which their rates let the attitudes differ at the end of the run, rad.
        rounded: rounding error of the attitude, rad.
        position: the same as `estimate` returns, not divided by `Goal.errors`.
        farthest: the largest distance.
    """

    sine: float
    cosine: float
    turned: float
    rounded: float
    position: float
    farthest: float


def errors_of(goal: Goal, farthest: float, found: Discrepancy) -> tuple[float, float, float, float]:
    """Return what `estimate` does for two finite results."""
    # A difference due to rounding is not a reason for shorter steps.
    attitude = angle_of(found.sine, found.cosine) + found.turned - found.rounded
    if not math.isfinite(attitude + found.position):
        return math.inf, math.inf, farthest, 0.0
    parts = goal.errors
    position, hidden = max(0.0, found.position) / parts, goal.noise * found.rounded / parts
    return max(0.0, attitude) / parts, position, found.farthest, hidden


def discrepancy(
    goal: Goal, farthest: float, phase: PhaseState, kept: PhaseState, other: PhaseState, h: float, strength: float
) -> Discrepancy:
    """Return by how much two results for a stride differ; arguments as for `estimate`."""
    rest, rate = _rest(goal, phase), norm(kept.angular_velocity)
    rate_error = norm(subtract(other.angular_velocity, kept.angular_velocity))
    x, y, z, w = multiply(conjugate(other.orientation), kept.orientation)
    rounded = _EPSILON * (1.0 + rate * rest)
    per_mass, moved = 1.0 / goal.mass, norm(gain(phase, kept, POSITION))
    gained = norm(gain(phase, kept, MOMENTUM)) * per_mass
    # The decay rate may fall as 1/t while the body comes to rest.
    grows = math.log1p(goal.slowing * rest) / goal.slowing if goal.slowing > 0.0 else rest
    drift = norm(gain(kept, other, POSITION)) + norm(gain(kept, other, MOMENTUM)) * per_mass * grows
    at_work = strength * per_mass * h
    if gained < _CANCELLED * at_work:
        gained = at_work
    # The compensation of the sums is itself rounded, which shows for a slow body far from the origin.
    at = phase.high
    rounded_away = _EPSILON * norm((at[0], at[1], at[2]))
    drift -= _ROUNDINGS * _EPSILON * (moved + gained * grows + rounded_away)
    # Only where strides begin: what lies beyond the end may be cut off by a command, or only be tried.
    farthest = max(farthest, norm(_away(goal, phase)))
    travelled = max(moved * goal.horizon / h, farthest, norm(_away(goal, kept)))
    position = drift / travelled if travelled > 0.0 else 0.0
    return Discrepancy(norm((x, y, z)), abs(w), rate_error * rest, rounded, position, farthest)


def _away(goal: Goal, phase: PhaseState) -> Vector:
    """Return the position of the centre of mass relative to that at the start of the run, m."""
    high, low = phase.high, phase.low
    return (high[0] - goal.x + low[0], high[1] - goal.y + low[1], high[2] - goal.z + low[2])


def _rest(goal: Goal, phase: PhaseState) -> float:
    """Return the remaining time (s) in which an error grows."""
    return max(goal.horizon - elapsed(phase), 1.0 / NANOSECONDS) if goal.ends else goal.horizon


def _require_reachable(goal: Goal, phase: PhaseState, steady: float) -> None:
    """Refuse an accuracy that rounding alone exceeds, with strides of `steady` s from `phase` on.

    Raises:
        ConvergenceError: names the accuracy that can be reached.
    """
    error = rounding(goal, phase, steady)
    if error > goal.accuracy:
        jumps = steady * NANOSECONDS < _SHORT
        raise ConvergenceError(
            f"accuracy {goal.accuracy:g} cannot be kept: at {norm(phase.angular_velocity):.3g} rad/s in steps of "
            f"{min(steady, _rest(goal, phase)):.3g} s rounding alone adds about {_rounded_up(error):g} rad in "
            f"{_rest(goal, phase):g} s; accept that much, shorten the run, or use a method of higher "
            "order, which takes longer steps"
            + "; or a load is discontinuous there, and its effect should name it in knots() and choose by `start`"
            * jumps
        )
