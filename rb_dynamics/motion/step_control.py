"""Step control: chooses the grid of an arc, by a fixed step or by the accuracy that the user asks for.

It sees a method only as a function that advances a phase. The functions that choose a step work on plain floats, and
`adaptive_kernel.py` compiles them as they are.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any, NamedTuple, Protocol

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.motion.method import Inertia
from rb_dynamics.motion.phase import MOMENTUM, POSITION, Phase, elapsed, gain, is_finite
from rb_dynamics.motion.step_checks import NO_ATTITUDE
from rb_dynamics.numerics.nanoseconds import NANOSECONDS
from rb_dynamics.numerics.rotation import angle_between
from rb_dynamics.numerics.vector import Vector, norm, subtract


class Advance(Protocol):
    """A method, the body that it moves and what acts on it."""

    def __call__(self, phase: Phase, h: float) -> Phase:
        """Return the phase after a step of h s."""

    def pair(self, phase: Phase, h: float) -> tuple[Phase, Phase]:
        """Return the phase after a step of h s, and the same of one order less."""

    def longest_step(self, phase: Phase, accuracy: float, horizon: float) -> float:
        """Return the longest step in s that adds at most accuracy * step / horizon to the error at the end."""

    def slowing(self, phase: Phase) -> float:
        """Return the rate (1/s) at which drag makes differences of speed die down in `phase`; 0 without drag."""

    def steady(self, phase: Phase, longest: float) -> float:
        """Return for how long (s), at most `longest`, the load stays near what it is in `phase`."""

    def sight(self, phase: Phase) -> float:
        """Return for how long (s) from `phase` on the load there tells what comes."""


MOST_STEPS = 10**12
"""Steps of a fixed length in one run: compiled they take days."""

_EPSILON = 2.0**-52

# What doubling may use up of the accuracy: errors grow faster than linearly while a body turns over its middle
# axis. A pair keeps the better one of its results, and has that in hand.
_SHARE = 0.2

# By so many roundings of rate and attitude the results of doubling may differ, beside one, however short the stride is:
# half of the strides by 0.6 to 2.6 with the one, of a thousand none by more than 10. Those of a pair are rounded alike.
_NOISE = 9.0

# ns; whole, and a float.
_LONGEST = 2.0**62


class Goal(NamedTuple):
    """What the strides of a run have to keep to, and how their errors are estimated.

    Attributes:
        accuracy: the accepted error.
        horizon: the time (s) over which it is kept.
        ends: whether the run ends with the horizon; where it does not, the horizon is counted from any time.
        mass: of the body, kg.
        order: of the result whose error is estimated.
        errors: how many of its errors make up the difference of two results.
        share: what may be used up of the accuracy.
        x, y, z: where the centre of mass starts, world axes, m.
        slowing: at which errors of velocity die down now, 1/s; see `Advance.slowing`.
        noise: by how many roundings of rate and attitude, beside one, the results may differ without an error.
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
    """What strides teach.

    Attributes:
        step: near which the next one is sought, s; 0 before the first.
        farthest: from the start, m: so far the body has travelled at least, whether it comes to rest or returns.
        telling: length of a stride whose results differ by more than rounding, s; 0 where none has been needed.
        told: error of attitude that it adds.
        until: the time that it reaches, s since the start of the run: until then it stands for the shorter ones.
    """

    step: float = 0.0
    farthest: float = 0.0
    telling: float = 0.0
    told: float = 0.0
    until: float = 0.0


class Stride(NamedTuple):
    """A stride that has been chosen.

    Attributes:
        length: ns; 0 if not even 1 ns keeps the accuracy.
        after: the phase at its end where choosing it meant taking it, else that at its start.
        learnt: what it teaches.
        error: which it adds.
    """

    length: int
    after: Phase
    learnt: Learnt
    error: float


class StepControl(Protocol):
    """Chooses the grid of an arc. Lengths of strides are integers in units of 1/`denominator` ns.

    Attributes:
        denominator: of the unit of time.
        parts: equal steps that are as accurate as a stride over the same time.
    """

    denominator: int
    parts: int

    def stride(self, phase: Phase, advance: Advance) -> tuple[int, Phase | None]:
        """Return the length of the next stride and, where choosing it meant taking it, the phase at its end."""

    def begin(self) -> None:
        """Learn from the stride that was chosen last: time goes into it. What is never entered must leave no trace."""


class FixedStep:
    """A fixed step; where it is no whole number of nanoseconds its remainder is carried exactly.

    Attributes:
        length: of every stride, in units of 1/`denominator` ns.
    """

    parts = 1

    def __init__(self, step: float) -> None:
        """Take the step in s, as the decimal number that the user wrote."""
        exact = Fraction(repr(float(step))) * NANOSECONDS
        self.denominator = exact.denominator
        self.length = exact.numerator

    def require_few(self, time_ns: int, name: str = "step", error: type[Exception] = ValueError) -> None:
        """Let pass a run of `time_ns` that takes at most `MOST_STEPS` steps.

        Raises:
            Exception: `error`, as it would run on for days, years or ages.
        """
        count = time_ns * self.denominator // self.length
        if count > MOST_STEPS:
            step, time = self.length / self.denominator / NANOSECONDS, time_ns / NANOSECONDS
            raise error(
                f"{name} is {step:g} s, which makes {count:.3g} steps in {time:g} s, expected at most {MOST_STEPS:g}: "
                f"that many take days; take a step of {time / MOST_STEPS:.2g} s or more"
            )

    def stride(self, phase: Phase, advance: Advance) -> tuple[int, Phase | None]:
        """Return the step; it has not been taken."""
        return self.length, None

    def begin(self) -> None:
        """Learn nothing: every step is the same."""


class WholeArc:
    """One stride for the whole arc, for a method in closed form: every time is reached from the start.

    Attributes:
        length: of the stride, ns: longer than any run.
    """

    denominator = parts = 1
    length = 2**64

    def __init__(self, accuracy: float = math.inf, turned: float = 0.0) -> None:
        """Take the accepted error, and the turn (rad) that lies behind the arc."""
        self._accuracy, self._turned = accuracy, turned

    def require_known(self, start: Phase, end: Phase, h: float) -> None:
        """Let pass a way of h s from `start` to `end` after which rounding leaves the accuracy.

        Raises:
            ConvergenceError: names the accuracy that can be reached.
        """
        turned = self._turned + max(norm(start.angular_velocity), norm(end.angular_velocity)) * h
        error = _EPSILON * (1.0 + turned)
        if error > self._accuracy:
            raise ConvergenceError(
                f"accuracy {self._accuracy:g} cannot be kept: in closed form too, rounding alone adds about "
                f"{_rounded_up(error):g} rad in a turn of {turned:.3g} rad; accept that much as solver.accuracy, or "
                "shorten the run"
            )

    def stride(self, phase: Phase, advance: Advance) -> tuple[int, Phase | None]:
        """Return the whole arc; it has not been taken."""
        return self.length, None

    def begin(self) -> None:
        """Learn nothing."""


class OwnControl:
    """Steps as long as `accuracy` allows, by the method's own knowledge of its error; see `AccuracyControl`.

    Attributes:
        goal: what the steps have to keep to.
        learnt: nothing, like `following`.
    """

    denominator = parts = 1

    def __init__(self, accuracy: float, horizon: float, *, ends: bool = True) -> None:
        """Take the accepted error and the length of the run in s; see `AccuracyControl` for a run that has no end."""
        self.goal = Goal(accuracy, horizon, ends)
        self.learnt = self.following = Learnt()

    def stride(self, phase: Phase, advance: Advance) -> tuple[int, Phase | None]:
        """Return the longest step there is; it has not been taken.

        Raises:
            ConvergenceError: not even a step of 1 ns keeps the accuracy.
        """
        length = by_method(self.goal, self.learnt, phase, advance).length
        if length == 0:
            raise ConvergenceError(
                f"accuracy {self.goal.accuracy:g} cannot be kept: at simulation time {elapsed(phase):.9g} s a step "
                "would have to be shorter than 1 ns; "
                "accept a larger solver.accuracy or check the size of the wrench"
            )
        _require_reachable(self.goal, phase, length)
        return length, None

    def begin(self) -> None:
        """Learn nothing: every step is judged by itself."""


class AccuracyControl:
    """Steps as long as `accuracy` allows, by step doubling or an embedded pair (Hairer, Norsett & Wanner I, II.4).

    Doubling takes each stride once whole and once in two halves; their difference, over 2^p - 1, estimates the error
    of the halves, which are kept. An embedded pair takes it once: the difference of its two results estimates the
    error of the lower order, and the result of the higher order is kept.

    The error is what the stride adds to attitude (rad) and to position at the end of the run: errors of rate and
    velocity count with the time they have to grow, linearly, and those of velocity less under drag. A stride h may add
    a share of accuracy * h / horizon to the attitude and, to the position, the same of the distance to the farthest
    place so far or, if that is more, a share of accuracy of what it travels itself: together no more than twice that of
    the distance travelled.

    Two results of doubling differ by some roundings of the rate, however short the stride. Where that is more than a
    stride may add, no comparison over it tells its error: a longer one is taken on trial, whose results do differ, and
    its error divided among the strides over the same time as the order says. Rounding itself is no reason to step
    shorter; where it alone leaves the accuracy, that is refused.

    Where the motion amplifies errors faster, as near the middle axis or in a chaotic tumble,
    more than the share comes together: the accuracy is no bound there, and `explain` and `trade` show what is reached.

    Attributes:
        goal: what the strides have to keep to.
        learnt: what the strides that time has gone into teach.
        following: the same with the stride chosen last, into which time may never go: it is also chosen to see where
            an output falls, and a new arc may begin before it does.
        embedded: whether by a pair.
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
        """Take the accepted error, the length of the run in s, the order of the method, and whether it is a pair.

        `start` is where the centre of mass is at the start of the run, world axes, m. Where the run has no end
        (`ends`), the horizon is what the accuracy is kept over, counted from any time.
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

    def stride(self, phase: Phase, advance: Advance) -> tuple[int, Phase | None]:
        """Return the length of an accepted stride and the phase at its end.

        Raises:
            ConvergenceError: not even a stride of 1 ns keeps the accuracy.
        """
        trials = _Trials(advance, self.embedded)
        goal = self.goal._replace(slowing=advance.slowing(phase))
        step = self.learnt.step or advance.steady(phase, _first(goal, phase))
        known = self.learnt._replace(step=min(step, max(advance.sight(phase), 1.0 / NANOSECONDS)))
        length, after, learnt, error = by_trial(goal, known, phase, trials)
        if length == 0 and trials.refused is not None:
            raise ConvergenceError(
                f"accuracy {self.goal.accuracy:g} cannot be kept: at simulation time {elapsed(phase):.9g} s not "
                f"even a step of 1 ns can be taken: {trials.refused}"
            ) from trials.refused
        if length == 0:
            raise ConvergenceError(
                f"accuracy {self.goal.accuracy:g} cannot be kept: at simulation time {elapsed(phase):.9g} s a step "
                f"of 1 ns has an error of {error:.3g}; accept a larger solver.accuracy or check the size of the wrench"
            )
        _require_reachable(self.goal, phase, max(length, learnt.step * NANOSECONDS))
        self.following = learnt
        return length, after

    def start(self) -> None:
        """Forget what holds for the last arc alone: another wrench has errors of its own."""
        self.learnt = self.learnt._replace(until=0.0)

    def begin(self) -> None:
        """Let the next stride be sought near what the last one suggests."""
        self.learnt = self.following


class _Trials:
    """Takes strides on trial, and remembers the last that the method refused."""

    def __init__(self, advance: Advance, embedded: bool) -> None:
        self._advance, self._embedded = advance, embedded
        self.refused: ConvergenceError | None = None

    def attempt(self, phase: Phase, h: float) -> tuple[Phase, Phase]:
        advance = self._advance
        try:
            if self._embedded:
                return advance.pair(phase, h)
            return advance(advance(phase, 0.5 * h), 0.5 * h), advance(phase, h)
        except ConvergenceError as refused:
            self.refused = refused
            nowhere = phase._replace(orientation=NO_ATTITUDE)
            return nowhere, nowhere


def by_trial(goal: Goal, learnt: Learnt, phase: Phase, trials: Any) -> Stride:
    """Return a stride from `phase` on that keeps to `goal`, found by trial; its length is 0 if there is none.

    `trials` is what `_attempt` takes strides by: in a kernel body and wrench.
    """
    h = learnt.step if learnt.step > 0.0 else _first(goal, phase)
    while True:
        length = max(1, round(min(h * NANOSECONDS, _LONGEST)))
        h = length / NANOSECONDS
        kept, other = _attempt(trials, phase, h)
        attitude, position, farthest, noise = _estimate(goal, learnt.farthest, phase, kept, other, h)
        allowed = goal.share * goal.accuracy * h / goal.horizon
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
        # A few nanoseconds less may be rounded to the same.
        h = min(following, (length - 1) / NANOSECONDS)


def taught(goal: Goal, learnt: Learnt, phase: Phase, trials: Any, h: float, noise: float) -> Learnt:
    """Return what strides longer than h s teach: the one that leaves the smallest error to the shorter ones.

    They are taken on trial up to one whose results differ by more than rounding, or to the longest that can be taken.
    `noise` is the error of attitude that rounding hides over h s.
    """
    power, now = goal.order + 1.0, elapsed(phase)
    telling, told, trial = h, noise, 2.0 * h
    if learnt.telling > 0.0:
        trial = max(trial, learnt.telling * min(2.0, max(0.5, (4.0 * noise / learnt.told) ** (1.0 / power))))
    found = False
    while trial <= goal.horizon:
        kept, other = _attempt(trials, phase, trial)
        attitude, _, _, hidden = _estimate(goal, learnt.farthest, phase, kept, other, trial)
        if not found and trial > 2.0 * h and not math.isfinite(attitude):
            trial = max(2.0 * h, 0.5 * trial)
            continue
        found = True
        # What rounding hides comes on top.
        if (attitude + hidden) * (telling / trial) ** power < told:
            telling, told = trial, attitude + hidden
        if not attitude <= hidden:
            break
        trial *= 2.0
    return Learnt(learnt.step, learnt.farthest, telling, told, now + telling)


def by_method(goal: Goal, learnt: Learnt, phase: Phase, advance: Any) -> Stride:
    """Return the longest step from `phase` on that keeps to `goal` by what the method itself knows of its error.

    `advance` is what `_longest_step` asks: in a kernel body and wrench.
    """
    rest = _rest(goal, phase)
    # The same share of the accuracy for each second, errors grow for the rest of the run.
    longest = _longest_step(advance, phase, goal.accuracy * rest / goal.horizon, rest) * NANOSECONDS
    return Stride(int(min(longest, _LONGEST)) if longest >= 1.0 else 0, phase, learnt, 0.0)


def rounding(goal: Goal, phase: Phase, length: float) -> float:
    """Return the error that rounding adds by the end: each step of `length` ns rounds the rate, a random walk.

    0 where the run has no end: what flies is not stopped for what an hour of such steps would add.
    """
    if not goal.ends:
        return 0.0
    rest, rate = _rest(goal, phase), norm(phase.angular_velocity)
    return _EPSILON * (1.0 + rate * rest) * math.sqrt(max(1.0, rest / (length / NANOSECONDS)))


def _rounded_up(error: float) -> float:
    """Return the next number of one digit: it can be accepted as it is said."""
    unit = float(f"1e{math.floor(math.log10(error))}")
    return math.ceil(error / unit) * unit


def _attempt(trials: _Trials, phase: Phase, h: float) -> tuple[Phase, Phase]:
    """Return the phase after a stride of h s, and another that tells its error. A kernel has its own."""
    return trials.attempt(phase, h)


def _longest_step(advance: Advance, phase: Phase, accuracy: float, horizon: float) -> float:
    """Return what the method says. A kernel has its own."""
    return advance.longest_step(phase, accuracy, horizon)


def _first(goal: Goal, phase: Phase) -> float:
    rate = norm(phase.angular_velocity)
    return min(0.01 * goal.horizon, 0.1 / rate if rate > 0.0 else math.inf)


def _estimate(
    goal: Goal, farthest: float, phase: Phase, kept: Phase, other: Phase, h: float
) -> tuple[float, float, float, float]:
    """Return what the stride of h s from `phase` to `kept` adds, and the farthest.

    That is its errors of attitude and position, infinite if it is refused, and then that of the attitude that rounding
    may hide.
    """
    if not (is_finite(kept) and is_finite(other)):
        return math.inf, math.inf, farthest, 0.0
    rest, rate = _rest(goal, phase), norm(kept.angular_velocity)
    rate_error = norm(subtract(other.angular_velocity, kept.angular_velocity))
    attitude = angle_between(other.orientation, kept.orientation) + rate_error * rest
    # What rounding alone makes of the difference is no reason to step shorter.
    rounded = _EPSILON * (1.0 + rate * rest)
    attitude -= rounded
    per_mass, moved = 1.0 / goal.mass, norm(gain(phase, kept, POSITION))
    gained = norm(gain(phase, kept, MOMENTUM)) * per_mass
    # The slowing may fall like 1/t while the body comes to rest, and errors with it.
    grows = math.log1p(goal.slowing * rest) / goal.slowing if goal.slowing > 0.0 else rest
    drift = norm(gain(kept, other, POSITION)) + norm(gain(kept, other, MOMENTUM)) * per_mass * grows
    drift -= 4.0 * _EPSILON * (moved + gained * grows)
    farthest = max(farthest, norm(_away(goal, phase)), norm(_away(goal, kept)))
    travelled = max(moved * goal.horizon / h, farthest)
    position = drift / travelled if travelled > 0.0 else 0.0
    if not math.isfinite(attitude + position):
        return math.inf, math.inf, farthest, 0.0
    parts = goal.errors
    return max(0.0, attitude) / parts, max(0.0, position) / parts, farthest, goal.noise * rounded / parts


def _away(goal: Goal, phase: Phase) -> Vector:
    """Return where the centre of mass is, seen from where it was at the start of the run, m."""
    high, low = phase.high, phase.low
    return (high[0] - goal.x + low[0], high[1] - goal.y + low[1], high[2] - goal.z + low[2])


def _rest(goal: Goal, phase: Phase) -> float:
    """Return for how long (s) an error has time to grow."""
    return max(goal.horizon - elapsed(phase), 1.0 / NANOSECONDS) if goal.ends else goal.horizon


def _require_reachable(goal: Goal, phase: Phase, length: float) -> None:
    """Refuse an accuracy that rounding alone does not leave, in strides of `length` ns from `phase` on.

    Raises:
        ConvergenceError: names the accuracy that can be reached.
    """
    error = rounding(goal, phase, length)
    if error > goal.accuracy:
        raise ConvergenceError(
            f"accuracy {goal.accuracy:g} cannot be kept: at {norm(phase.angular_velocity):.3g} rad/s in steps of "
            f"{length / NANOSECONDS:.3g} s rounding alone adds about {_rounded_up(error):g} rad in "
            f"{_rest(goal, phase):g} s; accept that much, shorten the run, or use a method of higher "
            "order, which takes longer steps"
        )
