"""Drag in a uniform medium, linear or quadratic in the speed, in translation and rotation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from rb_dynamics.body.rigid_body import RigidBody
from rb_dynamics.errors import SceneError
from rb_dynamics.loads.effect import Effect, Point, Wrenching
from rb_dynamics.loads.load import Takes
from rb_dynamics.rotation import conjugate, rotate, rotate_inverse
from rb_dynamics.rotation import multiply as compose
from rb_dynamics.vector import ZERO, Vector, multiply, norm, scale, subtract


@dataclass(frozen=True)
class LinearDrag(Effect):
    """Force -c (v - u) and torque -k w, in the limit of slow flow; it takes energy out at the rate c |v|^2 + k |w|^2.

    Attributes:
        translation: c along each body axis, N s/m; acts through the centre of mass.
        rotation: k about each body axis, N m s/rad.
        medium_velocity_world: u, m/s.
    """

    kind: ClassVar[str] = "linear_drag"
    takes: ClassVar[Takes] = Takes.ANY

    translation: Vector = ZERO
    rotation: Vector = ZERO
    medium_velocity_world: Vector = ZERO

    def __post_init__(self) -> None:
        """Refuse coefficients that are none.

        Raises:
            SceneError: one is negative, or not finite.
        """
        _check_coefficients(self.kind, self.translation, self.rotation, self.medium_velocity_world)

    def check(self, body: RigidBody) -> None:
        """Refuse to turn a particle.

        Raises:
            SceneError: the body is one and `rotation` is not zero.
        """
        _check_turns(self.kind, self.rotation, body)

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        """Return force and torque at a point."""
        return _resistance(self.translation, self.rotation, self.medium_velocity_world, body, lambda _: 1.0)


@dataclass(frozen=True)
class QuadraticDrag(Effect):
    """Force -c |v - u| (v - u) and torque -k |w| w, as in fast flow; it takes out energy like the cube of the speed.

    Attributes:
        translation: c along each body axis, N s^2/m^2 (half of density, area and drag coefficient).
        rotation: k about each body axis, N m s^2/rad^2.
        medium_velocity_world: u, m/s.
    """

    kind: ClassVar[str] = "quadratic_drag"
    takes: ClassVar[Takes] = Takes.ANY

    translation: Vector = ZERO
    rotation: Vector = ZERO
    medium_velocity_world: Vector = ZERO

    def __post_init__(self) -> None:
        """Refuse coefficients that are none.

        Raises:
            SceneError: one is negative, or not finite.
        """
        _check_coefficients(self.kind, self.translation, self.rotation, self.medium_velocity_world)

    def check(self, body: RigidBody) -> None:
        """Refuse to turn a particle.

        Raises:
            SceneError: the body is one and `rotation` is not zero.
        """
        _check_turns(self.kind, self.rotation, body)

    def wrenching(self, body: RigidBody, start: float) -> Wrenching:
        """Return force and torque at a point."""
        return _resistance(self.translation, self.rotation, self.medium_velocity_world, body, norm)


def _check_coefficients(kind: str, translation: Vector, rotation: Vector, medium: Vector) -> None:
    numbers = (*translation, *rotation)
    if not (all(map(math.isfinite, (*numbers, *medium))) and min(numbers) >= 0.0):
        raise SceneError(
            f"{kind}: translation is {translation}, rotation {rotation}, medium_velocity_world {medium}; expected "
            "coefficients of 0 or more and finite numbers: drag takes energy out, write it without a sign"
        )


def _check_turns(kind: str, rotation: Vector, body: RigidBody) -> None:
    if body.is_particle and rotation != ZERO:
        raise SceneError(
            f"{kind}: rotation is {rotation}, expected none: a body without inertia is a particle and does not turn; "
            "remove it, or add body.inertia"
        )


def _resistance(
    translation: Vector, rotation: Vector, medium: Vector, body: RigidBody, size: Callable[[Vector], float]
) -> Wrenching:
    """Return -size(v) c v and -size(w) k w, with the coefficients along the axes of the body."""
    axes = body.principal_orientation_xyzw

    def resistance(point: Point) -> tuple[Vector, Vector]:
        wind = subtract(point.velocity, medium)
        to_world = compose(point.orientation, conjugate(axes))
        force = rotate(to_world, scale(-size(wind), multiply(translation, rotate_inverse(to_world, wind))))
        omega = point.angular_velocity
        torque = rotate_inverse(axes, scale(-size(omega), multiply(rotation, rotate(axes, omega))))
        return force, torque

    return resistance
