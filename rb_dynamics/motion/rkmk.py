"""Runge-Kutta-Munthe-Kaas methods: Runge-Kutta in the Lie algebra, so that the attitude stays a rotation.

A method is a tableau. Never chooses a step: an embedded pair only gives both results.
"""

from __future__ import annotations

from typing import NamedTuple

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Load, Method, Takes
from rb_dynamics.motion.refusal import require_finite, require_small_turn
from rb_dynamics.rotation import (
    Quaternion,
    dexpinv,
    exp,
    normalize,
    rotate,
    rotate_inverse,
)
from rb_dynamics.rotation import multiply as compose
from rb_dynamics.vector import Vector, add, add_scaled, divide, dot, multiply, norm, scale

# Weights with the slopes they belong to: the zeros of a tableau cost nothing.
Terms = tuple[tuple[int, float], ...]


class Quadrature(NamedTuple):
    """How a step is made: of stages (node and weights), of weights, and of those of the second integral, b^T A."""

    stages: tuple[tuple[float, Terms], ...]
    first: Terms
    second: Terms


class Tableau(NamedTuple):
    """An explicit Runge-Kutta method (Hairer, Norsett & Wanner I, eq. II.1.8); a row may end before its zeros do.

    Attributes:
        nodes: of the stages, in units of the step.
        stages: for each stage the weights of the slopes before it.
        weights: of the slopes in the step.
        comparison: the same of one order less, for an embedded pair.
    """

    nodes: tuple[float, ...]
    stages: tuple[tuple[float, ...], ...]
    weights: tuple[float, ...]
    comparison: tuple[float, ...] = ()

    def quadrature(self, weights: tuple[float, ...]) -> Quadrature:
        """Return how `weights` make a step."""
        second = [0.0] * len(weights)
        for weight, row in zip(weights, self.stages, strict=False):
            for j, a in enumerate(row):
                second[j] += weight * a
        stages = zip(self.nodes[: len(weights)], map(nonzero, self.stages), strict=False)
        return Quadrature(tuple(stages), nonzero(weights), nonzero(tuple(second)))


def nonzero(weights: tuple[float, ...]) -> Terms:
    """Return the weights that are not zero, each with its place."""
    return tuple((j, weight) for j, weight in enumerate(weights) if weight)


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


def total(h: float, terms: Terms, slopes: list[Vector]) -> Vector:
    """Return h times the weighted sum of `slopes`."""
    x = y = z = 0.0
    for j, weight in terms:
        s, (a, b, c) = weight * h, slopes[j]
        x, y, z = x + s * a, y + s * b, z + s * c
    return (x, y, z)


def advance(
    name: str,
    ends: tuple[Quadrature, ...],
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None,
) -> list[Increment]:
    """Return what each of `ends` makes of the stages of the last, which begin with those of the others.

    With R = R0 exp(theta): theta' = dexpinv_{-theta}(omega), and the angular momentum is carried in the axes of R0,
    m = exp(-theta) (m0 + lambda) with lambda' = exp(theta) tau. So the world-frame angular momentum changes by the
    quadrature of the torque and by nothing else.

    Raises:
        ConvergenceError: the step turns the body further than exp can be inverted, or diverges.
    """
    mass, moments = inertia
    momentum = multiply(moments, angular_velocity)
    force_0 = rotate_inverse(orientation, held.force_world)
    torque_0 = rotate_inverse(orientation, held.torque_world)
    velocity_0 = rotate_inverse(orientation, velocity)

    # The slopes of the stages, all in the axes of R0. Of force and torque only what changes inside the step needs the
    # quadrature, the world-frame parts of the held wrench are constant there.
    turns: list[Vector] = []
    pushes: list[Vector] = []
    twists: list[Vector] = []
    velocities: list[Vector] = []
    powers: list[float] = []
    for node, terms in ends[-1].stages:
        ahead = node * h
        theta = total(h, terms, turns)
        turn = exp(theta)
        impulse = add_scaled(total(h, terms, twists), ahead, torque_0)
        v = velocity_0
        for j, weight in terms:
            v = add_scaled(v, weight * h / mass, add(pushes[j], force_0))
        omega = divide(rotate_inverse(turn, add(momentum, impulse)), moments)

        push, torque = rotate(turn, held.force_body), held.torque_body
        if load is not None:
            place = rotate(orientation, total(h, terms, velocities))
            force, more = load(ahead, place, rotate(orientation, v), compose(orientation, turn), omega)
            push, torque = add(push, rotate_inverse(orientation, force)), add(torque, more)
        theta_dot = dexpinv(scale(-1.0, theta), omega)
        require_small_turn(name, h, norm(theta_dot))
        turns.append(theta_dot)
        pushes.append(push)
        twists.append(rotate(turn, torque))
        velocities.append(v)
        powers.append(dot(add(push, force_0), v) + dot(torque, omega) + dot(torque_0, rotate(turn, omega)))

    steps = []
    for _, first, second in ends:
        turn = exp(scale(h, total(1.0, first, turns)))
        torque_impulse = scale(h, total(1.0, first, twists))
        displacement = rotate(orientation, scale(h * h / mass, total(1.0, second, pushes)))
        work = 0.0
        for j, weight in first:
            work += weight * h * powers[j]
        step = Increment(
            add(scale(h, velocity), add_scaled(displacement, 0.5 * h * h / mass, held.force_world)),
            normalize(compose(orientation, turn)),
            divide(rotate_inverse(turn, add(momentum, add_scaled(torque_impulse, h, torque_0))), moments),
            add_scaled(rotate(orientation, scale(h, total(1.0, first, pushes))), h, held.force_world),
            add_scaled(rotate(orientation, torque_impulse), h, held.torque_world),
            work,
        )
        steps.append(require_finite(name, h, step))
    return steps


def _method(name: str, order: int, tableau: Tableau, source: str) -> Method:
    end = tableau.quadrature(tableau.weights)
    comparison = tableau.quadrature(tableau.comparison)

    def step(
        inertia: Inertia,
        held: HeldWrench,
        h: float,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        load: Load | None = None,
    ) -> Increment:
        return advance(name, (end,), inertia, held, h, velocity, orientation, angular_velocity, load)[0]

    def pair(
        inertia: Inertia,
        held: HeldWrench,
        h: float,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        load: Load | None = None,
    ) -> tuple[Increment, Increment]:
        both = advance(name, (end, comparison), inertia, held, h, velocity, orientation, angular_velocity, load)
        return both[0], both[1]

    step.__doc__ = f"""Advance by a Runge-Kutta method in the Lie algebra, with dexpinv: {source}.

    Order {order}, under any load too; keeps the angular momentum and the unit quaternion.

    Raises:
        ConvergenceError: the step turns the body further than exp can be inverted, or diverges.
    """
    invariants = frozenset({"angular_momentum", "unit_quaternion"})
    return Method(name, order, invariants, step, takes=Takes.ANY, pair=pair if tableau.comparison else None)


_SOURCE = "Munthe-Kaas, BIT 38 (1998) 92; IMNZ algorithm 4.1"

RKMK4 = _method("rkmk4", 4, CLASSICAL, _SOURCE)

RKMK54 = _method(
    "rkmk54", 5, DORMAND_PRINCE, f"{_SOURCE}, with the tableau of Hairer, Norsett & Wanner I, table II.5.2"
)
