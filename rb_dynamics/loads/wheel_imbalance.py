"""The imbalance of a wheel: a force and a torque on the body that turn with the wheel.

With the speed W and a direction u perpendicular to the axis that turns with the wheel, the force is U_s W^2 u at the
wheel's place, and the torque is U_d W^2 u in addition to that of the force: the simple model of disturbance budgets.
Both act like external loads: the wheel does not lose the momentum that they transfer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.numerics.rotation import rotate_inverse
from rb_dynamics.numerics.sincos import sincos
from rb_dynamics.numerics.vector import ZERO, Vector, add_scaled, cross, dot, norm, scale, subtract

if TYPE_CHECKING:
    from rb_dynamics.loads.reaction_wheel import ReactionWheel

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

SEEN = 0.5 * math.pi
"""Largest angle (rad) by which a wheel may turn in a step: beyond it, the error of a step may seem small by chance."""

RESOLVED = math.pi
"""Largest angle (rad) by which a wheel may turn in a fixed step: the error is then 1e-4 of the imbalance's effect."""


class WheelImbalance(NamedTuple):
    """Force (kg m) and torque about the centre of mass (kg m^2) per square of the speed, in principal axes.

    Attributes:
        wheel: number of the wheel.
        forces: at the angle 0, and a quarter turn later.
        torques: likewise.
    """

    wheel: int
    forces: tuple[Vector, Vector]
    torques: tuple[Vector, Vector]


def imbalances(wheels: Sequence[ReactionWheel], body: RigidBody) -> tuple[WheelImbalance, ...]:
    """Return the imbalances of the wheels that have one."""
    found = []
    for k, wheel in enumerate(wheels):
        if not wheel.is_balanced:
            place = body.center_of_mass if wheel.position is None else wheel.position
            arm = subtract(place, body.center_of_mass)
            forces, torques = [], []
            for way in across(wheel.axis):
                force = scale(wheel.static_imbalance, way)
                torque = add_scaled(cross(arm, force), wheel.dynamic_imbalance, way)
                forces.append(rotate_inverse(body.principal_orientation_xyzw, force))
                torques.append(rotate_inverse(body.principal_orientation_xyzw, torque))
            found.append(WheelImbalance(k, (forces[0], forces[1]), (torques[0], torques[1])))
    return tuple(found)


def across(axis: Vector) -> tuple[Vector, Vector]:
    """Return the directions of the angle 0 and of a quarter turn about `axis`, in the same axes.

    The first is y if the largest component of `axis` is x, z if it is y, x if it is z, made perpendicular to the axis.
    """
    axis = scale(1.0 / norm(axis), axis)
    x, y, z = map(abs, axis)
    towards = _Y if x >= max(y, z) else _Z if y >= z else _X
    first = add_scaled(towards, -dot(towards, axis), axis)
    first = scale(1.0 / norm(first), first)
    return first, cross(axis, first)


def shaking(of: Sequence[WheelImbalance], speeds: Sequence[float], angles: Sequence[float]) -> tuple[Vector, Vector]:
    """Return force (N) and torque (N m) of imbalances, at the speeds of all wheels and angles of unbalanced ones."""
    force, torque = ZERO, ZERO
    for each, angle in zip(of, angles, strict=True):
        square = speeds[each.wheel] * speeds[each.wheel]
        # The remainder is exact: the same bits on every machine, however far the wheel has turned.
        sine, cosine = sincos(math.remainder(angle, math.tau))
        force = add_scaled(add_scaled(force, square * cosine, each.forces[0]), square * sine, each.forces[1])
        torque = add_scaled(add_scaled(torque, square * cosine, each.torques[0]), square * sine, each.torques[1])
    return force, torque


def time_to_turn(speed: float, acceleration: float) -> float:
    """Return the shortest time (s) for a wheel to turn by `SEEN`, from its speed (rad/s) and largest acceleration."""
    rate = abs(speed) + math.sqrt(speed * speed + 2.0 * SEEN * acceleration)
    return 2.0 * SEEN / rate if rate > 0.0 else math.inf
