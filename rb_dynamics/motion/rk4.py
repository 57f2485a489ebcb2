"""The classical Runge-Kutta method on quaternion and angular velocity: the baseline that users know."""

from __future__ import annotations

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Load, Method, Takes
from rb_dynamics.motion.refusal import no_rotation, require_finite
from rb_dynamics.rotation import Quaternion, normalize, rotate, rotate_inverse
from rb_dynamics.vector import ZERO, Vector, add, add_scaled, cross, divide, dot, multiply, norm, scale, subtract

_WEIGHTS = (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)
_NODES = (0.0, 0.5, 0.5, 1.0)


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
    keeps no invariant: the normalisation hides the error of |q|, not that of energy and angular momentum.

    Raises:
        ConvergenceError: the step turns the body so far that a stage is no rotation any more, or diverges.
    """
    mass, moments = inertia
    q, omega, v, v_before = orientation, angular_velocity, velocity, ZERO
    q_sum = (0.0, 0.0, 0.0, 0.0)
    omega_sum, displacement, impulse, torque_impulse, work = ZERO, ZERO, ZERO, ZERO, 0.0
    for stage in range(4):
        attitude = normalize(q)
        force = add(rotate(attitude, held.force_body), held.force_world)
        torque = add(held.torque_body, rotate_inverse(attitude, held.torque_world))
        if load is not None:
            ahead = _NODES[stage] * h
            push, twist = load(ahead, scale(ahead, v_before), v, attitude, omega)
            force, torque = add(force, push), add(torque, twist)
        omega_dot = divide(subtract(torque, cross(omega, multiply(moments, omega))), moments)
        q_dot = _kinematics(q, omega)

        weight = _WEIGHTS[stage] * h
        q_sum = _add_scaled(q_sum, weight, q_dot)
        omega_sum = add_scaled(omega_sum, weight, omega_dot)
        displacement = add_scaled(displacement, weight, v)
        impulse = add_scaled(impulse, weight, force)
        torque_impulse = add_scaled(torque_impulse, weight, rotate(attitude, torque))
        work += weight * (dot(force, v) + dot(torque, omega))
        if stage < 3:
            ahead = _NODES[stage + 1] * h
            q = _add_scaled(orientation, ahead, q_dot)
            omega = add_scaled(angular_velocity, ahead, omega_dot)
            v_before, v = v, add_scaled(velocity, ahead / mass, force)
    q_end = _add_scaled(orientation, 1.0, q_sum)
    # Products, as a power that overflows is an error in Python and no infinity.
    square = q_end[0] * q_end[0] + q_end[1] * q_end[1] + q_end[2] * q_end[2] + q_end[3] * q_end[3]
    if not 0.5 < square < 2.0:
        return no_rotation("rk4", h, square, norm(angular_velocity))
    end = Increment(displacement, normalize(q_end), add(angular_velocity, omega_sum), impulse, torque_impulse, work)
    return require_finite("rk4", h, end)


def _kinematics(q: Quaternion, omega: Vector) -> Quaternion:
    """Return q omega / 2."""
    x, y, z, w = q
    a, b, c = scale(0.5, omega)
    return (w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a, -x * a - y * b - z * c)


def _add_scaled(p: Quaternion, s: float, q: Quaternion) -> Quaternion:
    return (p[0] + s * q[0], p[1] + s * q[1], p[2] + s * q[2], p[3] + s * q[3])


RK4 = Method("rk4", order=4, invariants=frozenset({"unit_quaternion"}), step=step, takes=Takes.ANY, compiles=True)
