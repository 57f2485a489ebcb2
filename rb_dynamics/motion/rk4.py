"""The classical Runge-Kutta method on quaternion and angular velocity: the usual baseline."""

from __future__ import annotations

from typing import NamedTuple

from rb_dynamics.loads.varying_load import evaluated
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.equations_of_motion import differences_of, gyroscopic, half_product, turned
from rb_dynamics.motion.method import Increment, Inertia, Load, LoadDependence, Method
from rb_dynamics.motion.step_checks import is_rotation, no_rotation, require_finite
from rb_dynamics.numerics.rotation import Quaternion, normalize, renormalize
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, dot, norm, scale
from rb_dynamics.numerics.vector import multiply as times


def step(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance (q, omega, v, x) by the classical RK4 and normalise q (Hairer, Norsett & Wanner I, table II.1.2).

    q' = q omega / 2, I omega' = tau - omega x I omega (lecture 24, eq. 18), v' = F / m. Order 4, under any load too;
    has no invariants: the normalisation hides the error of |q|, not that of energy and angular momentum.

    Raises:
        ConvergenceError: the step rotates the body so far that a stage is not a rotation, or diverges.
    """
    inverse_mass, differences, moments = 1.0 / inertia.mass, differences_of(inertia.moments), inertia.moments
    inverse = (1.0 / moments[0], 1.0 / moments[1], 1.0 / moments[2])
    half = 0.5 * h

    # Stages are written out so that the compiler vectorises over bodies (`batch_kernel.py`), and for speed in Python.
    q, w, v = orientation, angular_velocity, velocity
    one = _slope(differences, inverse, held, 0.0, ZERO, v, q, w, load)
    ahead = scale(half, v)
    q, w = _add_scaled(orientation, half, one.spin), add_scaled(angular_velocity, half, one.angular)
    v = add_scaled(velocity, half * inverse_mass, one.force)
    two = _slope(differences, inverse, held, half, ahead, v, q, w, load)
    ahead = scale(half, v)
    q, w = _add_scaled(orientation, half, two.spin), add_scaled(angular_velocity, half, two.angular)
    v = add_scaled(velocity, half * inverse_mass, two.force)
    three = _slope(differences, inverse, held, half, ahead, v, q, w, load)
    ahead = scale(h, v)
    q, w = _add_scaled(orientation, h, three.spin), add_scaled(angular_velocity, h, three.angular)
    v = add_scaled(velocity, h * inverse_mass, three.force)
    four = _slope(differences, inverse, held, h, ahead, v, q, w, load)

    sixth = h / 6.0
    a, b, c, d = one.spin, two.spin, three.spin, four.spin
    middle = (2.0 * (b[0] + c[0]), 2.0 * (b[1] + c[1]), 2.0 * (b[2] + c[2]), 2.0 * (b[3] + c[3]))
    spin = (a[0] + d[0] + middle[0], a[1] + d[1] + middle[1], a[2] + d[2] + middle[2], a[3] + d[3] + middle[3])
    q = _add_scaled(orientation, sixth, spin)
    # Products, because a power that overflows raises in Python.
    square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    if not is_rotation(square):
        return no_rotation("rk4", h, square, norm(angular_velocity))
    end = Increment(
        # Weighted sums of the velocities of the stages.
        add_scaled(scale(h, velocity), h * sixth * inverse_mass, add(one.force, add(two.force, three.force))),
        renormalize(q),
        add_scaled(angular_velocity, sixth, _sum(one.angular, two.angular, three.angular, four.angular)),
        scale(sixth, _sum(one.force, two.force, three.force, four.force)),
        scale(sixth, _sum(one.torque, two.torque, three.torque, four.torque)),
        sixth * (one.power + four.power + 2.0 * (two.power + three.power)),
    )
    return require_finite("rk4", h, end)


class _Slope(NamedTuple):
    """Rates at a stage, for state, work and impulses.

    Attributes:
        spin: rate of the quaternion, 1/s.
        angular: angular acceleration, principal axes, rad/s^2.
        force: world axes, N.
        torque: world axes, N m.
        power: W.
    """

    spin: Quaternion
    angular: Vector
    force: Vector
    torque: Vector
    power: float


def _slope(
    differences: Vector,
    inverse: Vector,
    held: HeldWrench,
    t: float,
    displacement: Vector,
    velocity: Vector,
    q: Quaternion,
    omega: Vector,
    load: Load | None,
) -> _Slope:
    x, y, z, w = q
    # A stage is a unit quaternion only to the order of the method. One division here is cheaper than its norm.
    twice = 2.0 / (x * x + y * y + z * z + w * w)
    force = add(turned(q, twice, held.force_body), held.force_world)
    torque = held.torque_body
    # Rare; checking earlier would delay all later operations of the stage.
    if held.torque_world != ZERO:
        torque = add(torque, turned((-x, -y, -z, w), twice, held.torque_world))
    if load is not None:
        push, twist = evaluated(load, t, displacement, velocity, normalize(q), omega)
        force, torque = add(force, push), add(torque, twist)
    return _Slope(
        half_product(q, omega),
        times(add(torque, gyroscopic(differences, omega)), inverse),
        force,
        turned(q, twice, torque),
        dot(force, velocity) + dot(torque, omega),
    )


def _add_scaled(p: Quaternion, s: float, q: Quaternion) -> Quaternion:
    return (p[0] + s * q[0], p[1] + s * q[1], p[2] + s * q[2], p[3] + s * q[3])


def _sum(a: Vector, b: Vector, c: Vector, d: Vector) -> Vector:
    """Return a + 2 b + 2 c + d."""
    return (
        a[0] + d[0] + 2.0 * (b[0] + c[0]),
        a[1] + d[1] + 2.0 * (b[1] + c[1]),
        a[2] + d[2] + 2.0 * (b[2] + c[2]),
    )


RK4 = Method(
    "rk4",
    order=4,
    invariants=frozenset({"unit_quaternion"}),
    step=step,
    takes=LoadDependence.ANY,
    compiles=True,
    takes_arrays=True,
)
