"""Commutator-free Lie-group Runge-Kutta methods: each stage is a product of exponentials, without dexpinv or bracket.

A method is a table: for each stage, and for the step, the exponentials with their weights of the slopes before.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Load, Method, Takes
from rb_dynamics.motion.refusal import require_finite, require_small_turn
from rb_dynamics.rotation import IDENTITY, Quaternion, exp, normalize, rotate, rotate_inverse
from rb_dynamics.rotation import multiply as compose
from rb_dynamics.vector import ZERO, Vector, add, add_scaled, divide, dot, multiply, norm, scale

# The exponentials of one product, each by the weights of the slopes of the stages before, in units of the step.
Product = tuple[tuple[float, ...], ...]


class Table(NamedTuple):
    """The products of the stages after the first, and that of the step."""

    stages: tuple[Product, ...]
    end: Product


CF4_TABLE = Table(
    stages=(((0.5,),), ((0.0, 0.5),), ((0.5,), (-0.5, 0.0, 1.0))),
    end=((1.0 / 4.0, 1.0 / 6.0, 1.0 / 6.0, -1.0 / 12.0), (-1.0 / 12.0, 1.0 / 6.0, 1.0 / 6.0, 1.0 / 4.0)),
)


def weights(product: Product) -> tuple[float, ...]:
    """Return what the product comes to where everything commutes: its weights, summed for each slope."""
    return tuple(math.fsum(row[j] for row in product if j < len(row)) for j in range(max(map(len, product))))


def _combined(h: float, row: tuple[float, ...], slopes: list[Vector]) -> Vector:
    out = ZERO
    for weight, slope in zip(row, slopes, strict=False):
        out = add_scaled(out, weight * h, slope)
    return out


def _turned(h: float, product: Product, slopes: list[Vector]) -> Quaternion:
    turn = IDENTITY
    for row in product:
        turn = compose(turn, exp(_combined(h, row, slopes)))
    return turn


def advance(
    name: str,
    table: Table,
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance R' = R hat(omega) by products of exponentials, everything else by the Runge-Kutta method below them.

    The angular momentum is carried in the axes of R0, m = R^T R0 (m0 + lambda) with lambda' = R0^T R tau. So the
    world-frame angular momentum changes by the quadrature of the torque and by nothing else.

    Raises:
        ConvergenceError: the step turns the body too far, or diverges.
    """
    mass, moments = inertia
    momentum = multiply(moments, angular_velocity)
    force_0 = rotate_inverse(orientation, held.force_world)
    torque_0 = rotate_inverse(orientation, held.torque_world)
    velocity_0 = rotate_inverse(orientation, velocity)

    # The slopes of the stages; forces, torques and the gain of velocity in the axes of R0. Only what turns with the
    # body needs the quadrature, the world-frame parts are constant there.
    turns: list[Vector] = []
    pushes: list[Vector] = []
    twists: list[Vector] = []
    gains: list[Vector] = []
    work = 0.0
    end = weights(table.end)
    for stage, weight in enumerate(end):
        row: tuple[float, ...] = ()
        turn = IDENTITY
        if stage > 0:
            product = table.stages[stage - 1]
            row, turn = weights(product), _turned(h, product, turns)
        ahead = h * math.fsum(row)
        gain = scale(1.0 / mass, add_scaled(_combined(h, row, pushes), ahead, force_0))
        lever = add(momentum, add_scaled(_combined(h, row, twists), ahead, torque_0))
        omega = divide(rotate_inverse(turn, lever), moments)
        require_small_turn(name, h, norm(omega))
        push, torque = rotate(turn, held.force_body), held.torque_body
        if load is not None:
            place = add_scaled(rotate(orientation, _combined(h, row, gains)), ahead, velocity)
            v = add(velocity, rotate(orientation, gain))
            force, more = load(ahead, place, v, compose(orientation, turn), omega)
            push, torque = add(push, rotate_inverse(orientation, force)), add(torque, more)
        turns.append(omega)
        pushes.append(push)
        twists.append(rotate(turn, torque))
        gains.append(gain)
        power = dot(add(push, force_0), add(velocity_0, gain)) + dot(torque, omega)
        work += weight * h * (power + dot(torque_0, rotate(turn, omega)))

    turn = _turned(h, table.end, turns)
    torque_impulse = _combined(h, end, twists)
    step = Increment(
        add_scaled(rotate(orientation, _combined(h, end, gains)), h, velocity),
        normalize(compose(orientation, turn)),
        divide(rotate_inverse(turn, add(momentum, add_scaled(torque_impulse, h, torque_0))), moments),
        add_scaled(rotate(orientation, _combined(h, end, pushes)), h, held.force_world),
        add_scaled(rotate(orientation, torque_impulse), h, held.torque_world),
        work,
    )
    return require_finite(name, h, step)


def _method(name: str, order: int, table: Table, source: str) -> Method:
    def step(
        inertia: Inertia,
        held: HeldWrench,
        h: float,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        load: Load | None = None,
    ) -> Increment:
        return advance(name, table, inertia, held, h, velocity, orientation, angular_velocity, load)

    step.__doc__ = f"""Advance by products of exponentials, without commutators and without dexpinv: {source}.

    Order {order}, under any load too; keeps the angular momentum and the unit quaternion.

    Raises:
        ConvergenceError: the step turns the body too far, or diverges.
    """
    return Method(name, order, frozenset({"angular_momentum", "unit_quaternion"}), step, takes=Takes.ANY)


CF4 = _method(
    "cf4", 4, CF4_TABLE, "Celledoni, Marthinsen & Owren, Future Gener. Comput. Syst. 19 (2003) 341; cf. HLW IV.8"
)
