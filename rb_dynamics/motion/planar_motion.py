"""Motion that provably stays planar: rotation about one principal axis that nothing tilts, I theta'' = N.

One angle describes the attitude, in closed form for a constant torque. A body that does not rotate is included.
"""

from __future__ import annotations

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.motion.method import Increment, Inertia
from rb_dynamics.motion.step_checks import require_known_attitude
from rb_dynamics.numerics.rotation import Quaternion, exp, multiply, renormalize, rotate, rotate_inverse
from rb_dynamics.numerics.vector import ZERO, Vector, add, add_scaled, dot, scale

_AXES: tuple[Vector, Vector, Vector] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def fixed_axis(held: HeldWrench, orientation: Quaternion, angular_velocity: Vector) -> int:
    """Return the only principal axis (0, 1 or 2) about which the body turns under `held`; -1 if there is none.

    Angular velocity and torque must have exactly this component alone, and so must a force in body axes, which would
    otherwise turn with the body. If nothing turns at all, any axis is valid.
    """
    torque, force = _torque(held, orientation), held.force_body
    x = angular_velocity[0] != 0.0 or torque[0] != 0.0
    y = angular_velocity[1] != 0.0 or torque[1] != 0.0
    z = angular_velocity[2] != 0.0 or torque[2] != 0.0
    if not (x or y or z):
        return 2
    if x and not (y or z) and force[1] == force[2] == 0.0:
        return 0
    if y and not (x or z) and force[0] == force[2] == 0.0:
        return 1
    if z and not (x or y) and force[0] == force[1] == 0.0:
        return 2
    return -1


def advance(
    inertia: Inertia,
    held: HeldWrench,
    h: float,
    velocity: Vector,
    orientation: Quaternion,
    angular_velocity: Vector,
    axis: int,
) -> Increment:
    """Advance by theta = w h + N h^2 / 2 I about `axis` (lecture 24, page 3) and the parabola of a constant force."""
    mass, moments = inertia
    torque = _torque(held, orientation)[axis]
    slope = torque / moments[axis]
    angle = h * (angular_velocity[axis] + 0.5 * h * slope)
    require_known_attitude("exact", 1.0, abs(angle))
    unit = _AXES[axis]
    force = add(rotate(orientation, held.force_body), held.force_world)
    displacement = add_scaled(scale(h, velocity), 0.5 * h * h / mass, force)
    torque_world = add(rotate(orientation, held.torque_body), held.torque_world) if torque != 0.0 else ZERO
    return Increment(
        displacement,
        renormalize(multiply(orientation, exp(scale(angle, unit)))),
        add_scaled(angular_velocity, h * slope, unit),
        scale(h, force),
        scale(h, torque_world),
        dot(force, displacement) + torque * angle,
    )


def _torque(held: HeldWrench, orientation: Quaternion) -> Vector:
    if held.torque_world == ZERO:
        return held.torque_body
    return add(held.torque_body, rotate_inverse(orientation, held.torque_world))
