"""`State`: position, attitude and velocities of a body at one time, without anything that can be derived from them."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

from rb_dynamics.numerics.argument_checks import quaternion, time_count, vector
from rb_dynamics.numerics.rotation import IDENTITY, Quaternion
from rb_dynamics.numerics.vector import ZERO, Vector

_VECTORS = ("position_world", "orientation_xyzw", "linear_velocity_world", "angular_velocity_body")


@dataclass(frozen=True, slots=True)
class State:
    """Motion of a rigid body at one instant; the fields carry the names of the scene's `initial` section.

    One is made for every output of a run, so that nothing is checked here: a scene, an ensemble and `free_motion` check
    what they are given.

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

    def __post_init__(self) -> None:
        """Copy what is no tuple: an array may change later."""
        moves = type(self.position_world) is type(self.linear_velocity_world) is tuple
        if not (moves and type(self.angular_velocity_body) is tuple and type(self.orientation_xyzw) is tuple):
            for name in _VECTORS:
                object.__setattr__(self, name, copy(getattr(self, name)))

    def checked(self, name: str) -> State:
        """Return it with plain floats and an attitude of norm 1 to round-off; messages call it `name`.

        Raises:
            TypeError: a field is not of its type.
            ValueError: a number is not finite or no 64-bit time, or the norm of the attitude not 1 within
                `NORM_TOLERANCE`.
        """
        return replace(
            self,
            time_ns=time_count(self.time_ns, f"{name}.time_ns"),
            position_world=vector(self.position_world, f"{name}.position_world", "a position (m)"),
            orientation_xyzw=quaternion(self.orientation_xyzw, f"{name}.orientation_xyzw"),
            linear_velocity_world=vector(
                self.linear_velocity_world, f"{name}.linear_velocity_world", "a velocity (m/s)"
            ),
            angular_velocity_body=vector(self.angular_velocity_body, f"{name}.angular_velocity_body", "a rate (rad/s)"),
        )
