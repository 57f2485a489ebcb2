"""Inner states, in addition to those of the body, such as the momenta of wheels: integrated by the same method.

They are stored after the sums of a `PhaseState`. Each stage computes them with the method's own tableau, so that the
method integrates body and inner states as one system.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol, cast

from rb_dynamics.motion.method import Load, SparseTableau, Weights
from rb_dynamics.motion.phase_state import PhaseState, Sums, two_sum
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector, add_scaled


class StatefulLoad(Protocol):
    """A load with inner states.

    Attributes:
        states: the inner states at the start of the step.
    """

    states: Sums

    def stage(
        self,
        t: float,
        displacement: Vector,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        states: Sums,
    ) -> tuple[Vector, Vector, Sums]:
        """Return force and torque, as a `Load` does, and the rates of the states."""

    def turned(self, states: Sums) -> Vector:
        """Return the change of angular velocity (rad/s, principal axes) to which a difference of states corresponds."""


class StagedLoad:
    """A stateful load in one step: a `Load` that a method evaluates stage by stage, in the order of its tableau."""

    def __init__(self, load: StatefulLoad, h: float, tableau: SparseTableau) -> None:
        """Begin a step of h s."""
        self._load, self._h, self._tableau = load, h, tableau
        self._rates: list[Sums] = []

    def __call__(
        self, t: float, displacement: Vector, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
    ) -> tuple[Vector, Vector]:
        """Return force and torque at the next stage."""
        gained = self._sum(self._tableau.rows[len(self._rates)])
        states = tuple([a + b for a, b in zip(self._load.states, gained, strict=True)])
        force, torque, rates = self._load.stage(t, displacement, velocity, orientation, angular_velocity, states)
        self._rates.append(rates)
        return force, torque

    def after(self, before: PhaseState, after: PhaseState) -> PhaseState:
        """Return the phase at the end of the step with the states there."""
        return _with_states(before, after, self._sum(self._tableau.weights))

    def compared(self, before: PhaseState, other: PhaseState) -> PhaseState:
        """Return the second result of an embedded pair, with the estimated error of the inner states added.

        It is added to the angular velocity, because step control compares only body states.
        """
        fifth, third = (self._sum(weights) for weights in self._tableau.errors)
        off = tuple([difference(a, b) for a, b in zip(fifth, third, strict=True)])
        gained = tuple([a - b for a, b in zip(self._sum(self._tableau.weights), off, strict=True)])
        omega = add_scaled(other.angular_velocity, 1.0, self._load.turned(off))
        return _with_states(before, other._replace(angular_velocity=omega), gained)

    def _sum(self, weights: Weights) -> Sums:
        totals = [0.0] * len(self._load.states)
        for stage, weight in weights:
            for k, rate in enumerate(self._rates[stage]):
                totals[k] += weight * rate
        return tuple([self._h * total for total in totals])


def staged(load: Load, h: float, tableau: SparseTableau) -> Load:
    """Return `load` for a step of h s: itself if it has no inner states."""
    # Called at every step; checking a runtime protocol would be slow.
    return StagedLoad(cast(StatefulLoad, load), h, tableau) if hasattr(load, "states") else load


def difference(fifth: float, third: float) -> float:
    """Return the error of a state by the estimates of orders 5 and 3 (HNW I, eq. II.10.17)."""
    size = math.sqrt(fifth * fifth + 0.01 * third * third)
    return fifth * abs(fifth) / size if size > 0.0 else 0.0


def _with_states(before: PhaseState, after: PhaseState, gained: Sequence[float]) -> PhaseState:
    """Return `after` with the states of `before` increased by `gained`, added by two-sum like the other sums."""
    count = len(after.high)
    high, low = list(after.high), list(after.low)
    for a, rest, b in zip(before.high[count:], before.low[count:], gained, strict=True):
        total, error = two_sum(a, b, rest)
        high.append(total)
        low.append(error)
    return after._replace(high=tuple(high), low=tuple(low))
