"""Runge-Kutta-Munthe-Kaas methods: Runge-Kutta in the Lie algebra, so that the attitude stays a rotation."""

from __future__ import annotations

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia, Method
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

# The classical fourth-order tableau: each stage starts from the one before it.
_WEIGHTS = (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)
_NODES = (0.0, 0.5, 0.5, 1.0)

# exp is a diffeomorphism and dexpinv is regular for turns below 2 pi; half of that leaves the stages room.
_LARGEST_TURN = 3.0


def step(
    inertia: Inertia, held: HeldWrench, h: float, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
) -> Increment:
    """Advance by RKMK4 with dexpinv (Munthe-Kaas, BIT 38 (1998) 92; IMNZ algorithm 4.1).

    With R = R0 exp(theta): theta' = dexpinv_{-theta}(omega), and the angular momentum is carried in the axes of R0,
    m = exp(-theta) (m0 + lambda) with lambda' = exp(theta) tau. So the world-frame angular momentum changes by the
    quadrature of the torque and by nothing else. Order 4; keeps the angular momentum and the unit quaternion.

    Raises:
        ConvergenceError: the step turns the body further than exp can be inverted.
    """
    mass, moments = inertia
    momentum = multiply(moments, angular_velocity)
    force_0 = rotate_inverse(orientation, held.force_world)
    torque_0 = rotate_inverse(orientation, held.torque_world)
    velocity_0 = rotate_inverse(orientation, velocity)

    # Sums over the stages, all in the axes of R0; *_k is the slope of the stage before. Only the parts that turn with
    # the body need the quadrature, the world-frame parts are constant there.
    theta, theta_sum, theta_k = ZERO, ZERO, ZERO
    force_sum, force_k, force_moment = ZERO, ZERO, ZERO
    torque_sum, torque_k = ZERO, ZERO
    work = 0.0
    for stage in range(4):
        ahead = _NODES[stage] * h
        theta = scale(ahead, theta_k)
        turn = exp(theta)
        impulse = add_scaled(scale(ahead, torque_k), ahead, torque_0)
        v = add_scaled(velocity_0, ahead / mass, add(force_k, force_0))
        omega = divide(rotate_inverse(turn, add(momentum, impulse)), moments)

        theta_k = dexpinv(scale(-1.0, theta), omega)
        force_k = rotate(turn, held.force_body)
        torque_k = rotate(turn, held.torque_body)
        weight = _WEIGHTS[stage]
        theta_sum = add_scaled(theta_sum, weight, theta_k)
        force_sum = add_scaled(force_sum, weight, force_k)
        torque_sum = add_scaled(torque_sum, weight, torque_k)
        if stage < 3:
            force_moment = add_scaled(force_moment, 1.0 / 6.0, force_k)
        power = dot(add(force_k, force_0), v) + dot(held.torque_body, omega) + dot(torque_0, rotate(turn, omega))
        work += weight * h * power
        if not norm(theta_k) * h < _LARGEST_TURN:
            raise ConvergenceError(
                f"rkmk4: a step of {h:g} s turns the body by {norm(theta_k) * h:.3g} rad, expected less than "
                f"{_LARGEST_TURN:g} rad; use a step below {_LARGEST_TURN / norm(theta_k):.3g} s"
            )

    turn = exp(scale(h, theta_sum))
    torque_impulse = scale(h, torque_sum)
    displacement = rotate(orientation, scale(h * h / mass, force_moment))
    return Increment(
        add(scale(h, velocity), add_scaled(displacement, 0.5 * h * h / mass, held.force_world)),
        normalize(compose(orientation, turn)),
        divide(rotate_inverse(turn, add(momentum, add_scaled(torque_impulse, h, torque_0))), moments),
        add_scaled(rotate(orientation, scale(h, force_sum)), h, held.force_world),
        add_scaled(rotate(orientation, torque_impulse), h, held.torque_world),
        work,
    )


RKMK4 = Method("rkmk4", order=4, invariants=frozenset({"angular_momentum", "unit_quaternion"}), step=step)
