"""Heun's method on the group of motions: the mean of the rates at the start and at a step of Euler."""

from __future__ import annotations

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Load, LoadDependence, Method
from rb_dynamics.motion.step_checks import require_finite, require_small_turn
from rb_dynamics.numerics.rotation import Quaternion, exp, multiply, normalize, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, cross, divide, dot, norm, scale, subtract
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
    """Advance by Heun's method (Hairer, Norsett, Wanner, Solving ODEs I, eq. II.1.3), attitude by exp of the mean rate.

    Order 2 under any load; keeps no invariant.

    Raises:
        ConvergenceError: the step turns the body too far, or diverges.
    """

    def wrench(t: float, place: Vector, v: Vector, q: Quaternion, w: Vector) -> tuple[Vector, Vector]:
        force = add(rotate(q, held.force_body), held.force_world)
        torque = add(held.torque_body, rotate_inverse(q, held.torque_world))
        if load is None:
            return force, torque
        push, twist = load(t, place, v, q, w)
        return add(force, push), add(torque, twist)

    def turning(w: Vector, torque: Vector) -> Vector:
        return divide(subtract(torque, cross(w, times(inertia.moments, w))), inertia.moments)

    require_small_turn("heun", h, norm(angular_velocity))
    force, torque = wrench(0.0, ZERO, velocity, orientation, angular_velocity)
    alpha = turning(angular_velocity, torque)
    # A step of Euler, and what acts at its end.
    v = add_scaled(velocity, h / inertia.mass, force)
    q = multiply(orientation, exp(scale(h, angular_velocity)))
    w = add_scaled(angular_velocity, h, alpha)
    force_then, torque_then = wrench(h, scale(h, velocity), v, q, w)
    alpha_then = turning(w, torque_then)
    power = dot(force, velocity) + dot(torque, angular_velocity)
    power_then = dot(force_then, v) + dot(torque_then, w)
    half = 0.5 * h
    end = Increment(
        displacement=scale(half, add(velocity, v)),
        orientation=normalize(multiply(orientation, exp(scale(half, add(angular_velocity, w))))),
        angular_velocity=add_scaled(angular_velocity, half, add(alpha, alpha_then)),
        impulse=scale(half, add(force, force_then)),
        torque_impulse=scale(half, add(rotate(orientation, torque), rotate(q, torque_then))),
        work=half * (power + power_then),
    )
    return require_finite("heun", h, end)


HEUN = Method("heun", order=2, invariants=frozenset({"unit_quaternion"}), step=step, takes=LoadDependence.ANY)
