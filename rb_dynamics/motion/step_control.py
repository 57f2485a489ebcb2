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
from rb_dynamics.numerics.rotation import angle_between
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

_EPSILON = 2.0**-52

# Share of the accuracy for step doubling: errors grow faster than linearly while a body flips. A pair keeps the better
# of its results, and needs no such reserve.
_SHARE = 0.2

# The results of doubling may differ by this many roundings of rate and attitude, besides one, however short the stride:
# half of the strides differ by 0.6 to 2.6 with that one, none of a thousand by more than 10. Those of a pair are
# rounded alike.
_NOISE = 9.0

# Forces of which less than this share is left cancel: what is left of their rounding may then look like an error.
_CANCELLED = 1e-3

# ns; an integer as a float.
_LONGEST = 2.0**62


class Goal(NamedTuple):
    """Requirements on the strides of a run, and how their errors are estimated.

    Attributes:
        accuracy: the accepted error.
        horizon: the time (s) for which it holds.
        ends: whether the run ends with the horizon; otherwise the horizon is counted from any time.
        mass: of the body, kg.
        order: of the result whose error is estimated.
        errors: how many of its errors add up to the difference of two results.
        share: usable share of the accuracy.
        x, y, z: where the centre of mass starts, world axes, m.
        slowing: present rate at which errors of velocity decay, 1/s; see `Advance.slowing`.
        noise: by how many roundings of rate and attitude, besides one, the results may differ without an error.
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
        farthest: largest distance from the start, m: a lower bound of the path, also if the body stops or returns.
        telling: length of a stride whose results differ by more than rounding, s; 0 if none has been needed.
        told: error of attitude that it adds.
        until: its end, s since the start of the run, up to which it represents shorter ones.
    """

    step: float = 0.0
    farthest: float = 0.0
    telling: float = 0.0
    told: float = 0.0
    until: float = 0.0


class Stride(NamedTuple):
    """A chosen stride.

    Attributes:
        length: ns; 0 if not even 1 ns meets the accuracy.
        after: the phase at its end if it was taken to choose it, otherwise that at its start.
        learnt: state of step control after it.
        error: the error that it adds.
    """

    length: int
    after: PhaseState
    learnt: Learnt
    error: float


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
        """Learn from the stride chosen last, when time enters it. A stride never entered must leave no trace."""


class FixedStep:
    """A fixed step; if it is not a whole number of nanoseconds, its remainder is carried exactly.

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
        """Return the step; it has not been taken."""
        return self.length, None

    def begin(self) -> None:
        """Learn nothing: every step is the same."""


class WholeArc:
    """One stride for the whole arc, for a closed form: every time is reached from the start.

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
        """Return the whole arc; it has not been taken."""
        return self.length, None

    def begin(self) -> None:
        """Learn nothing."""


class OwnControl:
    """Steps as long as `accuracy` allows, by the method's own error estimate; see `AccuracyControl`.

    Attributes:
        goal: requirements on the steps.
        learnt: nothing, like `following`.
    """

    denominator = parts = 1

    def __init__(self, accuracy: float, horizon: float, *, ends: bool = True) -> None:
        """Use the accepted error and the length of the run in s; see `AccuracyControl` for an open-ended run."""
        self.goal = Goal(accuracy, horizon, ends)
        self.learnt = self.following = Learnt()

    def stride(self, phase: PhaseState, advance: Advance) -> tuple[int, PhaseState | None]:
        """Return the longest acceptable step; it has not been taken.

        Raises:
            ConvergenceError: not even a step of 1 ns meets the accuracy.
        """
        length = by_method(self.goal, self.learnt, phase, advance).length
        if length == 0:
            raise ConvergenceError(
                f"accuracy {self.goal.accuracy:g} cannot be kept: at simulation time {elapsed(phase):.9g} s a step "
                f"would have to be shorter than 1 ns; {_TOO_FAST}"
            )
        _require_reachable(self.goal, phase, length)
        return length, None

    def begin(self) -> None:
        """Learn nothing: every step is judged on its own."""


class AccuracyControl:
    """Steps as long as `accuracy` allows, by step doubling or an embedded pair (Hairer, Norsett & Wanner I, II.4).

    Doubling takes each stride once as a whole and once in two halves; their difference, over 2^p - 1, estimates the
    error of the halves, which are kept. An embedded pair takes it once: the difference of its two results estimates the
    error of the lower order, and the result of the higher order is kept.

    The error is the effect of the stride on attitude (rad) and position at the end of the run: errors of rate and
    velocity are multiplied by the remaining time, those of velocity with drag by less. A stride h may add a share of
    accuracy * h / horizon to the attitude and, to the position, the same times the largest distance so far or, if that
    is more, a share of accuracy times its own length: together at most twice that of the distance travelled.

    Two results of doubling differ by some roundings of the rate, however short the stride. If that is more than a
    stride may add, their comparison does not show the error: a longer stride is tried, whose results do differ, and its
    error is divided among the strides over the same time according to the order. Rounding is not a reason for shorter
    steps; if rounding alone exceeds the accuracy, the accuracy is refused.

    If the motion amplifies errors faster, as near the middle axis or in a chaotic tumble, the sum exceeds the share:
    the accuracy is then no bound, and `explain` and `trade` show the actual error.

    Attributes:
        goal: requirements on the strides.
        learnt: state after the strides that time has entered.
        following: state after the stride chosen last, which time may never enter: it is also chosen to see where an
            output falls, and a new arc may begin before it does.
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
        """Use the accepted error, the length of the run in s, the order of the method, and whether it is a pair.

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
        known = self.guess(phase, advance)
        known = known._replace(step=min(known.step, max(advance.sight(phase), 1.0 / NANOSECONDS)))
        length, after, learnt, error = by_trial(goal, known, phase, trials)
        if length == 0 and trials.refused is not None:
            raise ConvergenceError(
                f"accuracy {self.goal.accuracy:g} cannot be kept: at simulation time {elapsed(phase):.9g} s not "
                f"even a step of 1 ns can be taken: {trials.refused}"
            ) from trials.refused
        if length == 0:
            raise ConvergenceError(
                f"accuracy {self.goal.accuracy:g} cannot be kept: at simulation time {elapsed(phase):.9g} s a step "
                f"of 1 ns has an error of {error:.3g}; {_TOO_FAST}"
            )
        # The short steps for a load that changes gradually end with it.
        lasting = self.goal._replace(horizon=min(self.goal.horizon, advance.settled))
        _require_reachable(lasting, phase, max(length, learnt.step * NANOSECONDS))
        self.following = learnt
        return length, after

    def guess(self, phase: PhaseState, advance: Advance) -> Learnt:
        """Return what is learnt, with a guess for the next stride from `phase` on."""
        return self.learnt._replace(step=self.learnt.step or advance.steady(phase, _first(self.goal, phase)))

    def start(self) -> None:
        """Forget what applies only to the last arc: another wrench has other errors."""
        self.learnt = self.learnt._replace(until=0.0)

    def begin(self) -> None:
        """Use the last stride as the guess for the next one."""
        self.learnt = self.following


# Steps (ns) this short come from a load that jumps rather than from one that is strong.
_SHORT = 1e3
_TOO_FAST = (
    "a load jumps there, whose effect should name the time in its knots(), or is too strong; correct it, or accept a "
    "larger solver.accuracy"
)


class _Trials:
    """Takes trial strides, and keeps the refusal of the last one, if the method refused it."""

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
    h = learnt.step if learnt.step > 0.0 else _first(goal, phase)
    while True:
        length = max(1, round(min(h * NANOSECONDS, _LONGEST)))
        h = length / NANOSECONDS
        kept, other = _attempt(trials, phase, h)
        attitude, position, farthest, noise = _estimate(goal, learnt.farthest, phase, kept, other, h, 0.0)
        allowed = goal.share * goal.accuracy * h / goal.horizon
        if position > allowed:
            strength = _strength(trials, phase)
            attitude, position, farthest, noise = _estimate(goal, learnt.farthest, phase, kept, other, h, strength)
        if attitude <= noise and noise > allowed:
            if learnt.until <= elapsed(phase):
                learnt = taught(goal, learnt, phase, trials, h, noise)
            attitude = learnt.told * (h / learnt.telling) ** (goal.order + 1.0)
        error = max(attitude, position)
        following = 5.0 * h
        if error > 0.0:
            factor = 0.9 * (allowed / error) ** (1.0 / goal.order)
            following = h * min(5.0, max(0.2, factor))
        if error <= allowed:
            return Stride(length, kept, Learnt(following, farthest, learnt.telling, learnt.told, learnt.until), error)
        if length == 1:
            return Stride(0, phase, learnt, error)
        # A few nanoseconds less may round to the same.
        h = min(following, (length - 1) / NANOSECONDS)


def taught(goal: Goal, learnt: Learnt, phase: PhaseState, trials: Any, h: float, noise: float) -> Learnt:
    """Return the state learnt from strides longer than h s: the one that leaves the smallest error to shorter ones.

    They are tried up to one whose results differ by more than rounding, or to the longest possible one. `noise` is the
    error of attitude that rounding hides over h s.
    """
    power, now = goal.order + 1.0, elapsed(phase)
    telling, told, trial = h, noise, 2.0 * h
    if learnt.telling > 0.0:
        trial = max(trial, learnt.telling * min(2.0, max(0.5, (4.0 * noise / learnt.told) ** (1.0 / power))))
    found = False
    while trial <= goal.horizon:
        kept, other = _attempt(trials, phase, trial)
        attitude, _, _, hidden = _estimate(goal, learnt.farthest, phase, kept, other, trial, 0.0)
        if not found and trial > 2.0 * h and not math.isfinite(attitude):
            trial = max(2.0 * h, 0.5 * trial)
            continue
        found = True
        # Add the error that rounding hides.
        if (attitude + hidden) * (telling / trial) ** power < told:
            telling, told = trial, attitude + hidden
        if not attitude <= hidden:
            break
        trial *= 2.0
    return Learnt(learnt.step, learnt.farthest, telling, told, now + telling)


def by_method(goal: Goal, learnt: Learnt, phase: PhaseState, advance: Any) -> Stride:
    """Return the longest step from `phase` on that meets `goal` by the method's own error estimate.

    `advance` is passed to `_longest_step`: in a kernel, body and wrench.
    """
    rest = _rest(goal, phase)
    # The same share of the accuracy per second; errors grow for the rest of the run.
    longest = _longest_step(advance, phase, goal.accuracy * rest / goal.horizon, rest) * NANOSECONDS
    return Stride(int(min(longest, _LONGEST)) if longest >= 1.0 else 0, phase, learnt, 0.0)


def rounding(goal: Goal, phase: PhaseState, length: float) -> float:
    """Return the rounding error at the end: each step of `length` ns rounds the rate, a random walk.

    0 for an open-ended run, which must not be stopped because of rounding over an assumed horizon.
    """
    if not goal.ends:
        return 0.0
    rest, rate = _rest(goal, phase), norm(phase.angular_velocity)
    return _EPSILON * (1.0 + rate * rest) * math.sqrt(max(1.0, rest / (length / NANOSECONDS)))


def closed_form_rounding(turned: float, start: PhaseState, end: PhaseState, h: float) -> float:
    """Return the error that rounding adds to a turn of `turned` rad and then one of h s from `start` to `end`, rad."""
    return _EPSILON * (1.0 + (turned + max(norm(start.angular_velocity), norm(end.angular_velocity)) * h))


def _rounded_up(error: float) -> float:
    """Return the value rounded up to one digit, which can be accepted as printed."""
    unit = float(f"1e{math.floor(math.log10(error))}")
    return math.ceil(error / unit) * unit


def _attempt(trials: _Trials, phase: PhaseState, h: float) -> tuple[PhaseState, PhaseState]:
    """Return the phase after a stride of h s, and another for its error. A kernel has its own version."""
    return trials.attempt(phase, h)


def _strength(trials: _Trials, phase: PhaseState) -> float:
    """Return the sum of the magnitudes (N) of the forces in `phase`. A kernel has its own version."""
    return trials.strength(phase)


def _longest_step(advance: Advance, phase: PhaseState, accuracy: float, horizon: float) -> float:
    """Return the method's longest step. A kernel has its own version."""
    return advance.longest_step(phase, accuracy, horizon)


def _first(goal: Goal, phase: PhaseState) -> float:
    rate = norm(phase.angular_velocity)
    return min(0.01 * goal.horizon, 0.1 / rate if rate > 0.0 else math.inf)


def _estimate(
    goal: Goal, farthest: float, phase: PhaseState, kept: PhaseState, other: PhaseState, h: float, strength: float
) -> tuple[float, float, float, float]:
    """Return the error that the stride of h s from `phase` to `kept` adds, and the largest distance.

    Its errors of attitude and position, infinite if it is refused, and the error of the attitude that rounding may
    hide. `strength` is the sum of the magnitudes of the forces (N), 0 if they are known not to cancel.
    """
    if not (is_finite(kept) and is_finite(other)):
        return math.inf, math.inf, farthest, 0.0
    rest, rate = _rest(goal, phase), norm(kept.angular_velocity)
    rate_error = norm(subtract(other.angular_velocity, kept.angular_velocity))
    attitude = angle_between(other.orientation, kept.orientation) + rate_error * rest
    # A difference by rounding is not a reason for shorter steps.
    rounded = _EPSILON * (1.0 + rate * rest)
    attitude -= rounded
    per_mass, moved = 1.0 / goal.mass, norm(gain(phase, kept, POSITION))
    gained = norm(gain(phase, kept, MOMENTUM)) * per_mass
    # The decay rate may fall like 1/t while the body comes to rest, and errors with it.
    grows = math.log1p(goal.slowing * rest) / goal.slowing if goal.slowing > 0.0 else rest
    drift = norm(gain(kept, other, POSITION)) + norm(gain(kept, other, MOMENTUM)) * per_mass * grows
    at_work = strength * per_mass * h
    if gained < _CANCELLED * at_work:
        gained = at_work
    drift -= 4.0 * _EPSILON * (moved + gained * grows)
    farthest = max(farthest, norm(_away(goal, phase)), norm(_away(goal, kept)))
    travelled = max(moved * goal.horizon / h, farthest)
    position = drift / travelled if travelled > 0.0 else 0.0
    if not math.isfinite(attitude + position):
        return math.inf, math.inf, farthest, 0.0
    parts = goal.errors
    return max(0.0, attitude) / parts, max(0.0, position) / parts, farthest, goal.noise * rounded / parts


def _away(goal: Goal, phase: PhaseState) -> Vector:
    """Return the position of the centre of mass relative to that at the start of the run, m."""
    high, low = phase.high, phase.low
    return (high[0] - goal.x + low[0], high[1] - goal.y + low[1], high[2] - goal.z + low[2])


def _rest(goal: Goal, phase: PhaseState) -> float:
    """Return the remaining time (s) in which an error grows."""
    return max(goal.horizon - elapsed(phase), 1.0 / NANOSECONDS) if goal.ends else goal.horizon


def _require_reachable(goal: Goal, phase: PhaseState, length: float) -> None:
    """Refuse an accuracy that rounding alone exceeds, with strides of `length` ns from `phase` on.

    Raises:
        ConvergenceError: names the accuracy that can be reached.
    """
    error = rounding(goal, phase, length)
    if error > goal.accuracy:
        jumps = length < _SHORT
        raise ConvergenceError(
            f"accuracy {goal.accuracy:g} cannot be kept: at {norm(phase.angular_velocity):.3g} rad/s in steps of "
            f"{length / NANOSECONDS:.3g} s rounding alone adds about {_rounded_up(error):g} rad in "
            f"{_rest(goal, phase):g} s; accept that much, shorten the run, or use a method of higher "
            "order, which takes longer steps"
            + "; or a load jumps there, whose effect should name the time in its knots()"
            * jumps
        )
