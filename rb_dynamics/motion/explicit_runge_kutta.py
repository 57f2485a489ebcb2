"""Common parts of explicit Runge-Kutta methods of high order: the equations in increments, and the sums of a step.

The equations are those of `rk4`, but the attitude is relative to the axes R0 at the start of the step, and velocity and
position are relative to an observer who moves along. The increments are small, and so are their rounding errors. Under
a held wrench no stage needs force or position: they are sums over the weights.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from rb_dynamics.loads.varying_load import evaluated
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.equations_of_motion import differences_of, gyroscopic, half_product, turned
from rb_dynamics.motion.method import Increment, Inertia, Load
from rb_dynamics.motion.step_checks import is_rotation, no_rotation, require_finite
from rb_dynamics.numerics.rotation import Quaternion, multiply, normalize, renormalize, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, dot, norm, scale
from rb_dynamics.numerics.vector import multiply as times

Turn = tuple[Quaternion, Vector]
"""Change of the quaternion since R0 and of the angular velocity."""

Carried = tuple[Vector, Vector]
"""Impulse and displacement, in the axes R0, without their uniform parts."""

Row = tuple[float, ...]
"""Weights of the slopes; zero weights are left out."""


class StepConstants(NamedTuple):
    """Constants of a step; `*_0` in the axes R0.

    `differences` are those of the moments, and `inverse` is 1 / I.
    """

    differences: Vector
    inverse: Vector
    inverse_mass: float
    held: HeldWrench
    h: float
    velocity: Vector
    orientation: Quaternion
    angular_velocity: Vector
    force_0: Vector
    torque_0: Vector


class Slope(NamedTuple):
    """Rates at a stage.

    Attributes:
        turn: rates of quaternion and angular velocity.
        push: the force, without the constant force in world axes; axes R0.
        gain: change of velocity since the start, m/s; axes R0; zero without a load.
        twist: the torque, without the constant torque in world axes; axes R0.
        power: of the torques, and with a load also of the forces.
    """

    turn: Turn
    push: Vector
    gain: Vector
    twist: Vector
    power: float


Slopes = tuple[Slope, ...]

_START: Turn = ((0.0, 0.0, 0.0, 0.0), ZERO)


def step_constants(
    inertia: Inertia, held: HeldWrench, h: float, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
) -> StepConstants:
    """Return the constants of a step."""
    a, b, c = inertia.moments
    return StepConstants(
        differences_of(inertia.moments),
        (1.0 / a, 1.0 / b, 1.0 / c),
        1.0 / inertia.mass,
        held,
        h,
        velocity,
        orientation,
        angular_velocity,
        rotate_inverse(orientation, held.force_world),
        rotate_inverse(orientation, held.torque_world),
    )


def first(f: StepConstants, load: Load | None) -> Slope:
    """Return the slope at the start of the step."""
    return slope(f, 0.0, _START, (ZERO, ZERO), load)


def stage(f: StepConstants, node: float, row: Row, slopes: Slopes, load: Load | None) -> Slope:
    """Return the slope at `node` of the step, from h times the sum of `slopes` with the weights of `row`."""
    carried = (ZERO, ZERO)
    if load is not None:
        carried = _carried(f.h, row, slopes)
    return slope(f, node, total(f.h, row, slopes), carried, load)


def total(h: float, row: Row, slopes: Slopes) -> Turn:
    """Return h times the sum of the state's slopes with the weights of `row`."""
    (a, b, c, d), (e, f, g) = slopes[0].turn
    s = row[0]
    a, b, c, d, e, f, g = s * a, s * b, s * c, s * d, s * e, s * f, s * g
    for k in range(1, len(row)):
        s = row[k]
        (a1, b1, c1, d1), (e1, f1, g1) = slopes[k].turn
        a, b, c, d = a + s * a1, b + s * b1, c + s * c1, d + s * d1
        e, f, g = e + s * e1, f + s * f1, g + s * g1
    return (h * a, h * b, h * c, h * d), (h * e, h * f, h * g)


def moved(f: StepConstants, nodes: Row, row: Row, slopes: Slopes, load: Load | None) -> Carried:
    """Return impulse and displacement for the weights of `row`; `nodes` are those of the slopes.

    Without a load the slopes do not contain the velocity: the displacement by the force of each stage then has the
    weights sum of b_j a_ji = b_i (1 - c_i), the simplifying assumption D(1) (Hairer, Norsett & Wanner I, eq. II.5.7).
    The weights of the error estimates of DOP853 do not fulfil it: theirs is another estimate, of the same orders and
    several times larger.
    """
    if load is not None:
        return _carried(f.h, row, slopes)
    pushed = shifted = ZERO
    for k, s in enumerate(row):
        pushed = add_scaled(pushed, s, slopes[k].push)
        shifted = add_scaled(shifted, s * (1.0 - nodes[k]), slopes[k].push)
    return scale(f.h, pushed), scale(f.h * f.h * f.inverse_mass, shifted)


def end(name: str, f: StepConstants, nodes: Row, weights: Row, slopes: Slopes, load: Load | None) -> Increment:
    """Return the change of state for h times the sum of `slopes` with `weights`; `nodes` are those of the slopes.

    Raises:
        ConvergenceError: the result is not a rotation, or not finite.
    """
    turn, carried = total(f.h, weights, slopes), moved(f, nodes, weights, slopes, load)
    return increment(name, f, turn, carried, booked(f.h, weights, slopes), load)


def booked(h: float, weights: Row, slopes: Slopes) -> tuple[Vector, float]:
    """Return h times the sums of twist and power with `weights`."""
    twisted, work = ZERO, 0.0
    for k, weight in enumerate(weights):
        twisted, work = add_scaled(twisted, weight * h, slopes[k].twist), work + weight * h * slopes[k].power
    return twisted, work


def increment(
    name: str, f: StepConstants, turn: Turn, carried: Carried, books: tuple[Vector, float], load: Any
) -> Increment:
    """Return the increment for `turn` and `carried`, with the impulse of the torque and the work in `books`.

    Raises:
        ConvergenceError: as for `end`.
    """
    h, orientation = f.h, f.orientation
    (x, y, z, w), spin_up = turn
    pushed, shifted = carried
    w += 1.0
    square = x * x + y * y + z * z + w * w
    if not is_rotation(square):
        return no_rotation(name, h, square, norm(f.angular_velocity))
    twisted, work = books
    impulse = add_scaled(rotate(orientation, pushed), h, f.held.force_world)
    path = add_scaled(rotate(orientation, shifted), h, f.velocity)
    if load is None:
        path = add_scaled(path, 0.5 * h * h * f.inverse_mass, f.held.force_world)
        # For the held wrench: impulse times mean velocity.
        work += 0.5 * f.inverse_mass * dot(impulse, impulse)
    found = Increment(
        path,
        renormalize(multiply(orientation, normalize((x, y, z, w)))),
        add(f.angular_velocity, spin_up),
        impulse,
        add_scaled(rotate(orientation, twisted), h, f.held.torque_world),
        dot(f.velocity, impulse) + work,
    )
    return require_finite(name, h, found)


def _carried(h: float, row: Row, slopes: Slopes) -> Carried:
    pushed = shifted = ZERO
    for k, s in enumerate(row):
        pushed, shifted = add_scaled(pushed, s, slopes[k].push), add_scaled(shifted, s, slopes[k].gain)
    return scale(h, pushed), scale(h, shifted)


def slope(f: StepConstants, node: float, reached: Turn, carried: Carried, load: Any) -> Slope:
    """Return the slope at `node` of the step, where the body has `reached` a turn and `carried` its motion."""
    (x, y, z, w), spin_up = reached
    q, omega, gain = (x, y, z, 1.0 + w), add(f.angular_velocity, spin_up), ZERO
    # One division is cheaper than a norm.
    twice = 2.0 / (x * x + y * y + z * z + q[3] * q[3])
    push, torque = turned(q, twice, f.held.force_body), f.held.torque_body
    if load is not None:
        ahead, (pushed, shifted) = node * f.h, carried
        gain = scale(f.inverse_mass, add_scaled(pushed, ahead, f.force_0))
        turn = normalize(q)
        place = add_scaled(rotate(f.orientation, shifted), ahead, f.velocity)
        v = add(f.velocity, rotate(f.orientation, gain))
        force, more = evaluated(load, ahead, place, v, multiply(f.orientation, turn), omega)
        push, torque = add(push, rotate_inverse(f.orientation, force)), add(torque, more)
    all_torque = torque
    # Rare; checking earlier would delay all later operations of the stage.
    if f.held.torque_world != ZERO:
        all_torque = add(torque, turned((-x, -y, -z, q[3]), twice, f.torque_0))
    omega_dot = times(add(all_torque, gyroscopic(f.differences, omega)), f.inverse)
    power = dot(all_torque, omega)
    if load is not None:
        power += dot(add(push, f.force_0), gain)
    return Slope((half_product(q, omega), omega_dot), push, gain, turned(q, twice, torque), power)
