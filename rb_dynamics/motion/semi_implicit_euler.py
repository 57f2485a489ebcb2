"""Semi-implicit Euler, as used in physics engines for rigid bodies: a baseline of order 1."""

from __future__ import annotations

from rb_dynamics.loads.varying_load import evaluated
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.equations_of_motion import differences_of, gyroscopic
from rb_dynamics.motion.method import Increment, Inertia, Load, LoadDependence, Method
from rb_dynamics.motion.step_checks import LARGEST_TURN, require_finite, turns_too_far
from rb_dynamics.numerics.rotation import Quaternion, exp, multiply, renormalize, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, divide, dot, norm, scale


def step(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance by semi-implicit Euler with an explicit gyroscopic term (symplectic Euler, HLW eq. I.1.9).

    All loads are those at the start of the step; v1 = v0 + h F / m, x1 = x0 + h v1, w1 = w0 + h I^-1 (tau - w0 x I w0),
    q1 = q0 exp(h w1). The work is the impulses times the mean of the velocities before and after, so that the energy
    defect shows the errors of attitude and gyroscopic term. Order 1, under any load too; has no invariants.

    Raises:
        ConvergenceError: the step rotates the body too far, or diverges.
    """
    force = add(rotate(orientation, held.force_body), held.force_world)
    torque = add(held.torque_body, rotate_inverse(orientation, held.torque_world))
    if load is not None:
        push, twist = evaluated(load, 0.0, ZERO, velocity, orientation, angular_velocity)
        force, torque = add(force, push), add(torque, twist)
    free = gyroscopic(differences_of(inertia.moments), angular_velocity)
    omega = add_scaled(angular_velocity, h, divide(add(torque, free), inertia.moments))
    gain = scale(h / inertia.mass, force)
    rate = norm(omega)
    if not rate * abs(h) < LARGEST_TURN:
        return turns_too_far("euler", h, rate)
    power = dot(force, add_scaled(velocity, 0.5, gain)) + 0.5 * dot(torque, add(angular_velocity, omega))
    end = Increment(
        scale(h, add(velocity, gain)),
        renormalize(multiply(orientation, exp(scale(h, omega)))),
        omega,
        scale(h, force),
        scale(h, rotate(orientation, torque)),
        h * power,
    )
    return require_finite("euler", h, end)


EULER = Method(
    "euler", order=1, invariants=frozenset({"unit_quaternion"}), step=step, takes=LoadDependence.ANY, compiles=True
)
