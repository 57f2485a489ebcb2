"""Commutator-free Lie-group Runge-Kutta methods: each stage is a product of exponentials, without dexpinv or brackets.

A method is a table: for each stage, and for the step, the exponentials with their weights of the earlier slopes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rb_dynamics.loads.varying_load import evaluated
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Load, LoadDependence, Method
from rb_dynamics.motion.rkmk import StageContext, stage_context
from rb_dynamics.motion.step_checks import LARGEST_TURN, require_finite, turns_too_far
from rb_dynamics.numerics.rotation import IDENTITY, Quaternion, exp, multiply, renormalize, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, divide, dot, norm, scale

# Exponentials of one product, each given by its weights of the earlier slopes, in units of the step; rows of equal
# length.
Product = tuple[tuple[float, ...], ...]


class StageProducts(NamedTuple):
    """The products of the three stages after the first, and that of the step."""

    stages: tuple[Product, ...]
    end: Product


CF4_TABLE = StageProducts(
    stages=(((0.5,),), ((0.0, 0.5),), ((0.5, 0.0, 0.0), (-0.5, 0.0, 1.0))),
    end=((1.0 / 4.0, 1.0 / 6.0, 1.0 / 6.0, -1.0 / 12.0), (-1.0 / 12.0, 1.0 / 6.0, 1.0 / 6.0, 1.0 / 4.0)),
)


def weights(product: Product) -> tuple[float, ...]:
    """Return the Runge-Kutta weights of the product: the sums over its exponentials, for each slope."""
    return tuple(map(math.fsum, zip(*product, strict=True)))


class _Slope(NamedTuple):
    """Rates at a stage: rotation, momenta and position without their uniform parts, in the axes of R0, and power."""

    omega: Vector
    push: Vector
    twist: Vector
    gain: Vector
    power: float


class _Reached(NamedTuple):
    """State at a stage: time since the start (s), rotation, and the integrals of force, torque and position."""

    ahead: float
    turn: Quaternion
    pushed: Vector
    twisted: Vector
    moved: Vector


def _reached(h: float, product: Product, row: tuple[float, ...], slopes: tuple[_Slope, ...]) -> _Reached:
    turn = IDENTITY
    for weights_of_one in product:
        theta = ZERO
        for stage, weight in enumerate(weights_of_one):
            theta = add_scaled(theta, weight * h, slopes[stage].omega)
        turn = multiply(turn, exp(theta))
    ahead, pushed, twisted, moved = 0.0, ZERO, ZERO, ZERO
    for stage, weight in enumerate(row):
        s, k = weight * h, slopes[stage]
        ahead, pushed = ahead + s, add_scaled(pushed, s, k.push)
        twisted, moved = add_scaled(twisted, s, k.twist), add_scaled(moved, s, k.gain)
    return _Reached(ahead, turn, pushed, twisted, moved)


def _slope(context: StageContext, at: _Reached, load: Load | None) -> _Slope:
    (mass, moments), held, axes = context.inertia, context.held, context.orientation
    gain = scale(1.0 / mass, add_scaled(at.pushed, at.ahead, context.force_0))
    momentum = add(context.momentum, add_scaled(at.twisted, at.ahead, context.torque_0))
    omega = divide(rotate_inverse(at.turn, momentum), moments)
    rate = norm(omega)
    if not rate * abs(context.h) < LARGEST_TURN:
        omega = turns_too_far(context.name, context.h, rate).angular_velocity
    push, torque = rotate(at.turn, held.force_body), held.torque_body
    if load is not None:
        place = add_scaled(rotate(axes, at.moved), at.ahead, context.velocity)
        v = add(context.velocity, rotate(axes, gain))
        force, more = evaluated(load, at.ahead, place, v, multiply(axes, at.turn), omega)
        push, torque = add(push, rotate_inverse(axes, force)), add(torque, more)
    power = dot(add(push, context.force_0), add(context.velocity_0, gain)) + dot(torque, omega)
    power += dot(context.torque_0, rotate(at.turn, omega))
    return _Slope(omega, push, rotate(at.turn, torque), gain, power)


def _advance(
    name: str,
    table: StageProducts,
    rows: tuple[tuple[float, ...], ...],
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None,
) -> Increment:
    """Advance R' = R hat(omega) by products of exponentials, everything else by the Runge-Kutta method `rows`.

    The angular momentum is integrated in the axes of R0, m = R^T R0 (m0 + lambda) with lambda' = R0^T R tau. So the
    world-frame angular momentum changes only by the quadrature of the torque.

    Raises:
        ConvergenceError: the step rotates the body too far, or diverges.
    """
    moments = inertia.moments
    context = stage_context(name, inertia, held, h, velocity, orientation, angular_velocity)
    k1 = _slope(context, _Reached(0.0, IDENTITY, ZERO, ZERO, ZERO), load)
    k2 = _slope(context, _reached(h, table.stages[0], rows[0], (k1,)), load)
    k3 = _slope(context, _reached(h, table.stages[1], rows[1], (k1, k2)), load)
    k4 = _slope(context, _reached(h, table.stages[2], rows[2], (k1, k2, k3)), load)
    at = _reached(h, table.end, rows[3], (k1, k2, k3, k4))
    a, b, c, d = rows[3]
    end = Increment(
        add_scaled(rotate(orientation, at.moved), h, velocity),
        renormalize(multiply(orientation, at.turn)),
        divide(rotate_inverse(at.turn, add(context.momentum, add_scaled(at.twisted, h, context.torque_0))), moments),
        add_scaled(rotate(orientation, at.pushed), h, held.force_world),
        add_scaled(rotate(orientation, at.twisted), h, held.torque_world),
        h * (a * k1.power + b * k2.power + c * k3.power + d * k4.power),
    )
    return require_finite(name, h, end)


def method(name: str, order: int, table: StageProducts, source: str) -> Method:
    """Return the method of a table, from `source`."""
    rows = (*map(weights, table.stages), weights(table.end))

    def step(
        inertia: Inertia,
        held: HeldWrench,
        h: float,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        load: Load | None = None,
    ) -> Increment:
        return _advance(name, table, rows, inertia, held, h, velocity, orientation, angular_velocity, load)

    step.__doc__ = f"""Advance by products of exponentials, without commutators and without dexpinv: {source}.

    Order {order}, under any load too; keeps the angular momentum and the unit quaternion.

    Raises:
        ConvergenceError: the step turns the body too far, or diverges.
    """
    return Method(
        name, order, frozenset({"angular_momentum", "unit_quaternion"}), step, takes=LoadDependence.ANY, compiles=True
    )


CF4 = method(
    "cf4", 4, CF4_TABLE, "Celledoni, Marthinsen & Owren, Future Gener. Comput. Syst. 19 (2003) 341; cf. HLW IV.8"
)
