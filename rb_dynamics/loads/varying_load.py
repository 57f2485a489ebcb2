"""`Load`: force and torque that change inside a step, and what a method must be able to handle.

Effects provide loads and methods evaluate them; neither knows the other.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Protocol

from rb_dynamics.numerics.rotation import Quaternion
from rb_dynamics.numerics.vector import Vector


class Load(Protocol):
    """A force and a torque that change inside a step, such as drag or central gravity."""

    def __call__(
        self, t: float, displacement: Vector, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
    ) -> tuple[Vector, Vector]:
        """Return the force (N, world axes) and the torque about the centre of mass (N m, principal axes) at a state.

        Args:
            t: s since the start of the step.
            displacement: of the centre of mass since the start of the step, m, world axes.
            velocity: of the centre of mass, m/s, world axes.
            orientation: principal to world axes.
            angular_velocity: principal axes, rad/s.
        """


def evaluated(
    load: Load, t: float, displacement: Vector, velocity: Vector, orientation: Quaternion, angular_velocity: Vector
) -> tuple[Vector, Vector]:
    """Evaluate `load`; in a kernel, where a load is an array of numbers, `compiled_load.py` has this function."""
    return load(t, displacement, velocity, orientation, angular_velocity)


class LoadDependence(IntEnum):
    """What a load depends on. An effect declares it; a method declares the most that it supports.

    Each value includes the ones before it.
    """

    HELD = 0
    """Nothing: held wrenches only."""
    FIELD = 1
    """Time, place and attitude."""
    ANY = 2
    """The velocities too."""
    STATES = 3
    """In addition, inner states, such as the momenta of wheels."""
