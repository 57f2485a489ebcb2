"""The exact free motion as a method: one step of any length, where no torque and no force in body axes acts."""

from __future__ import annotations

from rb_dynamics.errors import ConvergenceError
from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.free import FreeRotation
from rb_dynamics.motion.method import Increment, Inertia, Method
from rb_dynamics.rotation import Quaternion, normalize
from rb_dynamics.rotation import multiply as compose
from rb_dynamics.vector import ZERO, Vector, add_scaled, dot, scale


def is_free(held: HeldWrench) -> bool:
    """Return whether the motion under `held` has a closed form: no torque, no force but one constant in the world."""
    return held.torque_body == held.torque_world == held.force_body == ZERO


def step(
    inertia: Inertia, held: HeldWrench, h: float, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
) -> Increment:
    """Advance by the closed form of the free rotation (`FreeRotation`) and of the motion under a constant force.

    No order: the error does not depend on h. Keeps energy and angular momentum to round-off at any h. Celledoni, Fasso,
    Safstrom & Zanna, SIAM J. Sci. Comput. 30 (2008) 2084.

    Raises:
        ConvergenceError: a torque or a force in body axes acts.
    """
    if not is_free(held):
        raise ConvergenceError(
            "exact: a torque or a force in body axes acts, expected free motion or a force in world axes alone; use "
            "method auto, which is exact wherever nothing turns the body, or one of the methods with a step"
        )
    turn, omega = FreeRotation(inertia.moments, angular_velocity).at(h)
    displacement = add_scaled(scale(h, velocity), 0.5 * h * h / inertia.mass, held.force_world)
    return Increment(
        displacement,
        normalize(compose(orientation, turn)),
        omega,
        scale(h, held.force_world),
        ZERO,
        dot(held.force_world, displacement),
    )


EXACT = Method("exact", order=None, invariants=frozenset({"energy", "angular_momentum", "unit_quaternion"}), step=step)
