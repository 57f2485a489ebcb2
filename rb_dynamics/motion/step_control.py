"""Step control: chooses the grid of an arc, by a fixed step or by the accuracy that the user accepts.

Sees a method only as a function that advances a phase; never knows the group behind it.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Protocol

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.motion.method import Inertia
from rb_dynamics.motion.phase import Phase
from rb_dynamics.rotation import angle_between
from rb_dynamics.vector import norm, scale, subtract


class Advance(Protocol):
    """A method under a held wrench."""

    def __call__(self, phase: Phase, h: float) -> Phase:
        """Return the phase after a step of h s."""

    def pair(self, phase: Phase, h: float) -> tuple[Phase, Phase]:
        """Return the phase after a step of h s, and the same of one order less."""

    def longest_step(self, phase: Phase, accuracy: float, horizon: float) -> float:
        """Return the longest step in s that adds at most accuracy * step / horizon to the error at the end."""


NANOSECONDS = 1_000_000_000
_EPSILON = 2.0**-52

# What doubling may use up of the accuracy: errors grow faster than linearly while a body turns over its middle
# axis. A pair keeps the better one of its results, and has that in hand.
_SHARE = 0.2


class StepControl(Protocol):
    """Chooses the grid of an arc. Lengths of strides are integers in units of 1/`denominator` ns."""

    denominator: int

    def stride(self, phase: Phase, advance: Advance) -> tuple[int, Phase | None]:
        """Return the length of the next stride and, where choosing it meant taking it, the phase at its end."""

    def begin(self) -> None:
        """Learn from the stride that was chosen last: time goes into it. What is never entered must leave no trace."""

    def refine(self, phase: Phase, advance: Advance, h: float) -> Phase:
        """Return the phase h s into a stride, as accurate as the stride."""


class FixedStep:
    """A fixed step; where it is no whole number of nanoseconds its remainder is carried exactly.

    Attributes:
        length: of every stride, in units of 1/`denominator` ns.
    """

    def __init__(self, step: float) -> None:
        """Take the step in s, as the decimal number that the user wrote."""
        exact = Fraction(repr(float(step))) * NANOSECONDS
        self.denominator = exact.denominator
        self.length = exact.numerator

    def stride(self, phase: Phase, advance: Advance) -> tuple[int, Phase | None]:
        """Return the step; it has not been taken."""
        return self.length, None

    def begin(self) -> None:
        """Learn nothing: every step is the same."""

    def refine(self, phase: Phase, advance: Advance, h: float) -> Phase:
        """Return the phase after one step of h s."""
        return advance(phase, h)


class WholeArc:
    """One stride for the whole arc, for a method in closed form: every time is reached from the start."""

    denominator = 1

    def stride(self, phase: Phase, advance: Advance) -> tuple[int, Phase | None]:
        """Return a stride longer than any run."""
        return 2**64, None

    def begin(self) -> None:
        """Learn nothing."""

    def refine(self, phase: Phase, advance: Advance, h: float) -> Phase:
        """Return the phase h s after the start of the arc."""
        return advance(phase, h)


class OwnControl:
    """Steps as long as `accuracy` allows, by the method's own knowledge of its error; see `AccuracyControl`."""

    denominator = 1

    def __init__(self, accuracy: float, horizon: float, *, ends: bool = True) -> None:
        """Take the accepted error and the length of the run in s; see `AccuracyControl` for a run that has no end."""
        self._accuracy, self._horizon, self._ends = accuracy, horizon, ends

    def stride(self, phase: Phase, advance: Advance) -> tuple[int, Phase | None]:
        """Return the longest step there is; it has not been taken.

        Raises:
            ConvergenceError: not even a step of 1 ns keeps the accuracy.
        """
        rate, rest = norm(phase.angular_velocity), _rest(phase, self._horizon, self._ends)
        # The same share of the accuracy for each second, errors grow for the rest of the run.
        share = self._accuracy * rest / self._horizon
        h_ns = int(min(advance.longest_step(phase, share, rest) * NANOSECONDS, 2.0**62))
        if h_ns < 1:
            raise ConvergenceError(
                f"accuracy {self._accuracy:g} cannot be kept: a step would have to be shorter than 1 ns; "
                "accept a larger solver.accuracy or check the size of the wrench"
            )
        _require_reachable(self._accuracy, rest, h_ns / NANOSECONDS, rate)
        return h_ns, None

    def begin(self) -> None:
        """Learn nothing: every step is judged by itself."""

    def refine(self, phase: Phase, advance: Advance, h: float) -> Phase:
        """Return the phase after one step of h s, which is shorter than the longest."""
        return advance(phase, h)


class AccuracyControl:
    """Steps as long as `accuracy` allows, by step doubling or an embedded pair (Hairer, Norsett & Wanner I, II.4).

    Doubling takes each stride once whole and once in two halves; their difference, over 2^p - 1, estimates the error
    of the halves, which are kept. An embedded pair takes it once: the difference of its two results estimates the
    error of the lower order, and the result of the higher order is kept.

    The error is what the stride adds to attitude (rad) and, relative to the distance travelled, to position at the end
    of the run: errors of rate and velocity count with the time they have to grow, linearly. A stride h may add a share
    of accuracy * h / horizon. Where the motion amplifies errors faster, as near the middle axis or in a chaotic tumble,
    more than the share comes together: the accuracy is no bound there, and `explain` and `trade` show what is reached.
    """

    denominator = 1

    def __init__(
        self,
        accuracy: float,
        horizon: float,
        order: int,
        inertia: Inertia,
        *,
        embedded: bool = False,
        ends: bool = True,
    ) -> None:
        """Take the accepted error, the length of the run in s, the order of the method, and whether it is a pair.

        Where the run has no end (`ends`), the horizon is what the accuracy is kept over, counted from any time.
        """
        self._accuracy, self._horizon, self._inertia, self._ends = accuracy, horizon, inertia, ends
        self._embedded = embedded
        # The order of the result whose error is estimated, and how many of its errors make up the difference.
        self._order = order - 1 if embedded else order
        self._errors = 1.0 if embedded else 2.0**order - 1.0
        self._share = 1.0 if embedded else _SHARE
        # What the stride chosen last suggests for the next one, and what the last one entered did: a stride is also
        # chosen to see where an output falls, and a new arc may begin before it does.
        self._next = self._learnt = 0.0
        # The largest speed, likewise: the distance travelled is not short because a body has come to rest.
        self._speed = self._fastest = 0.0

    def stride(self, phase: Phase, advance: Advance) -> tuple[int, Phase | None]:
        """Return the length of an accepted stride and the phase at its end.

        Raises:
            ConvergenceError: not even a stride of 1 ns keeps the accuracy.
        """
        h = self._learnt or self._first(phase)
        failure: ConvergenceError | None = None
        while True:
            h_ns = max(1, min(round(h * NANOSECONDS), 2**62))
            h = h_ns / NANOSECONDS
            try:
                after, error = self._attempt(phase, advance, h)
            except ConvergenceError as refused:
                after, error, failure = phase, math.inf, refused
            allowed = self._share * self._accuracy * h / self._horizon
            if not math.isfinite(error):
                error = math.inf
            if error > 0.0:
                factor = 0.9 * (allowed / error) ** (1.0 / self._order)
                self._next = h * min(5.0, max(0.2, factor))
            else:
                self._next = 5.0 * h
            if error <= allowed:
                rest = _rest(phase, self._horizon, self._ends)
                _require_reachable(self._accuracy, rest, h, norm(phase.angular_velocity))
                return h_ns, after
            if h_ns == 1 and failure is not None:
                raise ConvergenceError(
                    f"accuracy {self._accuracy:g} cannot be kept: not even a step of 1 ns can be taken: {failure}"
                ) from failure
            if h_ns == 1:
                raise ConvergenceError(
                    f"accuracy {self._accuracy:g} cannot be kept: a step of 1 ns has an error of {error:.3g}; "
                    "accept a larger solver.accuracy or check the size of the wrench"
                )
            h = self._next

    def begin(self) -> None:
        """Let the next stride be sought near what the last one suggests."""
        self._learnt, self._fastest = self._next, max(self._fastest, self._speed)

    def refine(self, phase: Phase, advance: Advance, h: float) -> Phase:
        """Return the phase after one step of a pair, or after two steps of h/2: as the stride itself is taken."""
        return advance(phase, h) if self._embedded else advance(advance(phase, 0.5 * h), 0.5 * h)

    def _first(self, phase: Phase) -> float:
        rate = norm(phase.angular_velocity)
        return min(0.01 * self._horizon, 0.1 / rate if rate > 0.0 else math.inf)

    def _attempt(self, phase: Phase, advance: Advance, h: float) -> tuple[Phase, float]:
        if self._embedded:
            kept, other = advance.pair(phase, h)
        else:
            kept, other = self.refine(phase, advance, h), advance(phase, h)
        mass, rest = self._inertia.mass, _rest(phase, self._horizon, self._ends)
        rate = norm(kept.angular_velocity)
        rate_error = norm(subtract(other.angular_velocity, kept.angular_velocity))
        attitude = angle_between(other.orientation, kept.orientation) + rate_error * rest
        momentum_error = subtract(other.linear_momentum_world, kept.linear_momentum_world)
        drift = norm(subtract(other.center_of_mass_world, kept.center_of_mass_world))
        drift += norm(scale(1.0 / mass, momentum_error)) * rest
        momentum = kept.linear_momentum_world
        at_start = norm(scale(1.0 / mass, subtract(momentum, kept.impulse_world)))
        self._speed = max(norm(scale(1.0 / mass, momentum)), at_start)
        speed = max(self._speed, self._fastest)
        position = drift / (speed * self._horizon) if speed > 0.0 else 0.0
        # What rounding alone makes of the difference is no reason to step shorter.
        floor = _EPSILON * (1.0 + rate * rest)
        error = max(attitude, position)
        return kept, (0.0 if error <= floor else error - floor) / self._errors


def _rest(phase: Phase, horizon: float, ends: bool) -> float:
    """Return for how long (s) an error has time to grow."""
    return max(horizon - phase.time, 1.0 / NANOSECONDS) if ends else horizon


def _require_reachable(accuracy: float, horizon: float, h: float, rate: float) -> None:
    """Refuse an accuracy that rounding alone does not leave: each step rounds the rate, errors add up as a random walk.

    Raises:
        ConvergenceError: names the accuracy that can be reached.
    """
    rounding = _EPSILON * (1.0 + rate * horizon) * math.sqrt(max(1.0, horizon / h))
    if rounding > accuracy:
        raise ConvergenceError(
            f"accuracy {accuracy:g} cannot be kept: at {rate:.3g} rad/s in steps of {h:.3g} s rounding alone adds "
            f"about {rounding:.1g} rad in {horizon:g} s; accept that much, shorten the run, or use a method "
            "of higher order, which takes longer steps"
        )
