"""`State`: where a body is and how it moves, as a value. Never holds anything that can be derived."""

from __future__ import annotations

from dataclasses import dataclass

from rb_dynamics.rotation import IDENTITY, Quaternion
from rb_dynamics.vector import ZERO, Vector


@dataclass(frozen=True, slots=True)
class State:
    """Motion of a rigid body at one instant; the fields carry the names of the scene's `initial` section.

    Attributes:
        time_ns: time since the start of the run, integer nanoseconds.
        position_world: position of the body origin, world axes, m.
        orientation_xyzw: unit quaternion, rotation from body to world axes.
        linear_velocity_world: velocity of the body origin, world axes, m/s.
        angular_velocity_body: angular velocity of the body in the world, body axes, rad/s.
    """

    time_ns: int = 0
    position_world: Vector = ZERO
    orientation_xyzw: Quaternion = IDENTITY
    linear_velocity_world: Vector = ZERO
    angular_velocity_body: Vector = ZERO
