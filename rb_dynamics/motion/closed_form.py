"""Motions with a closed form, as a method: one step of any length.

These are free motion, without torque and without force in body axes, and motion that stays planar (`planar_motion.py`).
"""

from __future__ import annotations

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion import planar_motion
from rb_dynamics.motion.free_rotation import free_rotation
from rb_dynamics.motion.method import Increment, Inertia, Load, Method
from rb_dynamics.motion.planar_motion import fixed_axis
from rb_dynamics.motion.step_checks import require_known_attitude
from rb_dynamics.numerics.rotation import Quaternion, multiply, renormalize
from rb_dynamics.numerics.vector import ZERO, Vector, add_scaled, dot, norm, scale


def is_free(held: HeldWrench) -> bool:
    """Return whether the motion under `held` is free: no torque, and no force except one constant in world axes."""
    return held.torque_body == held.torque_world == held.force_body == ZERO


def has_closed_form(held: HeldWrench, orientation: Quaternion, angular_velocity: Vector) -> bool:
    """Return whether the motion under `held` is free, or a rotation about one fixed axis."""
    return is_free(held) or fixed_axis(held, orientation, angular_velocity) >= 0


def free_step(
    inertia: Inertia, held: HeldWrench, h: float, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
) -> Increment:
    """Return the increment of h s of free rotation, under a force that is constant in world axes."""
    turn, omega = free_rotation(inertia.moments, angular_velocity, h)
    displacement = add_scaled(scale(h, velocity), 0.5 * h * h / inertia.mass, held.force_world)
    return Increment(
        displacement,
        renormalize(multiply(orientation, turn)),
        omega,
        scale(h, held.force_world),
        ZERO,
        dot(held.force_world, displacement),
    )


def step(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    load: Load | None = None,
) -> Increment:
    """Advance by the closed form of free rotation (`free_rotation`), or rotation about a fixed axis (`planar_motion`).

    No order: the error does not depend on h. Conserves energy and angular momentum to round-off for any h. Celledoni,
    Fasso, Safstrom & Zanna, SIAM J. Sci. Comput. 30 (2008) 2084.

    Raises:
        ConvergenceError: there is no closed form, because a torque or a force in body axes tilts the axis or a load
            changes inside the step; or the rotation is so long that no digit of the attitude is left.
    """
    if load is not None:
        raise ConvergenceError(
            "exact: a load that changes inside the step acts, expected free motion or a constant force in world axes; "
            "use method auto, or one of the methods with a step that take such a load"
        )
    if not is_free(held):
        axis = fixed_axis(held, orientation, angular_velocity)
        if axis < 0:
            raise ConvergenceError(
                "exact: a torque or a force in body axes acts that tilts the axis of rotation, expected free motion, a "
                "force in world axes, or a torque along the principal axis about which the body turns; use method "
                "auto, which is exact wherever there is a closed form, or one of the methods with a step"
            )
        return planar_motion.advance(inertia, held, h, velocity, orientation, angular_velocity, axis)
    require_known_attitude("exact", h, norm(angular_velocity))
    return free_step(inertia, held, h, velocity, orientation, angular_velocity)


EXACT = Method("exact", order=None, invariants=frozenset({"energy", "angular_momentum", "unit_quaternion"}), step=step)
