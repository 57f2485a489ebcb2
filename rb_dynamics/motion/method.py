"""`Method`: advances a body by h under a held wrench. A method is data plus one pure function, its `step`.

A step works in the principal axes of inertia and about the centre of mass, on plain floats. It returns increments, so
that one place (`Phase.after`) sums all of them with compensation. It never sees time, files or the wrench's channels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from rb_dynamics.loads.wrench import HeldWrench
from rb_dynamics.rotation import Quaternion
from rb_dynamics.vector import Vector


class Inertia(NamedTuple):
    """What a step needs to know of the body: kg and kg m^2 about the principal axes."""

    mass: float
    moments: Vector


class Increment(NamedTuple):
    """What one step does.

    Attributes:
        displacement: of the centre of mass, world axes, m.
        orientation: after the step, principal to world axes.
        angular_velocity: after the step, principal axes, rad/s.
        impulse: integral of the force by the method's own quadrature, world axes, N s.
        torque_impulse: integral of the torque about the centre of mass, likewise, world axes, N m s.
        work: integral of force . velocity + torque . angular velocity, likewise, J.
    """

    displacement: Vector
    orientation: Quaternion
    angular_velocity: Vector
    impulse: Vector
    torque_impulse: Vector
    work: float


# step(inertia, held wrench in principal and world axes, h, velocity_world, orientation, angular_velocity_principal)
Step = Callable[[Inertia, HeldWrench, float, Vector, Quaternion, Vector], Increment]


@dataclass(frozen=True, slots=True)
class Method:
    """A method of integration.

    Attributes:
        name: as in `solver.method`.
        order: after a fixed time the error of attitude, rate, position, booked work and impulses is O(h^order).
        invariants: what free motion keeps to round-off, of "energy", "angular_momentum" and "unit_quaternion".
        step: the method itself; its docstring names the source.
    """

    name: str
    order: int
    invariants: frozenset[str]
    step: Step
