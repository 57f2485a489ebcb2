"""Runge-Kutta-Munthe-Kaas methods: Runge-Kutta in the Lie algebra, which keeps the attitude a rotation.

A method is a tableau. An embedded pair returns both results; step control chooses the step.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rb_dynamics.loads.varying_load import evaluated
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Load, LoadDependence, Method
from rb_dynamics.motion.step_checks import LARGEST_TURN, require_finite, turns_too_far
from rb_dynamics.numerics.rotation import Quaternion, dexpinv, exp, multiply, renormalize, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, divide, dot, norm, scale
from rb_dynamics.numerics.vector import multiply as times


class Tableau(NamedTuple):
    """An explicit Runge-Kutta method (Hairer, Norsett & Wanner I, eq. II.1.8); trailing zeros may be left out.

    Attributes:
        nodes: of the stages, in units of the step.
        stages: for each stage the weights of the slopes before it.
        weights: of the slopes in the step.
        comparison: the weights of one order less, for an embedded pair.
    """

    nodes: tuple[float, ...]
    stages: tuple[tuple[float, ...], ...]
    weights: tuple[float, ...]
    comparison: tuple[float, ...] = ()

    def second(self, weights: tuple[float, ...]) -> tuple[float, ...]:
        """Return the weights of the second integral: b^T A."""
        return tuple(
            math.fsum(weight * row[j] for weight, row in zip(weights, self.stages, strict=False) if j < len(row))
            for j in range(len(weights) - 1)
        )


CLASSICAL = Tableau(
    nodes=(0.0, 0.5, 0.5, 1.0),
    stages=((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    weights=(1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0),
)
"""Order 4 (Hairer, Norsett & Wanner I, table II.1.2)."""

DORMAND_PRINCE = Tableau(
    nodes=(0.0, 1.0 / 5.0, 3.0 / 10.0, 4.0 / 5.0, 8.0 / 9.0, 1.0, 1.0),
    stages=(
        (),
        (1.0 / 5.0,),
        (3.0 / 40.0, 9.0 / 40.0),
        (44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0),
        (19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0),
        (9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0),
        (35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0),
    ),
    weights=(35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0),
    comparison=(
        *(5179.0 / 57600.0, 0.0, 7571.0 / 16695.0, 393.0 / 640.0),
        *(-92097.0 / 339200.0, 187.0 / 2100.0, 1.0 / 40.0),
    ),
)
"""Order 5 with a comparison of order 4 (Hairer, Norsett & Wanner I, table II.5.2)."""

_CLASSICAL_SECOND = CLASSICAL.second(CLASSICAL.weights)
_SECOND = DORMAND_PRINCE.second(DORMAND_PRINCE.weights)
_COMPARISON_SECOND = DORMAND_PRINCE.second(DORMAND_PRINCE.comparison)


class StageContext(NamedTuple):
    """Constants of a step; the angular `momentum` and `*_0` are in the axes of R0."""

    name: str
    inertia: Inertia
    held: HeldWrench
    h: float
    velocity: Vector
    orientation: Quaternion
    momentum: Vector
    velocity_0: Vector
    force_0: Vector
    torque_0: Vector


class _Reached(NamedTuple):
    """State at a stage, in the axes of R0.

    Attributes:
        ahead: time since the start of the step, s.
        theta: rotation vector.
        gained: torque impulse, without that of the constant torque in world axes.
        place: displacement since the start of the step, m.
        velocity: of the centre of mass.
    """

    ahead: float
    theta: Vector
    gained: Vector
    place: Vector
    velocity: Vector


class _Slope(NamedTuple):
    """Rates at a stage, in the axes of R0: theta, momenta without their uniform parts, position and work."""

    turn: Vector
    push: Vector
    twist: Vector
    velocity: Vector
    power: float


def stage_context(
    name: str,
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
) -> StageContext:
    """Return the constants of a step of the method `name`."""
    return StageContext(
        name,
        inertia,
        held,
        h,
        velocity,
        orientation,
        times(inertia.moments, angular_velocity),
        rotate_inverse(orientation, velocity),
        rotate_inverse(orientation, held.force_world),
        rotate_inverse(orientation, held.torque_world),
    )


def _slope(context: StageContext, at: _Reached, load: Load | None) -> _Slope:
    turn, v = exp(at.theta), at.velocity
    impulse = add_scaled(at.gained, at.ahead, context.torque_0)
    omega = divide(rotate_inverse(turn, add(context.momentum, impulse)), context.inertia.moments)

    push, torque, axes = rotate(turn, context.held.force_body), context.held.torque_body, context.orientation
    if load is not None:
        force, more = evaluated(load, at.ahead, rotate(axes, at.place), rotate(axes, v), multiply(axes, turn), omega)
        push, torque = add(push, rotate_inverse(axes, force)), add(torque, more)
    theta_dot = dexpinv(scale(-1.0, at.theta), omega)
    rate = norm(theta_dot)
    if not rate * abs(context.h) < LARGEST_TURN:
        theta_dot = turns_too_far(context.name, context.h, rate).angular_velocity
    power = dot(add(push, context.force_0), v) + dot(torque, omega) + dot(context.torque_0, rotate(turn, omega))
    return _Slope(theta_dot, push, rotate(turn, torque), v, power)


def _reached(context: StageContext, node: float, row: tuple[float, ...], slopes: tuple[_Slope, ...]) -> _Reached:
    a = b = c = d = e = f = g = i = j = k = m = n = 0.0
    for stage, weight in enumerate(row):
        s = weight * context.h
        (a1, b1, c1), (d1, e1, f1), (g1, i1, j1), (k1, m1, n1), _ = slopes[stage]
        a, b, c = a + s * a1, b + s * b1, c + s * c1
        d, e, f = d + s * d1, e + s * e1, f + s * f1
        g, i, j = g + s * g1, i + s * i1, j + s * j1
        k, m, n = k + s * k1, m + s * m1, n + s * n1
    ahead = node * context.h
    v = add_scaled(context.velocity_0, 1.0 / context.inertia.mass, add_scaled((d, e, f), ahead, context.force_0))
    return _Reached(ahead, (a, b, c), (g, i, j), (k, m, n), v)


def _end(
    context: StageContext,
    weights: tuple[float, ...],
    second: tuple[float, ...],
    slopes: tuple[_Slope, ...],
) -> Increment:
    """Return the increment for the weighted slopes; `second` are the weights of the second integral."""
    (mass, moments), held, h, orientation = context.inertia, context.held, context.h, context.orientation
    theta, pushed, moved, twisted, work = ZERO, ZERO, ZERO, ZERO, 0.0
    for stage, weight in enumerate(weights):
        k = slopes[stage]
        theta, pushed = add_scaled(theta, weight, k.turn), add_scaled(pushed, weight, k.push)
        twisted, work = add_scaled(twisted, weight, k.twist), work + weight * h * k.power
    for stage, weight in enumerate(second):
        moved = add_scaled(moved, weight, slopes[stage].push)
    turn, torque_impulse = exp(scale(h, theta)), scale(h, twisted)
    displacement = rotate(orientation, scale(h * h / mass, moved))
    end = Increment(
        add(scale(h, context.velocity), add_scaled(displacement, 0.5 * h * h / mass, held.force_world)),
        renormalize(multiply(orientation, turn)),
        divide(rotate_inverse(turn, add(context.momentum, add_scaled(torque_impulse, h, context.torque_0))), moments),
        add_scaled(rotate(orientation, scale(h, pushed)), h, held.force_world),
        add_scaled(rotate(orientation, torque_impulse), h, held.torque_world),
        work,
    )
    return require_finite(context.name, h, end)


def _rkmk4(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance by the classical Runge-Kutta method in the Lie algebra, with dexpinv (Munthe-Kaas, BIT 38 (1998) 92).

    With R = R0 exp(theta): theta' = dexpinv_{-theta}(omega) (IMNZ algorithm 4.1), and the angular momentum is
    integrated in the axes of R0, m = exp(-theta) (m0 + lambda) with lambda' = exp(theta) tau. So the world-frame
    angular momentum changes only by the quadrature of the torque. Order 4, under any load too; conserves the angular
    momentum and the unit quaternion.

    Raises:
        ConvergenceError: the step rotates the body further than exp can be inverted, or diverges.
    """
    f = stage_context("rkmk4", inertia, held, h, velocity, orientation, angular_velocity)
    k1 = _slope(f, _Reached(0.0, ZERO, ZERO, ZERO, f.velocity_0), load)
    k2 = _slope(f, _reached(f, CLASSICAL.nodes[1], CLASSICAL.stages[1], (k1,)), load)
    k3 = _slope(f, _reached(f, CLASSICAL.nodes[2], CLASSICAL.stages[2], (k1, k2)), load)
    k4 = _slope(f, _reached(f, CLASSICAL.nodes[3], CLASSICAL.stages[3], (k1, k2, k3)), load)
    return _end(f, CLASSICAL.weights, _CLASSICAL_SECOND, (k1, k2, k3, k4))


def _rkmk54(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance as `rkmk4` does, with the tableau of Dormand and Prince (Hairer, Norsett & Wanner I, table II.5.2).

    Order 5, under any load too; conserves the angular momentum and the unit quaternion.

    Raises:
        ConvergenceError: the step rotates the body further than exp can be inverted, or diverges.
    """
    context = stage_context("rkmk54", inertia, held, h, velocity, orientation, angular_velocity)
    return _end(context, DORMAND_PRINCE.weights, _SECOND, _slopes(context, load))


def _pair(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> tuple[Increment, Increment]:
    """Return the step of order 5 and its comparison of order 4, which needs one more slope, at the end.

    Raises:
        ConvergenceError: as for the step.
    """
    context = stage_context("rkmk54", inertia, held, h, velocity, orientation, angular_velocity)
    k1, k2, k3, k4, k5, k6 = _slopes(context, load)
    end = DORMAND_PRINCE.nodes[6], DORMAND_PRINCE.stages[6], (k1, k2, k3, k4, k5, k6)
    k7 = _slope(context, _reached(context, *end), load)
    return (
        _end(context, DORMAND_PRINCE.weights, _SECOND, (k1, k2, k3, k4, k5, k6)),
        _end(context, DORMAND_PRINCE.comparison, _COMPARISON_SECOND, (k1, k2, k3, k4, k5, k6, k7)),
    )


def _slopes(f: StageContext, load: Load | None) -> tuple[_Slope, _Slope, _Slope, _Slope, _Slope, _Slope]:
    nodes, rows = DORMAND_PRINCE.nodes, DORMAND_PRINCE.stages
    k1 = _slope(f, _Reached(0.0, ZERO, ZERO, ZERO, f.velocity_0), load)
    k2 = _slope(f, _reached(f, nodes[1], rows[1], (k1,)), load)
    k3 = _slope(f, _reached(f, nodes[2], rows[2], (k1, k2)), load)
    k4 = _slope(f, _reached(f, nodes[3], rows[3], (k1, k2, k3)), load)
    k5 = _slope(f, _reached(f, nodes[4], rows[4], (k1, k2, k3, k4)), load)
    k6 = _slope(f, _reached(f, nodes[5], rows[5], (k1, k2, k3, k4, k5)), load)
    return k1, k2, k3, k4, k5, k6


_INVARIANTS = frozenset({"angular_momentum", "unit_quaternion"})

RKMK4 = Method("rkmk4", 4, _INVARIANTS, _rkmk4, takes=LoadDependence.ANY, compiles=True)
RKMK54 = Method("rkmk54", 5, _INVARIANTS, _rkmk54, takes=LoadDependence.ANY, pair=_pair, compiles=True)
