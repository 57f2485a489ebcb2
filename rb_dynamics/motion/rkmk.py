"""Runge-Kutta-Munthe-Kaas methods: Runge-Kutta in the Lie algebra, so that the attitude stays a rotation.

A method is a tableau. Never chooses a step: an embedded pair only gives both results.
"""

from __future__ import annotations

from typing import NamedTuple

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Load, Method, Takes
from rb_dynamics.motion.refusal import LARGEST_TURN, require_finite, turns_too_far
from rb_dynamics.rotation import (
    Quaternion,
    dexpinv,
    exp,
    normalize,
    rotate,
    rotate_inverse,
)
from rb_dynamics.rotation import multiply as compose
from rb_dynamics.vector import ZERO, Vector, add, add_scaled, divide, dot, multiply, norm, scale

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
    frame = _frame(inertia, held, h, velocity, orientation, angular_velocity)

    # The slopes of the stages. Of force and torque only what changes inside the step needs the quadrature, the
    # world-frame parts of the held wrench are constant there.
    turns: list[Vector] = []
    pushes: list[Vector] = []
    twists: list[Vector] = []
    velocities: list[Vector] = []
    powers: list[float] = []
    for node, terms in ends[-1].stages:
        v = frame.velocity
        for j, weight in terms:
            v = add_scaled(v, weight * h / inertia.mass, add(pushes[j], frame.force))
        theta, gained, place = total(h, terms, turns), total(h, terms, twists), ZERO
        if load is not None:
            place = total(h, terms, velocities)
        k = _slope(name, frame, _Reached(node * h, theta, gained, place, v), load)
        turns.append(k.turn)
        pushes.append(k.push)
        twists.append(k.twist)
        velocities.append(v)
        powers.append(k.power)

    steps = []
    for _, first, second in ends:
        work = 0.0
        for j, weight in first:
            work += weight * h * powers[j]
        sums = _Slope(total(1.0, first, turns), total(1.0, first, pushes), total(1.0, first, twists), ZERO, work)
        step = _end(frame, velocity, sums, total(1.0, second, pushes))
        steps.append(require_finite(name, h, step))
    return steps


class _Frame(NamedTuple):
    """What the stages of a step share; force, torque and velocity are those of the world in the axes of R0."""

    inertia: Inertia
    held: HeldWrench
    h: float
    orientation: Quaternion
    momentum: Vector
    velocity: Vector
    force: Vector
    torque: Vector


class _Reached(NamedTuple):
    """Where a stage stands: s into the step, theta, torque impulse and place less what is uniform, and velocity."""

    ahead: float
    theta: Vector
    gained: Vector
    place: Vector
    velocity: Vector


class _Slope(NamedTuple):
    """What changes with time at a stage, in the axes of R0: theta, momenta less what is uniform, place and work."""

    turn: Vector
    push: Vector
    twist: Vector
    velocity: Vector
    power: float


def _frame(
    inertia: Inertia, held: HeldWrench, h: float, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
) -> _Frame:
    return _Frame(
        inertia,
        held,
        h,
        orientation,
        multiply(inertia.moments, angular_velocity),
        rotate_inverse(orientation, velocity),
        rotate_inverse(orientation, held.force_world),
        rotate_inverse(orientation, held.torque_world),
    )


def _slope(name: str, frame: _Frame, at: _Reached, load: Load | None) -> _Slope:
    turn, v = exp(at.theta), at.velocity
    impulse = add_scaled(at.gained, at.ahead, frame.torque)
    omega = divide(rotate_inverse(turn, add(frame.momentum, impulse)), frame.inertia.moments)

    push, torque, axes = rotate(turn, frame.held.force_body), frame.held.torque_body, frame.orientation
    if load is not None:
        force, more = load(at.ahead, rotate(axes, at.place), rotate(axes, v), compose(axes, turn), omega)
        push, torque = add(push, rotate_inverse(axes, force)), add(torque, more)
    theta_dot = dexpinv(scale(-1.0, at.theta), omega)
    rate = norm(theta_dot)
    if not rate * abs(frame.h) < LARGEST_TURN:
        theta_dot = turns_too_far(name, frame.h, rate).angular_velocity
    power = dot(add(push, frame.force), v) + dot(torque, omega) + dot(frame.torque, rotate(turn, omega))
    return _Slope(theta_dot, push, rotate(turn, torque), v, power)


def _end(frame: _Frame, velocity: Vector, mean: _Slope, second: Vector) -> Increment:
    """Return what a step does by the weighted slopes, `second` being the second integral of the push, over h^2."""
    (mass, moments), held, h, orientation = frame.inertia, frame.held, frame.h, frame.orientation
    turn, torque_impulse = exp(scale(h, mean.turn)), scale(h, mean.twist)
    displacement = rotate(orientation, scale(h * h / mass, second))
    return Increment(
        add(scale(h, velocity), add_scaled(displacement, 0.5 * h * h / mass, held.force_world)),
        normalize(compose(orientation, turn)),
        divide(rotate_inverse(turn, add(frame.momentum, add_scaled(torque_impulse, h, frame.torque))), moments),
        add_scaled(rotate(orientation, scale(h, mean.push)), h, held.force_world),
        add_scaled(rotate(orientation, torque_impulse), h, held.torque_world),
        mean.power,
    )


def _classical(
    name: str,
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None,
) -> Increment:
    """Do what `advance` does with `CLASSICAL`, to the last bit: its stages written out, so that it can be compiled."""
    frame = _frame(inertia, held, h, velocity, orientation, angular_velocity)
    k1 = _slope(name, frame, _Reached(0.0, ZERO, ZERO, ZERO, frame.velocity), load)
    k2 = _slope(name, frame, _reached(frame, 0.5 * h, k1), load)
    k3 = _slope(name, frame, _reached(frame, 0.5 * h, k2), load)
    k4 = _slope(name, frame, _reached(frame, h, k3), load)
    a, b = 1.0 / 6.0, 1.0 / 3.0
    mean = _Slope(
        _mean(k1.turn, k2.turn, k3.turn, k4.turn),
        _mean(k1.push, k2.push, k3.push, k4.push),
        _mean(k1.twist, k2.twist, k3.twist, k4.twist),
        ZERO,
        a * h * k1.power + b * h * k2.power + b * h * k3.power + a * h * k4.power,
    )
    second = add_scaled(add_scaled(add_scaled(ZERO, a, k1.push), a, k2.push), a, k3.push)
    return require_finite(name, h, _end(frame, velocity, mean, second))


def _reached(frame: _Frame, ahead: float, k: _Slope) -> _Reached:
    return _Reached(
        ahead,
        add_scaled(ZERO, ahead, k.turn),
        add_scaled(ZERO, ahead, k.twist),
        add_scaled(ZERO, ahead, k.velocity),
        add_scaled(frame.velocity, ahead / frame.inertia.mass, add(k.push, frame.force)),
    )


def _mean(k1: Vector, k2: Vector, k3: Vector, k4: Vector) -> Vector:
    a, b = 1.0 / 6.0, 1.0 / 3.0
    return add_scaled(add_scaled(add_scaled(add_scaled(ZERO, a, k1), b, k2), b, k3), a, k4)


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

    def written_out(
        inertia: Inertia,
        held: HeldWrench,
        h: float,
        velocity: Vector,
        orientation: Quaternion,
        angular_velocity: Vector,
        load: Load | None = None,
    ) -> Increment:
        return _classical(name, inertia, held, h, velocity, orientation, angular_velocity, load)

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
    written_out.__doc__ = step.__doc__
    invariants = frozenset({"angular_momentum", "unit_quaternion"})
    if tableau is CLASSICAL:
        return Method(name, order, invariants, written_out, takes=Takes.ANY, compiles=True)
    return Method(name, order, invariants, step, takes=Takes.ANY, pair=pair if tableau.comparison else None)


_SOURCE = "Munthe-Kaas, BIT 38 (1998) 92; IMNZ algorithm 4.1"

RKMK4 = _method("rkmk4", 4, CLASSICAL, _SOURCE)

RKMK54 = _method(
    "rkmk54", 5, DORMAND_PRINCE, f"{_SOURCE}, with the tableau of Hairer, Norsett & Wanner I, table II.5.2"
)
