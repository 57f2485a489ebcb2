"""`Method`: advances a body by h under a held wrench. A method is data plus one pure function, its `step`.

A step works in the principal axes of inertia and about the centre of mass, on plain floats. It returns increments,
which `PhaseState.after` adds up with compensated summation. It depends on neither time nor files nor channels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import count
from typing import NamedTuple, Protocol

from rb_dynamics.loads.varying_load import Load, LoadDependence
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector


class Inertia(NamedTuple):
    """Mass properties for a step: kg, and kg m^2 about the principal axes."""

    mass: float
    moments: Vector


class Increment(NamedTuple):
    """Result of one step.

    Attributes:
        displacement: of the centre of mass, world axes, m.
        orientation: after the step, principal to world axes.
        angular_velocity: after the step, principal axes, rad/s.
        impulse: integral of the force by the method's own quadrature, world axes, N s.
        torque_impulse: integral of the torque about the centre of mass, by the same quadrature, world axes, N m s.
        work: integral of force . velocity + torque . angular velocity, by the same quadrature, J.
    """

    displacement: Vector
    orientation: Quaternion
    angular_velocity: Vector
    impulse: Vector
    torque_impulse: Vector
    work: float


Weights = tuple[tuple[int, float], ...]
"""Weights of stages, by their number from 0."""


class SparseTableau(NamedTuple):
    """An explicit Runge-Kutta method with an embedded pair.

    Attributes:
        nodes: of the stages.
        rows: weights of each stage.
        weights: of the result.
        errors: of its two error estimates, see `inner_states.difference`; without weights if there is one.
        compared: returns both results from constants of a step, sums with `weights` and `errors`, books and load.
    """

    nodes: tuple[float, ...]
    rows: tuple[Weights, ...]
    weights: Weights
    errors: tuple[Weights, Weights]
    compared: Callable[..., tuple[Increment, Increment]]


def of_stages(row: tuple[float, ...], *stages: int) -> Weights:
    """Return weights that belong to these stages."""
    return tuple(zip(stages, row, strict=True))


class Step(Protocol):
    """One step of a method."""

    def __call__(
        self,
        inertia: Inertia,
        held: HeldWrench,
        h: float,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        load: Load | None = None,
    ) -> Increment:
        """Return the increment of a step of h s.

        Args:
            inertia: of the body.
            held: constant during the step; `*_body` in principal axes.
            h: s.
            velocity: of the centre of mass, world axes, m/s.
            orientation: principal to world axes.
            angular_velocity: principal axes, rad/s.
            load: a load in addition to `held`, or None; of a kind that the method supports (`Method.takes`).

        Raises:
            ConvergenceError: the step cannot be solved, or is too long for the method.
        """


class Pair(Protocol):
    """One step of an embedded pair."""

    def __call__(
        self,
        inertia: Inertia,
        held: HeldWrench,
        h: float,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        load: Load | None = None,
    ) -> tuple[Increment, Increment]:
        """Return the result of `step`, and one of one order less: their difference estimates the error."""


class DenseStep(NamedTuple):
    """A step for kernels that serves many times within a stride (dense output).

    Attributes:
        step: called like `Step`, but with an array in place of the load; gives the same bits. The array receives what
            steps of any length from the same start share, and begins with zeros.
        size: of the array.
    """

    step: Callable[..., Increment]
    size: int


# longest_step(inertia, held, velocity_world, orientation, angular_velocity_principal, accuracy, horizon)
LongestStep = Callable[[Inertia, HeldWrench, Vector, Quaternion, Vector, float, float], float]


# Compared by identity: kernels are looked up by method at every arc, and hashing a tableau takes longer than a step.
@dataclass(frozen=True, slots=True, eq=False)
class Method:
    """A method of integration.

    Attributes:
        name: as in `solver.method`.
        order: after a fixed time the error of attitude, rate, position, work and impulses is O(h^order); None for a
            closed form, whose error does not depend on h and which takes an arc in one step.
        invariants: what free motion conserves to round-off: any of "energy", "angular_momentum" and "unit_quaternion".
        step: the method itself; its docstring names the source.
        longest_step: for a method that knows its own error: the longest step (s) that adds at most accuracy * step /
            horizon to the error at the end; None if steps must be compared for that.
        takes: the loads that it supports.
        pair: for an embedded pair, the step with its comparison; None if steps must be compared.
        compiles: whether numba can compile `step`, `longest_step` and `pair` under a held wrench; the kernel cache
            identifies a step by the name of the method.
        compiles_loads: if so, whether also under the loads that it takes.
        tableau: the tableau of a method that takes a load with inner states.
        takes_arrays: whether `step` also takes numpy arrays in place of numbers, see `array_steps.py`, if it compiles.
        dense: for a method under held wrenches alone whose steps from one start share most of their work, if it
            compiles.
    """

    name: str
    order: int | None
    invariants: frozenset[str]
    step: Step
    longest_step: LongestStep | None = None
    takes: LoadDependence = LoadDependence.HELD
    pair: Pair | None = None
    compiles: bool = False
    tableau: SparseTableau | None = None
    compiles_loads: bool = True
    takes_arrays: bool = False
    dense: DenseStep | None = None


@cache
def stable_until(tableau: SparseTableau) -> float:
    """Return the largest h v, to 0.1, of steps h under which y' = -v y does not grow.

    Hairer & Wanner, Solving Ordinary Differential Equations II, section IV.2.
    """
    for x in count(1):
        slopes: list[float] = []
        for row in (*tableau.rows, tableau.weights):
            slopes.append(1.0 - 0.1 * x * math.fsum(weight * slopes[k] for k, weight in row))
        if abs(slopes[-1]) > 1.0:
            return 0.1 * (x - 1)
    return math.inf


__all__ = ["Increment", "Inertia", "Load", "LoadDependence", "LongestStep", "Method", "Pair", "Step"]
